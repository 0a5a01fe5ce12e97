# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a name needs: by chance, of its own kind, in two noises, beside a first effect."""

from __future__ import annotations

from dataclasses import replace
from statistics import NormalDist
from types import SimpleNamespace

import numpy as np
import pytest
from test_loop_choice import CHOOSER, A, B, elimination, fitted, state_of, trial, worse_by

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.screening.surrogates import level
from puma_sim_core.identify.selection.asked import in_both
from puma_sim_core.identify.selection.selection import Selection
from puma_sim_core.identify.selection.state import Chosen, Stage, Threshold
from puma_sim_core.identify.settings import FITTING, SELECTION
from puma_sim_core.identify.standing import standings
from puma_sim_core.plant.mechanism_file import load_mechanism


@pytest.mark.parametrize(
    "gains, threshold, others, other, named",
    [
        ((30.0, 20.0), 16.0, (25.0, 40.0), 16.0, (True, True)),
        # not above what chance gives in the first noise, in the second, in either
        ((5000.0, 12000.0), 9000.0, (1600.0, 1500.0), 16.0, (False, True)),
        ((1600.0, 1500.0), 16.0, (5000.0, 12000.0), 9000.0, (False, True)),
        ((5000.0, 12000.0), 9000.0, (10.0, 17.0), 16.0, (False, True)),
        # all that is tried in one noise alone is judged there
        ((12000.0, 8000.0), 9000.0, (), 16.0, (True, False)),
    ],
)
def test_a_gain_in_two_noises_is_one_that_holds_in_both(gains, threshold, others, other, named):
    def trials(values):
        return tuple(trial(key, gain) for key, gain in zip((A, B), values))

    found, least = in_both(trials(gains), Threshold.alike(threshold), trials(others), Threshold.alike(other))
    assert least == Threshold.alike(min(threshold, other))
    for one, own, value, is_named in zip(found, gains, (*others, np.inf, np.inf), named):
        assert (one.gain > least.of(one.key)) == is_named
        assert one.gain <= min(own, value)


def choosing(threshold):
    """Decides by a threshold alone."""
    return SimpleNamespace(
        _threshold=lambda state: threshold,
        _parsimonious=lambda best, trials: best,
        _beside=lambda state, trial: True,
        _in_place=lambda trial, best: True,
        _common=lambda accepted, passing: accepted,
        _first_friction=lambda stage: None,
    )


@pytest.mark.parametrize(
    "gain, validation_gain, named",
    [(30.0, 10.0, True), (15.0, 10.0, False), (30.0, -1.0, False), (30.0, FITTING.untried, True), (20.0, 1.5, False)],
)
def test_a_further_name_needs_what_chance_and_misfit_ask_whatever_the_first_one_gained(gain, validation_gain, named):
    """A limit that the drive is held at gains hundreds of thousands of nat, since the model without it is far off; a
    payload beside it has what its inertia and weight show."""
    first = trial(("current_limit", 3), 284632.0)
    further = trial(("payload", None), gain, validation_gain=validation_gain)
    state = state_of([Stage((first,), Threshold.alike(48.0), fitted(), first)], first)
    asked = Threshold.alike(SELECTION.least_gain)
    chooser = choosing(asked)
    stage = Selection.decide(chooser, replace(state, trials=(further,))).history[-1]
    assert (stage.accepted is not None) == named
    untried = replace(further, validation_gain=FITTING.untried)
    assert (stage.needed(first), stage.needed(untried)) == (SELECTION.least_gain, SELECTION.least_untried)
    # as the first of a pair, too
    assert stage.needed(trial(("joint_elasticity", 1), gain)) == SELECTION.least_two_mass


def test_dry_friction_needs_what_chance_gives_it_and_others_what_it_gives_them():
    """An error of the transmission follows a short shock anywhere: friction is not asked for as much."""
    chance = Threshold(dry=20.0, other=100.0)
    friction, ripple = trial(A, 60.0), trial(("transmission_error", 1), 70.0)
    chooser = choosing(chance)
    stage = Selection.decide(chooser, replace(state_of([]), trials=(friction, ripple))).history[-1]
    assert stage.accepted.key == A and (stage.needed(friction), stage.needed(ripple)) == (20.0, 100.0)
    assert (
        not Selection.decide(chooser, replace(state_of([]), trials=(replace(friction, gain=19.0),)))
        .history[-1]
        .accepted
    )


