# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""PID gains from a controller's own input and output (section 7.8).

The denominator of a PID controller is known: 1 - z^-1. Summed up once, its law is linear in the gains and in a constant
c, the sum at the record's start: ``u(k) = p e(k) + s sum_{1..k} e + d (w(k) - w(k-1)) + c``, w the error or less the
measurement. The inputs are the very numbers that the controller read, so that the rounding of the voltage is the only
error, and least squares is unbiased (unlike `transfer_function`). While the voltage is at its limit the law does not
hold; each stretch between two such has a constant of its own.
"""

from dataclasses import dataclass, field
from math import inf, sqrt

import numpy as np
from scipy.special import chdtrc, ndtri

from puma_sim_core.checks import check_choice, check_positive
from puma_sim_core.errors import ParameterError, RecordingError
from puma_sim_core.servo.pid import FORMS
from puma_sim_core.tuning.bounded_error import Enclosure, joint_rows
from puma_sim_core.tuning.controller_log import ControllerLog, lattice_step
from puma_sim_core.tuning.least_squares import SINGULAR, RecursiveLeastSquares, sandwich, weights

DERIVATIVES = ("auto", "error", "measurement")
#: fewer samples than this between two saturated ones are left out
_SHORTEST = 8
_MOST_STRETCHES = 200
#: the linear programmes grow with each stretch's constant
_MOST_ENCLOSED = 6
#: where the best PID leaves more than this share of the voltage's variance, it explains nothing
_UNEXPLAINED = 0.5


@dataclass(frozen=True)
class Interval:
    """A value and the ends of its interval; an end may be infinite."""

    value: float
    low: float
    high: float

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


@dataclass(frozen=True)
class Equations:
    """The linear equations of a record: rows (m, 3 + stretches), voltage (m,) [V].

    The first three columns belong to p, s and d, each centred in its stretch.
    """

    rows: np.ndarray
    voltage: np.ndarray

    def means(self, values: np.ndarray) -> np.ndarray:
        """Means of values (m,) over the stretches."""
        constants = self.rows[:, 3:]
        return constants.T @ values / constants.sum(axis=0)


@dataclass(frozen=True)
class PidEstimate:
    """What a record says of its controller.

    Attributes
    ----------
    gain, integral_time, derivative_time : Kg [V/rad], Ti [s], Td [s]. Where rounding of the voltage is the only error
        the intervals are certain (all that is within rounding of every sample) and the values their middles; else both
        are those of least_squares. Ti is inf where no integral action is seen, its lower end still holds.
    rounding_only : whether they are certain: some PID controller is within half a step of every sample.
    least_squares : the same three by least squares, with confidence intervals that allow for errors correlated in time.
        Under rounding alone, without dither, they cover less often than they say (88 % in place of 95 % for a motion
        of 20 counts).
    coefficients : least squares (q0, q1, q2) [V/rad] of (q0 + q1 z^-1 + q2 z^-2)/(1 - z^-1), from the error to u, and
        coefficient_intervals. With the derivative of the measurement it is the path from less the measurement; that
        from the setpoint is then (q0 - q2 + (q1 + 2 q2) z^-1)/(1 - z^-1).
    derivative : "error" or "measurement", "either" where the setpoint does not move.
    form : "positional" or "velocity", how Kg, Ti, Td follow from the same coefficients (see `pid`).
    period [s]; confidence; samples used; saturated : samples left out;
    other_residual : rms [V] with the other kind of derivative, None for "either";
    voltage_step, position_step : [V], [rad], 0 where there is none;
    terms, covariance : (3,) p, s, d [V/rad] and their (3, 3) covariance; residual : rms [V].
    """

    gain: Interval
    integral_time: Interval
    derivative_time: Interval
    rounding_only: bool
    least_squares: tuple[Interval, Interval, Interval]
    coefficients: tuple[float, float, float]
    coefficient_intervals: tuple[Interval, Interval, Interval]
    derivative: str
    form: str
    period: float
    confidence: float
    samples: int
    saturated: int
    other_residual: float | None
    voltage_step: float
    position_step: float
    where: str
    terms: np.ndarray
    covariance: np.ndarray
    residual: float
    equations: Equations = field(repr=False)


def identify_pid(
    log: ControllerLog,
    *,
    form: str = "positional",
    derivative: str = "auto",
    confidence: float = 0.95,
    forgetting: float = 1.0,
    limit: float = inf,
    bounds: bool = True,
) -> PidEstimate:
    """PID gains of a record, with intervals.

    Parameters
    ----------
    log : at least 16 samples; 4096 as in section 7.1.2 are plenty.
    form : "positional", the sum includes the present error (as `Pid` and the servo have it), or "velocity", it ends
        one sample before (equations 7.5 to 7.7).
    derivative : of the "error", of the "measurement", or "auto": whichever leaves less.
    confidence : of each interval, between 0 and 1.
    forgetting : factor of the recursion; below 1 the record's end counts most, and nothing is certain.
    limit : magnitude [V] at which the voltage saturates; such samples are left out.
    bounds : whether to look for certain intervals, which takes most of the time.

    Raises
    ------
    ParameterError : an option outside its range.
    RecordingError : the record does not determine the gains: error or voltage at rest, an error
        that does not tell the three actions apart, voltages that no PID explains.
    """
    check_choice(form, "form", FORMS)
    check_choice(derivative, "derivative", DERIVATIVES)
    if isinstance(confidence, bool) or not 0.0 < confidence < 1.0:
        raise ParameterError(f"confidence {confidence!r}", expected="a number between 0 and 1")
    check_positive(limit, "limit", "V", infinite=True)
    step = lattice_step(log.voltage[np.abs(log.voltage) < limit * (1.0 - 1e-9)])
    stretch = _stretches(log, limit, step)
    kinds = [derivative]
    if derivative == "auto":
        used = np.flatnonzero(stretch >= 0)
        moved = np.diff(log.setpoint)[used[used > 0] - 1].any()
        kinds = ["error", "measurement"] if moved else ["error"]
    fits = [_fit(log, kind, stretch, forgetting) for kind in kinds]
    best = min(range(len(fits)), key=lambda k: fits[k].residual)
    fit, kind = fits[best], kinds[best]
    if derivative == "auto" and len(kinds) == 1:
        kind = "either"
    constants, voltage = fit.equations.rows[:, 3:], fit.equations.voltage
    variance = float(np.mean((voltage - constants @ fit.equations.means(voltage)) ** 2))
    if fit.residual**2 > _UNEXPLAINED * variance:
        what = f"a PID leaves {fit.residual:.3g} V rms of the voltage's {sqrt(variance):.3g} V"
        expected = "the setpoint, position and voltage of one PID controller, of the same joint and sample"
        raise RecordingError(what, where=log.where, expected=expected)
    z = float(ndtri(0.5 + 0.5 * confidence))
    gain_of = np.array([1.0, 0.0 if form == "positional" else 1.0, 0.0])
    h = log.period
    gain = _linear(gain_of, fit, z)
    if not gain.low > 0.0:
        sign = "is negative" if gain.high < 0.0 else "is not determined"
        what = f"Kg {sign} ({gain.low:.4g} to {gain.high:.4g} V/rad at {confidence:g} confidence)"
        expected = "a record whose error moves, with setpoint, position and voltage in the controller's signs"
        raise RecordingError(what, where=log.where, expected=expected)
    _, integral, derive = np.eye(3)
    q_of = np.array([[1.0, 1.0, 1.0], [-1.0, 0.0, -2.0], [0.0, 0.0, 1.0]])
    q0, q1, q2 = (_linear(row, fit, z) for row in q_of)
    squares = (
        gain,
        _integral_time(_ratio(integral, gain_of, fit, z), h),
        _derivative_time(_ratio(derive, gain_of, fit, z), h),
    )
    certain = None
    if bounds and step > 0.0 and forgetting == 1.0 and stretch.max() < _MOST_ENCLOSED:
        certain = _enclosed(fit.equations, step, gain_of, h)
    return PidEstimate(
        *(certain or squares),
        rounding_only=certain is not None,
        least_squares=squares,
        coefficients=tuple(map(float, q_of @ fit.terms)),  # type: ignore[arg-type]
        coefficient_intervals=(q0, q1, q2),
        derivative=kind,
        form=form,
        period=h,
        confidence=float(confidence),
        samples=len(voltage),
        saturated=int((stretch < 0).sum()),
        other_residual=None if len(fits) == 1 else fits[1 - best].residual,
        voltage_step=step,
        position_step=lattice_step(log.position),
        where=log.where,
        **vars(fit),
    )


@dataclass(frozen=True)
class GainComparison:
    """Whether two records come from one controller.

    different : the finding. statistic, p_value : Wald's, chi-squared with 3 degrees of freedom.
    one_controller_possible : whether any one set of gains is within rounding of both; None where
    rounding is not the only error of both. Where it is known it decides, since it is certain;
    else `level` does, the chance of a false alarm.
    """

    different: bool
    statistic: float
    p_value: float
    level: float
    one_controller_possible: bool | None


def compare_gains(first: PidEstimate, second: PidEstimate, *, level: float = 0.01) -> GainComparison:
    """Test of equal gains in two records: gain scheduling, if they were taken at two poses.

    Raises ParameterError: estimates of other periods, forms or kinds of derivative, or a level outside (0, 1).
    """
    if not 0.0 < level < 1.0:
        raise ParameterError(f"level {level!r}", expected="a number between 0 and 1")
    kinds = {first.derivative, second.derivative} - {"either"}
    if len(kinds) > 1 or first.form != second.form or abs(first.period - second.period) > 1e-3 * first.period:
        what = " and ".join(
            f"{e.where} ({e.period * 1e3:.6g} ms, {e.form}, derivative of {e.derivative})" for e in (first, second)
        )
        raise ParameterError(what, where="two records", expected="one period, one form and one kind of derivative")
    change = second.terms - first.terms
    spread = np.sqrt(np.diag(first.covariance + second.covariance))
    scaled = (first.covariance + second.covariance) / np.outer(spread, spread)
    statistic = float(change / spread @ np.linalg.solve(scaled, change / spread))
    p_value = float(chdtrc(3.0, statistic))
    possible = None
    if first.rounding_only and second.rounding_only:
        both = (first.equations, second.equations)
        steps = np.repeat([first.voltage_step, second.voltage_step], [len(each.voltage) for each in both])
        rows, voltage = joint_rows(both[0].rows, both[1].rows, 3), np.concatenate([each.voltage for each in both])
        possible = not Enclosure(rows, voltage, steps).is_empty()
    different = p_value < level if possible is None else not possible
    return GainComparison(different, statistic, p_value, level, possible)


@dataclass(frozen=True)
class _Fit:
    terms: np.ndarray
    covariance: np.ndarray
    residual: float
    equations: Equations


def _fit(log: ControllerLog, kind: str, stretch: np.ndarray, forgetting: float) -> _Fit:
    """Least squares on the unsaturated samples, by the recursion."""
    actions, used = _actions(log, kind, stretch)
    place = stretch[used]
    _check_actions(log, actions, log.voltage[used])
    length = np.linalg.norm(actions, axis=0)
    rows = np.column_stack([actions / length, (place[:, None] == np.arange(place.max() + 1))])
    filter_ = RecursiveLeastSquares(rows.shape[1], forgetting)
    filter_.update(rows, log.voltage[used])
    theta = filter_.estimate
    residuals = log.voltage[used] - rows @ theta
    weight = weights(len(used), filter_.forgetting)
    covariance = sandwich(rows, rows, residuals, weight)
    # nothing is known better than sums of so many numbers in double precision
    rounding = 16.0 * len(used) * np.finfo(float).eps * float(np.abs(log.voltage).max())
    covariance += rounding**2 * np.linalg.inv(filter_.information)
    covariance = covariance[:3, :3] / np.outer(length, length)
    residual = sqrt(float(weight @ residuals**2 / weight.sum()))
    equations = Equations(np.column_stack([actions, rows[:, 3:]]), log.voltage[used])
    return _Fit(theta[:3] / length, covariance, residual, equations)


def _actions(log: ControllerLog, kind: str, stretch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What p, s and d multiply (m, 3), centred in each stretch, and the samples (m,) used."""
    error = log.error
    source = error if kind == "error" else -log.position
    used = np.flatnonzero(stretch >= 0)
    used = used[used > 0]
    actions = np.column_stack([error, np.cumsum(error), np.diff(source, prepend=source[0])])[used]
    place = stretch[used]
    for s in range(int(place.max()) + 1):
        actions[place == s] -= actions[place == s].mean(axis=0)
    return actions, used


