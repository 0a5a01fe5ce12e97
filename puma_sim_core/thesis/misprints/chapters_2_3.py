# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Proofs of the misprints of chapters 2 and 3 and of appendix A: kinematics and the general equations."""

from functools import reduce

import numpy as np

from puma_sim_core.arm.kinematics import dh_table, first_derivatives
from puma_sim_core.arm.rigid_body import arm_pseudo_inertias
from puma_sim_core.thesis.misprints import reference
from puma_sim_core.thesis.misprints.evidence import read_errata
from puma_sim_core.thesis.misprints.reference import ACCELERATIONS, POSES, RATES, along, at_poses, derivative, nominal

TABLE, BODIES = dh_table(nominal())[:3], arm_pseudo_inertias(nominal())

# ------------------------------------------------------------------------------------- chapter 2


def prove_joint_axes():
    q, turned = POSES[0], []
    chain = reference.frames(q, TABLE)
    for j in range(3):
        # joint j turns what is outside it about its axis
        slope = derivative(lambda x: reference.frames(x, TABLE)[-1][:3, :3], q, j)
        spin = slope @ chain[-1][:3, :3].T
        turned.append([spin[2, 1], spin[0, 2], spin[1, 0]])
    axes = [frame[:3, 2] for frame in chain]
    return turned, axes[:3], axes[1:]


