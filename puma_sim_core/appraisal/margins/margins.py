# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Margins of a loop from its sensitivity: what change of gain, phase or delay it bears before it is unstable.

A loop is broken at the plant input of one joint, the loops of the others stay closed. A voltage d added there makes
the plant's input u = S d; S is the sensitivity, T = 1 - S its complement, and L = 1/S - 1 the loop. All are functions
of the frequency up to half the sampling rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import degrees, inf, log, pi
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from puma_sim_core.appraisal.measure import Measure

#: points of the spline between two frequencies
_BETWEEN = 24
#: angle from the real axis that counts as on it at the ends of the band [rad]: a loop that is real at standstill turns
#: by little at the lowest frequency, and one that is not is away from the axis by 1.57
_ON_AXIS = 0.05
_DISK = "Seiler, Packard and Gahinet, IEEE Control Systems 40 (2020) 5: 78-95"
_ASTROM = "Astrom and Murray, Feedback Systems, sections 10.3 and 12.1"
MEASURES = (
    Measure("sensitivity_peak", "1", "Ms: greatest |S|; of the worst joint", _ASTROM, "margin"),
    Measure("complementary_peak", "1", "Mt: greatest |T|; of the worst joint", _ASTROM, "margin"),
    Measure(
        "gain_margin",
        "dB",
        "smallest change of the loop's gain, up or down, that makes it unstable; of the worst joint",
        _ASTROM,
        "margin",
        smaller_is_better=False,
    ),
    Measure(
        "phase_margin",
        "deg",
        "smallest change of the loop's phase, to either side, that makes it unstable; of the worst joint",
        _ASTROM,
        "margin",
        smaller_is_better=False,
    ),
    Measure(
        "delay_margin",
        "s",
        "smallest further delay in the loop that makes it unstable; of the worst joint",
        _ASTROM,
        "margin",
        smaller_is_better=False,
    ),
    Measure(
        "disk_margin",
        "1",
        "size of the disk of changes of gain and phase at once that the loop bears (balanced, skew 0): the least "
        "1 / |S - 1/2|; of the worst joint",
        _DISK,
        "margin",
        smaller_is_better=False,
    ),
)


class Margins(NamedTuple):
    """Margins of one loop, as `MEASURES` define them; inf where no change of a kind does harm."""

    sensitivity_peak: float
    complementary_peak: float
    gain_margin: float
    phase_margin: float
    delay_margin: float
    disk_margin: float


#: of a loop that is not stable
NO_MARGINS = Margins(inf, inf, 0.0, 0.0, 0.0, 0.0)


def margins_of(frequency: np.ndarray, sensitivity: np.ndarray) -> Margins:
    """Margins of a stable loop.

    frequency (m,) : increasing, positive [rad/s], m >= 4; sensitivity (m,) complex. In between it is a cubic spline
    over its logarithm. Crossings outside the band are not seen, but for a loop that is real at the band's ends.
    """
    x = np.log(frequency)
    fine = np.unique(np.concatenate([np.linspace(a, b, _BETWEEN) for a, b in pairwise(x)]))
    S = CubicSpline(x, sensitivity)(fine)
    loop = 1.0 / S - 1.0
    phase = np.unwrap(np.angle(loop))
    size = np.log(np.abs(loop))
    # where the phase passes an odd multiple of pi
    turn = np.floor((phase - pi) / (2.0 * pi))
    k = np.flatnonzero(turn[1:] != turn[:-1])
    level = pi + 2.0 * pi * np.maximum(turn[k], turn[k + 1])
    share = (level - phase[k]) / (phase[k + 1] - phase[k])
    sizes = (size[k] + share * (size[k + 1] - size[k])).tolist()
    sizes += [float(size[end]) for end in (0, -1) if abs(np.angle(-loop[end])) < _ON_AXIS]
    # where the size passes 1
    k = np.flatnonzero((size[1:] < 0.0) != (size[:-1] < 0.0))
    share = size[k] / (size[k] - size[k + 1])
    at = np.exp(fine[k] + share * (fine[k + 1] - fine[k]))
    angle = phase[k] + share * (phase[k + 1] - phase[k]) + pi
    away = np.abs((angle + pi) % (2.0 * pi) - pi)
    return Margins(
        sensitivity_peak=float(np.abs(S).max()),
        complementary_peak=float(np.abs(1.0 - S).max()),
        gain_margin=min((abs(20.0 * value / log(10.0)) for value in sizes), default=inf),
        phase_margin=degrees(float(away.min())) if k.size else inf,
        delay_margin=float((angle % (2.0 * pi) / at).min()) if k.size else inf,
        disk_margin=float((1.0 / np.abs(S - 0.5)).min()),
    )


def margin_measures(loops: Sequence[Margins]) -> dict[str, float]:
    """The worst of each over the loops."""
    return {
        one.name: float((max if one.smaller_is_better else min)(getattr(loop, one.name) for loop in loops))
        for one in MEASURES
    }
