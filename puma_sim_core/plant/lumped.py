# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Torques of mechanisms by the constants of the arm.

The torques of an arm, and of any part of it, are linear in the constants of `rigid_body.Lumps`: one table of sines,
speeds and accelerations serves the torque and all of its derivatives. A part reads the rows of its own joints, with
those that are held at rest.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters, Link
from puma_sim_core.arm.loads import with_point_mass
from puma_sim_core.arm.rigid_body import Lumps, lumped_constants
from puma_sim_core.plant.carrier import Layout, turned
from puma_sim_core.plant.mechanism import Mechanism, complex_slope

#: the constants that the link torques are linear in: `Lumps` but for E4, which is E0 + Ia3
LUMPS = Lumps._fields[:15] + Lumps._fields[16:]
#: an arm whose joints all move
WHOLE = Layout((0, 1, 2), (0.0, 0.0, 0.0), (0.0, 0.0))


@dataclass(frozen=True, eq=False)
class LumpedMechanism(Mechanism):
    """A `Mechanism` whose links are those of an arm.

    arm : that of the start; layout : which of its joints move.
    """

    arm: ArmParameters = field(kw_only=True)
    layout: Layout = field(default=WHOLE, kw_only=True)

    @abstractmethod
    def arm_of(self, theta: ArrayLike | None = None) -> ArmParameters:
        """The arm with the numbers of theta, real or complex, without loads."""

    def turn_of(self, theta: ArrayLike | None = None) -> tuple[Any, Any]:
        """Angles of the arm's joints 2 and 3 at position 0 with the numbers of theta, real or complex."""
        return self.layout.turn

    def of_links(self, name: str) -> bool:
        """Whether the torques of the links depend on the parameter of this name."""
        return True

    def lumps(self, theta: ArrayLike | None = None) -> np.ndarray:
        """(19,) constants `LUMPS` of the links and what they carry, without motor inertias."""
        turn = self.turn_of(theta)
        return self._constants(self.arm_of(theta), turn) + self._load_lumps(turn)

    @staticmethod
    def _constants(arm: ArmParameters, turn: tuple[Any, Any]) -> np.ndarray:
        """(19,) constants `LUMPS` of an arm's links, real or complex."""
        first, second, third = (replace(motor, inertia=0.0) for motor in arm.motors)
        k = turned(lumped_constants(replace(arm, motors=(first, second, third))), turn)
        return np.array(k[:15] + k[16:])

    def _load_lumps(self, turn: tuple[Any, Any]) -> np.ndarray:
        """What the payloads of the model add; of theta it depends on the turn alone."""
        loads = [effect for effect in self.effects if effect.kind.load is not None]
        if not loads:
            return np.zeros(len(LUMPS))
        loaded = self.arm
        for effect in loads:
            assert effect.kind.load is not None
            loaded = effect.kind.load(loaded, effect.on(self.arm).values)
        return self._constants(loaded, turn) - self._constants(self.arm, turn)

    def _poses(self, q: ArrayLike) -> np.ndarray:
        """(n, 3) positions of the arm's joints for those (n, J) that move."""
        q = np.asarray(q, dtype=float)
        out = np.tile(self.layout.rest, (len(q), 1))
        out[:, self.layout.axes] = q
        return out

    def _table(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        """(n, J, 19) factors of the constants in the torques of the joints that move."""
        axes, n = list(self.layout.axes), len(np.asarray(q))
        rates = np.zeros((2, n, 3))
        rates[0][:, axes], rates[1][:, axes] = qd, qdd
        return lump_table(self._poses(q), *rates)[:, axes]

    def torque(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        table = self._table(q, qd, qdd)
        return (table.reshape(-1, len(LUMPS)) @ self.lumps(theta)).reshape(-1, self.joints)

    def gravity(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        return self._weights(theta, q)[:, self.layout.axes]

    def _weights(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        """(n, 3) gravity torques of the arm's joints."""
        q = self._poses(q)
        g1, g2, g3, g4 = self.lumps(theta)[-4:]
        u = q[:, 1] + q[:, 2]
        third = g1 * np.cos(u) + g2 * np.sin(u)
        second = g3 * np.cos(q[:, 1]) + g4 * np.sin(q[:, 1]) + third
        return np.stack([np.zeros_like(third), second, third], axis=1)

    def inertia(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray:
        return np.diagonal(self.inertia_matrix(theta, q), axis1=1, axis2=2)

    def inertia_matrices(self, q: ArrayLike) -> Callable[[ArrayLike | None], np.ndarray]:
        still = np.zeros(np.shape(q))
        tables = [self._table(q, still, still + unit) for unit in np.eye(self.joints)]

        def matrices(theta: ArrayLike | None) -> np.ndarray:
            weight = self.lumps(theta)
            weight[-4:] = 0.0
            return np.stack([table @ weight for table in tables], axis=-1)

        return matrices

    def gravity_tilt(self, theta: ArrayLike | None, q: ArrayLike) -> np.ndarray | None:
        """See `Mechanism.gravity_tilt`: per rad, gravity points along (x, y, -1) of the base.

        Joint 1 gets (-x S1 + y C1) G2 and the moment of the masses beside the plane of the arm. None where the base
        does not turn.
        """
        if 0 not in self.layout.axes:
            return None
        arm, pose = self.arm_of(theta), self._poses(q)
        g, lumps = arm.gravity, self.lumps(theta)
        g1, g2, g3, g4 = lumps[-4:]
        first, second, third = arm.links
        loads = [e.values for e in self.effects if e.kind.load is not None]
        load, beside = sum(v["mass"] for v in loads), sum(v["mass"] * v["y"] for v in loads)
        # moments of mass [kg.m] times g: along the arm, and beside its plane
        along = g * first.mass * first.centre[0] - self._weights(theta, q)[:, 1]
        side = g * (
            first.mass * first.centre[2]
            + second.mass * second.centre[2]
            + third.mass * (arm.d3 + third.centre[1])
            + load * arm.d3
            + beside
        )
        s1, c1, u = np.sin(pose[:, 0]), np.cos(pose[:, 0]), pose[:, 1] + pose[:, 2]
        inward = g1 * np.sin(u) - g2 * np.cos(u)  # g d(along)/dq3
        both = g3 * np.sin(pose[:, 1]) - g4 * np.cos(pose[:, 1]) + inward
        slopes = np.stack([np.zeros_like(u), both, inward], axis=1)
        result = np.empty(pose.shape + (2,))
        result[:, :, 0] = -slopes * c1[:, None]
        result[:, :, 1] = -slopes * s1[:, None]
        result[:, 0, 0] = along * s1 + side * c1
        result[:, 0, 1] = -along * c1 + side * s1
        return result[:, self.layout.axes]

    def payload_torque(
        self, theta: ArrayLike | None, at: tuple[float, float, float], q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
    ) -> np.ndarray:
        """See `Mechanism.payload_torque`; on a slide the place means nothing."""
        at = at if self.position_unit == "rad" else (0.0, 0.0, 1.0)
        nothing = Link(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        load = with_point_mass(replace(self.arm, links=(nothing,) * 3), 1.0, *at)
        return self._table(q, qd, qdd) @ self._constants(load, self.turn_of(theta))

    def link_jacobian(self, theta: ArrayLike | None, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> np.ndarray:
        theta = self.start if theta is None else theta
        slopes = np.zeros((len(LUMPS), len(self.free)))
        for n, parameter in enumerate(self.free):
            if self.of_links(parameter.name):
                slopes[:, n] = complex_slope(self.lumps, theta, n)
        table = self._table(q, qd, qdd)
        return (table.reshape(-1, len(LUMPS)) @ slopes).reshape(len(table), self.joints, len(self.free))


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
