# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A mechanism of one joint as identification sees it (see `one_joint`)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.mechanism import Drive, Mechanism, complex_slope
from puma_sim_core.plant.one_joint import OneJoint, OneJointPlant, completed, obstacle
from puma_sim_core.plant.plant import Plant


@dataclass(frozen=True, eq=False)
class OneJointMechanism(Mechanism):
    """A `Mechanism` of one joint; body : its numbers."""

    body: OneJoint = field(kw_only=True)

    @classmethod
    def of(cls, body: OneJoint, effects: Iterable[Effect] = ()) -> OneJointMechanism:
        """The mechanism of a body, and effects that are known to be there."""
        return cls(
            name=body.name,
            joints=1,
            position_unit=body.unit_of("rad"),
            effort_unit=body.unit_of("N.m"),
            ranges=(body.limits,),
            torque_scale=np.array([body.torque_scale]),
            gear=np.array([body.values["gear_ratio"]]),
            parameters=tuple(replace(p, positive=p.value > 0.0) for p in body.parameters),
            effects=tuple(effects),
            body=body,
        )

    def of_plant(self, plant: Plant) -> OneJointMechanism:
        if not isinstance(plant, OneJointPlant) or plant.body.kind != self.body.kind:
            what = f"a model of kind {plant.body.kind if isinstance(plant, OneJointPlant) else 'arm'}"
            raise ParameterError(what, where=self.name, expected=f"a model of kind {self.body.kind}")
        return OneJointMechanism.of(plant.body, plant.effects)

    def plant(self, theta: ArrayLike | None = None, effects: Iterable[Effect] = ()) -> Plant:
        values = {} if theta is None else self.values(self.clip(theta))
        return OneJointPlant.of(self.body, self.effects + tuple(effects), values)

    def possible(self, name: str) -> bool:
        return obstacle(self.body, KINDS[name]) is None

    def _all(self, theta: ArrayLike | None) -> dict[str, Any]:
        return completed(self.values(theta))

    def _loads(self, theta: ArrayLike | None) -> tuple[Any, Any]:
        """Inertia [kg.m^2 or kg] without the motor's, and greatest gravity torque [N.m]."""
        v, slide = self._all(theta), self.body.kind == "slide"
        inertia, weight = v["mass"], 0.0
        if not slide:
            inertia = v["mass"] * v["length"] ** 2 + v["lever_inertia"]
            weight = v["mass"] * v["gravity"] * v["length"]
        for effect in self.effects:
            if effect.kind.load is not None:
                z, mass = effect.values.get("z"), effect.values["mass"]
                if z is None:
                    z = 1.0 if slide else self.body.values["length"]
                inertia += mass * z * z
                weight += mass * z * (0.0 if slide else v["gravity"])
        return inertia, weight

    def torque(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        inertia, weight = self._loads(theta)
        return inertia * np.asarray(qdd) + weight * np.sin(np.asarray(q))

    def gravity(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        return self._loads(theta)[1] * np.sin(np.asarray(q))

    def inertia(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        return np.full(np.shape(q), self._loads(theta)[0])

    def inertia_matrix(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        return self.inertia(theta, q)[:, :, None]

    def payload_torque(
        self, theta: ArrayLike | None, z: float, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
    ) -> np.ndarray:
        """See `Mechanism.payload_torque`: z [m] along the lever; on a slide z means nothing."""
        if self.body.kind == "slide":
            return np.array(qdd, dtype=float)
        return z * z * np.asarray(qdd) + self._all(theta)["gravity"] * z * np.sin(np.asarray(q))

    def link_jacobian(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        theta = np.asarray(theta, dtype=float)
        result = np.zeros(np.shape(q) + (len(theta),))
        for n in range(len(theta)):
            inertia, weight = complex_slope(self._loads, theta, n)
            if inertia or weight:
                result[:, :, n] = inertia * np.asarray(qdd) + weight * np.sin(np.asarray(q))
        return result

    def drive(self, theta: ArrayLike | None) -> Drive:
        v = self._all(theta)
        numbers = (
            v["resistance"] / (v["gear_ratio"] * v["torque_constant"]),
            v["inductance"] / v["resistance"],
            v["back_emf"] * v["gear_ratio"],
            v["viscous_friction"],
            v["motor_inertia"],
            v["resistance"],
        )
        return Drive(*(np.array([number]) for number in numbers))