def test_each_of_the_two_kinds_of_effects_has_half_of_the_probability():
    """Each needs what chance gives the greatest of its kind, with half of the probability that it may have in all; dry
    friction that is common, with that half on joints that have none."""
    rng = np.random.default_rng(2)
    drawn = {}

    def gains(pairs):
        return drawn.setdefault(pairs, rng.exponential(3.0, 24))

    placebos = SimpleNamespace(gains=gains)
    causal = SimpleNamespace(placebos=lambda shifts: placebos, pairs=lambda kind, joint: (kind.name, joint))
    library = {name: KINDS[name] for name in ("coulomb_friction", "torque_ripple", "joint_spring")}
    mechanism = load_mechanism("puma560")
    chooser = SimpleNamespace(shifts=None, library=library, mechanism=mechanism)
    found = Selection._chance(chooser, replace(state_of([]), chosen=()), causal)
    dry = np.max([drawn["coulomb_friction", joint] for joint in (1, 2, 3)], axis=0)
    other = np.max([values for (name, _), values in drawn.items() if name != "coulomb_friction"], axis=0)
    half = 0.5 * SELECTION.surrogate_level
    without = 1.0 / (1.0 + SELECTION.dry_odds)
    assert found == Threshold(level(dry, half / without), level(other, half), varying=level(dry, half))
    assert found.dry < found.varying


def with_friction(threshold, beside=True):
    """Decides by a threshold and by the share of the best gain, and takes the first dry friction of a joint."""
    chooser = choosing(threshold)
    chooser.library = KINDS
    chooser._beside = lambda state, trial: beside
    chooser._in_place = lambda trial, best: Selection._in_place(chooser, trial, best)
    chooser._first_friction = lambda stage: Selection._first_friction(chooser, stage)
    return chooser


def test_the_first_dry_friction_needs_no_more_than_chance_gives_and_its_odds_ask_for():
    """All but every drive has it: 6 nat are a name where chance gives 4, whatever else gains more and is none."""
    friction, offset = (
        replace(trial((name, 1), gain), fitted=fitted())
        for name, gain in (("load_dependent_friction", 6.0), ("voltage_offset", 15.5))
    )
    asked = Threshold(dry=4.0, other=16.0)
    start = replace(state_of([]), trials=(offset, friction))
    assert Selection.decide(with_friction(asked), start).history[-1].accepted == friction
    # not below what chance gives, nor where it is not better than none by its own standard errors
    assert Selection.decide(with_friction(replace(asked, dry=7.0)), start).history[-1].accepted is None
    assert Selection.decide(with_friction(asked, beside=False), start).history[-1].accepted is None
    # nor friction that varies, of which one level has nothing
    varying = replace(friction, scored=replace(friction.scored, name="position_dependent_friction"))
    for gain, accepted in ((6.0, None), (17.0, "position_dependent_friction")):
        trials = (offset, replace(varying, gain=gain))
        found = Selection.decide(with_friction(asked), replace(start, trials=trials)).history[-1].accepted
        assert (found and found.name) == accepted
    # nor as the second of its joint
    second = replace(asked, rubbing=frozenset({1}))
    assert Selection.decide(with_friction(second), start).history[-1].accepted is None
    # what may be named goes first
    named = replace(start, trials=(replace(offset, gain=40.0), friction))
    assert Selection.decide(with_friction(asked), named).history[-1].accepted.name == "voltage_offset"


