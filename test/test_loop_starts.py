# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Where the fits of trials start from, where the screened size leads nowhere."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from loop_fits import PENDULUM, lacking

from puma_sim_core.effects import KINDS, Effect, parse_effect
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection.refits import Refits
from puma_sim_core.identify.settings import FITTING, SELECTION

pytestmark = pytest.mark.long


def test_a_fit_that_is_worse_than_none_goes_on_from_every_start():
    """As a delay was fitted beside stretched parameters: one start falls slowly, and the one that is far off at first
    falls below the model without an effect (13575)."""
    paths = {
        "stretched": [110e3, 100e3, 93e3, 88e3, 85e3, 83e3, 81e3, 79e3, 76e3, 73e3, 68e3, 59e3],
        "nominal": [2965e3, 1082e3, 31e3, 17.5e3, 12e3, 10.7e3, 10.7e3],
    }

    def run(point, pairs, rounds):
        path = paths[point.start]
        at = min(point.round + rounds, len(path) - 1)
        return SimpleNamespace(point=SimpleNamespace(start=point.start, round=at), objective=path[at])

    base = SimpleNamespace(fit=SimpleNamespace(run=run), model=SimpleNamespace(names=(), objective=13575.0))
    starts = [SimpleNamespace(start=start, round=0, two_mass=False) for start in paths]
    trials = Trials.__new__(Trials)
    for order in (starts, starts[::-1]):
        (found,) = trials._relinearised(base, (), order, True)
        assert found.point.start == "nominal" and found.objective < base.model.objective


@pytest.mark.parametrize(
    "path, ends",
    [
        # far from its end, as where a limit starts at twice its value: it falls by a tenth or more each time
        ([3021e3, 481e3, 175e3, 150e3, 18e3, 17769.0, 17768.5, 17768.4], 5),
        # near its end a fit has the derivatives that it was given, and no more
        ([17900.0, 17800.0, 17780.0, 17770.0, 17768.0], 2),
        ([17900.0, 17800.0, 17799.0, 17770.0, 17768.0], 2),
        ([17900.0, 17899.0, 17780.0, 17770.0, 17768.0], 1),
        # what does not end is left
        ([2.0 ** (40 - n) for n in range(40)], FITTING.relinearisations_far),
    ],
)
def test_a_fit_that_falls_by_a_share_of_itself_is_not_at_its_end(path, ends):
    at = iter(range(len(path)))
    fit = PredictionFit.__new__(PredictionFit)
    fit.derivatives = lambda point, pairs, near=None: point
    fit.linear = lambda point, pairs, raw: SimpleNamespace(point=None, objective=path[next(at)])
    found, _ = fit.to_end(None, (), patient=True)
    assert found.objective == path[ends]
    at = iter(range(len(path)))
    assert fit.to_end(None, ())[0].objective == path[min(ends, FITTING.relinearisations)]


def beside_four(true, unseen):
    """Trials with an unseen limit behind four better ones, as they start from the nominal parameters too."""
    base, trials, state = lacking(parse_effect(true))
    far = Point(PENDULUM.start + np.array([5.0, 0.0, 0.0, 0.0]) * PENDULUM.deviations, ())
    errors = base.fit.errors(far)
    stretched = replace(base.model, point=far, errors=errors, objective=base.fit.objective(errors, far))
    limit = parse_effect(unseen)
    scored = Scored(limit.kind.name, 1, 0.0, values=dict(limit.values), occam=3.0)
    left = replace(stretched, point=Point(far.theta, (limit,)), names=((0, next(iter(limit.values))),))
    stuck = replace(trials.judged(base.fit, stretched, scored, left), gain=-20.0)
    screened = replace(scored, best=SimpleNamespace(entry=SimpleNamespace(candidate=SimpleNamespace(fixed=False))))
    others = (replace(stuck, gain=50.0, scored=screened),) * SELECTION.most_polished
    behind = Refits(trials, KINDS).from_nominal(replace(state, model=stretched, trials=(*others, stuck))).trials[-1]
    return stuck, behind


def test_a_limit_that_no_screening_saw_starts_from_the_nominal_parameters():
    """Stretched parameters hide it from any screening about them."""
    stuck, behind = beside_four("current_limit:joint=1,current=0.6", "current_limit:joint=1,current=6")
    assert behind.gain > stuck.gain and behind.effect.values["current"] == pytest.approx(0.6, rel=0.01)


