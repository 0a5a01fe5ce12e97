# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The gate: rows that cannot be used are left out; a log is refused where a channel is wrong, or too little is left.

In order: numbers that are missing, and time stamps; a motion that the drives did not make; channels that are not what
they are called; rows and runs that no drive can make; a log of another plant. Each check presupposes those before it. A
log is split where more time is missing than the motion between two rows can be followed over, and each part is checked
again by itself; whole channels are judged by the longest part. Rows count from 1, the first row of numbers; a fault of
a whole channel has none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.identify.arrays import Bools, runs
from puma_sim_core.identify.checks.channel_faults import channel_faults, moderate_faults, unexplained
from puma_sim_core.identify.checks.plausibility import Coarse, Plausibility, coarse
from puma_sim_core.identify.checks.row_faults import (
    first_of_each,
    frozen_positions,
    frozen_voltages,
    jitter_faults,
    longest_gap,
    number_faults,
    position_faults,
    time_faults,
    voltage_spikes,
)
from puma_sim_core.identify.checks.undriven import undriven
from puma_sim_core.identify.data.coarse_clock import evenly_stamped
from puma_sim_core.identify.data.late_stamps import read_in_time
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import shortest_span
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.settings import CHECKS
from puma_sim_core.plant.mechanism import Mechanism

#: faults of a log, or of a part of it
Finder = Callable[[Log, Plausibility], list[Fault]]


@dataclass(frozen=True)
class Checked:
    """What of a log can be used.

    parts : the log, or stretches of it without the rows that cannot be used; cuts : faults of rows that were left out;
    faults : why nothing can be used, none where `parts` can; doubts : faults of channels that stand unless an effect
    explains the log; notes : what else was seen, as sentences.
    """

    parts: tuple[Log, ...] = ()
    cuts: tuple[Fault, ...] = ()
    faults: tuple[Fault, ...] = ()
    notes: tuple[str, ...] = ()
    doubts: tuple[Fault, ...] = ()


def check(log: Log, mechanism: Mechanism) -> Checked:
    """Find the rows of a log that can be used."""
    model = Plausibility(mechanism)
    whole, notes = _complete(read_in_time(evenly_stamped(log)))
    parts: list[Log] = [whole]
    cuts: list[Fault] = []
    for of_rows, find in _STAGES if mechanism.links_known else _OF_SENSORS:
        if of_rows:
            parts, found, faults = _cut(parts, find, model)
            cuts += found
        else:
            faults = find(max(parts, key=len), model)
        if faults:
            return Checked((), tuple(first_of_each(cuts)), tuple(faults), tuple(notes))
    notes += [*_bridged(parts), *_still(parts, mechanism)]
    doubts = _coarsely(_of_another_plant)(max(parts, key=len), model) if mechanism.links_known else []
    return Checked(tuple(parts), tuple(first_of_each(cuts)), (), tuple(notes), tuple(doubts))


def _complete(log: Log) -> tuple[Log, list[str]]:
    """The log without channels that nothing needs and that have rows without a number, and notes on it."""
    optional = {name: getattr(log, name) for name in ("velocity", "current", "setpoint")}
    gone = {name: None for name, v in optional.items() if v is not None and not np.isfinite(v).all()}
    notes = [*log.notes, *(f"{name} has rows without a number: not used." for name in gone)]
    return (replace(log, **gone) if gone else log), notes  # type: ignore[arg-type]


def _cut(parts: Sequence[Log], find: Finder, model: Plausibility) -> tuple[list[Log], list[Fault], list[Fault]]:
    """Parts of a log without the rows that a check finds, the faults of these, and those of whole channels.

    A part with a wrong channel is left out as a whole where it is the smaller share of the rows.
    """
    kept, cuts, wrong, left = list[Log](), list[Fault](), list[tuple[Log, list[Fault]]](), list(parts)
    while left:
        part = left.pop(0)
        faults = find(part, model) if _long_enough(part) else [_short(part)]
        of_channels = [fault for fault in faults if fault.row is None]
        pieces = [] if of_channels else _without(part, faults)
        if of_channels:
            wrong.append((part, of_channels))
        elif [len(piece) for piece in pieces] != [len(part)]:
            cuts += faults
            left = [*pieces, *left]
        else:
            kept.append(part)
    if not kept or 2 * sum(len(part) for part, _ in wrong) > sum(map(len, parts)):
        faults = [fault for _, faults in wrong for fault in faults]
        return [], cuts, first_of_each([*cuts, *faults[:1]] if cuts else faults)
    cuts += [replace(fault, row=part.row(0), rows=len(part)) for part, faults in wrong for fault in faults[:1]]
    return kept, cuts, []


def _without(part: Log, faults: Sequence[Fault]) -> list[Log]:
    """What is left of a part without rows that cannot be used, split where too much time is between two rows."""
    bad, edges = np.zeros(len(part), dtype=bool), np.zeros(len(part), dtype=np.int64)
    for fault in faults:
        row = int(np.searchsorted(part.rows, fault.row or 1))
        bad[row : row + fault.rows] = True
        edges[row] += fault.rows == 0
    kept = np.flatnonzero(~bad)
    away, edge = np.diff(part.time[kept]), np.diff(np.cumsum(edges)[kept]) > 0
    # where many rows are left out, those that are not do not tell what the drives got between them
    near = (away > 0.0) & (away <= longest_gap(part)) & (bad.mean() <= CHECKS.row_even_share)
    apart = edge | ((np.diff(kept) > 1) & ~near)
    return [part.part(rows) for rows in np.split(kept, np.flatnonzero(apart) + 1) if len(rows)]


