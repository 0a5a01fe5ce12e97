# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The start of a log, in which a hand may hold the machine, or a drive may be off.

The model without effects predicts the log; what it misfits in the first windows is compared with the worst of the
later ones. No effect that goes on acting makes it many times as large at the start alone, unless the joint that is held
longest is in a position, or under a voltage, that it does not come to again: a stop or a limit may be met there.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from puma_sim_core.identify.arrays import Floats, runs
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.settings import CHECKS, FITTING


def held_starts(logs: Sequence[Log], predictor: Predictor, errors: Floats) -> list[Fault | None]:
    """Of each log the rows at its start in which it does not answer to its inputs, None without any.

    errors (N, J) : innovations of the model without effects, of all logs.
    """
    ends = np.cumsum([len(stretch.time) - 1 for stretch in predictor.stretches])
    own = zip(logs, predictor.stretches, np.split(errors, ends[:-1]))
    return [_held_start(log, stretch.time[1:], e) for log, stretch, e in own]


def _held_start(log: Log, time: Floats, errors: Floats) -> Fault | None:
    begin = float(log.time[0])
    # a part behind a gap has no start of its own; positions that are stamped late begin with the second row
    if log.row(0) > 2 or time[-1] - begin < CHECKS.start_longest + CHECKS.start_beside:
        return None
    held = [(until, j) for j, until in enumerate(_until(time - begin, errors)) if until > FITTING.settling_time]
    if not held:
        return None
    until, j = max(held)
    rows = int(np.searchsorted(log.time, begin + until))
    if not all(_within(of[:rows, j], of[rows:, j]) for of in (log.position, log.voltage)):
        return None
    what = f"does not answer to its input at the start as later: {rows} rows, to {log.place(rows - 1)}"
    return Fault.of(f"position{j + 1}", log.row(0), what, "a joint that nothing but its drive moves", rows)


def _within(values: Floats, others: Floats) -> bool:
    """Whether all but a few of some values lie between the least and the greatest of others."""
    outside = (values < others.min()) | (values > others.max())
    return float(outside.mean()) < CHECKS.start_elsewhere


def _until(time: Floats, errors: Floats) -> Iterator[float]:
    """Of each joint the end [s] of the windows that are worse than any later one, and begin before the predictor has
    settled; 0 where none is so by far. time (n,) : from the start of the log on."""
    width = max(CHECKS.start_window, CHECKS.start_window_rows * float(np.median(np.diff(time))))
    number = (time / width).astype(int)
    later = np.unique(number[time >= CHECKS.start_longest])
    for e in errors.T:
        squares = np.bincount(number, e**2) / np.maximum(np.bincount(number), 1)
        worst = float(squares[later].max())
        begin, end = next(iter(runs(squares[: later[0]] > worst)), (0, 0))
        by_far = end > begin and squares[begin:end].max() > CHECKS.start_excess * worst
        yield end * width if by_far and begin * width < FITTING.settling_time else 0.0
