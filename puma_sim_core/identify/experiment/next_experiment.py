# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What to record next: the tie to break, or the effect to bring out, and the command for it."""

from __future__ import annotations

import shlex
from collections.abc import Iterable

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.experiment.excitation import Builder, Limits
from puma_sim_core.identify.experiment.separation import Judge, Suspect
from puma_sim_core.identify.result import Hypothesis, NextExperiment
from puma_sim_core.identify.settings import EXPERIMENT
from puma_sim_core.plant.mechanism import Mechanism


def next_experiment(
    mechanism: Mechanism,
    ties: Iterable[tuple],
    not_excited: Iterable,
    log_name: str,
    *,
    plant: str | None = None,
    parameters: str | None = None,
    model: str | None = None,
) -> NextExperiment | None:
    """The first tie, else the first effect that the log did not excite, and how to get at it.

    Parameters
    ----------
    ties : pairs of what is named and what the log cannot tell from it, each with `name` and
        `joint` (1-based; None for the whole arm), such as `Hypothesis`; the most wanted first.
        Where the second has the first as a special case no record could tell, and none is asked
        for.
    not_excited : what it says nothing of, such as `Hypothesis` or `Detectable`; those on a joint
        come before those of the whole arm.
    log_name : of the log, for the sentence.
    plant, parameters, model : how `explain` was called; the mechanism's name by default.

    Returns
    -------
    None where nothing is left open that a motion could show.
    """
    source = [("--plant", plant or mechanism.name), ("--parameters", parameters), ("--model", model)]
    for first, second in ties:
        if _can_be_shown(first, mechanism) and _can_be_shown(second, mechanism) and not _within(first, second):
            return _made(mechanism, source, log_name, _hypothesis(first), _hypothesis(second))
    wanted = [each for each in not_excited if _can_be_shown(each, mechanism)]
    for each in sorted(wanted, key=lambda each: each.joint is None):
        if _has_columns(each, mechanism):
            return _made(mechanism, source, log_name, _hypothesis(each))
    return None


def label(each) -> str:
    """Such as NAME@2, as `puma-sim excite` takes it."""
    return each.name if each.joint is None else f"{each.name}@{each.joint}"


def _hypothesis(each) -> Hypothesis:
    return Hypothesis(each.name, each.joint)


def _can_be_shown(each, mechanism: Mechanism) -> bool:
    """Whether a motion brings the effect out: a blow is none, nor what a mechanism cannot have."""
    kind = KINDS.get(each.name)
    return kind is not None and kind.screening is not None and kind.repeatable and mechanism.possible(each.name)


def _within(first, second) -> bool:
    """Whether the first is a special case of the second, on one joint: then every record that the
    first explains, the second explains as well, and the simpler name stands."""
    return first.joint == second.joint and first.name in KINDS[second.name].contains


def _has_columns(each, mechanism: Mechanism) -> bool:
    """Whether one of a few motions brings it out: joint 1 of an arm bears no load of gravity."""
    builder = Builder(mechanism, Limits.of(mechanism), EXPERIMENT.offer_seconds)
    suspect = Suspect(KINDS[each.name], None if each.joint is None else each.joint - 1)
    judge, rng = Judge(builder, (suspect,)), np.random.default_rng(0)
    wanted = frozenset(range(mechanism.joints))
    return any(
        judge.shown(0, motion)
        for motion in (builder.plain(), *(builder.random(rng, wanted) for _ in range(EXPERIMENT.offer_looks)))
    )


def _made(mechanism, source, log_name: str, first: Hypothesis, second: Hypothesis | None = None) -> NextExperiment:
    joints = mechanism.joints
    if second is None:
        need = KINDS[first.name].screening.excitation
        sentence = f"{log_name} could not have shown {_words(first, joints)}. What shows it: {_lower(need)}"
        separate = (first,)
    else:
        sentence = f"{log_name} cannot tell {_words(first, joints)} from {_words(second, joints)}"
        told = _told_apart(first, second)
        sentence += f": {told}. " if told else ". "
        needs = dict.fromkeys(KINDS[each.name].screening.excitation for each in (first, second))
        sentence += "What tells them apart: " + " And: ".join(_lower(need) for need in needs)
        separate = (first, second)
    sentence += (
        " The command writes voltages for that; start at rest in the pose that the file "
        "names, record, and explain both logs together."
    )
    words = ["puma-sim", "excite"]
    for option, value in source:
        if value is not None:
            words += [option, str(value)]
    words += ["--separate", ",".join(label(each) for each in separate), "--out", "volts.csv"]
    return NextExperiment(sentence, separate, shlex.join(words))


def _told_apart(first: Hypothesis, second: Hypothesis) -> str | None:
    """What the library says of the difference, from the side of one of the two."""
    for one, other in ((first, second), (second, first)):
        told = KINDS[one.name].told_from(other.name)
        if told is not None:
            return f"of {one.name.replace('_', ' ')}, {told}"
    return None


def _words(each: Hypothesis, joints: int) -> str:
    name = each.name.replace("_", " ")
    return name if each.joint is None or joints == 1 else f"{name} on joint {each.joint}"


def _lower(sentence: str) -> str:
    """A sentence as it stands behind a colon."""
    second = sentence[1:2]
    return sentence if second.isupper() or second == " " else sentence[0].lower() + sentence[1:]
