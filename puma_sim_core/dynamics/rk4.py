# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The classical Runge-Kutta step (equation 6.5), once for all systems.

The voltages are held over a step (appendix B: constant input keeps the order). Deflections follow the travel of the
joints at each stage exactly, bounded by the friction at half the step: as springs they keep the order and the
stability of the method, and they are of second order where they yield.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from puma_sim_core.dynamics.circuit import limited_currents, motor_torques, settled_currents
from puma_sim_core.dynamics.laws import ALGEBRAIC, BRISTLE, CURRENT_LIMIT, POSED
from puma_sim_core.dynamics.torques import bent_torques, bristle_levels, bristle_torques
from puma_sim_core.dynamics.types import STILL, Model
from puma_sim_core.jit import Table, Vec, inlined, written


class Sums(NamedTuple):
    """The sums of the method for a state y that begins with the nine numbers x.

    moved : (y, h, k) -> y + h k; weighted : (a, b, c, d) -> a + 2 (b + c) + d; with_currents : (y, i1, i2, i3) -> y
    with these.
    """

    moved: Callable[..., Any]
    weighted: Callable[..., Any]
    with_currents: Callable[..., Any]


def sums_of(width: int, total: str = "a{i} + 2.0 * (b{i} + c{i}) + d{i}") -> Sums:
    """The sums for states of so many numbers, written out; total : the weighted one, in an order that the bits keep."""

    def numbers(term: str) -> str:
        return ", ".join(term.format(i=i) for i in range(width))

    def sums(vectors: str, term: str) -> list[str]:
        return [*(f"{numbers(name + '{i}')} = {name}" for name in vectors), f"return ({numbers(term)})"]

    kept = numbers("y[{i}]").replace("y[6], y[7], y[8]", "i1, i2, i3")
    return Sums(
        written("moved", "y, h, k", sums("yk", "y{i} + h * k{i}"), {}),
        written("weighted", "a, b, c, d", sums("abcd", total), {}),
        written("with_currents", "y, i1, i2, i3", [f"return ({kept})"], {}),
    )


def build_step(rates: Callable[..., Any], sums: Sums, trigonometry: Callable[..., Any]) -> Callable[..., Any]:
    """The step of a system: (y, z, v, h, model, p, lock, slip) -> y and deflections z after h seconds.

    rates : (y, v, model, p, lock, slip, bend) -> derivative of y; trigonometry : (q2, q3) -> trig.
    """
    moved, weighted, with_currents = sums

    @inlined
    def step(y: Vec, z: Vec, v: Vec, h: float, model: Model, p: Table, lock: Vec, slip: Vec) -> tuple[Any, ...]:
        active, half = model.active, 0.5 * h
        bend, level = bent_torques(z, active, p), STILL
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


#: those of an arm without drive trains
ARM = sums_of(9)
