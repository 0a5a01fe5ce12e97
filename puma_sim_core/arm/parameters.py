# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the arm is: the numbers of a rigid three-link PUMA 560 and its motors, with their units.

A parameter file is YAML. Each number stands as ``{value: ..., unit: ..., source: ...}``; the unit
is compulsory and is the one named in the tables below, so that a number in another unit is refused
and never misread. The published sets are the files of ``config/parameters``.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from puma_sim_core.arm.arm import ArmParameters, Link, Motor
from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.errors import ParameterError
from puma_sim_core.files import read_yaml, write_yaml
from puma_sim_core.resources import config_path

#: greatest distance between poses at which D + Ia is examined [deg]
_POSE_STEP = 5.0

_LINK_UNITS = {"mass": "kg", "centre": "m", "gyration_squared": "m^2", "products": "m^2"}
_MOTOR_UNITS = {
    "resistance": "ohm",
    "inductance": "H",
    "back_emf": "V.s/rad",
    "torque_constant": "N.m/A",
    "gear_ratio": "1",
    "inertia": "kg.m^2",
}
_GEOMETRY_UNITS = {"a2": "m", "a3": "m", "d3": "m", "d4": "m"}
_VECTORS = {"centre", "gyration_squared", "products"}
_POSITIVE = {"mass", "resistance", "inductance", "back_emf", "torque_constant", "gear_ratio"}
_NOT_NEGATIVE = {"gyration_squared", "inertia"}
_TOP_KEYS = ("name", "source", "geometry", "gravity", "links", "motors", "joint_ranges", "suggested_effects")


def parameter_sets() -> list[str]:
    """Names of the published sets, the default one first."""
    names = sorted(path.stem for path in config_path("parameters").glob("*.yaml"))
    return sorted(names, key=lambda name: name != "bejczy")


def load_parameters(name_or_path: str | os.PathLike) -> ArmParameters:
    """Read and check a published set by its name, or a file by its path.

    Raises
    ------
    ParameterError : no such set or file, or a file that is not usable; names the key.
    """
    path = Path(name_or_path)
    names = parameter_sets()
    if str(name_or_path) in names:
        path = config_path("parameters", f"{name_or_path}.yaml")
    elif not path.is_file():
        raise ParameterError(
            f"no parameter set or file '{name_or_path}'",
            expected=f"the path of a YAML file or one of {', '.join(names)}",
        )
    return from_mapping(read_yaml(path), where=str(path))


def dump_parameters(parameters: ArmParameters, path: str | os.PathLike) -> None:
    """Write a parameter file that loads to an equal value; the file appears complete or not at all.

    Raises
    ------
    ParameterError : the file cannot be written.
    """
    write_yaml(to_mapping(parameters), path)


def to_mapping(parameters: ArmParameters) -> dict:
    """Mapping of plain YAML types from which :func:`from_mapping` makes an equal value."""

    def quantity(key, value, unit):
        entry = {"value": _plain(value), "unit": unit}
        known = parameters.sources.get(key)
        if known is not None and known[0] == value and known[1]:
            entry["source"] = known[1]
        return entry

    def group(prefix, owner, units):
        return {key: quantity(f"{prefix}.{key}", getattr(owner, key), unit) for key, unit in units.items()}

    effects = []
    for index, effect in enumerate(parameters.suggested_effects, start=1):
        known = parameters.sources.get(f"suggested_effects[{index}]")
        note = known[1] if known is not None and known[0] == effect else None
        effects.append({"effect": effect, "source": note} if note else effect)
    mapping = {
        "name": parameters.name,
        "source": parameters.source,
        "geometry": group("geometry", parameters, _GEOMETRY_UNITS),
        "gravity": quantity("gravity", parameters.gravity, "m/s^2"),
        "links": {
            f"link{i}": group(f"links.link{i}", link, _LINK_UNITS) for i, link in enumerate(parameters.links, start=1)
        },
        "motors": {
            f"joint{i}": group(f"motors.joint{i}", motor, _MOTOR_UNITS)
            for i, motor in enumerate(parameters.motors, start=1)
        },
        "joint_ranges": {
            f"joint{i}": quantity(f"joint_ranges.joint{i}", pair, "rad")
            for i, pair in enumerate(parameters.joint_ranges, start=1)
        },
    }
    if effects:
        mapping["suggested_effects"] = effects
    return mapping


