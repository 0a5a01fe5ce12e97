# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What a reader wants to know in the first ten seconds: what is missing, how sure, how much better."""

from __future__ import annotations

import math

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.report.tables import STAGES
from puma_sim_core.identify.report.text import (
    effect_name,
    estimate,
    gain,
    hypothesis,
    is_augmented,
    listed,
    number,
    place,
    rms,
    scale,
    text,
    unit,
)
from puma_sim_core.identify.result import (
    DATA_FAULT,
    NAMED,
    NAMED_WITH_REMAINDER,
    NOTHING_MISSING,
    UNNAMED,
    Explanation,
    NamedEffect,
    StageErrors,
)

_BADGES = {
    NOTHING_MISSING: "Nothing missing",
    NAMED: "Named",
    NAMED_WITH_REMAINDER: "Named, with a remainder",
    UNNAMED: "Something without a name",
    DATA_FAULT: "Fault in the data",
}
_ROWS = {"nominal": "nominal", "retuned": "retuned", "augmented": "augmented", "floor": "noise"}


def badge(e: Explanation) -> str:
    """The verdict in a word or two."""
    return _BADGES.get(e.verdict, text(e.verdict))


def answers(e: Explanation) -> str:
    """The three answers side by side."""
    if e.verdict == DATA_FAULT:
        cards = [("What is wrong", _fault(e)), ("What to do", _remedy(e))]
    else:
        cards = [("What is missing", _what(e)), ("How sure", _how_sure(e)), ("How much better", _how_much(e))]
    return (
        '<div class="answers">\n'
        + "".join(f"<div><h2>{title}</h2>\n{content}</div>\n" for title, content in cards)
        + "</div>\n"
    )


def _what(e: Explanation) -> str:
    parts = [_one(effect) for effect in e.effects]
    if len(e.effects) == 1 and e.effects[0].name in KINDS:
        parts.append(f'<p class="soft">{text(KINDS[e.effects[0].name].sentence)}</p>\n')
    if e.verdict == NOTHING_MISSING:
        parts.append('<p class="big">Nothing that this record could have shown</p>\n')
        parts.append("<p>What differs from the model are its parameters and noise.</p>\n")
    elif e.shape is not None:
        shape = e.shape
        words = f"follows the {text(shape.axis.replace('_', ' '))} {text(shape.way)}".rstrip()
        if shape.line_hz is not None:
            words = f"oscillates at {number(shape.line_hz)} Hz"
        if e.effects:
            parts.append(f"<p>And a remainder on {place(shape.joint)} that {words}, which has no name.</p>\n")
        else:
            parts.append(
                f'<p class="big">Something on {place(shape.joint)} that {words}</p>\n'
                "<p>No effect of the library explains it; its curve is below.</p>\n"
            )
    elif not e.effects:
        parts.append('<p class="big">Something that no effect of the library explains</p>\n')
    return "".join(parts)


def _one(effect: NamedEffect) -> str:
    sizes = []
    for name, found in effect.parameters.items():
        value, interval, shown = estimate(found)
        sizes.append(f"{text(name.replace('_', ' '))} <b>{value}</b> {shown} ({interval})".replace("  ", " "))
    where = "of the whole arm" if effect.joint is None else f"on {place(effect.joint)}"
    rest = f"<p>{'; '.join(sizes)}</p>\n" if sizes else ""
    return f'<p class="big">{effect_name(effect.name)} {where}</p>\n{rest}'


def _how_sure(e: Explanation) -> str:
    tied = [each for effect in e.effects for each in effect.tied_with]
    own = {(each.name, each.joint) for each in (*e.effects, *tied)}
    others = [
        each
        for each in e.ranking
        if (each.name, each.joint) not in own and math.isfinite(each.evidence) and not _richer(each, e)
    ]
    rival = max(others, key=lambda each: each.evidence, default=None)
    parts = []
    if e.effects:
        first = e.effects[0]
        if tied:
            parts.append(
                f'<p class="big">Tied with {listed([hypothesis(t, True) for t in tied])}'
                "</p>\n<p>This record cannot tell them apart; "
                '<a href="#next">the next experiment</a> can.</p>\n'
            )
        else:
            behind = _behind(e, first, rival)
            parts.append(f'<p class="big">{behind[0]}</p>\n{behind[1]}')
        gains = listed([f"{gain(each.evidence)} nat" for each in e.effects])
        parts.append(
            f"<p>Evidence {gains} over the model without it; 10 would be odds of "
            "20\N{NARROW NO-BREAK SPACE}000 to 1.</p>\n"
        )
        if (
            e.feedback_bias is not None
            and e.feedback_bias.biased
            and any(KINDS[each.name].feigned for each in e.effects)
        ):
            parts.append(
                '<p class="unseen">The recording has feedback, which can feign this: '
                '<a href="#feedback">see the test</a>.</p>\n'
            )
        return "".join(parts)
    if e.verdict == NOTHING_MISSING:
        if rival is not None:
            parts.append(
                f'<p class="big">No effect gains evidence</p>\n<p>The best of '
                f"{len(others)} hypotheses, {hypothesis(rival, True)}, stands at "
                f"{gain(rival.evidence)} nat.</p>\n"
            )
        unseen = sum(not each.excited for each in e.detectability)
        if e.detectability:
            parts.append(
                f"<p>{len(e.detectability) - unseen} of {len(e.detectability)} "
                "combinations of effect and joint would have shown at a plausible size; "
                f"{unseen or 'none'} would not "
                '(<a href="#unseen">which</a>).</p>\n'
            )
        return "".join(parts) or '<p class="big">The residual is noise</p>\n'
    if rival is not None:
        parts.append(
            f'<p class="big">Not noise, and no known effect</p>\n<p>The best name, '
            f"{hypothesis(rival, True)}, does not hold "
            '(<a href="#ranking">why</a>).</p>\n'
        )
    if e.shape is not None and len(e.shape.ranking) > 1:
        (first, best), (second, next_best) = e.shape.ranking[:2]
        parts.append(
            f"<p>{text(first.replace('_', ' ')).capitalize()} explains it "
            f"{gain(best - next_best).lstrip('+')} nat better than "
            f"{text(second.replace('_', ' '))}.</p>\n"
        )
    return "".join(parts)


