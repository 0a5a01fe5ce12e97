# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Entries of files: numbers with their units, and errors that name the key."""

from __future__ import annotations

import math
from collections.abc import Mapping

from puma_sim_core.errors import ParameterError


class Reader:
    """Reads entries of a file and names their keys in errors (ParameterError)."""

    def __init__(self, where: str | None):
        self.where = where

    def fail(self, key: str, what: str, expected: str):
        """Raise, with the place and the key."""
        place = ": ".join(part for part in (self.where, key) if part)
        raise ParameterError(what, where=place or None, expected=expected)

    def keys(self, mapping, key: str, names, optional=()) -> None:
        """Check that a mapping has all of `names`, but for `optional`, and no others."""
        if not isinstance(mapping, Mapping):
            self.fail(key, f"{mapping!r}"[:80], f"a mapping with the keys {', '.join(names)}")
        for name in mapping:
            if name not in names:
                self.fail(f"{key}.{name}" if key else str(name), "unknown key", f"one of {', '.join(names)}")
        for name in names:
            if name not in mapping and name not in optional:
                self.fail(f"{key}.{name}" if key else name, "missing", f"this key in {key}" if key else "this key")

    def text(self, value, key: str) -> str:
        """A text that is not empty."""
        if not isinstance(value, str) or not value:
            self.fail(key, f"{value!r}"[:80], "text")
        return value

    def number(self, value, key: str, low: float = -math.inf, high: float = math.inf) -> float:
        """A finite number from low to high."""
        usable = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not usable or abs(value) > 1e300 or not low <= value <= high:
            bounds = "" if (low, high) == (-math.inf, math.inf) else f" from {low:g} to {high:g}"
            self.fail(key, f"{value!r}"[:80], f"a finite number{bounds}")
        return float(value)

    def entry(self, entry, key: str, unit: str, further=()) -> Mapping:
        """The mapping {value, unit, source} of a number, with the right unit."""
        if not isinstance(entry, Mapping):
            self.fail(key, f"{entry!r} without a unit"[:80], f"{{value: ..., unit: {unit}, source: ...}}")
        self.keys(entry, key, ("value", "unit", "source", *further), optional=("source", *further))
        if str(entry["unit"]) != unit:
            self.fail(f"{key}.unit", f"unit '{entry['unit']}'"[:80], unit)
        if "source" in entry:
            self.text(entry["source"], f"{key}.source")
        return entry

    def triple(self, entry, key: str, unit: str, low: float) -> tuple[float, ...]:
        """Three numbers of at least `low`."""
        values = self.entry(entry, key, unit)["value"]
        if not isinstance(values, (list, tuple)) or len(values) != 3:
            self.fail(f"{key}.value", f"{values!r}"[:80], "three numbers")
        return tuple(self.number(value, f"{key}.value", low) for value in values)
