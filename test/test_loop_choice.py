# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Rules of the choice of names: what is retracted, what counts as a tie, what a trial costs."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.loop import trials
from puma_sim_core.loop.evidence import Scored
from puma_sim_core.loop.explain import _confirmed
from puma_sim_core.loop.outcome import doubtful
from puma_sim_core.loop.prediction import Fitted, Point
from puma_sim_core.loop.selection import Selected, Selection, Stage
from puma_sim_core.loop.trials import Trial, Trials, tied

A, B = ("coulomb_friction", 1), ("impulse", 2)


def trial(key, gain, held=10.0):
    return Trial(*key, gain, held, None, 3.0)


def fitted(*names):
    return Fitted(Point(np.zeros(1), tuple(names)), np.zeros((4, 2)), 0.0, ())


@dataclass
class Chooser:
    """Takes an effect out as `Selection.without` does."""

    def without(self, selected, key):
        keys = tuple(k for k in selected.keys if k != key)
        return Selected(selected.retuned, fitted(*keys), keys, selected.stages, None, {},
                        (*selected.retracted, key))


def confirmed(errors, first, second):
    """Names that stay, and those retracted, by errors {names: position error}."""
    stages = [Stage([t], 8.0, None, [], None, t) for t in (first, second)]
    keys = (first.key, second.key)
    selected = Selected(fitted(), fitted(*keys), keys, stages, None)
    mechanism = SimpleNamespace(plant=lambda theta, effects: tuple(effects))
    validation = SimpleNamespace(
        position_rms=lambda plant, key: np.full(2, errors[frozenset(plant)]))
    found = _confirmed(Chooser(), selected, validation, mechanism)
    return found.keys, found.retracted


def errors(none, a, b, both):
    return {frozenset(): none, frozenset([A]): a, frozenset([B]): b, frozenset([A, B]): both}


def test_names_that_lower_the_error_held_out_stay():
    assert confirmed(errors(1.0, 0.7, 0.8, 0.5), trial(A, 90.0), trial(B, 30.0)) == ((A, B), ())


def test_the_weaker_name_goes_first_and_the_other_may_stay():
    assert confirmed(errors(1.0, 0.7, 0.8, 1.2), trial(A, 90.0), trial(B, 30.0)) == ((A,), (B,))
    assert confirmed(errors(1.0, 0.7, 0.8, 1.2), trial(A, 20.0), trial(B, 30.0)) == ((B,), (A,))


def test_without_a_lower_error_there_is_no_name():
    assert confirmed(errors(1.0, 1.0, 1.1, 1.2), trial(A, 90.0), trial(B, 30.0)) == ((), (B, A))


def test_a_blow_that_fell_elsewhere_need_not_lower_it():
    untried = trial(B, 30.0, held=trials._UNTOUCHED)
    assert untried.untried and not trial(B, 30.0).untried
    assert confirmed(errors(1.0, 0.9, 1.0, 1.01), trial(A, 90.0), untried) == ((A, B), ())
    assert confirmed(errors(1.0, 0.9, 1.0, 1.05), trial(A, 90.0), untried) == ((A,), (B,))


@pytest.mark.parametrize("held, windows, stays", [
    # a clear gain from row to row outweighs windows that are a little worse, the more the clearer
    (5.0, 1.001, False), (12.0, 1.019, True), (12.0, 1.021, False), (100.0, 1.09, True),
    (100.0, 1.11, False), (5000.0, 1.14, True), (5000.0, 1.16, False)])
def test_a_few_windows_say_less_than_all_rows(held, windows, stays):
    kept, _ = confirmed(errors(1.0, 0.9, 1.0, windows), trial(A, 90.0), trial(B, 30.0, held))
    assert (B in kept) is stays


@pytest.mark.parametrize("gain, left, wanted", [
    (30.0, [1.0, 1.0], False),  # little beside what was named
    (30.0, [1.0, 3.2], True),  # most of the residual is left, at the joint of the curve
    (30.0, [3.2, 1.0], False),
    (70.0, [1.0, 1.0], True),  # the curve explains nearly as much as the name
    (15.0, [1.0, 9.0], False)])  # no remainder
def test_what_is_left_puts_a_name_in_doubt(gain, left, wanted):
    curve = SimpleNamespace(scored=SimpleNamespace(gain=gain, joint=2))
    selected = SimpleNamespace(keys=(A,), gain_of=lambda key: 100.0)
    assert doubtful(selected, [curve], 0.0, np.array(left)) is wanted
    nothing = SimpleNamespace(keys=(), gain_of=lambda key: 0.0)
    assert not doubtful(nothing, [curve], 0.0, np.array(left))


@pytest.mark.parametrize("limit, wanted", [(97.5, "current_limit"), (96.0, "impulse")])
def test_a_limit_that_was_met_once_goes_before_a_blow(limit, wanted):
    chooser = SimpleNamespace(library=KINDS)
    blow, other = trial(("impulse", 2), 100.0), trial(("current_limit", 2), limit)
    elsewhere = trial(("current_limit", 1), 99.9)
    found = Selection._parsimonious(chooser, blow, [blow, other, elsewhere])
    assert found.key == (wanted, 2)


def test_without_rows_held_out_nothing_is_retracted():
    nan = float("nan")
    assert confirmed(errors(nan, nan, nan, nan), trial(A, 9.0), trial(B, 9.0)) == ((A, B), ())


@pytest.mark.parametrize("best, other, wanted", [
    (100.0, 93.0, True), (100.0, 91.0, False),
    # of much evidence a small share is no difference
    (10000.0, 9975.0, True), (10000.0, 9960.0, False)])
def test_a_tie_is_a_difference_that_the_log_cannot_show(best, other, wanted):
    assert tied(trial(A, best), trial(B, other)) is wanted


@pytest.mark.parametrize("screened, count, wanted", [
    (-2.0, 2, 3.0), (4.0, 1, 4.0), (80.0, 1, 6.0), (80.0, 3, 18.0)])
def test_a_price_is_that_of_the_screening_within_what_a_coefficient_can_cost(screened, count,
                                                                             wanted):
    scored = Scored("payload", None, 10.0, 10.0, None, None, None,
                    {str(n): 1.0 for n in range(count)}, None, screened)
    assert trials._price(scored) == wanted


def test_what_more_of_makes_less_of_an_effect_is_not_too_much():
    chooser = Trials(None, SimpleNamespace(mechanism=None, sampled=SimpleNamespace(joints=3)))
    stiff = parse_effect("joint_elasticity:joint=1,stiffness=9e5")
    soft = parse_effect("joint_elasticity:joint=1,stiffness=20")
    assert chooser.implausible(stiff) is None
    assert "stiffness 20, less than any machine has" in chooser.implausible(soft)
    heavy = parse_effect("coulomb_friction:joint=1,torque=400")
    assert "torque 400, more than any machine has" in chooser.implausible(heavy)


def test_a_spring_is_contained_in_a_stop():
    assert "joint_spring" in KINDS["soft_stop"].screening.contains
