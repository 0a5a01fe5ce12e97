# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Types of arrays, the rows of logs that stand below each other, and Cholesky factors of small matrices."""

from collections.abc import Iterable
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

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


def cholesky(matrix: Floats) -> Floats:
    """(p, p) lower factor of a positive definite matrix, for `solved`; what stands above its diagonal is no part of it.

    LAPACK without the checks of `scipy.linalg`: on a matrix of some rows these take ten times as long as the factor.
    Raises LinAlgError where the matrix is not positive definite.
    """
    factor, info = lapack.dpotrf(matrix, lower=1, clean=0)
    if info:
        raise np.linalg.LinAlgError(f"row {info} of a matrix of {len(matrix)} rows is not positive definite")
    return factor  # type: ignore[no-any-return]


def solved(factor: Floats, right: Floats) -> Floats:
    """x (p,) or (p, r) of A x = right, by the factor of A."""
    found, _ = lapack.dpotrs(factor, right, lower=1)
    return found  # type: ignore[no-any-return]
