# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What becomes of chosen effects beside those that were found later."""

from __future__ import annotations

from dataclasses import replace
from functools import partial, reduce

import pytest
from loop_fits import NOISE, PENDULUM, lacking
from loop_logs import pieces, record

from puma_sim_core.effects import KINDS, Effect, parse_effect
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection.elimination import Elimination
from puma_sim_core.identify.selection.selection import Selection
from puma_sim_core.identify.selection.state import Chosen, SelectionState, Stage, Threshold
from puma_sim_core.identify.settings import FITTING, SELECTION
from puma_sim_core.identify.standing import better_by, standings

pytestmark = pytest.mark.long


def test_an_effect_that_another_contains_leaves_its_size_to_it():
    true = parse_effect("stribeck_friction:joint=1,torque=0.03,velocity=0.08,sliding=0.05")
    base, trials, state = lacking(true)
    most, least = 0.046, 0.004
    coulomb = parse_effect(f"coulomb_friction:joint=1,torque={most}")
    bump = Effect(true.kind, 1, {**true.values, "sliding": least})
    scored = [Scored(effect.kind.name, 1, 100.0, values=dict(effect.values)) for effect in (coulomb, bump)]
    accepted = [trials.run(base, each) for each in scored]
    history = tuple(Stage(tuple(accepted), Threshold.alike(16.0), base.model, each) for each in accepted)
    model = base.fit.run(Point(PENDULUM.start, (coulomb, bump)), (), rounds=8)
    chosen = tuple(Chosen.of(each, history) for each in accepted)
    both = replace(state, model=model, history=history, chosen=chosen)
    left = Elimination(trials, KINDS).eliminate(both)
    assert left.keys == (("stribeck_friction", 1),)
    assert left.model.point.effects[0].values["sliding"] == pytest.approx(most + least, rel=0.1)


def test_a_rival_is_tried_in_the_form_that_suits_what_was_found_later():
    true = parse_effect("load_dependent_friction:joint=1,coefficient=0.15,transmitted=0")
    later = parse_effect("voltage_offset:joint=1,voltage=0.3")
    plant = PENDULUM.plant(effects=(true, later))
    problem, _, predictor = pieces(PENDULUM, record(PENDULUM, plant, volts=NOISE, noise=1e-5), NOISE, 1e-5)
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(plant)))
    base = fit.run(Point(PENDULUM.start, ()), (), rounds=8)
    trials, tried = Trials(predictor, problem), []
    for text, names in (
        ("position_dependent_friction:joint=1,torque=0.05,amplitude=0.03,angle=1.5", ("torque", "amplitude", "angle")),
        ("load_dependent_friction:joint=1,coefficient=0.1,transmitted=1", ("coefficient",)),
        ("voltage_offset:joint=1,voltage=0.3", ("voltage",)),
    ):
        effect = parse_effect(text)
        found, _ = fit.to_end(Point(PENDULUM.start, (effect,)), tuple((0, name) for name in names))
        scored = Scored(effect.kind.name, 1, 100.0, values={name: effect.values[name] for name in names})
        tried.append(Trial(scored, 100.0, 50.0, found, 3.0))
    stages = (
        Stage(tuple(tried[:2]), Threshold.alike(16.0), base, tried[0]),
        Stage((tried[2],), Threshold.alike(16.0), base, tried[2]),
    )
    both = (tried[0].effect, tried[2].effect)
    names = (*((0, name) for name in tried[0].effect.values), (1, "voltage"))
    model, _ = fit.to_end(Point(PENDULUM.start, both), names)
    chosen = tuple(Chosen.of(each, stages) for each in (tried[0], tried[2]))
    state = SelectionState(model, None, fit.weighting, chosen, stages)
    left = Elimination(trials, KINDS).eliminate(state)
    assert left.keys == (("voltage_offset", 1), ("load_dependent_friction", 1))
    assert left.model.point.effects[1].values == pytest.approx(true.values, abs=0.01)
    # its evidence is over a model without it that was fitted to its end, from anywhere
    without, _ = fit.to_end(Point(PENDULUM.start, (later,)), ((0, "voltage"),), times=8, gain=0.1)
    gained = without.objective - left.model.objective
    assert left.chosen[1].gain + left.chosen[1].occam == pytest.approx(gained, abs=FITTING.finished)


