# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a run gives: times, voltages and states, and their CSV form.

Columns: ``time`` [s], ``voltage1..3`` [V], and, in the output of a run, ``position1..3`` [rad],
``velocity1..3`` [rad/s], ``current1..3`` [A]. The voltages of a row hold until the next row; the
state of a row is the state at its time. Numbers are written with every digit, so that a file
reads back to the same bits.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TextIO

import numpy as np

from puma_sim_core.errors import RecordingError
from puma_sim_core.files import whole_file
from puma_sim_core.recording.csv_rows import CsvRows

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
    path: str | os.PathLike[str], required: Sequence[str] = ("voltage",), optional: Sequence[str] = (), joints: int = 3
) -> Recording:
    """Read a recording of so many joints with the groups of columns that are asked for, in any order.

    Raises
    ------
    RecordingError : the file cannot be read, is empty, lacks a column, has an unknown or repeated
        one, a text in a number, a number that is not finite, a row that is cut off, or times that
        do not increase.
    """
    columns = {group: [f"{group}{j + 1}" for j in range(joints)] for group in (*required, *optional)}
    wanted, further = ([name for group in groups for name in columns[group]] for groups in (required, optional))
    rows = CsvRows(path)
    for group in optional:
        have = [name for name in columns[group] if name in rows.names]
        if 0 < len(have) < joints:
            what, where = f"only {len(have)} of the columns {group}1..{joints}", f"{path}, line {rows.names_line}"
            raise RecordingError(what, where=where, expected="all of them or none")
    found = _columns(rows, [(wanted, further)])
    groups = {
        group: np.column_stack([found[name] for name in names]) for group, names in columns.items() if names[0] in found
    }
    return Recording(time=found["time"], **groups)


def read_columns(
    path: str | os.PathLike[str], layouts: Sequence[tuple[Sequence[str], Sequence[str]]]
) -> dict[str, np.ndarray]:
    """Read a file that has, beside ``time``, the columns of one of several layouts.

    layouts : (names that must be there, names that may be) of each; the first whose required names
    are all there is taken.

    Returns name -> (n,) values, ``time`` first. Raises RecordingError as `read_csv` does.
    """
    return _columns(CsvRows(path), layouts)


def _columns(rows: CsvRows, layouts: Sequence[tuple[Sequence[str], Sequence[str]]]) -> dict[str, np.ndarray]:
    path, names, where = rows.path, rows.names, f"{rows.path}, line {rows.names_line}"
    fitting = [layout for layout in layouts if {"time", *layout[0]} <= set(names)]
    allowed = [name for layout in fitting[:1] or layouts for name in ("time", *layout[0], *layout[1])]
    for name in names:
        if name not in allowed:
            expected = f"columns among {', '.join(allowed)}"
            raise RecordingError(f"unknown column '{name}'", where=where, expected=expected)
        if names.count(name) > 1:
            raise RecordingError(f"column '{name}' stands twice", where=where, expected="each column once")
    if not fitting:
        missing = next(name for name in ("time", *layouts[0][0]) if name not in names)
        expected = " or ".join(f"the columns {', '.join(('time', *layout[0]))}" for layout in layouts)
        raise RecordingError(f"column '{missing}' is missing", where=where, expected=expected)
    blocks = list(rows.blocks(range(len(names)), finite=True))
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
    return {name: table[:, names.index(name)].copy() for name in dict.fromkeys(("time", *names))}
