# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The noise of the residual of filtered motion: a few physical sources, each with its spectrum.

A noise model of any shape would take an oscillation for noise. Here the spectrum at each joint is a sum, with weights
>= 0, of what sources of noise can make: white voltage, positions rounded or noisy as they appear in volts, and
disturbances with correlation times of 10, 40 or 160 ms. Weights are fitted to medians of the periodogram over bands,
which a spectral line does not move, and none is below that of quantisation.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from puma_sim_core.identify.arrays import Bools, Floats, Ints, rows_of_segments
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.sampling import Sampled
from puma_sim_core.identify.settings import NOISE


@dataclass(frozen=True)
class Sources:
    """Spectra (k, f) [V^2/Hz] of unit sources at frequencies [Hz], past the second filter, and
    their autocovariances (k, n) at distances of 0 .. n - 1 kept rows."""

    frequency: Floats
    spectra: Floats
    covariances: Floats


def sources(sampled: Sampled, stiffness: float, emf: float, lag: float, most: int) -> Sources:
    """The sources of one joint.

    stiffness : volts per acceleration, k (D + Ia) [V.s^2/rad]; emf [V.s/rad]; lag [s]; most : kept rows that a
    covariance reaches across.
    """
    step = sampled.step
    n = 1 << int(np.ceil(np.log2(max(4096, 2 * most * sampled.every))))
    f = fft.rfftfreq(n, step)
    w = 2j * np.pi * f
    second = filters.response(f, sampled.cutoffs[1]) ** 2
    first = filters.response(f, sampled.cutoffs[0])
    to_volts = np.abs((stiffness * w**2 * (1.0 + lag * w) + emf * w) * first) ** 2
    one = np.full(len(f), 2.0 * step)
    parts = [one, one * to_volts]
    parts += [4.0 * time / (1.0 + (2.0 * np.pi * f * time) ** 2) for time in NOISE.residual_lasting]
    spectra = np.array(parts) * second
    covariances = np.fft.irfft(spectra, n, axis=1) * (0.5 / step)
    return Sources(f, spectra, covariances[:, : most * sampled.every : sampled.every])


def fit_weights(
    source: Sources,
    sampled: Sampled,
    residual: Floats,
    usable: Bools,
    stretches: Sequence[slice],
    budget: Floats,
    white_only: bool = False,
) -> Floats:
    """Weights (k,) of the sources for a residual at the kept rows.

    residual (m,) [V]; usable (m,) : rows that count; stretches : kept rows of each log; budget (k,) : least weights;
    white_only : from the upper half of the band, where a missing effect shows least, and without disturbances that
    last.
    """
    frequency, power = _periodogram(residual, usable, stretches, sampled.step * sampled.every)
    measured, design = [], []
    for low, high in itertools.pairwise(_edges(frequency, sampled)):
        inside = power[(frequency > low) & (frequency <= high)]
        if len(inside) >= NOISE.residual_least_lines // 2:
            # the median of the exponential distribution is log(2) of its mean
            measured.append(np.median(inside) / np.log(2.0))
            grid = (source.frequency > low) & (source.frequency <= high)
            design.append(source.spectra[:, grid].mean(axis=1))
    if len(measured) < NOISE.residual_least_bands:
        return np.maximum(budget, 0.0)
    y, X = np.array(measured), np.array(design)
    if white_only:
        half = len(y) // 2
        y, X = y[half:], X[half:] * (np.arange(len(budget)) < 2)
    rest = np.maximum(y - X @ budget, 0.0)
    model, weights = np.maximum(y, 1e-30), budget
    for _ in range(NOISE.rounds):
        # Whittle's likelihood as least squares relative to the spectrum
        weights = budget + nnls(X / model[:, None], rest / model)[0]
        model = 0.5 * model + 0.5 * np.maximum(X @ weights, 1e-30)
    return weights


def _periodogram(residual: Floats, usable: Bools, stretches: Sequence[slice], step: float) -> tuple[Floats, Floats]:
    """Frequencies [Hz] and power [V^2/Hz] of all logs."""
    found = [(np.zeros(0), np.zeros(0))]
    for rows in stretches:
        good = usable[rows]
        if good.sum() >= NOISE.residual_least_rows:
            taper = np.hanning(len(good)) * good
            y = np.where(good, residual[rows], 0.0)
            power = np.abs(np.fft.rfft(y * taper)) ** 2 * 2.0 * step / (taper**2).sum()
            found.append((fft.rfftfreq(len(good), step), power))
    frequency, power = (np.concatenate(parts) for parts in zip(*found))
    return frequency, power


def _edges(frequency: Floats, sampled: Sampled) -> list[float]:
    """Edges [Hz] of bands with lines enough for a median."""
    edges = [0.0]
    top = min(NOISE.residual_top * sampled.cutoffs[1], 0.45 / (sampled.step * sampled.every))
    while edges[-1] < top:
        low, width = edges[-1], NOISE.residual_band
        while low + width < top and ((frequency > low) & (frequency <= low + width)).sum() < NOISE.residual_least_lines:
            width += NOISE.residual_band
        edges.append(low + width)
    return edges


class Whitener:
    """Makes the kept rows of one joint independent and of variance 1: W r.

    rows : (m,) numbers of kept rows that count; place : (m,) their distance in kept rows from the start of their log;
    segment (m,) : number of the log.
    """

    def __init__(self, covariance: Floats, rows: Ints, place: Ints, segment: Ints):
        self.rows = rows
        covariance = covariance * np.where(np.arange(len(covariance)) == 0, 1.0 + NOISE.residual_jitter, 1.0)
        self._blocks = []
        factors: dict[bytes, Floats] = {}  # rows without a gap are alike, and so are their factors
        for log in rows_of_segments(segment):
            for start in range(log.start, log.stop, NOISE.residual_block):
                block = slice(start, min(start + NOISE.residual_block, log.stop))
                key = (place[block] - place[start]).tobytes()
                if key not in factors:
                    distance = np.abs(place[block, None] - place[None, block])
                    factors[key] = cholesky(covariance[distance], lower=True)
                self._blocks.append((block, factors[key]))

    @property
    def log_determinant(self) -> float:
        """Half the logarithm of the determinant of the covariance of all rows."""
        return sum(float(np.log(np.diagonal(factor)).sum()) for _, factor in self._blocks)

    def __call__(self, values: Floats) -> Floats:
        """Whitened rows (m, ...) of an array over all kept rows."""
        out = np.empty((len(self.rows), *values.shape[1:]))
        for block, factor in self._blocks:
            out[block] = solve_triangular(factor, values[self.rows[block]], lower=True, check_finite=False)
        return out


def least_weights(sampled: Sampled, joint: int, number: int) -> Floats:
    """Budget (k,): what white noise [V] and rounding leave at least."""
    budget = np.zeros(number)
    budget[0] = NOISE.residual_least**2
    budget[1] = max(sampled.position_noise[joint], 0.0) ** 2
    return budget
