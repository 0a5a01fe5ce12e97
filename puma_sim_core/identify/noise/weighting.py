# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Causal filters that make the innovations of logs white."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter, oaconvolve

from puma_sim_core.identify.settings import NOISE


@dataclass(frozen=True)
class Weighting:
    """Filters (J, taps) that make innovations white, what they are scaled by (J,), and the rows of
    each log: no filter reaches from one into the next."""

    filters: np.ndarray
    scale: np.ndarray
    lengths: tuple[int, ...]

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """(n, J, ...) innovations or their derivatives, white and of variance 1."""
        out = np.empty_like(values)
        for j in range(values.shape[1]):
            start = 0
            for n in self.lengths:
                rows = slice(start, start + n)
                out[rows, j] = self._filtered(self.filters[j], values[rows, j]) / self.scale[j]
                start += n
        return out

    @staticmethod
    def _filtered(taps, values):
        if len(taps) <= NOISE.whitening_direct:
            return lfilter(taps, [1.0], values, axis=0)
        taps = taps.reshape(-1, *[1] * (values.ndim - 1))
        return oaconvolve(values, taps, axes=0)[: len(values)]
