# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Reading of logs: anyone's CSV or a bag of `sim_node` as a `Log`.

Channels: ``time`` [s], ``voltage1..J`` [V], ``position1..J`` [rad or m], and, where there are any,
``velocity1..J``, ``current1..J``, ``setpoint1..J``, ``enable`` or ``enable1..J`` (0: the drive is
off and no current flows). The voltage of a row is the commanded one and holds until the next row;
the position of a row is the one at its time. What a file says is taken over as it stands, gaps
and NaN included: `gate` judges it. Rows count from 1, the first row of numbers.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from puma_sim_core.errors import RecordingError
from puma_sim_core.identify.data.bag_log import read_bag_log
from puma_sim_core.identify.data.log import Log, channels
from puma_sim_core.identify.settings import DATA
from puma_sim_core.recording.csv_rows import CsvRows

#: groups of channels, in the order of a file; the first two must be there
GROUPS = ("voltage", "position", "velocity", "current", "setpoint", "enable")
_REQUIRED = ("voltage", "position")


def parse_columns(text: str) -> dict[str, str]:
    """The map written as ``time=t_s,voltage1=motor_V``: channel -> column of the file.

    Raises
    ------
    RecordingError : an entry without '=', or a channel twice.
    """
    columns: dict[str, str] = {}
    for entry in filter(str.strip, text.split(",")):
        channel, equals, column = (part.strip() for part in entry.partition("="))
        if not (channel and equals and column):
            raise RecordingError(
                f"'{entry.strip()}'", where="columns", expected="CHANNEL=COLUMN, such as voltage1=motor_V"
            )
        if channel in columns:
            raise RecordingError(f"channel '{channel}' stands twice", where="columns", expected="each channel once")
        columns[channel] = column
    return columns


def read_log(
    path: str | os.PathLike,
    columns: Mapping[str, str] | None = None,
    joints: int = 3,
    *,
    greatest_rows: int = DATA.reading_greatest_rows,
) -> Log:
    """Read a CSV file or a bag (its directory or its .mcap file).

    Parameters
    ----------
    columns : channel -> column of the file, for names that are not those of the channels.
    joints : J, of the mechanism that the log is of.
    greatest_rows : of a longer CSV file the first so many are read, and a note says so.

    Raises
    ------
    RecordingError : a file that cannot be read, is empty or no text; a map to a column that is
        not there, a channel that is missing or stands twice, a text in a number, a row that is
        cut off; names the file, the line and the column.
    BagError : a directory or .mcap file that is no whole bag of the simulator.
    """
    if Path(path).is_dir() or Path(path).suffix == ".mcap":
        if columns:
            raise RecordingError("a map of columns", where=str(path), expected="none for a bag")
        return read_bag_log(path, joints)
    return _read_csv(path, dict(columns or {}), joints, greatest_rows)


def _read_csv(path, columns, joints, greatest_rows) -> Log:
    rows = CsvRows(path)
    chosen, notes = _choose(rows, columns, joints, path)
    places = [place for group in chosen.values() for place in group]
    blocks, lines, count = [], [], 0
    for block in rows.blocks(places):
        blocks.append(block.values[: greatest_rows - count])
        lines.append(block.lines[: greatest_rows - count])
        count += len(block.values)
        if count > greatest_rows:
            notes.append(
                f"The file has more than {greatest_rows} rows; the first "
                f"{greatest_rows} were read. Cut the file to look at another stretch."
            )
            break
    if count == 0:
        raise RecordingError("has no rows", where=str(path), expected="rows of numbers")
    table, lines = np.concatenate(blocks), np.concatenate(lines)
    if rows.cut and len(table) > 1:
        notes.append(f"The last row (line {lines[-1]}) has no line end: it may be cut off and is left out.")
        table, lines = table[:-1], lines[:-1]
    groups, first = {}, 0
    for group, found in chosen.items():
        groups[group] = table[:, first : first + len(found)].copy()
        first += len(found)
    time = groups.pop("time")[:, 0]
    if "enable" in groups and groups["enable"].shape[1] != joints:
        groups["enable"] = np.repeat(groups["enable"], joints, axis=1)
    return Log(name=str(path), time=time, lines=lines, notes=tuple(notes), **groups)


def _choose(rows: CsvRows, columns, joints, path) -> tuple[dict[str, list[int]], list[str]]:
    """Group -> places of its columns, and notes on columns that are not used."""
    where = f"{path}, line {rows.names_line}"
    there = f"one of the columns {', '.join(rows.names)}"
    known = ["time", "enable", *(c for group in GROUPS for c in channels(group, joints))]
    for channel, column in columns.items():
        if channel not in known:
            raise RecordingError(f"unknown channel '{channel}'", where="columns", expected=f"one of {', '.join(known)}")
        if column not in rows.names:
            raise RecordingError(f"no column '{column}' (asked for as {channel})", where=where, expected=there)
    taken = {channel: columns.get(channel, channel) for channel in known if columns.get(channel, channel) in rows.names}
    # a column that the map gives to another channel is not also the one of its own name
    for channel, column in list(taken.items()):
        if channel not in columns and column in columns.values():
            del taken[channel]
    used: dict[str, str] = {}
    for channel, column in taken.items():
        if rows.names.count(column) > 1:
            raise RecordingError(f"column '{column}' stands twice", where=where, expected="each column once")
        both_enable = used.get(column, "").startswith("enable") and channel.startswith("enable")
        if column in used and not both_enable:
            raise RecordingError(
                f"column '{column}' is both {used[column]} and {channel}",
                where="columns",
                expected="a column of its own for each",
            )
        used[column] = channel
    for channel in ("time", *(c for group in _REQUIRED for c in channels(group, joints))):
        if channel not in taken:
            raise RecordingError(
                f"channel '{channel}' is missing",
                where=where,
                expected=f"a column of that name or one given as {channel}=COLUMN; there are {', '.join(rows.names)}",
            )
    return _grouped(rows, taken, columns, joints, where)


def _grouped(rows, taken, columns, joints, where) -> tuple[dict[str, list[int]], list[str]]:
    notes, chosen = [], {"time": [rows.names.index(taken["time"])]}
    for group in GROUPS:
        names = [c for c in channels(group, joints) if c in taken]
        if len(names) == joints:
            chosen[group] = [rows.names.index(taken[c]) for c in names]
        elif group == "enable" and "enable" in taken:
            chosen[group] = [rows.names.index(taken["enable"])]
        elif names:
            notes.append(f"Only {', '.join(names)} of {joints} joints: not used.")
    used = {place for group in chosen.values() for place in group}
    if not columns:
        for group in _REQUIRED:
            if f"{group}{joints + 1}" in rows.names:
                raise RecordingError(
                    f"column '{group}{joints + 1}'",
                    where=where,
                    expected=f"a log of {joints} {'joint' if joints == 1 else 'joints'}, as the plant has",
                )
    others = [name for place, name in enumerate(rows.names) if place not in used]
    if others:
        notes.append(f"Columns that are not used: {', '.join(others)}.")
    return chosen, notes
