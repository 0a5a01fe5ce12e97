# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Fits of prediction errors come to places that have no zero: where a stop begins, when a blow
fell, how many waves a gear has a turn."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from loop_fits import NOISE, PENDULUM, lacking, tried
from loop_logs import pieces, record

from puma_sim_core.effects import KINDS, Effect, parse_effect
from puma_sim_core.errors import NonFiniteStateError
from puma_sim_core.identify import explain
from puma_sim_core.identify.fitting.intervals import intervals
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit, Slopes, bounded_step
from puma_sim_core.identify.fitting.trial import IMPOSSIBLE
from puma_sim_core.identify.fitting.trials import Base, Trials
from puma_sim_core.identify.prepare import runnable
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection.refits import Refits
from puma_sim_core.identify.selection.state import Stage, Threshold
from puma_sim_core.identify.settings import FITTING, SELECTION
from puma_sim_core.plant.mechanism_file import load_mechanism

pytestmark = pytest.mark.long
#: how far the undisturbed motion goes [rad]
HIGHEST = float(record(PENDULUM, PENDULUM.plant()).position.max())


@pytest.mark.parametrize(
    "text, off",
    [
        (
            f"soft_stop:joint=1,lower=-9,upper={HIGHEST - 0.1},stiffness=0.3,damping=0",
            {"upper": -0.005, "stiffness": 0.1},
        ),
        (f"soft_stop:joint=1,lower=-9,upper={HIGHEST - 0.1},stiffness=0.3,damping=0", {"upper": 0.008}),
        ("impulse:joint=1,torque=0.3,time=7.3,width=0.06", {"time": 0.02, "width": 0.01}),
        ("impulse:joint=1,torque=0.3,time=7.3,width=0.06", {"time": -0.02}),
        ("transmission_error:joint=1,amplitude=0.002,order=40,phase=1", {"order": 0.4}),
        # a step by its size would be one to below nothing
        ("friction_warm_up:joint=1,share=0.8,time_constant=1.5", {"time_constant": 9.0}),
    ],
)
def test_a_fit_comes_to_the_place(text, off):
    true = parse_effect(text)
    log = record(PENDULUM, PENDULUM.plant(effects=(true,)), volts=NOISE, noise=1e-5)
    _, _, predictor = pieces(PENDULUM, log, NOISE, 1e-5)
    weighting = predictor.unfiltered_weighting(predictor.errors(PENDULUM.plant(effects=(true,))))
    fit = PredictionFit(predictor, weighting)
    start = Effect(true.kind, 1, {name: value + off.get(name, 0.0) for name, value in true.values.items()})
    found = fit.run(Point(PENDULUM.start, (start,)), [(0, name) for name in off], rounds=8)
    errors = fit.errors(Point(PENDULUM.start, (true,)))
    # better than the truth by what noise gives to so many parameters
    assert found.objective < fit.objective(errors, Point(PENDULUM.start, ()))
    # to the place where a fit from the truth ends
    best = fit.run(Point(PENDULUM.start, (true,)), [(0, name) for name in off], rounds=8)
    for name, change in off.items():
        left = abs(found.point.effects[0].values[name] - best.point.effects[0].values[name])
        assert left < 0.2 * abs(change), (name, found.point.effects[0].values)


def test_a_payload_is_placed_beside_the_plane_of_the_links_too():
    arm = load_mechanism()
    true = parse_effect("payload:mass=2.5,x=-0.02,y=0.04,z=0.59")
    log = record(arm, arm.plant(effects=(true,)), volts=NOISE, noise=1e-6, seconds=6.0)
    problem, _, predictor = pieces(arm, log, NOISE, 1e-6)
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(arm.plant(effects=(true,)))))
    base, _ = fit.to_end(Point(arm.start, ()), ())
    jacobian = fit.whitened(fit.derivatives(Point(arm.start, ()), ()))
    scored = Scored("payload", None, 0.0, values={"mass": 1.0, "x": 0.0, "y": 0.0, "z": 0.45})
    trial = Trials(predictor, problem).run(Base(fit, base, jacobian), scored, again=True)
    found, _ = fit.to_end(trial.model.point, trial.model.names)
    for name, off in {"mass": 0.3, "x": 0.02, "y": 0.01, "z": 0.08}.items():
        assert found.point.effects[0].values[name] == pytest.approx(true.values[name], abs=off), name


