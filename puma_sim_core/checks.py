# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Checks of what users give: numbers, shapes, choices, and the entries of YAML files."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NoReturn

import numpy as np

from puma_sim_core.errors import LISTED, ParameterError, PumaSimError, one_of


def is_number(value: object) -> bool:
    """Whether a value is a finite real number; True and False are none."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        return False
    try:
        return math.isfinite(value)
    except (OverflowError, TypeError):  # an integer of more than 308 digits, a complex number
        return False


def check_choice(value: object, name: str, choices: Collection[object], where: object = None) -> None:
    """Raise ParameterError for a value that is none of the choices."""
    if isinstance(value, bool) or value not in choices:
        expected = " or ".join(map(str, choices)) if len(choices) <= LISTED else one_of(value, choices)
        raise ParameterError(f"{name} {value!r}", where=where, expected=expected)


def check_positive(value: object, name: str, unit: str = "", where: object = None, infinite: bool = False) -> float:
    """The number above 0, finite unless infinity is allowed; raises ParameterError."""
    if not ((is_number(value) or (infinite and value == math.inf)) and value > 0.0):  # type: ignore[operator]
        raise ParameterError(f"{name} {value!r} {unit}".rstrip(), where=where, expected="a positive number")
    return float(value)  # type: ignore[arg-type]


def check_whole(value: object, name: str, low: int, high: float = math.inf, where: object = None) -> int:
    """The whole number from low to high; raises ParameterError."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        bounds = f"of at least {low}" if high == math.inf else f"from {low} to {high}"
        raise ParameterError(f"{name} {value!r}", where=where, expected=f"a whole number {bounds}")
    return value


def check_keys(mapping: Any, keys: Collection[str], where: object = None) -> None:
    """Raise ParameterError for what is no mapping with these keys and no others."""
    if not isinstance(mapping, Mapping) or set(mapping) != set(keys):
        found = ", ".join(map(str, mapping)) if isinstance(mapping, Mapping) else repr(mapping)
        raise ParameterError(f"keys {found}", where=where, expected=", ".join(keys))


def check_three_each(setpoint: Sequence[float], measurement: Sequence[float], where: object = None) -> None:
    """Raise ParameterError for setpoints and measurements of other than three joints."""
    if len(setpoint) != 3 or len(measurement) != 3:
        what = f"{len(setpoint)} setpoints and {len(measurement)} measurements"
        raise ParameterError(what, where=where, expected="3 of each")


def check_numbers(values: Any, name: str, count: int = 3, where: object = None) -> tuple[float, ...]:
    """So many finite numbers as floats; raises ParameterError."""
    try:
        result = tuple(map(float, values))
    except (TypeError, ValueError):
        result = ()
    if len(result) != count or not all(map(math.isfinite, result)):
        wanted = f"{('one', 'two', 'three')[count - 1]} finite number{'s' * (count > 1)}"
        raise ParameterError(f"{name} = {values!r}"[:200], where=where, expected=wanted)
    return result


def check_three_positive(values: Any, name: str, where: object = None) -> tuple[float, ...]:
    """Three finite numbers above 0; raises ParameterError."""
    values = tuple(values)
    if len(values) != 3 or not all(is_number(value) and value > 0.0 for value in values):
        raise ParameterError(f"{name} = {list(values)!r}", where=where, expected="three positive numbers")
    return tuple(map(float, values))


def check_shapes(shape: str, where: object = None, error: type[PumaSimError] = ParameterError, **arrays: Any) -> Any:
    """Arrays of finite floats, in the order given, of one shape; raises the error.

    shape : such as "(n,)" or "(n, 3)"; a letter stands for any length, the same in all arrays.
    """
    sizes = [size.strip() for size in shape.strip("()").split(",") if size.strip()]
    found = [np.asarray(values, dtype=float) for values in arrays.values()]
    lengths: dict[str, int] = {}
    for values in found:
        if values.ndim != len(sizes) or any(
            length != (int(size) if size.isdigit() else lengths.setdefault(size, length))
            for size, length in zip(sizes, values.shape)
        ):
            shapes = ", ".join(f"{name} of shape {values.shape}" for name, values in zip(arrays, found))
            raise error(shapes, where=where, expected=shape)
    for name, values in zip(arrays, found):
        if not np.isfinite(values).all():
            raise error(f"{name} is not finite", where=where, expected="finite numbers")
    return found


