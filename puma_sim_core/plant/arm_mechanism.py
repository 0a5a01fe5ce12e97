# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm of three joints as identification sees it.

Its torques are linear in the constants of `rigid_body.Lumps`: one table of sines, speeds and accelerations serves the
torque and all of its derivatives. Thirty-nine parameters: mass, centre and squared radii of gyration of each link;
inertia, resistance, back-EMF, torque constant and inductance of each motor; viscous friction of each joint. Products of
inertia, lengths, gear ratios and gravity are known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters, Link, Motor
from puma_sim_core.arm.loads import with_point_mass
from puma_sim_core.arm.rigid_body import Lumps, lumped_constants
from puma_sim_core.effects import VISCOUS, Effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.mechanism import Drive, Mechanism, MechanismParameter, complex_slope
from puma_sim_core.plant.plant import Plant

#: the constants that the link torques are linear in: `Lumps` but for E4, which is E0 + Ia3
LUMPS = Lumps._fields[:15] + Lumps._fields[16:]
_AXES = ("x", "y", "z")
_MOTOR = {
    "inertia": "kg.m^2",
    "resistance": "ohm",
    "back_emf": "V.s/rad",
    "torque_constant": "N.m/A",
    "inductance": "H",
}
#: numbers whose prior widths a mechanism file gives, as shares of the numbers
WIDTHS = ("mass", "centre", "gyration_squared", *_MOTOR, "viscous_friction")


