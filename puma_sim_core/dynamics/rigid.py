# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The third-order model as scalar code: its derivative and one Runge-Kutta step.

Everything that moves runs through here, compiled or as plain Python (see `backend`), with the
same bits. The state is (q, qd, i): positions [rad], velocities [rad/s] and motor currents [A] of
the three joints, one tuple of nine. D, C and G depend on q2 and q3 alone, so that one evaluation
needs two pairs of sine and cosine and the twenty constants of `rigid_body.Lumps`; no matrix is
formed. Equations 4.1 (corrected: + Ia qdd, H qd) and 5.1.

A step is a list of stages: electrical circuit, torque at the joint, rigid body, rows of locked
joints removed, solution. Stages that only some effects need are entered by their bit of
`active`; a plant without effects passes them by.

Arguments that all functions share
    body    the constants `rigid_body.Lumps`, a tuple
    drive   15 constants of the motors, joint by joint: 1/L (0 where there is none), R, ke N, kT, H
    active  bit mask of the optional stages (`effects.active_stages`), with LOCKED
    p       the packed table of effects (`effects.pack`)
    lock    (l1, l2, l3, a1, a2, a3): l = 1.0 takes the joint's row out, its acceleration is a
    slip    (s1, s2, s3, c1, c2, c3): direction of sliding against dry friction, 0.0 without, and
            the torque, of friction and from outside, that stays the same over a step [N.m]
    bend    (f1, f2, f3): torques of the bristles [N.m]
