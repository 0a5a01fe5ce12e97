# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Whole runs in one call: voltages held row by row, or the digital servo.

What drive trains need is compiled by itself, so that nobody waits for it who does not use it.

The functions here take plain numbers, named tuples and flat arrays, so that they compile; `Simulator`
and `Session` are their callers. With a list in place of the packed table they run as plain Python. A
row of `out` holds the state x and the bristles, twelve numbers; with `WIDE` stages behind them the
measured positions m and the rest of z. A run stops at the first state that is not finite and returns
its row, or -1.
"""

from collections.abc import Callable
from typing import Any

from puma_sim_core.dynamics.circuit import drive_at, has_damping, settled_state, with_damping
from puma_sim_core.dynamics.contact import cold_step, contact, contact_step, with_held
from puma_sim_core.dynamics.laws import (
    ALGEBRAIC,
    BRISTLE,
    CURRENT_LIMIT,
    DELAYED,
    DRY,
    LOCKED,
    MEMORY,
    SENSED,
    SMOOTH,
    TIMED,
    TWO_MASS,
    VARYING,
    Z_WIDTH,
    after_losses,
    deflections_of,
    row_readers,
    with_deflections,
    within_supply,
)
from puma_sim_core.dynamics.rigid import arm_step, derivative
from puma_sim_core.dynamics.sensed import measured_after
from puma_sim_core.dynamics.torques import bent_torques, push_over
from puma_sim_core.dynamics.two_mass import settled_links, train_rates, train_step, trains
from puma_sim_core.dynamics.types import FREE, NO_SLIP, STILL, Constants, Model, Rows, ServoLoop, State
from puma_sim_core.jit import Table, Vec, compiled, fitting, inlined, interpreted, merged, outlined
from puma_sim_core.servo.servo import MEMORY_WIDTH, SERVO_WIDTH, delayed, servo_at_rest, servo_sample

#: stages whose runs have rows of WIDE_ROW numbers instead of ROW
WIDE = SENSED | TWO_MASS | MEMORY
ROW, WIDE_ROW = 12, 12 + Z_WIDTH
deflections_in_row, z_in_row = row_readers(ROW)
#: stages of plants without dry friction that have a step of their own
_COMMON = SMOOTH | VARYING | BRISTLE | CURRENT_LIMIT | LOCKED | TIMED
#: stages that act before or after a step
_AROUND = SENSED | DELAYED
#: numbers of `late` in `run_servo` before the voltages that it holds back
LATE_WIDTH = 5


@inlined
def terminal_voltage(j: int, v: float, p: Table) -> float:
    """Voltage [V] at motor j's terminals for the commanded one, without the sag of the supply."""
    return within_supply(j, after_losses(j, v, p), p)


@compiled
def _supply_voltages(v1: float, v2: float, v3: float, p: Table) -> Vec:
    return within_supply(0, v1, p), within_supply(1, v2, p), within_supply(2, v3, p)


def supply_voltages(v1: float, v2: float, v3: float, p: Table) -> Vec:
    """Voltages [V] that the supply can give of the commanded ones: what a drive reports."""
    return fitting(_supply_voltages, p)(v1, v2, v3, p)


@compiled
def _terminal_voltages(v1: float, v2: float, v3: float, p: Table) -> Vec:
    return terminal_voltage(0, v1, p), terminal_voltage(1, v2, p), terminal_voltage(2, v3, p)


def terminal_voltages(v1: float, v2: float, v3: float, p: Table) -> Vec:
    """Voltages [V] at the three motors' terminals for the commanded ones."""
    return fitting(_terminal_voltages, p)(v1, v2, v3, p)


@inlined
def stages_of_step(active: int) -> int:
    """The stages that a step itself has, of those of a plant: what acts before or after it is none of them."""
    return active & ~(_AROUND | ALGEBRAIC) if has_damping(active) else active & ~_AROUND


@merged
def advance(state: State, v: Vec, t: float, h: float, n: int, model: Model, p: Table, lock: Vec) -> State:
    """The state after n steps of h seconds from time t [s] on with the voltages v held."""
    x, z, m = state
    if model.active != 0:
        return advance_stages(state, v, t, h, n, model, p, lock)
    b = deflections_of(z)
    # the literal 0 lets the compiler drop every stage that is not needed
    plain = Model(model.body, model.drive, 0)
    for _ in range(n):
        x, b = arm_step(x, b, v, h, plain, p, FREE, NO_SLIP)
    return State(x, z, m)


