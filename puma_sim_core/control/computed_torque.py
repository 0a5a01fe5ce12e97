# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Computed torque: the inverse dynamics of the arm, in volts, with PID around it.

With r, r', r'' from the setpoints (see `reference`) and e = r - q, e' = r' - v,

``a = r'' + Kd e' + Kp e + Ki sum(e) h``
``volts = (R / kT) [(D + Ia) a + C(q, v) + G(q)] + ke N w``

at the measured positions q: as far as the model is right, each joint then moves by itself, like
a mass that the PID terms hold with three poles at -bandwidth: Kp = 3 b^2, Ki = b^3, Kd = 3 b.
While a voltage is at its limit, an error that would drive it further is not added to the sum.

v is the difference of measured positions, through a filter of first order:
``v(k) = v(k-1) + c [(q(k) - q(k-1)) / h - v(k-1)]``, c = 1 - exp(-h velocity_filter).

The back-EMF is made up for at the measured velocity (w = v), which decouples the joints entirely,
or at the reference's (w = r'), which leaves its damping to the motors: better where samples are
so slow or late that the voltage would come after the motion. Then Kd is smaller by what the
motors do by themselves, ke N kT / (R M) of each joint alone, where it is not more than all of it.

The inductance is neglected: L/R is 3 ms, a delay of the torque.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from math import cos, exp, inf, sin
from typing import Any

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.checks import check_choice, check_keys, check_positive, check_three_each, check_three_positive
from puma_sim_core.control.reference import Bounds, SetpointReference
from puma_sim_core.dynamics.rigid import rigid_body
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import interpreted
from puma_sim_core.plant.plant import Plant

_rigid_body: Callable[..., Any] = interpreted(rigid_body)
#: share of the speed at which the back-EMF takes all of the voltage limit
_REACHABLE = 0.9
BACK_EMF = ("measured", "reference")
_WHERE = "computed torque"
_NOTHING = (0.0, 0.0, 0.0)
Triple = tuple[float, float, float]


class InverseDynamics:
    """Voltages and torques that given accelerations need, with the inductance neglected.

    model : an arm, or a plant, of which arm and torque form are used; its effects are not.
    """

    def __init__(self, model: ArmParameters | Plant):
        plant = model if isinstance(model, Plant) else Plant(model)
        # without the effects: a controller knows nothing of friction and loads
        plain = Plant(plant.arm, (), plant.torque_form)
        self._body = plain.constants.body
        self._per_torque = tuple(m.resistance / kT for m, kT in zip(plain.arm.motors, plain.torque_per_ampere))
        self.back_emf = tuple(m.back_emf * m.gear_ratio for m in plain.arm.motors)

    def terms(self, q: Sequence[float], velocity: Sequence[float]) -> tuple[float, ...]:
        """(M11, M12, M13, M22, M23, M33, b1, b2, b3): M = D + Ia [kg.m^2], b = -C(q, v) - G(q) [N.m].

        q (3,) [rad], velocity (3,) [rad/s].
        """
        _, q2, q3 = q
        u = q2 + q3
        found: tuple[float, ...] = _rigid_body(*velocity, 0.0, 0.0, 0.0, (sin(q2), cos(q2), sin(u), cos(u)), self._body)
        return found

    def combined(
        self, terms: Sequence[float], acceleration: Sequence[float], turning: Sequence[float]
    ) -> tuple[float, float, float]:
        """Volts from `terms`, accelerations (3,) [rad/s^2], and the velocities (3,) [rad/s] of
        which the back-EMF is taken."""
        m11, m12, m13, m22, m23, m33, b1, b2, b3 = terms
        a1, a2, a3 = acceleration
        w1, w2, w3 = turning
        (k1, k2, k3), (e1, e2, e3) = self._per_torque, self.back_emf
        return (
            k1 * (m11 * a1 + m12 * a2 + m13 * a3 - b1) + e1 * w1,
            k2 * (m12 * a1 + m22 * a2 + m23 * a3 - b2) + e2 * w2,
            k3 * (m13 * a1 + m23 * a2 + m33 * a3 - b3) + e3 * w3,
        )

    def voltages(self, q: Sequence[float], velocity: Sequence[float], acceleration: Sequence[float]) -> list[float]:
        """Volts that a motion needs: q [rad], velocity [rad/s], acceleration [rad/s^2], (3,)."""
        return list(self.combined(self.terms(q, velocity), acceleration, velocity))

    def own_damping(self, terms: Sequence[float]) -> tuple[float, ...]:
        """Damping [1/s] that the back-EMF gives each joint alone."""
        inertias = terms[0], terms[3], terms[5]
        return tuple(e / (k * m) for e, k, m in zip(self.back_emf, self._per_torque, inertias))


