# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Causal filters that whiten the innovations of logs."""

from dataclasses import dataclass, field

import numpy as np
from scipy import fft
from scipy.ndimage import convolve1d

from puma_sim_core.identify.arrays import Complexes, Floats, log_rows
from puma_sim_core.identify.settings import NOISE


@dataclass(frozen=True)
class Weighting:
    """Filters (J, taps) that whiten innovations, what they are scaled by (J,), and the rows of each log: no filter
    reaches from one into the next, nor from the first `settling` rows of a log, where the predictor settles, on."""

    filters: Floats
    scale: Floats
    lengths: tuple[int, ...]
    settling: int = 0
    _transforms: dict[int, Complexes] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __call__(self, values: Floats) -> Floats:
        """(n, J, ...) innovations or their derivatives, white and of variance 1."""
        out = np.empty_like(values)
        for j in range(values.shape[1]):
            for rows in log_rows(self.lengths):
                settled = values[rows, j].copy()
                settled[: self.settling] = 0.0
                out[rows, j] = self._filtered(j, settled) / self.scale[j]
        return out

    def _filtered(self, j: int, values: Floats) -> Floats:
        taps = self.filters[j]
        if len(taps) <= NOISE.whitening_direct:
            filtered: Floats = convolve1d(values, taps, axis=0, mode="constant", origin=-(len(taps) // 2))
            return filtered
        # transforms of rows that stand together in memory take half the time
        columns = np.ascontiguousarray(np.moveaxis(values, 0, -1))
        size = fft.next_fast_len(len(values) + len(taps) - 1, real=True)
        filtered = fft.irfft(fft.rfft(columns, size) * self._responses(size)[j], size)[..., : len(values)]
        return np.moveaxis(filtered, -1, 0)

    def _responses(self, size: int) -> Complexes:
        """(J, size / 2 + 1) transforms of the filters: many innovations are filtered by the same ones."""
        if size not in self._transforms:
            self._transforms[size] = fft.rfft(self.filters, size)
        return self._transforms[size]


def folded_response(taps: Floats, size: int) -> Complexes:
    """(size / 2 + 1,) response of a filter at the frequencies of a transform of `size` rows."""
    folded = np.zeros(-(-len(taps) // size) * size)
    folded[: len(taps)] = taps
    return np.fft.rfft(folded.reshape(-1, size).sum(axis=0))