def test_the_gain_beside_another_effect_is_that_of_the_fits_with_and_without():
    """An offset that the log has, and a spring that it has not."""
    friction, offset = (
        parse_effect("coulomb_friction:joint=1,torque=0.03"),
        parse_effect("voltage_offset:joint=1,voltage=0.01"),
    )
    plant = PENDULUM.plant(effects=(friction, offset))
    problem, _, predictor = pieces(PENDULUM, record(PENDULUM, plant, volts=NOISE, noise=1e-5), NOISE, 1e-5)
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(plant)))
    spring, occam = parse_effect("joint_spring:joint=1,stiffness=1e-3,angle=0"), 3.0
    for effect, asked in ((offset, True), (spring, False)):
        effects = (friction, offset) if asked else (friction, offset, spring)
        pairs = tuple((n, name) for n, e in enumerate(effects) for name in e.values)
        model, _ = fit.to_end(Point(PENDULUM.start, effects), pairs)
        made = [Trial(Scored(e.kind.name, 1, 100.0, values=dict(e.values)), 50.0, 50.0, model, occam) for e in effects]
        stages = tuple(Stage((each,), Threshold.alike(16.0), model, each) for each in made)
        chosen = tuple(Chosen.of(each, stages) for each in made)
        state = SelectionState(model, None, fit.weighting, chosen, stages)
        gain = Elimination(Trials(predictor, problem), KINDS).gain_beside(state, (effect.kind.name, 1))
        if not asked:
            assert gain is None
            continue
        bare, _ = fit.to_end(Point(PENDULUM.start, (friction,)), ((0, "torque"),), times=8, gain=0.1)
        assert gain > 100.0 and gain == pytest.approx(bare.objective - model.objective - occam, rel=0.05)


def both_found(true, first, then, second, *rivals):
    """The trials of a pendulum with the effects `true`, and the state of a selection that accepted one effect and a
    second one before its rivals, and whose first has come out as another (`then`); all of them in the text form."""
    plant = PENDULUM.plant(effects=tuple(map(parse_effect, true)))
    problem, _, predictor = pieces(PENDULUM, record(PENDULUM, plant, volts=NOISE, noise=1e-5), NOISE, 1e-5)
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(plant)))
    trials, start = Trials(predictor, problem), PENDULUM.start

    def ended(*effects):
        point = Point(start, tuple(map(parse_effect, effects)))
        return fit.to_end(point, trials.free(point), patient=True)[0]

    def trial(model, gain):
        effect = model.point.effects[-1]
        return Trial(Scored(effect.kind.name, effect.joint, gain, values=dict(effect.values)), gain, 50.0, model, 3.0)

    base, one, other = ended(), trial(ended(first), 200.0), trial(ended(then), 190.0)
    beside = [trial(ended(first, text), 100.0 - n) for n, text in enumerate((second, *rivals))]
    stages = (
        Stage((one, other), Threshold.alike(16.0), base, one),
        Stage(tuple(beside), Threshold.alike(16.0), one.model, beside[0]),
    )
    chosen = (Chosen.of(other, stages, stages[0], 190.0), Chosen.of(beside[0], stages))
    return trials, SelectionState(ended(then, second), None, fit.weighting, chosen, stages)


def test_an_effect_that_was_right_beside_a_wrong_one_alone_is_exchanged_in_the_end():
    """Seen on a simulated slide: beside bristles a delay had more than the lag that the machine has, and when the
    bristles had become one level of friction the lag had 536 nat more."""
    friction, lag = "coulomb_friction:joint=1,torque=0.05", "sensor_lag:joint=1,time_constant=0.013"
    bristles = "presliding_friction:joint=1,stiffness=20,torque=0.05"
    trials, state = both_found((friction, lag), bristles, friction, "input_delay:time=0.006", lag)
    elimination = Elimination(trials, KINDS)
    found = elimination.exchange(state)
    assert found.keys == (("coulomb_friction", 1), ("sensor_lag", 1))
    assert found.model.point.effects[1].values["time_constant"] == pytest.approx(0.013, rel=0.1)
    # its evidence is greater by what the fits gain
    gained = state.model.objective - found.model.objective
    assert gained > 100.0 and found.chosen[1].gain == pytest.approx(100.0 + gained, abs=FITTING.finished)
    # the page says how far the other is from it now
    rows = {row.key: row for row in standings(found, partial(better_by, trials.predictor))}
    replaced = rows["input_delay", None]
    assert rows["sensor_lag", 1].evidence - replaced.evidence == pytest.approx(gained, abs=FITTING.finished)
    assert replaced.against == ("sensor_lag", 1) and replaced.verdict.startswith("lower than sensor lag by")
    # and what the log has stays
    assert elimination.exchange(found) is found


