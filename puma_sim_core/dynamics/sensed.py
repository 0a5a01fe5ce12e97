# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The measured position: what records, joint states, the servo and controllers see.

The state of the simulation is the true one; with `sensor_lag`, `encoder_offset` or
`sensor_nonlinearity` the measured position differs from it. A lag has a memory, the measured
position itself, which a run carries on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from puma_sim_core import effects as _registry
from puma_sim_core.dynamics.rigid import WIDTH
from puma_sim_core.effects.sensing import (
    ENCODER_OFFSET,
    LAG,
    NONLINEARITY,
    lagged_position,
    sensed_position,
    sensed_velocity,
)
from puma_sim_core.jit import inlined, interpreted

_LAG = _registry.slot(LAG)
_OFFSET = _registry.slot(ENCODER_OFFSET)
_CURVE = _registry.slot(NONLINEARITY)


@inlined
def measured_joint(j, before, q0, w0, q1, w1, step, p):
    """Measured position [rad] of joint j after a step [s] from (q0, w0) to (q1, w1)."""
    k = j * WIDTH
    return lagged_position(
        p,
        k + _LAG,
        before,
        sensed_position(p, k + _OFFSET, k + _CURVE, q0),
        sensed_position(p, k + _OFFSET, k + _CURVE, q1),
        sensed_velocity(p, k + _CURVE, q0, w0),
        sensed_velocity(p, k + _CURVE, q1, w1),
        step,
    )


@inlined
def measured_after(m, x, y, step, p):
    """Measured positions [rad] after a step [s] from state x to state y; m : before it."""
    return (
        measured_joint(0, m[0], x[0], x[3], y[0], y[3], step, p),
        measured_joint(1, m[1], x[1], x[4], y[1], y[4], step, p),
        measured_joint(2, m[2], x[2], x[5], y[2], y[5], step, p),
    )


_settled = interpreted(sensed_position)
_slope = interpreted(sensed_velocity)


def settled_positions(position: Sequence[float], table: Sequence[float]) -> tuple[float, ...]:
    """Measured positions [rad] of an arm that has rested at `position` [rad]."""
    return tuple(
        float(_settled(table, j * WIDTH + _OFFSET, j * WIDTH + _CURVE, float(q))) for j, q in enumerate(position)
    )


def true_motion(measured, velocity, acceleration, table: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """True position (3) [rad] and velocity (3) [rad/s] behind a measured motion.

    measured [rad], velocity [rad/s], acceleration [rad/s^2] : (3) of the measured position. The
    lag is undone by its equation, u = m + T dm/dt, the curve of the sensor by Newton's method.
    """
    position, speed = np.empty(3), np.empty(3)
    for j in range(3):
        k = j * WIDTH
        lag, offset, curve = table[k + _LAG], k + _OFFSET, k + _CURVE
        u = measured[j] + lag * velocity[j]
        q = u - table[offset]
        for _ in range(50):
            step = (_settled(table, offset, curve, q) - u) / max(_slope(table, curve, q, 1.0), 0.1)
            q -= step
            if abs(step) <= 1e-15 * (1.0 + abs(q)):
                break
        position[j] = q
        speed[j] = (velocity[j] + lag * acceleration[j]) / _slope(table, curve, q, 1.0)
    return position, speed
