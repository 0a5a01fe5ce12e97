# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Numbers, units and names of effects in Unicode, which pages and figures show alike."""

import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

MINUS = "\N{MINUS SIGN}"
SPACE = "\N{NO-BREAK SPACE}"
DASH = "\N{EN DASH}"
_RAISED = str.maketrans(
    f"-{MINUS}+0123456789", "\u207b\u207b\u207a\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)
#: units that readers know with a prefix
_SCALED = ("rad", "m", "s", "V", "A", "N.m")
_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}
_HYPHENED = {
    "load dependent": "load-dependent",
    "position dependent": "position-dependent",
    "dead band": "dead-band",
    "warm up": "warm-up",
}


def raised(words: object) -> str:
    """Powers with raised digits: m^2, 10^-5 and e^(-3)."""
    powers = rf"\^(?:\(([-{MINUS}+]?\d+)\)|([-{MINUS}+]?\d+))"
    return re.sub(powers, lambda found: (found[1] or found[2]).translate(_RAISED), str(words))


def unit_text(name: str) -> str:
    """A unit with its points and powers raised, "" for a pure number: N.m.s2/rad2 becomes N·m·s²/rad²."""
    powers = re.sub(r"(?<=[A-Za-z])\^?(\d)", r"^\1", "" if name == "1" else name)
    return raised(powers).replace(".", "\N{MIDDLE DOT}")


def number_text(value: Any) -> str:
    """A number with five digits and a proper minus, powers of ten as 10^5; words as they are; "" for None."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, (int, float)):
        return str(value)
    mantissa, _, exponent = (str(value) if isinstance(value, int) else f"{value:.5g}").partition("e")
    power = f"\N{MULTIPLICATION SIGN}10^{int(exponent)}" if exponent else ""
    return mantissa.replace("-", MINUS) + power


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many digits that count, a proper minus, and a dash where there is none."""
    if value is None or not math.isfinite(value):
        return DASH
    if value == 0.0:
        return "0"
    power = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if not -3 <= power < 6:
        return f"{fixed(value / 10.0**power, digits - 1)}\N{MULTIPLICATION SIGN}{raised(f'10^{power}')}"
    return fixed(value, max(0, digits - 1 - power))


def fixed(value: float, decimals: int) -> str:
    """A number with so many decimals and a proper minus."""
    return f"{value:.{decimals}f}".replace("-", MINUS)


def scale(values: Iterable[float], name: str) -> tuple[float, str]:
    """(factor, unit) in which the greatest of the values reads well: rad, mrad or µrad."""
    if name not in _SCALED:
        return 1.0, name
    sizes = np.abs(np.asarray(list(values), dtype=float).ravel())
    sizes = sizes[np.isfinite(sizes)]
    largest = float(sizes.max()) if sizes.size else 0.0
    if largest == 0.0 or largest >= 0.5 or (largest >= 0.05 and name in ("V", "A", "s", "N.m")):
        return 1.0, name
    return (1e3, f"m{name}") if largest >= 5e-5 else (1e6, f"\N{MICRO SIGN}{name}")


def quantity(value: float, name: str) -> str:
    """A number with its unit, in a prefix that reads well."""
    factor, shown = scale([value], name)
    return f"{number(value * factor)}{SPACE}{unit_text(shown)}".rstrip(SPACE)


def plain_quantity(value: float, name: str) -> str:
    """`quantity` in plain text, with three digits."""
    factor, shown = scale([value], name)
    return f"{value * factor:.3g} {'' if shown == '1' else shown}".strip()


def effect_name(name: str, lower: bool = False) -> str:
    """The name of an effect in words; `lower`: inside a sentence, where proper names keep their capital."""
    words = " ".join(_PROPER.get(word, word) for word in name.split("_"))
    for apart, together in _HYPHENED.items():
        words = words.replace(apart, together)
    return words if lower else words[:1].upper() + words[1:]


def place(joint: int | None) -> str:
    """Where an effect acts, in words."""
    return "the whole arm" if joint is None else f"joint{SPACE}{joint}"


def listed(words: Iterable[str]) -> str:
    """ "a, b and c"."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last