def test_an_effect_beside_those_that_it_was_chosen_beside_was_compared_with_its_rivals_there():
    friction, lag = "coulomb_friction:joint=1,torque=0.05", "sensor_lag:joint=1,time_constant=0.013"
    trials, state = both_found((friction, lag), friction, friction, "input_delay:time=0.006", lag)
    assert Elimination(trials, KINDS).exchange(state) is state


@pytest.mark.parametrize("differs, taken", [(0.0, False), (0.001, True)])
def test_what_contains_an_effect_takes_its_place_where_its_own_fit_had_not_ended(differs, taken):
    """Seen on a simulated double pendulum: friction over the position had not come to its end in its stage, and one
    level was named, 353 nat behind."""
    two = f"asymmetric_coulomb_friction:joint=1,positive={0.05 + differs},negative={0.05 - differs}"
    base, trials, state = lacking(parse_effect(two))
    one = trials.run(base, Scored("coulomb_friction", 1, 100.0, values={"torque": 0.05}))
    start = base.with_effect(parse_effect("asymmetric_coulomb_friction:joint=1,positive=0.03,negative=0.08"))
    errors = base.fit.errors(start)
    names = ((0, "positive"), (0, "negative"))
    begun = Fitted(start, errors, base.fit.objective(errors, start), names)
    rich = Trial(
        Scored(start.effects[0].kind.name, 1, 50.0, values=dict(start.effects[0].values)), 50.0, 5.0, begun, 6.0
    )
    stage = Stage((one, rich), Threshold.alike(16.0), base.model, one)
    state = replace(state, model=one.model, jacobian=None, chosen=(Chosen.of(one, (stage,)),), history=(stage,))
    found = Elimination(trials, KINDS).exchange(state)
    assert (found is not state) == taken
    if taken:
        assert found.keys == (("asymmetric_coulomb_friction", 1),)
        values = found.model.point.effects[0].values
        assert values["positive"] - values["negative"] == pytest.approx(2.0 * differs, rel=0.2)


@pytest.mark.parametrize("differs, taken", [(0.00018, False), (0.001, True)])
def test_what_contains_an_effect_takes_its_place_only_for_what_a_name_needs(differs, taken):
    lag, delay = "sensor_lag:joint=1,time_constant=0.006", "input_delay:time=0.006"
    one, two = "coulomb_friction:joint=1,torque=0.05", "asymmetric_coulomb_friction:joint=1,positive={},negative={}"
    two = two.format(0.05 + differs, 0.05 - differs)
    trials, state = both_found((delay, two), lag, delay, one, two)
    at = Point(state.model.point.theta, (state.model.point.effects[0], parse_effect(two)))
    rich, _ = PredictionFit(trials.predictor, state.noise).to_end(at, trials.free(at))
    # beyond what another rival needs
    assert state.model.objective - rich.objective > 2.0 * SELECTION.replacement_gain
    found = Elimination(trials, KINDS).exchange(state)
    assert found.keys[1] == ("asymmetric_coulomb_friction" if taken else "coulomb_friction", 1)


def beside_a_spring():
    """A model with friction that the log has and a spring that was accepted within the limit, which is slack at a given
    angle [rad] by now: the trials, and the state of the selection by that angle."""
    friction = parse_effect("coulomb_friction:joint=1,torque=0.05")
    base, trials, state = lacking(friction)
    near = parse_effect("joint_spring:joint=1,stiffness=0.1,angle=0.5")
    accepted = []
    for effect in (friction, near):
        fitted = base.fit.run(base.with_effect(effect), (), rounds=2)
        accepted.append(Trial(Scored(effect.kind.name, 1, 100.0, values=dict(effect.values)), 100.0, 9.0, fitted, 5.0))
    history = tuple(Stage(tuple(accepted), Threshold.alike(16.0), base.model, each) for each in accepted)
    chosen = tuple(Chosen.of(each, history) for each in accepted)

    def ending(angle):
        effects = (friction, replace(near, values={**near.values, "angle": angle}))
        model = base.fit.run(Point(base.model.point.theta, effects), (), rounds=2)
        return replace(state, model=model, history=history, chosen=chosen)

    return trials, ending


def test_an_effect_that_ended_where_no_machine_has_it_is_withdrawn():
    """Seen on a lever that is lifted once: a spring was tried within the limit, and slack at -3.6 rad in the end."""
    trials, ending = beside_a_spring()
    elimination = Elimination(trials, KINDS)
    kept = ending(0.5)
    assert elimination.withdraw(kept) is kept
    left = elimination.withdraw(ending(9.0))
    assert left.keys == (("coulomb_friction", 1),) == tuple((e.kind.name, e.joint) for e in left.model.point.effects)
    assert [(key, why == left.history[1].refuting.problem) for key, why in left.barred] == [(("joint_spring", 1), True)]
    assert [stage.accepted and stage.accepted.key for stage in left.history] == [("coulomb_friction", 1), None]
    for stage in (*left.history, left.chosen[0].stage):
        assert stage.refuting.key == ("joint_spring", 1) and "far outside the range" in stage.refuting.problem
        assert {t.key for t in stage.trials if t.possible} == {("coulomb_friction", 1)}


