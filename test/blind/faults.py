# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Faults of the data, put into a good log, with the channel and the row that show them.

Rows are counted from 1, the first line of data. A fault has `row` None where it is all over the
channel. Of swapped channels either may be named.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Log = dict[str, np.ndarray]
Found = list[dict]


def _fault(channel: str | None, row: int | None, what: str) -> Found:
    return [{"channel": channel, "row": row, "what": what}]


def _middle(rng, n: int) -> int:
    """An index well inside a log of n rows."""
    return int(rng.integers(n // 4, 3 * n // 4))


def _moving(rng, x: np.ndarray) -> int:
    """An index in the middle half at which x moves faster than most of the time."""
    n = len(x)
    width = max(3, n // 100)
    travel = np.abs(x[width:] - x[:-width])
    inside = np.arange(n // 4, min(3 * n // 4, len(travel)))
    fast = inside[travel[inside] >= np.quantile(travel[inside], 0.8)]
    return int(rng.choice(fast))


def _joint(rng) -> str:
    return str(int(rng.integers(1, 4)))


def _gap(log, rng):
    n = len(log["time"])
    at, missing = _middle(rng, n), max(3, int(n * rng.uniform(0.04, 0.12)))
    kept = np.r_[0:at, at + missing : n]
    return {name: x[kept] for name, x in log.items()}, _fault("time", at + 1, "gap")


def _dropped(log, rng):
    """Rows lost without a trace in the time stamps, which go on evenly."""
    n = len(log["time"])
    at = _moving(rng, log["position1"])
    missing = max(4, n // 40)
    kept = np.r_[0:at, at + missing : n]
    out = {name: x[kept] for name, x in log.items()}
    out["time"] = log["time"][: len(kept)]
    return out, _fault("position1", at + 1, "dropped samples")


def _repeated(log, rng):
    at = _middle(rng, len(log["time"]))
    out = {name: np.insert(x, at, x[at - 1]) for name, x in log.items()}
    return out, _fault("time", at + 1, "repeated time stamp")


def _reversed(log, rng):
    at = _middle(rng, len(log["time"]))
    out = {name: x.copy() for name, x in log.items()}
    for x in out.values():
        x[[at - 1, at]] = x[[at, at - 1]]
    return out, _fault("time", at + 1, "reversed time stamp")


def _jitter(log, rng):
    step = log["time"][1]
    out = dict(log)
    out["time"] = np.round(log["time"] + step * rng.uniform(0.0, 0.9, len(log["time"])), 7)
    return out, _fault("time", None, "jitter of the time stamps")


def _milliseconds(log, rng):
    return dict(log, time=log["time"] * 1000.0), _fault("time", None, "milliseconds for seconds")


def _nan(log, rng):
    channel = str(rng.choice(["voltage", "position"])) + _joint(rng)
    at = _middle(rng, len(log["time"]))
    x = log[channel].copy()
    x[at : at + int(rng.integers(1, 6))] = np.nan
    return dict(log, **{channel: x}), _fault(channel, at + 1, "not a number")


def _frozen(log, rng):
    channel = "position" + _joint(rng)
    x = log[channel].copy()
    at = _moving(rng, x)
    end = len(x) if rng.random() < 0.5 else at + len(x) // 6
    x[at:end] = x[at - 1]
    return dict(log, **{channel: x}), _fault(channel, at + 1, "frozen")


def _frozen_voltage(log, rng):
    channel = "voltage" + _joint(rng)
    x = log[channel].copy()
    at = _moving(rng, x)
    x[at : at + len(x) // 3] = x[at - 1]
    return dict(log, **{channel: x}), _fault(channel, at + 1, "frozen")


def _swapped(kind: str) -> Callable:
    def spoil(log, rng):
        a, b = (f"{kind}{j + 1}" for j in sorted(rng.choice(3, 2, replace=False)))
        return (
            dict(log, **{a: log[b], b: log[a]}),
            _fault(a, None, f"swapped with {b}") + _fault(b, None, f"swapped with {a}"),
        )

    return spoil


def _all(kind: str, what: str, change: Callable) -> Callable:
    def spoil(log, rng):
        channel = kind + _joint(rng)
        return (dict(log, **{channel: change(log[channel], rng)}), _fault(channel, None, what))

    return spoil


def _joint_offset(log, rng):
    """A joint that gravity turns, set to a wrong zero."""
    channel = "position" + str(int(rng.integers(2, 4)))
    shift = rng.choice([-1.0, 1.0]) * np.round(rng.uniform(0.5, 1.5), 3)
    return dict(log, **{channel: log[channel] + shift}), _fault(channel, None, "joint offset")


def _spike(log, rng):
    channel = "position" + _joint(rng)
    x = log[channel].copy()
    at = _middle(rng, len(x))
    x[at] += rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 1.0)
    return dict(log, **{channel: x}), _fault(channel, at + 1, "bad sample")


def _jump(log, rng):
    """The encoder loses or gains counts at one row."""
    channel = "position" + _joint(rng)
    x = log[channel].copy()
    at = _middle(rng, len(x))
    x[at:] += rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.4)
    return dict(log, **{channel: x}), _fault(channel, at + 1, "jump")


def _short(log, rng):
    n = int(rng.integers(4, 12))
    return {name: x[:n] for name, x in log.items()}, _fault(None, None, "too short")


def _rest(log, rng):
    out = dict(log)
    for j in "123":
        x = log["position" + j]
        out["position" + j] = np.full_like(x, x[0])
        volts = log["voltage" + j]
        out["voltage" + j] = np.full_like(volts, volts[0])
        if "setpoint" + j in log:
            out["setpoint" + j] = np.full_like(x, x[0])
    return out, _fault(None, None, "at rest")


def _other_plant(log, rng):
    """Voltages of a direct drive that has nothing to do with this arm."""
    out = dict(log)
    step = log["time"][1]
    for j in "123":
        acceleration = np.gradient(np.gradient(log["position" + j], step), step)
        smooth = np.convolve(acceleration, np.ones(9) / 9, "same")
        out["voltage" + j] = 0.4 * smooth + 2.0 * np.sin(log["position" + j])
    return out, _fault(None, None, "another plant")


_SPOIL: dict[str, Callable] = {
    "gap": _gap,
    "dropped_samples": _dropped,
    "repeated_time": _repeated,
    "reversed_time": _reversed,
    "jitter": _jitter,
    "milliseconds": _milliseconds,
    "nan": _nan,
    "frozen_position": _frozen,
    "frozen_voltage": _frozen_voltage,
    "swapped_positions": _swapped("position"),
    "swapped_voltages": _swapped("voltage"),
    "flipped_position": _all("position", "sign flipped", lambda x, rng: -x),
    "flipped_voltage": _all("voltage", "sign flipped", lambda x, rng: -x),
    "degrees": _all("position", "degrees for radians", lambda x, rng: np.rad2deg(x)),
    "millivolts": _all("voltage", "millivolts for volts", lambda x, rng: 1000.0 * x),
    "wrong_gear_ratio": _all("position", "wrong gear ratio", lambda x, rng: x * rng.choice([0.5, 0.7, 1.4, 2.0])),
    "joint_offset": _joint_offset,
    "bad_sample": _spike,
    "jump": _jump,
    "too_short": _short,
    "at_rest": _rest,
    "another_plant": _other_plant,
    "text": None,
    "truncated": None,
}
FAULTS: tuple[str, ...] = tuple(_SPOIL)


def spoil(kind: str, log: Log, rng: np.random.Generator) -> tuple[Log, Found]:
    """The log with a fault of that kind, and what there is to be found. Faults of the text are
    left to `spoil_text`."""
    made = _SPOIL[kind]
    return made(dict(log), rng) if made else (log, [])


def spoil_text(kind: str, lines: list[str], rng: np.random.Generator) -> tuple[list[str], Found]:
    """Lines of the file, the header first, with a fault that no array can have."""
    if kind == "text":
        row = _middle(rng, len(lines))
        column = int(rng.integers(1, 7))
        cells = lines[row].split(",")
        cells[column] = str(rng.choice(["ERR", "--", "#VALUE!"]))
        return (
            [*lines[:row], ",".join(cells), *lines[row + 1 :]],
            _fault(lines[0].split(",")[column], row, "not a number"),
        )
    if kind == "truncated":
        row = _middle(rng, len(lines))
        cells = lines[row].split(",")[:4]
        return [*lines[:row], ",".join(cells)], _fault(lines[0].split(",")[4], row, "file ends inside a line")
    return lines, []
