# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Integration methods beside one another on the simulator's own equations (section 6.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from puma_sim_core.dynamics.rigid import FREE, NO_SLIP, STILL, derivative, library_trigonometry
from puma_sim_core.dynamics.runs import run_voltages
from puma_sim_core.jit import BACKEND, compiled
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import native

#: a row of voltages: one setpoint period of the manipulator [s]
ROW = 0.028


class Run(NamedTuple):
    """States (n + 1, 9) at the rows' ends, and how often the derivative was evaluated.

    ``failed`` is the first row whose state is not finite, or -1.
    """

    states: np.ndarray
    evaluations: int
    failed: int = -1


@compiled
def _rates(x, v, body, drive, p):
    a1, a2, a3, e1, e2, e3 = derivative(
        x[0],
        x[1],
        x[2],
        x[3],
        x[4],
        x[5],
        x[6],
        x[7],
        x[8],
        v[0],
        v[1],
        v[2],
        library_trigonometry(x[1], x[2]),
        body,
        drive,
        0,
        p,
        FREE,
        NO_SLIP,
        STILL,
    )
    return x[3], x[4], x[5], a1, a2, a3, e1, e2, e3


@compiled
def _euler(start, volts, count, h, body, drive, p, out):
    q1, q2, q3, w1, w2, w3, i1, i2, i3 = start
    for j in range(9):
        out[0, j] = start[j]
    for r in range(len(volts)):
        v1, v2, v3 = volts[r][0], volts[r][1], volts[r][2]
        for _ in range(count):
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
                library_trigonometry(q2, q3),
                body,
                drive,
                0,
                p,
                FREE,
                NO_SLIP,
                STILL,
            )
            q1 += h * w1
            q2 += h * w2
            q3 += h * w3
            w1 += h * a1
            w2 += h * a2
            w3 += h * a3
            i1 += h * e1
            i2 += h * e2
            i3 += h * e3
        total = q1 + q2 + q3 + w1 + w2 + w3 + i1 + i2 + i3
        if total - total != 0.0:
            return r + 1
        x = (q1, q2, q3, w1, w2, w3, i1, i2, i3)
        for j in range(9):
            out[r + 1, j] = x[j]
    return -1


def euler(plant: Plant, start, volts, count: int) -> Run:
    """Euler's method with ``count`` steps a row; plant without effects."""
    body, drive, _, table = plant.constants
    out = np.zeros((len(volts) + 1, 9))
    start = tuple(float(value) for value in start)
    failed = _euler(start, _rows(volts), count, ROW / count, body, drive, native(table), out)
    return Run(out, len(volts) * count, failed)


def rk4(plant: Plant, start, volts, count: int, row: float = ROW) -> Run:
    """The simulator's Runge-Kutta method with ``count`` steps a row, whatever their length."""
    body, drive, active, table = plant.constants
    out = np.zeros((len(volts) + 1, 12))
    counts = np.full(len(volts), count, dtype=np.int64)
    steps = np.full(len(volts), row / count)
    failed = run_voltages(
        tuple(float(value) for value in start),
        (0.0,) * 9,
        (0.0, 0.0, 0.0),
        _rows(volts),
        _rows(row * np.arange(len(volts))),
        counts if BACKEND == "numba" else counts.tolist(),
        _rows(steps),
        body,
        drive,
        active,
        native(table),
        FREE,
        out,
    )
    return Run(out[:, :9], 4 * len(volts) * count, failed)


def adaptive(plant: Plant, start, volts, tolerance: float = 1e-12) -> Run:
    """Adaptive reference: DOP853 of SciPy, restarted at each row, where the voltages jump."""
    body, drive, _, table = plant.constants
    table = native(table)
    out = np.zeros((len(volts) + 1, 9))
    out[0] = start
    evaluations = 0
    for r, row in enumerate(np.asarray(volts, dtype=float)):
        v = tuple(row.tolist())
        run = solve_ivp(
            lambda t, x: _rates(tuple(x.tolist()), v, body, drive, table),
            (0.0, ROW),
            out[r],
            method="DOP853",
            rtol=tolerance,
            atol=tolerance * 1e-1,
            first_step=ROW / 8,
        )
        out[r + 1] = run.y[:, -1]
        evaluations += run.nfev
    return Run(out, evaluations)


def position_error(run: Run, reference: Run) -> float:
    """Greatest distance of the angles [rad] at the rows, infinite for a run that failed."""
    if run.failed >= 0:
        return float("inf")
    return float(np.max(np.abs(run.states[:, :3] - reference.states[:, :3])))


def _rows(values):
    values = np.ascontiguousarray(values, dtype=float)
    return values if BACKEND == "numba" else values.tolist()
