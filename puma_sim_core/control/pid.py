# SPDX-License-Identifier: Apache-2.0
"""Discrete PID control (section 7.6.1), one law for the kernel's servo and for Python.

Positional form of equation 7.2, whose printed version lacks h/Ti:
``u(k) = Kg [e(k) + (h/Ti) sum e + (Td/h)(d(k) - d(k-1))]``, where d is the error, or less the
measurement, so that a step of the setpoint does not kick. The output is limited; while it is at
its limit, an error that would drive it further is not added to the sum (anti-windup).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite

from ..backend import inlined, interpreted
from ..errors import ParameterError


@dataclass(frozen=True)
class PidGains:
    """Gains of one joint: Kg [V/rad], Ti [s] (inf: no integral action), Td [s]."""

    gain: float
    integral_time: float = inf
    derivative_time: float = 0.0

    def __post_init__(self):
        for name, low in (("gain", 0.0), ("integral_time", 1e-9), ("derivative_time", 0.0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) \
                    or not (isfinite(value) or (value == inf and name == "integral_time")) \
                    or value < low:
                raise ParameterError(f"{name} = {value!r}", where="PID gains",
                                     expected=f"a number of at least {low:g}")
            object.__setattr__(self, name, float(value))


@inlined
def pid_law(error, d_now, d_before, total, gain, integral, derivative, limit):
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
    """

    def __init__(self, gains: Sequence[PidGains], period: float, *, limit: float = inf,
                 on_measurement: bool = False):
        if not isfinite(period) or period <= 0.0:
            raise ParameterError(f"period = {period!r}", where="PID", expected="seconds, positive")
        if not limit > 0.0:
            raise ParameterError(f"limit = {limit!r}", where="PID", expected="volts, positive")
        self.gains = tuple(gains)
        self.period = float(period)
        self.limit = float(limit)
        self.on_measurement = bool(on_measurement)
        self.reset()

    def reset(self) -> None:
        """Forget the past: no sum, and no derivative at the next sample."""
        self._total = [0.0] * len(self.gains)
        self._before: list[float] | None = None

    def update(self, t: float, setpoint: Sequence[float],
               measurement: Sequence[float]) -> tuple[float, ...]:
        """Volts for one sample at time t [s]; setpoint and measurement [rad], one a joint.

        Raises
        ------
        ParameterError : wrong number of joints.
        """
        if len(setpoint) != len(self.gains) or len(measurement) != len(self.gains):
            raise ParameterError(f"{len(setpoint)} setpoints and {len(measurement)} measurements",
                                 where="PID", expected=f"{len(self.gains)} of each")
        now = [-float(y) if self.on_measurement else float(r) - float(y)
               for r, y in zip(setpoint, measurement)]
        before = now if self._before is None else self._before
        volts = []
        for j, g in enumerate(self.gains):
            u, self._total[j] = _law(float(setpoint[j]) - float(measurement[j]), now[j],
                                      before[j], self._total[j], g.gain,
                                      self.period / g.integral_time,
                                      g.derivative_time / self.period, self.limit)
            volts.append(u)
        self._before = now
        return tuple(volts)
