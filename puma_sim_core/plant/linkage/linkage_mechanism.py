# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A linkage as identification sees it (see `linkage`)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.carrier import carrier, layout_of, turn_of
from puma_sim_core.plant.linkage.linkage import PASSIVE, POSITION, Axis, Linkage
from puma_sim_core.plant.linkage.linkage_plant import LinkagePlant, obstacle
from puma_sim_core.plant.lumped import LumpedMechanism
from puma_sim_core.plant.mechanism import Drive, LinkSensor, PositionServo
from puma_sim_core.plant.plant import Plant
from puma_sim_core.plant.quantities import DRIVES


@dataclass(frozen=True, eq=False)
class LinkageMechanism(LumpedMechanism):
    """A `Mechanism` of the joints of a linkage that move; body : its numbers."""

    body: Linkage = field(kw_only=True)

    @classmethod
    def of(cls, body: Linkage, effects: Iterable[Effect] = ()) -> LinkageMechanism:
        """The mechanism of a linkage, and effects that are known to be there."""
        return cls(
            name=body.name,
            joints=len(body.moving),
            position_unit=body.unit_of("rad"),
            effort_unit=body.unit_of("N.m"),
            ranges=tuple(axis.limits for axis in body.moving),
            torque_scale=np.array([axis.torque_scale for axis in body.moving]),
            gear=np.array([body.numbers(body.values, axis.place)["gear_ratio"] for axis in body.moving]),
            parameters=body.parameters,
            effects=tuple(effects),
            arm=carrier(body, body.values),
            layout=layout_of(body),
            body=body,
        )

    def of_plant(self, plant: Plant) -> LinkageMechanism:
        given = plant.body if isinstance(plant, LinkagePlant) else None
        drives = [(axis.place, axis.amplifier) for axis in self.body.axes]
        if given is None or given.kind != self.body.kind or [(a.place, a.amplifier) for a in given.axes] != drives:
            what = f"a model of kind {'arm' if given is None else given.kind}"
            if given is not None and given.kind == self.body.kind:
                what += f" with {', '.join(f'{a.place}: {a.amplifier}' for a in given.axes)}"
            own = ", ".join(f"{place}: {amplifier}" for place, amplifier in drives)
            raise ParameterError(what, where=self.name, expected=f"a model of kind {self.body.kind} with {own}")
        return LinkageMechanism.of(given, plant.effects)

    def plant(self, theta: ArrayLike | None = None, effects: Iterable[Effect] = ()) -> Plant:
        values = {} if theta is None else self.values(self.clip(theta))
        return LinkagePlant.of(self.body, self.effects + tuple(effects), values)

    def possible(self, name: str, joint: int | None = None) -> bool:
        kind = KINDS[name]
        if kind.shifts_zero and joint is not None and self.body.moving[joint - 1].zero_free:
            return False  # a parameter already
        return obstacle(self.body, kind, joint) is None

    @property
    def inputs(self) -> tuple[str, ...]:
        channels = {PASSIVE: "", POSITION: "setpoint"}
        return tuple(channels.get(axis.amplifier, "voltage") for axis in self.body.moving)

    @property
    def servos(self) -> tuple[PositionServo | None, ...]:
        return tuple(self._servo(axis) for axis in self.body.moving)

    @property
    def link_sensors(self) -> tuple[LinkSensor | None, ...]:
        return tuple(axis.link_sensor for axis in self.body.moving)

    def _servo(self, axis: Axis) -> PositionServo | None:
        if axis.amplifier != POSITION:
            return None
        v = self.body.numbers(self.body.values, axis.place)
        return PositionServo(v["servo_gain"], v["servo_damping"], v["servo_limit"])

    def arm_of(self, theta: ArrayLike | None = None) -> ArmParameters:
        return carrier(self.body, self.values(theta))

    def turn_of(self, theta: ArrayLike | None = None) -> tuple[Any, Any]:
        return turn_of(self.body, self.values(theta))

    def of_links(self, name: str) -> bool:
        own = name.rpartition(".")[2]
        return own not in DRIVES[POSITION] and own != "gain"

    def drive(self, theta: ArrayLike | None) -> Drive:
        values = self.values(theta)
        rows = []
        for axis in self.body.moving:
            v = self.body.numbers(values, axis.place)
            rows.append(
                (
                    v["resistance"] / (v["gear_ratio"] * v["torque_constant"]),
                    v["inductance"] / v["resistance"],
                    v["back_emf"] * v["gear_ratio"],
                    v["viscous_friction"],
                    v["motor_inertia"],
                    v["resistance"],
                )
            )
        return Drive(*(np.array(column) for column in zip(*rows)))
