# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a run gives: times, voltages and states, and their CSV form.

Columns: ``time`` [s], ``voltage1..3`` [V], and, in the output of a run, ``position1..3`` [rad],
``velocity1..3`` [rad/s], ``current1..3`` [A]. The voltages of a row hold until the next row; the
state of a row is the state at its time. Numbers are written with every digit, so that a file
reads back to the same bits.
"""

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TextIO

import numpy as np

from puma_sim_core.errors import RecordingError, one_of
from puma_sim_core.files import whole_file
from puma_sim_core.recording.column_names import own_column, unit_in
from puma_sim_core.recording.csv_rows import CsvRows

#: what a person should know beside the result
LOG = logging.getLogger("puma_sim")

#: groups of three columns, in the order of a file, with the attribute that holds each
GROUPS = ("voltage", "setpoint", "position", "velocity", "current")
#: rows that are turned into text at once: enough to be quick, few enough to take little memory
_WRITTEN_AT_ONCE = 4096


@dataclass(frozen=True)
class Recording:
    """Synchronous samples of a run; None for what it has none of."""

    time: np.ndarray  #: (n,) [s]
    voltage: np.ndarray | None = None  #: (n, 3) [V]
    position: np.ndarray | None = None  #: (n, 3) [rad]
    velocity: np.ndarray | None = None  #: (n, 3) [rad/s]
    current: np.ndarray | None = None  #: (n, 3) [A]
    setpoint: np.ndarray | None = None  #: (n, 3) [rad]
    acceleration: np.ndarray | None = None  #: (n, 3) [rad/s^2]; has no columns in a file

    def __len__(self) -> int:
        return len(self.time)

    def states(self) -> np.ndarray:
        """(n, 9) positions, velocities and currents side by side."""
        return np.hstack([getattr(self, name) for name in ("position", "velocity", "current")])

    def columns(self) -> Iterator[tuple[str, np.ndarray]]:
        """(name, values) of each column of the file."""
        yield "time", self.time
        for group in GROUPS:
            values = getattr(self, group)
            for j, column in enumerate(() if values is None else values.T, start=1):
                yield f"{group}{j}", column


def write_rows(recording: Recording, file: TextIO, report: Callable[[int], None] = lambda rows: None) -> None:
    """Write a recording to an open text file; `report` gets the number of rows written."""
    names, columns = zip(*recording.columns())
    file.write(",".join(names) + "\n")
    for first in range(0, len(recording), _WRITTEN_AT_ONCE):
        rows = np.column_stack([c[first : first + _WRITTEN_AT_ONCE] for c in columns]).tolist()
        file.write("".join(f"{','.join(map(repr, row))}\n" for row in rows))
        report(first + len(rows))


def write_csv(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording; the file appears complete or not at all. Raises RecordingError."""
    with whole_file(path, RecordingError) as file:
        write_rows(recording, file)


def read_csv(
    path: str | os.PathLike[str],
    required: Sequence[str] = ("voltage",),
    optional: Sequence[str] = (),
    joints: int = 3,
    columns: Mapping[str, str] | None = None,
) -> Recording:
    """Read a recording of so many joints with the groups of columns that are asked for, in any order; other columns
    are left out. Units behind the names of columns are converted.

    columns : our name -> the file's, of columns that are called otherwise.

    Raises
    ------
    RecordingError : the file cannot be read, is empty, lacks a column or has one twice, a text in a number, a number
        that is not finite, a row that is cut off, or times that do not increase.
    """
    groups = {group: [f"{group}{j + 1}" for j in range(joints)] for group in (*required, *optional)}
    wanted, further = ([name for group in some for name in groups[group]] for some in (required, optional))
    rows = CsvRows(path, measured=True)
    taken = _taken(rows, ["time", *wanted, *further], columns or {})
    for group in optional:
        have = [name for name in groups[group] if name in taken]
        if 0 < len(have) < joints:
            what, where = f"only {len(have)} of the columns {group}1..{joints}", f"{path}, line {rows.names_line}"
            raise RecordingError(what, where=where, expected="all of them or none")
    missing = [name for name in ("time", *wanted) if name not in taken]
    if missing:
        expected = f"the columns {', '.join(('time', *wanted))}; there are {', '.join(rows.names)}"
        where = f"{path}, line {rows.names_line}"
        raise RecordingError(f"column '{missing[0]}' is missing", where=where, expected=expected)
    left = [name for name in rows.names if name not in taken.values()]
    if left:
        LOG.info("note: %s: columns that are not used: %s", path, ", ".join(left))
    found = _table(rows, taken)
    for name, column in taken.items():
        found[name] *= unit_in(rows, rows.names.index(column), name.rstrip("0123456789"))[1]
    return Recording(
        time=found["time"],
        **{
            group: np.column_stack([found[name] for name in names])
            for group, names in groups.items()
            if names[0] in found
        },
    )