def test_a_fit_comes_back_from_where_parameters_took_the_place_of_an_effect():
    friction = parse_effect("coulomb_friction:joint=1,torque=0.02")
    fit, _ = fit_of(PENDULUM, friction, seconds=4.0)
    true = Point(PENDULUM.start, (friction,))
    far = Point(PENDULUM.clip(PENDULUM.start + 3.0 * PENDULUM.deviations), true.effects)
    pairs = ((0, "torque"),)
    known = Slopes.of(fit.whitened(fit.derivatives(true, pairs)))
    stopped = fit.run(far, (), jacobian=known, frozen=pairs, rounds=0)
    back = fit.from_start(stopped, known)
    assert back.objective < stopped.objective
    assert back.objective <= fit.objective(fit.errors(true), true)
    # one that is as low already stays as it is
    assert fit.from_start(back, known) is back


@pytest.mark.thorough
def test_a_log_without_any_noise_gives_the_truth():
    arm, friction = load_mechanism(), parse_effect("coulomb_friction:joint=2,torque=12")
    # a kind with more to fit comes to its end first here, and turns out to be Coulomb's
    found = explain(record(arm, arm.plant(effects=(friction,)), seconds=6.0))
    assert found.verdict == "NAMED"
    (named,) = found.effects
    torque = named.parameters["torque"]
    assert (named.name, named.joint) == ("coulomb_friction", 2)
    assert torque.value == pytest.approx(12.0, rel=2e-3) and torque.low < 12.0 < torque.high
    assert {each.name for each in (*named.tied_with, *named.ruled_out)} >= {
        "position_dependent_friction",
        "voltage_dead_band",
    }


