# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the name of a column says: the unit behind it, and the channel that it may hold."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import pi
from typing import TYPE_CHECKING

from puma_sim_core.errors import RecordingError

if TYPE_CHECKING:
    from puma_sim_core.recording.csv_rows import CsvRows

#: group of channels -> unit -> factor to the unit of the format
_UNITS = {
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "voltage": {"v": 1.0, "volts": 1.0, "mv": 1e-3, "nm": 1.0},
    "position": {"rad": 1.0, "deg": pi / 180.0, "mrad": 1e-3, "m": 1.0, "mm": 1e-3, "turns": 2.0 * pi, "rev": 2.0 * pi},
}
_UNITS["setpoint"] = _UNITS["link_position"] = _UNITS["position"]
#: a unit behind a name: position_deg, position [deg], position (deg)
_BEHIND = re.compile(r"(?P<name>.+?)(?:_|\s*[\[(])(?P<unit>[A-Za-z.]+)[\])]?")
#: words that a column of a group is called, the most telling first
_WORDS = {
    "time": ("time", "t", "stamp", "timestamp", "seconds", "clock"),
    "voltage": (
        "voltage",
        "volts",
        "volt",
        "motor",
        "u",
        "vir",
        "v",
        "tau_meas",
        "tau_cmd",
        "tau",
        "torque",
        "tau_motor",
        "motor_torque",
        "command",
    ),
    "position": ("position", "pos", "q", "q_meas", "theta", "angle", "x", "motor_position", "q_motor"),
    "link_position": ("link_position", "q_link", "link_angle", "load_position", "q_load"),
    "setpoint": ("setpoint", "goal", "target", "goal_position", "reference", "ref", "q_ref", "q_des", "desired"),
}


def unit_of(name: str, group: str) -> tuple[str, float]:
    """(unit behind a column's name, factor to the unit of the format) of a group; ("", 1.0) without one."""
    _, unit = _split(name, group)
    return unit, _UNITS[group][unit.lower()] if unit else 1.0


def own_column(channel: str, names: Sequence[str]) -> str | None:
    """The column of a channel's own name, or the only one of that name with a unit behind it; None without one."""
    if channel in names:
        return channel
    group = channel.rstrip("0123456789")
    found = [name for name in names if _split(name, group)[0] == channel]
    return found[0] if len(found) == 1 else None


def units_of(group: str) -> Mapping[str, float]:
    """Unit -> factor to the unit of the format, of those that a group may have; none where nothing is converted."""
    return _UNITS.get(group, {})


def unit_in(rows: CsvRows, place: int, group: str) -> tuple[str, float]:
    """(unit of a file's column, factor to the unit of the format), by its name or by the line of units.

    Raises RecordingError: a unit that the group does not know.
    """
    name, unit = rows.names[place], rows.units[place]
    found = unit_of(f"{name} [{unit}]" if unit else name, group)
    if unit and not found[0] and (known := units_of(group)):
        where = f"{rows.path}, line {rows.units_line}, column {name}"
        expected = f"a number, or a unit among {', '.join(known)}; a line that is neither begins with #"
        raise RecordingError(f"'{unit}'", where=where, expected=expected)
    return found


def _split(name: str, group: str) -> tuple[str, str]:
    """(name of a column without its unit, the unit), which is "" for one that the group does not know."""
    found = _BEHIND.fullmatch(name.strip())
    unit = found["unit"].replace(".", "") if found else ""
    return (found["name"], unit) if found and unit.lower() in _UNITS.get(group, {}) else (name.strip(), "")


def suggested(names: Sequence[str], inputs: Sequence[str], links: Sequence[str] = ()) -> dict[str, str]:
    """Channel -> column, for the time, the inputs and the positions, by the names of columns; {} where one is not
    found. inputs : (J,) as for `read_log`; links : channels of link positions."""
    joints = [str(j) for j in range(1, len(inputs) + 1)]
    given = [(group, number) for number, group in zip(joints, inputs) if group]
    wanted = [("time", ""), *given, *(("position", number) for number in joints)]
    wanted += [("link_position", channel.removeprefix("link_position")) for channel in links]
    found = {f"{group}{number}": _best(names, group, number, len(inputs)) for group, number in wanted}
    complete = all(found.values()) and len(set(found.values())) == len(found)
    return {channel: column for channel, column in found.items() if column} if complete else {}


def _best(names: Sequence[str], group: str, number: str, joints: int) -> str | None:
    numbers = {number, ""} if joints == 1 or not number else {number}
    ranked = []
    for place, name in enumerate(names):
        bare = _split(name, group)[0].lower()
        letters, digits = re.sub(r"\d", "", bare), re.sub(r"\D", "", bare)
        if letters in _WORDS[group] and digits in numbers:
            ranked.append((_WORDS[group].index(letters), place, name))
    return min(ranked)[2] if ranked else None
