# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Tune one joint by the ultimate-sensitivity method of Ziegler and Nichols (section 7.6.1).

The other joints are locked. The gain at which a proportional controller makes the joint oscillate,
and the period of that oscillation, are found twice: from the eigenvalues of the linearised and
exactly sampled joint, and on the nonlinear simulator. Table 7.2 makes controllers of them.

  puma-sim tune --joint 2 --pose 0,-90,90
  puma-sim tune --joint 1 --pose 0,0,90 --period 0.028 --delay 1
"""

import argparse
from typing import Any

from puma_sim_core.cli.arguments import Command, add_plant_arguments, joint_numbers, number, plant_of, whole_number
from puma_sim_core.errors import ParameterError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--joint", metavar="1|2|3", required=True, help="the joint that moves")
    pose = "where the joints stand [deg] (0,0,0), or 1.57rad"
    parser.add_argument("--pose", metavar="Q1,Q2,Q3", default="0,0,0", help=pose)
    parser.add_argument("--period", metavar="S", help="time between samples [s] (28/30 ms)")
    parser.add_argument("--delay", metavar="N", default="0", help="samples by which a voltage acts late (0)")
    parser.add_argument("--limit", metavar="V/RAD", default="1e6", help="greatest gain that is looked at [V/rad] (1e6)")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")
    parser.add_argument("--method", choices=("both", "eigenvalues", "simulation"), default="both", help="how (both)")
    add_plant_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Tune and print; raises ParameterError, LimitError, TuningError or ModelError."""
    joint, delay = whole_number(options.joint, "--joint"), whole_number(options.delay, "--delay")
    pose = joint_numbers(options.pose, "--pose", "deg", 3)
    limit = number(options.limit, "--limit")
    period = None if options.period is None else number(options.period, "--period")

    from math import inf, radians

    from puma_sim_core.control.linear import is_linear
    from puma_sim_core.json_text import json_text
    from puma_sim_core.simulation.simulator import SERVO_PERIOD
    from puma_sim_core.tuning.ziegler_nichols import (
        SETTINGS,
        Loop,
        settings,
        ultimate_by_eigenvalues,
        ultimate_by_simulation,
    )

    plant = plant_of(options)
    if plant.joints != 3:
        raise ParameterError(f"a model of {plant.joints} joint", where="--model", expected="a model of an arm of three")
    loop = Loop(plant, joint, tuple(map(radians, pose)), SERVO_PERIOD if period is None else period, delay)
    found = {}
    if options.method != "simulation":
        found["eigenvalues"] = ultimate_by_eigenvalues(loop, limit=limit)
    if options.method != "eigenvalues":
        found["simulation"] = ultimate_by_simulation(loop, limit=limit)
    best = next(iter(found.values()))
    if options.json:
        from dataclasses import asdict

        table = {method: _plain(asdict(settings(best, method))) for method in SETTINGS}
        ultimates = {name: _plain(asdict(each)) for name, each in found.items()}
        where = {"joint": joint, "pose_deg": list(pose), "period_s": loop.period, "delay": delay}
        print(json_text({**where, "ultimate": ultimates, "settings": table}), end="")
        return 0
    print(
        f"joint {joint} of {plant.arm.name} at ({', '.join(f'{q:g}' for q in pose)}) deg, the "
        f"others locked; sampled every {loop.period * 1e3:.6g} ms, {delay} samples of delay\n"
    )
    print(f"{'':13}{'Kmax [V/rad]':>14}{'Tp [s]':>12}")
    for name, ultimate in found.items():
        print(f"{name:13}{ultimate.gain:14.6g}{ultimate.period:12.5g}")
    if len(found) == 2:
        a, b = found.values()
        print(f"{'difference':13}{b.gain / a.gain - 1.0:14.2%}{b.period / a.period - 1.0:12.2%}")
    if best.least_gain:
        print(f"below {best.least_gain:.4g} V/rad the joint falls over")
    if not is_linear(plant):
        print(
            "note: the plant has friction, limits or stops that eigenvalues cannot see; with "
            "them the simulation's answer holds for small motion only"
        )
    print(f"\n{'table 7.2':13}{'Kg [V/rad]':>14}{'Ti [s]':>12}{'Td [s]':>12}")
    for method in SETTINGS:
        gains = settings(best, method)
        times = (gains.integral_time, gains.derivative_time)
        cells = "".join(f"{'-':>12}" if t in (0.0, inf) else f"{t:12.5g}" for t in times)
        print(f"{method:13}{gains.gain:14.6g}{cells}")
    return 0


def _plain(numbers: dict[str, Any]) -> dict[str, Any]:
    """Numbers as JSON holds them: none for infinity."""
    from math import isfinite

    return {name: value if value is None or isfinite(value) else None for name, value in numbers.items()}


COMMAND = Command("tune", "ultimate gain, period and PID settings of a joint at a pose", __doc__, add_arguments, run)