def test_one_that_fits_no_better_than_none_there_does_not():
    stuck, behind = beside_four("voltage_offset:joint=1,voltage=1e-6", "current_limit:joint=1,current=6")
    assert behind is stuck


def held(base, name, **values):
    """The trial of dry friction that holds the joint, so that no slope sees anything of it."""
    scored = Scored(name, 1, 0.0, values=values)
    effect = Effect(KINDS[name], 1, values)
    point = base.with_effect(effect)
    errors = base.fit.errors(point)
    at = Fitted(point, errors, base.fit.objective(errors, point), tuple((0, each) for each in values))
    return Trial(scored, base.model.objective - at.objective, 0.0, at, 0.0)


def test_a_level_that_holds_the_joint_is_sought_among_those_that_machines_have():
    base, trials, state = lacking(parse_effect("coulomb_friction:joint=1,torque=0.05"))
    stuck = held(base, "coulomb_friction", torque=2.0)
    assert stuck.gain < 0.0
    refits = Refits(trials, KINDS)
    (found,) = refits.from_levels(replace(state, trials=(stuck,))).trials
    assert found.gain > 100.0 and found.effect.values["torque"] == pytest.approx(0.05, rel=0.1)
    # what gains enough for a name stays
    assert refits.from_levels(replace(state, trials=(found,))).trials == (found,)
    # and what contains it begins from there
    wide = held(base, "asymmetric_coulomb_friction", positive=2.0, negative=2.0)
    _, freed = refits.from_nested(replace(state, trials=(found, wide))).trials
    assert wide.gain < 0.0 and freed.model.objective < found.model.objective + 1.0


def test_effects_that_contain_one_another_start_from_each_other_until_none_gains():
    """Seen on a simulated pendulum: one level of friction was fitted on from two, and stayed ahead of these."""
    base, trials, state = lacking(parse_effect("asymmetric_coulomb_friction:joint=1,positive=0.06,negative=0.04"))
    plain = held(base, "coulomb_friction", torque=0.3)
    wide = held(base, "asymmetric_coulomb_friction", positive=0.02, negative=0.08)
    assert wide.gain > plain.gain
    state, refits = replace(state, trials=(plain, wide)), Refits(trials, KINDS)
    one, two = refits.from_containing(refits.from_nested(state)).trials
    assert one.model.objective < two.model.objective
    one, two = refits.related(state).trials
    assert two.model.objective < one.model.objective - 16.0
    # one more round changes nothing
    again = refits.related(replace(state, trials=(one, two))).trials
    assert again == (one, two)


def test_fits_that_creep_on_end():
    """Seen on a record with a limit: from each other two forms of friction gained a few nat for minutes."""
    base, trials, state = lacking(parse_effect("coulomb_friction:joint=1,torque=0.05"))

    class Creeping(Refits):
        rounds = 0

        def from_nested(self, state):
            self.rounds += 1
            return replace(state, trials=tuple(replace(t, gain=t.gain + 3.0) for t in state.trials))

        def from_containing(self, state):
            return state

    creeping = Creeping(trials, KINDS)
    one = held(base, "coulomb_friction", torque=0.3)
    assert creeping.related(replace(state, trials=(one,))).trials[0].gain == one.gain + 3.0 * creeping.rounds
    assert creeping.rounds < 10


def test_no_level_is_found_where_no_dry_friction_is():
    base, trials, _ = lacking(parse_effect("voltage_offset:joint=1,voltage=0.1"))
    scored = Scored("coulomb_friction", 1, 0.0, values={"torque": 2.0})
    assert trials.best_level(base, scored, {"torque": float(PENDULUM.torque_scale[0])}) is None


def test_a_gap_beyond_all_that_are_tried_at_first_is_found():
    true = parse_effect("backlash:joint=1,gap=0.0077,stiffness=2000,damping=1.0")
    base, trials, _ = lacking(true)
    grid = SimpleNamespace(entry=SimpleNamespace(candidate=SimpleNamespace(fixed=True)))
    values = {"gap": 0.002, "stiffness": 2000.0, "damping": 1.0}
    assert max(FITTING.threshold_starts) * values["gap"] < 0.4 * true.values["gap"]
    found = trials.run(base, Scored("backlash", 1, 0.0, best=grid, values=values))
    assert found.effect.values["gap"] == pytest.approx(true.values["gap"], rel=0.05)


