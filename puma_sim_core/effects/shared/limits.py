# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Grids of limits that a log exceeds, and what lies beyond a limit."""

from __future__ import annotations

import numpy as np

#: shares of the samples that lie beyond a limit, for the grids of limits
_BEYOND = (0.003, 0.008, 0.016, 0.03, 0.055, 0.09, 0.14, 0.2, 0.28, 0.38, 0.5)
#: how far the coefficient of an effect without one may come out from 1.00
SHARP = 0.05


def beyond(values: np.ndarray, limit: float) -> np.ndarray:
    """The part of `values` that exceeds a limit in magnitude."""
    return values - np.clip(values, -limit, limit)


def limits_of(values: np.ndarray) -> list[tuple[float, float]]:
    """Limits that the magnitude of `values` exceeds for a while, each with the reach of its
    neighbours: a second column moves the limit within it."""
    magnitude = np.abs(values)
    levels = np.quantile(magnitude, 1.0 - np.asarray(_BEYOND))
    # a signal that is itself clipped ends in a level that it never exceeds
    levels = np.unique(levels[levels < 0.999 * magnitude.max()])
    if levels.size == 0 or levels[-1] <= 0.0:
        return []
    edges = np.concatenate([[levels[0]], levels, [magnitude.max()]])
    return [
        (float(level), float(max(0.3 * (edges[n + 2] - edges[n]), 1e-3 * level)))
        for n, level in enumerate(levels)
        if level > 0.0
    ]
