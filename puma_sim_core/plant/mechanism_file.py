# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Files that describe mechanisms: ``config/mechanisms`` and those of users.

YAML with ``format``, ``name`` and ``kind``; a number is ``{value: ..., unit: ..., source: ...}``.

``kind: arm``: ``parameters`` (a published set or the path of a parameter file),
``viscous_friction`` and ``torque_scale`` (three values each) and ``relative_deviation``, the
width of the prior of each sort of number as a share of it.

``kind: pendulum`` and ``kind: slide``: ``range``, ``body`` and ``drive``; a number may also have
``deviation`` (in its unit), ``relative_deviation`` (a share of it) or ``known: true``, one of them.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.errors import ParameterError
from puma_sim_core.files import read_yaml
from puma_sim_core.plant.arm_mechanism import WIDTHS, ArmMechanism
from puma_sim_core.plant.mechanism import MECHANISM_FORMAT, Mechanism

KINDS = ("arm", "pendulum", "slide")


def read_mechanism(path: str | os.PathLike) -> Mechanism:
    """The mechanism of a file.

    Raises
    ------
    ParameterError : names the file, the key, what is wrong and what was expected.
    """
    mapping = read_yaml(path)
    reader = Reader(str(path))
    if not isinstance(mapping, Mapping) or mapping.get("format") != MECHANISM_FORMAT:
        found = mapping.get("format") if isinstance(mapping, Mapping) else mapping
        reader.fail("format", f"{found!r}"[:80], f"'{MECHANISM_FORMAT}'")
    kind = mapping.get("kind")
    if kind not in KINDS:
        reader.fail("kind", f"{kind!r}"[:80], f"one of {', '.join(KINDS)}")
    if kind == "arm":
        return _arm(reader, mapping, Path(path).parent)
    from puma_sim_core.plant.one_joint import OneJoint
    from puma_sim_core.plant.one_joint_mechanism import OneJointMechanism

    return OneJointMechanism.of(OneJoint.from_mapping(mapping, str(path)))


def _arm(reader: Reader, mapping: Mapping, folder: Path) -> ArmMechanism:
    reader.keys(
        mapping, "", ("format", "name", "kind", "parameters", "viscous_friction", "torque_scale", "relative_deviation")
    )
    source = reader.text(mapping["parameters"], "parameters")
    beside = folder / source
    arm = load_parameters(beside if beside.is_file() else source)
    viscous = reader.triple(mapping["viscous_friction"], "viscous_friction", "N.m.s/rad", 0.0)
    scale = reader.triple(mapping["torque_scale"], "torque_scale", "N.m", 1e-9)
    shares = mapping["relative_deviation"]
    reader.keys(shares, "relative_deviation", WIDTHS)
    widths = {}
    for name in WIDTHS:
        key = f"relative_deviation.{name}"
        entry = reader.entry(shares[name], key, "1")
        widths[name] = reader.number(entry["value"], f"{key}.value", 0.0, 1.0)
    return ArmMechanism.of(arm, viscous, widths, scale, name=reader.text(mapping["name"], "name"))


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
