# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Rows of the report's tables: errors, ranking, smallest sizes, parameters; the templates print them."""

import math
from collections.abc import Sequence

import numpy as np

from puma_sim_core.identify.report.json import STAGES
from puma_sim_core.identify.report.text import estimate, gain, hypothesis
from puma_sim_core.identify.result import Agreement, Detectable, Explanation, FeedbackBias
from puma_sim_core.identify.settings import REPORT
from puma_sim_core.pages.text import DASH, MINUS, SPACE, effect_name, listed, number, scale, unit_text

_PARTS = {
    "held_out_logs": "Held-out logs, outside the analysis",
    "held_out": "Validation set, not used to fit",
    "unseen": "Validation set, not used to choose the effects either",
    "fit": "Fitted data",
}


def errors(e: Explanation, quantity: str, base: str) -> tuple[str, list[tuple[str, list[list[str]]]]]:
    """(unit, parts) of one quantity; a part is its words and, for each joint, the number of each stage."""
    parts = {
        words: [np.atleast_1d(getattr(getattr(e.errors[part], quantity), stage)) for stage in STAGES]
        for part, words in _PARTS.items()
        if part in e.errors
    }
    factor, unit = scale(np.concatenate([column for columns in parts.values() for column in columns]), base)
    shown = []
    for words, columns in parts.items():
        count = max(column.size for column in columns)
        full = [[*column * factor, *[math.nan] * (count - column.size)] for column in columns]
        shown.append((words, [[number(value) for value in row] for row in zip(*full)]))
    return unit_text(unit), shown


def ranking(e: Explanation) -> list[tuple[str, str, str, float, str]]:
    """(class, hypothesis, gain, its share of the greatest [%], reason) of all hypotheses, the best first; look-alikes
    that were not tried come last."""
    named = {(effect.name, effect.joint) for effect in e.effects}
    largest = max([1.0, *(each.evidence for each in e.ranking if math.isfinite(each.evidence))])
    rows, seen = [], set(named)
    for each in e.ranking:
        key = (each.name, each.joint)
        seen.add(key)
        kind, why = "", each.verdict
        if key in named:
            kind, why = "named", "named: it explains the residual best"
        elif each.verdict == "tied" and each.against is not None:
            kind, why = "tied", f"tied with {hypothesis(each.against, True)}: this record cannot tell the two apart"
        share = 100.0 * min(max(each.evidence, 0.0) / largest, 1.0) if math.isfinite(each.evidence) else 0.0
        rows.append((kind, hypothesis(each), gain(each.evidence), share, f"{why[:1].upper()}{why[1:]}."))
    for other in (other for effect in e.effects for other in effect.ruled_out):
        if (other.name, other.joint) not in seen:
            seen.add((other.name, other.joint))
            rows.append(("", hypothesis(other), DASH, 0.0, other.because[:1].upper() + other.because[1:]))
    return rows


def link_sides(e: Explanation) -> list[tuple[int, str, list[str], str]]:
    """(joint, what was found, numbers, unit) of each joint with a second sensor; the numbers are root mean squares of
    the readings' difference before and after, and what their steps leave."""
    rows = []
    for side in e.link_side:
        values = (side.held_out_before, side.held_out_after, side.floor)
        factor, unit = scale(values[:2], e.position_unit)
        found = []
        for effect in side.effects:
            ((name, size),) = effect.parameters.items()
            value, interval, shown = estimate(size)
            whose = f" of the {effect.sensor}'s sensor" if effect.sensor else ""
            size_words = f"{name.replace('_', ' ')} {value} {shown} ({interval})"
            found.append(f"{effect_name(effect.name)}{whose}, {size_words}, {gain(effect.evidence)} nat")
        words = "; ".join(found) or "nothing"
        rows.append((side.joint, words, [number(each * factor) for each in values], unit_text(unit)))
    return rows


def heterogeneity(found: Agreement) -> list[tuple[str, list[str], bool]]:
    """(size, numbers, whether the logs agree) of the sizes that several logs give."""
    rows = []
    for effect in found.effects:
        for size in effect.sizes:
            if size.mean is not None and size.p_value is not None and size.q is not None and size.i2 is not None:
                value, interval, unit = estimate(size.mean)
                p = "< 0.0001" if size.p_value < 1e-4 else number(size.p_value, 2)
                numbers = [f"{value} {unit}".strip(), interval, number(size.q), p, f"{100.0 * size.i2:.0f} %"]
                words = f"{size.parameter.replace('_', ' ')}{f' ({size.law_words})' if size.law_words else ''}"
                rows.append((f"{hypothesis(effect)}, {words}", numbers, size.agrees))
    return rows


def smallest_sizes(found: Sequence[Detectable], joints: int) -> list[tuple[str, str, bool, list[str | None]]]:
    """(effect, parameter with unit, whether of the whole arm, sizes) of each effect; None: not excited."""
    groups: dict[tuple[str, str, str], dict[int | None, Detectable]] = {}
    for each in found:
        groups.setdefault((each.name, each.parameter, each.unit), {})[each.joint] = each
    rows = []
    for (name, parameter, base), places in groups.items():
        factor, unit = scale([each.size for each in places.values() if each.excited], base)
        whole = None in places
        sizes = [
            DASH if each is None else number(each.size * factor, 2) if each.excited else None
            for each in map(places.get, (None,) if whole else range(1, joints + 1))
        ]
        words = ", ".join(filter(None, (parameter.replace("_", " "), unit_text(unit))))
        rows.append((effect_name(name), words, whole, sizes))
    return rows


def not_excited(found: Sequence[Detectable]) -> list[str]:
    """Names of the effects with the joints on which the log could not have shown them."""
    groups: dict[str, list[int | None]] = {}
    for each in found:
        if not each.excited:
            groups.setdefault(each.name, []).append(each.joint)
    names = []
    for name, joints in groups.items():
        where = f" (joint{'s' * (len(joints) > 1)}{SPACE}{listed(map(str, joints))})"
        if 1 < len(joints) == sum(each.name == name for each in found):
            where = " (all joints)"
        names.append(effect_name(name, lower=True) + ("" if joints[0] is None else where))
    return names


def parameters_retuned(e: Explanation) -> list[tuple[str, str, list[str], bool]]:
    """(name, unit, numbers, whether far) of each parameter, those that moved most on top; the numbers are start,
    retuned, relative change and, where any is known, change in widths of the prior."""
    known = any(len(entry) > 3 and entry[3] for entry in e.parameters.values())
    rows = []
    for name, (start, retuned, unit, *width) in e.parameters.items():
        step = retuned - start
        relative = step / start if start else math.nan
        widths = step / width[0] if width and width[0] else math.nan
        moved = next((abs(each) for each in (widths, relative) if math.isfinite(each)), abs(step))
        shown = [number(start, 5), number(retuned, 5), _signed(relative, "+.1%")]
        shown += [_signed(widths, "+.2f")] if known else []
        rows.append((moved, (name, unit_text(unit), shown, abs(widths) > REPORT.far)))
    return [row for _, row in sorted(rows, key=lambda pair: -pair[0])]


def feedback(found: FeedbackBias) -> list[tuple[str, str]]:
    """(statistic, p-value) of the test for feedback, joint by joint."""
    pairs = zip(np.atleast_1d(found.statistic), np.atleast_1d(found.p_value))
    return [(number(a), "< 0.0001" if 0.0 <= b < 1e-4 else number(b, 2)) for a, b in pairs]


def _signed(value: float, digits: str) -> str:
    return f"{value:{digits}}".replace("-", MINUS) if math.isfinite(value) else DASH
