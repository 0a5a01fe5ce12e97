# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A model that follows a measured motion, row by row: predicted to the end of a row, and corrected there.

What it is for, and where the correction comes from: `simulation.tracking`.
"""

from typing import Any, NamedTuple

from puma_sim_core.dynamics.circuit import settled_state
from puma_sim_core.dynamics.contact import passing, rests
from puma_sim_core.dynamics.laws import ALGEBRAIC, CURRENT_LIMIT, DRY, SENSED, TWO_MASS, current_bound, with_links
from puma_sim_core.dynamics.runs import advance, is_finite, model_at, terminal_voltage, train_advance
from puma_sim_core.dynamics.two_mass import train_passing
from puma_sim_core.dynamics.types import Drive, Model, Rows, State
from puma_sim_core.jit import compiled, inlined, merged

#: share of its limit from which a current counts as held by it
HELD = 0.999999


class Track(NamedTuple):
    """The measured motion that a model follows.

    on (k, 3) : 0.0 where a drive is cut off; target (k) : row of `out` whose first three numbers are the positions
    measured at the end of the row, -1 where none are; corrected : for each row of `out`, whether its innovation moves
    the state; gain : nine numbers, joint by joint for position, velocity and current; parts : of a step, in rows in
    which a current meets its limit or leaves it.
    """

    on: Any
    target: Any
    corrected: Any
    gain: Any
    parts: int


@inlined
def at_limit(x: Any, p: Any) -> bool:
    """Whether a current of the state is held by its limit."""
    return (
        abs(x[6]) >= HELD * current_bound(0, p)
        or abs(x[7]) >= HELD * current_bound(1, p)
        or abs(x[8]) >= HELD * current_bound(2, p)
    )


@inlined
def switched(drive: Drive, a: float, b: float, c: float) -> Drive:
    """Constants of the drives where 0.0 for a joint cuts its drive off."""
    return Drive(
        drive[0],
        drive[1],
        drive[2] * a,
        drive[3] * a,
        drive[4],
        drive[5],
        drive[6],
        drive[7] * b,
        drive[8] * b,
        drive[9],
        drive[10],
        drive[11],
        drive[12] * c,
        drive[13] * c,
        drive[14],
    )


@merged
def predicted(
    advance: Any, before: State, v: Any, t: float, h: float, n: int, model: Model, parts: int, p: Any, lock: Any
) -> Any:
    """The state after n steps of h seconds, with a function like `runs.advance`; in parts of steps where a current
    meets its limit or leaves it."""
    limited = model.active & CURRENT_LIMIT
    state, now = before, parts if limited and at_limit(before.x, p) else 1
    # a loop and no second call: the step is put in here as a whole
    while True:
        state = advance(before, v, t, h / now, n * now, model, p, lock)
        if not limited or now == parts or not at_limit(state.x, p):
            break
        now = parts
    return state


@merged
def moved_by(
    passing: Any,
    state: State,
    e: Any,
    v: Any,
    on: Any,
    over: float,
    t: float,
    gain: Any,
    model: Model,
    p: Any,
    lock: Any,
) -> Any:
    """The state that innovations e [rad] at time t [s] move, `over` seconds after the last ones, with a function like
    `contact.passing`."""
    x, z, m = state
    active = model.active
    a, b, c = on
    pushed = (gain[1] * e[0], gain[4] * e[1], gain[7] * e[2])
    d1, d2, d3 = pushed
    if active & DRY and rests(x, lock):
        # the torque that the model does not know of acts since the last correction, and so does friction
        at, push = model_at(model, p, t)
        if active & ALGEBRAIC:
            x = settled_state(x, v, at, p)
        d1, d2, d3 = passing(x, z, v, pushed, over, at, p, lock, push)
    # a current that is held at its limit stays there: moved, it could only fall
    if active & CURRENT_LIMIT:
        a = 0.0 if abs(x[6]) >= HELD * current_bound(0, p) else a
        b = 0.0 if abs(x[7]) >= HELD * current_bound(1, p) else b
        c = 0.0 if abs(x[8]) >= HELD * current_bound(2, p) else c
    x = (
        x[0] + gain[0] * e[0],
        x[1] + gain[3] * e[1],
        x[2] + gain[6] * e[2],
        x[3] + d1,
        x[4] + d2,
        x[5] + d3,
        x[6] + a * gain[2] * e[0],
        x[7] + b * gain[5] * e[1],
        x[8] + c * gain[8] * e[2],
    )
    if active & SENSED:
        m = (m[0] + gain[0] * e[0], m[1] + gain[3] * e[1], m[2] + gain[6] * e[2])
    if active & TWO_MASS:
        # friction holds motors, and no links
        w1, w2, w3 = pushed
        z = with_links(
            z, (z[3] + gain[0] * e[0], z[4] + gain[3] * e[1], z[5] + gain[6] * e[2], z[6] + w1, z[7] + w2, z[8] + w3)
        )
    return State(x, z, m)


@merged
def followed_rows(
    advance: Any, passing: Any, state: Any, rows: Rows, track: Track, constants: Any, lock: Any, out: Any
) -> int:
    """Innovations of each row, with functions like `runs.advance` and `contact.passing`.

    out : its measured positions are replaced by the innovations, and the six numbers behind them by the positions and
    velocities that the model predicts there. Returns the first row whose state is not finite, or -1.
    """
    model, p = constants
    active, since = model.active, 0.0
    for r in range(len(rows.count)):
        on = (track.on[r][0], track.on[r][1], track.on[r][2])
        now = Model(model.body, switched(model.drive, on[0], on[1], on[2]), active)
        v = (
            on[0] * terminal_voltage(0, rows.voltage[r][0], p),
            on[1] * terminal_voltage(1, rows.voltage[r][1], p),
            on[2] * terminal_voltage(2, rows.voltage[r][2], p),
        )
        state = predicted(advance, state, v, rows.time[r], rows.step[r], rows.count[r], now, track.parts, p, lock)
        if not is_finite(state.x):
            return r
        k, span = track.target[r], rows.count[r] * rows.step[r]
        since += span
        if k < 0:
            continue
        x, m = state.x, state.m
        e = (
            out[k, 0] - (m[0] if active & SENSED else x[0]),
            out[k, 1] - (m[1] if active & SENSED else x[1]),
            out[k, 2] - (m[2] if active & SENSED else x[2]),
        )
        for j in range(3):
            out[k, j] = e[j]
        for j in range(6):
            out[k, 3 + j] = x[j]
        over, since = since, 0.0
        if track.corrected[k]:
            end = rows.time[r] + span
            state = moved_by(passing, state, e, v, on, over, end, track.gain, now, p, lock)
    return -1


@compiled
def follow(state: Any, rows: Any, track: Any, constants: Any, lock: Any, out: Any) -> int:
    """`followed_rows` of an arm whose links follow its motors."""
    return followed_rows(advance, passing, state, rows, track, constants, lock, out)


@compiled
def follow_trains(state: Any, rows: Any, track: Any, constants: Any, lock: Any, out: Any) -> int:
    """`followed_rows` with drive trains."""
    return followed_rows(train_advance, train_passing, state, rows, track, constants, lock, out)
