# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What a run gives: times, voltages and states, and their CSV form.

Columns: ``time`` [s], ``voltage1..3`` [V], and, in the output of a run, ``position1..3`` [rad],
``velocity1..3`` [rad/s], ``current1..3`` [A]. The voltages of a row hold until the next row; the
state of a row is the state at its time. Numbers are written with every digit, so that a file
reads back to the same bits.
"""

from __future__ import annotations

import io
import math
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from puma_sim_core.errors import RecordingError
from puma_sim_core.files import whole_file
from puma_sim_core.recording.csv_rows import check_count, fields_of, number_of

#: groups of three columns, in the order of a file, with the attribute that holds each
GROUPS = ("voltage", "setpoint", "position", "velocity", "current")
#: rows that are turned into text at once: enough to be quick, few enough to take little memory
_WRITTEN_AT_ONCE = 4096


@dataclass(frozen=True)
class Recording:
    """Synchronous samples of a run.

    time (n,) [s]; voltage (n, 3) [V]; position (n, 3) [rad]; velocity (n, 3) [rad/s]; current
    (n, 3) [A]; setpoint (n, 3) [rad]; acceleration (n, 3) [rad/s^2]. All but the first are None
    where the recording has none of them; acceleration has no columns in a file.
    """

    time: np.ndarray
    voltage: np.ndarray | None = None
    position: np.ndarray | None = None
    velocity: np.ndarray | None = None
    current: np.ndarray | None = None
    setpoint: np.ndarray | None = None
    acceleration: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.time)

    def columns(self) -> Iterator[tuple[str, np.ndarray]]:
        """(name, values) of each column of the file."""
        yield "time", self.time
        for group in GROUPS:
            values = getattr(self, group)
            if values is not None:
                for j in range(values.shape[1]):
                    yield f"{group}{j + 1}", values[:, j]


def write_rows(recording: Recording, file: TextIO, report: Callable[[int], None] = lambda rows: None) -> None:
    """Write a recording to an open text file; `report` is told how many rows were written."""
    names, columns = zip(*recording.columns())
    file.write(",".join(names) + "\n")
    for first in range(0, len(recording), _WRITTEN_AT_ONCE):
        rows = np.column_stack([c[first : first + _WRITTEN_AT_ONCE] for c in columns]).tolist()
        file.write("".join(f"{','.join(map(repr, row))}\n" for row in rows))
        report(first + len(rows))


def write_csv(recording: Recording, path: str | os.PathLike) -> None:
    """Write a recording; the file appears complete or not at all.

    Raises
    ------
    RecordingError : the file cannot be written.
    """
    with whole_file(path, RecordingError) as file:
        write_rows(recording, file)


def read_csv(
    path: str | os.PathLike, required: Sequence[str] = ("voltage",), optional: Sequence[str] = (), joints: int = 3
) -> Recording:
    """Read a recording of so many joints with the groups of columns that are asked for.

    Lines that begin with '#' are skipped. Columns may stand in any order.

    Raises
    ------
    RecordingError : the file cannot be read, is empty, lacks a column, has an unknown or repeated
        one, a text in a number, a number that is not finite, a row that is cut off, or times that
        do not increase; names the file, the line and the column.
    """
    names, table = _table(
        path, lambda names, line: _check_names(names, path, line, tuple(required), tuple(optional), joints)
    )
    groups = {}
    for group in (*required, *optional):
        columns = [f"{group}{j + 1}" for j in range(joints)]
        if columns[0] in names:
            groups[group] = table[:, [names.index(column) for column in columns]]
    return Recording(time=table[:, names.index("time")].copy(), **groups)


def read_columns(
    path: str | os.PathLike, layouts: Sequence[tuple[Sequence[str], Sequence[str]]]
) -> dict[str, np.ndarray]:
    """Read a file that has, beside ``time``, the columns of one of several layouts.

    layouts : (names that must be there, names that may be) of each; the first whose required names
    are all there is taken.

    Returns
    -------
    name -> (n,) values, ``time`` first.

    Raises
    ------
    RecordingError : as `read_csv`.
    """

    def check(names, line):
        where = f"{path}, line {line}"
        fitting = next((layout for layout in layouts if {"time", *layout[0]} <= set(names)), None)
        if fitting is None:
            raise RecordingError(
                f"columns {', '.join(names)}",
                where=where,
                expected=" or ".join(", ".join(("time", *layout[0])) for layout in layouts),
            )
        for name in names:
            if name not in ("time", *fitting[0], *fitting[1]):
                raise RecordingError(
                    f"unknown column '{name}'",
                    where=where,
                    expected=f"columns among time, {', '.join((*fitting[0], *fitting[1]))}",
                )
            if names.count(name) > 1:
                raise RecordingError(f"column '{name}' stands twice", where=where, expected="each column once")

    names, table = _table(path, check)
    return {name: table[:, names.index(name)].copy() for name in ("time", *(name for name in names if name != "time"))}


def _table(path, check: Callable[[list[str], int], None]) -> tuple[list[str], np.ndarray]:
    """Column names and rows (n, columns) of a file; `check` is given the names and their line."""
    path = Path(path)
    try:
        # whole, since it may have to be read twice and may be a pipe
        with open(path, encoding="utf-8-sig", newline="") as file:
            text = file.read()
    except OSError as error:
        raise RecordingError(f"cannot be read ({error.strerror})", where=str(path), expected="a CSV file") from None
    except UnicodeDecodeError:
        raise RecordingError("is not text", where=str(path), expected="a CSV file") from None
    file = io.StringIO(text, newline="")
    numbered = ((n, line) for n, line in enumerate(file, start=1) if line.strip() and not line.lstrip().startswith("#"))
    first = next(numbered, None)
    if first is None:
        raise RecordingError("is empty", where=str(path), expected="a line of column names")
    names = [name.strip() for name in fields_of(first[1], path, first[0])]
    check(names, first[0])
    start = file.tell()
    table = _clean_table(file, names)
    if table is None:
        file.seek(start)
        table = _diagnosed_table(numbered, names, path)
    return names, table


def _clean_table(file, names) -> np.ndarray | None:
    """Rows of numbers (n, columns) by NumPy's reader, or None where anything is unusual.

    It gives the same bits as float() and is several times quicker, but cannot say what is wrong.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # that there are no rows
            table = np.loadtxt(file, delimiter=",", comments=None, ndmin=2, encoding="utf-8")
    except (ValueError, UserWarning):
        return None
    usable = (
        table.shape[1] == len(names)
        and np.isfinite(table).all()
        and (np.diff(table[:, names.index("time")]) > 0.0).all()
    )
    return table if usable else None


