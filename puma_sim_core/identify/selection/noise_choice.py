# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Whether the validation set refuses the noise that a fit left.

A noise that counts a missing effect as noise pulls the model from where it predicts best. So a model fitted in another
noise is compared with the one before by the voltages that they lack on the validation set. These vary by chance, more
where the noise lasts: the difference counts only beyond its standard error over pieces that are longer than any source
of noise lasts (`fitting.pieces`).

The noise that stays then keeps its spectrum, and gets the size of what the best explanation of each joint leaves. The
first noise of a log is that of changes from row to row: where most of what is left lasts, it is hundreds of times too
small, so that priors hold nothing and parameters go wherever the misfit pulls them.
"""

from collections.abc import Sequence

import numpy as np

from puma_sim_core.identify.arrays import Bools, Floats, Ints
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


def least_variances(left: Sequence[Floats], rows: Bools, block: Ints) -> Floats:
    """(J,) variance of whitened innovations, for each joint that of the model which leaves least: 1 in the right noise.

    left : innovations (N, J) of models; rows (N, J) : which count; block (N,) : the block of each. A variance is the
    median over the blocks, which a touch does not move.
    """
    return np.min([[_variance(e[own, j], block[own]) for j, own in enumerate(rows.T)] for e in left], axis=0)


def _variance(errors: Floats, block: Ints) -> float:
    """The median over blocks of the mean squares of errors; 1 without any."""
    present, block = np.unique(block, return_inverse=True)
    if not len(present):
        return 1.0
    return float(np.median(np.bincount(block, errors**2) / np.bincount(block)))