@merged
def advance_stages(state: State, v: Vec, t: float, h: float, n: int, model: Model, p: Table, lock: Vec) -> State:
    """`advance` for a plant with active stages."""
    x, z, m = state
    damped, active = has_damping(model.active), stages_of_step(model.active)
    b = deflections_of(z)
    now = Model(model.body, model.drive, active)
    for k in range(n):
        push = STILL
        if active & TIMED:
            now = Model(model.body, drive_at(t + (k + 0.5) * h, model.drive, p), active)
            push = push_over(t + k * h, h, p)
        at = now
        if damped:
            x, at = with_damping(x, v, now)
        if active & DRY:
            y, b = contact_step(x, b, v, h, at, p, lock, push)
        else:
            outside = (0.0, 0.0, 0.0, -push[0], -push[1], -push[2])
            if active & ~_COMMON == 0:
                # the mask lets the compiler drop the other stages
                y, b = arm_step(x, b, v, h, Model(at.body, at.drive, active & _COMMON), p, lock, outside)
            else:
                y, b = cold_step(x, b, v, h, at, p, lock, outside)
        if model.active & SENSED:
            m = measured_after(m, x, y, h, p)
        x = y
    if damped:
        x = settled_state(x, v, now, p)
    return State(x, with_deflections(z, b), m)


@inlined
def is_finite(x: Vec) -> bool:
    """Whether all nine numbers of the state are finite."""
    q1, q2, q3, w1, w2, w3, i1, i2, i3 = x
    total = q1 + q2 + q3 + w1 + w2 + w3 + i1 + i2 + i3
    return total - total == 0.0


@inlined
def store(out: Table, r: int, x: Vec, z: Vec) -> None:
    """Write state and bristles to row r."""
    for j in range(9):
        out[r, j] = x[j]
    for j in range(3):
        out[r, 9 + j] = z[j]


@inlined
def store_wide(out: Table, r: int, z: Vec, m: Vec) -> None:
    """Write measured positions, links and further deflections to row r, behind what `store` writes."""
    for j in range(3):
        out[r, ROW + j] = m[j]
    for j in range(Z_WIDTH - 3):
        out[r, ROW + 3 + j] = z[3 + j]


@inlined
def terminals(volts: Table, r: int, p: Table) -> Vec:
    """Voltages [V] at the three motors' terminals for row r of the commanded ones."""
    return (
        terminal_voltage(0, volts[r][0], p),
        terminal_voltage(1, volts[r][1], p),
        terminal_voltage(2, volts[r][2], p),
    )


@inlined
def store_state(out: Table, r: int, state: State, active: int) -> None:
    """Write a state to row r."""
    store(out, r, state.x, state.z)
    if active & WIDE:
        store_wide(out, r, state.z, state.m)


@outlined
def run_plain(state: State, rows: Rows, constants: Constants, out: Table) -> int:
    """`run_voltages` for a plant that needs no stage, in a loop that has nothing else in it."""
    model, p = constants
    x, z = state.x, state.z
    plain = Model(model.body, model.drive, 0)
    store(out, 0, x, z)
    b = deflections_of(z)
    for r in range(len(rows.count)):
        v = terminals(rows.voltage, r, p)
        for _ in range(rows.count[r]):
            x, b = arm_step(x, b, v, rows.step[r], plain, p, FREE, NO_SLIP)
        if not is_finite(x):
            return r + 1
        store(out, r + 1, x, z)
    return -1


@compiled
def _arm_voltages(state: State, rows: Rows, constants: Constants, lock: Vec, out: Table) -> int:
    """`run_voltages` of an arm whose links follow their motors."""
    if constants.model.active == 0:
        return run_plain(state, rows, constants, out)
    return held_rows(advance, state, rows, constants, lock, out)


@merged
def held_rows(
    advance: Callable[..., Any], state: State, rows: Rows, constants: Constants, lock: Vec, out: Table
) -> int:
    """`run_voltages` with a function like `advance`."""
    model, p = constants
    store_state(out, 0, state, model.active)
    for r in range(len(rows.count)):
        v = terminals(rows.voltage, r, p)
        state = advance(state, v, rows.time[r], rows.step[r], rows.count[r], model, p, lock)
        if not is_finite(state.x):
            return r + 1
        store_state(out, r + 1, state, model.active)
    return -1


