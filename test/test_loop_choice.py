# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Rules of the selection: what goes before what, what replaces what, what values an effect may have."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.effects.screening import VOLTAGE_COLUMN
from puma_sim_core.effects.shared.columns import candidate
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.identify.residuals.unnamed import Explained, curve_preferred
from puma_sim_core.identify.screening.detect import detectable
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection.elimination import Elimination, _Compared
from puma_sim_core.identify.selection.selection import Selection
from puma_sim_core.identify.selection.state import Chosen, SelectionState, Stage, Threshold
from puma_sim_core.plant.mechanism_file import load_mechanism

A, B = ("coulomb_friction", 1), ("impulse", 2)


def scored(key):
    return Scored(*key, 0.0)


def trial(key, gain, occam=3.0, validation_gain=10.0):
    return Trial(scored(key), gain, validation_gain, None, occam)


def fitted(*names):
    return Fitted(Point(np.zeros(1), tuple(names)), np.zeros((4, 2)), 0.0, ())


def state_of(stages, *chosen, **more):
    """The state of a selection that accepted these trials in these stages, or has them instead of what was accepted."""
    made = tuple(each if isinstance(each, Chosen) else Chosen.of(each, tuple(stages)) for each in chosen)
    model = fitted(*(each.key for each in made))
    return SelectionState(model, None, None, made, tuple(stages), retuned=fitted(), **more)


PIECES = np.random.default_rng(8).normal(0.0, 1.0, 30)


def explained(cost, spread=0.0):
    """An explanation of a cost [nat] whose pieces scatter so much about their mean."""
    return Explained(cost, cost / 30.0 + spread * (PIECES - PIECES.mean()))


@pytest.mark.parametrize(
    "curve, names, both, wanted",
    [
        # names that a curve takes over whole add nothing to it
        (explained(800.0), explained(1000.0), explained(803.0), True),
        # a curve that is better, but beside which they still explain something
        (explained(800.0), explained(1000.0), explained(700.0), False),
        # no better than the names, by its heights' Occam factor or by chance
        (explained(1010.0), explained(1000.0), explained(990.0), False),
        (explained(990.0), explained(1000.0), explained(995.0), False),
        (explained(970.0, 8.0), explained(1000.0), explained(975.0, 8.0), False),
        # what they add may be chance as well
        (explained(800.0), explained(1000.0), explained(790.0, 2.0), True),
    ],
)
def test_names_fall_only_where_a_better_curve_takes_over_what_they_explain(curve, names, both, wanted):
    assert curve_preferred(curve, names, both) is wanted


def test_a_difference_counts_beyond_two_standard_errors_of_a_sum():
    rng = np.random.default_rng(4)
    # of sums of 40 values with deviation 3 about a true difference of zero, 2.3 % are beyond 2 standard errors
    found = 0
    for _ in range(2000):
        difference = rng.normal(0.0, 3.0, 40)
        found += Explained(0.0, np.zeros(40)).better(Explained(float(difference.sum()), difference))
    assert 0.014 < found / 2000 < 0.04


ROWS = 400
#: one log of 4 s, whose rows all count
PREDICTOR = SimpleNamespace(
    stretches=[SimpleNamespace(time=0.01 * np.arange(ROWS + 1))],
    fit_rows=np.ones((ROWS, 2), dtype=bool),
    mechanism=SimpleNamespace(start=np.zeros(1), deviations=np.ones(1)),
)
CHOOSER = SimpleNamespace(library=KINDS, predictor=PREDICTOR)
CHOOSER._enough = partial(Selection._enough, CHOOSER)


def worse_by(likelihood, effect=None):
    """A model without errors, and at a distance from it by which its log likelihood is so much less [nat]."""
    away = np.full((ROWS, 2), np.sqrt(likelihood / ROWS))
    return Fitted(Point(np.zeros(1), () if effect is None else (effect,)), away, likelihood, ())


