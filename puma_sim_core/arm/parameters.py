# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the arm is: the numbers of a rigid three-link PUMA 560 and its motors, with their units.

A parameter file is YAML. Each number stands as ``{value: ..., unit: ..., source: ...}``; the unit
is compulsory and is the one named in the tables below, so that a number in another unit is refused
and never misread. The published sets are the files of ``config/parameters``.
"""

import math
import os
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from puma_sim_core.arm.arm import ArmParameters, Link, Motor
from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.checks import Reader
from puma_sim_core.errors import ParameterError, one_of
from puma_sim_core.files import read_yaml
from puma_sim_core.resources import config_path

#: greatest distance between poses at which D + Ia is examined [deg]
_POSE_STEP = 5.0
#: poses up to which eigenvalues are solved for to the last digit
_FEW_POSES = 81


class _Quantity(NamedTuple):
    """Unit, number of values (0: one, by itself), and which values may be: any, "not negative", "positive"."""

    unit: str
    length: int = 0
    sign: str = "any"


_LINK = {
    "mass": _Quantity("kg", sign="positive"),
    "centre": _Quantity("m", 3),
    "gyration_squared": _Quantity("m^2", 3, "not negative"),
    "products": _Quantity("m^2", 3),
}
_MOTOR = {
    "resistance": _Quantity("ohm", sign="positive"),
    "inductance": _Quantity("H", sign="positive"),
    "back_emf": _Quantity("V.s/rad", sign="positive"),
    "torque_constant": _Quantity("N.m/A", sign="positive"),
    "gear_ratio": _Quantity("1", sign="positive"),
    "inertia": _Quantity("kg.m^2", sign="not negative"),
}
_GEOMETRY = {name: _Quantity("m") for name in ("a2", "a3", "d3", "d4")}
_TOP_KEYS = ("name", "source", "geometry", "gravity", "links", "motors", "joint_ranges", "suggested_effects")


def parameter_sets() -> list[str]:
    """Names of the published sets, the default one first."""
    names = sorted(path.stem for path in config_path("parameters").glob("*.yaml"))
    return sorted(names, key=lambda name: name != "bejczy")


def load_parameters(name_or_path: str | os.PathLike[str]) -> ArmParameters:
    """Read and check a published set by its name, or a file by its path.

    Raises
    ------
    ParameterError : no such set or file, or a file that is not usable; names the key.
    """
    path, names = Path(name_or_path), parameter_sets()
    if str(name_or_path) in names:
        path = config_path("parameters", f"{name_or_path}.yaml")
    elif not path.is_file():
        expected = f"the path of a YAML file or {one_of(name_or_path, names)}"
        raise ParameterError(f"no parameter set or file '{name_or_path}'", expected=expected)
    return from_mapping(read_yaml(path), where=str(path))


def to_mapping(parameters: ArmParameters) -> dict[str, Any]:
    """Mapping of plain YAML types from which :func:`from_mapping` makes an equal value."""

    def source(key: str, value: object) -> str | None:
        known = parameters.sources.get(key)
        return known[1] if known is not None and known[0] == value and known[1] else None

    def entry(key: str, value: Any, unit: str) -> dict[str, Any]:
        plain = [float(item) for item in value] if isinstance(value, tuple) else float(value)
        text = source(key, value)
        return {"value": plain, "unit": unit, **({"source": text} if text else {})}

    def group(prefix: str, owner: object, quantities: Mapping[str, _Quantity]) -> dict[str, Any]:
        return {name: entry(f"{prefix}.{name}", getattr(owner, name), q.unit) for name, q in quantities.items()}

    effects = [
        {"effect": effect, "source": text} if (text := source(f"suggested_effects[{n}]", effect)) else effect
        for n, effect in enumerate(parameters.suggested_effects, start=1)
    ]
    return {
        "name": parameters.name,
        "source": parameters.source,
        "geometry": group("geometry", parameters, _GEOMETRY),
        "gravity": entry("gravity", parameters.gravity, "m/s^2"),
        "links": {f"link{n}": group(f"links.link{n}", link, _LINK) for n, link in enumerate(parameters.links, 1)},
        "motors": {f"joint{n}": group(f"motors.joint{n}", m, _MOTOR) for n, m in enumerate(parameters.motors, 1)},
        "joint_ranges": {
            f"joint{n}": entry(f"joint_ranges.joint{n}", pair, "rad")
            for n, pair in enumerate(parameters.joint_ranges, 1)
        },
        **({"suggested_effects": effects} if effects else {}),
    }


def from_mapping(mapping: Mapping[str, Any], where: str | None = None) -> ArmParameters:
    """Value from the mapping of a parameter file, checked by :func:`check_parameters`.

    ``where`` (a path, a topic) begins the text of every error.

    Raises ParameterError: unknown or missing key, wrong unit, length, type or sign, D + Ia not
    positive definite; names the key and what was expected.
    """
    reader = Reader(where)
    reader.keys(mapping, "", _TOP_KEYS, optional=("suggested_effects",))
    values: dict[str, Any] = {}

    def quantity(entry: Any, key: str, count: int, *units: str) -> Any:
        found, at = reader.entry(entry, key, *units), f"{key}.value"
        values[key] = reader.numbers(found["value"], at, count) if count else reader.number(found["value"], at)
        if found["unit"] == "deg":
            values[key] = tuple(map(math.radians, values[key]))
        return values[key]

    def quantities(
        group: Any, key: str, known: Mapping[str, _Quantity], optional: Collection[str] = ()
    ) -> dict[str, Any]:
        reader.keys(group, key, known, optional)
        return {n: quantity(group[n], f"{key}.{n}", q.length, q.unit) for n, q in known.items() if n in group}

    def three(key: str, stem: str) -> list[tuple[Any, str]]:
        names = [f"{stem}{n}" for n in (1, 2, 3)]
        reader.keys(mapping[key], key, names)
        return [(mapping[key][name], f"{key}.{name}") for name in names]

    links, motors, ranges = three("links", "link"), three("motors", "joint"), three("joint_ranges", "joint")
    parameters = ArmParameters(
        name=reader.text(mapping["name"], "name"),
        source=reader.text(mapping["source"], "source"),
        links=tuple(Link(**quantities(*link, _LINK, ("products",))) for link in links),  # type: ignore[arg-type]
        motors=tuple(Motor(**quantities(*motor, _MOTOR)) for motor in motors),  # type: ignore[arg-type]
        **quantities(mapping["geometry"], "geometry", _GEOMETRY),
        gravity=quantity(mapping["gravity"], "gravity", 0, "m/s^2"),
        joint_ranges=tuple(quantity(*each, 2, "rad", "deg") for each in ranges),  # type: ignore[arg-type]
        suggested_effects=_effects(reader, mapping.get("suggested_effects", []), values),
        sources={key: (values[key], text) for key, text in reader.sources.items()},
    )
    check_parameters(parameters, where)
    return parameters


def _effects(reader: Reader, entries: Any, values: dict[str, Any]) -> tuple[str, ...]:
    """The suggested effects; `values` gets each by its key."""
    if not isinstance(entries, (list, tuple)):
        reader.fail("suggested_effects", f"{entries!r}", "a list of effects")
    names = []
    for n, entry in enumerate(entries, start=1):
        key = f"suggested_effects[{n}]"
        if isinstance(entry, Mapping):
            reader.keys(entry, key, ("effect", "source"))
            reader.sources[key] = reader.text(entry["source"], f"{key}.source")
            entry, key = entry["effect"], f"{key}.effect"
        values[f"suggested_effects[{n}]"] = effect = reader.text(entry, key)
        if not re.fullmatch(r"\w+(:\w+=[^,=]+(,\w+=[^,=]+)*)?", effect):
            reader.fail(key, f"'{effect}'", "NAME:parameter=value,...")
        names.append(effect)
    return tuple(names)


def check_parameters(parameters: ArmParameters, where: str | None = None) -> None:
    """Refuse values that no arm can have.

    Types, lengths and signs; then D + Ia, whose smallest eigenvalue must be above zero over the
    joint ranges (a grid of at most 5 degrees, refined about its lowest pose). D alone need not be
    positive definite: the thesis's links have no products of inertia and are not quite bodies.

    Raises ParameterError: names the key, or the pose [deg] and the eigenvalue [kg.m^2].
    """
    reader = Reader(where)

    def check(key: str, value: Any, quantity: _Quantity) -> None:
        values = reader.numbers(value, key, quantity.length) if quantity.length else (reader.number(value, key),)
        if quantity.sign == "positive" and min(values) <= 0:
            reader.fail(key, f"{min(values)}", f"a number above 0 {quantity.unit}")
        if quantity.sign == "not negative" and min(values) < 0:
            reader.fail(key, f"{min(values)}", f"no number below 0 {quantity.unit}")

    def three(key: str, owners: tuple[Any, ...]) -> list[tuple[str, Any]]:
        if len(owners) != 3:
            reader.fail(key, f"{len(owners)} entries", "3 entries")
        return [(f"{key}{n}", owner) for n, owner in enumerate(owners, start=1)]

    groups = [("geometry", parameters, _GEOMETRY)]
    groups += [(*each, _LINK) for each in three("links.link", parameters.links)]
    groups += [(*each, _MOTOR) for each in three("motors.joint", parameters.motors)]
    for prefix, owner, quantities in groups:
        for name, quantity in quantities.items():
            check(f"{prefix}.{name}", getattr(owner, name), quantity)
    check("gravity", parameters.gravity, _Quantity("m/s^2", sign="not negative"))
    for key, pair in three("joint_ranges.joint", parameters.joint_ranges):
        check(key, pair, _Quantity("rad", 2))
        if not 0 < pair[1] - pair[0] <= 4 * math.pi:
            reader.fail(key, f"from {pair[0]} to {pair[1]} rad", "the lower end first, at most two turns in all")
    lowest, q2, q3 = smallest_eigenvalue(parameters)
    # not "<= 0": numbers so great that the inertia overflows give NaN
    if not lowest > 0:
        raise ParameterError(
            f"D + Ia is not positive definite: its smallest eigenvalue is {lowest:.4g} kg.m^2 "
            f"at q2 = {math.degrees(q2):.1f} deg, q3 = {math.degrees(q3):.1f} deg",
            where=where or f"parameters '{parameters.name}'",
            expected="eigenvalues above 0 over the joint ranges",
        )


def within_a_turn(parameters: ArmParameters) -> list[tuple[float, float]]:
    """Ranges [rad] of joints 2 and 3 that hold all poses in which D differs: it repeats after a whole turn."""
    return [(float(low), float(min(high, low + 2.0 * math.pi))) for low, high in parameters.joint_ranges[1:]]


def smallest_eigenvalue(parameters: ArmParameters) -> tuple[float, float, float]:
    """Smallest eigenvalue [kg.m^2] of D + Ia over the ranges of joints 2 and 3, with q2, q3 [rad].

    D does not depend on q1. The grid of 5 degrees is followed by three grids, each about the lowest
    pose of the one before.
    """
    added = np.diag(parameters.motor_inertia)
    low, high = np.array(within_a_turn(parameters)).T
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
            return math.nan, float(second[0, 0]), float(third[0, 0])
        # the pose of the first grid is only looked up: its eigenvalue comes with the grids about it
        values = np.linalg.eigvalsh(matrices)[..., 0] if count.prod() <= _FEW_POSES else _least_eigenvalues(matrices)
        best = np.unravel_index(np.argmin(values), values.shape)
        spacing = (last - first) / (count - 1)
        centre = poses[best][1:]
        first, last = np.maximum(low, centre - spacing), np.minimum(high, centre + spacing)
        count = np.array([9, 9])
    return float(values[best]), float(centre[0]), float(centre[1])


def _least_eigenvalues(matrices: np.ndarray) -> np.ndarray:
    """(...) smallest eigenvalues of symmetric matrices (..., 3, 3), in closed form (Smith 1961, Communications of the
    ACM 4:168): a fifth of the time of a solver, and to 1e-8 of the matrix where two are nearly the same."""
    a, b, c = (matrices[..., j, j] for j in range(3))
    d, e, f = matrices[..., 0, 1], matrices[..., 0, 2], matrices[..., 1, 2]
    mean = (a + b + c) / 3.0
    a, b, c = a - mean, b - mean, c - mean
    size = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    half = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e))
    cube = size**3
    # where all three are the same, any angle gives them
    cosine = np.clip(half / np.where(cube > 0.0, cube, 1.0), -1.0, 1.0)
    lowest: np.ndarray = mean + 2.0 * size * np.cos((np.arccos(cosine) + 2.0 * np.pi) / 3.0)
    return lowest
