# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Drives that are switched off for some rows: no current flows, and the joint swings freely."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.dynamics.types import Drive
from puma_sim_core.errors import ParameterError


def enabled(enable: ArrayLike, rows: int, axes: Sequence[int]) -> np.ndarray:
    """(n, 3) whether the drives of the kernel's joints are on.

    enable : (n,) for all joints or (n, J), on where it is not 0; joints that are not among the `axes` are on.

    Raises ParameterError: another shape, or values that are not finite.
    """
    values, joints = np.asarray(enable, dtype=float), len(axes)
    if values.shape == (rows,):
        values = np.repeat(values[:, None], joints, axis=1)
    if values.shape != (rows, joints) or not np.isfinite(values).all():
        raise ParameterError(f"enable of shape {values.shape}", expected=f"({rows},) or ({rows}, {joints}), finite")
    on = np.ones((rows, 3), dtype=bool)
    on[:, axes] = values != 0.0
    return on


def stretches(on: np.ndarray) -> Iterator[tuple[int, int]]:
    """(first row, row after the last) of the stretches in which nothing is switched."""
    edges = np.flatnonzero((on[1:] != on[:-1]).any(axis=1)) + 1
    bounds = [0, *edges.tolist(), len(on)]
    return itertools.pairwise(bounds)


def opened(drive: Drive, on: np.ndarray) -> Drive:
    """The constants of the drives with those that are off cut from their joints: neither torque nor back-EMF."""
    off = [f"{name}{j + 1}" for name in ("emf", "torque") for j in range(3) if not on[j]]
    return drive._replace(**dict.fromkeys(off, 0.0))