def transforms(q, slip=None):
    """T1, T2, T3 of section 2.3 with one misprint."""
    a2, a3, d = nominal().a2, nominal().a3, nominal().d3
    (s1, s2, s3), (c1, c2, c3) = np.sin(q), np.cos(q)
    d2, d3 = d if slip == "d2" else 0, 0 if slip == "d3" else d
    height = a3 * (c3 if slip == "a3C3" else s3)
    return [
        np.array([[c1, 0, -s1, 0], [s1, 0, c1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
        np.array([[c2, -s2, 0, a2 * c2], [s2, c2, 0, a2 * s2], [0, 0, 1, d2], [0, 0, 0, 1]]),
        np.array([[c3, 0, s3, a3 * c3], [s3, 0, -c3, height], [0, 1, 0, d3], [0, 0, 0, 1]]),
    ]


def prove_offset(slip, reference):
    def d12(q, slip):
        """D12 in trace form with the derivatives of exactly these matrices."""

        def slope(count, joint):
            return derivative(lambda x: reduce(np.matmul, transforms(x, slip)[:count]), q, joint)

        return sum(np.trace(slope(p, 0) @ BODIES[p - 1] @ slope(p, 1).T) for p in (2, 3))

    q2, u = POSES[:, 1], POSES[:, 1] + POSES[:, 2]
    functions = np.column_stack([np.sin(q2), np.sin(u), np.cos(u), np.cos(q2)])
    values = np.transpose(at_poses(lambda q: d12(q, None), lambda q: d12(q, slip)))
    return reference, *np.linalg.lstsq(functions, values, rcond=None)[0][[0, 2]].T


def prove_elbow_offset():
    return at_poses(
        lambda q: reference.frames(q[2:], TABLE[2:])[1][1, 3],
        lambda q: transforms(q)[2][1, 3],
        lambda q: transforms(q, "a3C3")[2][1, 3],
    )


AXIS, SHIFT = np.array([2.0, -1.0, 2.0]) / 3.0, np.array([0.3, -0.2, 0.4])
#: the delta operator of a unit turn about AXIS and the translation SHIFT, section 2.5.2
DELTA = np.zeros((4, 4))
DELTA[:3] = np.column_stack([np.cross(AXIS, np.eye(3)).T, SHIFT])
PRINTED_DELTA = DELTA * [[1, 1, 1, 1], [1, 1, 1, 1], [1, -1, 1, 1], [1, 1, 1, 1]]


def turn_about_axis(angle):
    """(4, 4) rotation about AXIS by Rodrigues' formula, then the translation angle * SHIFT."""
    matrix = np.eye(4, dtype=complex)
    matrix[:3, :3] += np.sin(angle) * DELTA[:3, :3] + (1 - np.cos(angle)) * (np.outer(AXIS, AXIS) - np.eye(3))
    matrix[:3, 3] = angle * SHIFT
    return matrix


def prove_linear_part(size):
    return (matrix[:size, :size] for matrix in (along(turn_about_axis, (0.0, 1.0)), DELTA, PRINTED_DELTA))


def prove_rotation_corner(angle):
    first_order, point = np.eye(4) + angle * DELTA, np.array([0.1, 0.2, 0.3, 1.0])
    lost = first_order - np.diag([0, 0, 0, 1])
    return ((matrix @ point)[3] for matrix in (turn_about_axis(angle).real, first_order, lost))


# ------------------------------------------------------------------------- chapter 3 and appendix A

#: a bar that small masses stand for
MASSES = np.full(400, 7.0 / 400)
PLACES = np.random.default_rng(3).uniform(-1, 1, (400, 3)) * (0.05, 0.04, 0.3) + (0.0, 0.02, 0.1)
#: integrals of x^2, y^2 and z^2 over it
XX, YY, ZZ = MASSES @ PLACES**2


def prove_radius_of_gyration(power):
    mass = np.sum(MASSES)
    k = np.sqrt((YY + ZZ) / mass)
    return YY + ZZ, mass * k**2, mass * k**power


def prove_distance_from_y():
    return MASSES @ np.linalg.norm(np.cross(PLACES, [0.0, 1.0, 0.0]), axis=1) ** 2, XX + ZZ, XX + YY


def prove_integral_of_x_squared():
    rest = 0.5 * (XX + ZZ) + 0.5 * (XX + YY)
    return XX, -0.5 * (YY + ZZ) + rest, 0.5 * (YY - ZZ) + rest


def prove_integral_of_z_squared():
    total = (YY + ZZ) + (XX + ZZ) - (XX + YY)
    return ZZ, total / 2, total


def prove_fourth_element_of_gravity(correct, printed):
    def energy(q, fourth):
        vector, links = np.array([0.0, 0.0, -nominal().gravity, fourth]), nominal().links
        chain = reference.frames(q, TABLE)[1:]
        return -sum(link.mass * vector @ frame @ [*link.centre, 1.0] for frame, link in zip(chain, links))

    return at_poses(reference.potential, lambda q: energy(q, correct), lambda q: energy(q, printed))


def traces(q, indices):
    """trace(dT_p/dq_i J_p dT_p'/dq_j) by einsum's indices."""
    first = first_derivatives(q, TABLE)
    return np.einsum(indices, first, BODIES, first)


def prove_trace_of_inertia():
    correct, printed = "piab,pbc,pjac->ij", "pkab,pbc,pkac->k"
    return at_poses(reference.inertia, lambda q: traces(q, correct), lambda q: np.tile(traces(q, printed), (3, 1)))


def prove_lower_limit():
    i, j = np.indices((3, 3)) + 1
    links = np.argmax(np.abs(traces(POSES[1], "piab,pbc,pjac->pij")) > 1e-12, axis=0) + 1, np.maximum(i, j), i
    return (" ".join(map(str, each.ravel())) for each in links)


def prove_sign_of_gravity():
    def trace_form(q):
        return nominal().gravity * np.einsum("pib,pb->i", first_derivatives(q, TABLE)[:, :, 2], BODIES[:, :, 3])

    independent, correct = at_poses(reference.gravity, trace_form)
    return independent, correct, -correct


def prove_inner_velocities():
    (c,) = at_poses(reference.coriolis)
    return c[:, [1, 2], 0, 0], -c[:, 0, 0, [1, 2]], np.zeros((len(POSES), 2))


def prove_reflection():
    (c,) = at_poses(reference.coriolis)
    apart = np.max(np.abs(c + c.transpose(0, 3, 2, 1)), axis=0)
    i, j, k = np.indices((3, 3, 3))
    return 0.0, np.max(apart[(i >= j) & (k >= j)]), np.max(apart[(j >= k) & (j >= i)])


def prove_lagrange_dot():
    def to_position(q, qd):
        # dL/dq_i = sum over j, k of C_jik qd_j qd_k - G_i, since dD_jk/dq_i = C_jik + C_kij
        return np.einsum("jik,j,k->i", reference.coriolis(q), qd, qd) - reference.gravity(q)

    def by_velocity(q, qd, qdd):
        c = reference.coriolis(q)
        mass_rate = np.einsum("ijk,k->ij", c, qd) + np.einsum("jik,k->ij", c, qd)
        return (reference.inertia(q) + np.diag(nominal().motor_inertia)) @ qdd + mass_rate @ qd - to_position(q, qd)

    def by_position(q, qd, qdd, h=1e-6):
        # both terms hold dL/dq then: its rate of change, by a difference of the exact values
        ahead, behind = (to_position(q + step * qd, qd + step * qdd) for step in (h, -h))
        return (ahead - behind) / (2 * h) - to_position(q, qd)

    return reference.over(list(zip(POSES, RATES, ACCELERATIONS)), reference.torque, by_velocity, by_position)


ROWS = read_errata("errata_chapters_2_3.yaml", globals())
