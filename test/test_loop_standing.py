# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One evidence for each effect: how hypotheses stand beside what was found, and reports that agree with themselves."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import replace

import pytest
from loop_support import EXPLANATIONS, tied
from report_checks import CHECKS, contradictions
from test_loop_choice import state_of, trial

from puma_sim_core.identify.report.answers import lead, rivals, told_next
from puma_sim_core.identify.report.json import report_text
from puma_sim_core.identify.report.tables import ranking as shown
from puma_sim_core.identify.result import Hypothesis
from puma_sim_core.identify.selection.state import Chosen, Stage, Threshold
from puma_sim_core.identify.standing import ranking, ruled_out, standings, ties
from puma_sim_core.identify.standing import tied as cannot_tell

COULOMB, ASYMMETRIC = ("coulomb_friction", 1), ("asymmetric_coulomb_friction", 1)
DEAD_BAND, SPRING, OFFSET = ("voltage_dead_band", 1), ("joint_spring", 2), ("voltage_offset", 2)
BLOW = ("impulse", 1)


def told_apart(one, other, errors):
    """Trials whose innovations show what their gains do."""
    return True


def two_effects():
    """Friction on joint 1 with 900 nat, then a spring on joint 2 with 300."""
    first = trial(COULOMB, 900.0)
    others = [trial(ASYMMETRIC, 901.0), trial(DEAD_BAND, 898.0), trial(SPRING, 40.0), trial(OFFSET, 35.0)]
    others.append(trial(("stribeck_friction", 1), 700.0))
    others.append(trial(("sensor_nonlinearity", 1), 1000.0, validation_gain=-1.0))
    others.append(replace(trial(BLOW, 950.0), problem="it would need an impossible value: width 1, more than 0.15"))
    second = trial(SPRING, 300.0)
    rest = [trial(OFFSET, 298.0), trial(DEAD_BAND, -3.0), trial(("quadratic_friction", 3), 4.0)]
    stages = (
        Stage((first, *others), Threshold.alike(16.0), None, first),
        Stage((second, *rest), Threshold.alike(16.0), None, second),
    )
    return state_of(stages, first, second)


def test_an_effect_has_its_gain_over_the_model_without_it_everywhere():
    rows = {row.key: row for row in standings(two_effects(), told_apart)}
    assert (rows[SPRING].evidence, rows[SPRING].verdict) == (300.0, "named")
    assert (rows[COULOMB].evidence, rows[COULOMB].verdict) == (900.0, "named")
    # what could stand in for an effect: its gain in that place, not beside it
    assert (rows[OFFSET].evidence, rows[OFFSET].verdict, rows[OFFSET].against) == (298.0, "tied", SPRING)
    assert (rows[DEAD_BAND].evidence, rows[DEAD_BAND].against) == (898.0, COULOMB)
    # of another joint: what it would add to all that was found
    other = rows["quadratic_friction", 3]
    assert (other.evidence, other.against) == (4.0, None) and other.verdict == "below the threshold of 16 nat"


def test_what_is_enough_is_not_tied_with_what_contains_it():
    rows = standings(two_effects(), told_apart)
    assert ties(rows, COULOMB) == (Hypothesis(*DEAD_BAND),)
    because = {(out.name, out.joint): out.because for out in ruled_out(rows, COULOMB)}
    assert because[ASYMMETRIC] == "it contains Coulomb friction, which is enough"
    # a look-alike that was never tried has no evidence
    assert because["load_dependent_friction", 1].startswith("the screening gave it no evidence")
    assert not {OFFSET, SPRING} & set(because)
    # what has more evidence, and was refused, is no tie
    refused = "100 nat more than Coulomb friction, but it does not lower the error on the validation set"
    assert because["sensor_nonlinearity", 1] == refused


@pytest.mark.parametrize(
    "best, other, wanted",
    [
        (100.0, 93.0, True),
        (100.0, 91.0, False),
        # of much evidence a small share is no difference
        (10000.0, 9975.0, True),
        (10000.0, 9960.0, False),
    ],
)
def test_a_tie_is_a_difference_that_the_log_cannot_show(best, other, wanted):
    one, two = trial(COULOMB, best), trial(DEAD_BAND, other)
    assert cannot_tell(one, two, told_apart) is cannot_tell(two, one, told_apart) is wanted


def test_what_does_not_fit_clearly_better_is_tied_however_much_its_gain():
    def clearly(one, other, errors):
        assert one.gain > other.gain and errors == 2.0
        return other.key == OFFSET

    best, near, far = trial(COULOMB, 900.0), trial(DEAD_BAND, 700.0), trial(OFFSET, 700.0)
    assert cannot_tell(best, near, clearly) and cannot_tell(near, best, clearly)
    assert not cannot_tell(best, far, clearly) and not cannot_tell(far, best, clearly)


@pytest.mark.parametrize("key, errors", [(COULOMB, 0.88), (ASYMMETRIC, 0.88), (OFFSET, 2.0)])
@pytest.mark.parametrize("rubbing", [False, True])
@pytest.mark.parametrize("nat, near", [(1.4, True), (1.7, False), (7.9, False), (8.1, False)])
def test_dry_friction_has_the_odds_of_machines_beside_what_is_none(key, errors, rubbing, nat, near):
    """The first of a joint is tied where it gains 8 nat x (0.88 / 2)^2 = 1.55 more, or fits better by 0.88 errors."""
    asked = []

    def clearly(one, other, errors):
        asked.append(errors)
        return True

    threshold = replace(Threshold.alike(16.0), rubbing=frozenset({1}) if rubbing else frozenset())
    named, rival = trial(key, 100.0), trial((DEAD_BAND[0], key[1]), 100.0 - nat)
    stage = Stage((named, rival), threshold, None, named)
    rows = standings(state_of((stage,), named), clearly)
    if rubbing or errors == 2.0:
        errors, near = 2.0, nat < 8.0
    assert (rows[1].verdict == "tied") is near and asked == ([] if near else [errors])
    # another dry friction has the same odds
    if key == COULOMB:
        stage = Stage((named, trial(("load_dependent_friction", 1), 94.0)), threshold, None, named)
        assert standings(state_of((stage,), named), clearly)[1].verdict == "tied"