def test_that_nothing_is_missing_is_refuted_by_the_gain_of_a_name_alone():
    """Friction of a size that no machine has, by a few nat, speaks of nothing."""
    problem = "it would need an impossible value: coefficient 3, more than any machine has"
    friction = replace(trial(("load_dependent_friction", 1), 6.0), problem=problem, fitted=fitted())
    for gain, refutes in ((6.0, False), (17.0, True)):
        state = replace(state_of([]), trials=(replace(friction, gain=gain),))
        stage = Selection.decide(with_friction(Threshold(dry=4.0, other=16.0)), state).history[-1]
        assert (stage.refuting is not None) == refutes and stage.accepted is None


def test_what_the_first_friction_needs_is_asked_of_chance_where_a_trial_may_be_it():
    """Else the surrogates are not screened: they take as long as a stage's screening."""
    kinds = SimpleNamespace(library=KINDS)
    for one, may in (
        (trial(A, SELECTION.least_dry + 0.1), True),
        (trial(A, SELECTION.least_dry - 0.1), False),
        (trial(("voltage_offset", 1), 15.0), False),
        (trial(("stribeck_friction", 1), 15.0), False),
    ):
        state = replace(state_of([]), trials=(replace(one, fitted=fitted()),))
        assert Selection._may_rub(kinds, state) == may
    # not where the joint has some
    held = state_of([Stage((trial(A, 40.0),), Threshold.alike(16.0), fitted(), trial(A, 40.0))], trial(A, 40.0))
    assert not Selection._may_rub(kinds, replace(held, trials=(replace(trial(A, 5.0), fitted=fitted()),)))


def test_friction_that_entered_with_little_need_not_gain_more_later():
    """Beside what was found later it needs what chance gave in its stage; one that entered with more, a name's gain."""
    full, bare = worse_by(0.0), worse_by(9.0)
    found = SimpleNamespace(full=full, bare=bare, gain=9.0, dispersion=1.0)
    judge = elimination(SimpleNamespace(predictor=CHOOSER.predictor))
    for entered, chance, stays in ((8.0, 5.0, True), (8.0, 10.0, False), (100.0, 5.0, False)):
        stage = Stage((), Threshold(dry=chance, other=16.0), fitted())
        chosen = Chosen(A, 0.0, stage, entered)
        assert judge._asked_for(replace(state_of([]), chosen=(chosen,)), chosen, found) is stays


@pytest.mark.parametrize("gain, taken", [(4.0, True), (-1.0, False)])
def test_friction_asked_for_beside_what_is_no_name_is_named_by_itself(gain, taken):
    """An elasticity of 1.6 standard errors is none; the log asks for friction beside it, and has some without it."""
    alone, elasticity = replace(trial(A, gain), fitted=fitted(A)), trial(("joint_elasticity", 1), 38.8)
    last = Stage((elasticity, alone), Threshold(dry=6.0, other=16.0), fitted(), None)
    found = replace(trial(A, 33.8), fitted=fitted(("joint_elasticity", 1), A))
    beside = Stage((found,), Threshold(dry=5.0, other=40.0), fitted(), found)
    chooser = SimpleNamespace(add=lambda state: Selection.add(None, state))
    state = Selection._rubbing(chooser, state_of([last]), beside)
    assert (state is not None) == taken
    if state is not None:
        assert state.keys == (A,) and state.chosen[0].gain == 33.8 and state.model == alone.fitted
    # what is no dry friction, or not the first of its joint, is not taken
    offset = replace(found, scored=replace(found.scored, name="voltage_offset"))
    assert Selection._rubbing(chooser, state_of([last]), replace(beside, accepted=offset)) is None
    second = replace(last, threshold=replace(last.threshold, rubbing=frozenset({1})))
    assert Selection._rubbing(chooser, state_of([second]), beside) is None