@pytest.mark.parametrize("seed", range(5))
def test_a_bounded_step_is_the_least_that_its_bounds_allow(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((8, 5))
    normal, gradient = A.T @ A, 20.0 * rng.standard_normal(5)
    step = bounded_step(normal, gradient, 2)
    held = np.abs(step) == FITTING.greatest_step
    assert held[2:].any() and not held[:2].any() and np.all(np.abs(step[2:]) <= FITTING.greatest_step)
    # nothing is gained by moving what is not held
    assert np.abs((normal @ step + gradient)[~held]).max() < 1e-9 * np.abs(gradient).max()


@pytest.mark.parametrize("share", [0.0, 0.02, 0.2])
def test_a_stop_has_the_damping_that_the_log_shows(share):
    """Without it each bounce ends in a push that nothing explains. share : of the critical damping."""
    place, stiffness = HIGHEST - 0.1, 5.0
    signals = pieces(PENDULUM, record(PENDULUM, PENDULUM.plant()), NOISE, 1e-5)[0].signals(PENDULUM.start)
    inertia = float(signals.link_inertia[:, 0].mean() + signals.motor_inertia[0])
    asked = {"lower": -9.0, "upper": place, "stiffness": stiffness}
    true = Effect(KINDS["soft_stop"], 1, {**asked, "damping": 2.0 * share * float(np.sqrt(stiffness * inertia))})
    base, trials, _ = lacking(true)
    stops = KINDS["soft_stop"].screening.candidates(trials.problem.signals(PENDULUM.start), 0)
    near = min((c for c in stops if "upper" in c.grid), key=lambda c: abs(c.grid["upper"] - place))
    scored = Scored("soft_stop", 1, 0.0, values=near.values(np.array([stiffness])), occam=3.0)
    trial = trials.run(base, scored, again=True)
    ends, _ = base.fit.to_end(trial.model.point, trials.free(trial.model.point), patient=True)
    best, _ = base.fit.to_end(Point(PENDULUM.start, (true,)), trials.free(ends.point))
    found = ends.point.effects[0].values
    assert ends.objective < best.objective + 1.0
    critical = 2.0 * np.sqrt(found["stiffness"] * inertia)
    assert found["damping"] / critical == pytest.approx(share, abs=0.01), found
    assert found["stiffness"] == pytest.approx(stiffness, rel=0.05) and found["upper"] == pytest.approx(place, abs=1e-3)


def fit_of(mechanism, effect, seconds=1.0):
    """A fit to a log of a plant with an effect, and its innovations."""
    plant = mechanism.plant(effects=(effect,))
    log = record(mechanism, plant, volts=NOISE, noise=1e-5, seconds=seconds)
    _, _, predictor = pieces(mechanism, log, NOISE, 1e-5)
    raw = predictor.errors(plant)
    return PredictionFit(predictor, predictor.unfiltered_weighting(raw)), raw


def limited():
    """The fitted model of a log of a pendulum whose voltage has a limit, without it; the trials, the state of the
    selection, and a function of a limit [V] and parameters -> the trial from there."""
    limit = parse_effect("voltage_saturation:joint=1,voltage=4.2")
    base, trials, state = lacking(limit)
    scored = Scored("voltage_saturation", 1, 0.0, values={"voltage": 4.2}, occam=3.0)

    def tried(value, theta):
        return trials.run(base, scored, Point(theta, (Effect(limit.kind, 1, {"voltage": value}),)))

    return base, trials, state, tried


def test_a_limit_is_fitted_on_from_where_it_was_found_in_the_stage_before():
    base, trials, state, tried = limited()
    then, now = tried(4.2, PENDULUM.start), tried(6.0, base.model.point.theta)
    assert then.gain > 100.0 > 0.0 > now.gain
    refits = Refits(trials, KINDS)

    def resumed(accepted, stages=1):
        history = (Stage((then,), Threshold.alike(16.0), base.model, accepted),) * stages
        return refits.from_previous(replace(state, trials=(now,), history=history)).trials[0]

    elsewhere = replace(then, scored=replace(then.scored, joint=None))
    assert resumed(elsewhere).gain > then.gain - 1.0
    # there another explanation was better, and now there is less to explain
    assert resumed(then) is now
    assert resumed(elsewhere, stages=0) is now


def stretched_away():
    """A pendulum with a limit of its current: the trials, a state whose parameters are stretched, and a trial that is
    held at another limit, with a gain of 10 nat."""
    true = parse_effect("current_limit:joint=1,current=0.6")
    base, trials, state = lacking(true)
    far = Point(PENDULUM.start + np.array([5.0, 0.0, 0.0, 0.0]) * PENDULUM.deviations, ())
    errors = base.fit.errors(far)
    stretched = replace(base.model, point=far, errors=errors, objective=base.fit.objective(errors, far))
    scored = Scored("current_limit", 1, 0.0, values={"current": 6.0}, occam=3.0)
    level = Effect(true.kind, 1, {"current": 6.0})
    stuck = trials.judged(base.fit, stretched, scored, replace(stretched, point=Point(far.theta, (level,))))
    stuck = replace(stuck, gain=10.0, fitted=replace(stuck.fitted, names=((0, "current"),)))
    return trials, replace(state, model=stretched), stuck


def test_a_limit_starts_from_the_nominal_parameters_at_the_level_that_suits_these():
    """A limit of the current and the torque constant scale each other: stretched parameters have another level."""
    trials, state, stuck = stretched_away()
    again = Refits(trials, KINDS).from_nominal(replace(state, trials=(stuck,))).trials[0]
    assert again.effect.values["current"] == pytest.approx(0.6, rel=0.01)
    assert np.all(np.abs(again.model.point.theta - PENDULUM.start) < 0.2 * PENDULUM.deviations)


@pytest.mark.parametrize("gain", [-30.0, 30.0])
def test_what_gains_less_than_the_screening_saw_starts_from_there_too(gain):
    """Trials of nothing that lead the model itself to better parameters may be the best by their gain."""
    trials, state, stuck = stretched_away()
    others = (replace(stuck, gain=50.0),) * SELECTION.most_polished
    unseen = replace(stuck, gain=-20.0, scored=replace(stuck.scored, gain=0.0))
    seen = replace(stuck, gain=gain, scored=replace(stuck.scored, gain=100.0))
    behind = (*(unseen,) * SELECTION.most_polished, seen)
    *_, again = Refits(trials, KINDS).from_nominal(replace(state, trials=(*others, *behind))).trials
    assert again.effect.values["current"] == pytest.approx(0.6, rel=0.01)


def test_a_limit_that_ran_away_starts_from_there_too():
    """Seen on a simulated arm whose drive is held by its limit in nearly all rows: about parameters that the limit had
    stretched it came out at 239 A, and the log was called a fault."""
    trials, state, stuck = stretched_away()
    others = (replace(stuck, gain=50.0),) * SELECTION.most_polished
    away = replace(stuck, gain=-1000.0, problem=f"{IMPOSSIBLE}: current 239 A")
    *_, again = Refits(trials, KINDS).from_nominal(replace(state, trials=(*others, away))).trials
    assert again.effect.values["current"] == pytest.approx(0.6, rel=0.01) and again.problem is None


def test_a_trial_worse_than_the_model_without_it_starts_from_that_model():
    """Its parameters are those of a model that was fitted on since."""
    true = parse_effect("coulomb_friction:joint=1,torque=0.05")
    base, trials, state = lacking(true)
    good = trials.run(base, Scored("coulomb_friction", 1, 0.0, values=dict(true.values), occam=3.0))
    far = Point(PENDULUM.start + np.array([5.0, 0.0, 0.0, 0.0]) * PENDULUM.deviations, (true,))
    errors = base.fit.errors(far)
    left = replace(good.model, point=far, errors=errors, objective=base.fit.objective(errors, far))
    left = replace(good, fitted=left, gain=base.model.objective - left.objective - good.occam)
    assert left.gain < -100.0 and good.gain > 100.0
    refits = Refits(trials, KINDS)
    assert refits.from_base(replace(state, trials=(left,))).trials[0].gain == pytest.approx(good.gain, abs=1.0)
    assert refits.from_base(replace(state, trials=(good,))).trials == (good,)


def test_the_best_trial_is_fitted_to_its_end_with_none_near_it():
    """A fit that has not ended misfits in just its own direction, and lacks standard errors for it."""
    base, trials, state, tried = limited()
    rough = replace(tried(4.5, base.model.point.theta), validation_gain=10.0)
    (polished,) = Refits(trials, KINDS).polished(replace(state, trials=(rough,))).trials
    assert polished.gain > rough.gain


def test_a_bump_that_came_out_as_nothing_is_tried_again_as_machines_have_it():
    true = parse_effect("stribeck_friction:joint=1,torque=0.03,velocity=0.08,sliding=0.03")
    base, trials, state = lacking(true)
    refits = Refits(trials, KINDS)

    def tried(text):
        effect = parse_effect(text)
        scored = Scored(effect.kind.name, 1, 0.0, values=dict(effect.values))
        start = Point(PENDULUM.start, (effect,))
        return trials.run(base, scored, start)

    plain = tried("coulomb_friction:joint=1,torque=0.04")
    good = tried("stribeck_friction:joint=1,torque=0.03,velocity=0.08,sliding=0.03")
    nothing = Effect(
        true.kind,
        1,
        {**true.values, "torque": 0.0, "velocity": 1e-3, "sliding": plain.fitted.point.effects[0].values["torque"]},
    )
    stuck = replace(
        good, gain=plain.gain - 3.0, fitted=replace(plain.fitted, point=Point(plain.fitted.point.theta, (nothing,)))
    )

    def revived(trial):
        return refits.from_usual(replace(state, trials=(plain, trial))).trials

    assert good.gain > plain.gain + 10.0
    assert revived(stuck)[1].gain > good.gain - 1.0 and revived(stuck)[0] is plain
    # one that is more than what it contains stays as it is
    assert revived(good)[1] is good


def test_a_variation_whose_amplitude_stuck_at_zero_is_tried_from_every_side():
    true = parse_effect("position_dependent_friction:joint=1,torque=0.05,amplitude=0.03,angle=-2")
    base, trials, state = lacking(true)

    plain = tried(base, trials, "coulomb_friction:joint=1,torque=0.05")
    good = tried(base, trials, "position_dependent_friction:joint=1,torque=0.05,amplitude=0.03,angle=-2")
    level = plain.fitted.point.effects[0].values["torque"]
    nothing = Effect(true.kind, 1, {"torque": level, "amplitude": 0.0, "angle": 1.0})
    stuck = replace(
        good, gain=plain.gain - 3.0, fitted=replace(plain.fitted, point=Point(plain.fitted.point.theta, (nothing,)))
    )
    again = Refits(trials, KINDS).from_usual(replace(state, trials=(plain, stuck))).trials[1]
    assert good.gain > plain.gain + 10.0 and again.gain > good.gain - 1.0
    # at no amplitude no angle helps
    assert trials.run(base, stuck.scored, Point(plain.fitted.point.theta, (nothing,))).gain < good.gain - 10.0


def test_parameters_that_no_log_can_be_predicted_with_go_back_towards_their_start():
    """A stop that the model lacks drove them so far that explain ended with an error (record 991768)."""
    start, far = np.array([1.0, 2.0]), np.array([5.0, -2.0])

    def predictor(most):
        """Predicts with parameters up to some distance from their start."""

        def errors(theta):
            if np.linalg.norm(theta - start) > most:
                raise NonFiniteStateError(7)
            return np.zeros((10, 1))

        mechanism = SimpleNamespace(start=start, plant=lambda theta, effects: theta)
        return SimpleNamespace(mechanism=mechanism, errors=errors)

    whole = float(np.linalg.norm(far - start))
    assert np.array_equal(runnable(predictor(whole), far), far)
    assert runnable(predictor(0.4 * whole), far) == pytest.approx(start + 0.25 * (far - start))
    assert np.array_equal(runnable(predictor(0.0), far), start)


def test_a_drive_train_that_no_log_can_show_is_not_run():
    """Along 40 s of a log they would take tens of millions of steps."""
    base, _, _ = lacking(parse_effect("coulomb_friction:joint=1,torque=0.05"))

    def innovations(text):
        return base.fit.errors(Point(PENDULUM.start, (parse_effect(text),)))

    assert np.isfinite(innovations("joint_elasticity:joint=1,stiffness=300,damping=0.3")).all()
    assert innovations("joint_elasticity:joint=1,stiffness=1000,damping=1000") is None
    assert PENDULUM.plant(effects=(parse_effect("coulomb_friction:joint=1,torque=0.05"),)).least_rate == 0.0


def test_a_level_that_stuck_far_off_starts_from_the_one_of_what_contains_it():
    """Seen on the double pendulum: one level of friction had 4 nat at 0.165 N.m, and 118 as friction over the position
    without any variation."""
    base, trials, state = lacking(parse_effect("coulomb_friction:joint=1,torque=0.05"))

    plain = tried(base, trials, "coulomb_friction:joint=1,torque=0.05")
    rich = tried(base, trials, "asymmetric_coulomb_friction:joint=1,positive=0.05,negative=0.05")
    holding = Point(base.model.point.theta, (parse_effect("coulomb_friction:joint=1,torque=0.9"),))
    errors = base.fit.errors(holding)
    stuck = replace(plain.fitted, point=holding, errors=errors, objective=base.fit.objective(errors, holding))
    lost = replace(plain, fitted=stuck, gain=plain.gain - (stuck.objective - plain.model.objective))
    refits = Refits(trials, KINDS)
    again = refits.from_containing(replace(state, trials=(lost, rich))).trials
    assert plain.gain > lost.gain + 100.0 and again[0].gain > plain.gain - 1.0 and again[1] is rich
    # one that is better than what contains it stays, and so does one that nothing tried contains
    assert refits.from_containing(replace(state, trials=(plain, replace(rich, fitted=stuck)))).trials[0] is plain
    assert refits.from_containing(replace(state, trials=(lost,))).trials[0] is lost


@pytest.mark.parametrize(
    "text, volts, noise, least, most",
    [
        ("friction_warm_up:joint=2,share=0.85,time_constant=8", NOISE, 1e-5, 0.1, 0.95),
        ("resistance_drift:joint=2,share=0.3,time_constant=30", 0.1, 3e-5, 0.05, 0.8),
    ],
)
def test_a_share_that_a_short_log_does_not_tell_is_none_on_a_bound(text, volts, noise, least, most):
    arm = load_mechanism()
    true = parse_effect(text)
    plant = arm.plant(effects=(true,))
    log = record(arm, plant, volts=volts, noise=noise, seconds=4.0)
    problem, _, predictor = pieces(arm, log, volts, noise)
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(plant)))
    ends = []
    for share in (0.2, 0.99):
        time_constant = true.values["time_constant"] * share / true.values["share"]
        start = Point(arm.start, (Effect(true.kind, 2, {"share": share, "time_constant": time_constant}),))
        found, _ = fit.to_end(start, ((0, "share"), (0, "time_constant")))
        ends.append(found.point.effects[0])
    # the log tells how fast it begins, and the prior how far it goes
    assert all(least < end.values["share"] < most for end in ends)
    assert ends[0].values["share"] == pytest.approx(ends[1].values["share"], abs=0.1)
    assert all(Trials(predictor, problem).implausible(end) is None for end in ends)