def check_excitation(log: ControllerLog) -> None:
    """Raise RecordingError where error and voltage do not move enough to identify anything."""
    actions, used = _actions(log, "error", np.zeros(len(log), dtype=int))
    _check_actions(log, actions, log.voltage[used])


def _check_actions(log: ControllerLog, actions: np.ndarray, voltage: np.ndarray) -> None:
    length = np.linalg.norm(actions, axis=0)
    expected = "a record with motion: several starts and stops, or a path of changing speed"
    if np.ptp(voltage) == 0.0:
        raise RecordingError("the voltage does not change", where=log.where, expected=expected)
    still = length <= 1e-12 * max(1.0, float(np.abs(log.setpoint).max())) * sqrt(len(actions))
    if still[0] or still[2]:
        raise RecordingError("no excitation: the error does not change", where=log.where, expected=expected)
    smallest = float(np.linalg.svd(actions / length, compute_uv=False)[-1])
    if smallest < SINGULAR:
        what = "the error, its sum and its difference are in fixed proportion (a single sinusoid, or a line)"
        raise RecordingError(f"no sufficient excitation: {what}", where=log.where, expected=expected)


def _stretches(log: ControllerLog, limit: float, step: float) -> np.ndarray:
    """(n,) number of the unsaturated stretch of each sample, -1 where saturated or too short."""
    # the highest code of a converter is one step below its lowest, in magnitude
    inside = np.abs(log.voltage) < limit - 1.5 * step - 1e-9 * min(limit, 1e6)
    stretch = np.full(len(log), -1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    kept = [(a, b) for a, b in zip(edges[::2], edges[1::2]) if b - a >= _SHORTEST]
    for number, (a, b) in enumerate(kept):
        stretch[a:b] = number
    if not kept or len(kept) > _MOST_STRETCHES:
        what = f"{int((~inside).sum())} of {len(log)} samples at the limit of {limit:g} V, in {len(kept)} stretches"
        raise RecordingError(what, where=log.where, expected="a record whose voltage is mostly within its limit")
    return stretch


def _linear(along: np.ndarray, fit: _Fit, z: float) -> Interval:
    value = float(along @ fit.terms)
    half = z * sqrt(max(float(along @ fit.covariance @ along), 0.0))
    return Interval(value, value - half, value + half)


def _ratio(above: np.ndarray, below: np.ndarray, fit: _Fit, z: float) -> Interval:
    """Fieller's interval of a ratio whose denominator's own interval is above 0."""
    n, d = float(above @ fit.terms), float(below @ fit.terms)
    nn, nd, dd = (z * z * float(a @ fit.covariance @ b) for a, b in ((above, above), (above, below), (below, below)))
    scale = d * d - dd
    middle = (n * d - nd) / scale
    # middle^2 - (n^2 - nn) / scale, without its differences of equal numbers
    half = sqrt(max(nd * nd - 2.0 * n * d * nd + d * d * nn + n * n * dd - dd * nn, 0.0)) / scale
    return Interval(n / d, middle - half, middle + half)


def _integral_time(rate: Interval, h: float) -> Interval:
    """Ti [s] from s/Kg; inf where the rate may be zero."""
    low, high = (h / r if r > 0.0 else inf for r in (rate.high, rate.low))
    return Interval(h / rate.value if rate.low > 0.0 else inf, low, high)


def _derivative_time(rate: Interval, h: float) -> Interval:
    """Td [s] from d/Kg; 0 where the rate may be negative."""
    return Interval(*(max(h * r, 0.0) for r in (rate.value, rate.low, rate.high)))


def _enclosed(
    equations: Equations, step: float, gain_of: np.ndarray, h: float
) -> tuple[Interval, Interval, Interval] | None:
    """Certain intervals of Kg, Ti and Td, or None where rounding alone did not make the record."""
    enclosure = Enclosure(equations.rows, equations.voltage, step)
    below, integral_of, derive_of = np.pad(
        [gain_of, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ((0, 0), (0, equations.rows.shape[1] - 3))
    )
    gain = enclosure.ends(below)
    if gain is None or gain[0] <= 0.0:
        return None
    integral, derive = enclosure.ratio_ends(integral_of, below), enclosure.ratio_ends(derive_of, below)
    if integral is None or derive is None:
        return None
    return (_middle(*gain), _integral_time(_middle(*integral), h), _derivative_time(_middle(*derive), h))


def _middle(low: float, high: float) -> Interval:
    return Interval(0.5 * (low + high), low, high)
