# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Positions that are read at the begin of a loop whose stamp is taken at its end: each is about a row older than that.

Where all rows take the same time that is a delay, and no stamp shows it. A row that takes longer does: its position was
read in time, and the step that it seems to have taken is that of the row before.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.settings import DATA

#: what is read together with a position, and the numbers by which rows are called
_READ = ("position", "velocity", "current", "link_position", "lines", "rows")


def bends(time: Floats, position: Floats) -> Floats:
    """(n - 2, J) what positions (n, J) are away from the lines between their neighbours, at times (n,)."""
    steps = np.diff(time)[:, None]
    before, after = steps[:-1], steps[1:]
    return np.asarray(position[1:-1] - (position[:-2] * after + position[2:] * before) / (before + after))


def scales(log: Log) -> Floats:
    """(J,) step of the encoder, or the usual bend of a row, of each position: less says nothing of a clock."""
    turns = [np.abs(np.diff(column[np.isfinite(column)], 2)) for column in log.position.T]
    usual = np.array([float(np.median(own)) if len(own) else 0.0 for own in turns])
    return np.maximum(np.maximum(log.quantum, 0.35 * usual), 1e-12)


def read_in_time(log: Log) -> Log:
    """The log with each position at the stamp of the row before, where uneven rows show that it was read then.

    Of normal bends, n of them, with a variance of its own for each clock, one is better than another by
    n / 2 log(S' / S) nat, S and S' the sums of their squares. That of the row before must be better than the stamps,
    and than an even clock about which stamps jitter. A note says what was done.
    """
    size = scales(log)
    clocks = (log.time[:-1], log.time[1:], np.arange(len(log) - 1.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        by_last, *others = (bends(time, log.position[1:]) / size for time in clocks)
        told = np.abs(by_last - others[0]) > 1.0
        # stamps that stand or go back, and those without a number, tell nothing
        on = np.diff(log.time) > 0.0
    told &= (on[:-2] & on[1:-1] & on[2:])[:, None]
    last, *squares = (float(np.minimum(x[told] ** 2, DATA.bend_most).sum()) for x in (by_last, *others))
    ratio = min(squares) / max(last, 1.0)
    if ratio < DATA.bend_ratio or np.count_nonzero(told) * np.log(ratio) < 2.0 * DATA.late_gain:
        return log
    read = {name: values[1:] for name in _READ if (values := getattr(log, name)) is not None}
    note = (
        f"time: {np.count_nonzero(told.any(axis=1))} rows that came late show that positions are read at the begin of "
        "a row whose stamp is taken at its end. Each is taken at the stamp of the row before; rows count by positions."
    )
    return replace(log.part(slice(len(log) - 1)), **read, notes=(*log.notes, note))
