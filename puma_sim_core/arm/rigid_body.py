# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The rigid body: inertia D, centripetal and Coriolis coefficients C, gravity torque G.

The closed form (equations 4.9 to 4.47, with their misprints corrected and with products of inertia)
is a handful of constants times sines and cosines of q2, q3 and q2 + q3, in
``F = (D + Ia) qdd + qd' C qd + G``. Tests compare it with the trace form (equations 3.22 to 3.28).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters, Link
from puma_sim_core.arm.kinematics import as_angles


class Lumps(NamedTuple):
    """The arm as 20 constants [kg.m^2; g1 to g4: N.m], u = q2 + q3.

    ====  =========================================================================
    D11   A0 + A1 C2^2 + A2 S2 C2 + A3 Cu^2 + A4 Su Cu + A5 C2 Cu + A6 C2 Su
    D13   B1 Su + B2 Cu
    D12   B3 S2 + B4 C2 + D13
    D33   E0
    h     E1 C3 + E2 S3
    D23   E0 + h
    D22   E3 + 2 h
    G3    g1 Cu + g2 Su
    G2    g3 C2 + g4 S2 + G3
    ====  =========================================================================

    A0 and E3 hold the motor inertias Ia1 and Ia2, and E4 = E0 + Ia3, as the equations of motion
    need them.
    """

    A0: float
    A1: float
    A2: float
    A3: float
    A4: float
    A5: float
    A6: float
    B1: float
    B2: float
    B3: float
    B4: float
    E0: float
    E1: float
    E2: float
    E3: float
    E4: float
    g1: float
    g2: float
    g3: float
    g4: float


def lumped_constants(arm: ArmParameters) -> Lumps:
    """Constants of the closed form, equations 4.9 to 4.47 with products of inertia.

    With X the distance of a mass point from the base axis along the arm, Y its depth below the
    shoulder and w its distance beside the plane of the arm, D11 is the integral of X^2 + w^2,
    D12 and D13 are those of w times the derivatives of X, and the rest belongs to the plane arm.
    """
    a2, a3, d3, g = arm.a2, arm.a3, arm.d3, arm.gravity
    link1, link2, link3 = arm.links
    ia1, ia2, ia3 = (motor.inertia for motor in arm.motors)
    m2, m3 = link2.mass, link3.mass
    x2, y2, z2 = (m2 * value for value in link2.centre)
    x3, y3, z3 = (m3 * value for value in link3.centre)
    xx2, yy2, zz2 = _second_moments(link2)
    xx3, yy3, zz3 = _second_moments(link3)
    xy2, yz2, xz2 = (m2 * value for value in link2.products)
    xy3, yz3, xz3 = (m3 * value for value in link3.products)

    upper = m2 * a2 * a2 + 2 * a2 * x2 + xx2  # of (a2 + x)^2 over link 2
    fore = m3 * a3 * a3 + 2 * a3 * x3 + xx3  # of (a3 + x)^2 over link 3
    reach = m3 * a3 + x3  # of a3 + x over link 3
    e0 = fore + zz3
    return Lumps(
        A0=link1.mass * link1.gyration_squared[1] + ia1 + yy2 + zz2 + yy3 + zz3 + m3 * d3 * d3 + 2 * d3 * y3,
        A1=upper - yy2 + m3 * a2 * a2,
        A2=-2 * (a2 * y2 + xy2),
        A3=fore - zz3,
        A4=2 * (a3 * z3 + xz3),
        A5=2 * a2 * reach,
        A6=2 * a2 * z3,
        B1=d3 * reach + a3 * y3 + xy3,
        B2=-(d3 * z3 + yz3),
        B3=a2 * z2 + xz2 + a2 * (m3 * d3 + y3),
        B4=yz2,
        E0=e0,
        E1=a2 * reach,
        E2=a2 * z3,
        E3=upper + yy2 + m3 * a2 * a2 + e0 + ia2,
        E4=e0 + ia3,
        g1=-g * reach,
        g2=-g * z3,
        g3=-g * (m2 * a2 + x2 + m3 * a2),
        g4=g * y2,
    )


