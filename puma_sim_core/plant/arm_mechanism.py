# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm of three joints as identification sees it.

Thirty-nine parameters: mass, centre and squared radii of gyration of each link;
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
from puma_sim_core.effects import VISCOUS, Effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.linkage.linkage_plant import LinkagePlant
from puma_sim_core.plant.lumped import LumpedMechanism
from puma_sim_core.plant.mechanism import Drive, MechanismParameter
from puma_sim_core.plant.plant import Plant

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
class ArmMechanism(LumpedMechanism):
    """A `Mechanism` of three joints.

    viscous (3,) [N.m.s/rad]; widths: the relative deviations of
    `WIDTHS`; torque_form as `Plant`.
    """

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
        if isinstance(plant, LinkagePlant):
            what = f"a model of kind {plant.body.kind}"
            raise ParameterError(what, where=self.name, expected="a model of an arm")
        given = {e.joint for e in plant.effects if e.kind is VISCOUS}
        viscous = [plant.viscous_friction[j] if j + 1 in given else self.viscous[j] for j in range(3)]
        effects = [e for e in plant.effects if e.kind is not VISCOUS]
        return self.with_arm(plant.arm, viscous=viscous, effects=effects, torque_form=plant.torque_form)

    @property
    def library_sized(self) -> bool:
        return True

    def of_links(self, name: str) -> bool:
        return name.startswith("link")

    def arm_of(self, theta: ArrayLike | None = None) -> ArmParameters:
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
