# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Numbers, units and names as a reader of the report sees them: HTML, already escaped."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from html import escape

import numpy as np

from puma_sim_core.identify.result import Explanation, Hypothesis, Interval

DASH = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
SPACE = "\N{NO-BREAK SPACE}"
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


def text(words: object) -> str:
    """Any words as HTML; what a file name has that is no text becomes a question mark."""
    return escape(str(words).encode("utf-8", "replace").decode("utf-8"))


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many digits that count, a proper minus, and a dash where there is none."""
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0.0:
        return "0"
    power = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -3 <= power < 6:
        return (
            f"{_fixed(value / 10.0**power, digits - 1)}\N{MULTIPLICATION SIGN}"
            f"10<sup>{str(power).replace('-', MINUS)}</sup>"
        )
    return _fixed(value, max(0, digits - 1 - power))


def _fixed(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}".replace("-", MINUS)


def unit(name: str) -> str:
    """A unit with its points raised, "" for a pure number: N.m.s2/rad2 becomes N·m·s²/rad²."""
    if name in ("", "1"):
        return ""
    shown = re.sub(r"(?<=[A-Za-z])\^?(\d)", r"<sup>\1</sup>", escape(name))
    return shown.replace(".", "\N{MIDDLE DOT}")


def plain_unit(name: str) -> str:
    """A unit for the letters of a drawing, which has no raised ones."""
    raised = str.maketrans("0123456789", "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")
    return re.sub(r"(?<=[A-Za-z])\^?(\d)", lambda m: m[1].translate(raised), name).replace(".", "\N{MIDDLE DOT}")


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
    return f"{number(value * factor)}{SPACE}{unit(shown)}".rstrip(SPACE)


def estimate(found: Interval) -> tuple[str, str, str]:
    """(value, interval, unit) of an estimate, with as many decimals as the interval deserves."""
    factor, shown = scale([found.value], found.unit)
    value, low, high = (each * factor for each in (found.value, found.low, found.high))
    wide = high - low
    if not math.isfinite(wide) or wide <= 0.0:
        ends = [number(low), number(high)]
        middle = number(value)
    else:
        decimals = 1 - math.floor(math.log10(wide / 2.0))
        if decimals > 6 or max(abs(low), abs(high)) >= 1e6:
            middle, ends = number(value, 5), [number(low, 5), number(high, 5)]
        else:
            middle, *ends = (_fixed(each, max(0, decimals)) for each in (value, low, high))
    words = [end if math.isfinite(each) else "no bound" for end, each in zip(ends, (low, high))]
    return middle, f"{words[0]} to {words[1]}", unit(shown)


def effect_name(name: str) -> str:
    """The name of an effect in words."""
    words = " ".join(_PROPER.get(word, word) for word in name.split("_"))
    for apart, together in _HYPHENED.items():
        words = words.replace(apart, together)
    return text(words[:1].upper() + words[1:])


def place(joint: int | None) -> str:
    """Where an effect acts, in words."""
    return "the whole arm" if joint is None else f"joint{SPACE}{joint}"


def hypothesis(each: Hypothesis, lower: bool = False) -> str:
    """An effect with its place: "Coulomb friction on joint 2"."""
    name = effect_name(each.name)
    if lower and each.name.split("_")[0] not in _PROPER:
        name = name[:1].lower() + name[1:]
    return f"{name} {'of' if each.joint is None else 'on'} {place(each.joint)}"


def listed(words: Iterable[str], last: str = "and") -> str:
    """ "a, b and c"."""
    words = list(words)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}"


def gain(evidence: float) -> str:
    """A gain of evidence with its sign."""
    if evidence is None or not math.isfinite(evidence):
        return DASH
    shown = f"{evidence:+.0f}" if abs(evidence) >= 9.95 else f"{evidence:+.1f}"
    return shown.replace("-", MINUS)


def mechanism(explanation: Explanation) -> str:
    """The mechanism's name as people write it."""
    return text(_MECHANISMS.get(explanation.mechanism, explanation.mechanism))


def rms(values: np.ndarray) -> float:
    """Root of the mean square of what is finite; NaN where nothing is."""
    values = np.asarray(values, dtype=float)
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def is_augmented(e: Explanation) -> bool:
    """Whether anything was added to the model: effects, or the shape of what has no name."""
    if e.effects:
        return True
    return e.shape is not None and any(
        not np.array_equal(stages.augmented, stages.retuned, equal_nan=True)
        for each in e.errors.values()
        for stages in (each.voltage_rms, each.position_rms)
    )
