# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stamps of a clock whose ticks are longer than a row: several rows in turn have the same one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.settings import DATA


def evenly_stamped(log: Log) -> Log:
    """The log with the times of an even clock, where its stamps are those in ticks; as it is where they are not.

    They are where each stamp is the one before or one tick later, all of them within a tick of a straight line over the
    rows, and positions move between rows of one stamp as they do between others. A note says what was done.
    """
    found = _even(log.time)
    if found is None or not _moves_alike(log):
        return log
    time, tick = found
    note = (
        f"time: the stamps repeat, {len(log)} rows on {len(np.unique(log.time))}. They are those of an even clock in "
        f"ticks of {tick:.4g} s, and the rows are taken as one every {time[1] - time[0]:.4g} s."
    )
    return replace(log, time=time, notes=(*log.notes, note))


def _even(stamps: Floats) -> tuple[Floats, float] | None:
    """(n,) times of rows that came evenly, and the tick [s] of the clock that stamped them; None of other stamps."""
    if not np.isfinite(stamps).all():
        return None
    steps = np.diff(stamps)
    if (steps < 0.0).any() or (steps > 0.0).all() or not (steps > 0.0).any():
        return None
    ticked = steps[steps > 0.0]
    tick = float(np.median(ticked))
    if (np.abs(ticked - tick) > DATA.clock_even * tick).any():
        return None
    rows = np.arange(len(stamps), dtype=float)
    # the line through the first rows of the ticks, which are later than their stamps by less than a row
    first = np.flatnonzero(steps > 0.0) + 1
    if len(first) < DATA.clock_ticks:
        return None
    slope, start = np.polyfit(rows[first], stamps[first], 1)
    line = start + slope * rows
    if np.ptp(line - stamps) > (1.0 + DATA.clock_even) * tick:
        return None
    return line, tick


def _moves_alike(log: Log) -> bool:
    """Whether a row with the stamp of the one before has a new position as often as one with a new stamp."""
    moved = (np.diff(log.position, axis=0) != 0.0).any(axis=1)
    again = np.diff(log.time) == 0.0
    return bool(moved[again].mean() > DATA.clock_moved * moved[~again].mean())
