# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The third-order model as scalar code: its derivative (equations 4.1, corrected: + Ia qdd, H qd, and 5.1) and step.

Everything that moves runs through here, compiled or as plain Python (see `jit`), with the same bits. D, C and G
depend on q2 and q3 alone, so that one evaluation needs two pairs of sine and cosine and the twenty constants of
`rigid_body.Lumps`; no matrix is formed.

A derivative is a list of stages: electrical circuit, torques at the joints, rigid body, rows of locked joints removed,
solution. Stages that only some effects need are entered by their bit of `Model.active`; a plant without effects
passes them by. What the arguments are: `types`.
"""

from collections.abc import Callable
from math import cos, sin
from typing import Any

from puma_sim_core.dynamics.circuit import electric_rates
from puma_sim_core.dynamics.laws import ALGEBRAIC, CURRENT_LIMIT, DROOP, LOCKED, bounded_rate
from puma_sim_core.dynamics.rk4 import ARM, build_step
from puma_sim_core.dynamics.torques import effect_torques
from puma_sim_core.dynamics.types import Model
from puma_sim_core.jit import Table, Vec, inlined


@inlined
def rigid_body(w1: float, w2: float, w3: float, t1: float, t2: float, t3: float, trig: Vec, body: Table) -> Vec:
    """M = D + Ia, row by row from the diagonal, and b = t - C(qd, qd) - G (equation 4.1).

    trig = (sin q2, cos q2, sin(q2 + q3), cos(q2 + q3)).
    """
    s2, c2, su, cu = trig
    A0, A1, A2, A3, A4, A5, A6, B1, B2, B3, B4, E0, E1, E2, E3, E4, g1, g2, g3, g4 = body
    c3 = c2 * cu + s2 * su
    s3 = su * c2 - cu * s2
    sc2 = s2 * c2
    scu = su * cu
    c2cu = c2 * cu
    c2su = c2 * su
    cc2 = c2 * c2
    ccu = cu * cu
    d13 = B1 * su + B2 * cu
    h = E1 * c3 + E2 * s3
    m11 = A0 + A1 * cc2 + A2 * sc2 + A3 * ccu + A4 * scu + A5 * c2cu + A6 * c2su
    m12 = B3 * s2 + B4 * c2 + d13
    m22 = E3 + h + h
    m23 = E0 + h
    # Christoffel symbols, C_ijk = C_ikj; C211 = -C112, C311 = -C113, C322 = -C223
    c113 = A4 * (ccu - 0.5) - A3 * scu + 0.5 * (A6 * c2cu - A5 * c2su)
    c112 = A2 * (cc2 - 0.5) - A1 * sc2 - 0.5 * (A5 * s2 * cu + A6 * s2 * su) + c113
    e = B1 * cu - B2 * su
    c122 = B3 * c2 - B4 * s2 + e
    c223 = E2 * c3 - E1 * s3
    w22 = w2 * w2
    both = w3 * (w2 + w2 + w3)
    G3 = g1 * cu + g2 * su
    b1 = t1 - 2.0 * w1 * (c112 * w2 + c113 * w3) - c122 * w22 - e * both
    b2 = t2 + c112 * w1 * w1 - c223 * both - (g3 * c2 + g4 * s2 + G3)
    b3 = t3 + c113 * w1 * w1 + c223 * w22 - G3
    return m11, m12, d13, m22, m23, E4, b1, b2, b3


@inlined
def remove_rows(system: Vec, lock: Vec) -> Vec:
    """The system with the rows and columns of locked joints taken out.

    Their accelerations are known; what they exert on the others moves to the right-hand side.
    """
    m11, m12, m13, m22, m23, m33, b1, b2, b3 = system
    l1, l2, l3, a1, a2, a3 = lock
    if l1 != 0.0:
        b2 -= m12 * a1
        b3 -= m13 * a1
        m11, m12, m13, b1 = 1.0, 0.0, 0.0, a1
    if l2 != 0.0:
        b1 -= m12 * a2
        b3 -= m23 * a2
        m22, m12, m23, b2 = 1.0, 0.0, 0.0, a2
    if l3 != 0.0:
        b1 -= m13 * a3
        b2 -= m23 * a3
        m33, m13, m23, b3 = 1.0, 0.0, 0.0, a3
    return m11, m12, m13, m22, m23, m33, b1, b2, b3


@inlined
def solve(system: Vec) -> Vec:
    """Solution of the symmetric positive definite system by elimination from joint 3 upward."""
    m11, m12, m13, m22, m23, m33, b1, b2, b3 = system
    # m33 is a constant unless joint 3 is locked: its reciprocal leaves the loop over steps
    k33 = 1.0 / m33
    f2 = m23 * k33
    f1 = m13 * k33
    n22 = m22 - f2 * m23
    n12 = m12 - f2 * m13
    r2 = b2 - f2 * b3
    k22 = 1.0 / n22
    f = n12 * k22
    a1 = (b1 - f1 * b3 - f * r2) / (m11 - f1 * m13 - f * n12)
    a2 = (r2 - n12 * a1) * k22
    a3 = (b3 - m13 * a1 - m23 * a2) * k33
    return a1, a2, a3


@inlined
def library_trigonometry(q2: float, q3: float) -> Vec:
    """(sin q2, cos q2, sin(q2 + q3), cos(q2 + q3)) by the C library."""
    u = q2 + q3
    return sin(q2), cos(q2), sin(u), cos(u)


def build_arm(trigonometry: Callable[..., Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """The derivative of the arm's state and its Runge-Kutta step, on top of a function like `library_trigonometry`.

    A batch takes sines and cosines of several runs at once.
    """

    @inlined
    def derivative(x: Vec, v: Vec, model: Model, p: Table, lock: Vec, slip: Vec, bend: Vec) -> Vec:
        """(qd, qdd, di/dt) of the three joints, nine numbers in rad/s, rad/s^2 and A/s."""
        _, _, _, w1, w2, w3, i1, i2, i3 = x
        body, drive, active = model
        trig = trigonometry(x[1], x[2])
        y1, r1, k1, n1, h1, y2, r2, k2, n2, h2, y3, r3, k3, n3, h3 = drive
        if active & (DROOP | ALGEBRAIC):
            i1, i2, i3, e1, e2, e3 = electric_rates(x, v, model, p)
        else:
            # written out: as a call of its own it makes all that follows slower by half
            e1 = (v[0] - r1 * i1 - k1 * w1) * y1
            e2 = (v[1] - r2 * i2 - k2 * w2) * y2
            e3 = (v[2] - r3 * i3 - k3 * w3) * y3
            if active & CURRENT_LIMIT:
                e1 = bounded_rate(0, i1, e1, p)
                e2 = bounded_rate(1, i2, e2, p)
                e3 = bounded_rate(2, i3, e3, p)
        t1 = n1 * i1 - h1 * w1
        t2 = n2 * i2 - h2 * w2
        t3 = n3 * i3 - h3 * w3
        if active:
            t1, t2, t3 = effect_torques(x, (t1, t2, t3), trig, model, p, slip, bend)
        system = rigid_body(w1, w2, w3, t1, t2, t3, trig, body)
        if active & LOCKED:
            system = remove_rows(system, lock)
        a1, a2, a3 = solve(system)
        return w1, w2, w3, a1, a2, a3, e1, e2, e3

    return derivative, build_step(derivative, ARM, trigonometry)


derivative, arm_step = build_arm(library_trigonometry)
