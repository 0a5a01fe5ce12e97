# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Numbers and names as a reader of the report sees them."""

import math

import numpy as np

from puma_sim_core.identify.result import (
    AgreementOfEffect,
    Explanation,
    Hypothesis,
    Interval,
    NamedEffect,
    Ranked,
    RuledOut,
)
from puma_sim_core.pages.text import DASH, MINUS, effect_name, fixed, number, place, scale, unit_text

_MECHANISMS = {"puma560": "PUMA 560"}
#: the rows that errors are shown for, the most telling first
PART_WORDS = {"held_out_logs": "held-out logs", "held_out": "validation set", "fit": "fitted data"}


def shown_part(e: Explanation) -> str | None:
    """The part of the errors that is drawn, None without any."""
    return next((part for part in PART_WORDS if part in e.errors), None)


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
        middle, *ends = (fixed(each, max(0, decimals)) for each in (value, low, high))
    words = [end if math.isfinite(each) else "no bound" for end, each in zip(ends, (low, high))]
    return middle, f"{words[0]} to {words[1]}", unit_text(shown)


def hypothesis(each: Hypothesis | AgreementOfEffect | NamedEffect | Ranked | RuledOut, lower: bool = False) -> str:
    """An effect with its place: "Coulomb friction on joint 2"."""
    return f"{effect_name(each.name, lower)} {'of' if each.joint is None else 'on'} {place(each.joint)}"


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
