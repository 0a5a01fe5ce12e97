# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Kalman predictor: the model follows a measured motion, and its innovations tell how well.

Each row the model predicts the measured positions of the next one; what they are away from the
prediction, the innovation, moves the model's state by a constant gain. With the gain of a steady
Kalman filter the innovations of a true model are independent of one another and of all voltages
before, also where feedback made those voltages out of the measured positions.

The correction w of a velocity stands for a torque M w / h that acted over the h seconds since the
last one and that the model does not know of. A joint that sticks under a torque T, below a level F
of friction, gets of it what that torque gives beyond its friction (`contact.past_friction`),

    sign(T + M w / h) max(|T + M w / h| - F, 0) h / M,

so that innovations do not jump where a little more friction makes the joint stick.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.dynamics.circuit import settled_state
from puma_sim_core.dynamics.contact import passing, rests
from puma_sim_core.dynamics.laws import (
    ALGEBRAIC,
    CURRENT_LIMIT,
    DELAYED,
    DRY,
    SENSED,
    TWO_MASS,
    current_bound,
    with_links,
)
from puma_sim_core.dynamics.runs import advance, is_finite, model_at, terminal_voltage, train_advance
from puma_sim_core.dynamics.two_mass import train_passing
from puma_sim_core.dynamics.types import Drive, Model, Rows, State
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.jit import compiled, inlined, merged
from puma_sim_core.simulation.open_circuit import enabled
from puma_sim_core.simulation.run_inputs import kernel_rows, native, rows_of
from puma_sim_core.simulation.simulator import Simulator

#: share of its limit from which a current counts as held by it
_HELD = 0.999999


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
        abs(x[6]) >= _HELD * current_bound(0, p)
        or abs(x[7]) >= _HELD * current_bound(1, p)
        or abs(x[8]) >= _HELD * current_bound(2, p)
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
def tracked_rows(
    advance: Any, passing: Any, state: Any, rows: Rows, track: Track, constants: Any, lock: Any, out: Any
) -> int:
    """Innovations of each row, with functions like `runs.advance` and `contact.passing`.

    out : its measured positions are replaced by the innovations, and the six numbers behind them by the positions and
    velocities that the model predicts there. Returns the first row whose state is not finite, or -1.
    """
    model, p = constants
    active, gain, since = model.active, track.gain, 0.0
    for r in range(len(rows.count)):
        a, b, c = track.on[r][0], track.on[r][1], track.on[r][2]
        now = Model(model.body, switched(model.drive, a, b, c), active)
        v = (
            a * terminal_voltage(0, rows.voltage[r][0], p),
            b * terminal_voltage(1, rows.voltage[r][1], p),
            c * terminal_voltage(2, rows.voltage[r][2], p),
        )
        before, parts = state, track.parts if active & CURRENT_LIMIT and at_limit(state.x, p) else 1
        while True:
            state = advance(before, v, rows.time[r], rows.step[r] / parts, rows.count[r] * parts, now, p, lock)
            if parts == track.parts or not active & CURRENT_LIMIT or not at_limit(state.x, p):
                break
            parts = track.parts
        x, z, m = state
        if not is_finite(x):
            return r
        k, span = track.target[r], rows.count[r] * rows.step[r]
        since += span
        if k < 0:
            continue
        e1 = out[k, 0] - (m[0] if active & SENSED else x[0])
        e2 = out[k, 1] - (m[1] if active & SENSED else x[1])
        e3 = out[k, 2] - (m[2] if active & SENSED else x[2])
        out[k, 0] = e1
        out[k, 1] = e2
        out[k, 2] = e3
        for j in range(6):
            out[k, 3 + j] = x[j]
        over, since = since, 0.0
        if not track.corrected[k]:
            continue
        pushed = (gain[1] * e1, gain[4] * e2, gain[7] * e3)
        d1, d2, d3 = pushed
        if active & DRY and rests(x, lock):
            # the torque that the model does not know of acts since the last correction, and so does friction
            at, push = model_at(now, p, rows.time[r] + span)
            if active & ALGEBRAIC:
                x = settled_state(x, v, at, p)
            d1, d2, d3 = passing(x, z, v, pushed, over, at, p, lock, push)
        # a current that is held at its limit stays there: moved, it could only fall
        if active & CURRENT_LIMIT:
            a = 0.0 if abs(x[6]) >= _HELD * current_bound(0, p) else a
            b = 0.0 if abs(x[7]) >= _HELD * current_bound(1, p) else b
            c = 0.0 if abs(x[8]) >= _HELD * current_bound(2, p) else c
        x = (
            x[0] + gain[0] * e1,
            x[1] + gain[3] * e2,
            x[2] + gain[6] * e3,
            x[3] + d1,
            x[4] + d2,
            x[5] + d3,
            x[6] + a * gain[2] * e1,
            x[7] + b * gain[5] * e2,
            x[8] + c * gain[8] * e3,
        )
        if active & SENSED:
            m = (m[0] + gain[0] * e1, m[1] + gain[3] * e2, m[2] + gain[6] * e3)
        if active & TWO_MASS:
            # friction holds motors, and no links
            w1, w2, w3 = pushed
            z = with_links(
                z, (z[3] + gain[0] * e1, z[4] + gain[3] * e2, z[5] + gain[6] * e3, z[6] + w1, z[7] + w2, z[8] + w3)
            )
        state = State(x, z, m)
    return -1


