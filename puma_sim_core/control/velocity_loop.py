# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Independent joints with a velocity loop inside the position loop, as section 7.7 wishes for.

``w = r' + Kp (r - q)``; ``volts = Kv [(w - v) + (h / Tv) sum(w - v)]``: the outer loop asks for a
velocity, a PI controller sees to it. Setpoints and measured velocity v as in `computed_torque`,
but no model of the arm. While a voltage is at its limit, its sum does not grow.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, inf, isfinite

from puma_sim_core.control.reference import SetpointReference
from puma_sim_core.dynamics.pid import pid_law
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import interpreted

_law = interpreted(pid_law)


class VelocityLoop:
    """Position and velocity loops of the three joints; see the module.

    Parameters
    ----------
    period : h [s], the stated rate of `update`; setpoint_period : whole periods [s].
    position_gain Kp [1/s], velocity_gain Kv [V.s/rad], velocity_time Tv [s] : (3,) each.
    velocity_filter : of the measured velocity [rad/s].
    greatest_velocity (3,) [rad/s], greatest_acceleration (3,) [rad/s^2], lead : see `reference`.
    limit : greatest magnitude of the output [V].

    Raises
    ------
    ParameterError : names what cannot be.
    """

    def __init__(
        self,
        period: float,
        *,
        position_gain: Sequence[float],
        velocity_gain: Sequence[float],
        velocity_time: Sequence[float],
        greatest_velocity: Sequence[float],
        greatest_acceleration: Sequence[float],
        velocity_filter: float = 300.0,
        lead: float = 1.0,
        setpoint_period: float = 0.028,
        limit: float = inf,
    ):
        where = "velocity loop"
        for name, values in (
            ("position_gain", position_gain),
            ("velocity_gain", velocity_gain),
            ("velocity_time", velocity_time),
        ):
            if len(values) != 3 or not all(isfinite(v) and v > 0.0 for v in values):
                raise ParameterError(f"{name} = {list(values)!r}", where=where, expected="three positive numbers")
        for name, value in (("period", period), ("limit", limit), ("velocity_filter", velocity_filter)):
            if not value > 0.0:
                raise ParameterError(f"{name} = {value!r}", where=where, expected="a positive number")
        samples = round(setpoint_period / period)
        if samples < 1 or abs(samples * period - setpoint_period) > 1e-9 * setpoint_period:
            raise ParameterError(
                f"period = {period!r} s", where=where, expected=f"a whole part of {setpoint_period!r} s"
            )
        self.period = float(period)
        self.limit = float(limit)
        self._gains = tuple(zip(position_gain, velocity_gain, velocity_time))
        self._filter = 1.0 - exp(-period * velocity_filter)
        self._reference = SetpointReference(samples, setpoint_period, greatest_velocity, greatest_acceleration, lead)
        self.reset()

    def reset(self) -> None:
        """Forget the past: no sum, at rest at the next sample."""
        self._reference.reset()
        self._total = [0.0, 0.0, 0.0]
        self._velocity = [0.0, 0.0, 0.0]
        self._before: list[float] | None = None

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, float, float]:
        """Volts for one sample at time t [s]; setpoint and measurement (3,) [rad]."""
        q = [float(y) for y in measurement]
        before = q if self._before is None else self._before
        self._before = q
        volts = []
        for j, ((r, rd, _), (kp, kv, tv)) in enumerate(zip(self._reference.update(setpoint, q), self._gains)):
            v = self._velocity[j]
            v = self._velocity[j] = v + self._filter * ((q[j] - before[j]) / self.period - v)
            error = rd + kp * (r - q[j]) - v
            u, self._total[j] = _law(error, 0.0, 0.0, self._total[j], kv, self.period / tv, 0.0, self.limit)
            volts.append(u)
        return tuple(volts)
