# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What noise makes of the errors of a true model in open loop.

Noise that is known by the innovations e that it makes goes into open loop as they do. A joint by itself has
x_{k+1} = F (x_k + K e_k) and y_k = C x_k + e_k, so the error m rows after the last correction is

    d_m = g_0 e_m + g_1 e_{m-1} + ... + g_m e_0,    g_0 = 1, g_i = C F^i K

and its variance a sum over the autocovariance r of the innovations.

Noise of rows is that of a voltage and of a position. A voltage w of row k with the correlation time T is a process of
first order, of rows a step h apart,

    w_{k+1} = rho w_k + (1 - rho^2)^(1/2) v_k,    rho = exp(-h / T)

with v white; T = 0 is a white voltage. The longer the correlation, the less of the voltage changes from row to row, and
the more of it is left in open loop: of two noises that make the same innovations, the slower makes larger errors there.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import fft

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise.weighting import Weighting, folded_response
from puma_sim_core.identify.settings import FITTING

#: rows -> (rows, J) variance [rad^2 or m^2] of a true model's positions by the rows since its last correction
Spread = Callable[[int], Floats]


class NoiseFloor(NamedTuple):
    """Errors of a true model: (J,) of voltages [V], root mean square, and the spread of positions."""

    volts: Floats
    spread: Spread


class RowNoise(NamedTuple):
    """Noise of rows, (J,): of a voltage [V] with a correlation time [s], and of a position [rad or m]."""

    volts: Floats
    position: Floats
    correlation: float = 0.0


def noise_behind(predictor: Predictor, innovations: Floats, position: Floats, correlation: float = 0.0) -> RowNoise:
    """The noise behind innovations (N, J) of a true model, NaN where a row does not count.

    position (J,) : the greatest noise of a position; correlation [s] : of a voltage. What a remainder leaves in the
    innovations is no noise, nor is all that came before a name: from row to row a voltage changes no more than a white
    one that is as large as expected (`Predictor.expected`).
    """
    variance = np.nanvar(innovations, axis=0)
    one, none = np.ones(len(position)), np.zeros(len(position))
    pairs = (RowNoise(one, none, correlation), RowNoise(none, one, correlation))
    driven, seen = (variance_of_rows(predictor, noise, 1)[0] for noise in pairs)
    sensed = np.minimum(position**2, variance / seen)
    volts = np.sqrt(np.maximum(variance - seen * sensed, 0.0) / driven)
    most = predictor.expected / np.sqrt(1.0 - _kept(predictor, correlation))
    return RowNoise(np.minimum(volts, most), np.sqrt(sensed), correlation)


def position_floor(lengths: Floats, spread: Spread) -> Floats:
    """(J,) root mean square error [rad or m] that noise alone makes in windows, NaN without any.

    lengths (w,) : rows of the windows, which begin at an observer's state that the noise makes uncertain.
    """
    if not len(lengths):
        return np.full(spread(1).shape[1], np.nan)
    return np.sqrt(np.cumsum(spread(int(lengths.max())), axis=0)[lengths - 1].sum(axis=0) / lengths.sum())


def variance_of_innovations(predictor: Predictor, noise: Weighting, rows: int) -> Floats:
    """(rows, J) variance [rad^2 or m^2] of a true model's positions by the rows since its last correction, where a
    weighting makes its innovations white."""
    columns = []
    # finer than any source of noise is narrow
    finest = max(2 * (FITTING.spectrum_points - 1), 2 * noise.filters.shape[1], 4 * rows)
    size = fft.next_fast_len(finest, real=True)
    for (F, _, gain), taps, scale in zip(predictor.linear, noise.filters, noise.scale):
        r = fft.irfft((scale / np.abs(folded_response(taps, size))) ** 2, size)[:rows]
        g = np.array([1.0, *_powers(F, gain, rows - 1)])
        before = np.convolve(g, np.concatenate([[0.0], r[1:]]))[:rows]
        columns.append(np.cumsum(2.0 * g * before + g**2 * r[0]))
    return np.column_stack(columns)


def _powers(F: Floats, gain: Floats, rows: int) -> Iterator[float]:
    x = gain
    for _ in range(rows):
        x = F @ x
        yield x[0]


def variance_of_rows(predictor: Predictor, noise: RowNoise, rows: int) -> Floats:
    """(rows, J) variance [rad^2 or m^2] of a true model's positions by the rows since its last correction."""
    return np.column_stack([np.fromiter(each, float, rows) for each in _variances(predictor, noise, rows)])


def _variances(predictor: Predictor, noise: RowNoise, rows: int) -> Iterator[Iterator[float]]:
    rho = _kept(predictor, noise.correlation)
    for (F, G, gain), volts, position in zip(predictor.linear, noise.volts, noise.position):
        # the state of the joint, and the voltage that is there until the next row
        A = np.block([[F, G[:, None]], [np.zeros((1, len(F))), np.full((1, 1), rho)]])
        driven = np.zeros_like(A)
        driven[-1, -1] = (1.0 - rho**2) * volts**2
        corrected = np.append(gain, 0.0)
        kept = np.eye(len(A))
        kept[:, 0] -= corrected
        seen = position**2 * np.outer(corrected, corrected)
        P = kept @ stationary_covariance(A @ kept, A @ seen @ A.T + driven) @ kept.T + seen
        yield _grown(A, driven, P, position**2, rows)


def _grown(A: Floats, driven: Floats, P: Floats, sensed: float, rows: int) -> Iterator[float]:
    for _ in range(rows):
        P = A @ P @ A.T + driven
        yield P[0, 0] + sensed


def _kept(predictor: Predictor, correlation: float) -> float:
    """Share of a voltage that is left of it in the next row."""
    return float(np.exp(-predictor.step / correlation)) if correlation > 0.0 else 0.0


def stationary_covariance(A: Floats, Q: Floats) -> Floats:
    """P = A P A' + Q of a stable A, by doubling (Smith 1968, SIAM J. Appl. Math. 16:198): a log
    without noise makes the linear equations for P too ill-conditioned to be solved."""
    while np.abs(A).max() > 1e-12:
        A, Q = A @ A, Q + A @ Q @ A.T
    return Q
