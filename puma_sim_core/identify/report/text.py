# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Numbers and names as a reader of the report sees them."""

import math
from collections.abc import Iterable

import numpy as np

from puma_sim_core.identify.result import Explanation, Hypothesis, Interval, NamedEffect, Ranked, RuledOut
from puma_sim_core.pages.text import DASH, MINUS, SPACE, raised, unit_text

#: units that readers know with a prefix
_SCALED = ("rad", "m", "s", "V", "A")
_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}
_HYPHENED = {
    "load dependent": "load-dependent",
    "position dependent": "position-dependent",
    "dead band": "dead-band",
    "warm up": "warm-up",
}
_MECHANISMS = {"puma560": "PUMA 560"}
#: the rows that errors are shown for, the most telling first
PART_WORDS = {"held_out_logs": "held-out logs", "held_out": "validation set", "fit": "fitted data"}


def shown_part(e: Explanation) -> str | None:
    """The part of the errors that is drawn, None without any."""
    return next((part for part in PART_WORDS if part in e.errors), None)


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many digits that count, a proper minus, and a dash where there is none."""
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0.0:
        return "0"
    power = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -3 <= power < 6:
        return f"{_fixed(value / 10.0**power, digits - 1)}\N{MULTIPLICATION SIGN}{raised(f'10^{power}')}"
    return _fixed(value, max(0, digits - 1 - power))


def _fixed(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}".replace("-", MINUS)


def scale(values: Iterable[float], name: str) -> tuple[float, str]:
    """(factor, unit) in which the greatest of the values reads well: rad, mrad or µrad."""
    if name not in _SCALED:
        return 1.0, name
    sizes = np.abs(np.asarray(list(values), dtype=float).ravel())
    sizes = sizes[np.isfinite(sizes)]
    largest = float(sizes.max()) if sizes.size else 0.0
    if largest == 0.0 or largest >= 0.5 or (largest >= 0.05 and name in ("V", "A", "s")):
        return 1.0, name
    return (1e3, f"m{name}") if largest >= 5e-5 else (1e6, f"\N{MICRO SIGN}{name}")


def quantity(value: float, name: str) -> str:
    """A number with its unit, in a prefix that reads well."""
    factor, shown = scale([value], name)
    return f"{number(value * factor)}{SPACE}{unit_text(shown)}".rstrip(SPACE)


def estimate(found: Interval) -> tuple[str, str, str]:
    """(value, interval, unit) of an estimate, with as many decimals as the interval deserves."""
    factor, shown = scale([found.value], found.unit)
    value, low, high = (each * factor for each in (found.value, found.low, found.high))
    wide = high - low
    decimals = 1 - math.floor(math.log10(wide / 2.0)) if math.isfinite(wide) and wide > 0.0 else None
    if decimals is None:
        middle, *ends = map(number, (value, low, high))
    elif decimals > 6 or max(abs(low), abs(high)) >= 1e6:
        middle, *ends = (number(each, 5) for each in (value, low, high))
    else:
        middle, *ends = (_fixed(each, max(0, decimals)) for each in (value, low, high))
    words = [end if math.isfinite(each) else "no bound" for end, each in zip(ends, (low, high))]
    return middle, f"{words[0]} to {words[1]}", unit_text(shown)


def effect_name(name: str, lower: bool = False) -> str:
    """The name of an effect in words; `lower`: inside a sentence, where proper names keep their capital."""
    words = " ".join(_PROPER.get(word, word) for word in name.split("_"))
    for apart, together in _HYPHENED.items():
        words = words.replace(apart, together)
    return words if lower else words[:1].upper() + words[1:]


def place(joint: int | None) -> str:
    """Where an effect acts, in words."""
    return "the whole arm" if joint is None else f"joint{SPACE}{joint}"


def hypothesis(each: Hypothesis | NamedEffect | Ranked | RuledOut, lower: bool = False) -> str:
    """An effect with its place: "Coulomb friction on joint 2"."""
    return f"{effect_name(each.name, lower)} {'of' if each.joint is None else 'on'} {place(each.joint)}"


def listed(words: Iterable[str]) -> str:
    """ "a, b and c"."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


def gain(evidence: float | None) -> str:
    """A gain of evidence with its sign."""
    if evidence is None or not math.isfinite(evidence):
        return DASH
    shown = f"{evidence:+.0f}" if abs(evidence) >= 9.95 else f"{evidence:+.1f}"
    return shown.replace("-", MINUS)


def mechanism(explanation: Explanation) -> str:
    """The mechanism's name as people write it."""
    return _MECHANISMS.get(explanation.mechanism, explanation.mechanism)


def is_augmented(e: Explanation) -> bool:
    """Whether anything was added to the model: effects, or the shape of what has no name."""
    if e.effects:
        return True
    return e.shape is not None and any(
        not np.array_equal(stages.augmented, stages.retuned, equal_nan=True)
        for each in e.errors.values()
        for stages in (each.voltage_rms, each.position_rms)
    )
