# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`registers` for plain Python: any number of runs side by side in arrays of NumPy, with the same bits.

The step is that of one arm, with an array over the runs in place of each number, so that the interpreter goes through
it once for all of them. Sums and products of arrays have the bits of those of numbers; sine and cosine are the
polynomials of `registers`, as those of NumPy have no such promise.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from puma_sim_core.dynamics.lanes.following import build_sliding, moved, moved_alone, row_alone
from puma_sim_core.dynamics.lanes.places import DAMPING, HAS_DRY, LEVELS, NEAR_LIMIT
from puma_sim_core.dynamics.lanes.registers import build_trigonometry
from puma_sim_core.dynamics.rigid import build_arm
from puma_sim_core.dynamics.runs import terminals
from puma_sim_core.dynamics.types import Drive, Model, Rows
from puma_sim_core.jit import Table, Vec, interpreted, plain

# of the compiled kernel these are never called, and so never compiled
_, array_step = build_arm(build_trigonometry(np.floor, np.where)[1])
array_sliding_step, array_leaves = map(interpreted, build_sliding(array_step, np.where))


def follow_arrays(
    numbers: np.ndarray,
    active: int,
    rows: Rows,
    target: Any,
    measured: Any,
    corrected: Any,
    gain: Any,
    tables: Sequence[Table],
    alike: bool,
    parts: Sequence[int],
    lock: Vec,
) -> np.ndarray:
    """`following.follow_lanes` of m models with stages of `SLIDING` alone: innovations (m, n, 3).

    numbers (FOLLOWED, m) : those of `follow_lanes`, a column a model; tables, parts : m of them.
    """
    x, levels, damping = tuple(numbers[0:9]), tuple(numbers[LEVELS : LEVELS + 6]), tuple(numbers[DAMPING : DAMPING + 3])
    has_dry, near_limit = tuple(numbers[HAS_DRY : HAS_DRY + 3]), tuple(numbers[NEAR_LIMIT : NEAR_LIMIT + 3])
    body, drive = numbers[12:32], numbers[32:47]
    models = [Model(tuple(b), Drive(*d), active) for b, d in zip(body.T.tolist(), drive.T.tolist())]
    out, since = np.empty((numbers.shape[1], len(measured), 3)), 0.0
    for r, n in enumerate(rows.count):
        h, t, before, alone = rows.step[r], rows.time[r], x, np.zeros(len(models), dtype=bool)
        volts = [terminals(rows.voltage, r, p) for p in (tables[:1] if alike else tables)]
        v = tuple(np.transpose(volts))
        for _ in range(n):
            after = array_sliding_step(x, v, h, tuple(body), tuple(drive), levels, damping, tables[0], lock)
            alone |= array_leaves(x, after, v, h, tuple(drive), has_dry, near_limit)
            x = after
        since += n * h
        left = np.flatnonzero(alone).tolist()
        for m in left:
            own, v = _column(before, m), volts[0 if alike else m]
            _put_column(x, m, _or_nan(row_alone, own, v, t, h, n, models[m], parts[m], tables[m], lock))
        i = target[r]
        if i < 0:
            continue
        e = tuple(measured[i][j] - x[j] for j in range(3))
        out[:, i] = np.transpose(e)
        over, since = since, 0.0
        if not corrected[i]:
            continue
        slid, x = x, moved(x, e, gain)
        for m in left:
            own, seen, v = _column(slid, m), _column(e, m), volts[0 if alike else m]
            _put_column(x, m, _or_nan(moved_alone, own, seen, v, over, t + n * h, gain, models[m], tables[m], lock))
    return out


def _column(arrays: Any, m: int) -> Vec:
    return tuple(float(one[m]) for one in arrays)


def _put_column(arrays: Any, m: int, values: Vec) -> None:
    for one, value in zip(arrays, values):
        one[m] = value


def _or_nan(run: Callable[..., Vec], *arguments: Any) -> Vec:
    """What plain Python makes of a state, not finite where it stops."""
    try:
        return plain(run)(*arguments)
    except (OverflowError, ValueError, ZeroDivisionError):
        return (np.nan,) * 9