@compiled
def _tracked(state: Any, rows: Any, track: Any, constants: Any, lock: Any, out: Any) -> int:
    return tracked_rows(advance, passing, state, rows, track, constants, lock, out)


@compiled
def _tracked_trains(state: Any, rows: Any, track: Any, constants: Any, lock: Any, out: Any) -> int:
    return tracked_rows(train_advance, train_passing, state, rows, track, constants, lock, out)


class Tracked(NamedTuple):
    """Innovations [rad], predicted positions [rad] and velocities [rad/s], (n - 1, J) each."""

    innovation: np.ndarray
    position: np.ndarray
    velocity: np.ndarray


def innovations(
    simulator: Simulator,
    time: ArrayLike,
    voltage: ArrayLike,
    measured: ArrayLike,
    gain: ArrayLike,
    enable: ArrayLike | None = None,
    corrected: ArrayLike | None = None,
    parts: int = 1,
) -> Tracked:
    """Innovations of a model from its present state on.

    simulator : at time[0], its state is used up; time (n,) [s]; voltage (n, J) [V], row r held until time[r + 1];
    measured (n, J) positions [rad]; gain (J, 3): of position [1], velocity [1/s] and current [A/rad] for an innovation
    of a joint; enable (n, J), 0 where a drive is off; corrected (n - 1,): whether the innovation of a row moves the
    state, None: each does. Where it does not the model runs in open loop, and innovations are its errors; parts : that
    a step of integration is divided into where a current meets its limit or leaves it.

    Returns `Tracked`, at time[1:]. Raises ParameterError: shapes that do not go together; NonFiniteStateError: the
    state stopped being finite.
    """
    time = np.ascontiguousarray(time, dtype=float)
    plant, n = simulator.plant, len(time)
    J, axes = plant.joints, np.array(plant.axes)
    voltage, measured, gain = (np.asarray(a, dtype=float) for a in (voltage, measured, gain))
    if voltage.shape != (n, J) or measured.shape != (n, J) or gain.shape != (J, 3) or n < 2:
        what = f"time {time.shape}, voltage {voltage.shape}, measured {measured.shape}, gain {gain.shape}"
        raise ParameterError(what, where="innovations", expected=f"(n,), (n, {J}), (n, {J}), ({J}, 3)")
    volts = np.ascontiguousarray(plant.spread(voltage[:-1]))
    out = np.zeros((n - 1, 9))
    out[:, :3] = np.array(plant.rest)
    out[:, axes] = measured[1:]
    on = np.ones((n - 1, 3)) if enable is None else enabled(enable, n, plant.axes)[:-1].astype(float)
    target, edges = np.arange(n - 1), time
    active = simulator.constants.active
    if active & DELAYED:
        pieces, _ = simulator.past.arriving(time, volts)
        edges, volts = pieces.time, pieces.voltage
        target = np.full(len(volts), -1)
        target[pieces.row[1:] - 1] = np.arange(n - 1)
        on = on[np.clip(np.searchsorted(pieces.row, np.arange(len(volts)), side="right") - 1, 0, n - 2)]
    corrected = np.ones(n - 1, dtype=bool) if corrected is None else np.asarray(corrected, bool)
    if corrected.shape != (n - 1,):
        raise ParameterError(f"corrected {corrected.shape}", where="innovations", expected=f"({n - 1},)")
    gains = native(plant.spread(gain.T).T.ravel().tolist())
    run = _tracked_trains if active & TWO_MASS else _tracked
    rows = kernel_rows(volts, edges, np.diff(edges), simulator.max_step)
    track = Track(rows_of(on), rows_of(target), rows_of(corrected), gains, parts)
    bad = run(simulator.whole, rows, track, simulator.constants, simulator.lock, out)
    if bad >= 0 or not np.isfinite(out).all():
        raise NonFiniteStateError(int(bad))
    # of a whole arm without a copy
    own = [slice(first, first + 3) if J == 3 else first + axes for first in (0, 3, 6)]
    return Tracked(*(out[:, columns] for columns in own))
