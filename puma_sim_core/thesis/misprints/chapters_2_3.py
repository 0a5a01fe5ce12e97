# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Misprints of chapters 2 and 3 and of appendix A: kinematics and the general equations."""

from __future__ import annotations

import numpy as np

from puma_sim_core.arm.kinematics import dh_table, first_derivatives
from puma_sim_core.arm.rigid_body import arm_pseudo_inertias
from puma_sim_core.thesis.misprints import reference
from puma_sim_core.thesis.misprints.evidence import Erratum, Evidence
from puma_sim_core.thesis.misprints.reference import POSES, RATES, at_poses, nominal

# ------------------------------------------------------------------------------------- chapter 2


def _joint_axes():
    """Joint j turns what is outside it about an axis; frames give two candidates."""
    table = dh_table(nominal())[:3]
    q = POSES[0]
    turned, inner, outer = [], [], []
    for j in range(3):
        chain = reference.frames(q, table)
        slope = reference.derivative(lambda x: reference.frames(x, table)[-1][:3, :3], q, j)
        spin = slope @ chain[-1][:3, :3].T
        turned.append([spin[2, 1], spin[0, 2], spin[1, 0]])
        inner.append(chain[j][:3, 2])
        outer.append(chain[j + 1][:3, 2])
    return Evidence(
        "axis of each joint (unit vectors)",
        "",
        "derivative of the orientation of the last link",
        np.array(turned),
        np.array(inner),
        np.array(outer),
        1e-12,
    )