def _taken(rows: CsvRows, names: Sequence[str], columns: Mapping[str, str]) -> dict[str, str]:
    """Our name -> the file's, of the columns that it has; raises RecordingError."""
    where = f"{rows.path}, line {rows.names_line}"
    for ours, theirs in columns.items():
        if ours not in names:
            raise RecordingError(f"'{ours}' is not read here", where="--columns", expected=one_of(ours, names))
        if theirs not in rows.names:
            expected = one_of(theirs, rows.names, f"the columns {', '.join(rows.names)}")
            raise RecordingError(f"no column '{theirs}' (asked for as {ours})", where=where, expected=expected)
    # a column that is given to another name is not also the one of its own name
    own = {n: column for n in names if (column := own_column(n, rows.names)) and column not in columns.values()}
    taken = {name: column for name in names if (column := {**own, **columns}.get(name)) is not None}
    for column in taken.values():
        if rows.names.count(column) > 1:
            raise RecordingError(f"column '{column}' stands twice", where=where, expected="each column once")
    return taken


def read_columns(
    path: str | os.PathLike[str], layouts: Sequence[tuple[Sequence[str], Sequence[str]]]
) -> dict[str, np.ndarray]:
    """Read a file that has, beside ``time``, the columns of one of several layouts.

    layouts : (names that must be there, names that may be) of each; the first whose required names
    are all there is taken.

    Returns name -> (n,) values, ``time`` first. Raises RecordingError as `read_csv` does, and for other columns.
    """
    rows = CsvRows(path)
    names, where = rows.names, f"{path}, line {rows.names_line}"
    fitting = [layout for layout in layouts if {"time", *layout[0]} <= set(names)]
    allowed = [name for layout in fitting[:1] or layouts for name in ("time", *layout[0], *layout[1])]
    for name in names:
        if name not in allowed:
            expected = one_of(name, allowed, f"the columns {', '.join(allowed)}")
            raise RecordingError(f"unknown column '{name}'", where=where, expected=expected)
        if names.count(name) > 1:
            raise RecordingError(f"column '{name}' stands twice", where=where, expected="each column once")
    if not fitting:
        missing = next(name for name in ("time", *layouts[0][0]) if name not in names)
        expected = " or ".join(f"the columns {', '.join(('time', *layout[0]))}" for layout in layouts)
        raise RecordingError(f"column '{missing}' is missing", where=where, expected=expected)
    return _table(rows, {name: name for name in dict.fromkeys(("time", *names))})


def _table(rows: CsvRows, taken: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Our name -> (n,) finite numbers, times that increase among them; raises RecordingError."""
    names, path = list(taken), rows.path
    blocks = list(rows.blocks([rows.names.index(column) for column in taken.values()], finite=True))
    if not blocks:
        raise RecordingError("has no rows", where=str(path), expected="at least one row of numbers")
    table = np.concatenate([block.values for block in blocks])
    time = table[:, names.index("time")]
    back = np.flatnonzero(~(np.diff(time) > 0.0))
    if back.size:
        row = int(back[0])
        line = np.concatenate([block.lines for block in blocks])[row + 1]
        what = f"time {float(time[row + 1])!r} after {float(time[row])!r}"
        raise RecordingError(what, where=f"{path}, line {line}, column time", expected="times that increase")
    return {name: table[:, place].copy() for place, name in enumerate(names)}
