# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Columns of the stops where the motion of a joint ends."""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects.columns.common import candidate, on_joint, positive, travelled
from puma_sim_core.effects.screening import Candidate, Screening, Signals

#: where a stop may begin, in shares of the travelled range from its end: a hard stop gives way by
#: a thousandth of it, a soft one is pressed in for half of the motion
_DEPTHS = np.geomspace(0.0012, 0.45, 20)
#: counts of the encoder that a stop must be pressed in, to be seen at all
_COUNTS = 5.0
#: samples in a stop that show it
_SAMPLES = 20


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

            # the deepest press takes a few middling friction torques
            unit = scale / pressed
            found.append(
                candidate(on_joint(joint, column), [unit], [2.0 * unit], values, {"upper" if upper else "lower": place})
            )
    return found


SCREENINGS = {
    "soft_stop": Screening(
        soft_stop,
        look_alikes=(
            (
                "joint_spring",
                "the torque begins with a kink at one position; seen only from inside, a stop is a spring",
            ),
            ("payload", "the torque stays on its joint and is zero before the kink"),
            ("presliding_friction", "the torque comes back at the same position, not after each reversal"),
            ("impulse", "the torque comes back whenever the joint comes back to the same position"),
        ),
        excitation="Motion into the ends of the range, and well away from them.",
        # seen only from inside it is one
        contains=("joint_spring",),
        # softer is a spring, or a cable, and begins nowhere
        plausible=(("stiffness", 100.0, 1e5),),
    )
}
