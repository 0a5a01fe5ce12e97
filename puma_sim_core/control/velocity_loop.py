# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Independent joints with a velocity loop inside the position loop, as section 7.7 wishes for.

``w = r' + Kp (r - q)``; ``volts = Kv [(w - v) + (h / Tv) sum(w - v)]``: the outer loop asks for a
velocity, a PI controller sees to it. Setpoints and measured velocity v as in `computed_torque`,
but no model of the arm. While a voltage is at its limit, its sum does not grow.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf

from puma_sim_core.checks import check_positive, check_three_each, check_three_positive
from puma_sim_core.control.reference import Bounds, SetpointReference
from puma_sim_core.control.sample_laws import packed, velocity_loops
from puma_sim_core.jit import fitting

_WHERE = "velocity loop"
_AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


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
        per_joint = [number for kp, kv, tv in gains for number in (kp, kv, self.period / tv)]
        self.limit = check_positive(limit, "limit", "V", _WHERE, infinite=True)
        share = 1.0 - exp(-period * check_positive(s.velocity_filter, "velocity_filter", "rad/s", _WHERE, True))
        bounds = Bounds(s.greatest_velocity, s.greatest_acceleration, s.lead)
        self._reference = reference = SetpointReference(period, setpoint_period, bounds, _WHERE)
        self._constants = packed([*per_joint, self.period, share, self.limit, reference.period, reference.lead])
        self.reset()

    def reset(self) -> None:
        """Forget the past: no sum, at rest at the next sample."""
        self._reference.reset()
        self._known: tuple[float, ...] | None = None

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """Volts for one sample at time t [s]; setpoint and measurement (3,) [rad]."""
        check_three_each(setpoint, measurement, _WHERE)
        q1, q2, q3 = measurement
        q = (float(q1), float(q2), float(q3))
        u, pieces = self._reference.pieces(setpoint, q)
        c, known = self._constants, self._known or (*q, *_AT_REST)
        volts: tuple[float, ...]
        volts, self._known = fitting(velocity_loops, c)(c, q, known, u, pieces)
        return volts
