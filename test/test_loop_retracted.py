# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What is taken back after the selection, since it does not predict better in cross-validation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest
from test_loop_choice import A, fitted, state_of, trial

from puma_sim_core.identify.explain import Stages, retracted
from puma_sim_core.identify.selection.state import Stage, Threshold

C = ("joint_spring", 2)


@dataclass
class Chooser:
    """Takes an effect out as `Selection.without` does."""

    def without(self, state, key):
        left = tuple(chosen for chosen in state.chosen if chosen.key != key)
        model = fitted(*(chosen.key for chosen in left))
        return replace(state, model=model, chosen=left, retracted=(*state.retracted, key))


def confirmed(errors, first, second, rubbing=frozenset({1})):
    """Effects that stay, and those retracted, by errors {effects: error in cross-validation}.

    rubbing : joints that have another dry friction already.
    """
    threshold = replace(Threshold.alike(8.0), rubbing=rubbing)
    state = state_of([Stage((t,), threshold, None, t) for t in (first, second)], first, second)

    def lower(model, than, noise_holds, as_good):
        assert than.fitted is state.retuned and noise_holds()
        less = errors[frozenset()] - errors[frozenset(model.fitted.point.effects)]
        return less >= 0.0 if as_good else less > 0.0

    found = retracted(Chooser(), state, SimpleNamespace(better=lower))
    return found.keys, found.retracted


def test_a_push_is_not_judged_by_other_folds():
    found = SimpleNamespace(keys=(("impulse", 1), ("impulse", 2)))
    assert Stages._noise_holds(None, found)  # nothing of the log is asked for
    with pytest.raises(AttributeError):
        Stages._noise_holds(None, SimpleNamespace(keys=(("impulse", 1), ("joint_elasticity", 1))))


def errors(none, a, b, both):
    return {frozenset(): none, frozenset([A]): a, frozenset([C]): b, frozenset([A, C]): both}


def test_effects_that_lower_the_error_in_cross_validation_stay():
    assert confirmed(errors(1.0, 0.7, 0.8, 0.5), trial(A, 90.0), trial(C, 30.0)) == ((A, C), ())


def test_the_weaker_name_goes_first_and_the_other_may_stay():
    assert confirmed(errors(1.0, 0.7, 0.8, 1.2), trial(A, 90.0), trial(C, 30.0)) == ((A,), (C,))
    assert confirmed(errors(1.0, 0.7, 0.8, 1.2), trial(A, 20.0), trial(C, 30.0)) == ((C,), (A,))


def test_without_a_lower_error_there_is_no_name():
    assert confirmed(errors(1.0, 1.0, 1.1, 1.2), trial(A, 90.0), trial(C, 30.0)) == ((), (C, A))


@pytest.mark.parametrize(
    "asked, rubbing",
    [
        (replace(trial(("payload", None), 20.0), eased=23.5), {1}),  # 20.5 nat of the priors, where a name needs 8
        (trial(A, 20.0), {2}),  # what all but every drive has
        (trial(("impulse", 1), 20.0), {1}),  # what happens once
    ],
)
def test_what_something_else_speaks_for_goes_last_and_need_not_lower_the_error(asked, rubbing):
    """A payload of 1.5 kg that links of other masses can replace was taken back by a hundredth of the error."""

    def confirmed_by(*left):
        return confirmed(dict(zip(map(frozenset, ((), (asked.key,), (C,), (asked.key, C))), left)), *both, rubbing)

    both = asked, trial(C, 30.0)
    assert confirmed_by(1.0, 1.0, 1.1, 1.0) == ((asked.key,), (C,))
    assert confirmed_by(1.0, 1.1, 1.1, 1.2) == ((), (C, asked.key))
    # beside it another one must lower the error all the same
    assert confirmed_by(1.0, 1.0, 0.9, 0.9) == ((asked.key, C), ())
