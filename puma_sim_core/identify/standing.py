# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How each hypothesis stands beside what was found: the one evidence that text, tables and files give.

The evidence of an effect that is named is its gain over the model without it. A hypothesis that could stand in its
place, on its joint or of the whole arm, is compared with it in the stage that accepted it, and has the evidence that it
would have there. Any other one has the gain that it would add to the last model in which it was tried.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.fitting.dispersion import errors_between
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.result import Hypothesis, Ranked, RuledOut
from puma_sim_core.identify.screening.evidence import Key
from puma_sim_core.identify.selection.state import Chosen, SelectionState, Stage
from puma_sim_core.identify.settings import FITTING, SELECTION
from puma_sim_core.pages.text import effect_name

NAMED, TIED = "named", "tied"

#: whether the first trial of a stage fits better than the second by more than so many standard errors
Better = Callable[[Trial, Trial, float], bool]


@dataclass(frozen=True)
class Standing:
    """One hypothesis.

    evidence [nat] : NaN where it was tried in another model than what it is compared with; verdict : "named", "tied",
    or why it is neither; against : the effect that it could stand in for, None without; possible : whether its fit
    has sizes that a machine may have; trial : its fit.
    """

    key: Key
    evidence: float
    verdict: str
    against: Key | None
    possible: bool
    trial: Trial


def standings(state: SelectionState, better: Better) -> tuple[Standing, ...]:
    """Those of all hypotheses that were tried, the greatest evidence first."""
    rows = [Standing(c.key, float(c.gain), NAMED, None, True, c.trial) for c in state.chosen]
    last = {trial.key: (stage, trial) for stage in state.history for trial in state.others(stage)}
    rows += [_in_place(state, key, better) or _added(state, *tried) for key, tried in last.items()]
    return tuple(sorted(rows, key=lambda row: (math.isnan(row.evidence), -row.evidence)))


def ranking(rows: tuple[Standing, ...]) -> tuple[Ranked, ...]:
    """The rows of a report's ranking."""
    return tuple(
        Ranked(
            *row.key, row.evidence, row.verdict, None if row.against is None else Hypothesis(*row.against), row.possible
        )
        for row in rows
    )


def ties(rows: tuple[Standing, ...], key: Key) -> tuple[Hypothesis, ...]:
    """What the log cannot tell from an effect."""
    return tuple(Hypothesis(*row.key) for row in rows if row.against == key and row.verdict == TIED)


def ruled_out(rows: tuple[Standing, ...], key: Key) -> tuple[RuledOut, ...]:
    """What could stand in for an effect, and why it does not; look-alikes that were not tried come last."""
    out = [RuledOut(*row.key, row.verdict) for row in rows if row.against == key and row.verdict != TIED]
    seen = {row.key for row in rows}
    for other, text, _ in KINDS[key[0]].look_alikes:
        if other in KINDS and (own := (other, key[1] if KINDS[other].per_joint else None)) not in seen:
            out.append(RuledOut(*own, f"the screening gave it no evidence; {text}"))
    return tuple(out)


def _in_place(state: SelectionState, key: Key, better: Better) -> Standing | None:
    """A hypothesis in the place of the effect that it comes nearest to; None where it could take that of none."""
    found = [
        (row, _on_one_joint(chosen.key, key))
        for chosen in state.chosen
        for trial in state.others(chosen.stage)
        if trial.key == key
        for row in [_beside(chosen, trial, better)]
        if _on_one_joint(chosen.key, key) or row.verdict == TIED
    ]
    # -inf: what was replaced is nearest to what replaced it
    order = [
        (row.verdict != TIED, not same, -row.evidence if math.isfinite(row.evidence) else -math.inf)
        for row, same in found
    ]
    return found[order.index(min(order))][0] if found else None


def better_by(predictor: Predictor, one: Trial, other: Trial, errors: float) -> bool:
    """Whether one of two trials of a stage fits better by more than so many standard errors, in its noise."""
    return errors_between(predictor, one.model, other.model) > errors