def test_what_contains_another_was_named_by_its_errors():
    """Its evidence, which it has less its Occam factor, says no more of the two; that of any other does."""
    rich, simple, other = trial(ASYMMETRIC, 100.0), trial(COULOMB, 97.0), trial(("stribeck_friction", 1), 97.0)
    stage = Stage((rich, simple, other), replace(Threshold.alike(16.0), rubbing=frozenset({1})), None, rich)
    rows = {row.key: row.verdict for row in standings(state_of((stage,), rich), told_apart)}
    assert rows[COULOMB].startswith("lower than asymmetric Coulomb friction by 3 nat")
    assert rows["stribeck_friction", 1] == "tied"
    rows = {row.key: row.verdict for row in standings(state_of((stage,), rich), lambda *_: False)}
    assert rows[COULOMB] == "tied"


def test_what_replaced_another_is_compared_by_the_trial_that_was_accepted():
    """The one that replaced it may have been far behind in that stage, and is nearer in the model that was found."""
    accepted, rival = trial(DEAD_BAND, 100.0), trial(COULOMB, 60.0)
    third = trial(("torque_ripple", 1), 80.0)
    stage = Stage((accepted, third, rival), Threshold.alike(16.0), None, accepted)
    compared = []

    def clearly(one, other, errors):
        compared.append((one.key, other.key))
        return True

    standings(state_of((stage,), Chosen.of(rival, (stage,), stage, 140.0)), clearly)
    assert compared == [(DEAD_BAND, ("torque_ripple", 1))]


def test_what_no_machine_has_is_no_rival():
    e = replace(tied(), effects=tied().effects[:1], ranking=ranking(standings(two_effects(), told_apart)))
    e = replace(e, effects=(replace(e.effects[0], name="coulomb_friction", joint=1, evidence=900.0, tied_with=()),))
    found = rivals(replace(e, ranking=tuple(each for each in e.ranking if each.joint == 1)))
    assert [(each.name, lead(e, each)) for each in found] == [
        ("sensor_nonlinearity", -100.0),
        ("voltage_dead_band", 2.0),
    ]


def test_an_effect_that_replaced_another_keeps_the_distances_of_the_stage():
    accepted, rival, third = trial(DEAD_BAND, 100.0), trial(COULOMB, 95.0), trial(("torque_ripple", 1), 60.0)
    stage = Stage((accepted, rival, third), Threshold.alike(16.0), None, accepted)
    state = state_of((stage,), Chosen.of(rival, (stage,), stage, 140.0))
    rows = {row.key: row for row in standings(state, told_apart)}
    assert rows[COULOMB].evidence == 140.0
    assert math.isnan(rows[DEAD_BAND].evidence) and "Coulomb friction explains more" in rows[DEAD_BAND].verdict
    assert rows["torque_ripple", 1].evidence == 100.0


@pytest.mark.parametrize("name", EXPLANATIONS)
def test_the_examples_agree_with_themselves(name):
    assert contradictions(json.loads(report_text(EXPLANATIONS[name]()))) == []


def change_of(name: str):
    """A change of a report by which it contradicts itself, for each check."""

    def ranking_evidence(r):
        r["ranking"][0]["evidence"] += 1.0

    def not_excited(r):
        row = next(d for d in r["detectability"] if (d["name"], d["joint"]) == ("voltage_dead_band", 2))
        row["size"] = "NOT_EXCITED"

    def other_experiment(r):
        r["next_experiment"]["separate"][1]["name"] = "stribeck_friction"

    def contains(r):
        r["effects"][0]["tied_with"][0]["name"] = "asymmetric_coulomb_friction"

    def wrong_lead(r):
        row = next(each for each in r["ranking"] if each["verdict"].startswith("lower than"))
        row["verdict"] = row["verdict"].replace("by ", "by 1")

    def headline(r):
        r["sentence"] = "the residual of joint 2 falls from 0.34 to 0.0123 V"

    def shape(r):
        r["verdict"] = "UNNAMED"

    changes = (ranking_evidence, contains, wrong_lead, not_excited, other_experiment, headline, shape)
    return dict(zip((check.__name__ for check in CHECKS), changes))[name]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_each_check_finds_what_it_is_for(check):
    report = json.loads(report_text(tied()))
    changed = copy.deepcopy(report)
    change_of(check.__name__)(changed)
    assert list(check(report)) == [] and list(check(changed)) != []


def test_the_page_gives_the_numbers_of_the_ranking():
    e = tied()
    rows = {name: (kind, gain, why) for kind, name, gain, _, why in shown(e)}
    assert rows["Coulomb friction on joint\N{NO-BREAK SPACE}2"][:2] == ("named", "+1834")
    kind, gain, why = rows["Voltage dead-band on joint\N{NO-BREAK SPACE}2"]
    assert (kind, gain) == ("tied", "+1832") and "Coulomb friction" in why
    assert told_next(e) and not told_next(replace(e, next_experiment=None))