@pytest.mark.parametrize(
    "name, simpler, less, wanted",
    [
        # two standard errors of a log likelihood ratio of L nat, which has the variance 2 L, are L at 8 nat
        ("asymmetric_coulomb_friction", "coulomb_friction", 7.9, "coulomb_friction"),
        ("asymmetric_coulomb_friction", "coulomb_friction", 8.1, "asymmetric_coulomb_friction"),
        ("soft_stop", "joint_spring", 7.9, "joint_spring"),
        ("soft_stop", "joint_spring", 8.1, "soft_stop"),
        # a limit that was met once goes before a blow
        ("impulse", "current_limit", 20.0, "current_limit"),
        ("impulse", "current_limit", 35.0, "impulse"),
    ],
)
def test_of_effects_that_contain_each_other_the_simpler_goes_first_unless_clearly_worse(name, simpler, less, wanted):
    effect = SimpleNamespace(kind=KINDS[name], values={p.name: p.low for p in KINDS[name].parameters})
    best = replace(trial((name, 2), 1000.0), fitted=worse_by(0.0, effect))
    plain = replace(trial((simpler, 2), 1000.0 - less), fitted=worse_by(less))
    elsewhere = replace(trial((simpler, 1), 999.9), fitted=worse_by(0.1))
    assert Selection._parsimonious(CHOOSER, best, [best, plain, elsewhere]).key == (wanted, 2)


def test_a_simpler_effect_is_not_enough_where_another_that_contains_it_is_clearly_better():
    """Seen on the EMPS in millimetres: a bristle was first and not clearly better than one level of friction, which was
    taken, though friction that differs by direction is 5.5 standard errors better than that."""

    def tried(name, gain):
        return replace(trial((name, 2), gain), fitted=worse_by(0.0))

    bristle, directions = tried("presliding_friction", 110.0), tried("asymmetric_coulomb_friction", 100.0)
    plain, other = tried("coulomb_friction", 40.0), tried("voltage_dead_band", 105.0)
    trials = [bristle, other, directions, plain]
    only = SimpleNamespace(library=KINDS, _enough=lambda c, t: (c, t) == (plain, bristle))
    assert Selection._parsimonious(only, bristle, trials) is directions
    both = SimpleNamespace(library=KINDS, _enough=lambda c, t: c is plain and t in (bristle, directions))
    assert Selection._parsimonious(both, bristle, trials) is plain
    none = SimpleNamespace(library=KINDS, _enough=lambda c, t: False)
    assert Selection._parsimonious(none, bristle, trials) is bristle


def test_a_simpler_effect_that_costs_more_than_it_is_worse_goes_first():
    richer = replace(trial(("stribeck_friction", 2), 99.5, 12.0), fitted=worse_by(0.0))
    plain = replace(trial(("coulomb_friction", 2), 100.0, 6.0), fitted=worse_by(6.5))
    assert Selection._parsimonious(CHOOSER, plain, [richer, plain]) is plain


@pytest.mark.parametrize("stiffness, wanted", [(2e4, "presliding_friction"), (1e6, "coulomb_friction")])
def test_a_bristle_as_stiff_as_it_may_be_is_none(stiffness, wanted):
    bristle = parse_effect(f"presliding_friction:joint=2,torque=8,stiffness={stiffness}")
    stiff = replace(trial(("presliding_friction", 2), 120.0, 8.0), fitted=worse_by(0.0, bristle))
    plain = replace(trial(("coulomb_friction", 2), 100.0, 6.0), fitted=worse_by(22.0))
    assert Selection._parsimonious(CHOOSER, stiff, [stiff, plain]).name == wanted


def test_rivals_are_the_best_and_those_that_contain_what_was_chosen():
    chosen = trial(("coulomb_friction", 2), 100.0)
    others = [
        (("voltage_dead_band", 2), 95.0),
        (("stribeck_friction", 2), 90.0),
        (("load_dependent_friction", 2), 85.0),
        (("joint_spring", 2), 80.0),
        (("position_dependent_friction", 2), 70.0),
        (("presliding_friction", 1), 65.0),
        # beside what is not found yet, a rival may have gained little of what it gains in the end
        (("asymmetric_coulomb_friction", 2), 16.5),
        (("quadratic_friction", 2), 15.5),
    ]
    trials = [chosen, *(replace(trial(*each), fitted=fitted()) for each in others)]
    state = state_of([Stage(tuple(trials), Threshold.alike(15.0), None, chosen)], chosen)
    found = elimination()._rivals(state, chosen.key)
    assert [t.name for t in found] == [
        "voltage_dead_band",
        "stribeck_friction",
        "load_dependent_friction",
        "position_dependent_friction",
        "asymmetric_coulomb_friction",
    ]
    few = [chosen, trials[-2], trials[-1]]
    state = state_of([Stage(tuple(few), Threshold.alike(15.0), None, chosen)], chosen)
    assert [t.name for t in elimination()._rivals(state, chosen.key)] == ["asymmetric_coulomb_friction"]


def elimination(trials=None):
    return Elimination(trials or SimpleNamespace(predictor=None), KINDS)


