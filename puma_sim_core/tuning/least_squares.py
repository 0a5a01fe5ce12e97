# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Recursive least squares, and covariances of estimates whose errors are correlated in time.

Recursive least squares with exponential forgetting minimises, after sample n,
``sum_k lambda^(n-k) (y(k) - phi(k)' theta)^2`` (Ljung, System Identification, section 11.2). It is
kept here as the triangular factor of the weighted rows, not as a covariance matrix: there is no
starting guess to forget, and the result after any number of rows is that of one batch.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.checks import check_whole, is_number
from puma_sim_core.errors import ParameterError

#: columns whose smallest singular value, each scaled to length 1, is below this cannot be told
#: apart in double precision
SINGULAR = 1e-9


class RecursiveLeastSquares:
    """Estimate of theta (n,) in y = phi' theta, moved on by rows of phi and y.

    Parameters
    ----------
    size : n.
    forgetting : lambda, above 0 and at most 1; the weight of a sample falls by it at each newer
        one, so that about 1/(1 - lambda) samples count.

    Raises ParameterError: size below 1, or a forgetting factor outside its range.
    """

    def __init__(self, size: int, forgetting: float = 1.0):
        self.forgetting = check_forgetting(forgetting)
        self.size = check_whole(size, "size", 1, where="least squares")
        self.samples = 0
        self._factor: Any = np.zeros((0, size + 1))

    def update(self, rows: ArrayLike, values: ArrayLike) -> None:
        """Take one row (n,) and its value, or m rows (m, n) and values (m,), oldest first.

        Raises ParameterError: shapes that do not fit, numbers that are not finite.
        """
        rows = np.atleast_2d(np.asarray(rows, dtype=float))
        values = np.atleast_1d(np.asarray(values, dtype=float))
        if rows.shape != (len(values), self.size) or values.ndim != 1:
            what = f"rows {rows.shape} and values {values.shape}"
            raise ParameterError(what, where="least squares", expected=f"(m, {self.size}) and (m,)")
        if not (np.isfinite(rows).all() and np.isfinite(values).all()):
            raise ParameterError("a row or value that is not finite", where="least squares", expected="finite numbers")
        m = len(values)
        weight = np.sqrt(weights(m, self.forgetting))[:, None]
        aged = np.sqrt(self.forgetting**m) * self._factor
        self._factor = np.linalg.qr(np.vstack([aged, weight * np.column_stack([rows, values])]), mode="r")
        self.samples += m

    @property
    def determined(self) -> bool:
        """Whether the rows so far determine every parameter."""
        triangle = self._factor[:, : self.size]
        length = np.linalg.norm(triangle, axis=0)
        if len(triangle) < self.size or not (length > 0.0).all():
            return False
        return float(np.linalg.svd(triangle / length, compute_uv=False)[-1]) > SINGULAR

    @property
    def estimate(self) -> np.ndarray:
        """(n,) theta; raises ParameterError while the rows do not determine it."""
        if not self.determined:
            what = f"{self.samples} rows do not determine {self.size} parameters"
            raise ParameterError(what, where="least squares", expected="rows that differ enough")
        triangle = self._factor[: self.size, : self.size]
        return np.linalg.solve(triangle, self._factor[: self.size, self.size])

    @property
    def information(self) -> np.ndarray:
        """(n, n) sum of lambda^(n-k) phi phi'."""
        triangle = self._factor[:, : self.size]
        return triangle.T @ triangle


def check_forgetting(value: float) -> float:
    """The forgetting factor, or a ParameterError."""
    if not is_number(value) or not 0.0 < value <= 1.0:
        raise ParameterError(f"forgetting factor {value!r}", expected="a number above 0 and at most 1")
    return float(value)


def weights(samples: int, forgetting: float) -> np.ndarray:
    """(samples,) weights lambda^(n-k), the newest last with weight 1."""
    return forgetting ** np.arange(samples - 1, -1, -1.0)


def sandwich(rows: np.ndarray, instruments: np.ndarray, residuals: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n, n) covariance of an estimate where residuals are correlated and of unequal size.

    rows, instruments (m, n): the same for least squares; residuals, weight (m,). Newey and West
    (1987) with Bartlett weights, as many lags as Andrews (1991) asks for and at least m^(1/3):
    the rounding errors of a slow voltage stay alike for several samples, so that the usual
    sigma^2 (X'X)^-1 gives intervals that do not hold.
    """
    scores = instruments * (weight * residuals)[:, None]
    meat = scores.T @ scores
    lags = _lags(scores)
    for lag in range(1, lags + 1):
        cross = scores[lag:].T @ scores[:-lag]
        meat += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    bread = np.linalg.inv((instruments * weight[:, None]).T @ rows)
    m, n = rows.shape
    return bread @ meat @ bread.T * (m / max(m - n, 1))


def _lags(scores: np.ndarray) -> int:
    """Lags for Bartlett weights from a first-order autoregression of each score."""
    m = len(scores)
    power = (scores[:-1] ** 2).sum(axis=0)
    rho = np.divide((scores[1:] * scores[:-1]).sum(axis=0), power, out=np.zeros_like(power), where=power > 0.0)
    rho = np.clip(np.abs(rho), 0.0, 0.97).max()
    alpha = 4.0 * rho**2 / (1.0 - rho**2) ** 2
    return int(min(max(m ** (1.0 / 3.0), 1.1447 * (alpha * m) ** (1.0 / 3.0)), m // 4))
