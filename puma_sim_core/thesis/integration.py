# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Integration methods beside one another on the simulator's own equations (section 6.2)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from puma_sim_core.dynamics.laws import AT_REST
from puma_sim_core.dynamics.rigid import derivative
from puma_sim_core.dynamics.rk4 import moved_arm
from puma_sim_core.dynamics.runs import is_finite, run_voltages
from puma_sim_core.dynamics.types import FREE, NO_SLIP, STILL, Constants, Rows, State
from puma_sim_core.jit import BACKEND, compiled, inlined
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


@inlined
def _slope(x, v, constants):
    model, p = constants
    return derivative(x, v, model, p, FREE, NO_SLIP, STILL)


@compiled
def _rates(x, v, constants):
    return _slope(x, v, constants)


@compiled
def _euler(x, volts, count, h, constants, out):
    for j in range(9):
        out[0, j] = x[j]
    for r in range(len(volts)):
        v = (volts[r][0], volts[r][1], volts[r][2])
        for _ in range(count):
            x = moved_arm(x, h, _slope(x, v, constants))
        if not is_finite(x):
            return r + 1
        for j in range(9):
            out[r + 1, j] = x[j]
    return -1


def _constants(plant: Plant, active: int | None = None) -> Constants:
    model, table = plant.constants
    return Constants(model if active is None else model._replace(active=active), native(table))


def euler(plant: Plant, start, volts, count: int) -> Run:
    """Euler's method with ``count`` steps a row; plant without effects."""
    out = np.zeros((len(volts) + 1, 9))
    start = tuple(float(value) for value in start)
    plain = _constants(plant, 0)
    failed = _euler(start, _rows(volts), count, ROW / count, plain, out)
    return Run(out, len(volts) * count, failed)


def rk4(plant: Plant, start, volts, count: int, row: float = ROW) -> Run:
    """The simulator's Runge-Kutta method with ``count`` steps a row, whatever their length."""
    out = np.zeros((len(volts) + 1, 12))
    counts = np.full(len(volts), count, dtype=np.int64)
    rows = Rows(
        _rows(volts),
        _rows(row * np.arange(len(volts))),
        counts if BACKEND == "numba" else counts.tolist(),
        _rows(np.full(len(volts), row / count)),
    )
    state = State(tuple(float(value) for value in start), AT_REST, (0.0, 0.0, 0.0))
    failed = run_voltages(state, rows, _constants(plant), FREE, out)
    return Run(out[:, :9], 4 * len(volts) * count, failed)


def adaptive(plant: Plant, start, volts, tolerance: float = 1e-12) -> Run:
    """Adaptive reference: DOP853 of SciPy, restarted at each row, where the voltages jump."""
    constants = _constants(plant, 0)
    out = np.zeros((len(volts) + 1, 9))
    out[0] = start
    evaluations = 0
    for r, row in enumerate(np.asarray(volts, dtype=float)):
        v = tuple(row.tolist())
        run = solve_ivp(
            lambda t, x: _rates(tuple(x.tolist()), v, constants),  # noqa: B023 (called within the round)
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
