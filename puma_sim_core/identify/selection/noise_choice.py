# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Whether the validation set refuses the noise that a fit left.

A noise that counts a missing effect as noise pulls the model from where it predicts best. So a model fitted in another
noise is compared with the one before by the voltages that they lack on the validation set. These vary by chance, more
where the noise lasts: the difference counts only beyond its standard error over pieces that are longer than any source
of noise lasts (batch means; Alexopoulos and Seila 1998, Handbook of Simulation, chapter 7).
"""

import numpy as np
from scipy.stats import t as student

from puma_sim_core.identify.arrays import Bools, Floats, runs
from puma_sim_core.identify.settings import SELECTION


def squares_of_pieces(volts: Floats, rows: Bools, step: float) -> Floats:
    """(k, J) mean squares [V^2] of voltages (N, J) over pieces of the rows (N,) that count; step [s]."""
    longest = max(1, int(SELECTION.noise_piece / step))
    found = []
    for first, end in runs(rows):
        for piece in np.array_split(np.arange(first, end), max(1, (end - first) // longest)):
            found.append((volts[piece] ** 2).mean(axis=0))
    return np.reshape(found, (-1, volts.shape[1]))


def noise_refused(before: Floats, after: Floats) -> bool:
    """Whether a model in another noise lacks more of the validation set's voltage than chance makes it.

    before, after (k, J) : `squares_of_pieces` of the two models. With d_i the change of piece i, of each joint over its
    mean before and averaged over the joints, it is refused where the mean of d is above the share that decides nothing
    and above the 97.5 % quantile of Student's t times its standard error.
    """
    size = before.mean(axis=0) if len(before) else np.zeros(1)
    if not (size > 0.0).all() or not (after.mean(axis=0) > 0.0).all():
        return False
    worse = ((after - before) / size).mean(axis=1)
    count, mean = len(worse), float(worse.mean())
    if mean <= SELECTION.worse_noise or count < 2:
        return mean > SELECTION.worse_noise
    error = float(worse.std(ddof=1)) / np.sqrt(count)
    return bool(mean > student.ppf(SELECTION.noise_confidence, count - 1) * error)
