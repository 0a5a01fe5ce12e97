# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Evidence of linear models in noise that nobody knows: coefficients and noise are integrated out.

With the rows y = X b + e, the prior b ~ N(0, S^2), S diagonal, and noise e ~ N(0, s^2 C_g),

    p(y) = sum over g, s of p(g, s) N(y; 0, s^2 C_g + X S^2 X').

C_g is white noise and a disturbance of one correlation time (an Ornstein-Uhlenbeck process), as the filter passes them
on; g runs over shares and times, s over standard deviations, all alike probable. So each model has the noise that suits
it best, and what a model leaves counts as noise only in that model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft
from scipy.special import logsumexp

from puma_sim_core.identify.arrays import Floats, Ints
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.link_side.sides import Sides
from puma_sim_core.identify.noise.residual import Whitener
from puma_sim_core.identify.settings import LINK_SIDE, NOISE


@dataclass(frozen=True)
class Posterior:
    """log_evidence [nat]; mean (k,), covariance (k, k) of the coefficients; noise : number of the most probable one;
    deviation : and its standard deviation."""

    log_evidence: float
    mean: Floats
    covariance: Floats
    noise: int
    deviation: float


class NoiseGrid:
    """The noises that rows of logs may have."""

    def __init__(self, sides: Sides):
        self.sides = sides
        self.covariances = list(_covariances(sides))

    @cached_property
    def whiteners(self) -> list[Whitener]:
        """That of all rows for each noise."""
        return [self.whitener(n, np.arange(len(self.sides.time))) for n in range(len(self.covariances))]

    def whitener(self, noise: int, rows: Ints) -> Whitener:
        """That of some rows for one noise."""
        s = self.sides
        return Whitener(self.covariances[noise], rows, s.place[rows], s.segment[rows])

    def deviations(self, y: Floats, least: float) -> Floats:
        """(d,) standard deviations of the noise that come into question for rows y; least : that of the resolution."""
        most = 2.0 * float(np.std(y)) + least
        low = max(least, LINK_SIDE.least_deviation * most)
        count = int(np.ceil(np.log(most / low) / np.log(LINK_SIDE.deviation_ratio))) + 2
        steps: Floats = np.arange(count, dtype=float)
        return low * LINK_SIDE.deviation_ratio**steps

    def posteriors(self, Y: Floats, X: Floats, prior: Floats, deviations: Floats) -> list[Posterior]:
        """The posterior of coefficients (k,) of columns X (m, k), by each of several series of rows Y (m, q).

        prior (k,) : deviations of the coefficients; deviations (d,) : those that the noise may have, as `deviations`.
        """
        m, q = Y.shape
        s2 = deviations**2
        logs = np.empty((q, len(self.whiteners), len(s2)))
        found = []
        for g, whitener in enumerate(self.whiteners):
            white = whitener(np.column_stack([Y, X]))
            A, V = white[:, q:] * prior, white[:, :q]
            values, vectors = np.linalg.eigh(A.T @ A)
            values = np.maximum(values, 0.0)
            u = vectors.T @ (A.T @ V)  # (k, q)
            found.append((values, vectors, u))
            squares = (V**2).sum(axis=0)[:, None] / s2  # (q, d)
            spread = s2 + values[:, None]  # (k, d)
            explained = np.einsum("kq,kd->qd", u**2, 1.0 / spread) / s2
            width = np.log(spread / s2).sum(axis=0) + m * np.log(2.0 * np.pi * s2)
            logs[:, g] = 0.5 * (explained - squares - width) - whitener.log_determinant
        return [self._mixed(logs[n], [(a, b, u[:, n]) for a, b, u in found], prior, s2) for n in range(q)]

    @staticmethod
    def _mixed(logs: Floats, found: list[tuple[Floats, Floats, Floats]], prior: Floats, s2: Floats) -> Posterior:
        """The posterior over all noises; logs (g, d) of their evidence."""
        total = float(logsumexp(logs))
        weights = np.exp(logs - total)
        mean, second = np.zeros(len(prior)), np.zeros((len(prior), len(prior)))
        counted = weights > 1e-6
        weights /= weights[counted].sum()
        for g, d in np.argwhere(counted).tolist():
            values, vectors, u = found[g]
            own = prior * (vectors @ (u / (s2[d] + values)))
            spread = prior[:, None] * (vectors * (s2[d] / (s2[d] + values))) @ vectors.T * prior
            mean += weights[g, d] * own
            second += weights[g, d] * (spread + np.outer(own, own))
        best, at = (int(n) for n in np.unravel_index(int(np.argmax(logs)), logs.shape))
        covariance = second - np.outer(mean, mean)
        return Posterior(total - float(np.log(logs.size)), mean, covariance, best, float(np.sqrt(s2[at])))


def _covariances(sides: Sides) -> Iterator[Floats]:
    """Of each noise, by the distance in kept rows: of variance 1."""
    longest = max(LINK_SIDE.lasting)
    # of a block of rows between which others are left out, too
    most = min(int(sides.place.max()) + 1, 2 * NOISE.residual_block)
    rows = max(2 * most * sides.every, int(20.0 * longest / sides.step))
    n = 1 << int(np.ceil(np.log2(rows)))
    f = fft.rfftfreq(n, sides.step)
    passed = filters.response(f, sides.cutoff) ** 2

    def covariance(spectrum: Floats) -> Floats:
        found = np.fft.irfft(spectrum * passed, n)[: most * sides.every : sides.every]
        return found / found[0]

    white = covariance(np.ones(len(f)))
    yield white
    for time in LINK_SIDE.lasting:
        lasting = covariance(1.0 / (1.0 + (2.0 * np.pi * f * time) ** 2))
        for share in LINK_SIDE.white:
            yield share * white + (1.0 - share) * lasting