@pytest.mark.parametrize("less, wanted", [(7.9, "coulomb_friction"), (8.1, "voltage_dead_band")])
def test_dry_friction_goes_before_what_is_not_clearly_better_on_its_joint(less, wanted):
    """All but every drive has it; what a log cannot tell from it is reported as tied."""
    band = replace(trial(("voltage_dead_band", 2), 100.0), fitted=worse_by(0.0))
    friction = replace(trial(("coulomb_friction", 2), 100.0 - less), fitted=worse_by(less))
    chooser = SimpleNamespace(library=KINDS, predictor=CHOOSER.predictor, _parsimonious=lambda best, trials: best)
    assert Selection._common(chooser, band, [band, friction]).name == wanted
    # not that of another joint, nor before other friction, nor before a push, which stood out beside it
    elsewhere = replace(friction, scored=replace(friction.scored, joint=1))
    assert Selection._common(chooser, band, [band, elsewhere]) is band
    for name in ("stribeck_friction", "impulse"):
        other = replace(trial((name, 2), 100.0), fitted=worse_by(0.0))
        assert Selection._common(chooser, other, [other, friction]) is other


@pytest.mark.parametrize("name, gain, stays", [("coulomb_friction", 20.0, True), ("voltage_dead_band", 20.0, False)])
def test_beside_others_friction_is_judged_in_its_own_direction(name, gain, stays):
    """A dispersion of six asks of 20 nat what 3.3 would be in a true model; where the misfit lies in other directions,
    friction has 20 nat by 3.2 standard errors."""
    full, bare = worse_by(0.0), worse_by(gain)
    found = SimpleNamespace(full=full, bare=bare, gain=gain, dispersion=6.0)
    chosen = Chosen((name, 1), 0.0, None, gain)
    state = replace(state_of([]), chosen=(chosen,))
    judge = elimination(SimpleNamespace(predictor=CHOOSER.predictor))
    assert judge._asked_for(state, chosen, found) is stays
    # no gain that chance gives
    few = SimpleNamespace(full=full, bare=worse_by(15.0), gain=15.0, dispersion=1.0)
    assert not judge._asked_for(state, chosen, few)
    # a second dry friction of a joint is no more common than anything else
    second = replace(state, chosen=(chosen, replace(chosen, key=("load_dependent_friction", 1))))
    assert not judge._asked_for(second, chosen, found)
    added = replace(trial((name, 1), gain), fitted=full)
    chooser = SimpleNamespace(library=KINDS, predictor=CHOOSER.predictor)
    errors = SELECTION.dry_errors if stays else SELECTION.name_errors
    with_one = replace(state_of([]), model=worse_by(1.96 * errors**2), chosen=(replace(chosen, key=B),))
    assert not Selection._beside(chooser, with_one, added)
    assert Selection._beside(chooser, replace(with_one, model=worse_by(2.04 * errors**2)), added)
    # the first of a log takes up misfit itself, which all but every drive's friction is a part of; by a name's gain
    assert Selection._beside(chooser, replace(with_one, chosen=()), added) is (name == "coulomb_friction")


def test_what_nearly_every_joint_has_needs_the_same_probability_from_the_log_and_from_machines():
    """Ten to one that a joint has dry friction (nine of nine, and Laplace's rule), times the odds of the log."""

    def odds(errors):
        return NormalDist().cdf(errors) / NormalDist().cdf(-errors)

    assert 10.0 * odds(SELECTION.dry_errors) == pytest.approx(odds(SELECTION.standard_errors), rel=0.01)
    # in a true model the square of a standard error is twice the gain, so that 8 nat are two of them
    assert SELECTION.least_dry > 2.0 * SELECTION.dry_errors**2
    assert SELECTION.least_gain == pytest.approx(2.0 * SELECTION.name_errors**2)


@pytest.mark.parametrize("chosen", [(), (A,)])
def test_what_not_every_drive_has_needs_the_standard_errors_of_the_least_gain(chosen):
    """In a true model a gain is half the square of its standard error; what the model misfits adds to that."""
    state = replace(state_of([]), chosen=tuple(Chosen(key, 0.0, None, 50.0) for key in chosen))
    chooser = SimpleNamespace(library=KINDS, predictor=CHOOSER.predictor)

    def stays(key, less):
        one = replace(trial(key, 50.0), fitted=worse_by(0.0))
        return Selection._beside(chooser, replace(state, model=worse_by(less)), one)

    less, more = SELECTION.least_gain - 0.1, SELECTION.least_gain + 0.1
    assert (stays(B, less), stays(B, more)) == (False, True)
    second = ("load_dependent_friction", A[1])
    assert (stays(second, less), stays(second, more)) == (not chosen, True)