@dataclass(frozen=True, eq=False)
class ArmMechanism(Mechanism):
    """A `Mechanism` of three joints.

    arm : the start's numbers; viscous (3,) [N.m.s/rad]; widths: the relative deviations of
    `WIDTHS`; torque_form as `Plant`.
    """

    arm: ArmParameters = field(kw_only=True)
    viscous: tuple[float, ...] = (0.0, 0.0, 0.0)
    widths: Mapping[str, float] = field(default_factory=dict)
    torque_form: str = "physical"

    @classmethod
    def of(
        cls,
        arm: ArmParameters,
        viscous: Iterable[float],
        widths: Mapping[str, float],
        torque_scale: ArrayLike,
        *,
        name: str = "puma560",
        effects: Iterable[Effect] = (),
        torque_form: str = "physical",
    ) -> ArmMechanism:
        """Mechanism of an arm; `widths` has the relative deviation of each of `WIDTHS`."""
        viscous = tuple(float(value) for value in viscous)
        return cls(
            name=name,
            joints=3,
            position_unit="rad",
            effort_unit="N.m",
            ranges=arm.joint_ranges,
            torque_scale=np.array(torque_scale, dtype=float),
            gear=np.array([motor.gear_ratio for motor in arm.motors]),
            parameters=_parameters(arm, viscous, widths),
            effects=tuple(effects),
            arm=arm,
            viscous=viscous,
            widths=dict(widths),
            torque_form=torque_form,
        )

    def with_arm(self, arm: ArmParameters, **changes: Any) -> ArmMechanism:
        """The mechanism that starts from another arm; changes : of `viscous`, `effects`, `torque_form`."""
        kept = {name: getattr(self, name) for name in ("viscous", "name", "effects", "torque_form")}
        return ArmMechanism.of(arm, widths=self.widths, torque_scale=self.torque_scale, **(kept | changes))

    def of_plant(self, plant: Plant) -> ArmMechanism:
        """See `Mechanism.of_plant`; joints without viscous friction in the plant keep that of the
        mechanism as the start (what is not known is not zero)."""
        if plant.joints != 3:
            what = f"a model of {plant.joints} joint"
            raise ParameterError(what, where=self.name, expected="a model of three joints")
        given = {e.joint for e in plant.effects if e.kind is VISCOUS}
        viscous = [plant.viscous_friction[j] if j + 1 in given else self.viscous[j] for j in range(3)]
        effects = [e for e in plant.effects if e.kind is not VISCOUS]
        return self.with_arm(plant.arm, viscous=viscous, effects=effects, torque_form=plant.torque_form)

    def arm_of(self, theta: ArrayLike | None = None) -> ArmParameters:
        """The arm with the numbers of theta, without loads."""
        value = self.values(theta)
        links: list[Any] = [
            Link(
                value[f"link{i}.mass"],
                (value[f"link{i}.centre_x"], value[f"link{i}.centre_y"], value[f"link{i}.centre_z"]),
                (value[f"link{i}.gyration_xx"], value[f"link{i}.gyration_yy"], value[f"link{i}.gyration_zz"]),
                link.products,
            )
            for i, link in enumerate(self.arm.links, start=1)
        ]
        motors: list[Any] = [
            Motor(gear_ratio=motor.gear_ratio, **{key: value[f"motor{i}.{key}"] for key in _MOTOR})
            for i, motor in enumerate(self.arm.motors, start=1)
        ]
        return replace(self.arm, links=tuple(links), motors=tuple(motors))

    def plant(self, theta: ArrayLike | None = None, effects: Iterable[Effect] = ()) -> Plant:
        theta = None if theta is None else self.clip(theta)
        value = self.values(theta)
        viscous = tuple(
            Effect(VISCOUS, j, {"coefficient": value[f"joint{j}.viscous"]})
            for j in (1, 2, 3)
            if value[f"joint{j}.viscous"] > 0.0
        )
        return Plant(self.arm_of(theta), viscous + self.effects + tuple(effects), self.torque_form)

    def lumps(self, theta: ArrayLike | None = None) -> np.ndarray:
        """(19,) constants `LUMPS` of the links and what they carry, without motor inertias."""
        return _link_lumps(self.arm_of(theta)) + self._load_lumps

    @property
    def _load_lumps(self) -> np.ndarray:
        """What the payloads of the model add; it does not depend on theta."""
        loaded = self.arm
        for effect in self.effects:
            if effect.kind.load is not None:
                loaded = effect.kind.load(loaded, effect.on(self.arm).values)
        return _link_lumps(loaded) - _link_lumps(self.arm)

    def torque(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        table = lump_table(q, qd, qdd)
        return (table.reshape(-1, len(LUMPS)) @ self.lumps(theta)).reshape(-1, 3)

    def gravity(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        q = np.asarray(q)
        g1, g2, g3, g4 = self.lumps(theta)[-4:]
        u = q[:, 1] + q[:, 2]
        third = g1 * np.cos(u) + g2 * np.sin(u)
        second = g3 * np.cos(q[:, 1]) + g4 * np.sin(q[:, 1]) + third
        return np.stack([np.zeros_like(third), second, third], axis=1)

    def inertia(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        return np.diagonal(self.inertia_matrix(theta, q), axis1=1, axis2=2)

    def inertia_matrix(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        still = np.zeros(np.shape(q))
        weight = self.lumps(theta)
        weight[-4:] = 0.0
        return np.stack([lump_table(q, still, still + unit) @ weight for unit in np.eye(3)], axis=-1)

    def gravity_tilt(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        """See `Mechanism.gravity_tilt`: per rad, gravity points along (x, y, -1) of the base.

        Joint 1 gets (-x S1 + y C1) G2 and the moment of the masses beside the plane of the arm.
        """
        q = np.asarray(q, dtype=float)
        arm, g = self.arm_of(theta), self.arm.gravity
        lumps = self.lumps(theta)
        g1, g2, g3, g4 = lumps[-4:]
        first, second, third = arm.links
        loads = [e.values for e in self.effects if e.kind.load is not None]
        load, beside = sum(v["mass"] for v in loads), sum(v["mass"] * v["y"] for v in loads)
        # moments of mass [kg.m] times g: along the arm, and beside its plane
        along = g * first.mass * first.centre[0] - self.gravity(theta, q)[:, 1]
        side = g * (
            first.mass * first.centre[2]
            + second.mass * second.centre[2]
            + third.mass * (arm.d3 + third.centre[1])
            + load * arm.d3
            + beside
        )
        s1, c1, u = np.sin(q[:, 0]), np.cos(q[:, 0]), q[:, 1] + q[:, 2]
        inward = g1 * np.sin(u) - g2 * np.cos(u)  # g d(along)/dq3
        both = g3 * np.sin(q[:, 1]) - g4 * np.cos(q[:, 1]) + inward
        slopes = np.stack([np.zeros_like(u), both, inward], axis=1)
        result = np.empty(q.shape + (2,))
        result[:, :, 0] = -slopes * c1[:, None]
        result[:, :, 1] = -slopes * s1[:, None]
        result[:, 0, 0] = along * s1 + side * c1
        result[:, 0, 1] = -along * c1 + side * s1
        return result

    def payload_torque(
        self, theta: ArrayLike | None, z: float, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
    ) -> np.ndarray:
        nothing = Link(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        load = with_point_mass(replace(self.arm, links=(nothing,) * 3), 1.0, 0.0, 0.0, float(z))
        return lump_table(q, qd, qdd) @ _link_lumps(load)

    def link_jacobian(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        theta = self.start if theta is None else theta
        slopes = np.zeros((len(LUMPS), len(self.free)))
        for n, parameter in enumerate(self.free):
            if parameter.name.startswith("link"):
                slopes[:, n] = complex_slope(lambda moved: _link_lumps(self.arm_of(moved)), theta, n)
        table = lump_table(q, qd, qdd)
        return (table.reshape(-1, len(LUMPS)) @ slopes).reshape(len(table), 3, len(self.free))

    def drive(self, theta: ArrayLike | None) -> Drive:
        value = self.values(theta)
        per_motor = {key: np.array([value[f"motor{i}.{key}"] for i in (1, 2, 3)]) for key in _MOTOR}
        gear = self.gear if self.torque_form == "physical" else np.ones(3)
        return Drive(
            volts_per_torque=per_motor["resistance"] / (gear * per_motor["torque_constant"]),
            lag=per_motor["inductance"] / per_motor["resistance"],
            emf=per_motor["back_emf"] * self.gear,
            viscous=np.array([value[f"joint{j}.viscous"] for j in (1, 2, 3)]),
            motor_inertia=per_motor["inertia"],
            resistance=per_motor["resistance"],
        )


def _parameters(
    arm: ArmParameters, viscous: Iterable[float], widths: Mapping[str, float]
) -> tuple[MechanismParameter, ...]:
    """Name, unit, number, width and whether some torque depends on it, for all numbers of the arm."""
    found: list[tuple[str, str, float, str, bool]] = []
    for i, link in enumerate(arm.links, start=1):
        # the first link only turns about its upright axis
        found.append((f"link{i}.mass", "kg", link.mass, "mass", True))
        found += [(f"link{i}.centre_{a}", "m", value, "centre", i > 1) for a, value in zip(_AXES, link.centre)]
        for a, value in zip(_AXES, link.gyration_squared):
            found.append((f"link{i}.gyration_{a}{a}", "m^2", value, "gyration_squared", i > 1 or a == "y"))
    for i, motor in enumerate(arm.motors, start=1):
        found += [(f"motor{i}.{key}", unit, getattr(motor, key), key, True) for key, unit in _MOTOR.items()]
    for j, value in enumerate(viscous, start=1):
        found.append((f"joint{j}.viscous", "N.m.s/rad", value, "viscous_friction", True))
    return tuple(
        # a number that is zero, or that no torque depends on, has nothing to be fitted
        MechanismParameter(
            name,
            unit,
            float(value),
            deviation := abs(value) * widths[width],
            known=not (acts and deviation > 0.0),
            positive=width != "centre",
        )
        for name, unit, value, width, acts in found
    )


def _link_lumps(arm: ArmParameters) -> np.ndarray:
    """(19,) constants `LUMPS` of the links alone, real or complex."""
    first, second, third = (replace(motor, inertia=0.0) for motor in arm.motors)
    k = lumped_constants(replace(arm, motors=(first, second, third)))
    return np.array(k[:15] + k[16:])


def lump_table(q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
    """Factors of the constants `LUMPS` in the link torques.

    q, qd, qdd : (n, 3) [rad, rad/s, rad/s^2]. Returns (n, 3, 19) such that the product with the
    constants is D qdd + qd' C qd + G (equation 4.1; see `Lumps` for D, `coriolis` for C).
    """
    q, qd, qdd = (np.asarray(values, dtype=float) for values in (q, qd, qdd))
    s2, c2, s3, c3 = np.sin(q[:, 1]), np.cos(q[:, 1]), np.sin(q[:, 2]), np.cos(q[:, 2])
    su, cu = np.sin(q[:, 1] + q[:, 2]), np.cos(q[:, 1] + q[:, 2])
    w1, w2, w3 = qd.T
    a1, a2, a3 = qdd.T
    w11, w22, both = w1 * w1, w2 * w2, w3 * (2.0 * w2 + w3)
    w12, w1u = 2.0 * w1 * w2, 2.0 * w1 * (w2 + w3)
    half2, halfu = c2 * c2 - 0.5, cu * cu - 0.5
    # half of the slopes of C2 Cu and C2 Su with q2, and with q3
    f5, f5u = -0.5 * (s2 * cu + c2 * su), -0.5 * c2 * su
    f6, f6u = 0.5 * (c2 * cu - s2 * su), 0.5 * c2 * cu
    w13 = 2.0 * w1 * w3
    #: factors in the torques of the three joints, None for 0
    factors: dict[str, tuple[Any, Any, Any]] = {
        "A0": (a1, None, None),
        "A1": (c2 * c2 * a1 - s2 * c2 * w12, s2 * c2 * w11, None),
        "A2": (s2 * c2 * a1 + half2 * w12, -half2 * w11, None),
        "A3": (cu * cu * a1 - su * cu * w1u, su * cu * w11, su * cu * w11),
        "A4": (su * cu * a1 + halfu * w1u, -halfu * w11, -halfu * w11),
        "A5": (c2 * cu * a1 + f5 * w12 + f5u * w13, -f5 * w11, -f5u * w11),
        "A6": (c2 * su * a1 + f6 * w12 + f6u * w13, -f6 * w11, -f6u * w11),
        "B1": (su * (a2 + a3) + cu * (w22 + both), su * a1, su * a1),
        "B2": (cu * (a2 + a3) - su * (w22 + both), cu * a1, cu * a1),
        "B3": (s2 * a2 + c2 * w22, s2 * a1, None),
        "B4": (c2 * a2 - s2 * w22, c2 * a1, None),
        "E0": (None, a3, a2 + a3),
        "E1": (None, c3 * (2.0 * a2 + a3) - s3 * both, c3 * a2 + s3 * w22),
        "E2": (None, s3 * (2.0 * a2 + a3) + c3 * both, s3 * a2 - c3 * w22),
        "E3": (None, a2, None),
        "g1": (None, cu, cu),
        "g2": (None, su, su),
        "g3": (None, c2, None),
        "g4": (None, s2, None),
    }
    table = np.zeros((len(q), 3, len(LUMPS)))
    for n, name in enumerate(LUMPS):
        for j, factor in enumerate(factors[name]):
            if factor is not None:
                table[:, j, n] = factor
    return table
