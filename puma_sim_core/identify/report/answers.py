# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Facts of the three answers on top of a report: what is missing, how sure, how much better."""

import math

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.identify import result
from puma_sim_core.identify.report.json import STAGES
from puma_sim_core.identify.report.text import PART_WORDS, is_augmented, shown_part
from puma_sim_core.identify.settings import REPORT
from puma_sim_core.pages.text import number, place, scale, unit_text

#: the verdicts in a word or two
BADGES = {
    result.NOTHING_MISSING: "Nothing missing",
    result.NAMED: "Named",
    result.NAMED_WITH_REMAINDER: "Named, with a remainder",
    result.UNNAMED: "Something without a name",
    result.DATA_FAULT: "Fault in the data",
}


def ties(e: result.Explanation) -> list[result.Hypothesis]:
    """What the record cannot tell from the effects found."""
    return [each for effect in e.effects for each in effect.tied_with]


def rivals(e: result.Explanation) -> list[result.Ranked]:
    """Hypotheses that may be named and could stand in for what was found, the nearest first; where nothing was found,
    all that may be, the best first. Without ties, and without those that contain an effect found."""
    if not e.effects:
        others = [each for each in e.ranking if each.possible and math.isfinite(each.evidence)]
        return sorted(others, key=lambda each: -each.evidence)
    tied = {(each.name, each.joint) for each in ties(e)}
    others = [
        each
        for each in e.ranking
        if each.possible
        and each.against is not None
        and math.isfinite(each.evidence)
        and (each.name, each.joint) not in tied
        and not (each.name in KINDS and each.against.name in KINDS[each.name].special_cases)
    ]
    return sorted(others, key=lambda each: lead(e, each))


def lead(e: result.Explanation, rival: result.Ranked) -> float:
    """Evidence by which an effect is ahead of one that could stand in for it [nat]."""
    return (
        next(each.evidence for each in e.effects if result.Hypothesis(each.name, each.joint) == rival.against)
        - rival.evidence
    )


def told_next(e: result.Explanation) -> bool:
    """Whether the next experiment tells apart all that is tied."""
    offered = () if e.next_experiment is None else e.next_experiment.separate
    tied = [result.Hypothesis(effect.name, effect.joint) for effect in e.effects if effect.tied_with]
    return {*tied, *ties(e)} <= set(offered)


def is_feigned(e: result.Explanation) -> bool:
    """Whether feedback in the recording can feign an effect found."""
    return (
        e.feedback_bias is not None and e.feedback_bias.biased and any(KINDS[each.name].feigned for each in e.effects)
    )


def improvement(e: result.Explanation) -> tuple[str, list[tuple[str, float, str]], str] | None:
    """(headline, meters, what they show) of the error before and after; a meter is stage, share [%] and number."""
    part = shown_part(e)
    if part is None:
        return _of_link_side(e) if e.link_side else None
    joint = e.effects[0].joint if e.effects else e.shape.joint if e.shape is not None else None
    what, base, values = "Open-loop position error", e.position_unit, _stages(e.errors[part].position_rms, joint)
    if not math.isfinite(values["retuned"]):
        what, base, values = "Residual", e.voltage_unit, _stages(e.errors[part].voltage_rms, joint)
    added = is_augmented(e)
    if not added:
        del values["augmented"]
    factor, unit = scale(values.values(), base)
    largest = max(filter(math.isfinite, values.values()), default=1.0) or 1.0
    meters = [
        (name, 100.0 * value / largest if math.isfinite(value) else 0.0, number(value * factor))
        for name, value in values.items()
    ]
    where = "all joints" if joint is None else place(joint)
    data = PART_WORDS[part]
    note = "" if added else "; retuned only, nothing added"
    return (
        _times(values["nominal"], values["augmented" if added else "retuned"]),
        meters,
        f"{what} [{unit_text(unit)}], {where}, {data}{note}.",
    )


def _of_link_side(e: result.Explanation) -> tuple[str, list[tuple[str, float, str]], str]:
    """The same of readings of both sides of a transmission alone: root mean squares over the joints."""
    squares = np.array([(s.held_out_before**2, s.held_out_after**2, s.floor**2) for s in e.link_side]).mean(axis=0)
    values = dict(zip(("retuned", "augmented", "floor"), np.sqrt(squares).tolist()))
    factor, unit = scale(values.values(), e.position_unit)
    largest = max(values.values()) or 1.0
    meters = [(name, 100.0 * value / largest, number(value * factor)) for name, value in values.items()]
    note = f"Difference of the readings [{unit_text(unit)}], all joints, validation set."
    return _times(values["retuned"], values["augmented"]), meters, note


def _times(before: float, after: float) -> str:
    if not (0.0 < before < math.inf and 0.0 < after < math.inf):
        return "Error before and after"
    ratio = before / after
    if ratio >= REPORT.changed:
        return f"Error {number(ratio, 2)} times smaller"
    return "Error unchanged" if ratio > 1.0 / REPORT.changed else f"Error {number(1.0 / ratio, 2)} times larger"


def _stages(errors: result.StageErrors, joint: int | None) -> dict[str, float]:
    """Errors of one joint, or the root mean square of all that are finite."""
    found = {}
    for name in STAGES:
        values = np.atleast_1d(np.asarray(getattr(errors, name), dtype=float))
        if joint is not None and joint <= values.size:
            values = values[joint - 1 : joint]
        values = values[np.isfinite(values)]
        found[name] = float(np.sqrt(np.mean(values**2))) if values.size else math.nan
    return found
