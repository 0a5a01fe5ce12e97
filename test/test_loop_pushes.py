# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Several pushes on one joint: each has a name of its own, numbered in the order of time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from loop_logs import record

import puma_sim_core as ps
from puma_sim_core.effects import KINDS, Effect, parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify import explain
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.screening.hypotheses import open_to
from puma_sim_core.identify.selection.state import Chosen, SelectionState, Stage, Threshold
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.model_file import dump_model, load_model

PENDULUM = load_mechanism("dfki_pendulum")


def push(time, name="impulse", joint=1, torque=5.0, width=0.1):
    return Effect(KINDS[name], joint, {"torque": torque, "time": time, "width": width})


def trial(effect, gain=100.0):
    model = Fitted(Point(PENDULUM.start, (effect,)), np.zeros((1, 1)), 0.0, ())
    return Trial(Scored(effect.kind.name, effect.joint, gain, values=effect.values), gain, 1.0, model, 5.0)


def state_of(*effects):
    """A state with these effects, each accepted in a stage of its own."""
    tried = [trial(effect) for effect in effects]
    history = tuple(Stage((t,), Threshold.alike(16.0), None, t) for t in tried)
    chosen = tuple(Chosen.of(t, history) for t in tried)
    model = Fitted(Point(PENDULUM.start, effects), np.zeros((1, 1)), 0.0, ())
    return SelectionState(model, None, SimpleNamespace(), chosen, history)


def motion(*texts):
    simulator = ps.Simulator(ps.Plant.of("bejczy", [parse_effect(text) for text in texts]))
    simulator.reset(position=(0.0, -1.2, 1.0))
    return simulator.run(np.arange(0.0, 0.3, 0.028), np.zeros((11, 3))).position


ONE, OTHER = "torque=40,time=0.08,width=0.06", "torque=-60,time=0.2,width=0.05"


def test_pushes_of_one_joint_act_all_whatever_their_order():
    both = motion(f"impulse:joint=2,{ONE}", f"impulse:joint=2,{OTHER}")
    assert np.array_equal(both, motion(f"impulse:joint=2,{ONE}", f"impulse_2:joint=2,{OTHER}"))
    assert np.allclose(both, motion(f"impulse:joint=2,{OTHER}", f"impulse:joint=2,{ONE}"), rtol=0.0, atol=1e-12)
    # before the second one begins nothing of it is seen, and afterwards it is
    first = motion(f"impulse:joint=2,{ONE}")
    assert np.array_equal(both[:7], first[:7]) and not np.allclose(both[-1], first[-1], atol=1e-4)
    assert np.array_equal(first, motion(f"impulse_3:joint=2,{ONE}"))


def test_given_again_it_is_the_next_one_and_no_joint_has_more_than_there_may_be():
    most = KINDS["impulse"].most
    names = [effect.kind.name for effect in ps.Plant.of("bejczy", [push(n) for n in range(most)]).effects]
    assert names == list(KINDS["impulse"].names) == ["impulse", "impulse_2", "impulse_3", "impulse_4"]
    with pytest.raises(ParameterError, match="impulse stands too often on joint 1.*at most 4 times a joint"):
        ps.Plant.of("bejczy", [push(n) for n in range(most + 1)])
    ps.Plant.of("bejczy", [push(n, joint=joint) for n in range(most) for joint in (1, 2, 3)])
    friction = parse_effect("coulomb_friction:joint=1,torque=1")
    with pytest.raises(ParameterError, match="coulomb_friction stands twice on joint 1.*once a joint"):
        ps.Plant.of("bejczy", [friction, friction])


def test_a_model_file_keeps_them(tmp_path):
    plant = ps.Plant.of("bejczy", [push(1.0), push(2.0), push(0.5, joint=3)])
    path = tmp_path / "pushed.yaml"
    dump_model(plant, path)
    assert load_model(path).effects == plant.effects


def test_a_further_one_is_sought_where_the_one_before_is_in_the_model():
    second, third = KINDS["impulse_2"], KINDS["impulse_3"]
    assert not open_to(second, 1, ()) and not open_to(second, 1, [("impulse", 2)])
    assert open_to(second, 1, [("impulse", 1)]) and not open_to(third, 1, [("impulse", 1)])
    assert not open_to(KINDS["impulse"], 1, [("impulse", 1)]) and open_to(KINDS["impulse"], 2, [("impulse", 1)])


