# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Independent derivation of the rigid body, against which printed equations are held.

It uses neither the thesis's matrices nor the closed form: frames are products of elementary
rotations and translations, D is the quadratic form of the kinetic energy of bodies with an inertia
tensor (velocities by cross products), C are the Christoffel symbols of D, and G the derivative of
the potential energy, both by the complex step (Squire and Trapp, SIAM Review 40, 1998).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.kinematics import dh_table
from puma_sim_core.arm.parameters import load_parameters

_STEP = 1e-40

#: poses at which forms are compared: no symmetry of the arm, both signs of every sine and cosine
POSES = np.random.default_rng(560).uniform(-math.pi, math.pi, (12, 3))
RATES = np.random.default_rng(561).uniform(-2.0, 2.0, (12, 3))
ACCELERATIONS = np.random.default_rng(562).uniform(-6.0, 6.0, (12, 3))
JERKS = np.random.default_rng(563).uniform(-20.0, 20.0, (12, 3))
VISCOUS = np.array([0.3, 0.5, 0.2])


@cache
def nominal() -> ArmParameters:
    """The set behind the thesis's numbers."""
    return load_parameters("bejczy")


def rotation(axis: int, angle) -> np.ndarray:
    """(4, 4) elementary rotation about a coordinate axis (0, 1, 2)."""
    matrix = np.eye(4, dtype=np.result_type(angle, float))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix[j, j] = matrix[k, k] = np.cos(angle)
    matrix[k, j] = np.sin(angle)
    matrix[j, k] = -matrix[k, j]
    return matrix


def translation(x=0.0, y=0.0, z=0.0) -> np.ndarray:
    """(4, 4) elementary translation."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def frames(q, table) -> list[np.ndarray]:
    """Frames 0 to n in the base frame, by the composition of section 2.2.

    q : (n,) [rad], real or complex; table : rows (a, alpha, d).
    """
    found = [np.eye(4)]
    for angle, (a, alpha, d) in zip(q, table):
        found.append(found[-1] @ rotation(2, angle) @ translation(z=d) @ translation(x=a) @ rotation(0, alpha))
    return found


def inertia(q, arm: ArmParameters | None = None) -> np.ndarray:
    """D (3, 3) [kg.m^2] without motor inertias; q : (3,), real or complex."""
    arm = arm or nominal()
    chain = frames(q, dh_table(arm)[:3])
    total = np.zeros((3, 3), dtype=chain[-1].dtype)
    for p, link in enumerate(arm.links, start=1):
        turn, origin = chain[p][:3, :3], chain[p][:3, 3]
        spin = np.zeros((3, 3), dtype=total.dtype)
        speed = np.zeros((3, 3), dtype=total.dtype)
        for i in range(p):
            axis = chain[i][:3, 2]
            spin[:, i] = axis
            speed[:, i] = np.cross(axis, origin - chain[i][:3, 3])
        xy, yz, xz = link.products
        tensor = link.mass * (np.diag(link.gyration_squared) - np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]]))
        arm_of_mass = link.mass * (turn @ np.array(link.centre))
        # m v.(omega x c), once for each of the two factors of the quadratic form
        mixed = speed.T @ np.cross(spin, arm_of_mass[:, None], axis=0)
        total += link.mass * speed.T @ speed + mixed + mixed.T + spin.T @ turn @ tensor @ turn.T @ spin
    return total


def coriolis(q, arm: ArmParameters | None = None) -> np.ndarray:
    """C (3, 3, 3) [kg.m^2], Christoffel symbols of D; q : (3,), real."""
    slope = np.stack([inertia(_ahead(q, k), arm).imag / _STEP for k in range(3)], axis=-1)
    return 0.5 * (slope + slope.transpose(0, 2, 1) - slope.transpose(2, 0, 1))


def potential(q, arm: ArmParameters | None = None):
    """Potential energy [J]; q : (3,), real or complex."""
    arm = arm or nominal()
    chain = frames(q, dh_table(arm)[:3])
    return arm.gravity * sum(
        link.mass * (frame @ np.array([*link.centre, 1.0]))[2] for frame, link in zip(chain[1:], arm.links)
    )


def gravity(q, arm: ArmParameters | None = None) -> np.ndarray:
    """G (3,) [N.m]; q : (3,), real."""
    return np.array([potential(_ahead(q, k), arm).imag / _STEP for k in range(3)])


def torque(q, qd, qdd, arm: ArmParameters | None = None) -> np.ndarray:
    """Torque at the joints (3,) [N.m], motor inertias included, without friction."""
    arm = arm or nominal()
    return (
        (inertia(q, arm) + np.diag(arm.motor_inertia)) @ qdd
        + np.einsum("ijk,j,k->i", coriolis(q, arm), qd, qd)
        + gravity(q, arm)
    )


def at_poses(function) -> np.ndarray:
    """function(q) at each of POSES."""
    return np.array([function(q) for q in POSES])


def derivative(function, q, k: int):
    """d function / dq_k by the complex step; function must take complex angles."""
    return np.asarray(function(_ahead(q, k))).imag / _STEP


def _ahead(q, k):
    ahead = np.array(q, dtype=complex)
    ahead[k] += 1j * _STEP
    return ahead
