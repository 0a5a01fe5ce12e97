# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Types of arrays, and the rows of logs that stand below each other."""

from collections.abc import Iterable
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int_]
Complexes = NDArray[np.complex128]


def runs(inside: NDArray[np.generic]) -> list[tuple[int, int]]:
    """(first, one past the last) row of each run of rows (n,) that are true."""
    change = np.flatnonzero(np.diff(np.r_[0, inside.astype(int), 0])).tolist()
    return list(zip(change[::2], change[1::2]))


def log_rows(lengths: Iterable[int]) -> list[slice]:
    """The rows of each of several logs."""
    return [slice(a, b) for a, b in pairwise(accumulate(lengths, initial=0))]


def rows_of_segments(segment: Ints) -> list[slice]:
    """The rows of each log, by the number of its log for each row (n,)."""
    starts = np.flatnonzero(np.diff(segment, prepend=-1)).tolist()
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(segment)])]