def test_the_first_dry_friction_of_a_joint_acts_wherever_it_moves():
    """Where the validation set says nothing of a name it needs more, but for that."""
    stage = Stage((), Threshold.alike(SELECTION.least_gain), fitted())
    untried = {"validation_gain": FITTING.untried}
    needed = [stage.needed(trial((name, 1), 20.0, **untried)) for name in ("coulomb_friction", "soft_stop")]
    assert needed == [SELECTION.least_gain, SELECTION.least_untried]
    rubbing = replace(stage, threshold=replace(stage.threshold, rubbing=frozenset({1})))
    assert rubbing.needed(trial(("stribeck_friction", 1), 20.0, **untried)) == SELECTION.least_untried


@pytest.mark.parametrize(
    "gain, eased, asked",
    [
        # priors that give 18 nat less an Occam factor of 3, where a name needs 16
        (17.5, 20.0, SELECTION.least_gain),
        (17.5, 18.0, SELECTION.least_untried),
        # rows that lose some of it again
        (15.0, 20.0, SELECTION.least_untried),
        (30.0, 0.0, SELECTION.least_untried),
    ],
)
def test_of_what_the_priors_ask_for_no_rows_say_anything(gain, eased, asked):
    """Seen on a payload of 1.5 kg that links of other masses could replace, 4.9 deviations of their priors away."""
    stage = Stage((), Threshold.alike(SELECTION.least_gain), fitted())
    payload = replace(trial(("payload", None), gain, validation_gain=FITTING.untried), eased=eased)
    assert stage.needed(payload) == asked
    assert stage.by_priors(payload) is (asked == SELECTION.least_gain)
    # nor is it theirs where the rows ask for as much
    assert not stage.by_priors(replace(payload, gain=gain + SELECTION.least_gain + 3.0))
    # where the validation set says something of it, that is heard
    assert stage.needed(replace(payload, validation_gain=9.0)) == SELECTION.least_gain


def test_what_the_best_contains_may_stand_where_that_does_not_pass():
    """Anything else in its place must gain nearly as much."""
    best = trial(("position_dependent_friction", 1), 50.0)
    share = SELECTION.replacement_share * best.gain
    places = [("coulomb_friction", 1), ("coulomb_friction", 2), ("voltage_dead_band", 1)]
    chooser = SimpleNamespace(library=KINDS)
    assert [Selection._in_place(chooser, trial(key, share - 0.1), best) for key in places] == [True, False, False]
    assert all(Selection._in_place(chooser, trial(key, share + 0.1), best) for key in places)


def test_the_first_dry_friction_of_a_joint_needs_less():
    asked = Threshold(dry=20.0, other=100.0, rubbing=frozenset({2}))
    assert [asked.of(("coulomb_friction", joint)) for joint in (1, 2)] == [20.0, 100.0]
    # where it varies it needs more
    varying = replace(asked, varying=30.0)
    assert [varying.of((name, 1)) for name in ("coulomb_friction", "stribeck_friction")] == [20.0, 30.0]
    assert varying.least(replace(asked, varying=25.0)).varying == 25.0
    assert asked.of(("voltage_dead_band", 1)) == 100.0
    assert asked.least(Threshold(16.0, 120.0)) == Threshold(16.0, 100.0, frozenset({2}))


def test_friction_that_is_not_clearly_better_is_not_named_and_the_report_says_so():
    friction = replace(trial(A, 60.0), fitted=fitted())
    chooser = choosing(Threshold.alike(SELECTION.least_gain))
    chooser._beside = lambda state, one: one.key != A
    state = Selection.decide(chooser, replace(state_of([]), trials=(friction,)))
    assert state.history[-1].accepted is None and state.history[-1].unclear == {A}
    (row,) = standings(state, lambda one, other: True)
    assert row.key == A and row.verdict.startswith("not clearly better than the model without it")