def inertia(q: ArrayLike, arm: ArmParameters) -> np.ndarray:
    """D(q), rigid links alone, without the motor inertias Ia.

    q : (..., 3) joint angles [rad], real or complex. Returns (..., 3, 3) [kg.m^2];
    equations 4.9 to 4.17.
    """
    k = lumped_constants(arm)
    s2, c2, s3, c3, su, cu = _sines(q)
    d13 = k.B1 * su + k.B2 * cu
    h = k.E1 * c3 + k.E2 * s3
    out = np.empty(s2.shape + (3, 3), dtype=s2.dtype)
    in_q2 = k.A0 - arm.motors[0].inertia + k.A1 * c2 * c2 + k.A2 * s2 * c2
    out[..., 0, 0] = in_q2 + k.A3 * cu * cu + k.A4 * su * cu + k.A5 * c2 * cu + k.A6 * c2 * su
    out[..., 0, 1] = out[..., 1, 0] = k.B3 * s2 + k.B4 * c2 + d13
    out[..., 0, 2] = out[..., 2, 0] = d13
    out[..., 1, 1] = k.E3 - arm.motors[1].inertia + 2 * h
    out[..., 1, 2] = out[..., 2, 1] = k.E0 + h
    out[..., 2, 2] = k.E0
    return out


def coriolis(q: ArrayLike, arm: ArmParameters) -> np.ndarray:
    """C(q): the torque at joint i is the sum over j and k of C[i, j, k] qd_j qd_k.

    q : (..., 3) joint angles [rad], real or complex. Returns (..., 3, 3, 3) [kg.m^2], symmetric in
    j and k: the Christoffel symbols of D; equations 4.18 to 4.44.
    """
    k = lumped_constants(arm)
    s2, c2, s3, c3, su, cu = _sines(q)
    square2, squareu = c2 * c2 - s2 * s2, cu * cu - su * su
    # halves of the derivatives of D11 to q2 + q3 at fixed q2, and to q2
    c113 = -k.A3 * su * cu + k.A4 * squareu / 2 + c2 * (k.A6 * cu - k.A5 * su) / 2
    c112 = c113 - k.A1 * s2 * c2 + k.A2 * square2 / 2 - s2 * (k.A5 * cu + k.A6 * su) / 2
    e = k.B1 * cu - k.B2 * su
    slope = k.E2 * c3 - k.E1 * s3
    out = np.zeros(s2.shape + (3, 3, 3), dtype=s2.dtype)
    out[..., 0, 0, 1] = out[..., 0, 1, 0] = c112
    out[..., 0, 0, 2] = out[..., 0, 2, 0] = c113
    out[..., 0, 1, 1] = k.B3 * c2 - k.B4 * s2 + e
    out[..., 0, 1, 2] = out[..., 0, 2, 1] = out[..., 0, 2, 2] = e
    out[..., 1, 0, 0] = -c112
    out[..., 1, 1, 2] = out[..., 1, 2, 1] = out[..., 1, 2, 2] = slope
    out[..., 2, 0, 0] = -c113
    out[..., 2, 1, 1] = -slope
    return out


def gravity_torque(q: ArrayLike, arm: ArmParameters) -> np.ndarray:
    """G(q), the torque that holds the arm against gravity.

    q : (..., 3) joint angles [rad], real or complex. Returns (..., 3) [N.m];
    equations 4.45 to 4.47.
    """
    k = lumped_constants(arm)
    s2, c2, _, _, su, cu = _sines(q)
    out = np.zeros(s2.shape + (3,), dtype=s2.dtype)
    out[..., 2] = k.g1 * cu + k.g2 * su
    out[..., 1] = k.g3 * c2 + k.g4 * s2 + out[..., 2]
    return out


def _second_moments(link: Link) -> tuple[float, float, float]:
    """Integrals of x^2, y^2, z^2 over the mass [kg.m^2], equation 3.9."""
    kxx, kyy, kzz = link.gyration_squared
    half = link.mass / 2
    return half * (kyy + kzz - kxx), half * (kzz + kxx - kyy), half * (kxx + kyy - kzz)


def _sines(q: ArrayLike) -> tuple[np.ndarray, ...]:
    q = as_angles(q)
    q2, q3 = q[..., 1], q[..., 2]
    u = q2 + q3
    return np.sin(q2), np.cos(q2), np.sin(q3), np.cos(q3), np.sin(u), np.cos(u)


def arm_pseudo_inertias(arm: ArmParameters) -> np.ndarray:
    """(3, 4, 4) pseudo inertias of the three links, for the trace form."""
    return np.array([link.pseudo_inertia for link in arm.links])