def tied(
    named: Trial, other: Trial, better: Better, errors: float = SELECTION.standard_errors, contains: bool = False
) -> bool:
    """Whether the log cannot tell an effect of a stage from another one.

    errors : by how many standard errors the one that is named must fit better; contains : whether it contains the
    other: then these decided that it was named, and its evidence says no more of the two.
    """
    less, more = sorted((named, other), key=lambda t: t.gain)
    ahead = more is named
    errors = errors if ahead else SELECTION.standard_errors
    # of a true model a gain goes with the square of its standard errors
    nearest = max(FITTING.tie * (errors / SELECTION.standard_errors) ** 2, FITTING.tie_share * more.gain)
    near = not (contains and ahead) and more.gain - less.gain < nearest
    return near or not better(more, less, errors)


def _on_one_joint(one: Key, other: Key) -> bool:
    return one[1] == other[1] or None in (one[1], other[1])


def _beside(chosen: Chosen, trial: Trial, better: Better) -> Standing:
    """A trial of the stage that accepted an effect, or the one that the effect replaced later."""
    accepted = chosen.stage.accepted
    # what replaced another keeps that one's distances
    reference = chosen.trial if accepted is None or accepted.key == chosen.key else accepted
    evidence = float(chosen.gain - (reference.gain - trial.gain))
    if trial.key == reference.key:
        evidence = math.nan
    named = effect_name(chosen.key[0], lower=True)
    if trial.problem is not None:
        verdict = trial.problem
    elif chosen.key[0] in KINDS[trial.name].special_cases and trial.joint == chosen.key[1]:
        verdict = f"it contains {named}, which is enough"
    elif math.isnan(evidence):
        verdict = f"with all that was found in the model, {named} explains more"
    elif tied(replace(reference, gain=chosen.gain), replace(trial, gain=evidence), better, *_asked(chosen, trial)):
        verdict = TIED
    elif evidence > chosen.gain:
        other = "too little of it acts in the validation set"
        why = "it does not lower the error on the validation set" if trial.validation_gain <= 0.0 else other
        verdict = f"{evidence - chosen.gain:.0f} nat more than {named}, but {why}"
    else:
        verdict = f"lower than {named} by {chosen.gain - evidence:.0f} nat"
        told = KINDS[chosen.key[0]].told_from(KINDS[trial.name].first)
        verdict += f": {told}" if told else ""
    return Standing(trial.key, evidence, verdict, chosen.key, trial.problem is None, trial)


def _asked(chosen: Chosen, trial: Trial) -> tuple[float, bool]:
    """By how many standard errors an effect must fit better than a trial that could take its place, and whether it
    contains that one.

    The first dry friction of a joint has the odds that machines give it, beside what is none.
    """
    common = chosen.stage.threshold.rubs(chosen.key) and not KINDS[trial.name].dry
    contains = trial.name in KINDS[chosen.key[0]].special_cases and trial.joint == chosen.key[1]
    return SELECTION.dry_errors if common else SELECTION.standard_errors, contains


def _added(state: SelectionState, stage: Stage, trial: Trial) -> Standing:
    """A trial added to the model of a stage, and why it was not accepted."""
    best = stage.accepted
    if trial.problem is not None:
        verdict = trial.problem
    elif trial.key in state.retracted:
        verdict = "retracted: it does not lower the validation error, or a free curve leaves clearly less"
    elif trial.gain <= stage.threshold.of(trial.key):
        verdict = f"below the threshold of {stage.threshold.of(trial.key):.0f} nat"
    elif trial.validation_gain <= 0.0:
        verdict = "it does not lower the error on the validation set"
    elif best is not None:
        verdict = f"lower than {effect_name(best.name, lower=True)} by {best.gain - trial.gain:.0f} nat"
    elif trial.key in stage.unclear:
        verdict = "not clearly better than the model without it: what else that misfits may make as much"
    else:
        verdict = "too little of it acts in the validation set"
    return Standing(trial.key, float(trial.gain), verdict, None, trial.problem is None, trial)
