# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One sample at a time, at the least cost of a call: for loops in Python around the kernel.

`runs.run_voltages` takes named tuples, whose forty numbers cost a call more than a step's arithmetic. Here the plant is
three flat arrays, and the state is a row of `out`, so that a sample goes from one row to the next.
"""

from typing import Any, NamedTuple

import numpy as np

from puma_sim_core.arm.rigid_body import Lumps
from puma_sim_core.dynamics.laws import AT_REST, TWO_MASS
from puma_sim_core.dynamics.runs import (
    ROW,
    WIDE,
    WIDE_ROW,
    advance,
    deflections_in_row,
    is_finite,
    store_state,
    terminal_voltage,
    train_advance,
    x_in_row,
    z_in_row,
)
from puma_sim_core.dynamics.types import FREE, Constants, Drive, Model, State
from puma_sim_core.jit import BACKEND, Table, Vec, compiled, inlined, merged, written

_BODY, _DRIVE = len(Lumps._fields), len(Drive._fields)


def _fields(first: int, count: int) -> str:
    return ", ".join(f"float(n[{k}])" for k in range(first, first + count))


#: (n) -> the model in a flat array
model_of = written(
    "model_of",
    "n",
    [f"return Model(Lumps({_fields(0, _BODY)}), Drive({_fields(_BODY, _DRIVE)}), int(n[{_BODY + _DRIVE}]))"],
    {"Model": Model, "Lumps": Lumps, "Drive": Drive},
)


@inlined
def state_in_row(out: Table, r: int, active: int) -> State:
    """The state in row r of a run."""
    x = x_in_row(out, r)
    if active & WIDE:
        return State(x, z_in_row(out, r), (out[r, ROW], out[r, ROW + 1], out[r, ROW + 2]))
    b = deflections_in_row(out, r, 0)
    return State(x, (b[0], b[1], b[2], x[0], x[1], x[2], x[3], x[4], x[5]) + AT_REST[9:], (x[0], x[1], x[2]))


@merged
def held_sample(
    advance: Any, plant: Table, p: Table, out: Table, rows: Any, v: Vec, time: float, count: int, step: float
) -> bool:
    """`hold` with a function like `runs.advance`."""
    at, to = rows
    model = model_of(plant)
    terminal = (terminal_voltage(0, v[0], p), terminal_voltage(1, v[1], p), terminal_voltage(2, v[2], p))
    state = advance(state_in_row(out, at, model.active), terminal, time, step, count, model, p, FREE)
    if not is_finite(state.x):
        return False
    store_state(out, to, state, model.active)
    return True


@compiled
def _arm_sample(plant: Table, p: Table, out: Table, rows: Any, v: Vec, time: float, count: int, step: float) -> bool:
    return held_sample(advance, plant, p, out, rows, v, time, count, step)


@compiled
def _train_sample(plant: Table, p: Table, out: Table, rows: Any, v: Vec, time: float, count: int, step: float) -> bool:
    return held_sample(train_advance, plant, p, out, rows, v, time, count, step)


class Flat(NamedTuple):
    """A plant as `hold` takes it: its model and its packed table in flat arrays, and the compiled function."""

    hold: Any
    model: Any
    table: Any
    width: int


def flat(constants: Constants) -> Flat:
    """The flat form of a plant's constants.

    ``hold(model, table, out, (at, to), v, time, count, step)`` goes on from the state in row `at` of out (n, width) at
    `time` [s], with the voltages v (3,) [V] held for `count` steps of `step` [s], and writes row `to`. Returns whether
    the state stayed finite; without that nothing is written.
    """
    body, drive, active = constants.model
    numbers = [float(value) for value in (*body, *drive, active)]
    table = [float(value) for value in constants.table]
    hold = _train_sample if active & TWO_MASS else _arm_sample
    width = WIDE_ROW if active & WIDE else ROW
    if BACKEND == "numba":
        return Flat(hold, np.array(numbers), np.array(table), width)
    return Flat(hold, numbers, table, width)
