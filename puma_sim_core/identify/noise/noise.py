# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The noise of the residual: a few physical sources, each with its spectrum (step 3).

A noise model that may take any shape would take up an oscillation whole and call it noise. Here
the spectrum at each joint is a sum, with weights >= 0, of what sources of noise can make: white
voltage, positions rounded or noisy as they appear in volts, and disturbances that last 10, 40
or 160 ms. Weights are fitted to medians of the periodogram over bands, which a line in the
spectrum does not move, and none falls below the budget that quantisation gives.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.sampling import Sampled
from puma_sim_core.identify.settings import NOISE


@dataclass(frozen=True)
class Sources:
    """Spectra (k, f) [V^2/Hz] of unit sources at frequencies [Hz], past the second filter, and
    their autocovariances (k, n) at distances of 0 .. n - 1 kept rows."""

    frequency: np.ndarray
    spectra: np.ndarray
    covariances: np.ndarray


def sources(sampled: Sampled, stiffness: float, emf: float, lag: float, most: int) -> Sources:
    """The sources of one joint.

    stiffness : volts per acceleration, k (D + Ia) [V.s^2/rad]; emf [V.s/rad]; lag [s]; most : of
    kept rows that a covariance reaches across.
    """
    step = sampled.step
    n = 1 << int(np.ceil(np.log2(max(4096, 2 * most * sampled.every))))
    f = np.fft.rfftfreq(n, step)
    w = 2j * np.pi * f
    second = filters.response(f, sampled.cutoffs[1]) ** 2
    first = filters.response(f, sampled.cutoffs[0])
    to_volts = np.abs((stiffness * w**2 * (1.0 + lag * w) + emf * w) * first) ** 2
    one = np.full(len(f), 2.0 * step)
    parts = [one, one * to_volts]
    for time in NOISE.residual_lasting:
        parts.append(4.0 * time / (1.0 + (2.0 * np.pi * f * time) ** 2))
    spectra = np.array(parts) * second
    covariances = np.fft.irfft(spectra, n, axis=1) * (0.5 / step)
    return Sources(f, spectra, covariances[:, : most * sampled.every : sampled.every])


def fit_weights(
    source: Sources,
    sampled: Sampled,
    residual: np.ndarray,
    usable: np.ndarray,
    stretches,
    budget: np.ndarray,
    white_only: bool = False,
) -> np.ndarray:
    """Weights (k,) of the sources for a residual at the kept rows.

    residual (m,) [V]; usable (m,): rows that count; stretches: slices of kept rows that are
    continuous; budget (k,): least weights; white_only: from the upper half of the band, where a
    missing effect shows least, and without disturbances that last.
    """
    step = sampled.step * sampled.every
    bands = []
    for rows in stretches:
        y, good = residual[rows], usable[rows]
        n = len(y)
        if good.sum() < 32:
            continue
        y = np.where(good, y, 0.0)
        taper = np.hanning(n) * good
        power = np.abs(np.fft.rfft(y * taper)) ** 2 * 2.0 * step / (taper**2).sum()
        bands.append((np.fft.rfftfreq(n, step), power))
    edges = [0.0]
    top = min(1.15 * sampled.cutoffs[1], 0.45 / step)
    lines = np.concatenate([f for f, _ in bands]) if bands else np.zeros(0)
    while edges[-1] < top:
        width = NOISE.residual_band
        while ((lines > edges[-1]) & (lines <= edges[-1] + width)).sum() < NOISE.residual_least_lines and edges[
            -1
        ] + width < top:
            width += NOISE.residual_band
        edges.append(edges[-1] + width)
    measured, design = [], []
    for low, high in itertools.pairwise(edges):
        inside = np.concatenate([p[(f > low) & (f <= high)] for f, p in bands]) if bands else np.zeros(0)
        if len(inside) < NOISE.residual_least_lines // 2:
            continue
        measured.append(np.median(inside) / np.log(2.0))
        grid = (source.frequency > low) & (source.frequency <= high)
        design.append(source.spectra[:, grid].mean(axis=1))
    if len(measured) < 3:
        return np.maximum(budget, 0.0)
    measured, design = np.array(measured), np.array(design)
    if white_only:
        half = len(measured) // 2
        measured, design = measured[half:], design[half:] * (np.arange(len(budget)) < 2)
    rest = np.maximum(measured - design @ budget, 0.0)
    model = np.maximum(measured, 1e-30)
    weights = budget
    for _ in range(12):
        # Whittle's likelihood as least squares relative to the spectrum
        found, _ = nnls(design / model[:, None], rest / model)
        weights = budget + found
        model = 0.5 * model + 0.5 * np.maximum(design @ weights, 1e-30)
    return weights


class Whitener:
    """Makes the kept rows of one joint independent and of variance 1: W r.

    rows : (m,) numbers of kept rows that count; place: (m,) their distance in kept rows from the
    start of their stretch; stretch (m,).
    """

    def __init__(self, covariance: np.ndarray, rows, place, stretch):
        self.rows = rows
        self._blocks = []
        start = 0
        covariance = covariance.copy()
        covariance[0] *= 1.0 + NOISE.residual_jitter
        while start < len(rows):
            stop = start
            while stop < len(rows) and stretch[stop] == stretch[start] and stop - start < NOISE.residual_block:
                stop += 1
            at = place[start:stop]
            C = covariance[np.abs(at[:, None] - at[None, :])]
            L = cholesky(C, lower=True)
            self._blocks.append((start, stop, L))
            start = stop
        self.log_determinant = 2.0 * sum(float(np.log(np.diag(L)).sum()) for _, _, L in self._blocks)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Whitened rows (m, ...) of an array over all kept rows."""
        out = np.empty((len(self.rows), *values.shape[1:]))
        for start, stop, L in self._blocks:
            out[start:stop] = solve_triangular(L, values[self.rows[start:stop]], lower=True, check_finite=False)
        return out


def least_weights(sampled: Sampled, joint: int, number: int) -> np.ndarray:
    """Budget (k,): what white noise [V] and rounding leave at least."""
    budget = np.zeros(number)
    budget[0] = NOISE.residual_least**2
    budget[1] = max(sampled.position_noise[joint], 0.0) ** 2
    return budget