"""

from __future__ import annotations

from math import cos, sin

from puma_sim_core.dynamics.circuit import electric_rates, limited_currents, motor_torques, settled_currents
from puma_sim_core.dynamics.laws import ALGEBRAIC, BRISTLE, CURRENT_LIMIT, DROOP, LOCKED, POSED, WIDTH, bounded_rate
from puma_sim_core.dynamics.torques import bristle_levels, bristle_torques, effect_torques
from puma_sim_core.jit import inlined

FREE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NO_SLIP = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)


@inlined
def rigid_body(w1, w2, w3, t1, t2, t3, trig, body):
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
def remove_rows(m11, m12, m13, m22, m23, m33, b1, b2, b3, lock):
    """The system with the rows and columns of locked joints taken out.

    Their accelerations are known; what they exert on the others moves to the right-hand side.
    """
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
def solve(m11, m12, m13, m22, m23, m33, b1, b2, b3):
    """Solution of the symmetric positive definite system by elimination from joint 3 upward."""
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
def derivative(q1, q2, q3, w1, w2, w3, i1, i2, i3, v1, v2, v3, trig, body, drive, active, p, lock, slip, bend):
    """(qdd1, qdd2, qdd3, di1/dt, di2/dt, di3/dt) in rad/s^2 and A/s.

    Sines and cosines come in from the caller, so that a batch can take them over several runs
    at once.
    """
    y1, r1, k1, n1, h1, y2, r2, k2, n2, h2, y3, r3, k3, n3, h3 = drive
    if active & (DROOP | ALGEBRAIC):
        i1, i2, i3, e1, e2, e3 = electric_rates(i1, i2, i3, w1, w2, w3, v1, v2, v3, drive, active, p)
    else:
        # written out: as a call of its own it makes all that follows slower by half
        e1 = (v1 - r1 * i1 - k1 * w1) * y1
        e2 = (v2 - r2 * i2 - k2 * w2) * y2
        e3 = (v3 - r3 * i3 - k3 * w3) * y3
        if active & CURRENT_LIMIT:
            e1 = bounded_rate(p, 0, i1, e1)
            e2 = bounded_rate(p, WIDTH, i2, e2)
            e3 = bounded_rate(p, 2 * WIDTH, i3, e3)
    t1 = n1 * i1 - h1 * w1
    t2 = n2 * i2 - h2 * w2
    t3 = n3 * i3 - h3 * w3
    if active:
        t1, t2, t3 = effect_torques(q1, q2, q3, w1, w2, w3, t1, t2, t3, trig, body, active, p, slip, bend)
    m11, m12, m13, m22, m23, m33, b1, b2, b3 = rigid_body(w1, w2, w3, t1, t2, t3, trig, body)
    if active & LOCKED:
        m11, m12, m13, m22, m23, m33, b1, b2, b3 = remove_rows(m11, m12, m13, m22, m23, m33, b1, b2, b3, lock)
    a1, a2, a3 = solve(m11, m12, m13, m22, m23, m33, b1, b2, b3)
    return a1, a2, a3, e1, e2, e3


@inlined
def library_trigonometry(q2, q3):
    """(sin q2, cos q2, sin(q2 + q3), cos(q2 + q3)) by the C library."""
    u = q2 + q3
    return sin(q2), cos(q2), sin(u), cos(u)


def build_step(trigonometry):
    """The Runge-Kutta step on top of a function like `library_trigonometry`."""

    @inlined
    def rk4_step(x, z, v, h, body, drive, active, p, lock, slip):
        """State and bristles after one classical Runge-Kutta step of `h` seconds (equation 6.5).

        x is the state, z the deflections of the bristles [rad], v the voltages [V] held over the
        step (appendix B: constant input keeps the order). The bristles follow the travel of
        the joint at each stage exactly (`bristle_flow`), bounded by the friction at half the
        step: as springs they keep the order and the stability of the method, and they are of
        second order where they yield.
        """
        q1, q2, q3, w1, w2, w3, i1, i2, i3 = x
        v1, v2, v3 = v
        half = 0.5 * h
        bend = STILL
        level = STILL
        z_end = z

        if active & BRISTLE:
            _, bend = bristle_torques(z, 0.0, 0.0, 0.0, level, p)
        a1, a2, a3, e1, e2, e3 = derivative(
            q1,
            q2,
            q3,
            w1,
            w2,
            w3,
            i1,
            i2,
            i3,
            v1,
            v2,
            v3,
            trigonometry(q2, q3),
            body,
            drive,
            active,
            p,
            lock,
            slip,
            bend,
        )

        u1 = w1 + half * a1
        u2 = w2 + half * a2
        u3 = w3 + half * a3
        r2 = q2 + half * w2
        r3 = q3 + half * w3
        trig = trigonometry(r2, r3)
        if active & BRISTLE:
            motors = STILL
            if active & POSED:
                motors = motor_torques(
                    i1 + half * e1, i2 + half * e2, i3 + half * e3, u1, u2, u3, v1, v2, v3, drive, active, p
                )
            level = bristle_levels(q1 + half * w1, r2, r3, u1, u2, u3, motors, trig, body, p)
            _, bend = bristle_torques(z, half * w1, half * w2, half * w3, level, p)
        b1, b2, b3, f1, f2, f3 = derivative(
            q1 + half * w1,
            r2,
            r3,
            u1,
            u2,
            u3,
            i1 + half * e1,
            i2 + half * e2,
            i3 + half * e3,
            v1,
            v2,
            v3,
            trig,
            body,
            drive,
            active,
            p,
            lock,
            slip,
            bend,
        )

        x1 = w1 + half * b1
        x2 = w2 + half * b2
        x3 = w3 + half * b3
        if active & BRISTLE:
            _, bend = bristle_torques(z, half * u1, half * u2, half * u3, level, p)
        r2 = q2 + half * u2
        r3 = q3 + half * u3
        c1, c2, c3, g1, g2, g3 = derivative(
            q1 + half * u1,
            r2,
            r3,
            x1,
            x2,
            x3,
            i1 + half * f1,
            i2 + half * f2,
            i3 + half * f3,
            v1,
            v2,
            v3,
            trigonometry(r2, r3),
            body,
            drive,
            active,
            p,
            lock,
            slip,
            bend,
        )

        y1 = w1 + h * c1
        y2 = w2 + h * c2
        y3 = w3 + h * c3
        if active & BRISTLE:
            _, bend = bristle_torques(z, h * x1, h * x2, h * x3, level, p)
        r2 = q2 + h * x2
        r3 = q3 + h * x3
        d1, d2, d3, k1, k2, k3 = derivative(
            q1 + h * x1,
            r2,
            r3,
            y1,
            y2,
            y3,
            i1 + h * g1,
            i2 + h * g2,
            i3 + h * g3,
            v1,
            v2,
            v3,
            trigonometry(r2, r3),
            body,
            drive,
            active,
            p,
            lock,
            slip,
            bend,
        )

        sixth = h / 6.0
        m1 = w1 + 2.0 * (u1 + x1) + y1
        m2 = w2 + 2.0 * (u2 + x2) + y2
        m3 = w3 + 2.0 * (u3 + x3) + y3
        if active & BRISTLE:
            z_end, _ = bristle_torques(z, sixth * m1, sixth * m2, sixth * m3, level, p)
        i1 += sixth * (e1 + 2.0 * (f1 + g1) + k1)
        i2 += sixth * (e2 + 2.0 * (f2 + g2) + k2)
        i3 += sixth * (e3 + 2.0 * (f3 + g3) + k3)
        if active & CURRENT_LIMIT:
            i1, i2, i3 = limited_currents(i1, i2, i3, p)
        w1 += sixth * (a1 + 2.0 * (b1 + c1) + d1)
        w2 += sixth * (a2 + 2.0 * (b2 + c2) + d2)
        w3 += sixth * (a3 + 2.0 * (b3 + c3) + d3)
        if active & ALGEBRAIC:
            i1, i2, i3 = settled_currents(i1, i2, i3, w1, w2, w3, v1, v2, v3, drive, active, p)
        return (q1 + sixth * m1, q2 + sixth * m2, q3 + sixth * m3, w1, w2, w3, i1, i2, i3), z_end

    return rk4_step


rk4_step = build_step(library_trigonometry)
