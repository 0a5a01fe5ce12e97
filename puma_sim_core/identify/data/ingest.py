# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Reading of logs: anyone's CSV or a bag of `sim_node` as a `Log`.

Channels: ``time`` [s], ``voltage1..J`` [V], ``position1..J`` [rad or m], and, where there are any, ``velocity1..J``,
``current1..J``, ``setpoint1..J``, ``enable`` or ``enable1..J`` (0: the drive is off and no current flows), and
``link_position`` of those joints that have a second sensor, on the link's side. The voltage of a row is the commanded
one and holds until the next row; the position of a row is the one at its time. A unit behind the name of a time,
voltage or position is converted (t_ms, q1_deg). Gaps and NaN are taken over: `gate` judges them. Rows count from 1, the
first row of numbers.
"""

import os
from collections.abc import Mapping, Sequence
from itertools import accumulate
from pathlib import Path

import numpy as np

from puma_sim_core.errors import RecordingError
from puma_sim_core.identify.arrays import Floats, Ints
from puma_sim_core.identify.data.bag_log import read_bag_log
from puma_sim_core.identify.data.log import Log, channels
from puma_sim_core.identify.settings import DATA
from puma_sim_core.recording.column_names import own_column, suggested, unit_in
from puma_sim_core.recording.csv_rows import CsvRows

#: groups of channels, in the order of a file; the first two must be there
GROUPS = ("voltage", "position", "velocity", "current", "setpoint", "link_position", "enable")
_REQUIRED = ("voltage", "position")


def read_log(
    path: str | os.PathLike[str],
    columns: Mapping[str, str] | None = None,
    joints: int = 3,
    *,
    inputs: Sequence[str] | None = None,
    link_sensors: Sequence[bool] = (),
    greatest_rows: int = DATA.reading_greatest_rows,
) -> Log:
    """Read a CSV file or a bag (its directory or its .mcap file).

    Parameters
    ----------
    columns : channel -> column of the file, for names that are not those of the channels.
    joints : J, of the mechanism that the log is of.
    inputs : (J,) the channel of each joint's input, "voltage" or "setpoint", or "" of a joint without a drive; None:
        all are voltages. Channels of other joints are 0.
    link_sensors : (J,) joints whose link position must be there; () none. Of other joints it is read if it is there.
    greatest_rows : of a longer CSV file the first so many are read, and a note says so.

    Raises
    ------
    RecordingError : a file that cannot be read, is empty or no text; a map to a column that is not there, a channel
        that is missing or stands twice, a text in a number, a row that is cut off; names file, line and column.
    BagError : a directory or .mcap file that is no whole bag of the simulator.
    """
    if Path(path).is_dir() or Path(path).suffix == ".mcap":
        if columns:
            raise RecordingError("a map of columns", where=str(path), expected="none for a bag")
        return read_bag_log(os.fspath(path), joints)
    rows = CsvRows(path, measured=True)
    inputs = ("voltage",) * joints if inputs is None else tuple(inputs)
    needed = [f"link_position{j}" for j, there in enumerate(link_sensors, 1) if there]
    taken = _taken(rows, columns or {}, inputs, needed)
    places, notes = _places(rows, taken, inputs, guessed=not columns)
    table, lines, more = _table(rows, [place for group in places.values() for place in group], greatest_rows)
    units = {group: [unit_in(rows, place, group) for place in own] for group, own in places.items()}
    factors = [factor for own in units.values() for _, factor in own]
    notes += _converted(units)
    notes += [f"Lines before the names of the columns were skipped ({rows.title})."] if rows.title else []
    table = table * factors
    starts = accumulate(map(len, places.values()), initial=0)
    groups = {group: table[:, a : a + len(own)].copy() for a, (group, own) in zip(starts, places.items())}
    time = groups.pop("time")[:, 0]
    for group in ("voltage", "setpoint"):
        own = groups.get(group, np.zeros((len(time), 0)))
        if own.shape[1] < joints and (group == "voltage" or group in groups):
            groups[group] = np.zeros((len(time), joints))
            groups[group][:, [given == group for given in inputs]] = own
    if "link_position" in groups:
        own, sensed = groups["link_position"], [c in taken for c in channels("link_position", joints)]
        groups["link_position"] = np.full((len(time), joints), np.nan)
        groups["link_position"][:, sensed] = own
    if "enable" in groups and groups["enable"].shape[1] != joints:
        groups["enable"] = np.repeat(groups["enable"], joints, axis=1)
    return Log(name=str(path), time=time, lines=lines, notes=(*notes, *more), **groups)


def _table(rows: CsvRows, places: list[int], greatest_rows: int) -> tuple[Floats, Ints, list[str]]:
    """Numbers of some columns, the line of each row, and notes on rows that were left out."""
    values, numbers, count, notes = [], [], 0, []
    for block in rows.blocks(places):
        values.append(block.values[: greatest_rows - count])
        numbers.append(block.lines[: greatest_rows - count])
        count += len(block.values)
        if count > greatest_rows:
            note = f"The file has more than {greatest_rows} rows; the first {greatest_rows} were read."
            notes.append(f"{note} Cut the file to look at another stretch.")
            break
    if count == 0:
        raise RecordingError("has no rows", where=str(rows.path), expected="rows of numbers")
    table, lines = np.concatenate(values), np.concatenate(numbers)
    if rows.cut and len(table) > 1:
        notes.append(f"The last row (line {lines[-1]}) has no line end: it may be cut off and is left out.")
        table, lines = table[:-1], lines[:-1]
    return table, lines, notes


def _converted(units: Mapping[str, Sequence[tuple[str, float]]]) -> list[str]:
    """A note on each group that is in another unit than the format's."""
    notes = []
    for group, own in units.items():
        words = " and ".join(sorted({f"{unit} (times {factor:.6g})" for unit, factor in own if factor != 1.0}))
        notes += [f"By the header of the file, {group} is in {words}: converted."] if words else []
    return notes