class Reader:
    """Reads entries of a YAML file, names their keys in errors (ParameterError), and gathers their sources.

    where : the file; places : line and column of its keys, as `files.places_of_keys` gives them.
    """

    def __init__(self, where: str | None, places: Mapping[str, str] | None = None):
        self.where = where
        self.places = places or {}
        self.sources: dict[str, str] = {}

    def fail(self, key: str, what: str, expected: str) -> NoReturn:
        """Raise, with the place and the key."""
        known = key
        while known and known not in self.places:  # a key that is missing is missing in the one above it
            known = known.rpartition(".")[0]
        where = ", ".join(part for part in (self.where, self.places.get(known)) if part)
        place = ": ".join(part for part in (where, key) if part)
        raise ParameterError(what[:80], where=place or None, expected=expected)

    def keys(self, mapping: Any, key: str, names: Collection[str], optional: Collection[str] = ()) -> Mapping[str, Any]:
        """The mapping, which has all of `names`, but for `optional`, and no others."""
        if not isinstance(mapping, Mapping):
            self.fail(key, f"{mapping!r}", f"a mapping with the keys {', '.join(names)}")
        prefix = f"{key}." if key else ""
        for name in mapping:
            if name not in names:
                self.fail(f"{prefix}{name}", "unknown key", one_of(name, names))
        for name in names:
            if name not in mapping and name not in optional:
                self.fail(f"{prefix}{name}", "missing", f"this key in {key}" if key else "this key")
        return mapping

    def choice(self, value: object, key: str, choices: Collection[str]) -> str:
        """One of the texts."""
        if not isinstance(value, str) or value not in choices:
            self.fail(key, f"{value!r}", " or ".join(choices))
        return value

    def text(self, value: object, key: str, least: int = 0) -> str:
        """A text of at least so many characters."""
        if not isinstance(value, str) or len(value) < least:
            self.fail(key, f"{value!r}", "text")
        return value

    def number(self, value: Any, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number from low to high."""
        if not is_number(value) or not low <= value <= high:
            bounds = "" if low == -math.inf else " above 0" if 0.0 < low < 1e-6 else f" of at least {low:g}"
            if high < math.inf:
                bounds = f"{bounds}, at most {high:g}" if 0.0 < low < 1e-6 else f" from {low:g} to {high:g}"
            self.fail(key, "no value" if value is None else f"{value!r}", f"a finite number{bounds}")
        return float(value)

    def numbers(
        self, values: Any, key: str, count: int, low: float = -math.inf, high: float = math.inf
    ) -> tuple[float, ...]:
        """So many finite numbers from low to high."""
        if not isinstance(values, (list, tuple)) or len(values) != count:
            self.fail(key, "no value" if values is None else f"{values!r}", f"{count} finite numbers")
        return tuple(self.number(value, key, low, high) for value in values)

    def entry(self, entry: Any, key: str, *units: str, further: Collection[str] = ()) -> Mapping[str, Any]:
        """The mapping {value, unit, source} of a quantity in one of the units."""
        wanted = " or ".join(units)
        if not isinstance(entry, Mapping):
            self.fail(key, f"{entry!r} without a unit", f"{{value: ..., unit: {wanted}, source: ...}}")
        self.keys(entry, key, ("value", "unit", "source", *further), ("source", *further))
        if str(entry["unit"]) not in units:
            self.fail(f"{key}.unit", f"unit '{entry['unit']}'", wanted)
        if entry.get("source") is not None:
            self.sources[key] = self.text(entry["source"], f"{key}.source")
        return entry

    def quantity(self, entry: Any, key: str, unit: str, low: float = -math.inf, high: float = math.inf) -> float:
        """The number of an entry in a unit."""
        return self.number(self.entry(entry, key, unit)["value"], f"{key}.value", low, high)
