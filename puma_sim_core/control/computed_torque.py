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
from math import exp, inf
from typing import Any

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.checks import check_choice, check_keys, check_positive, check_three_each, check_three_positive
from puma_sim_core.control.reference import Bounds, SetpointReference
from puma_sim_core.control.sample_laws import computed_torque, inverse_terms, packed, torque_table
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import fitting, plain
from puma_sim_core.plant.plant import Plant

_terms: Callable[..., Any] = plain(inverse_terms)
#: share of the speed at which the back-EMF takes all of the voltage limit
_REACHABLE = 0.9
BACK_EMF = ("measured", "reference")
_WHERE = "computed torque"
_AT_REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class InverseDynamics:
    """Voltages and torques that given accelerations need, with the inductance neglected.

    model : an arm, or a plant, of which arm and torque form are used; its effects are not.
    """

    def __init__(self, model: ArmParameters | Plant):
        plant = model if isinstance(model, Plant) else Plant(model)
        # without the effects: a controller knows nothing of friction and loads
        known = Plant(plant.arm, (), plant.torque_form)
        self.body = known.constants.body
        #: of each joint [V/(N.m)]
        self.per_torque = tuple(m.resistance / kT for m, kT in zip(known.arm.motors, known.torque_per_ampere))
        self.back_emf = tuple(m.back_emf * m.gear_ratio for m in known.arm.motors)

    def terms(self, q: Sequence[float], velocity: Sequence[float]) -> tuple[float, ...]:
        """(M11, M12, M13, M22, M23, M33, b1, b2, b3): M = D + Ia [kg.m^2], b = -C(q, v) - G(q) [N.m].

        q (3,) [rad], velocity (3,) [rad/s].
        """
        found: tuple[float, ...] = _terms(tuple(q), tuple(velocity), self.body)
        return found

    def voltages(self, q: Sequence[float], velocity: Sequence[float], acceleration: Sequence[float]) -> list[float]:
        """Volts that a motion needs: q [rad], velocity [rad/s], acceleration [rad/s^2], (3,)."""
        m11, m12, m13, m22, m23, m33, b1, b2, b3 = self.terms(q, velocity)
        a1, a2, a3 = acceleration
        torques = (
            m11 * a1 + m12 * a2 + m13 * a3 - b1,
            m12 * a1 + m22 * a2 + m23 * a3 - b2,
            m13 * a1 + m23 * a2 + m33 * a3 - b3,
        )
        return [k * t + e * w for k, t, e, w in zip(self.per_torque, torques, self.back_emf, velocity)]


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
        amplifier = check_positive(amplifier_gain, "amplifier_gain", "", _WHERE)
        self.dynamics = InverseDynamics(model)
        # faster than a motor can turn the reference would run away from the arm
        reachable = [_REACHABLE * limit / e for e in self.dynamics.back_emf]
        velocity = [min(v, w) for v, w in zip(settings.greatest_velocity, reachable)]
        bounds = Bounds(velocity, settings.greatest_acceleration, settings.lead)
        self.reference = SetpointReference(self.period, setpoint_period, bounds, _WHERE)
        bandwidth = tuple(map(float, settings.bandwidth))
        gains = [(3.0 * b, b * b, b) for b in bandwidth]
        share = 1.0 - exp(-self.period * settings.velocity_filter)
        dynamics, reference = self.dynamics, self.reference
        late = settings.back_emf == "reference"
        sample = (self.period, share, self.limit, amplifier, late, reference.period, reference.lead)
        self._constants = packed(torque_table(dynamics.body, dynamics.per_torque, dynamics.back_emf, gains, sample))
        self.reset()

    def reset(self) -> None:
        """Forget the past: no sum, at rest at the next sample."""
        self.reference.reset()
        self._known: tuple[float, ...] | None = None

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """Volts for one sample at time t [s]; setpoint and measurement (3,) [rad]."""
        check_three_each(setpoint, measurement, _WHERE)
        q1, q2, q3 = measurement
        q = (float(q1), float(q2), float(q3))
        u, pieces = self.reference.pieces(setpoint, q)
        c, known = self._constants, self._known or (*q, *_AT_REST)
        volts: tuple[float, ...]
        volts, self._known = fitting(computed_torque, c)(c, q, known, u, pieces)
        return volts
