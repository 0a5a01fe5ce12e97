# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stops at the ends of the range, as stiff springs with damping."""

from math import inf
from typing import Any

import numpy as np

from puma_sim_core.effects.base import PLACE, RATE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals, Values
from puma_sim_core.effects.shared.columns import candidate, on_joint, positive, travelled
from puma_sim_core.jit import Table, inlined

#: where a stop may begin, in shares of the travelled range from its end: a hard stop yields by a thousandth of it, a
#: soft one is pressed in for most of the motion, or all the time
_DEPTHS = np.geomspace(0.0012, 1.1, 24)
#: counts of the encoder that a stop must be pressed in to be seen at all, and samples in it that show it
_COUNTS, _SAMPLES = 5.0, 20
#: share of critical damping that a fit starts from, since none has no scale; fits from it end at none, at 2 and at 20 %
#: alike (`test_loop_fits`)
_DAMPED = 0.05
#: deflection of a stop
_PRESSED = {"upper": np.maximum, "lower": np.minimum}


@inlined
def stop_torque(p: Table, k: int, q: float, qd: float) -> float:
    """Torque [N.m] of the stops, positive against positive motion."""
    if q > p[k + 1]:
        return max(p[k + 2] * (q - p[k + 1]) + p[k + 3] * qd, 0.0)
    if q < p[k]:
        return min(p[k + 2] * (q - p[k]) + p[k + 3] * qd, 0.0)
    return 0.0


def soft_stop(signals: Signals, joint: int) -> list[Candidate]:
    """max(0, q - qs) near the upper end of the travelled range and min(0, q - qs) near the lower, for a grid of qs; the
    coefficient is the stiffness."""
    q, scale = signals.position[:, joint], float(signals.torque_scale[joint])
    inertia = float(signals.link_inertia[:, joint].mean() + signals.motor_inertia[joint])
    low, high = travelled(signals, joint)
    range_low, range_high = signals.ranges[joint]
    # the stop of the other side stands where the joint's range ends, or beyond the motion
    beyond = {} if range_low <= low else {"lower": low - (high - low)}
    above = {} if range_high >= high else {"upper": high + (high - low)}

    def at(side: str, place: float, pressed: float) -> Candidate:
        def values(c: np.ndarray, **stop: float) -> dict[str, float]:
            other = beyond if side == "upper" else above
            stiffness = positive(c[0], "stiffness", "N.m/rad", 1e6)
            damping = float(2.0 * _DAMPED * np.sqrt(stiffness * inertia))
            return {**stop, **other, "stiffness": stiffness, "damping": damping}

        # the deepest press takes a few nominal friction torques
        column, unit = _PRESSED[side](q - place, 0.0), scale / pressed
        return candidate(on_joint(joint, column), [unit], [2.0 * unit], values, {side: place})

    depths = [depth for depth in (_DEPTHS * (high - low)).tolist() if not depth <= _COUNTS * signals.quantum[joint]]
    found = [at("upper", high - depth, depth) for depth in depths]
    found += [at("lower", low + depth, depth) for depth in depths]
    return [c for c in found if np.count_nonzero(c.columns[0][joint]) >= _SAMPLES]


def fitted(names: list[str], values: Values, lowest: float, highest: float) -> list[str]:
    """Parameters that a log tells of: of the stop's material, and the places that its motion from lowest to highest
    meets."""
    met = {"stiffness": True, "damping": True, "lower": values["lower"] > lowest, "upper": values["upper"] < highest}
    return [name for name in names if met.get(name, False)]


def stop(name: str, end: int, neutral: float) -> Parameter:
    """The place of a stop; the end of the joint's range where it is not given."""

    def range_end(arm: Any, joint: int) -> float:
        return arm.joint_ranges[joint - 1][end]

    meaning = f"where the {name} stop begins"
    return Parameter(name, "rad", -10.0, 10.0, meaning, PLACE, neutral=neutral, from_arm=range_end, step=0.02)


EFFECT = Kind(
    name="soft_stop",
    order=160,
    acts=TORQUE,
    equation="tau = K d + B qd while d = q - upper > 0 or d = q - lower < 0; never pulls back",
    sentence="A stiff stop at each end of the joint's range, or where it is put.",
    parameters=(
        stop("lower", 0, -inf),
        stop("upper", 1, inf),
        Parameter("stiffness", "N.m/rad", 0.0, 1e7, "K", RATE, (5.0, 1e5), default=1e4),
        Parameter("damping", "N.m.s/rad", 0.0, 1e5, "B", default=100.0),
    ),
    laws=(Law(Point.LINK_TORQUE, stop_torque),),
    check=lambda values: None if values["lower"] < values["upper"] else "lower below upper",
    stiffening=lambda values: (values["stiffness"], values["damping"]),
    screening=Screening(
        soft_stop, fitted=fitted, excitation="Motion into the ends of the range, and well away from them."
    ),
    drawn_against=("position",),
    example="soft_stop:joint=3,lower=-0.5,upper=0.5",
)
