# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The electrical circuits of the three motors (equation 5.1), as scalar code of `kernel`."""

from __future__ import annotations

from puma_sim_core.dynamics.laws import (
    ALGEBRAIC,
    CURRENT_LIMIT,
    DROOP,
    WIDTH,
    bounded_current,
    bounded_rate,
    supply_share,
)
from puma_sim_core.jit import inlined


@inlined
def supplied(v1, v2, v3, i1, i2, i3, p):
    """Voltages [V] that are left of a supply that sags under the currents."""
    share = supply_share(p, 0, i1, i2, i3)
    return v1 * share, v2 * share, v3 * share


@inlined
def settled_current(j, i, w, v, inverse_inductance, resistance, emf, active, p):
    """Current [A] of motor j: without inductance what voltage and speed make of it, else i."""
    if inverse_inductance != 0.0:
        return i
    i = (v - emf * w) / resistance
    if active & CURRENT_LIMIT:
        i = bounded_current(p, j * WIDTH, i)
    return i


@inlined
def settled_currents(i1, i2, i3, w1, w2, w3, v1, v2, v3, drive, active, p):
    """`settled_current` of the three motors; a supply droops under the currents given."""
    y1, r1, k1, _, _, y2, r2, k2, _, _, y3, r3, k3, _, _ = drive
    if active & DROOP:
        v1, v2, v3 = supplied(v1, v2, v3, i1, i2, i3, p)
    return (
        settled_current(0, i1, w1, v1, y1, r1, k1, active, p),
        settled_current(1, i2, w2, v2, y2, r2, k2, active, p),
        settled_current(2, i3, w3, v3, y3, r3, k3, active, p),
    )


@inlined
def settled_state(x, v, drive, active, p):
    """The state with `settled_currents` for the voltages v."""
    q1, q2, q3, w1, w2, w3, i1, i2, i3 = x
    i1, i2, i3 = settled_currents(i1, i2, i3, w1, w2, w3, v[0], v[1], v[2], drive, active, p)
    return q1, q2, q3, w1, w2, w3, i1, i2, i3


@inlined
def motor_torques(i1, i2, i3, w1, w2, w3, v1, v2, v3, drive, active, p):
    """Torques [N.m] that the motors give at the joints after viscous friction."""
    _, _, _, n1, h1, _, _, _, n2, h2, _, _, _, n3, h3 = drive
    if active & ALGEBRAIC:
        i1, i2, i3 = settled_currents(i1, i2, i3, w1, w2, w3, v1, v2, v3, drive, active, p)
    return n1 * i1 - h1 * w1, n2 * i2 - h2 * w2, n3 * i3 - h3 * w3


@inlined
def electric_rates(i1, i2, i3, w1, w2, w3, v1, v2, v3, drive, active, p):
    """Currents [A], as they are or as the voltages settle them, and their rates [A/s]."""
    y1, r1, k1, _, _, y2, r2, k2, _, _, y3, r3, k3, _, _ = drive
    u1, u2, u3 = v1, v2, v3
    if active & DROOP:
        u1, u2, u3 = supplied(v1, v2, v3, i1, i2, i3, p)
    if active & ALGEBRAIC:
        i1, i2, i3 = settled_currents(i1, i2, i3, w1, w2, w3, v1, v2, v3, drive, active, p)
    e1 = (u1 - r1 * i1 - k1 * w1) * y1
    e2 = (u2 - r2 * i2 - k2 * w2) * y2
    e3 = (u3 - r3 * i3 - k3 * w3) * y3
    if active & CURRENT_LIMIT:
        e1 = bounded_rate(p, 0, i1, e1)
        e2 = bounded_rate(p, WIDTH, i2, e2)
        e3 = bounded_rate(p, 2 * WIDTH, i3, e3)
    return i1, i2, i3, e1, e2, e3


@inlined
def limited_currents(i1, i2, i3, p):
    """Currents [A] of the three motors within their bounds."""
    return (bounded_current(p, 0, i1), bounded_current(p, WIDTH, i2), bounded_current(p, 2 * WIDTH, i3))
