# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A mechanism of one joint as the explaining loop sees it (see `one_joint`)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.mechanism import Drive, Mechanism
from puma_sim_core.plant.one_joint import OneJoint, OneJointPlant, completed, obstacle
from puma_sim_core.plant.plant import Plant


@dataclass(frozen=True, eq=False)
class OneJointMechanism(Mechanism):
    """A `Mechanism` of one joint; body : its numbers."""

    body: OneJoint = None

    @classmethod
    def of(cls, body: OneJoint, effects: Iterable[Effect] = ()) -> OneJointMechanism:
        """The mechanism of a body, and effects that are known to be there."""
        return cls(
            name=body.name,
            joints=1,
            position_unit=body.position_unit,
            effort_unit=body.effort_unit,
            ranges=(body.limits,),
            torque_scale=np.array([body.torque_scale]),
            gear=np.array([body.values["gear_ratio"]]),
            parameters=tuple(replace(p, positive=p.value > 0.0) for p in body.parameters),
            effects=tuple(effects),
            body=body,
        )

    def of_plant(self, plant: Plant) -> OneJointMechanism:
        if not isinstance(plant, OneJointPlant) or plant.body.kind != self.body.kind:
            kind = plant.body.kind if isinstance(plant, OneJointPlant) else "arm"
            raise ParameterError(
                f"a model of kind {kind}", where=self.name, expected=f"a model of kind {self.body.kind}"
            )
        return OneJointMechanism.of(plant.body, plant.effects)

    def plant(self, theta=None, effects: Iterable[Effect] = ()) -> Plant:
        values = {} if theta is None else self.values(self.clip(theta))
        return OneJointPlant.of(self.body, self.effects + tuple(effects), values)

    def possible(self, name: str) -> bool:
        return obstacle(self.body, KINDS[name]) is None

    def _all(self, theta) -> dict:
        return completed(self.values(theta))

    def _loads(self, theta) -> tuple[complex, complex]:
        """Inertia [kg.m^2 or kg] without the motor's, and greatest gravity torque [N.m]."""
        v = self._all(theta)
        inertia, weight = v["mass"], 0.0
        if self.body.kind == "pendulum":
            inertia = v["mass"] * v["length"] ** 2 + v["lever_inertia"]
            weight = v["mass"] * v["gravity"] * v["length"]
        for effect in self.effects:
            if effect.kind.load is not None:
                z, mass = self._place(effect), effect.values["mass"]
                inertia += mass * z * z
                weight += mass * z * self._gravity(v)
        return inertia, weight

    def _place(self, effect: Effect) -> float:
        z = effect.values.get("z")
        if z is None:
            z = 1.0 if self.body.kind == "slide" else self.body.values["length"]
        return z

    def _gravity(self, values) -> float:
        return 0.0 if self.body.kind == "slide" else values["gravity"]

    def torque(self, theta, q, qd, qdd) -> np.ndarray:
        inertia, weight = self._loads(theta)
        return inertia * np.asarray(qdd) + weight * np.sin(np.asarray(q))

    def gravity(self, theta, q) -> np.ndarray:
        return self._loads(theta)[1] * np.sin(np.asarray(q))

    def inertia(self, theta, q) -> np.ndarray:
        return np.full(np.shape(q), self._loads(theta)[0])

    def inertia_matrix(self, theta, q) -> np.ndarray:
        return self.inertia(theta, q)[:, :, None]

    def payload_torque(self, theta, z: float, q, qd, qdd) -> np.ndarray:
        """See `Mechanism.payload_torque`: z [m] along the lever; on a slide z means nothing."""
        if self.body.kind == "slide":
            return np.array(qdd, dtype=float)
        return z * z * np.asarray(qdd) + self._all(theta)["gravity"] * z * np.sin(np.asarray(q))

    def link_jacobian(self, theta, q, qd, qdd) -> np.ndarray:
        theta = np.asarray(theta, dtype=float)
        result = np.zeros(np.shape(q) + (len(theta),))
        for n in range(len(theta)):
            moved = theta.astype(complex)
            moved[n] += 1e-30j
            inertia, weight = (np.imag(value) * 1e30 for value in self._loads(moved))
            if inertia or weight:
                result[:, :, n] = inertia * np.asarray(qdd) + weight * np.sin(np.asarray(q))
        return result

    def drive(self, theta) -> Drive:
        v = self._all(theta)
        return Drive(
            volts_per_torque=np.array([v["resistance"] / (v["gear_ratio"] * v["torque_constant"])]),
            lag=np.array([v["inductance"] / v["resistance"]]),
            emf=np.array([v["back_emf"] * v["gear_ratio"]]),
            viscous=np.array([v["viscous_friction"]]),
            motor_inertia=np.array([v["motor_inertia"]]),
            resistance=np.array([v["resistance"]]),
        )
