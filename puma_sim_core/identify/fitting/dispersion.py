# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How much more the scores of a fitted model scatter between blocks of the logs than noise makes them.

With J the derivatives of the whitened innovations e by all free parameters, and the sum of J'J = A over the rows, each
block k of a log adds a score u_k = J_k'e_k. In a true model with the right noise the sum B of u_k u_k' has the mean A.
What a model lacks, or a noise that is too small, makes B greater: evidence [nat] is too large by

    c = tr(A^-1 B) / p,

the criterion of Takeuchi (1976, Suri-Kagaku 153:12) over its value for a true model, and the variance inflation of
quasi-likelihood (Wedderburn 1974, Biometrika 61:439; Burnham and Anderson 2002, Model Selection, section 2.5). A gain
over c is the same whatever size of noise was assumed: both go with one over its variance.

Two models are compared in the one direction in which they differ, d = e' - e with e the innovations of the better, and
the deviations of its parameters from their priors: its log likelihood is greater by d'e + d'd/2, and chance moves that
by the sum of the blocks' d_k'e_k, of variance d'd where the better model is true. The greater of that and what the
blocks show is its standard error.
"""

import numpy as np

from puma_sim_core.identify.arrays import Floats, Ints
from puma_sim_core.identify.fitting.prediction import Fitted
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.settings import FITTING, SELECTION


def dispersion(predictor: Predictor, jacobian: Floats, errors: Floats, priors: int) -> float:
    """The least dispersion c that a model's scores are consistent with, 1 at least.

    jacobian (N', p) : derivatives after whitening, at the rows to fit, the first `priors` of them by parameters with a
    prior of unit deviation; errors (N, J) : innovations after whitening. In a true model c is a mean of K p squares of
    a normal distribution over K blocks, of standard error sqrt(2 / (K p)): two of these are taken for chance.
    """
    rows = predictor.fit_rows
    # as `rows` picks them: row by row, the joints of each together
    block = np.broadcast_to(blocks(predictor)[:, None], rows.shape)[rows]
    present, block = np.unique(block, return_inverse=True)
    count = len(present)
    if count < FITTING.dispersion_least_blocks:
        return 1.0
    scores = np.zeros((count, jacobian.shape[1]))
    np.add.at(scores, block, jacobian * errors[rows][:, None])
    scores -= scores.mean(axis=0)
    precision = np.full(jacobian.shape[1], FITTING.least_precision)
    precision[:priors] = 1.0
    normal = jacobian.T @ jacobian
    answered = np.linalg.solve(normal + np.diag(precision), np.column_stack([normal, scores.T @ scores]))
    p = jacobian.shape[1]
    # parameters that the prior holds, and the log says nothing of, do not count
    effective = float(np.trace(answered[:, :p]))
    if effective <= 0.0:
        return 1.0
    found = float(np.trace(answered[:, p:])) / effective * count / (count - 1.0)
    uncertain = FITTING.dispersion_errors * np.sqrt(2.0 / (count * effective))
    return max(1.0, found / (1.0 + uncertain))


def clearly_better(predictor: Predictor, better: Fitted, other: Fitted) -> bool:
    """Whether one model fits better than another beyond what chance, or what the better one misfits, may do."""
    return errors_between(predictor, better, other) > SELECTION.standard_errors


def errors_between(predictor: Predictor, better: Fitted, other: Fitted) -> float:
    """By how many standard errors one model fits better than another, by chance and by what the better one misfits.

    The priors of the parameters count as rows of their own: a model may fit as well by parameters far from their start.
    """
    rows, m = predictor.fit_rows, predictor.mechanism
    left = np.where(rows, better.errors, 0.0)
    apart = np.where(rows, other.errors - better.errors, 0.0)
    strained = (better.point.theta - m.start) / m.deviations
    moved = (other.point.theta - better.point.theta) / m.deviations
    scores = np.bincount(blocks(predictor), (apart * left).sum(axis=1))
    squares = float((apart**2).sum() + moved @ moved)
    variance = max(squares, float(scores @ scores + ((moved * strained) ** 2).sum()))
    return float((other.objective - better.objective) / np.sqrt(variance)) if variance > 0.0 else 0.0


def blocks(predictor: Predictor, length: float = FITTING.dispersion_block) -> Ints:
    """(N,) number of the block, of about a length [s], that each innovation is in; none reaches from one log into the
    next."""
    found, first = [], 0
    for stretch in predictor.stretches:
        time = stretch.time[1:] - stretch.time[0]
        count = max(1, round(float(time[-1]) / length))
        found.append(first + np.minimum((count * time / time[-1]).astype(int), count - 1))
        first += count
    return np.concatenate(found)