def ended(base, effect):
    """The trial of an effect whose fit ended at these values, with the parameters of the base."""
    scored = Scored(effect.kind.name, 1, 0.0, values=dict(effect.values))
    point = base.with_effect(effect)
    errors = base.fit.errors(point)
    at = Fitted(point, errors, base.fit.objective(errors, point), tuple((0, name) for name in effect.values))
    return Trial(scored, base.model.objective - at.objective, 0.0, at, 0.0)


def test_a_spring_that_ended_far_away_starts_from_the_stop_that_it_is_inside_of():
    base, trials, state = lacking(parse_effect("joint_spring:joint=1,stiffness=0.4,angle=2.5"))
    stop = ended(base, parse_effect("soft_stop:joint=1,lower=2.5,upper=9.0,stiffness=0.4,damping=0"))
    lost = ended(base, parse_effect("joint_spring:joint=1,stiffness=0.05,angle=9.0"))
    assert stop.gain > lost.gain + 100.0
    spring, same = Refits(trials, KINDS).from_containing(replace(state, trials=(lost, stop))).trials
    assert same is stop and spring.gain > stop.gain - 1.0
    # weight and gain of the drive answer to it, too
    assert spring.effect.values["stiffness"] == pytest.approx(0.4, rel=0.3)
    assert spring.effect.values["angle"] == pytest.approx(2.5, rel=0.1)


@pytest.mark.parametrize("beyond, refused", [(1.4, False), (1.6, True)])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_spring_whose_torque_varies_by_less_than_half_of_its_mean_is_a_constant_torque(beyond, refused, side):
    low, high = -1.9, -1.4
    angle = (high if side > 0.0 else low) + side * beyond * (high - low)
    torques = [low - angle, high - angle]
    assert (abs(torques[1] - torques[0]) < 0.5 * abs(sum(torques)) / 2.0) == refused
    illegal = KINDS["joint_spring"].screening.illegal
    assert (illegal({"stiffness": 30.0, "angle": angle}, (low, high), (-9.0, 9.0)) is not None) == refused


def test_a_start_about_which_the_model_cannot_be_run_is_none():
    """Seen on a blind record: an elasticity beside the parameters of an earlier trial ended it with an error."""
    base, trials, state = lacking(parse_effect("coulomb_friction:joint=1,torque=0.05"))
    found = ended(base, parse_effect("coulomb_friction:joint=1,torque=0.04"))
    nowhere = Point(base.model.point.theta, (parse_effect("joint_elasticity:joint=1,stiffness=1000,damping=1000"),))
    assert base.fit.errors(nowhere) is None
    assert Refits(trials, KINDS)._better(state, found, nowhere, found.model.point) is found


def test_a_stop_starts_from_where_the_innovations_have_it():
    """A record of a score: a joint that struck a hard stop stretched the parameters, the filtered motion had a soft one
    0.23 rad off, and no trial found the one there was."""
    base, trials, state = lacking(parse_effect("soft_stop:joint=1,lower=-9,upper=0.6,stiffness=150,damping=0.02"))
    far = Point(PENDULUM.start + np.array([5.0, 0.0, 0.0, 0.0]) * PENDULUM.deviations, ())
    errors = base.fit.errors(far)
    stretched = replace(base.model, point=far, errors=errors, objective=base.fit.objective(errors, far))
    beyond = {"lower": -9.0, "upper": 1.2, "stiffness": 1.0, "damping": 0.0}
    stuck = trials.run(replace(base, model=stretched), Scored("soft_stop", 1, 5.0, values=beyond))
    state = replace(state, model=stretched, jacobian=base.fit.derivatives(far, ()), trials=(stuck,))
    refits = Refits(trials, KINDS)
    (found,) = refits.from_innovations(state).trials
    assert stuck.effect.values["upper"] > 1.0 and found.gain > stuck.gain + SELECTION.least_gain
    assert found.effect.values["upper"] == pytest.approx(0.6, abs=2e-3)
    # about parameters as the priors have them the filtered motion is to be trusted
    near = replace(state, model=replace(base.model, point=Point(PENDULUM.start, ())))
    assert refits.from_innovations(near) is near