def test_an_effect_that_replaced_another_has_a_gain_of_its_own():
    rival = trial(("stribeck_friction", 1), 85.0)
    first, second = trial(A, 90.0), trial(B, 30.0)
    history = (
        Stage((first, rival), Threshold.alike(8.0), None, first),
        Stage((second,), Threshold.alike(8.0), None, second),
    )
    chosen = Chosen.of(rival, history, history[0], 120.0)
    state = state_of(history, second, chosen)
    assert [chosen.gain for chosen in state.chosen] == [30.0, 120.0]
    # what it was tied with and what was ruled out for it are those of the stage where it was tried
    assert chosen.stage is history[0] and chosen.trial == replace(rival, gain=120.0)
    assert state.chosen[0].stage is history[1] and state.chosen[0].trial == second


@pytest.mark.parametrize("angle, refused", [(-0.99, True), (0.99, True), (-0.03, False)])
def test_a_sensor_is_off_by_as_much_to_either_side(angle, refused):
    arm = load_mechanism()
    sampled = SimpleNamespace(joints=3, position=np.zeros((2, 3)), quantum=np.full(3, 1e-4))
    problem = SimpleNamespace(mechanism=arm, sampled=sampled)
    found = Trials(None, problem).implausible(parse_effect(f"encoder_offset:joint=3,angle={angle}"))
    assert bool(found) is refused


@pytest.mark.parametrize("period, refused", [(12.0, False), (20.0, True)])
def test_a_wave_is_no_longer_than_its_joint_can_go(period, refused):
    pendulum = load_mechanism("pendulum")
    sampled = SimpleNamespace(joints=1, position=np.array([[-1.0], [1.0]]), quantum=np.zeros(1))
    problem = SimpleNamespace(mechanism=pendulum, sampled=sampled)
    wave = parse_effect(f"sensor_nonlinearity:joint=1,amplitude=0.01,period={period}")
    found = Trials(None, problem).implausible(wave)
    assert bool(found) is refused and (found is None or "period 20" in found)


def test_effects_that_one_contains_are_those_tried_beside_it():
    chosen = trial(("position_dependent_friction", 2), 100.0)
    others = [("coulomb_friction", 2), ("coulomb_friction", 1), ("voltage_dead_band", 2)]
    trials = (chosen, *(replace(trial(key, 90.0), fitted=fitted()) for key in others))
    state = state_of([Stage(trials, Threshold.alike(15.0), None, chosen)], chosen)
    assert [t.key for t in elimination()._contained(state, 0)] == [("coulomb_friction", 2)]
    # a blow fits any single event: what it contains is chosen elsewhere
    blow = trial(("impulse", 2), 100.0)
    stage = Stage(
        (blow, replace(trial(("current_limit", 2), 99.0), fitted=fitted())), Threshold.alike(15.0), None, blow
    )
    assert elimination()._contained(state_of([stage], blow), 0) == []
    # one that took the place of another has the trials of that one's stage
    first = replace(trial(("coulomb_friction", 2), 110.0), fitted=fitted())
    stage = Stage((first, replace(chosen, fitted=fitted())), Threshold.alike(15.0), None, first)
    instead = state_of([stage], Chosen.of(chosen, (stage,), stage, 100.0))
    assert [t.key for t in elimination()._contained(instead, 0)] == [("coulomb_friction", 2)]