def test_an_effect_is_looked_at_after_the_last_fit_of_all():
    """Seen beside backlash: friction that warms up had a time constant that machines have until all was fitted to its
    end, and 0.23 s in the report, which none has."""
    trials, ending = beside_a_spring()

    class Moving(Selection):
        """A selection whose last fit of both moves the spring."""

        def finish(self, state):
            ended = super().finish(state)
            moved = ending(9.0).model if len(state.chosen) == 2 else ended.model
            return replace(ended, model=replace(ended.model, point=moved.point))

    selection = Moving(None, trials, KINDS, 0, lambda *_: None)
    both = ending(0.5)
    ended = reduce(lambda state, each: each(state), selection.conclusion, both)
    assert ended.keys == (("coulomb_friction", 1),)
    assert [key for key, _ in ended.barred] == [("joint_spring", 1)]
    # the others are fitted again without it, and so they are where another effect is retracted
    assert ended.model.jacobian is not None and ended.jacobian is not None
    offset = parse_effect("voltage_offset:joint=1,voltage=0")
    point = Point(both.model.point.theta, (*both.model.point.effects, offset))
    chosen = (*both.chosen, replace(both.chosen[0], key=("voltage_offset", 1)))
    three = replace(both, chosen=chosen, model=replace(both.model, point=point))
    assert selection.without(three, ("voltage_offset", 1)).keys == ended.keys


def test_what_was_retracted_takes_no_place():
    trials, ending = beside_a_spring()
    alone = ending(9.0)
    point = Point(alone.model.point.theta, alone.model.point.effects[1:])
    alone = replace(alone, chosen=alone.chosen[1:], model=replace(alone.model, point=point))
    friction = ("coulomb_friction", 1)
    elimination = Elimination(trials, KINDS)
    assert elimination.withdraw(alone).keys == (friction,)
    assert elimination.withdraw(replace(alone, retracted=(friction,))).keys == ()


VARYING = "position_dependent_friction:joint=1,torque=0.05,amplitude=9,angle=1.5"
LOADED = "load_dependent_friction:joint=1,coefficient=0.99"


@pytest.mark.parametrize("true, stays", [(0.05, True), (1e-4, False)])
@pytest.mark.parametrize("impossible, removed", [(VARYING, False), (LOADED, True)])
def test_a_simpler_effect_takes_the_place_of_a_withdrawn_one_if_the_log_asks_for_it(impossible, removed, true, stays):
    """Of those that it contains: friction over the position took a part of friction by load up, was withdrawn for its
    size, and all friction of its joint went with it. And of those that it made needless: so it was with friction by
    load, beside which one level had been removed."""
    base, trials, state = lacking(parse_effect(f"coulomb_friction:joint=1,torque={true}"))
    level, rich = parse_effect("coulomb_friction:joint=1,torque=0.05"), parse_effect(impossible)
    assert ("coulomb_friction" in rich.kind.contains) is not removed and trials.implausible(rich) is not None
    tried = []
    for effect in (level, rich):
        fitted = base.fit.run(base.with_effect(level), (), rounds=2)
        tried.append(Trial(Scored(effect.kind.name, 1, 100.0, values=dict(effect.values)), 100.0, 9.0, fitted, 5.0))
    tried[1] = replace(tried[1], fitted=replace(tried[1].model, point=Point(base.model.point.theta, (rich,))))
    accepted = tried if removed else tried[1:]
    history = tuple(Stage(tuple(tried), Threshold.alike(16.0), base.model, each) for each in accepted)
    chosen = (Chosen.of(tried[1], history),)
    found = Elimination(trials, KINDS).withdraw(replace(state, model=tried[1].model, history=history, chosen=chosen))
    assert found.keys == ((("coulomb_friction", 1),) if stays else ())
    # with another in its place no choice need be made again
    assert [key for key, _ in found.barred] == ([] if stays else [(rich.kind.name, 1)])
    assert tuple((e.kind.name, e.joint) for e in found.model.point.effects) == found.keys
    assert found.history[-1].refuting.key == (rich.kind.name, 1)
    if stays:
        assert found.model.point.effects[0].values["torque"] == pytest.approx(true, rel=0.2)
        assert found.chosen[0].gain > 16.0
