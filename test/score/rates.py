# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Shares of a count with their 95 % intervals."""

from __future__ import annotations

from math import sqrt

from scipy.stats import beta

_NORMAL = 1.959963984540054


def wilson(right: int, count: int) -> tuple[float, float]:
    """Interval of a share (Wilson 1927, J. Am. Stat. Assoc. 22:209)."""
    if count == 0:
        return 0.0, 1.0
    share, z2 = right / count, _NORMAL**2
    middle = (share + z2 / (2 * count)) / (1.0 + z2 / count)
    half = _NORMAL / (1.0 + z2 / count) * sqrt(share * (1.0 - share) / count + z2 / (4.0 * count**2))
    return max(0.0, middle - half), min(1.0, middle + half)


def clopper_pearson(right: int, count: int) -> tuple[float, float]:
    """The exact, wider interval (Clopper and Pearson 1934, Biometrika 26:404)."""
    if count == 0:
        return 0.0, 1.0
    low = 0.0 if right == 0 else float(beta.ppf(0.025, right, count - right + 1))
    high = 1.0 if right == count else float(beta.ppf(0.975, right + 1, count - right))
    return low, high
