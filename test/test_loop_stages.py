# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The stages of a selection: what becomes of one whose effect came to values that no machine has, and pairs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection.selection import Selection
from puma_sim_core.identify.selection.state import Chosen, SelectionState, Threshold
from puma_sim_core.identify.settings import SELECTION

STRIBECK, COULOMB, OFFSET = ("stribeck_friction", 1), ("coulomb_friction", 1), ("voltage_offset", 1)
GAINS = {STRIBECK: 58.0, COULOMB: 46.0, OFFSET: 20.0}
WHY = "it would need an impossible value: velocity on the bound"


def model_of(chosen):
    return Fitted(Point(np.zeros(1), tuple(each.key for each in chosen)), np.zeros((4, 1)), 0.0, ())


class Stages(Selection):
    """A selection with trials of given gains, where some effects come to values that no machine has. begun : the
    effects of the model at each stage."""

    def __init__(self, wrong):
        self.library, self.begun = KINDS, []
        self.stage, self.addition, self.conclusion = (self.try_all, self.decide), (self.add,), (self.withdraw,)
        self.wrong = wrong

    def progress(self, *_):
        """Nothing is shown."""

    def _start(self, _):
        return SelectionState(model_of(()), None, None)

    def try_all(self, state):
        self.begun.append(state.keys)
        left = ((key, gain) for key, gain in GAINS.items() if key not in state.keys)
        return replace(state, trials=tuple(Trial(Scored(*key, 0.0), gain, 10.0, None, 3.0) for key, gain in left))

    def _threshold(self, _):
        return Threshold.alike(16.0)

    def _beside(self, *_):
        return True

    def _common(self, accepted, _):
        return accepted

    def _parsimonious(self, best, _):
        return best

    def add(self, state):
        chosen = (*state.chosen, Chosen.of(state.history[-1].accepted, state.history))
        return replace(state, model=model_of(chosen), chosen=chosen)

    def withdraw(self, state):
        gone = [chosen for chosen in state.chosen if chosen.key in self.wrong]
        kept = tuple(chosen for chosen in state.chosen if chosen not in gone)
        barred = (*state.barred, *((chosen.key, WHY) for chosen in gone))
        return replace(state, model=model_of(kept), chosen=kept, barred=barred)


@pytest.mark.parametrize(
    "wrong, named, begun",
    [
        ((), (STRIBECK, COULOMB, OFFSET), [0, 1, 2, 3]),
        # what stood behind it has its place, and what came after it comes again
        ((STRIBECK,), (COULOMB, OFFSET), [0, 1, 2, 3, 0, 1, 2]),
        # what came before it stays
        ((OFFSET,), (STRIBECK, COULOMB), [0, 1, 2, 3, 2]),
        ((STRIBECK, COULOMB), (OFFSET,), [0, 1, 2, 3, 0, 1]),
        ((STRIBECK, COULOMB, OFFSET), (), [0, 1, 2, 3, 0]),
    ],
)
def test_the_stage_of_an_effect_that_no_machine_has_is_made_again_without_it(wrong, named, begun):
    selection = Stages(wrong)
    ended = selection.run(np.zeros(1))
    assert ended.keys == named
    assert [len(keys) for keys in selection.begun] == begun
    assert dict(ended.barred) == dict.fromkeys(wrong, WHY)
    # its last stage has it with the reason, and none of these accepts it
    for key in wrong:
        (last,) = (t for t in ended.history[-1].trials if t.key == key)
        assert last.problem == WHY
    assert not {stage.accepted.key for stage in ended.history if stage.accepted} & set(wrong)


class Pairs(Stages):
    """Of two effects neither is asked for alone. least : gain of the better one alone; beside : what the first has
    beside the second, None where the log does not ask for it; chance : gain of the second alone, which chance gives as
    well."""

    def __init__(self, wrong=(), least=12.0, beside=40.0, chance=None):
        super().__init__(wrong)
        self.chance = chance
        self.alone = {COULOMB: least, OFFSET: chance or least - 1.0, STRIBECK: 3.0}
        self.elimination = SimpleNamespace(gain_beside=lambda state, key: beside if len(state.keys) == 2 else None)

    def try_all(self, state):
        self.begun.append(state.keys)
        gains = {COULOMB: 50.0, OFFSET: 50.0} if state.keys in ((COULOMB,), (OFFSET,)) else self.alone
        left = [(key, gain) for key, gain in gains.items() if key not in state.keys]
        tried = [Trial(Scored(*key, 0.0), gain, 10.0, model_of(state.chosen), 3.0) for key, gain in left]
        if self.chance and not state.keys:
            tried = [replace(t, problem="chance") if t.key == OFFSET else t for t in tried]
        return replace(state, trials=tuple(tried))


@pytest.mark.parametrize(
    "given, named, begun",
    [
        ({}, (COULOMB, OFFSET), [0, 1, 2]),
        # the first has no more than both have beyond the second alone: 12 + 50 less 34 or 48, where it needs 16
        ({"beside": 400.0, "chance": 34.0}, (COULOMB, OFFSET), [0, 1, 2]),
        ({"beside": 400.0, "chance": 48.0}, (), [0, 1]),
        # the log must ask for the first one beside the second, by more than the first needed alone
        ({"beside": None}, (), [0, 1]),
        ({"beside": 15.0}, (), [0, 1]),
        # what has less than two standard errors is not put into the model
        ({"least": 7.5}, (), [0]),
        # without the second one the first is not asked for: both are gone
        ({"wrong": (OFFSET,)}, (), [0, 1, 2, 0, 1]),
        ({"wrong": (COULOMB,)}, (), [0, 1, 2, 0, 1]),
    ],
)
def test_of_a_pair_none_need_be_asked_for_alone(given, named, begun):
    selection = Pairs(**given)
    ended = selection.run(np.zeros(1))
    assert ended.keys == named
    assert [len(keys) for keys in selection.begun] == begun
    accepted = [stage.accepted.key for stage in ended.history if stage.accepted]
    assert tuple(accepted) == named and len(ended.history) == len(named) + 1
    # the first one has the evidence that it has beside the second
    first = 12.0 + 50.0 - given["chance"] if "chance" in given else 40.0
    assert [chosen.gain for chosen in ended.chosen] == [first, 50.0][: len(named)]


def test_a_pair_needs_room_for_two(monkeypatch):
    selection = Pairs()
    monkeypatch.setattr("puma_sim_core.identify.selection.selection.SELECTION", replace(SELECTION, most_effects=1))
    assert selection.run(np.zeros(1)).keys == () and selection.begun == [()]