def _richer(each, e: Explanation) -> bool:
    """Whether it is an effect that was found, with more freedom: no rival, it explains the same."""
    kind = KINDS.get(each.name)
    return kind is not None and any(effect.name in kind.contains and effect.joint == each.joint for effect in e.effects)


def _behind(e: Explanation, first: NamedEffect, rival) -> tuple[str, str]:
    """How far the best rival that is not tied stays behind."""
    mine = next(
        (each.evidence for each in e.ranking if (each.name, each.joint) == (first.name, first.joint)), first.evidence
    )
    if rival is None:
        return "No rival", ""
    lead = mine - rival.evidence
    if lead <= 0.0:
        # two effects together explain what one alone seems to
        return "Best together", (
            f"<p>Alone, {hypothesis(rival, True)} would gain more, but what was found explains the record better.</p>\n"
        )
    words = "No rival near" if lead > 10.0 else f"Closest rival {number(lead, 2)} nat behind"
    return words, (f"<p>The next best, {hypothesis(rival, True)}, stays {number(lead, 2)} nat behind.</p>\n")


def _how_much(e: Explanation) -> str:
    part = "held_out" if "held_out" in e.errors else "fit"
    if part not in e.errors:
        return '<p class="big">Not measured</p>\n'
    joint = e.effects[0].joint if e.effects else e.shape.joint if e.shape is not None else None
    words, base, values = "open-loop position error", e.position_unit, _stages(e.errors[part].position_rms, joint)
    if not math.isfinite(values["retuned"]):
        words, base, values = "residual", e.voltage_unit, _stages(e.errors[part].voltage_rms, joint)
    added = is_augmented(e)
    after = "augmented" if added else "retuned"
    shown = {name: value for name, value in values.items() if name != "augmented" or added}
    factor, in_unit = scale(shown.values(), base)
    largest = max((value for value in shown.values() if math.isfinite(value)), default=1.0) or 1.0
    rows = "".join(
        f'<span>{_ROWS[name]}</span><i class="{name}" '
        f'style="width:{100.0 * value / largest if math.isfinite(value) else 0.0:.1f}%"></i>'
        f"<b>{number(value * factor)}</b>\n"
        for name, value in shown.items()
    )
    where = "all joints" if joint is None else place(joint)
    data = "held-out data" if part == "held_out" else "fitted data"
    times = _times(values["nominal"], values[after])
    return (
        f'<p class="big">{times}</p>\n<div class="meters">\n{rows}</div>\n'
        f"<p>{words[0].upper() + words[1:]} [{unit(in_unit)}], {where}, {data}"
        f"{'' if added else '; retuned only, nothing added'}.</p>\n"
    )


def _times(before: float, after: float) -> str:
    if not (math.isfinite(before) and math.isfinite(after)) or min(before, after) <= 0.0:
        return "Error before and after"
    ratio = before / after
    if ratio >= 1.05:
        return f"Error {number(ratio, 2)} times smaller"
    return "Error unchanged" if ratio > 0.95 else f"Error {number(1.0 / ratio, 2)} times larger"


def _stages(errors: StageErrors, joint: int | None) -> dict[str, float]:
    """Errors of one joint, or of all together."""
    found = {}
    for name in STAGES:
        values = np.atleast_1d(np.asarray(getattr(errors, name), dtype=float))
        one = joint is not None and joint <= values.size
        found[name] = float(values[joint - 1]) if one else rms(values)
    return found


def _fault(e: Explanation) -> str:
    parts = []
    for each in e.faults[:2]:
        where = "" if each.row is None else f", row {each.row}"
        parts.append(f'<p class="big">{text(each.channel)}{where}</p>\n<p>{text(each.what)}</p>\n')
    if len(e.faults) > 2:
        parts.append(f'<p><a href="#faults">All {len(e.faults)} faults</a></p>\n')
    return "".join(parts)


def _remedy(e: Explanation) -> str:
    return (
        '<p class="big">Repair or repeat the record</p>\n<p>Nothing was fitted and no effect '
        "was sought: what faulty data seem to show is an accident. Check the named channel "
        "(wiring, sign, unit, column), then run the same command again.</p>\n"
    )
