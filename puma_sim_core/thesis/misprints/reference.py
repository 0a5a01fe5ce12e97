# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Independent derivation of the rigid body, against which printed equations are held.

It uses neither the thesis's matrices nor the closed form: frames are products of elementary
rotations and translations, D is the quadratic form of the kinetic energy of bodies with an inertia
tensor (velocities by cross products), C are the Christoffel symbols of D, and G the derivative of
the potential energy, both by the complex step (Squire and Trapp, SIAM Review 40, 1998).
"""

from functools import cache

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.kinematics import dh_table
from puma_sim_core.arm.parameters import load_parameters

_STEP = 1e-40

#: poses at which forms are compared: no symmetry of the arm, both signs of every sine and cosine
POSES = np.random.default_rng(560).uniform(-np.pi, np.pi, (12, 3))
RATES = np.random.default_rng(561).uniform(-2.0, 2.0, (12, 3))
ACCELERATIONS = np.random.default_rng(562).uniform(-6.0, 6.0, (12, 3))
JERKS = np.random.default_rng(563).uniform(-20.0, 20.0, (12, 3))
VISCOUS = np.array([0.3, 0.5, 0.2])


@cache
def nominal() -> ArmParameters:
    """The set behind the thesis's numbers."""
    return load_parameters("bejczy")


def along(function, *pairs):
    """Rate of function(x, ...) while each argument x moves at its rate, by the complex step; pairs: (x, rate)."""
    return np.asarray(function(*(x + 1j * _STEP * rate for x, rate in pairs))).imag / _STEP


def derivative(function, q, k: int):
    """d function / dq_k; function must take complex angles."""
    return along(function, (q, np.eye(len(q))[k]))


def over(states, *functions) -> list[np.ndarray]:
    """Values of each function at each of the states, which are tuples of its arguments."""
    return [np.array([function(*state) for state in states]) for function in functions]


def at_poses(*functions) -> list[np.ndarray]:
    """Values of each function(q) at each of POSES."""
    return over(POSES[:, None], *functions)


def rotation(axis: int, angle) -> np.ndarray:
    """(4, 4) elementary rotation about a coordinate axis (0, 1, 2)."""
    matrix = np.eye(4, dtype=np.result_type(angle, float))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix[j, j] = matrix[k, k] = np.cos(angle)
    matrix[k, j] = np.sin(angle)
    matrix[j, k] = -matrix[k, j]
    return matrix


def frames(q, table) -> list[np.ndarray]:
    """Frames 0 to n in the base frame, by the composition of section 2.2.

    q : (n,) [rad], real or complex; table : rows (a, alpha, d).
    """
    found = [np.eye(4)]
    for angle, (a, alpha, d) in zip(q, table):
        shift = np.eye(4)
        shift[:3, 3] = a, 0.0, d
        found.append(found[-1] @ rotation(2, angle) @ shift @ rotation(0, alpha))
    return found


def inertia(q, arm: ArmParameters | None = None) -> np.ndarray:
    """D (3, 3) [kg.m^2] without motor inertias; q : (3,), real or complex."""
    arm = arm or nominal()
    chain = frames(q, dh_table(arm)[:3])
    total = np.zeros((3, 3), dtype=chain[-1].dtype)
    for p, link in enumerate(arm.links, start=1):
        turn, origin = chain[p][:3, :3], chain[p][:3, 3]
        spin, speed = np.zeros((2, 3, 3), dtype=total.dtype)
        for i, frame in enumerate(chain[:p]):
            spin[:, i] = frame[:3, 2]
            speed[:, i] = np.cross(frame[:3, 2], origin - frame[:3, 3])
        xy, yz, xz = link.products
        tensor = link.mass * (np.diag(link.gyration_squared) - np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]]))
        arm_of_mass = link.mass * (turn @ np.array(link.centre))
        # m v.(omega x c), once for each of the two factors of the quadratic form
        mixed = speed.T @ np.cross(spin, arm_of_mass[:, None], axis=0)
        total += link.mass * speed.T @ speed + mixed + mixed.T + spin.T @ turn @ tensor @ turn.T @ spin
    return total


def coriolis(q, arm: ArmParameters | None = None) -> np.ndarray:
    """C (3, 3, 3) [kg.m^2], Christoffel symbols of D; q : (3,), real."""
    slope = np.stack([derivative(lambda x: inertia(x, arm), q, k) for k in range(3)], axis=-1)
    return 0.5 * (slope + slope.transpose(0, 2, 1) - slope.transpose(2, 0, 1))


def potential(q, arm: ArmParameters | None = None):
    """Potential energy [J]; q : (3,), real or complex."""
    arm = arm or nominal()
    centres = [frame @ [*link.centre, 1.0] for frame, link in zip(frames(q, dh_table(arm)[:3])[1:], arm.links)]
    return arm.gravity * sum(link.mass * centre[2] for link, centre in zip(arm.links, centres))


def gravity(q, arm: ArmParameters | None = None) -> np.ndarray:
    """G (3,) [N.m]; q : (3,), real."""
    return np.array([derivative(lambda x: potential(x, arm), q, k) for k in range(3)])


def torque(q, qd, qdd, arm: ArmParameters | None = None) -> np.ndarray:
    """Torque at the joints (3,) [N.m], motor inertias included, without friction."""
    mass = inertia(q, arm) + np.diag((arm or nominal()).motor_inertia)
    return mass @ qdd + np.einsum("ijk,j,k->i", coriolis(q, arm), qd, qd) + gravity(q, arm)
