# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Changes of logs that change no physics, so that the answer must stay: names, verdict, sizes within their intervals.

Each is a function of a `Given` that returns the changed one, or None where it does not apply. Where it changes what the
numbers of an effect mean, `back` maps the parameters of an answer to those of the unchanged machine.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rigs.logs import Table

#: pause between logs that are concatenated [s]
PAUSE = 1.0
SHIFT = 1000.0
#: rate [Hz] from which on every second row can be dropped
FAST = 400.0
#: noise that is added, as a share of the floor
NOISE = 0.1
_THOUSAND = 1000.0
#: how many threads the libraries of linear algebra may use
BLAS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_SIGNED = ("voltage", "position", "velocity", "current", "setpoint")

Parameters = dict[str, tuple[float, ...]]


@dataclass(frozen=True)
class Given:
    """What is explained: tables of fitted and held-out logs, further ones of the same machine, the map of channels to
    columns, the mapping of the mechanism file (None for the default arm), the floor (J,) of the voltage [V] that the
    unchanged logs have, and the seed of noise."""

    logs: tuple[Table, ...]
    held_out: tuple[Table, ...] = ()
    spare: tuple[Table, ...] = ()
    columns: Mapping[str, str] | None = None
    mechanism: Mapping[str, Any] | None = None
    floor: tuple[float, ...] | None = None
    seed: int = 0

    def column(self, channel: str) -> str:
        """The column of a channel."""
        return (self.columns or {}).get(channel, channel)

    def present(self, table: Table, *groups: str) -> list[str]:
        """The columns of a table that belong to channels of groups."""
        channels = [channel for channel in (self.columns or table.names) if channel.rstrip("0123456789") in groups]
        return [self.column(channel) for channel in channels if self.column(channel) in table.names]

    def each(self, change: Callable[[Table], Table]) -> Given:
        """With each log changed."""
        return replace(self, **{key: tuple(map(change, getattr(self, key))) for key in ("logs", "held_out", "spare")})

    def scaled(self, factor: float, *groups: str) -> Given:
        """With the channels of groups multiplied."""

        def change(table: Table) -> Table:
            return table.with_columns(**{name: factor * table.column(name) for name in self.present(table, *groups)})

        return self.each(change)


def held_out_added(given: Given) -> Given | None:
    """A log more in the validation set, which no choice may depend on."""
    if not given.spare:
        return None
    return replace(given, held_out=(*given.held_out, given.spare[0]), spare=given.spare[1:])


def held_out_removed(given: Given) -> Given | None:
    """One held-out log less."""
    return replace(given, held_out=given.held_out[:-1]) if given.held_out else None


def logs_reversed(given: Given) -> Given | None:
    """The logs in the opposite order."""
    return replace(given, logs=given.logs[::-1]) if len(given.logs) > 1 else None


def logs_concatenated(given: Given) -> Given | None:
    """All fitted logs as one, with a pause of `PAUSE` between them."""
    if len(given.logs) < 2:
        return None
    time, first = given.column("time"), given.logs[0]
    parts, end = [first.values], first.column(time)[-1]
    for table in given.logs[1:]:
        if table.names != first.names:
            return None
        t = table.column(time)
        moved = table.with_columns(**{time: t - t[0] + end + PAUSE})
        parts.append(moved.values)
        end = moved.column(time)[-1]
    return replace(given, logs=(replace(first, values=np.concatenate(parts)),))


def time_shifted(given: Given) -> Given:
    """All times later by `SHIFT` seconds."""
    time = given.column("time")
    return given.each(lambda table: table.with_columns(**{time: table.column(time) + SHIFT}))


def mirrored(given: Given) -> Given | None:
    """Position and voltage with the opposite sign; machines of one joint only, the arm has no such symmetry."""
    if not _one_joint(given):
        return None
    mechanism = copy.deepcopy(dict(given.mechanism))
    low, high = mechanism["range"]["value"]
    mechanism["range"]["value"] = [-high, -low]
    return replace(given.scaled(-1.0, *_SIGNED), mechanism=mechanism)


def command_in_thousandths(given: Given) -> Given | None:
    """The input in thousandths of its unit (millivolts), with the numbers of the drive in the same unit."""
    if not _one_joint(given):
        return None
    mechanism = copy.deepcopy(dict(given.mechanism))
    drive = mechanism["drive"]
    if drive["amplifier"] == "current":
        _multiply(drive, 1.0 / _THOUSAND, "gain")
    else:
        # power stays in watts: the current is in thousands of amperes
        _multiply(drive, _THOUSAND, "torque_constant", "back_emf")
        _multiply(drive, _THOUSAND**2, "resistance", "inductance")
    return replace(given.scaled(_THOUSAND, "voltage"), mechanism=mechanism)


def position_in_millimetres(given: Given) -> Given | None:
    """A slide with a current drive whose positions are in millimetres."""
    if (
        not _one_joint(given)
        or given.mechanism["kind"] != "slide"
        or given.mechanism["drive"]["amplifier"] != "current"
    ):
        return None
    mechanism = copy.deepcopy(dict(given.mechanism))
    mechanism["range"]["value"] = [_THOUSAND * end for end in mechanism["range"]["value"]]
    _multiply(mechanism["body"], 1.0 / _THOUSAND, "mass")
    _multiply(mechanism["drive"], 1.0 / _THOUSAND, "viscous_friction", "motor_inertia")
    return replace(given.scaled(_THOUSAND, "position", "velocity", "setpoint"), mechanism=mechanism)


