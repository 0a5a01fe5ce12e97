# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What to record next: the tie to break, or the effect to bring out, and the command for it."""

import shlex
from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.experiment.excitation import Builder, Limits
from puma_sim_core.identify.experiment.separation import Judge, Suspect
from puma_sim_core.identify.result import Hypothesis, NextExperiment
from puma_sim_core.identify.settings import EXPERIMENT
from puma_sim_core.plant.mechanism import Mechanism


class Named(Protocol):
    """An effect on a joint (1-based; None for the whole arm), such as `Hypothesis` or `Detectable`."""

    @property
    def name(self) -> str: ...
    @property
    def joint(self) -> int | None: ...


def next_experiment(
    mechanism: Mechanism,
    ties: Iterable[Sequence[Named]],
    not_excited: Iterable[Named],
    log_name: str,
    *,
    plant: str | None = None,
    parameters: str | None = None,
    model: str | None = None,
) -> NextExperiment | None:
    """The first effects that are tied, else the first one that the log did not excite, and how to get at it.

    Parameters
    ----------
    ties : what is named with all that the log cannot tell from it, the most wanted first. What no motion shows, such as
        an impact, is left out; one that has the named effect as a special case could never be told from it.
    not_excited : what it says nothing of; those on a joint come before those of the whole arm.
    log_name : of the log, for the sentence.
    plant, parameters, model : how `explain` was called; the mechanism's name by default.

    Returns
    -------
    None where nothing is left open that a motion could show, or where volts cannot be given to all joints.
    """
    if set(mechanism.inputs) != {"voltage"}:
        return None
    found: tuple[Named, ...] = ()
    for named, *others in ties:
        told = [each for each in others if _can_be_shown(each, mechanism) and not _within(named, each)]
        if told and _can_be_shown(named, mechanism):
            found = (named, *told[: EXPERIMENT.design_suspects - 1])
            break
    else:
        wanted = [each for each in not_excited if _can_be_shown(each, mechanism)]
        for each in sorted(wanted, key=lambda each: each.joint is None):
            if _has_columns(each, mechanism):
                found = (each,)
                break
    if not found:
        return None
    separate = tuple(Hypothesis(each.name, each.joint) for each in found)
    words = ["puma-sim", "excite"]
    for option, value in (("--plant", plant or mechanism.name), ("--parameters", parameters), ("--model", model)):
        if value is not None:
            words += [option, str(value)]
    words += ["--separate", ",".join(map(label, separate)), "--out", "volts.csv"]
    return NextExperiment(_sentence(log_name, separate, mechanism.joints), separate, shlex.join(words))


def label(each: Named) -> str:
    """Such as NAME@2, as `puma-sim excite` takes it."""
    return each.name if each.joint is None else f"{each.name}@{each.joint}"


def _can_be_shown(each: Named, mechanism: Mechanism) -> bool:
    """Whether a motion brings the effect about: not an impact, nor what a mechanism cannot have."""
    kind = KINDS.get(each.name)
    return kind is not None and kind.screening is not None and kind.repeatable and mechanism.possible(each.name)


def _within(first: Named, second: Named) -> bool:
    """Whether the first is a special case of the second, on one joint: the second then explains every record of the
    first as well, and the simpler name is preferred."""
    return first.joint == second.joint and first.name in KINDS[second.name].special_cases


def _has_columns(each: Named, mechanism: Mechanism) -> bool:
    """Whether one of a few motions shows it: joint 1 of an arm bears no load of gravity."""
    builder = Builder(mechanism, Limits.of(mechanism), EXPERIMENT.offer_seconds)
    judge, rng = Judge(builder, (Suspect(KINDS[each.name], each.joint),)), np.random.default_rng(0)
    wanted = frozenset(range(mechanism.joints))
    motions = (builder.plain(), *(builder.random(rng, wanted) for _ in range(EXPERIMENT.offer_looks)))
    return any(sum(judge.columns(motion)) for motion in motions)


def _sentence(log_name: str, separate: tuple[Hypothesis, ...], joints: int) -> str:
    names = [_words(each, joints) for each in separate]
    needs = dict.fromkeys(s.excitation for each in separate if (s := KINDS[each.name].screening) is not None)
    lower = " And: ".join(_lower(need) for need in needs)
    if len(separate) == 1:
        what = f"{log_name} could not have shown {names[0]}. What shows it: {lower}"
    else:
        told = [reason for each in separate[1:] if (reason := _told_apart(separate[0], each))]
        why = f": {'; '.join(told)}" if told else ""
        others = " and ".join(filter(None, (", ".join(names[1:-1]), names[-1])))
        what = f"{log_name} cannot tell {names[0]} from {others}{why}. What tells them apart: {lower}"
    return (
        f"{what} The command writes voltages for that; start at rest in the pose that the file names, record, and "
        "explain both logs together."
    )


def _told_apart(first: Hypothesis, second: Hypothesis) -> str | None:
    """What the library says of the difference, from the side of one of the two."""
    for one, other in ((first, second), (second, first)):
        told = KINDS[one.name].told_from(KINDS[other.name].first)
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