def test_an_interval_follows_a_ridge():
    """A small variation may be a greater one about another angle: at the ends the other parameters have answered."""
    true = parse_effect("position_dependent_friction:joint=1,torque=0.02,amplitude=0.004,angle=2.8")
    volts, noise, plant = 0.3, 3e-4, PENDULUM.plant(effects=(true,))
    log = record(PENDULUM, plant, volts=volts, noise=noise)
    _, _, predictor = pieces(PENDULUM, log, volts, noise)
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(plant)))
    names = ((0, "torque"), (0, "amplitude"), (0, "angle"))
    model, _ = fit.to_end(Point(PENDULUM.start, (true,)), names)
    for (number, name), (value, low, high) in intervals(fit, model).items():
        assert low < value < high
        others = tuple(pair for pair in names if pair != (number, name))
        for end in (low, high):
            moved = Effect(true.kind, 1, {**model.point.effects[0].values, name: end})
            there, _ = fit.to_end(Point(model.point.theta, (moved,)), others)
            fall = there.objective - model.objective
            # 95 % of a normal distribution: 1.92 nat, or what the sandwich's width takes
            assert fall > 0.9 * 0.5 * FITTING.normal_quantile**2


@pytest.mark.parametrize("stiffness, damping", [(5e5, 150.0), (4e6, 20.0), (6e4, 900.0)])
def test_a_fit_takes_the_slopes_of_the_priors_that_its_objective_has(stiffness, damping):
    arm = load_mechanism()
    effect = parse_effect(f"backlash:joint=2,gap=1e-3,stiffness={stiffness},damping={damping}")
    fit, errors = fit_of(arm, effect)
    names = ("gap", "stiffness", "damping")
    slopes, precision = fit.prior(Point(arm.start, (effect,)), [(0, name) for name in names])

    def objective(name, share):
        moved = {**effect.values, name: effect.values[name] * np.exp(share)}
        return fit.objective(0.0 * errors, Point(arm.start, (Effect(effect.kind, 2, moved),)))

    for name, slope, curvature in zip(names, slopes, precision):
        before, here, after = (objective(name, share) for share in (-1e-3, 0.0, 1e-3))
        assert slope == pytest.approx((after - before) / 2e-3, abs=1e-6)
        assert curvature == pytest.approx((after + before - 2.0 * here) / 1e-6, abs=1e-3)
    assert precision[0] < 1e-3 < 1.0 < min(precision[1:])


def test_of_the_sizes_of_other_mechanisms_nothing_is_known_beforehand():
    effect = parse_effect("backlash:joint=1,gap=0.01,stiffness=1e4,damping=3")
    fit, _ = fit_of(PENDULUM, effect)
    slopes, precision = fit.prior(Point(PENDULUM.start, (effect,)), [(0, "gap"), (0, "stiffness")])
    assert not slopes.any() and precision.max() < 1e-3
    # but of a share as much
    drift = parse_effect("resistance_drift:joint=1,share=0.8,time_constant=9")
    slopes, precision = fit.prior(Point(PENDULUM.start, (drift,)), [(0, "share"), (0, "time_constant")])
    assert slopes[0] > 1.0 < precision[0] and slopes[1] == 0.0