def from_mapping(mapping: Mapping, where: str | None = None) -> ArmParameters:
    """Value from the mapping of a parameter file, checked by :func:`check_parameters`.

    ``where`` (a path, a topic) begins the text of every error.

    Raises
    ------
    ParameterError : unknown or missing key, wrong unit, length, type or sign, D + Ia not positive
        definite; names the key and what was expected.
    """
    reader = _Reader(where)
    reader.keys(mapping, "", _TOP_KEYS, optional=("suggested_effects",))
    links = reader.group(mapping["links"], "links", "link")
    motors = reader.group(mapping["motors"], "motors", "joint")
    ranges = reader.group(mapping["joint_ranges"], "joint_ranges", "joint")
    parameters = ArmParameters(
        name=reader.text(mapping["name"], "name"),
        source=reader.text(mapping["source"], "source"),
        links=tuple(reader.record(Link, entry, key, _LINK_UNITS, {"products"}) for key, entry in links),
        motors=tuple(reader.record(Motor, entry, key, _MOTOR_UNITS) for key, entry in motors),
        **reader.quantities(mapping["geometry"], "geometry", _GEOMETRY_UNITS),
        gravity=reader.quantity(mapping["gravity"], "gravity", "m/s^2"),
        joint_ranges=tuple(reader.angles(entry, key) for key, entry in ranges),
        suggested_effects=reader.effects(mapping.get("suggested_effects", [])),
        sources=reader.sources,
    )
    check_parameters(parameters, where)
    return parameters


def check_parameters(parameters: ArmParameters, where: str | None = None) -> None:
    """Refuse values that no arm can have.

    Types, lengths and signs; then D + Ia, whose smallest eigenvalue must be above zero over the
    joint ranges (a grid of at most 5 degrees, refined about its lowest pose). D alone need not be
    positive definite: the thesis's links have no products of inertia and are not quite bodies.

    Raises
    ------
    ParameterError : names the key, or the pose [deg] and the eigenvalue [kg.m^2].
    """

    def at(key):
        return key if where is None else f"{where}: {key}"

    _check_group(parameters.links, _LINK_UNITS, at, "links.link")
    _check_group(parameters.motors, _MOTOR_UNITS, at, "motors.joint")
    for key in _GEOMETRY_UNITS:
        _check_number(getattr(parameters, key), at(f"geometry.{key}"), 0)
    _check_number(parameters.gravity, at("gravity"), 0)
    if parameters.gravity < 0:
        raise ParameterError(
            f"{parameters.gravity}", where=at("gravity"), expected="0 or more m/s^2: gravity points down the base axis"
        )
    if len(parameters.joint_ranges) != 3:
        raise ParameterError(f"{len(parameters.joint_ranges)} entries", where=at("joint_ranges"), expected="3 entries")
    for i, pair in enumerate(parameters.joint_ranges, start=1):
        _check_number(pair, at(f"joint_ranges.joint{i}"), 2)
        if not (pair[0] < pair[1] and pair[1] - pair[0] <= 4 * math.pi):
            raise ParameterError(
                f"from {pair[0]} to {pair[1]} rad",
                where=at(f"joint_ranges.joint{i}"),
                expected="the lower end first, at most two turns in all",
            )
    lowest, q2, q3 = smallest_eigenvalue(parameters)
    # not "<= 0": numbers so great that the inertia overflows give NaN
    if not lowest > 0:
        raise ParameterError(
            f"D + Ia is not positive definite: its smallest eigenvalue is {lowest:.4g} kg.m^2 "
            f"at q2 = {math.degrees(q2):.1f} deg, q3 = {math.degrees(q3):.1f} deg",
            where=where or f"parameters '{parameters.name}'",
            expected="eigenvalues above 0 over the joint ranges",
        )


def smallest_eigenvalue(parameters: ArmParameters) -> tuple[float, float, float]:
    """Smallest eigenvalue [kg.m^2] of D + Ia over the ranges of joints 2 and 3, with q2, q3 [rad].

    D does not depend on q1. The grid of 5 degrees is followed by three grids, each about the lowest
    pose of the one before.
    """
    added = np.diag(parameters.motor_inertia)
    low, high = (np.array(ends, dtype=float) for ends in zip(*parameters.joint_ranges[1:]))
    count = np.ceil((high - low) / math.radians(_POSE_STEP)).astype(int) + 1
    first, last = low, high
    for _ in range(4):
        second, third = np.meshgrid(
            np.linspace(first[0], last[0], count[0]), np.linspace(first[1], last[1], count[1]), indexing="ij"
        )
        poses = np.stack([np.zeros_like(second), second, third], axis=-1)
        with np.errstate(over="ignore", invalid="ignore"):
            matrices = inertia(poses, parameters) + added
        if not np.all(np.isfinite(matrices)):
            return math.nan, *map(float, poses[0, 0, 1:])
        values = np.linalg.eigvalsh(matrices)[..., 0]
        best = np.unravel_index(np.argmin(values), values.shape)
        spacing = (last - first) / (count - 1)
        centre = poses[best][1:]
        first = np.maximum(low, centre - spacing)
        last = np.minimum(high, centre + spacing)
        count = np.array([9, 9])
    return float(values[best]), float(centre[0]), float(centre[1])


def _plain(value):
    return [float(item) for item in value] if isinstance(value, tuple) else float(value)


