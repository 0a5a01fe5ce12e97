# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The registry of effects. A new family is one line here, a new law one line in the kernel."""

from __future__ import annotations

from collections.abc import Iterable

from puma_sim_core.effects import amplifier, friction, load, motor, outside, sensing, stops, transmission
from puma_sim_core.effects.base import (
    ALWAYS,
    BRISTLE,
    CURRENT_LIMIT,
    DELAYED,
    DROOP,
    DRY,
    POSED,
    SENSED,
    SMOOTH,
    TILT,
    TIMED,
    TWO_MASS,
    VARYING,
    Effect,
    Kind,
    Parameter,
)
from puma_sim_core.errors import ParameterError

__all__ = [
    "ALWAYS",
    "BRISTLE",
    "CURRENT_LIMIT",
    "DELAYED",
    "DROOP",
    "DRY",
    "KINDS",
    "POSED",
    "SENSED",
    "SMOOTH",
    "TILT",
    "TIMED",
    "TWO_MASS",
    "VARYING",
    "WIDTH",
    "Effect",
    "Kind",
    "Parameter",
    "active_stages",
    "check_distinct",
    "fill_arm",
    "pack",
    "parse_effect",
    "slot",
]

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        *friction.KINDS,
        *amplifier.KINDS,
        *stops.KINDS,
        *load.KINDS,
        *transmission.KINDS,
        *motor.KINDS,
        *outside.KINDS,
        *sensing.KINDS,
    )
}

_SLOTS: dict[str, int] = {}
for _kind in KINDS.values():
    _SLOTS[_kind.name] = sum(len(KINDS[name].parameters) for name in _SLOTS)

#: parameters of one joint in the packed table
WIDTH = sum(len(kind.parameters) for kind in KINDS.values())

_NEUTRAL = [p.neutral for kind in KINDS.values() for p in kind.parameters]


def slot(kind: Kind) -> int:
    """Place of the first parameter of `kind` among the parameters of a joint."""
    return _SLOTS[kind.name]


def parse_effect(text: str) -> Effect:
    """The effect written as ``name:joint=2,parameter=value,...``.

    Raises
    ------
    ParameterError : names the part of the text that cannot be used.
    """
    name, _, rest = text.strip().partition(":")
    if name not in KINDS:
        raise ParameterError(
            f"unknown effect '{name}'", where=f"effect '{text}'", expected=f"one of {', '.join(KINDS)}"
        )
    joint: int | None = None
    values: dict[str, float] = {}
    for item in filter(None, rest.split(",")):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not key or not value:
            raise ParameterError(f"'{item}'", where=f"effect '{text}'", expected="key=value")
        if key in values or (key == "joint" and joint is not None):
            raise ParameterError(f"'{key}' is given twice", where=f"effect '{text}'", expected="each once")
        try:
            if key == "joint":
                joint = int(value)
            else:
                values[key] = float(value)
        except ValueError:
            raise ParameterError(
                f"{key}={value}", where=f"effect '{text}'", expected="joint=1, 2 or 3" if key == "joint" else "a number"
            ) from None
    return Effect(KINDS[name], joint, values)


def check_distinct(effects: Iterable[Effect]) -> None:
    """Raise ParameterError where the same kind stands twice on one joint."""
    seen = set()
    for effect in effects:
        key = (effect.kind.name, effect.joint)
        if key in seen:
            place = "the arm" if effect.joint is None else f"joint {effect.joint}"
            raise ParameterError(
                f"effect {effect.kind.name} stands twice on {place}", expected="each kind once a joint"
            )
        seen.add(key)


def pack(effects: Iterable[Effect]) -> list[float]:
    """The flat table of 3 * WIDTH parameters that the kernel reads."""
    table = _NEUTRAL * 3
    for effect in effects:
        joints = (0, 1, 2) if effect.joint is None else (effect.joint - 1,)
        for j in joints:
            at = j * WIDTH + slot(effect.kind)
            table[at : at + len(effect.values)] = effect.values.values()
    return table


def fill_arm(table: list[float], kind: Kind, numbers: Iterable[float]) -> None:
    """Put numbers that an effect of the whole arm comes down to in the places of `kind`, joint by
    joint, in a table of `pack`."""
    width = len(kind.parameters)
    for n, number in enumerate(numbers):
        table[n // width * WIDTH + slot(kind) + n % width] = float(number)


def active_stages(effects: Iterable[Effect]) -> int:
    """Bit mask of the kernel's optional stages that these effects need.

    A joint whose dry friction acts through a bristle never sticks and slips.
    """
    effects = tuple(effects)
    bristled = {effect.joint for effect in effects if effect.kind.stage & BRISTLE}
    mask = 0
    for effect in effects:
        mask |= effect.kind.stage & ~DRY if effect.joint in bristled else effect.kind.stage
    return mask