@dataclass(frozen=True)
class Settings:
    """Settings of computed torque, those of config/controllers.yaml.

    bandwidth : (3,) [rad/s], where the three poles of each joint are; velocity_filter : [rad/s], inf for none;
    greatest_velocity, greatest_acceleration, lead : of the reference, see `reference.Bounds`, the velocities at most
    0.9 of what the limit lets the motors reach; back_emf : "measured" or "reference".

    Raises ParameterError: names what cannot be.
    """

    bandwidth: Sequence[float]
    velocity_filter: float
    greatest_velocity: Sequence[float]
    greatest_acceleration: Sequence[float]
    lead: float = 1.0
    back_emf: str = "measured"

    def __post_init__(self) -> None:
        check_positive(self.velocity_filter, "velocity_filter", "rad/s", _WHERE, infinite=True)
        check_three_positive(self.bandwidth, "bandwidth", _WHERE)
        check_choice(self.back_emf, "back_emf", BACK_EMF, _WHERE)
        Bounds(self.greatest_velocity, self.greatest_acceleration, self.lead)

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> Settings:
        """From a mapping with all six; raises ParameterError on others."""
        check_keys(mapping, [field.name for field in fields(cls)], _WHERE)
        try:
            return cls(**mapping)
        except TypeError as error:
            raise ParameterError(str(error), where=_WHERE, expected="numbers") from None


class ComputedTorque:
    """Computed-torque control of the three joints; see the module.

    model : the arm as the controller knows it (see `InverseDynamics`).
    period : h [s], the stated rate of `update`; setpoint_period : between setpoints [s], a whole number of periods.
    limit : greatest magnitude of a motor voltage [V]; amplifier_gain : motor volts per volt that `update` gives.

    Raises ParameterError: names what cannot be.
    """

    def __init__(
        self,
        model: ArmParameters | Plant,
        settings: Settings,
        period: float,
        *,
        setpoint_period: float = 0.028,
        limit: float = inf,
        amplifier_gain: float = 1.0,
    ):
        self.period = check_positive(period, "period", "s", _WHERE)
        self.limit = check_positive(limit, "limit", "V", _WHERE, infinite=True)
        self._amplifier = check_positive(amplifier_gain, "amplifier_gain", "", _WHERE)
        self.dynamics = InverseDynamics(model)
        # faster than a motor can turn the reference would run away from the arm
        reachable = [_REACHABLE * limit / e for e in self.dynamics.back_emf]
        velocity = [min(v, w) for v, w in zip(settings.greatest_velocity, reachable)]
        bounds = Bounds(velocity, settings.greatest_acceleration, settings.lead)
        self.reference = SetpointReference(self.period, setpoint_period, bounds, _WHERE)
        bandwidth = tuple(map(float, settings.bandwidth))
        # of each joint: of the error's rate, of the error, and of its sum beside that
        self._gains = [(3.0 * b, b * b, b) for b in bandwidth]
        self._measured = settings.back_emf == "measured"
        self._filter = 1.0 - exp(-self.period * settings.velocity_filter)
        self.reset()

    def reset(self) -> None:
        """Forget the past: no sum, at rest at the next sample."""
        self.reference.reset()
        self._sum, self._velocity = _NOTHING, _NOTHING
        self._before: Triple | None = None

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """Volts for one sample at time t [s]; setpoint and measurement (3,) [rad]."""
        check_three_each(setpoint, measurement, _WHERE)
        # joint by joint, without loops: a third of the time, and an appraisal calls this a thousand times a second
        q1, q2, q3 = map(float, measurement)
        q = (q1, q2, q3)
        h, c = self.period, self._filter
        (p1, p2, p3), (v1, v2, v3), (s1, s2, s3) = self._before or q, self._velocity, self._sum
        v1 += c * ((q1 - p1) / h - v1)
        v2 += c * ((q2 - p2) / h - v2)
        v3 += c * ((q3 - p3) / h - v3)
        self._before, self._velocity = q, (v1, v2, v3)
        (r1, rd1, rdd1), (r2, rd2, rdd2), (r3, rd3, rdd3) = self.reference.update(setpoint, q)
        terms = self.dynamics.terms(q, (v1, v2, v3))
        (d1, k1, b1), (d2, k2, b2), (d3, k3, b3) = self._gains
        turning = (v1, v2, v3)
        if not self._measured:
            turning = (rd1, rd2, rd3)
            own1, own2, own3 = self.dynamics.own_damping(terms)
            d1, d2, d3 = max(d1 - own1, 0.0), max(d2 - own2, 0.0), max(d3 - own3, 0.0)
        e1, e2, e3 = r1 - q1, r2 - q2, r3 - q3
        n1, n2, n3 = s1 + h * e1, s2 + h * e2, s3 + h * e3
        acceleration = (
            rdd1 + d1 * (rd1 - v1) + k1 * (3.0 * e1 + b1 * n1),
            rdd2 + d2 * (rd2 - v2) + k2 * (3.0 * e2 + b2 * n2),
            rdd3 + d3 * (rd3 - v3) + k3 * (3.0 * e3 + b3 * n3),
        )
        u1, u2, u3 = self.dynamics.combined(terms, acceleration, turning)
        limit, amplifier = self.limit, self._amplifier
        if not -limit <= u1 <= limit:
            u1, n1 = self._limited(u1, e1, s1, n1)
        if not -limit <= u2 <= limit:
            u2, n2 = self._limited(u2, e2, s2, n2)
        if not -limit <= u3 <= limit:
            u3, n3 = self._limited(u3, e3, s3, n3)
        self._sum = (n1, n2, n3)
        return u1 / amplifier, u2 / amplifier, u3 / amplifier

    def _limited(self, u: float, error: float, before: float, after: float) -> tuple[float, float]:
        """Voltage and sum of a joint that is at its limit: an error that drives it further is not added."""
        return min(max(u, -self.limit), self.limit), after if error * u < 0.0 else before
