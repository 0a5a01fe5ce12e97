# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The classical Runge-Kutta step (equation 6.5), once for all systems.

The voltages are held over a step (appendix B: constant input keeps the order). Deflections follow the travel of the
joints at each stage exactly, bounded by the friction at half the step: as springs they keep the order and the
stability of the method, and they are of second order where they yield.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from puma_sim_core.dynamics.circuit import limited_currents, motor_torques, settled_currents
from puma_sim_core.dynamics.laws import ALGEBRAIC, BRISTLE, CURRENT_LIMIT, POSED
from puma_sim_core.dynamics.torques import bristle_levels, bristle_torques
from puma_sim_core.dynamics.types import STILL
from puma_sim_core.jit import inlined


class System(NamedTuple):
    """What is stepped: a state y that begins with the nine numbers x.

    rates : (y, v, model, p, lock, slip, bend) -> derivative of y; moved : (y, h, k) -> y + h k; weighted : (a, b, c, d)
    -> a + 2 (b + c) + d; with_currents : (y, i1, i2, i3) -> y with these; trigonometry : (q2, q3) -> trig.
    """

    rates: Callable[..., Any]
    moved: Callable[..., Any]
    weighted: Callable[..., Any]
    with_currents: Callable[..., Any]
    trigonometry: Callable[..., Any]


def build_step(system: System) -> Callable[..., Any]:
    """The step of a system: (y, z, v, h, model, p, lock, slip) -> y and deflections z after h seconds."""
    rates, moved, weighted, with_currents, trigonometry = system

    @inlined
    def step(y, z, v, h, model, p, lock, slip):
        active, half = model.active, 0.5 * h
        bend, level = STILL, STILL
        if active & BRISTLE:
            _, bend = bristle_torques(z, 0.0, 0.0, 0.0, level, p)
        a = rates(y, v, model, p, lock, slip, bend)
        middle = moved(y, half, a)
        if active & BRISTLE:
            motors = STILL
            if active & POSED:
                motors = motor_torques(middle, v, model, p)
            level = bristle_levels(middle, motors, trigonometry(middle[1], middle[2]), model, p)
            _, bend = bristle_torques(z, half * a[0], half * a[1], half * a[2], level, p)
        b = rates(middle, v, model, p, lock, slip, bend)
        if active & BRISTLE:
            _, bend = bristle_torques(z, half * b[0], half * b[1], half * b[2], level, p)
        c = rates(moved(y, half, b), v, model, p, lock, slip, bend)
        if active & BRISTLE:
            _, bend = bristle_torques(z, h * c[0], h * c[1], h * c[2], level, p)
        d = rates(moved(y, h, c), v, model, p, lock, slip, bend)
        sixth = h / 6.0
        mean = weighted(a, b, c, d)
        z_end = z
        if active & BRISTLE:
            z_end, _ = bristle_torques(z, sixth * mean[0], sixth * mean[1], sixth * mean[2], level, p)
        end = moved(y, sixth, mean)
        if active & CURRENT_LIMIT:
            i1, i2, i3 = limited_currents(end[6], end[7], end[8], p)
            end = with_currents(end, i1, i2, i3)
        if active & ALGEBRAIC:
            i1, i2, i3 = settled_currents(end, v, model, p)
            end = with_currents(end, i1, i2, i3)
        return end, z_end

    return step


@inlined
def moved_arm(x, h, k):
    """x + h k of an arm, nine numbers."""
    q1, q2, q3, w1, w2, w3, i1, i2, i3 = x
    k1, k2, k3, k4, k5, k6, k7, k8, k9 = k
    return (
        q1 + h * k1,
        q2 + h * k2,
        q3 + h * k3,
        w1 + h * k4,
        w2 + h * k5,
        w3 + h * k6,
        i1 + h * k7,
        i2 + h * k8,
        i3 + h * k9,
    )


@inlined
def weighted_arm(a, b, c, d):
    """a + 2 (b + c) + d of four rates of an arm, nine numbers."""
    a1, a2, a3, a4, a5, a6, a7, a8, a9 = a
    b1, b2, b3, b4, b5, b6, b7, b8, b9 = b
    c1, c2, c3, c4, c5, c6, c7, c8, c9 = c
    d1, d2, d3, d4, d5, d6, d7, d8, d9 = d
    return (
        a1 + 2.0 * (b1 + c1) + d1,
        a2 + 2.0 * (b2 + c2) + d2,
        a3 + 2.0 * (b3 + c3) + d3,
        a4 + 2.0 * (b4 + c4) + d4,
        a5 + 2.0 * (b5 + c5) + d5,
        a6 + 2.0 * (b6 + c6) + d6,
        a7 + 2.0 * (b7 + c7) + d7,
        a8 + 2.0 * (b8 + c8) + d8,
        a9 + 2.0 * (b9 + c9) + d9,
    )


@inlined
def arm_with_currents(x, i1, i2, i3):
    """x with other currents [A]."""
    return x[0], x[1], x[2], x[3], x[4], x[5], i1, i2, i3
