# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Numbers and units in Unicode, which pages and figures show alike."""

import re
from typing import Any

MINUS = "\N{MINUS SIGN}"
SPACE = "\N{NO-BREAK SPACE}"
DASH = "\N{EN DASH}"
_RAISED = str.maketrans(
    f"-{MINUS}+0123456789", "\u207b\u207b\u207a\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)


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