@pytest.mark.parametrize(
    "ends, impossible, wanted, gain",
    [
        # what was promised holds: nothing else is asked
        ({"position": 1000.0, "coulomb": 1083.0, "asymmetric": 900.0}, (), "position", 100.0),
        # it does not: another kind that contains the simpler one is better
        ({"position": 1000.0, "coulomb": 1006.0, "asymmetric": 993.0}, (), "asymmetric", 109.0),
        # ... but not by less than a rival must be
        ({"position": 1000.0, "coulomb": 1006.0, "asymmetric": 999.5}, (), "position", 100.0),
        # ... and no name where it comes out as no machine has it
        ({"position": 1000.0, "coulomb": 1006.0, "asymmetric": 993.0}, ("asymmetric",), "position", 100.0),
        # ... nor by less than its coefficients cost
        ({"position": 1000.0, "coulomb": 1001.0, "asymmetric": 999.5}, (), "coulomb", 103.0),
    ],
)
def test_effects_whose_trials_had_not_come_to_their_end_are_fitted_to_it(ends, impossible, wanted, gain, monkeypatch):
    full = {
        "position": "position_dependent_friction",
        "coulomb": "coulomb_friction",
        "asymmetric": "asymmetric_coulomb_friction",
    }
    values = {"position": "torque=2,amplitude=1", "coulomb": "torque=2", "asymmetric": "positive=2,negative=1"}

    def tried(short, gain, occam):
        effect = parse_effect(f"{full[short]}:joint=2,{values[short]}")
        model = Fitted(Point(np.zeros(1), (effect,)), np.zeros((4, 3)), 0.0, ())
        return replace(trial((full[short], 2), gain, occam), fitted=model)

    position, *others = (tried("position", 100.0, 10.0), tried("coulomb", 20.0, 6.0), tried("asymmetric", 80.0, 8.0))
    stage = Stage((position, *others), Threshold.alike(16.0), None, position)
    ending = {full[short]: objective for short, objective in ends.items()}
    lowest = min(ends.values())

    def ended(at, objective):
        return replace(worse_by(objective - lowest), point=at, objective=objective)

    monkeypatch.setattr(
        PredictionFit, "to_end", lambda fit, at, pairs: (ended(at, ending[at.effects[0].kind.name]), None)
    )
    trials = SimpleNamespace(
        predictor=PREDICTOR,
        free=lambda point: (),
        problem_of=lambda fit, model, n: model.point.effects[n].kind.name in {full[short] for short in impossible},
    )
    before = replace(state_of([stage], position), model=position.fitted)
    after = elimination(trials).simplify(before)
    assert after.keys == ((full[wanted], 2),) and after.model.point.effects[0].kind.name == full[wanted]
    assert after.chosen[0].gain == pytest.approx(gain)
    assert after.chosen[0].occam == next(t.occam for t in stage.trials if t.name == full[wanted])
    # the state before stays as it was
    assert before.keys == (position.key,) and before.model is position.fitted


@pytest.mark.parametrize("period, longest", [(0.001, 0.022), (0.02, 0.06)])
def test_a_delay_may_be_that_of_the_log_s_own_stamps(period, longest):
    """A row that is written first and read in turn has positions up to a period older than the voltages beside them."""
    sampled = SimpleNamespace(joints=3, quantum=np.zeros(3))
    problem = SimpleNamespace(mechanism=load_mechanism(), sampled=sampled)
    chooser = Trials(SimpleNamespace(step=period), problem)
    assert chooser.implausible(parse_effect(f"input_delay:time={longest - 1e-4}")) is None
    late = chooser.implausible(parse_effect(f"input_delay:time={longest + 1e-4}"))
    assert f"more than any machine has ({500 * longest:g} ms)" in late


def test_what_more_of_makes_less_of_an_effect_is_not_too_much():
    position = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    sampled = SimpleNamespace(joints=3, position=position, quantum=np.zeros(3))
    chooser = Trials(None, SimpleNamespace(mechanism=load_mechanism(), sampled=sampled))
    stiff = parse_effect("joint_elasticity:joint=1,stiffness=9e5")
    soft = parse_effect("joint_elasticity:joint=1,stiffness=20")
    assert chooser.implausible(stiff) is None
    assert "stiffness 20 N.m/rad, less than any machine has" in chooser.implausible(soft)
    heavy = parse_effect("coulomb_friction:joint=2,torque=400")
    assert "torque 400 N.m, more than any machine has" in chooser.implausible(heavy)
    quick = parse_effect("resistance_drift:joint=2,share=0.4,time_constant=0.06")
    assert "time_constant 0.06 s, less than any machine has" in chooser.implausible(quick)
    tiny = parse_effect("voltage_dead_band:joint=2,voltage=0.004")
    assert "voltage 4 mV, less than any machine has" in chooser.implausible(tiny)
    # one size of two may be small, and what says where or how fast has none
    assert chooser.implausible(parse_effect("base_tilt:x=0.0001,y=0.03")) is None
    assert chooser.implausible(parse_effect("impulse:joint=1,torque=9,time=3,width=0.001")) is None
    # a hand pushes as hard as it likes, but not for a row alone
    assert chooser.implausible(parse_effect("impulse:joint=1,torque=2500,time=3,width=0.2")) is None
    short = chooser.implausible(parse_effect("impulse:joint=1,torque=2500,time=3,width=0.001"))
    assert "torque 2.5e+03 N.m, more than any machine has" in short


