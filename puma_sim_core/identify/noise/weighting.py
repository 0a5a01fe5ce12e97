# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Causal filters that whiten the innovations of logs."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter, oaconvolve

from puma_sim_core.identify.arrays import Floats, log_rows
from puma_sim_core.identify.settings import NOISE


@dataclass(frozen=True)
class Weighting:
    """Filters (J, taps) that whiten innovations, what they are scaled by (J,), and the rows of each log: no filter
    reaches from one into the next."""

    filters: Floats
    scale: Floats
    lengths: tuple[int, ...]

    def __call__(self, values: Floats) -> Floats:
        """(n, J, ...) innovations or their derivatives, white and of variance 1."""
        out = np.empty_like(values)
        for j in range(values.shape[1]):
            for rows in log_rows(self.lengths):
                out[rows, j] = _filtered(self.filters[j], values[rows, j]) / self.scale[j]
        return out


def _filtered(taps: Floats, values: Floats) -> Floats:
    if len(taps) <= NOISE.whitening_direct:
        filtered: Floats = lfilter(taps, [1.0], values, axis=0)
    else:
        filtered = oaconvolve(values, taps.reshape(-1, *[1] * (values.ndim - 1)), axes=0)[: len(values)]
    return filtered