def _where(rows: CsvRows) -> str:
    return f"{rows.path}, line {rows.names_line}"


def _taken(
    rows: CsvRows, columns: Mapping[str, str], inputs: Sequence[str], links: Sequence[str] = ()
) -> dict[str, str]:
    """Channel -> column, of those that a file has; links : channels of link positions that must be there."""
    where, there, joints = _where(rows), ", ".join(rows.names), len(inputs)
    known = ["time", "enable", *(c for group in GROUPS for c in channels(group, joints))]
    for channel, column in columns.items():
        if channel not in known:
            groups = ", ".join(f"{group}1" for group in GROUPS if group != "enable")
            expected = f"time, enable, {groups}{', voltage2 and so on' if joints > 1 else ''}"
            raise RecordingError(f"unknown channel '{channel}'", where="columns", expected=expected)
        if column not in rows.names:
            what = f"no column '{column}' (asked for as {channel})"
            raise RecordingError(what, where=where, expected=f"one of the columns {there}")
    # a column that the map gives to another channel is not also the one of its own name
    own = {c: name for c in known if (name := own_column(c, rows.names)) and name not in columns.values()}
    taken = {channel: {**own, **columns}[channel] for channel in known if channel in own or channel in columns}
    used: dict[str, str] = {}
    for channel, column in taken.items():
        if rows.names.count(column) > 1:
            raise RecordingError(f"column '{column}' stands twice", where=where, expected="each column once")
        both_enable = used.get(column, "").startswith("enable") and channel.startswith("enable")
        if column in used and not both_enable:
            what = f"column '{column}' is both {used[column]} and {channel}"
            raise RecordingError(what, where="columns", expected="a column of its own for each")
        used[column] = channel
    required = [c for group in _REQUIRED for c in _needed(group, inputs)]
    required += [*(_needed("setpoint", inputs) if "setpoint" in inputs else ()), *links]
    for channel in ("time", *required):
        if channel not in taken:
            expected = f"a column of that name or one given as {channel}=COLUMN; there are {there}"
            expected += f". The plant has {joints} joints; --plant names another" if joints > 1 else ""
            named = ",".join(f"{ours}={theirs}" for ours, theirs in suggested(rows.names, inputs, links).items())
            if own_column(channel, rows.units):
                expected += f". Line {rows.units_line} has it: leave one line of names"
            elif named and not columns:
                expected += f". By their names: --columns {named}"
            if len(rows.names) == 1:
                expected += ". Fields stand between commas, semicolons or tabs"
            raise RecordingError(f"channel '{channel}' is missing", where=where, expected=expected)
    return taken


def _needed(group: str, inputs: Sequence[str]) -> list[str]:
    """The channels of a group that say something: a joint without a drive has no voltage."""
    own = [given == group for given in inputs]
    if group not in ("voltage", "setpoint") or (group == "setpoint" and not any(own)):
        return channels(group, len(inputs))
    return [channel for channel, needed in zip(channels(group, len(inputs)), own) if needed]


def _places(
    rows: CsvRows, taken: Mapping[str, str], inputs: Sequence[str], guessed: bool
) -> tuple[dict[str, list[int]], list[str]]:
    """Group -> places of its columns, and notes on columns that are not used. guessed : no map names the columns."""
    notes, places, joints = [], {"time": [rows.names.index(taken["time"])]}, len(inputs)
    for group in GROUPS:
        needed = _needed(group, inputs)
        found = [c for c in needed if c in taken]
        if found and (len(found) == len(needed) or group == "link_position"):
            places[group] = [rows.names.index(taken[c]) for c in found]
        elif group == "enable" and "enable" in taken:
            places[group] = [rows.names.index(taken["enable"])]
        elif found:
            notes.append(f"Only {', '.join(found)} of {joints} joints: not used.")
    for group in _REQUIRED if guessed else ():
        if f"{group}{joints + 1}" in rows.names:
            expected = f"a log of {joints} {'joint' if joints == 1 else 'joints'}, as the plant has"
            raise RecordingError(f"column '{group}{joints + 1}'", where=_where(rows), expected=expected)
    used = {place for group in places.values() for place in group}
    others = [name for place, name in enumerate(rows.names) if place not in used]
    if others:
        notes.append(f"Columns that are not used: {', '.join(others)}.")
    return places, notes