def test_plausible_sizes_go_with_the_machine_and_a_bound_is_no_size():
    pendulum = load_mechanism("pendulum")
    sampled = SimpleNamespace(joints=1, position=np.array([[-1.0], [1.0]]), quantum=np.zeros(1))
    chooser = Trials(None, SimpleNamespace(mechanism=pendulum, sampled=sampled))
    # a two-hundredth of the friction of the arm's joints, and an error of a third of a radian is none of an encoder
    assert chooser.implausible(parse_effect("coulomb_friction:joint=1,torque=0.03")) is None
    assert "more than any machine has" in chooser.implausible(parse_effect("coulomb_friction:joint=1,torque=3"))
    assert "more than any machine has" in chooser.implausible(
        parse_effect("sensor_nonlinearity:joint=1,amplitude=0.32,period=6")
    )
    on_it = parse_effect("load_dependent_friction:joint=1,coefficient=1")
    assert "coefficient on the bound 1 of what its law allows" in chooser.implausible(on_it)
    for unit, joint in itertools.product(("N.m", "rad", "V", "A", "kg", "N.m/rad"), range(3)):
        # the ranges are those of the arm
        assert 0.3 < load_mechanism().effect_scale(unit, joint) < 3.0


@pytest.mark.parametrize(
    "mechanism, name, parameter, size, shown",
    [
        # the least friction that the log would show is much for the pendulum, and little for the arm
        ("puma560", "coulomb_friction", "torque", 3.0, True),
        ("pendulum", "coulomb_friction", "torque", 3.0, False),
        ("pendulum", "coulomb_friction", "torque", 0.03, True),
        # more of a stiffness is less of an effect: the arm's drives are stiffer, so that 50 N.m/rad is too much of one
        ("puma560", "joint_elasticity", "stiffness", 50.0, False),
        ("puma560", "joint_elasticity", "stiffness", 2e4, True),
        ("pendulum", "joint_elasticity", "stiffness", 50.0, True),
        # a delay may be longer by a period of the log, here 20 ms
        ("pendulum", "input_delay", "time", 0.025, True),
        ("pendulum", "input_delay", "time", 0.035, False),
    ],
)
def test_what_a_log_could_show_is_compared_with_what_the_machine_may_have(mechanism, name, parameter, size, shown):
    def values(coefficients):
        return {parameter: size * float(coefficients[0])}

    machine, kind = load_mechanism(mechanism), KINDS[name]
    screened = candidate([np.zeros(3)], [1.0], [0.1], values, {}, VOLTAGE_COLUMN, fixed=True)
    pairs, joint = [(screened, np.array([[100.0]]))], 1 if kind.per_joint else None
    row = detectable(kind, joint, machine, 0.02, pairs, threshold=16.0)
    assert (row.size, row.unit, row.excited) == (size, kind.parameter(parameter).unit, shown)
    # what is seen is excited, whatever its size
    found = parse_effect(f"{name}:{'joint=1,' if joint else ''}{parameter}={size}")
    assert detectable(kind, joint, machine, 0.02, pairs, 16.0, found).excited


def test_a_spring_is_contained_in_a_stop():
    assert "joint_spring" in KINDS["soft_stop"].contains


def test_a_stop_that_the_fit_moved_beyond_the_motion_keeps_its_column(monkeypatch):
    """Rivals are fitted beside the columns that the derivatives have, not those that the fitted model would have."""
    stop, names = parse_effect("soft_stop:joint=1,upper=0.1,stiffness=30"), ((0, "stiffness"), (0, "upper"))
    bare = replace(fitted(), point=Point(np.zeros(1), (stop,)), names=names)
    rival, asked = replace(trial(B, 30.0), fitted=bare), []
    found = _Compared(fitted(), bare, SimpleNamespace(jacobian=None), 1.0)
    fit = SimpleNamespace(best_of=lambda points: next(iter(points)), run=lambda *_, frozen, **__: asked.append(frozen))
    monkeypatch.setattr("puma_sim_core.identify.selection.elimination.PredictionFit", lambda *_: fit)
    monkeypatch.setattr("puma_sim_core.identify.selection.elimination.CausalScreen", lambda *_: None)
    judge = elimination(SimpleNamespace(predictor=None, problem=None, names=lambda *_: [], free=lambda point: ()))
    monkeypatch.setattr(judge, "_compared", lambda *_: found, raising=False)
    monkeypatch.setattr(judge, "_asked_for", lambda *_: True)
    monkeypatch.setattr(judge, "_rivals", lambda *_: [rival])
    monkeypatch.setattr(judge, "_screened_again", lambda *_: [])
    first = trial(A, 90.0)
    state = state_of([Stage((first,), Threshold.alike(8.0), None, first)], first)
    assert judge._without_or_replaced(state, 0) is None
    assert asked == [names]