def _numbers_and_times(part: Log, _: Plausibility) -> list[Fault]:
    return number_faults(part) or time_faults(part)


def _named_wrongly(part: Log, model: Plausibility) -> list[Fault]:
    """Channels that are not what they are called, by the part alone."""
    c = coarse(part)
    if c is None:
        what = f"{len(part)} rows of very uneven times"
        return [Fault.of("time", None, what, "rows that are spread over the log")]
    if _rests(part, model.mechanism).all():
        # a joint in a stop or with a brake rests under any constant voltage
        driven = [f"position{j + 1}" for j in range(part.joints) if np.ptp(part.voltage[:, j]) > 2.0 * model.unit[j]]
        what = "nothing moves: it stays within"
        found = [f"{what} {np.ptp(q):.2g} {model.mechanism.position_unit}" for q in part.position.T]
        return [f for f in frozen_positions(part, model, c) if f.channel in driven] or [
            Fault.of(f"position{j}", None, text, "a motion") for j, text in enumerate(found, 1)
        ]
    return jitter_faults(part) or channel_faults(model, c)


def _coarsely(find: Callable[[Log, Plausibility, Coarse], list[Fault]]) -> Finder:
    """A check that reads the slow part of a log too."""

    def found(part: Log, model: Plausibility) -> list[Fault]:
        c = coarse(part)
        return [] if c is None else find(part, model, c)

    return found


def _moderate(part: Log, model: Plausibility, c: Coarse) -> list[Fault]:
    return moderate_faults(model, c, coarse(part, CHECKS.gate_slow) or c)


def _of_another_plant(part: Log, model: Plausibility, c: Coarse) -> list[Fault]:
    return unexplained(model, c)


def _long_enough(part: Log) -> bool:
    return len(part) >= CHECKS.gate_least_rows and part.span >= _needed(part)


def _needed(part: Log) -> float:
    """Time [s] that a part must last: a motion, and what the filters spoil at its ends."""
    return max(CHECKS.gate_least_time, shortest_span(part.step) if part.step > 0.0 else 0.0)


def _short(part: Log) -> Fault:
    what = f"the log is too short: {part.extent} from {part.place(0)} on"
    return Fault.of("time", None, what, f"{CHECKS.gate_least_rows} rows and {_needed(part):.2g} s at least")


def _rests(log: Log, mechanism: Mechanism) -> Bools:
    """(J,) whether a joint rests all the time; noise of the sensor is no motion."""
    still = np.zeros(log.joints, dtype=bool)
    for j, q in enumerate(log.position.T):
        blocks = [part.mean() for part in np.array_split(q, CHECKS.gate_rest_blocks)]
        width = float(np.ptp(mechanism.ranges[j]))
        least = max(CHECKS.gate_rest_steps * log.quantum[j], CHECKS.gate_rest_share * width)
        still[j] = np.ptp(blocks) <= least and np.ptp(q) < CHECKS.gate_rest_rows * width
    return still


def _outside(log: Log, model: Plausibility) -> list[Fault]:
    mechanism, found = model.mechanism, list[Fault]()
    for j, (low, high) in enumerate(mechanism.ranges):
        q, room = log.position[:, j], CHECKS.gate_outside * (high - low)
        outside = (q < low - room) | (q > high + room)
        whole = np.count_nonzero(outside) > CHECKS.row_many * len(q)
        for r, end in runs(outside)[: 1 if whole else None]:
            what = f"{q[r]:.5g} at {log.place(r)}, far outside the joint's range"
            expected = f"{low:.4g} to {high:.4g} {mechanism.position_unit}"
            found.append(Fault.of(f"position{j + 1}", None if whole else log.row(r), what, expected, end - r))
    return found


def _bridged(parts: Sequence[Log]) -> list[str]:
    """A note on the places of a log where a row is missing or late, and the motion is followed over it."""
    steps = np.concatenate([np.diff(part.time) for part in parts])
    middle = float(np.median(steps))
    longer = steps[steps > CHECKS.row_missing * middle]
    if not 0 < len(longer) < CHECKS.row_even_share * len(steps):
        return []
    where = f"{len(longer)} places" if len(longer) > 1 else "one place"
    return [f"Rows are missing or late in {where}: up to {longer.max():.3g} s, with rows every {middle:.3g} s."]


def _still(parts: Sequence[Log], mechanism: Mechanism) -> list[str]:
    """A note on each joint that rests all the time."""
    rest = np.all([_rests(part, mechanism) for part in parts], axis=0)
    return [f"Joint {j + 1} does not move: nothing can be said of it alone." for j in np.flatnonzero(rest)]


#: whether a check is of rows or of whole channels, and the check, in their order
_STAGES: tuple[tuple[bool, Finder], ...] = (
    (True, _numbers_and_times),
    (False, undriven),
    (False, _named_wrongly),
    (True, position_faults),
    (True, _coarsely(frozen_voltages)),
    (False, _coarsely(_moderate)),
    (True, _coarsely(frozen_positions)),
    (True, voltage_spikes),
    (True, _outside),
)
#: those that need no model of the motion
_OF_SENSORS = (_STAGES[0], _STAGES[-1])