def _check_group(group, units, at, name):
    """Three links or motors: types, lengths and signs of their numbers."""
    if len(group) != 3:
        raise ParameterError(f"{len(group)} entries", where=at(name), expected="3 entries")
    for i, owner in enumerate(group, start=1):
        for key, unit in units.items():
            value, where = getattr(owner, key), at(f"{name}{i}.{key}")
            _check_number(value, where, 3 if key in _VECTORS else 0)
            lowest = min(value) if key in _VECTORS else value
            if key in _POSITIVE and lowest <= 0:
                raise ParameterError(f"{lowest}", where=where, expected=f"a number above 0 {unit}")
            if key in _NOT_NEGATIVE and lowest < 0:
                raise ParameterError(f"{lowest}", where=where, expected=f"no number below 0 {unit}")


def _check_number(value, where: str, length: int) -> None:
    """A finite number (length 0), or a tuple of as many finite numbers."""
    expected = f"{length} finite numbers" if length else "a finite number"
    if length and (not isinstance(value, (tuple, list)) or len(value) != length):
        raise ParameterError(f"{value!r}", where=where, expected=expected)
    for item in value if length else (value,):
        if not _is_finite(item):
            raise ParameterError(f"{item!r}", where=where, expected=expected)


def _is_finite(item) -> bool:
    if isinstance(item, bool) or not isinstance(item, (int, float, np.floating)):
        return False
    try:
        return math.isfinite(item)
    except OverflowError:  # an integer of more than 308 digits
        return False


class _Reader:
    """Reads entries of a mapping, names their keys in errors, and gathers their sources."""

    def __init__(self, where):
        self.where, self.sources = where, {}

    def fail(self, key, what, expected):
        place = ": ".join(part for part in (self.where, key) if part)
        raise ParameterError(what, where=place or None, expected=expected)

    def keys(self, mapping, key, names, optional=()):
        if not isinstance(mapping, Mapping):
            self.fail(key, f"{mapping!r}"[:80], f"a mapping with the keys {', '.join(names)}")
        for name in mapping:
            if name not in names:
                self.fail(f"{key}.{name}" if key else str(name), "unknown key", f"one of {', '.join(names)}")
        for name in names:
            if name not in mapping and name not in optional:
                self.fail(f"{key}.{name}" if key else name, "missing", "this key" if not key else f"this key in {key}")

    def text(self, value, key):
        if not isinstance(value, str):
            self.fail(key, f"{value!r}", "text")
        return value

    def group(self, mapping, key, stem):
        names = tuple(f"{stem}{i}" for i in (1, 2, 3))
        self.keys(mapping, key, names)
        return [(f"{key}.{name}", mapping[name]) for name in names]

    def record(self, kind, mapping, key, units, optional=frozenset()):
        return kind(**self.quantities(mapping, key, units, optional))

    def quantities(self, mapping, key, units, optional=frozenset()):
        self.keys(mapping, key, tuple(units), optional)
        return {
            name: self.quantity(mapping[name], f"{key}.{name}", unit, 3 if name in _VECTORS else 0)
            for name, unit in units.items()
            if name in mapping
        }

    def quantity(self, entry, key, units, length=0):
        units = (units,) if isinstance(units, str) else units
        wanted = " or ".join(units)
        if not isinstance(entry, Mapping):
            self.fail(key, f"{entry!r} without a unit", f"{{value: ..., unit: {wanted}, source: ...}}")
        self.keys(entry, key, ("value", "unit", "source"), optional=("source",))
        unit = str(entry["unit"])
        if unit not in units:
            self.fail(f"{key}.unit", f"unit '{unit}'", wanted)
        value, place = entry["value"], f"{key}.value"
        _check_number(value, place if self.where is None else f"{self.where}: {place}", length)
        value = tuple(float(item) for item in value) if length else float(value)
        if unit == "deg":
            value = tuple(math.radians(item) for item in value)
        source = entry.get("source")
        if source is not None:
            self.sources[key] = (value, self.text(source, f"{key}.source"))
        return value

    def angles(self, entry, key):
        return self.quantity(entry, key, ("rad", "deg"), length=2)

    def effects(self, entries):
        if not isinstance(entries, (list, tuple)):
            self.fail("suggested_effects", f"{entries!r}"[:80], "a list of effects")
        names = []
        for index, entry in enumerate(entries, start=1):
            key = f"suggested_effects[{index}]"
            if isinstance(entry, Mapping):
                self.keys(entry, key, ("effect", "source"))
                effect = self.text(entry["effect"], f"{key}.effect")
                self.sources[key] = (effect, self.text(entry["source"], f"{key}.source"))
            else:
                effect = self.text(entry, key)
            if not re.fullmatch(r"\w+(:\w+=[^,=]+(,\w+=[^,=]+)*)?", effect):
                self.fail(key, f"'{effect}'", "NAME:parameter=value,...")
            names.append(effect)
        return tuple(names)