@inlined
def arriving(j: int, u: float, late: Table) -> Vec:
    """(voltage that reaches amplifier j at the start of a sample, that after the held-back part);
    u [V]: asked for in this sample, which takes the place of the oldest in `late`."""
    size = int(late[4])
    k = LATE_WIDTH + j * size
    oldest = late[k]
    for i in range(k, k + size - 1):
        late[i] = late[i + 1]
    late[k + size - 1] = u
    return oldest, late[k]


@compiled
def _arm_servo(
    state: State, setpoints: Table, loop: ServoLoop, constants: Constants, lock: Vec, out: Table, volts: Table
) -> int:
    """`run_servo` of such an arm."""
    return servo_rows(advance, state, setpoints, loop, constants, lock, out, volts)


@merged
def servo_rows(
    advance: Callable[..., Any],
    state: State,
    setpoints: Table,
    loop: ServoLoop,
    constants: Constants,
    lock: Vec,
    out: Table,
    volts: Table,
) -> int:
    """`run_servo` with a function like `advance`."""
    model, p = constants
    active = model.active
    store_state(out, 0, state, active)
    row = 0
    pieces = 2 if active & DELAYED else 1
    for r in range(len(setpoints)):
        for _ in range(loop.samples):
            for j in range(3):
                k = j * MEMORY_WIDTH
                seen = state.m[j] if active & SENSED else state.x[j]
                u, loop.memory[k], loop.memory[k + 1] = servo_sample(
                    setpoints[r][j], seen, loop.memory[k], loop.memory[k + 1], loop.table, j * SERVO_WIDTH
                )
                volts[row, j] = delayed(j, u, loop.memory, loop.table)
            u1, u2, u3 = volts[row, 0], volts[row, 1], volts[row, 2]
            o1, o2, o3 = u1, u2, u3
            t, n, step = loop.start + row * (loop.steps * loop.h), loop.steps, loop.h
            if active & DELAYED:
                o1, u1 = arriving(0, u1, loop.late)
                o2, u2 = arriving(1, u2, loop.late)
                o3, u3 = arriving(2, u3, loop.late)
                n, step = int(loop.late[0]), loop.late[1]
            for _ in range(pieces):
                v = (terminal_voltage(0, o1, p), terminal_voltage(1, o2, p), terminal_voltage(2, o3, p))
                state = advance(state, v, t, step, n, model, p, lock)
                if active & DELAYED:
                    o1, o2, o3 = u1, u2, u3
                    t += n * step
                    n, step = int(loop.late[2]), loop.late[3]
            row += 1
            if not is_finite(state.x):
                return row
            store_state(out, row, state, active)
    return -1


def servo_memory(setpoint: Vec, position: Vec, servo: Table) -> Vec:
    """The memory of a servo at rest for `run_servo`, 3 * MEMORY_WIDTH numbers, without those that
    a delay holds back.

    setpoint, position : triples [rad]; servo : the table of `ServoConfig`.
    """
    return fitting(_servo_memory, servo)(setpoint, position, servo)


@compiled
def _servo_memory(setpoint: Vec, position: Vec, servo: Table) -> Vec:
    total1, before1 = servo_at_rest(setpoint[0], position[0], servo, 0)
    total2, before2 = servo_at_rest(setpoint[1], position[1], servo, SERVO_WIDTH)
    total3, before3 = servo_at_rest(setpoint[2], position[2], servo, 2 * SERVO_WIDTH)
    return total1, before1, total2, before2, total3, before3


@inlined
def x_in_row(out: Table, r: int) -> Vec:
    """State of the arm in a row of a run."""
    return (out[r, 0], out[r, 1], out[r, 2], out[r, 3], out[r, 4], out[r, 5], out[r, 6], out[r, 7], out[r, 8])


@inlined
def model_at(model: Model, p: Table, time: float) -> tuple[Any, ...]:
    """The model at an instant [s], and the torques [N.m] that push it from outside."""
    now, push = model.drive, STILL
    if model.active & TIMED:
        now, push = drive_at(time, model.drive, p), push_over(time, 0.0, p)
    return Model(model.body, now, model.active), push


