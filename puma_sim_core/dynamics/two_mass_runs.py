# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The runs of `runs` for arms whose links do not follow their motors, and the choice between both.

They are compiled by themselves, so that nobody waits for the one who does not use the other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from puma_sim_core.dynamics import runs
from puma_sim_core.dynamics.laws import SENSED, TIMED, TWO_MASS
from puma_sim_core.dynamics.runs import held_rows, servo_rows, terminals, x_in_row, z_in_row
from puma_sim_core.dynamics.sensed import measured_after
from puma_sim_core.dynamics.timed import drive_at, push_over
from puma_sim_core.dynamics.two_mass import settled_links, train_rates, train_step, trains
from puma_sim_core.dynamics.types import STILL, Constants, Model, Rows, ServoLoop, State
from puma_sim_core.jit import compiled, inlined, interpreted


@inlined
def model_at(model, p, time):
    """The model at an instant [s], and the torques [N.m] that push it from outside."""
    now, push = model.drive, STILL
    if model.active & TIMED:
        now, push = drive_at(time, model.drive, p), push_over(time, 0.0, p)
    return Model(model.body, now, model.active), push


@inlined
def train_advance(state, v, t, h, n, model, p, lock):
    """`runs.advance` with drive trains."""
    x, z, m = state
    active = model.active
    for k in range(n):
        now, push = model, STILL
        if active & TIMED:
            now = Model(model.body, drive_at(t + (k + 0.5) * h, model.drive, p), active)
            push = push_over(t + k * h, h, p)
        y, z = train_step(x, z, v, h, now, p, lock, push)
        if active & SENSED:
            m = measured_after(m, x, y, h, p)
        x = y
    return State(x, z, m)


@compiled
def _train_voltages(state, rows, constants, lock, out):
    return held_rows(train_advance, state, rows, constants, lock, out)


@compiled
def _train_servo(state, setpoints, loop, constants, lock, out, volts):
    return servo_rows(train_advance, state, setpoints, loop, constants, lock, out, volts)


@compiled
def _train_accelerations(out, rows, constants, lock, result):
    model, p = constants
    for r in range(len(result)):
        now, push = model_at(model, p, rows.time[r])
        a = train_rates(x_in_row(out, r), z_in_row(out, r), terminals(rows.voltage, r, p), now, p, lock, push)
        for j in range(3):
            result[r, j] = a[3 + j]


@compiled
def _settled(x, time, constants, stiff, lock):
    model, p = constants
    now, push = model_at(model, p, time)
    return settled_links(x, now, p, stiff, lock, push)


def links_at(x: tuple[float, ...], time: float, constants: Constants, lock: tuple[float, ...]) -> tuple[float, ...]:
    """Positions [rad] and velocities [rad/s] of links that follow their motors without swinging.

    x : state of the motors, nine numbers; time [s]. A soft joint is twisted by the torque that its
    link takes when it moves with the motor, and backlash lies on the side of that torque.
    """
    if not constants.active & TWO_MASS:
        return tuple(x[:6])
    stiff = constants.table.copy()
    for train in interpreted(trains)(stiff):
        stiff[train] = 0.0
    return tuple(_settled(tuple(x), float(time), constants, stiff, lock))


def run_voltages(state: State, rows: Rows, constants: Constants, lock: tuple[float, ...], out: Any) -> int:
    """`runs.run_voltages` of any arm."""
    run: Callable[..., int] = _train_voltages if constants.active & TWO_MASS else runs.run_voltages
    return run(state, rows, constants, lock, out)


def run_servo(
    state: State, setpoints: Any, loop: ServoLoop, constants: Constants, lock: tuple[float, ...], out: Any, volts: Any
) -> int:
    """`runs.run_servo` of any arm."""
    run: Callable[..., int] = _train_servo if constants.active & TWO_MASS else runs.run_servo
    return run(state, setpoints, loop, constants, lock, out, volts)


def accelerations(out: Any, rows: Rows, constants: Constants, lock: tuple[float, ...], result: Any) -> None:
    """`runs.accelerations` of any arm: those of the motors over their gear ratios."""
    run: Callable[..., None] = _train_accelerations if constants.active & TWO_MASS else runs.accelerations
    run(out, rows, constants, lock, result)
