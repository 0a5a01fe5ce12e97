# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Discrete PID control (section 7.6.1), one law for the kernel's servo and for Python.

Positional form of equation 7.2, whose printed version lacks h/Ti:
``u(k) = Kg [e(k) + (h/Ti) sum e + (Td/h)(d(k) - d(k-1))]``, where d is the error, or less the
measurement, so that a step of the setpoint does not kick. The output is limited; while it is at
its limit, an error that would drive it further is not added to the sum (anti-windup).

Velocity form, equation 7.3: ``u(k) = u(k-1) + q0 e(k) + q1 e(k-1) + q2 e(k-2)`` with the
coefficients 7.5 to 7.7, whose 7.6 lacks its minus in print. Its sum ends one sample earlier
(at k-1, as those coefficients have it), so that without limits it is the positional form less
``Kg (h/Ti) e(k)``. It goes on from the limited output, which is its anti-windup.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

from puma_sim_core.checks import check_choice, check_positive, is_number
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import Table, Vec, inlined, interpreted

#: forms of the same law, equations 7.2 and 7.3
FORMS = ("positional", "velocity")


@dataclass(frozen=True)
class PidGains:
    """Gains of one joint: Kg [V/rad], Ti [s] (inf: no integral action), Td [s]."""

    gain: float
    integral_time: float = inf
    derivative_time: float = 0.0

    def __post_init__(self) -> None:
        for name, low in (("gain", 0.0), ("integral_time", 1e-9), ("derivative_time", 0.0)):
            value = getattr(self, name)
            if not (is_number(value) or (value == inf and name == "integral_time")) or value < low:
                raise ParameterError(f"{name} = {value!r}", where="PID gains", expected=f"a number of at least {low:g}")
            object.__setattr__(self, name, float(value))


class Recursive(NamedTuple):
    """Coefficients of the velocity form [V/rad], equation 7.3."""

    q0: float
    q1: float
    q2: float


def recursive_coefficients(gains: PidGains, period: float) -> Recursive:
    """Equations 7.5 to 7.7 for a sample period h [s], with the sign of q1 that 7.6 lacks."""
    kg, rate = gains.gain, gains.derivative_time / period
    return Recursive(kg * (1.0 + rate), -kg * (1.0 + 2.0 * rate - period / gains.integral_time), kg * rate)


def gains_of_recursive(q0: float, q1: float, q2: float, period: float) -> PidGains:
    """The inverse of `recursive_coefficients`.

    Kg = q0 - q2, Td = q2 h / Kg, Ti = Kg h / (q0 + q1 + q2), h = period [s].

    Raises
    ------
    ParameterError : coefficients that no PID controller has: Kg not positive, a negative Td, or
        a sum that is negative (a sum of zero is a controller without integral action).
    """
    gain, total = q0 - q2, q0 + q1 + q2
    if not gain > 0.0 or not q2 >= 0.0 or not total >= 0.0:
        raise ParameterError(
            f"q = ({q0:g}, {q1:g}, {q2:g})", where="PID coefficients", expected="q0 > q2 >= 0 and q0 + q1 + q2 >= 0"
        )
    return PidGains(gain, gain * period / total if total > 0.0 else inf, q2 * period / gain)


@inlined
def pid_law(
    error: float,
    d_now: float,
    d_before: float,
    total: float,
    gain: float,
    integral: float,
    derivative: float,
    limit: float,
) -> Vec:
    """Output and new sum for one sample.

    integral = h/Ti, derivative = Td/h; `total` is the sum of (h/Ti) e so far [rad]; the output
    [V] lies within +-limit.
    """
    candidate = total + integral * error
    u = gain * (error + candidate + derivative * (d_now - d_before))
    if u > limit:
        u = limit
        if error > 0.0:
            candidate = total
    elif u < -limit:
        u = -limit
        if error < 0.0:
            candidate = total
    return u, candidate


_law = interpreted(pid_law)


class Pid:
    """Independent PID control of several joints at one rate.

    Parameters
    ----------
    gains : one `PidGains` a joint.
    period : h [s], the stated rate of `update`.
    limit : greatest magnitude of the output [V].
    on_measurement : take the derivative of the measurement, not of the error.
    form : "positional" (equation 7.2) or "velocity" (7.3); see the module for how they differ.
    anti_windup : False lets the sum grow while the output is at its limit. In the velocity form a
        joint without integral action always keeps what the limit cuts off: going on from the
        limited output would lose the proportional action for good.

    Raises
    ------
    ParameterError : a period or limit that is not positive, an unknown form.
    """

    def __init__(
        self,
        gains: Sequence[PidGains],
        period: float,
        *,
        limit: float = inf,
        on_measurement: bool = False,
        form: str = "positional",
        anti_windup: bool = True,
    ):
        check_choice(form, "form", FORMS, "PID")
        self.gains = tuple(gains)
        self.period = check_positive(period, "period", "s", "PID")
        self.limit = check_positive(limit, "limit", "V", "PID", infinite=True)
        self.on_measurement = bool(on_measurement)
        self.form = form
        self.anti_windup = bool(anti_windup)
        self._sample = self._positional if form == "positional" else self._velocity
        # of each joint, with the limit beyond which a sum does not grow: once, not at each sample
        bound = self.limit if self.anti_windup else inf
        h = self.period
        self._laws = [(g.gain, h / g.integral_time, g.derivative_time / h, bound) for g in self.gains]
        self.reset()

    def reset(self) -> None:
        """Forget the past: no sum, and no derivative at the next sample."""
        self._total = [0.0] * len(self.gains)
        self._before: list[float] | None = None
        self._last: list[tuple[float, float, float, float]] = []

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """Volts for one sample at time t [s]; setpoint and measurement [rad], one a joint.

        Raises
        ------
        ParameterError : wrong number of joints.
        """
        if len(setpoint) != len(self.gains) or len(measurement) != len(self.gains):
            raise ParameterError(
                f"{len(setpoint)} setpoints and {len(measurement)} measurements",
                where="PID",
                expected=f"{len(self.gains)} of each",
            )
        error = [float(r) - float(y) for r, y in zip(setpoint, measurement)]
        now = [-float(y) for y in measurement] if self.on_measurement else error
        return tuple(self._sample(error, now))

    def _positional(self, error: Table, now: Table) -> list[float]:
        before, total = self._before or now, self._total
        volts = []
        for j, law in enumerate(self._laws):
            u, total[j] = _law(error[j], now[j], before[j], total[j], *law)
            volts.append(u)
        self._before = now
        return volts if self.anti_windup else [self._limited(u) for u in volts]

    def _velocity(self, error: Table, now: Table) -> list[float]:
        if not self._last:
            # at rest with this error for ever: the proportional action alone
            self._last = [
                (g.gain * (1.0 - self.period / g.integral_time) * e, e, d, d) for g, e, d in zip(self.gains, error, now)
            ]
        volts = []
        for j, (g, last) in enumerate(zip(self.gains, self._last)):
            u, e1, d1, d2 = last
            # 7.3, its terms put together so that d need not be the error
            u += g.gain * (
                error[j]
                - e1
                + self.period / g.integral_time * e1
                + g.derivative_time / self.period * (now[j] - 2.0 * d1 + d2)
            )
            volts.append(self._limited(u))
            kept = volts[j] if self.anti_windup and g.integral_time < inf else u
            self._last[j] = kept, error[j], now[j], d1
        return volts

    def _limited(self, u: float) -> float:
        return min(max(u, -self.limit), self.limit)
