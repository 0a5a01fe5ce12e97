# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""An effect at a size: from the smallest to the greatest that machines have, on a logarithmic scale.

Size 0 is the least plausible value of the effect's main parameter, 1 the greatest; for a stiffness or a limit, of which
less is worse, it is the other way round. Other parameters of the same unit keep the proportion that they have in the
effect's example; what needs time to build up does so within a trial.
"""

from __future__ import annotations

from math import inf, log

from puma_sim_core.effects import KINDS, Effect, Kind, parse_effect
from puma_sim_core.effects.base import PLACE, RATE, Parameter

#: sizes that single effects are tried at
SIZES = {"small": 0.0, "medium": 0.5, "large": 1.0}
#: range in which a critical size is sought, in the scale above: from a hundredth of the range below it to half above
SEARCHED = (-1.0, 1.5)
#: of an effect whose file states no plausible sizes, its example divided and multiplied by this
_ABOUT_EXAMPLE = 5.0


def main_parameter(kind: Kind) -> tuple[Parameter, float, float]:
    """The parameter that an effect's size is, and its (value at size 0, value at size 1)."""
    if kind.plausible:
        name, low, high = kind.plausible[0]
        found = kind.parameter(name)
    else:
        found = kind.parameters[0]
        value = parse_effect(kind.example).values[found.name]
        low, high = value / _ABOUT_EXAMPLE, value * _ABOUT_EXAMPLE
    less_is_worse = found.inverse or found.neutral == inf
    return (found, high, low) if less_is_worse else (found, low, high)


def scalable() -> list[Kind]:
    """Effects that have a size: those with an example, one of each that a joint may have several of."""
    return [kind for kind in KINDS.values() if kind.example and kind.number == 1 and main_parameter(kind)[1] > 0.0]


def value_at(kind: Kind, size: float) -> float:
    """Value of the main parameter at a size, within what the parameter may be."""
    parameter, first, last = main_parameter(kind)
    return float(min(max(first * (last / first) ** size, parameter.low), parameter.high))


def size_at(kind: Kind, value: float) -> float:
    """The inverse of `value_at`."""
    _, first, last = main_parameter(kind)
    return log(value / first) / log(last / first)


def effect_of_size(name: str, joint: int | None, size: float, middle: float) -> Effect:
    """The effect of a name at a size; middle : of the trial [s], where what happens once does."""
    kind = KINDS[name]
    main, value = main_parameter(kind)[0], value_at(kind, size)
    example = parse_effect(kind.example).values
    ratio = value / example[main.name] if main.name in example else 1.0
    values = {}
    for p in kind.parameters:
        if p is main or p.name == main.name:
            values[p.name] = value
        elif p.from_arm is not None and p.role is PLACE:
            continue
        elif p.name == "time":
            values[p.name] = middle
        elif p.unit == main.unit and p.role is main.role and p.name in example:
            values[p.name] = float(min(max(example[p.name] * ratio, p.low), p.high))
        elif p.role is RATE and p.unit == "s" and p.plausible is not None:
            values[p.name] = p.plausible[0]
        elif p.name in example:
            values[p.name] = example[p.name]
    return Effect(kind, joint, values)
