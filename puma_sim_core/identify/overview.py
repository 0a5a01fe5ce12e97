# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a log holds before anything is fitted: rows, what would be left out, motion, and which effects it can show."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.identify.checks.gate import Checked, check
from puma_sim_core.identify.data.coarse_clock import evenly_stamped
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.link_side.terms import BACKLASH, ELASTICITY, LAG
from puma_sim_core.identify.prepare import library_of
from puma_sim_core.identify.result import Hypothesis
from puma_sim_core.identify.screening.hypotheses import candidates, hypotheses
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.plant.mechanism import Mechanism


@dataclass(frozen=True)
class JointMotion:
    """One joint in the rows that can be used: lowest and highest position [rad or m] and voltage [V], greatest speed,
    and the share of the rows in which it moves."""

    position: tuple[float, float]
    voltage: tuple[float, float]
    speed: float
    moving: float


@dataclass(frozen=True)
class Overview:
    """log, and what of it can be used; motion : of each joint; shown, hidden : effects that its motion can show, and
    those for which it has nothing that they act on; these three are empty where nothing can be used. exchanged :
    whether the log can be used with positions for voltages and voltages for positions."""

    log: Log
    checked: Checked
    motion: tuple[JointMotion, ...] = ()
    shown: tuple[Hypothesis, ...] = ()
    hidden: tuple[Hypothesis, ...] = ()
    exchanged: bool = False

    def lines(self, position_unit: str) -> list[str]:
        """The overview as text."""
        log, found = self.log, self.checked
        steps = 1e3 * np.diff(log.time)
        rate = f", a row every {1e3 * log.step:.4g} ms (at most {steps.max():.4g})" if len(steps) else ""
        lines = [f"{log.name}: {log.extent}{rate}", *(f"  note: {note}" for note in found.notes)]
        lines += [f"  left out: {cut.channel}, row {cut.row}: {cut.what}" for cut in found.cuts]
        lines += [f"  fault: {fault.channel}: {fault.what}" for fault in (*found.faults, *found.doubts)]
        if not found.parts:
            lines += ["  are the columns of voltages and positions exchanged?"] if self.exchanged else []
            return [*lines, "  nothing of it can be used"]
        parts = f" in {len(found.parts)} parts" if len(found.parts) > 1 else ""
        lines.append(f"  used: {sum(map(len, found.parts))} rows{parts}")
        for j, m in enumerate(self.motion, 1):
            positions = "{:.4g} to {:.4g}".format(*m.position)
            volts, moves = "{:.4g} to {:.4g} V".format(*m.voltage), f"moves in {m.moving:.0%} of the rows"
            speed = f"up to {m.speed:.3g} {position_unit}/s"
            lines.append(f"  joint {j}: {positions} {position_unit}, {speed}, {volts}, {moves}")
        lines.append(f"  can show: {_listed(self.shown, log.joints)}")
        lines += [f"  cannot show: {_listed(self.hidden, log.joints)}"] if self.hidden else []
        return lines


def overview(log: Log, mechanism: Mechanism) -> Overview:
    """Look at a log as `explain` would, without any fit."""
    log = evenly_stamped(log)
    checked = check(log, mechanism)
    if not checked.parts:
        other = check(replace(log, voltage=log.position, position=log.voltage, quantum=np.zeros(0)), mechanism)
        return Overview(log, checked, exchanged=bool(other.parts) and not other.doubts)
    if not mechanism.links_known:
        sought = [Hypothesis(name, j) for j in range(1, mechanism.joints + 1) for name in (LAG, ELASTICITY, BACKLASH)]
        return Overview(log, checked, shown=tuple(sought))
    problem = Problem(sample(checked.parts), mechanism)
    s, start = problem.sampled, mechanism.start
    signals = replace(problem.signals(start), residual=problem.full_residual(start))
    motion = tuple(
        JointMotion(_span(s.position[:, j]), _span(s.voltage[:, j]), float(np.abs(s.velocity[:, j]).max()), moving)
        for j, moving in enumerate(problem.usable.mean(axis=0).tolist())
    )
    shown, hidden = list[Hypothesis](), list[Hypothesis]()
    for kind, joint in hypotheses(library_of(mechanism).values(), mechanism):
        (shown if candidates(kind, joint, signals) else hidden).append(Hypothesis(kind.name, joint))
    return Overview(log, checked, motion, tuple(shown), tuple(hidden))


def _span(values: np.ndarray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _listed(found: Iterable[Hypothesis], joints: int) -> str:
    """Effects, with their joints where these are not all: coulomb_friction@1,2."""
    places: dict[str, list[str]] = {}
    for each in found:
        places.setdefault(each.name, []).extend([] if each.joint is None else [str(each.joint)])
    some = {name: "@" + ",".join(own) if 0 < len(own) < joints else "" for name, own in places.items()}
    return ", ".join(name + where for name, where in some.items()) or "nothing"