def _thesis_transforms(q, slip):
    """T1, T2, T3 of section 2.3 with one misprint."""
    arm = nominal()
    (s1, s2, s3), (c1, c2, c3) = np.sin(q), np.cos(q)
    a2, a3, d = arm.a2, arm.a3, arm.d3
    return [
        np.array([[c1, 0, -s1, 0], [s1, 0, c1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
        np.array([[c2, -s2, 0, a2 * c2], [s2, c2, 0, a2 * s2], [0, 0, 1, d if slip == "d2" else 0], [0, 0, 0, 1]]),
        np.array(
            [
                [c3, 0, s3, a3 * c3],
                [s3, 0, -c3, a3 * (c3 if slip == "a3C3" else s3)],
                [0, 1, 0, 0 if slip == "d3" else d],
                [0, 0, 0, 1],
            ]
        ),
    ]


def _wrist_side_moment(slip):
    """Coefficients of S2 and C23 in D12 from the chain that the matrices describe."""
    arm = nominal()

    def d12(q):
        # trace form with the derivatives of exactly these matrices
        def chain(x, count):
            product = np.eye(4)
            for step in _thesis_transforms(x, slip)[:count]:
                product = product @ step
            return product

        bodies = arm_pseudo_inertias(arm)
        return sum(
            np.trace(
                reference.derivative(lambda x, p=p: chain(x, p), q, 0)
                @ bodies[p - 1]
                @ reference.derivative(lambda x, p=p: chain(x, p), q, 1).T
            )
            for p in (2, 3)
        )

    values = at_poses(d12)
    q2, u = POSES[:, 1], POSES[:, 1] + POSES[:, 2]
    basis = np.column_stack([np.sin(q2), np.sin(u), np.cos(u), np.cos(q2)])
    return np.linalg.lstsq(basis, values, rcond=None)[0][[0, 2]]


def _offset(slip):
    def evidence():
        return Evidence(
            "coefficients of S2 and of C23 in D12",
            "kg.m^2",
            "the thesis's own number in section 4.5",
            [2.4492, -0.1596],
            _wrist_side_moment(""),
            _wrist_side_moment(slip),
            2e-4,
        )

    return evidence


def _elbow_offset():
    table = dh_table(nominal())[2:3]
    return Evidence(
        "third transform",
        "m",
        "product of its four elementary movements",
        at_poses(lambda q: reference.frames(q[2:], table)[1][1, 3]),
        at_poses(lambda q: _thesis_transforms(q, "")[2][1, 3]),
        at_poses(lambda q: _thesis_transforms(q, "a3C3")[2][1, 3]),
        1e-12,
    )


_AXIS = np.array([2.0, -1.0, 2.0]) / 3.0
_SHIFT = np.array([0.3, -0.2, 0.4])


def _turn_about_axis(angle):
    """(4, 4) rotation about _AXIS by Rodrigues' formula, then the translation angle * _SHIFT."""
    kx, ky, kz = _AXIS
    cross = np.array([[0, -kz, ky], [kz, 0, -kx], [-ky, kx, 0]])
    matrix = np.eye(4, dtype=complex)
    matrix[:3, :3] = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (np.outer(_AXIS, _AXIS) - np.eye(3))
    matrix[:3, 3] = angle * _SHIFT
    return matrix


def _delta(sign, corner=0.0):
    kx, ky, kz = _AXIS
    matrix = np.array(
        [[0, -kz, ky, _SHIFT[0]], [kz, 0, -kx, _SHIFT[1]], [-ky, sign * kx, 0, _SHIFT[2]], [0, 0, 0, corner]]
    )
    return matrix


def _rotation_sign():
    slope = _turn_about_axis(1e-40j).imag[:3, :3] / 1e-40
    return Evidence(
        "part of Rot(k, dq) that is linear in dq",
        "",
        "derivative of the exact rotation (Rodrigues)",
        slope,
        _delta(1)[:3, :3],
        _delta(-1)[:3, :3],
        1e-12,
    )


def _rotation_corner():
    moved = _turn_about_axis(1e-9).real @ np.array([0.1, 0.2, 0.3, 1.0])
    first_order = np.eye(4) + 1e-9 * _delta(1)
    lost = first_order.copy()
    lost[3, 3] = 0.0
    point = np.array([0.1, 0.2, 0.3, 1.0])
    return Evidence(
        "scale (fourth element) of a point after Rot(k, dq)",
        "",
        "a point's fourth element is 1 in every frame (section 2.5)",
        moved[3],
        (first_order @ point)[3],
        (lost @ point)[3],
        1e-12,
    )


def _delta_sign():
    return Evidence(
        "delta operator for a turn and a shift",
        "1/rad",
        "derivative of the exact rotation and translation",
        _turn_about_axis(1e-40j).imag / 1e-40,
        _delta(1),
        _delta(-1),
        1e-12,
    )


# ------------------------------------------------------------------------------------- chapter 3


def _cylinder():
    """Mass and moments of inertia about x, y, z of a bar, summed over small masses."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (400, 3)) * (0.05, 0.04, 0.3) + (0.0, 0.02, 0.1)
    dm = np.full(400, 7.0 / 400)
    x, y, z = points.T
    return dm, x, y, z


def _gyration_definition():
    dm, _x, y, z = _cylinder()
    inertia, mass = np.sum(dm * (y**2 + z**2)), np.sum(dm)
    k = np.sqrt(inertia / mass)
    return Evidence(
        "moment of inertia of a body from its radius of gyration",
        "kg.m^2",
        "sum over 400 small masses",
        inertia,
        mass * k**2,
        mass * k,
        1e-12,
    )


def _gyration_distance():
    dm, _x, y, z = _cylinder()
    inertia, mass = np.sum(dm * (y**2 + z**2)), np.sum(dm)
    k = np.sqrt(inertia / mass)
    return Evidence(
        "moment of inertia of the whole mass at the stated distance",
        "kg.m^2",
        "sum over 400 small masses",
        inertia,
        mass * k**2,
        mass * (k**2) ** 2,
        1e-12,
    )


def _third_product():
    return Evidence(
        "products of inertia that the list names",
        "",
        "elements above the diagonal of the pseudo inertia, equation 3.8",
        frozenset({"xy", "xz", "yz"}),
        frozenset(("xy", "xz", "yz")),
        frozenset(("xy", "xz", "xy")),
    )


def _gravity_fourth():
    arm = nominal()
    g = np.array([0.0, 0.0, -arm.gravity, 0.0])

    def energy(q, vector):
        chain = reference.frames(q, dh_table(arm)[:3])[1:]
        return -sum(link.mass * vector @ frame @ np.array([*link.centre, 1.0]) for frame, link in zip(chain, arm.links))

    return Evidence(
        "potential energy, equation 3.17",
        "J",
        "m g h of the centres of mass",
        at_poses(reference.potential),
        at_poses(lambda q: energy(q, g)),
        at_poses(lambda q: energy(q, g + [0, 0, 0, 1.0])),
        1e-10,
    )


def _first_trace(printed):
    arm = nominal()
    bodies = arm_pseudo_inertias(arm)

    def rows(q):
        first = first_derivatives(q, dh_table(arm)[:3])
        if printed:
            column = np.einsum("pkab,pbc,pkac->k", first, bodies, first)
            return np.tile(column, (3, 1))
        return np.einsum("pkab,pbc,piac->ik", first, bodies, first)

    return at_poses(rows)


def _equation_3_20():
    return Evidence(
        "coefficients of the accelerations",
        "kg.m^2",
        "kinetic energy of the bodies",
        at_poses(reference.inertia),
        _first_trace(False),
        _first_trace(True),
        1e-10,
    )


def _first_link(rule):
    return " ".join(str(rule(i, j)) for i in (1, 2, 3) for j in (1, 2, 3))


def _lower_limit():
    arm = nominal()
    first = first_derivatives(POSES[1], dh_table(arm)[:3])
    bodies = arm_pseudo_inertias(arm)
    terms = np.einsum("piab,pbc,pjac->pij", first, bodies, first)
    begins = _first_link(lambda i, j: int(np.argmax(np.abs(terms[:, i - 1, j - 1]) > 1e-12)) + 1)
    return Evidence(
        "first link that adds to D11, D12 ... D33",
        "",
        "terms of the sum over the links that are not zero",
        begins,
        _first_link(max),
        _first_link(lambda i, j: i),
    )


def _gravity_sign():
    arm = nominal()
    g = np.array([0.0, 0.0, -arm.gravity, 0.0])

    def equation(q, sign):
        first = first_derivatives(q, dh_table(arm)[:3])
        moments = [link.mass * np.array([*link.centre, 1.0]) for link in arm.links]
        return sign * np.einsum("a,piab,pb->i", g, first, np.array(moments))

    return Evidence(
        "gravity torque",
        "N.m",
        "derivative of the potential energy",
        at_poses(reference.gravity),
        at_poses(lambda q: equation(q, -1)),
        at_poses(lambda q: equation(q, 1)),
        1e-10,
    )


def _inner_velocities():
    def squares(q):
        return reference.coriolis(q)[[1, 2], [0, 0], [0, 0]]

    from_4_27 = at_poses(lambda q: -reference.coriolis(q)[0, 0, [1, 2]])
    return Evidence(
        "C211 and C311",
        "kg.m^2",
        "Christoffel symbols of D",
        at_poses(squares),
        from_4_27,
        np.zeros((len(POSES), 2)),
        1e-10,
    )


def _reflection():
    """C_ijk = -C_kji, for the index ranges of the formula and for those of the sentence."""

    def worst(allowed):
        return max(
            abs(c[i, j, k] + c[k, j, i])
            for c in map(reference.coriolis, POSES)
            for i in range(3)
            for j in range(3)
            for k in range(3)
            if allowed(i, j, k)
        )

    return Evidence(
        "greatest |C_ijk + C_kji| over the indices that are named",
        "kg.m^2",
        "Christoffel symbols of D",
        0.0,
        worst(lambda i, j, k: i >= j and k >= j),
        worst(lambda i, j, k: j >= k and j >= i),
        1e-10,
    )


def _lagrange_dot():
    """d/dt of the derivative of L to the velocity, and to the position, less dL/dq."""

    def sides(q, qd, qdd, to_velocity):
        arm = nominal()
        added = np.diag(arm.motor_inertia)
        c, g = reference.coriolis(q, arm), reference.gravity(q, arm)
        # dL/dq_i = sum over j, k of C_jik qd_j qd_k - G_i, since dD_jk/dq_i = C_jik + C_kij
        along = np.einsum("jik,j,k->i", c, qd, qd) - g
        slope = np.einsum("ijk,k->ij", c, qd) + np.einsum("jik,k->ij", c, qd)
        momentum_rate = (reference.inertia(q, arm) + added) @ qdd + slope @ qd
        if to_velocity:
            return momentum_rate - along
        # both terms hold dL/dq then: its rate of change, by a difference of the exact values
        h = 1e-6
        ahead, behind = (
            np.einsum("jik,j,k->i", reference.coriolis(q + s * h * qd, arm), qd + s * h * qdd, qd + s * h * qdd)
            - reference.gravity(q + s * h * qd, arm)
            for s in (1, -1)
        )
        return (ahead - behind) / (2 * h) - along

    states = list(zip(POSES, RATES, reference.ACCELERATIONS))
    return Evidence(
        "torque at the joints",
        "N.m",
        "equation of motion of the bodies",
        np.array([reference.torque(*s) for s in states]),
        np.array([sides(*s, True) for s in states]),
        np.array([sides(*s, False) for s in states]),
        1e-9,
    )


# ------------------------------------------------------------------------------------ appendix A


def _axis_distance():
    dm, x, y, z = _cylinder()
    points = np.column_stack([x, y, z])
    along = np.array([0.0, 1.0, 0.0])
    distance = np.linalg.norm(np.cross(points, along), axis=1)
    return Evidence(
        "moment of inertia about the y axis",
        "kg.m^2",
        "squared distance of 400 small masses from the axis",
        np.sum(dm * distance**2),
        np.sum(dm * (x**2 + z**2)),
        np.sum(dm * (x**2 + y**2)),
        1e-12,
    )


def _second_moment():
    dm, x, y, z = _cylinder()
    rest = 0.5 * np.sum(dm * (x**2 + z**2)) + 0.5 * np.sum(dm * (x**2 + y**2))
    return Evidence(
        "integral of x^2 dm",
        "kg.m^2",
        "sum over 400 small masses",
        np.sum(dm * x**2),
        -0.5 * np.sum(dm * (y**2 + z**2)) + rest,
        0.5 * np.sum(dm * (y**2 - z**2)) + rest,
        1e-12,
    )


def _pseudo_half():
    dm, x, y, z = _cylinder()
    ixx, iyy, izz = (np.sum(dm * v) for v in (y**2 + z**2, x**2 + z**2, x**2 + y**2))
    return Evidence(
        "element (3,3) of the pseudo inertia",
        "kg.m^2",
        "sum over 400 small masses",
        np.sum(dm * z**2),
        (ixx + iyy - izz) / 2,
        ixx + iyy - izz,
        1e-12,
    )


ROWS = (
    Erratum(
        "2.2 axis",
        "section 2.2, choice of the axes",
        "z of frame n is the axis of joint n",
        "z of frame n is the axis of joint n + 1",
        _joint_axes,
        "The origin and the matrices of the same section have it right.",
    ),
    Erratum(
        "2.3 T2(3,4)",
        "section 2.3, T2 element (3,4)",
        "d2",
        "0",
        _offset("d2"),
        "With d3 in the third transform; d2 is taken as the same 0.1505 m.",
    ),
    Erratum(
        "2.3 T3(3,4)",
        "section 2.3, T3 element (3,4)",
        "0",
        "d3",
        _offset("d3"),
        "Equations 4.9 to 4.26 hold with the offset in the third transform only.",
    ),
    Erratum("2.3 T3(2,4)", "section 2.3, T3 element (2,4)", "a3 C3", "a3 S3", _elbow_offset),
    Erratum("2.5.2 Rot(3,2)", "section 2.5.2, Rot(k, dq) element (3,2)", "-kx dq", "+kx dq", _rotation_sign),
    Erratum("2.5.2 Rot(4,4)", "section 2.5.2, Rot(k, dq) element (4,4)", "0", "1", _rotation_corner),
    Erratum(
        "2.5.2 Delta(3,2)",
        "section 2.5.2, delta operator element (3,2)",
        "-kx dq",
        "+kx dq",
        _delta_sign,
        "No number depends on it: for the joints kx = 0 (equation 2.1).",
    ),
    Erratum(
        "3.10 k",
        "equation 3.10, first line",
        "m k = I",
        "m k^2 = I",
        _gyration_definition,
        "Its other lines have the square; the tables list k^2.",
    ),
    Erratum(
        "3.10 distance",
        "section 3.2.1 and appendix A, radius of gyration",
        "all the mass a distance k^2 from the axis",
        "all the mass a distance k from the axis",
        _gyration_distance,
    ),
    Erratum(
        "3.10 products",
        "section 3.2.1 and appendix A, list of the products of inertia",
        "I_xy, I_xz, I_xy",
        "I_xy, I_xz, I_yz",
        _third_product,
    ),
    Erratum(
        "3.14 g",
        "section 3.2.2, gravity vector",
        "g' = (gx gy gz 1)",
        "g' = (gx gy gz 0)",
        _gravity_fourth,
        "A constant in the energy: no torque depends on it.",
    ),
    Erratum(
        "3.19 dot",
        "section 3.1.1 and equation 3.19",
        "d/dt (dL/dq) - dL/dq",
        "d/dt (dL/dqd) - dL/dq",
        _lagrange_dot,
        "A dot that print or scan lost.",
    ),
    Erratum("3.20 trace", "equation 3.20, first trace", "dT/dq_k J dT'/dq_k", "dT/dq_k J dT'/dq_i", _equation_3_20),
    Erratum(
        "3.23 limit",
        "section 4.2, D_ij (equation 3.23)",
        "sum from p = i",
        "sum from p = max(i, j)",
        _lower_limit,
        "No number depends on it: the terms too many are zero.",
    ),
    Erratum(
        "3.28 sign",
        "equation 3.28",
        "G_i = sum m g' dT r",
        "G_i = - sum m g' dT r",
        _gravity_sign,
        "Section 4.2 prints it with its minus.",
    ),
    Erratum(
        "3.3.3 inner",
        "section 3.3.3",
        "no Coriolis force on joint i from velocities of joints j, k if j or k < i",
        "C211 = -C112 and C311 = -C113 are such forces",
        _inner_velocities,
    ),
    Erratum(
        "3.3.3 reflection",
        "section 3.3.3, reflective coupling in words",
        "for j >= k, i",
        "for i, k >= j",
        _reflection,
        "The formula beside it has the right indices; the sentence also calls link k link m.",
    ),
    Erratum("A dIyy", "appendix A, dI_yy", "(x^2 + y^2) dm", "(x^2 + z^2) dm", _axis_distance),
    Erratum(
        "A x^2", "appendix A, integral of x^2, first term", "+1/2 of y^2 - z^2", "-1/2 of y^2 + z^2", _second_moment
    ),
    Erratum(
        "A J(3,3)",
        "appendix A, J element (3,3)",
        "I_xx + I_yy - I_zz over nothing",
        "(I_xx + I_yy - I_zz) / 2",
        _pseudo_half,
        "The denominator may be lost in the scan.",
    ),
)
