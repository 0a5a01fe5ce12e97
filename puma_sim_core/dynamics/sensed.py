# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The measured position: what records, joint states, the servo and controllers see.

The state of the simulation is the true one; with effects of its sensors
the measured position differs from it. A lag has a memory, the measured
position itself, which a run carries on.
"""

from collections.abc import Sequence
from math import exp

import numpy as np

from puma_sim_core.dynamics.laws import combined, sensor_error, sensor_offset, sensor_slope, sensor_time
from puma_sim_core.effects.base import Point
from puma_sim_core.jit import Table, Vec, inlined, interpreted


@inlined
def lagged_position(T: float, before: float, u0: float, u1: float, d0: float, d1: float, step: float) -> float:
    """Position [rad] behind a lag of T [s] at the end of a step, `before` at its start.

    u0, u1 : what the sensor gives at start and end once it has settled; d0, d1 : its rates. The exact solution for
    the parabola with the mean slope and the mean curvature of the step.
    """
    if T == 0.0:
        return u1
    slope = (u1 - u0) / step
    bow = (d1 - d0) / step
    # slope and curvature add these to a lag that has settled
    shift0 = T * (slope - 0.5 * step * bow) - T * T * bow
    shift1 = T * (slope + 0.5 * step * bow) - T * T * bow
    return u1 - shift1 + (before - u0 + shift0) * exp(-step / T)


@inlined
def measured_joint(j: int, before: float, q0: float, w0: float, q1: float, w1: float, step: float, p: Table) -> float:
    """Measured position [rad] of joint j after a step [s] from (q0, w0) to (q1, w1)."""
    return lagged_position(
        sensor_time(j, p),
        before,
        q0 + sensor_offset(j, p) + sensor_error(j, q0, p),
        q1 + sensor_offset(j, p) + sensor_error(j, q1, p),
        w0 * (1.0 + sensor_slope(j, q0, p)),
        w1 * (1.0 + sensor_slope(j, q1, p)),
        step,
    )


@inlined
def measured_after(m: Vec, x: Vec, y: Vec, step: float, p: Table) -> Vec:
    """Measured positions [rad] after a step [s] from state x to state y; m : before it."""
    return (
        measured_joint(0, m[0], x[0], x[3], y[0], y[3], step, p),
        measured_joint(1, m[1], x[1], x[4], y[1], y[4], step, p),
        measured_joint(2, m[2], x[2], x[5], y[2], y[5], step, p),
    )


_offset, _error, _slope, _lag = (
    combined(point, interpreted)
    for point in (Point.SENSOR_OFFSET, Point.SENSOR_ERROR, Point.SENSOR_SLOPE, Point.SENSOR_LAG)
)


def settled_positions(position: Sequence[float], table: Sequence[float]) -> tuple[float, ...]:
    """Measured positions [rad] of an arm that has rested at `position` [rad]."""
    return tuple(float(float(q) + _offset(j, table) + _error(j, float(q), table)) for j, q in enumerate(position))


def true_motion(
    measured: Table, velocity: Table, acceleration: Table, table: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """True position (3) [rad] and velocity (3) [rad/s] behind a measured motion.

    measured [rad], velocity [rad/s], acceleration [rad/s^2] : (3) of the measured position. The
    lag is undone by its equation, u = m + T dm/dt, the error of the sensor by Newton's method.
    """
    position, speed = np.empty(3), np.empty(3)
    for j in range(3):
        lag, offset = _lag(j, table), _offset(j, table)
        u = measured[j] + lag * velocity[j]
        q = u - offset
        for _ in range(50):
            step = (q + offset + _error(j, q, table) - u) / max(1.0 + _slope(j, q, table), 0.1)
            q -= step
            if abs(step) <= 1e-15 * (1.0 + abs(q)):
                break
        position[j] = q
        speed[j] = (velocity[j] + lag * acceleration[j]) / (1.0 + _slope(j, q, table))
    return position, speed
