# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Whether the validation set refuses the noise that a fit left.

A noise that counts a missing effect as noise pulls the model from where it predicts best. So a model fitted in another
noise is compared with the one before by the voltages that they lack on the validation set. These vary by chance, more
where the noise lasts: the difference counts only beyond its standard error over pieces that are longer than any source
of noise lasts (`fitting.pieces`).
"""

from collections.abc import Sequence

import numpy as np

from puma_sim_core.identify.arrays import Bools, Floats
from puma_sim_core.identify.fitting.pieces import clearly_above_zero, pieces
from puma_sim_core.identify.settings import SELECTION


def squares_of_pieces(volts: Floats, rows: Bools, step: float) -> Floats:
    """(k, J) mean squares [V^2] of voltages (N, J) over pieces of the rows (N,) that count; step [s]."""
    found = [(volts[piece] ** 2).mean(axis=0) for piece in pieces(rows, step)]
    return np.reshape(found, (-1, volts.shape[1]))


def least_of_joints(squares: Sequence[Floats]) -> Floats:
    """(k, J) of several `squares_of_pieces`, for each joint those with the least mean."""
    found = np.array(squares)
    if not found.shape[1]:
        return np.asarray(found[0])
    numbers = found.mean(axis=1).argmin(axis=0)
    return np.column_stack([found[number, :, j] for j, number in enumerate(numbers.tolist())])


def noise_refused(before: Floats, after: Floats) -> bool:
    """Whether a model in another noise lacks more of the validation set's voltage than chance makes it.

    before, after (k, J) : `squares_of_pieces` of the two, each by the model that predicts a joint best. With d_i the
    change of piece i, of each joint over its mean before and averaged over the joints, it is refused where the mean of
    d is above the share that decides nothing and above the 97.5 % quantile of Student's t times its standard error.
    """
    size = before.mean(axis=0) if len(before) else np.zeros(1)
    if not (size > 0.0).all() or not (after.mean(axis=0) > 0.0).all():
        return False
    worse = ((after - before) / size).mean(axis=1)
    return float(worse.mean()) > SELECTION.worse_noise and clearly_above_zero(worse)
