# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Differences of two models over pieces of the rows, and whether they are more than chance.

Pieces are twice as long as any source of noise lasts, so that sums over them are nearly independent (batch means;
Alexopoulos and Seila 1998, Handbook of Simulation, chapter 7).
"""

import numpy as np
from scipy.special import stdtrit

from puma_sim_core.identify.arrays import Bools, Floats, Ints, runs
from puma_sim_core.identify.settings import SELECTION


def pieces(rows: Bools, step: float) -> list[Ints]:
    """Numbers of the rows of each piece of those (n,) that count, none across a gap of them; step [s]."""
    longest = max(1, int(SELECTION.noise_piece / step))
    return [
        piece
        for first, end in runs(rows)
        for piece in np.array_split(np.arange(first, end), max(1, (end - first) // longest))
    ]


def clearly_above_zero(values: Floats) -> bool:
    """Whether the mean of values (k,) is above the 97.5 % quantile of Student's t times its standard error.

    Of a single value, whose error is not known, whether it is above zero.
    """
    count, mean = len(values), float(values.mean()) if len(values) else 0.0
    if count < 2:
        return mean > 0.0
    error = float(values.std(ddof=1)) / np.sqrt(count)
    return bool(mean > stdtrit(count - 1, SELECTION.noise_confidence) * error)
