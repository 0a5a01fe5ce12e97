# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A linear system from its impulse responses (Ho and Kalman, Regelungstechnik 14 (1966): 545-548)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

#: block rows and columns of the Hankel matrix
BLOCKS = 60
#: samples of an impulse response that it takes
SAMPLES = 2 * BLOCKS + 1
#: singular values below this share of the greatest are rounding: outputs of 40 V have 1e-14 V of it, a pulse of
#: 1e-5 rad makes 0.01 V at least
_RANK = 1e-9


class LinearSystem(NamedTuple):
    """x(k+1) = A x + B u, y = C x + D u: A (n, n), B (n, m), C (p, n), D (p, m)."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray

    def response(self, inputs: np.ndarray) -> np.ndarray:
        """Outputs (n, p) to inputs (n, m), from rest."""
        x, out = np.zeros(len(self.A)), []
        for u in inputs:
            out.append(self.C @ x + self.D @ u)
            x = self.A @ x + self.B @ u
        return np.array(out)


def realised(impulse: np.ndarray) -> LinearSystem:
    """The system of least order with these impulse responses.

    impulse : (SAMPLES, p, m), output at sample k after a unit impulse of each input.
    """
    direct, rest = impulse[0], impulse[1:]
    _, p, m = impulse.shape
    place = np.arange(BLOCKS)[:, None] + np.arange(BLOCKS)
    first, shifted = (rest[place + lag].transpose(0, 2, 1, 3).reshape(BLOCKS * p, BLOCKS * m) for lag in (0, 1))
    left, values, right = np.linalg.svd(first)
    n = int((values > _RANK * values[0]).sum()) if values[0] > 0.0 else 0
    root = np.sqrt(values[:n])
    observed, reached = left[:, :n] * root, root[:, None] * right[:n]
    A = (left[:, :n] / root).T @ shifted @ (right[:n].T / root)
    return LinearSystem(A, reached[:, :m], observed[:p], direct)
