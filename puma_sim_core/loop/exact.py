# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Positions that are better than any sensor's, as a simulator records them.

Without noise there is no scale on which a misfit is small: the last digits of an integration
would be physics to be explained, and a fit would have to be exact to a millionth before an effect
shows. Such positions are read as a good encoder would give them.
"""

from __future__ import annotations

from dataclasses import replace
from math import comb, sqrt

import numpy as np

from .ingest import Log

#: step of the encoder that positions are read with, as a share of the joint's range; the PUMA's
#: own have 1e-5 to 2e-5
_STEP_SHARE = 1e-5
#: positions with noise beyond so many of these steps have what they need; in less, rounding to
#: the step is hardly seen
_NOISY = 3.0
#: order of the differences that noise is judged by: a motion that is smooth beside the sampling
#: vanishes in them
_ORDER = 6


def as_measured(log: Log, mechanism) -> tuple[Log, str | None]:
    """A log with its exact positions rounded to encoder steps, and a note on it, None without any.

    mechanism : whose ranges give the steps. Joints where steps of an encoder or noise of some steps
    can be seen stay as they are.
    """
    position, quantum, joints = log.position, log.quantum, []
    for j, (low, high) in enumerate(mechanism.ranges):
        step = _STEP_SHARE * (high - low)
        if quantum[j] > 0.0 or _noise(log.position[:, j]) > _NOISY * step:
            continue
        if not joints:
            position, quantum = position.copy(), quantum.copy()
        position[:, j] = step * np.round(position[:, j] / step)
        quantum[j] = step
        joints.append(j + 1)
    if not joints:
        return log, None
    which = (
        "all joints"
        if len(joints) == log.joints
        else f"joint{'s' if len(joints) > 1 else ''} {', '.join(map(str, joints))}"
    )
    return replace(log, position=position, quantum=quantum), (
        f"The positions of {which} are exact, as a simulator gives them: they are read as by an "
        f"encoder with {1.0 / _STEP_SHARE:.0f} steps over the range."
    )


def _noise(position: np.ndarray) -> float:
    """Standard deviation of white noise whose differences would be as great as those of an (n,)
    series; infinite for a series too short for them."""
    if len(position) <= _ORDER:
        return np.inf
    middle = float(np.median(np.abs(np.diff(position, _ORDER))))
    return middle / (0.6745 * sqrt(comb(2 * _ORDER, _ORDER)))
