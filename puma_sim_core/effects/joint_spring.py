# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A spring across a joint."""

import numpy as np

from puma_sim_core.effects.base import PLACE, RATE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Illegal, Screening, Signals, Span, Values
from puma_sim_core.effects.shared.columns import candidate, on_joint, positive, whole_range
from puma_sim_core.jit import Table, inlined


@inlined
def spring_torque(p: Table, k: int, q: float, qd: float) -> float:
    """Torque [N.m] of the spring at position q [rad], positive against positive motion."""
    return p[k] * (q - p[k + 1])


def spring(signals: Signals, joint: int) -> list[Candidate]:
    """q less its mean, and 1: stiffness, and torque at the mean."""
    q, scale = signals.position[:, joint], float(signals.torque_scale[joint])
    middle = float(q.mean())
    low, high = whole_range(signals, joint)
    if high <= low:
        return []
    unit = 2.0 * scale / (high - low)

    def values(c: np.ndarray) -> dict[str, float]:
        stiffness = positive(c[0], "stiffness", "N.m/rad", 60.0 * unit)
        found = {"stiffness": stiffness, "angle": middle - float(c[1]) / max(stiffness, 1e-12)}
        reason = far(found, (low, high), (low, high))
        if reason is not None:
            raise Illegal(reason)
        return found

    columns = on_joint(joint, q - middle, np.ones_like(q))
    return [candidate(columns, [2.0 * unit, 0.0], [3.0 * unit, 1.5 * scale], values)]


def far(values: Values, motion: Span, _: Span) -> str | None:
    """Where the spring's torque varies by less than half of its mean over the motion, and is told from a constant one
    by nothing else; None where it varies by more. With R the span of the motion and d from there to where it is slack
    the two are K R and K (d + R/2), so that d is 1.5 R."""
    low, high = motion
    angle, beyond = values["angle"], 1.5 * (high - low)
    if low - beyond <= angle <= high + beyond:
        return None
    return f"slack at {angle:.3g} rad, far outside the range {low:.3g} to {high:.3g} rad, and all but a constant torque"


EFFECT = Kind(
    name="joint_spring",
    order=230,
    acts=TORQUE,
    equation="tau = Ks (q - q0)",
    sentence="A spring across the joint: a balance spring, or a cable that is bent.",
    parameters=(
        Parameter("stiffness", "N.m/rad", 0.0, 1e5, "Ks", RATE, (0.5, 50.0)),
        Parameter("angle", "rad", -10.0, 10.0, "q0, where it is slack", PLACE, default=0.0),
    ),
    laws=(Law(Point.LINK_TORQUE, spring_torque, 1),),
    screening=Screening(spring, "Slow motion over the full range of the joint.", illegal=far),
    drawn_against=("position",),
    example="joint_spring:joint=3,stiffness=6",
)
