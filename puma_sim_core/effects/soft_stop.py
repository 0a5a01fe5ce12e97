# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Stops at the ends of the range, as stiff springs with damping."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, Parameter, Point, Role
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, positive, travelled
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass

#: where a stop may begin, in shares of the travelled range from its end: a hard stop yields by
#: a thousandth of it, a soft one is pressed in for half of the motion
_DEPTHS = np.geomspace(0.0012, 0.45, 20)

#: counts of the encoder that a stop must be pressed in, to be seen at all
_COUNTS = 5.0

#: samples in a stop that show it
_SAMPLES = 20


@inlined
def stop_torque(p, k, q, qd):
    """Torque [N.m] of the stops, positive against positive motion."""
    if q > p[k + 1]:
        return max(p[k + 2] * (q - p[k + 1]) + p[k + 3] * qd, 0.0)
    if q < p[k]:
        return min(p[k + 2] * (q - p[k]) + p[k + 3] * qd, 0.0)
    return 0.0


def soft_stop(signals: Signals, joint: int) -> list[Candidate]:
    """max(0, q - qs) near the upper end of the travelled range and min(0, q - qs) near the lower,
    for a grid of qs; the coefficient is the stiffness."""
    q, scale = signals.position[:, joint], float(signals.torque_scale[joint])
    low, high = travelled(signals, joint)
    range_low, range_high = (float(end) for end in signals.ranges[joint])
    found = []
    for upper in (True, False):
        for depth in _DEPTHS:
            pressed = float(depth) * (high - low)
            place = high - pressed if upper else low + pressed
            column = np.maximum(q - place, 0.0) if upper else np.minimum(q - place, 0.0)
            if pressed <= _COUNTS * signals.quantum[joint] or np.count_nonzero(column) < _SAMPLES:
                continue
            ends = {"upper": place} if upper else {"lower": place}
            # the stop of the other side stands where the joint's range ends, or beyond the motion
            if upper and not range_low <= low:
                ends["lower"] = low - (high - low)
            if not upper and not range_high >= high:
                ends["upper"] = high + (high - low)

            def values(c, ends=ends):
                return {**ends, "stiffness": positive(c[0], "stiffness", "N.m/rad", 1e6), "damping": 0.0}

            # the deepest press takes a few nominal friction torques
            unit = scale / pressed
            found.append(
                candidate(on_joint(joint, column), [unit], [2.0 * unit], values, {"upper" if upper else "lower": place})
            )
    return found


def fitted(names: list[str], values: Mapping[str, float], lowest: float, highest: float) -> list[str]:
    """Parameters that a log tells of: the stiffness, and the stops that its motion from lowest to highest meets."""
    met = {"stiffness": True, "lower": values["lower"] > lowest, "upper": values["upper"] < highest}
    return [name for name in names if met.get(name, False)]


EFFECT = Kind(
    name="soft_stop",
    order=160,
    acts=TORQUE,
    equation="tau = K d + B qd while d = q - upper > 0 or d = q - lower < 0; never pulls back",
    sentence="A stiff stop at each end of the joint's range, or where it is put.",
    parameters=(
        Parameter(
            "lower",
            "rad",
            -10.0,
            10.0,
            "where the lower stop begins",
            neutral=-inf,
            from_arm=lambda arm, joint: arm.joint_ranges[joint - 1][0],
            role=Role.PLACE,
            step=0.02,
        ),
        Parameter(
            "upper",
            "rad",
            -10.0,
            10.0,
            "where the upper stop begins",
            neutral=inf,
            from_arm=lambda arm, joint: arm.joint_ranges[joint - 1][1],
            role=Role.PLACE,
            step=0.02,
        ),
        Parameter("stiffness", "N.m/rad", 0.0, 1e6, "K", default=1e4, role=Role.RATE, plausible=(100.0, 1e5)),
        Parameter("damping", "N.m.s/rad", 0.0, 1000.0, "B", default=100.0),
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