@compiled
def _arm_accelerations(out: Table, rows: Rows, constants: Constants, lock: Vec, result: Table) -> None:
    """`accelerations` of such an arm."""
    model, p = constants
    active = model.active
    for r in range(len(result)):
        x = x_in_row(out, r)
        v = terminals(rows.voltage, r, p)
        at, push = model_at(model, p, rows.time[r])
        if active & ALGEBRAIC:
            x = settled_state(x, v, at, p)
        slip = (0.0, 0.0, 0.0, -push[0], -push[1], -push[2])
        held, deflected = lock, deflections_in_row(out, r, active)
        if active & DRY:
            held, slip = contact(x, deflected, STILL, at, p, lock, push)
            at = with_held(at, held)
        a = derivative(x, v, at, p, held, slip, bent_torques(deflected, active, p))
        for j in range(3):
            result[r, j] = a[3 + j]


@inlined
def train_advance(state: State, v: Vec, t: float, h: float, n: int, model: Model, p: Table, lock: Vec) -> State:
    """`advance` with drive trains."""
    x, z, m = state
    damped, active = has_damping(model.active), stages_of_step(model.active)
    now = Model(model.body, model.drive, active)
    for k in range(n):
        push = STILL
        if active & TIMED:
            now = Model(model.body, drive_at(t + (k + 0.5) * h, model.drive, p), active)
            push = push_over(t + k * h, h, p)
        at = now
        if damped:
            x, at = with_damping(x, v, now)
        y, z = train_step(x, z, v, h, at, p, lock, push)
        if model.active & SENSED:
            m = measured_after(m, x, y, h, p)
        x = y
    if damped:
        x = settled_state(x, v, now, p)
    return State(x, z, m)


@compiled
def _train_voltages(state: State, rows: Rows, constants: Constants, lock: Vec, out: Table) -> int:
    return held_rows(train_advance, state, rows, constants, lock, out)


@compiled
def _train_servo(
    state: State, setpoints: Table, loop: ServoLoop, constants: Constants, lock: Vec, out: Table, volts: Table
) -> int:
    return servo_rows(train_advance, state, setpoints, loop, constants, lock, out, volts)


@compiled
def _train_accelerations(out: Table, rows: Rows, constants: Constants, lock: Vec, result: Table) -> None:
    model, p = constants
    for r in range(len(result)):
        now, push = model_at(model, p, rows.time[r])
        a = train_rates(x_in_row(out, r), z_in_row(out, r), terminals(rows.voltage, r, p), now, p, lock, push)
        for j in range(3):
            result[r, j] = a[3 + j]


@compiled
def _settled(x: Vec, time: float, constants: Constants, stiff: Table, lock: Vec) -> Vec:
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
    return tuple(fitting(_settled, stiff)(tuple(x), float(time), constants, stiff, lock))


def run_voltages(state: State, rows: Rows, constants: Constants, lock: tuple[float, ...], out: Any) -> int:
    """Run with voltages held row by row.

    rows : voltages (n, 3) [V] as they reach the amplifiers, a delay of the input taken out; out (n + 1, ROW or
    WIDE_ROW), whose row r is the state at the start of row r. Returns the first row that is not finite, or -1.
    """
    run: Callable[..., int] = _train_voltages if constants.active & TWO_MASS else _arm_voltages
    return fitting(run, constants.table)(state, rows, constants, lock, out)


def run_servo(
    state: State, setpoints: Any, loop: ServoLoop, constants: Constants, lock: tuple[float, ...], out: Any, volts: Any
) -> int:
    """Run under the digital servo.

    setpoints (n, 3) [rad]; loop : `ServoLoop`; out (n * samples + 1, ROW or WIDE_ROW) and volts (n * samples, 3), as
    the servo asks for them, a row a sample. Returns the first row of `out` that is not finite, or -1.
    """
    run: Callable[..., int] = _train_servo if constants.active & TWO_MASS else _arm_servo
    return fitting(run, constants.table)(state, setpoints, loop, constants, lock, out, volts)


def accelerations(out: Any, rows: Rows, constants: Constants, lock: tuple[float, ...], result: Any) -> None:
    """Joint accelerations [rad/s^2] at the rows of `out`, written to result (n, 3): those of the motors over their gear
    ratios where joints are soft.

    rows : the voltage that reaches the amplifiers from each row on, and their times.
    """
    run: Callable[..., None] = _train_accelerations if constants.active & TWO_MASS else _arm_accelerations
    fitting(run, constants.table)(out, rows, constants, lock, result)