def test_a_trial_of_what_the_model_has_is_none_and_of_another_push_has_another_name():
    there = (push(3.0), push(5.0, joint=2), push(6.0, "impulse_2", joint=2))
    assert trial(push(3.04)).beside(there) is None
    other = trial(push(4.0)).beside(there)
    assert other.key == ("impulse_2", 1) and other.effect == push(4.0, "impulse_2")
    assert trial(push(3.0, joint=2)).beside(there).key == ("impulse_3", 2)
    assert trial(push(6.03, joint=2)).beside(there) is None
    friction = parse_effect("coulomb_friction:joint=1,torque=1")
    assert trial(friction).beside((friction,)) is None and trial(friction).beside(there).key == trial(friction).key
    full = tuple(push(float(n), name) for n, name in enumerate(KINDS["impulse"].names))
    assert trial(push(9.0)).beside(full) is None


def test_they_are_numbered_in_the_order_of_time():
    friction = parse_effect("coulomb_friction:joint=1,torque=1")
    state = state_of(push(7.0), friction, push(2.0, "impulse_3"), push(4.0, "impulse_2"), push(1.0, joint=2))
    numbered = state.numbered
    places = {key: effect.place for key, effect in zip(numbered.keys, numbered.model.point.effects)}
    assert places == {
        ("impulse_3", 1): 7.0,
        ("coulomb_friction", 1): 0.0,
        ("impulse", 1): 2.0,
        ("impulse_2", 1): 4.0,
        ("impulse", 2): 1.0,
    }
    for key, effect, chosen in zip(numbered.keys, numbered.model.point.effects, numbered.chosen):
        assert key == (effect.kind.name, effect.joint) == chosen.trial.key == chosen.stage.accepted.key
        assert chosen.trial.effect == effect and chosen.gain == 100.0
    assert numbered.numbered.keys == numbered.keys
    # one that was left alone by the others has the first name
    alone = replace(
        state,
        chosen=state.chosen[2:3],
        model=replace(state.model, point=Point(PENDULUM.start, (push(2.0, "impulse_3"),))),
    )
    assert alone.numbered.keys == (("impulse", 1),)


def test_of_a_stage_only_what_the_model_lacks_is_open():
    state = state_of(push(7.0), push(2.0, "impulse_2"))
    stage = replace(
        state.history[0], trials=(*state.history[0].trials, trial(push(2.02, "impulse_2")), trial(push(5.0, joint=2)))
    )
    assert [t.key for t in state.others(stage)] == [("impulse", 2)]
    # tried at another time: a third push
    stage = replace(stage, trials=(trial(push(5.0)),), accepted=None)
    assert [t.key for t in state.others(stage)] == [("impulse_3", 1)]


@pytest.mark.thorough
def test_three_pushes_by_hand_are_named_where_they_came():
    """Their shape is a bell and not the effect's own: place and momentum are what is asked for."""
    bells = {2.4: 0.7, 6.2: 0.8, 9.1: -0.9}
    sigma = 0.09

    def unlogged(t, _):
        return np.array([sum(top * np.exp(-0.5 * ((t - at) / sigma) ** 2) for at, top in bells.items())])

    friction = parse_effect("coulomb_friction:joint=1,torque=0.15")
    log = record(PENDULUM, PENDULUM.plant(effects=(friction,)), 0.1, 1e-4, unlogged=unlogged)
    effects = {(effect.name, effect.joint): effect for effect in explain(log, plant="dfki_pendulum").effects}
    names = KINDS["impulse"].names[: len(bells)]
    assert set(effects) == {("coulomb_friction", 1), *((name, 1) for name in names)}
    for name, (at, top) in zip(names, bells.items()):
        values = {key: p.value for key, p in effects[name, 1].parameters.items()}
        assert values["time"] == pytest.approx(at, abs=0.03)
        momentum = 0.5 * values["torque"] * values["width"]
        assert momentum == pytest.approx(np.sqrt(2.0 * np.pi) * sigma * top, rel=0.15)
