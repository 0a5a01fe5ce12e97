# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The electrical circuits of the three motors: equation 5.1, L di/dt = V - R i - ke N qd."""

from typing import Any

from puma_sim_core.dynamics.laws import (
    ALGEBRAIC,
    CURRENT_LIMIT,
    DROOP,
    bounded_current,
    bounded_rate,
    resistance_factor,
    supply_share,
    viscous_factor,
)
from puma_sim_core.dynamics.types import Drive, Model
from puma_sim_core.jit import Table, Vec, inlined


@inlined
def supplied(v: Vec, i1: float, i2: float, i3: float, p: Table) -> Vec:
    """Voltages [V] that are left of a supply that sags under the currents."""
    share = supply_share(0, i1, i2, i3, p)
    return v[0] * share, v[1] * share, v[2] * share


@inlined
def limited_currents(i1: float, i2: float, i3: float, p: Table) -> Vec:
    """Currents [A] of the three motors within their bounds."""
    return bounded_current(0, i1, p), bounded_current(1, i2, p), bounded_current(2, i3, p)


@inlined
def settled_currents(x: Vec, v: Vec, model: Model, p: Table) -> Vec:
    """Currents [A]: of a motor without inductance what voltage and speed make of it, else the state's own.

    A supply sags under the currents of the state.
    """
    _body, drive, active = model
    y1, r1, k1, _, _, y2, r2, k2, _, _, y3, r3, k3, _, _ = drive
    i1, i2, i3 = x[6], x[7], x[8]
    v1, v2, v3 = v[0], v[1], v[2]
    if active & DROOP:
        v1, v2, v3 = supplied(v, i1, i2, i3, p)
    if y1 == 0.0:
        i1 = (v1 - k1 * x[3]) / r1
        if active & CURRENT_LIMIT:
            i1 = bounded_current(0, i1, p)
    if y2 == 0.0:
        i2 = (v2 - k2 * x[4]) / r2
        if active & CURRENT_LIMIT:
            i2 = bounded_current(1, i2, p)
    if y3 == 0.0:
        i3 = (v3 - k3 * x[5]) / r3
        if active & CURRENT_LIMIT:
            i3 = bounded_current(2, i3, p)
    return i1, i2, i3


@inlined
def settled_state(x: Vec, v: Vec, model: Model, p: Table) -> Vec:
    """The state with `settled_currents`."""
    i1, i2, i3 = settled_currents(x, v, model, p)
    return x[0], x[1], x[2], x[3], x[4], x[5], i1, i2, i3


@inlined
def has_damping(active: int) -> bool:
    """Whether `with_damping` holds for a plant with these stages: no limit and no sagging supply bends its currents."""
    return active & ALGEBRAIC != 0 and active & (CURRENT_LIMIT | DROOP) == 0


@inlined
def with_damping(x: Vec, v: Vec, model: Model) -> tuple[Any, ...]:
    """The state and the model with the back-EMF of motors without inductance as viscous friction.

    While V is held, i = (V - ke N w) / R makes the torque kT i - H w the same as kT V / R - (H + kT ke N / R) w: that
    of a constant current.
    """
    y1, r1, k1, n1, h1, y2, r2, k2, n2, h2, y3, r3, k3, n3, h3 = model.drive
    i1, i2, i3 = x[6], x[7], x[8]
    if y1 == 0.0:
        i1, h1 = v[0] / r1, h1 + n1 * k1 / r1
    if y2 == 0.0:
        i2, h2 = v[1] / r2, h2 + n2 * k2 / r2
    if y3 == 0.0:
        i3, h3 = v[2] / r3, h3 + n3 * k3 / r3
    drive = Drive(y1, r1, k1, n1, h1, y2, r2, k2, n2, h2, y3, r3, k3, n3, h3)
    return (x[0], x[1], x[2], x[3], x[4], x[5], i1, i2, i3), Model(model.body, drive, model.active)


@inlined
def motor_torques(x: Vec, v: Vec, model: Model, p: Table) -> Vec:
    """Torques [N.m] that the motors give at the joints after viscous friction."""
    _, _, _, n1, h1, _, _, _, n2, h2, _, _, _, n3, h3 = model.drive
    i1, i2, i3 = x[6], x[7], x[8]
    if model.active & ALGEBRAIC:
        i1, i2, i3 = settled_currents(x, v, model, p)
    return n1 * i1 - h1 * x[3], n2 * i2 - h2 * x[4], n3 * i3 - h3 * x[5]


@inlined
def electric_rates(x: Vec, v: Vec, model: Model, p: Table) -> Vec:
    """Currents [A], as they are or as the voltages settle them, and their rates [A/s] (equation 5.1)."""
    _body, drive, active = model
    y1, r1, k1, _, _, y2, r2, k2, _, _, y3, r3, k3, _, _ = drive
    w1, w2, w3, i1, i2, i3 = x[3], x[4], x[5], x[6], x[7], x[8]
    u1, u2, u3 = v[0], v[1], v[2]
    if active & DROOP:
        u1, u2, u3 = supplied(v, i1, i2, i3, p)
    if active & ALGEBRAIC:
        i1, i2, i3 = settled_currents(x, v, model, p)
    e1 = (u1 - r1 * i1 - k1 * w1) * y1
    e2 = (u2 - r2 * i2 - k2 * w2) * y2
    e3 = (u3 - r3 * i3 - k3 * w3) * y3
    if active & CURRENT_LIMIT:
        e1 = bounded_rate(0, i1, e1, p)
        e2 = bounded_rate(1, i2, e2, p)
        e3 = bounded_rate(2, i3, e3, p)
    return i1, i2, i3, e1, e2, e3


@inlined
def drive_at(time: float, drive: Drive, p: Table) -> Drive:
    """The constants of the drives at a time [s]: of motors and grease that warm up, taken at the middle of a step."""
    y1, r1, k1, n1, h1, y2, r2, k2, n2, h2, y3, r3, k3, n3, h3 = drive
    return Drive(
        y1,
        r1 * resistance_factor(0, time, p),
        k1,
        n1,
        h1 * viscous_factor(0, time, p),
        y2,
        r2 * resistance_factor(1, time, p),
        k2,
        n2,
        h2 * viscous_factor(1, time, p),
        y3,
        r3 * resistance_factor(2, time, p),
        k3,
        n3,
        h3 * viscous_factor(2, time, p),
    )