def column_added(given: Given) -> Given:
    """A column that no channel is read from."""
    return given.each(lambda table: table.with_columns(temperature_C=np.linspace(20.0, 30.0, len(table))))


def every_second_row(given: Given) -> Given | None:
    """Every second row dropped, where all logs have `FAST` rows a second or more."""
    time = given.column("time")
    steps = [np.median(np.diff(table.column(time))) for table in given.logs]
    if max(steps) > 1.0 / FAST:
        return None
    return given.each(lambda table: table.rows(slice(None, None, 2)))


def noise_added(given: Given) -> Given | None:
    """White noise of a tenth of the floor on the voltages of the fitted logs."""
    if given.floor is None:
        return None
    random = np.random.default_rng(given.seed)

    def noisy(table: Table) -> Table:
        names = given.present(table, "voltage")
        levels = np.resize(given.floor, len(names))
        return table.with_columns(
            **{
                name: table.column(name) + NOISE * level * random.standard_normal(len(table))
                for name, level in zip(names, levels)
            }
        )

    return replace(given, logs=tuple(map(noisy, given.logs)))


def blas_threads(given: Given) -> Given:
    """The same logs, in a process whose linear algebra may use two threads: sums then have another order."""
    return given


def _one_joint(given: Given) -> bool:
    return given.mechanism is not None and given.mechanism.get("kind") in ("pendulum", "slide")


def _multiply(group: dict[str, Any], factor: float, *names: str) -> None:
    """Numbers of a mechanism file, and the widths of their priors, in another unit."""
    for name in names:
        if name in group:
            group[name]["value"] *= factor
            if "deviation" in group[name]:
                group[name]["deviation"] *= factor


# ------------------------------------------------------------------------------------ what the sizes mean afterwards


def _same(effect: str, parameters: Parameters, units: Mapping[str, str]) -> Parameters:
    return parameters


def _without_times(effect: str, parameters: Parameters, units: Mapping[str, str]) -> Parameters:
    """Instants count from another origin."""
    return {name: values for name, values in parameters.items() if name != "time" or effect == "input_delay"}


#: parameters that change their sign with the joint's, and those that cannot be compared
_TURNED = ("voltage_offset.voltage", "encoder_offset.angle", "joint_spring.angle", "impulse.torque", "base_tilt.x")
_EXCHANGED = {"asymmetric_coulomb_friction": ("positive", "negative"), "soft_stop": ("lower", "upper")}
_NOT_COMPARED = ("phase", "transmission_error.order", "position_dependent_friction.angle")


def _turned(effect: str, parameters: Parameters, units: Mapping[str, str]) -> Parameters:
    one, other = _EXCHANGED.get(effect, ("", ""))
    found = {}
    for name, values in parameters.items():
        if name in _NOT_COMPARED or f"{effect}.{name}" in _NOT_COMPARED:
            continue
        turned = f"{effect}.{name}" in _TURNED or (effect == "soft_stop" and name in (one, other))
        found[{one: other, other: one}.get(name, name)] = tuple(-v for v in values) if turned else values
    return found


#: powers of the input's unit, and of metre, in units where watts and newtons stay
_INPUT = {"V": 1, "A": -1, "ohm": 2, "H": 2}
_LENGTH = {"m": 1, "kg": -1}


def _in_units(powers: Mapping[str, int]) -> Callable[[str, Parameters, Mapping[str, str]], Parameters]:
    def back(effect: str, parameters: Parameters, units: Mapping[str, str]) -> Parameters:
        found = {}
        for name, values in parameters.items():
            factor = _THOUSAND ** -unit_power(units.get(name, "1"), powers)
            found[name] = tuple(factor * value for value in values)
        return found

    return back


def unit_power(unit: str, powers: Mapping[str, int]) -> int:
    """Power of a base unit in a unit such as N.s2/m2."""
    total, over = 0, 1
    for piece, separator in re.findall(r"([^./]+)([./]?)", unit):
        name, power = re.fullmatch(r"([A-Za-z]*?)\^?(\d*)", piece).groups()
        total += over * powers.get(name, 0) * int(power or 1)
        over = -1 if separator == "/" else over
    return total


Back = Callable[[str, Parameters, Mapping[str, str]], Parameters]


@dataclass(frozen=True)
class Variant:
    """A change, what the sizes of its answer are in the unchanged machine's, and what its process has in its
    environment."""

    change: Callable[[Given], Given | None]
    back: Back = _same
    environment: Mapping[str, str] = field(default_factory=dict)


VARIANTS: dict[str, Variant] = {
    found.change.__name__: found
    for found in (
        Variant(held_out_added),
        Variant(held_out_removed),
        Variant(logs_reversed),
        Variant(logs_concatenated, _without_times),
        Variant(time_shifted, _without_times),
        Variant(mirrored, _turned),
        Variant(command_in_thousandths, _in_units(_INPUT)),
        Variant(position_in_millimetres, _in_units(_LENGTH)),
        Variant(column_added),
        Variant(every_second_row),
        Variant(noise_added),
        Variant(blas_threads, environment=dict.fromkeys(BLAS, "2")),
    )
}
