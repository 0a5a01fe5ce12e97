# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A controller's transfer function with its denominator left free, as section 7.8 estimates it.

``u(k) = -a1 u(k-1) - a2 u(k-2) + q0 e(k) + q1 e(k-1) + q2 e(k-2)``. The voltages on the right are the recorded ones:
rounded to 12 bits they bring noise into the regressors, and least squares is biased. For a PID controller the bias of
a1 is small (below 1e-3), but the gains are differences of coefficients thirty times larger, and Ti is lost. Instruments
that are free of the rounding, the noise-free output of a first model, take the bias away (Young 2011, refined
instrumental variables), at the price of wider intervals; knowing the denominator (`identify_pid`) does better.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from puma_sim_core.checks import check_choice
from puma_sim_core.errors import ParameterError, RecordingError
from puma_sim_core.tuning.controller_log import ControllerLog
from puma_sim_core.tuning.least_squares import RecursiveLeastSquares, sandwich, weights
from puma_sim_core.tuning.pid_identification import Interval, check_excitation, identify_pid

METHODS = ("least squares", "instrumental variables")


class ImpliedGains(NamedTuple):
    """Kg [V/rad], Ti [s], Td [s] by arithmetic alone; they may be negative or make no sense."""

    gain: float
    integral_time: float
    derivative_time: float


def implied_gains(numerator: Iterable[float], period: float, *, as_printed: bool = False) -> ImpliedGains:
    """Gains that equations 7.5 to 7.7 imply for q0, q1, q2 [V/rad] and a period [s].

    Kg = q0 - q2, Td = q2 h / Kg, Ti = Kg h / (q0 + q1 + q2); as_printed: from 7.6 without its
    minus, Ti = Kg h / (q0 - q1 + q2).

    Raises ParameterError: q0 = q2, or a sum of zero, for which there is no such gain.
    """
    q0, q1, q2 = (float(q) for q in numerator)
    gain, total = q0 - q2, q0 + (-q1 if as_printed else q1) + q2
    if gain == 0.0 or total == 0.0:
        expected = "q0 other than q2, and a sum other than 0"
        raise ParameterError(f"q = ({q0:g}, {q1:g}, {q2:g})", where="PID coefficients", expected=expected)
    return ImpliedGains(gain, gain * period / total, q2 * period / gain)


@dataclass(frozen=True)
class TransferFunction:
    """(q0 + q1 z^-1 + q2 z^-2)/(1 + a1 z^-1 + a2 z^-2) from the error [rad] to the voltage [V].

    numerator (3,) and denominator (1 or 2, without its leading 1) as intervals; covariance of
    (a, q); residual : rms of one prediction [V]; period [s].
    """

    numerator: tuple[Interval, ...]
    denominator: tuple[Interval, ...]
    covariance: np.ndarray
    residual: float
    period: float
    method: str

    @property
    def coefficients(self) -> tuple[float, ...]:
        """(q0, q1, q2)."""
        return tuple(q.value for q in self.numerator)

    @property
    def poles(self) -> tuple[complex, ...]:
        """Poles in the z plane, greatest magnitude first; a PID controller has one, at 1."""
        return poles([a.value for a in self.denominator])


def poles(denominator: Sequence[float]) -> tuple[complex, ...]:
    """Roots of z^n + a1 z^(n-1) + ... , greatest magnitude first."""
    found = np.roots([1.0, *denominator])
    return tuple(complex(z) for z in sorted(found, key=lambda z: (-abs(z), -z.real, z.imag)))


def identify_transfer_function(
    log: ControllerLog,
    *,
    order: int = 2,
    method: str = "least squares",
    confidence: float = 0.95,
    forgetting: float = 1.0,
) -> TransferFunction:
    """Transfer function with a free denominator of the given order (1 or 2).

    Intervals allow for correlated errors, not for the bias of "least squares" where the voltage is
    rounded. Saturated samples are not left out: for those, `identify_pid`.

    Raises
    ------
    ParameterError : order, method, confidence or forgetting factor outside its range.
    RecordingError : the record does not determine the coefficients, or, with instruments, no PID
        explains it.
    """
    check_choice(order, "order", (1, 2))
    check_choice(method, "method", METHODS)
    if not 0.0 < confidence < 1.0:
        raise ParameterError(f"confidence {confidence!r}", expected="a number between 0 and 1")
    check_excitation(log)
    rows, values = _rows(log.error, log.voltage, order), log.voltage[3:]
    length = np.linalg.norm(rows, axis=0)
    rows = rows / length
    filter_ = RecursiveLeastSquares(rows.shape[1], forgetting)
    filter_.update(rows, values)
    if not filter_.determined:
        what = "no sufficient excitation for a free denominator"
        raise RecordingError(what, where=log.where, expected="a path of changing speed")
    weight = weights(len(values), filter_.forgetting)
    instruments, theta = rows, filter_.estimate
    if method == "instrumental variables":
        pid = identify_pid(log, derivative="error", forgetting=forgetting, bounds=False)
        means = pid.equations.means(pid.equations.voltage - pid.equations.rows[:, :3] @ pid.terms)
        clean = np.concatenate([[np.nan], pid.equations.rows @ np.concatenate([pid.terms, means])])
        instruments = _rows(log.error, clean, order) / length
        weighted = instruments * weight[:, None]
        theta = np.linalg.solve(weighted.T @ rows, weighted.T @ values)
    residuals = values - rows @ theta
    covariance = sandwich(rows, instruments, residuals, weight) / np.outer(length, length)
    theta = theta / length
    half = float(ndtri(0.5 + 0.5 * confidence)) * np.sqrt(np.diag(covariance))
    intervals = [Interval(float(t), float(t - w), float(t + w)) for t, w in zip(theta, half)]
    residual = float(np.sqrt(weight @ residuals**2 / weight.sum()))
    return TransferFunction(
        tuple(intervals[order:]), tuple(intervals[:order]), covariance, residual, log.period, method
    )


def _rows(error: np.ndarray, voltage: np.ndarray, order: int) -> np.ndarray:
    """Regressors from sample 3 on: the first whose voltages have a noise-free counterpart."""
    n = len(error)
    return np.column_stack(
        [*(-voltage[3 - lag : n - lag] for lag in range(1, order + 1)), *(error[3 - lag : n - lag] for lag in range(3))]
    )