def _diagnosed_table(numbered, names, path) -> np.ndarray:
    """Rows of numbers (n, columns), line by line; raises RecordingError at the first fault."""
    time = names.index("time")
    rows = []
    for number, line in numbered:
        row = _row(line, names, path, number)
        if rows and not row[time] > rows[-1][time]:
            raise RecordingError(
                f"time {row[time]!r} after {rows[-1][time]!r}",
                where=f"{path}, line {number}, column time",
                expected="times that increase",
            )
        rows.append(row)
    if not rows:
        raise RecordingError("has no rows", where=str(path), expected="at least one row of numbers")
    return np.array(rows, dtype=float)


def _check_names(names, path, line, required, optional, joints) -> None:
    where = f"{path}, line {line}"
    numbers = range(1, joints + 1)
    wanted = ["time"] + [f"{group}{j}" for group in required for j in numbers]
    allowed = wanted + [f"{group}{j}" for group in optional for j in numbers]
    for name in names:
        if name not in allowed:
            raise RecordingError(
                f"unknown column '{name}'", where=where, expected=f"columns among {', '.join(allowed)}"
            )
        if names.count(name) > 1:
            raise RecordingError(f"column '{name}' stands twice", where=where, expected="each column once")
    for name in wanted:
        if name not in names:
            raise RecordingError(
                f"column '{name}' is missing", where=where, expected=f"the columns {', '.join(wanted)}"
            )
    for group in optional:
        have = [j for j in numbers if f"{group}{j}" in names]
        if have and len(have) < joints:
            raise RecordingError(
                f"only {len(have)} of the columns {group}1..{joints}", where=where, expected="all three or none"
            )


def _row(line, names, path, number) -> list[float]:
    fields = fields_of(line, path, number)
    check_count(fields, names, path, number)
    row = []
    for name, field in zip(names, fields):
        where = f"{path}, line {number}, column {name}"
        value = number_of(field, where)
        if not math.isfinite(value):
            raise RecordingError(field.strip(), where=where, expected="a finite number")
        row.append(value)
    return row
