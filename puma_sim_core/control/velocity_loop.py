# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Independent joints with a velocity loop inside the position loop, as section 7.7 wishes for.

``w = r' + Kp (r - q)``; ``volts = Kv [(w - v) + (h / Tv) sum(w - v)]``: the outer loop asks for a
velocity, a PI controller sees to it. Setpoints and measured velocity v as in `computed_torque`,
but no model of the arm. While a voltage is at its limit, its sum does not grow.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, inf
from typing import Any

from puma_sim_core.checks import check_positive, check_three_positive
from puma_sim_core.control.reference import Bounds, SetpointReference
from puma_sim_core.jit import interpreted
from puma_sim_core.servo.pid import pid_law

_law: Callable[..., Any] = interpreted(pid_law)
_WHERE = "velocity loop"


@dataclass(frozen=True)
class VelocityLoopSettings:
    """position_gain Kp [1/s], velocity_gain Kv [V.s/rad], velocity_time Tv [s] : (3,) each; greatest_velocity,
    greatest_acceleration, lead : see `reference.Bounds`; velocity_filter : of the measured velocity [rad/s]."""

    position_gain: Sequence[float]
    velocity_gain: Sequence[float]
    velocity_time: Sequence[float]
    greatest_velocity: Sequence[float]
    greatest_acceleration: Sequence[float]
    velocity_filter: float = 300.0
    lead: float = 1.0


class VelocityLoop:
    """Position and velocity loops of the three joints; see the module.

    period : h [s], the stated rate of `update`; setpoint_period : whole periods [s]; limit : greatest magnitude of
    the output [V].

    Raises ParameterError: names what cannot be.
    """

    def __init__(
        self, settings: VelocityLoopSettings, period: float, *, setpoint_period: float = 0.028, limit: float = inf
    ):
        s, names = settings, ("position_gain", "velocity_gain", "velocity_time")
        self.period = check_positive(period, "period", "s", _WHERE)
        gains = zip(*(check_three_positive(getattr(s, name), name, _WHERE) for name in names))
        self._gains = tuple((kp, kv, self.period / tv) for kp, kv, tv in gains)
        self.limit = check_positive(limit, "limit", "V", _WHERE, infinite=True)
        self._filter = 1.0 - exp(-period * check_positive(s.velocity_filter, "velocity_filter", "rad/s", _WHERE, True))
        bounds = Bounds(s.greatest_velocity, s.greatest_acceleration, s.lead)
        self._reference = SetpointReference(period, setpoint_period, bounds, _WHERE)
        self.reset()

    def reset(self) -> None:
        """Forget the past: no sum, at rest at the next sample."""
        self._reference.reset()
        self._total = [0.0, 0.0, 0.0]
        self._velocity = [0.0, 0.0, 0.0]
        self._before: list[float] | None = None

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """Volts for one sample at time t [s]; setpoint and measurement (3,) [rad]."""
        q = [float(y) for y in measurement]
        before, known, total, h, limit = self._before or q, self._velocity, self._total, self.period, self.limit
        self._before = q
        volts = []
        for j, ((r, rd, _), (kp, kv, integral)) in enumerate(zip(self._reference.update(setpoint, q), self._gains)):
            known[j] += self._filter * ((q[j] - before[j]) / h - known[j])
            error = rd + kp * (r - q[j]) - known[j]
            u, total[j] = _law(error, 0.0, 0.0, total[j], kv, integral, 0.0, limit)
            volts.append(u)
        return tuple(volts)
