# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a battery is made of, as text: controllers, tasks with their limits, perturbations, measures."""

from __future__ import annotations

from puma_sim_core.appraisal.battery import Battery
from puma_sim_core.appraisal.controllers import BASELINES
from puma_sim_core.appraisal.measures import MEASURES
from puma_sim_core.appraisal.perturbations.drawing import AUGMENTED, NOMINAL, RANDOM, effect_names
from puma_sim_core.appraisal.perturbations.sizes import SIZES, main_parameter, value_at
from puma_sim_core.effects import KINDS


def listing(mechanism: str = "puma560") -> str:
    """Everything that `appraise` can be asked for, for the arm of a mechanism."""
    setting = Battery(("pid",), mechanism=mechanism).setting
    lines = ["Controllers"]
    lines += [f"  {one.name:27}{one.sentence}" for one in BASELINES.values()]
    lines += ["  module:Class               a class with period, reset() and update(t, setpoint, measurement)"]
    lines += ["", "Tasks (--task), with what a trial must keep to pass"]
    for task in setting.tasks.values():
        lines.append(f"  {task.name:20}{task.duration:5.1f} s  {task.sentence}")
        lines += [
            f"      {each.measure} at most {each.value:.4g} {_unit(each.measure)}: {each.why}" for each in task.limits
        ]
    lines += ["", "Perturbations (--perturbation)"]
    lines += [f"  {NOMINAL:14}the arm as the mechanism states it", f"  {AUGMENTED:14}the arm of --model"]
    lines += [f"  {name:14}{sentence}" for name, sentence in RANDOM.items()]
    lines += [f"  effects       each effect alone at each size, NAME:JOINT:SIZE, SIZE one of {', '.join(SIZES)}:"]
    for name in dict.fromkeys(each.partition(":")[0] for each in effect_names(setting.drawing.mechanism)):
        parameter, *_ = main_parameter(KINDS[name])
        sizes = ", ".join(f"{value_at(KINDS[name], size):.3g}" for size in SIZES.values())
        joint = ":1..3" if KINDS[name].per_joint else ""
        lines.append(f"      {name + joint:36}{parameter.name} {sizes} {parameter.unit}")
    lines += ["", "Measures"]
    for one in MEASURES.values():
        lines.append(f"  {one.name:28}[{one.unit}] {one.definition} ({one.source})")
    return "\n".join(lines)


def _unit(measure: str) -> str:
    unit = MEASURES[measure].unit
    return "" if unit == "1" else unit
