# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Errors of models at rows that their parameters were not fitted to."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from loop_logs import pieces, record
from scipy.optimize import minimize_scalar

from puma_sim_core.effects import Effect, parse_effect
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.noise.open_loop import NoiseFloor
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.selection import cross_validation
from puma_sim_core.identify.selection.cross_validation import CrossValidation, Fold, WeightedModel
from puma_sim_core.identify.selection.validate import Validation
from puma_sim_core.plant.mechanism_file import load_mechanism

pytestmark = pytest.mark.long
NOISE = 0.05


def ones(rows):
    """A spread of one joint."""
    return np.ones((rows, 1))


def fits(*true, place=0.5):
    """(the folds, function of an effect and its free parameters -> the model fitted with it)
    of a log of the pendulum with effects."""
    mechanism = load_mechanism("pendulum")
    effects = tuple(parse_effect(text) for text in true)
    log = record(mechanism, mechanism.plant(effects=effects), volts=NOISE, noise=1e-5)
    problem, rows, predictor = pieces(mechanism, log, NOISE, 1e-5, place)
    weighting = predictor.unfiltered_weighting(predictor.errors(mechanism.plant(effects=effects)))
    fit = PredictionFit(predictor, weighting)

    def fitted(text, *names):
        point = Point(mechanism.start, (parse_effect(text),) if text else ())
        return WeightedModel(fit.run(point, [(0, name) for name in names]), weighting)

    return CrossValidation.of(problem, predictor, rows), fitted


@pytest.mark.parametrize("place", (0.5, 0.2, 0.8))
def test_folds_cover_a_log_without_overlap(place):
    folds, _ = fits(place=place)
    times = sum(fold.predictor.validation_rows.astype(int) for fold in folds.folds)
    usable = folds.folds[0].predictor
    usable = usable.fit_rows | usable.validation_rows
    # but for a row at a border
    assert np.mean(times[usable] == 1) > 0.99 and not times[~usable].any()
    for fold in folds.folds:
        assert fold.predictor.validation_rows.any()
        assert not (fold.predictor.validation_rows & fold.predictor.fit_rows).any()
        assert len(fold.validation.lengths("held_out")) >= 3


def test_what_is_there_lowers_the_error_and_what_is_not_does_not():
    friction = "coulomb_friction:joint=1,torque=0.02"
    folds, fitted = fits(friction)
    with_it, without = fitted(friction, "torque"), fitted(None)
    assert folds.better(with_it, without)
    assert not folds.better(without, with_it)
    assert not folds.better(without, without)


@pytest.mark.parametrize(
    "more, densities, better, as_good",
    [
        ([-1.0, -1.1, -0.9, -1.0], [-5.0], True, True),  # less error in the windows
        ([1.0, 1.1, 0.9, 1.0], [5.0, -6.0], False, False),  # more of it, beyond two standard errors
        ([3.0, -1.0, -1.0, 0.0], [5.0], True, True),  # more of it, within two: the density decides
        ([3.0, -1.0, -1.0, 0.0], [-5.0], False, False),
        ([3.0, -1.0, -1.0, 0.0], [-5.0, 1.0, 2.0, 1.0], False, True),  # less of it, by chance
        ([3.0, -1.0, -1.0, 0.0], [-5.0, -6.0, -5.0, -5.0], False, False),  # and beyond
        ([3.0, -1.0, -1.0, 0.0], [-np.inf, 1.0], False, False),  # a model that cannot be run
        ([np.nan, np.nan, np.nan, np.nan], [-5.0], True, True),  # nothing to measure it at
    ],
)
def test_windows_decide_beyond_two_standard_errors_and_else_the_density(monkeypatch, more, densities, better, as_good):
    """as_good : whether a model passes that need not be better."""
    folds = CrossValidation([None] * 4)
    one, other = SimpleNamespace(name="one"), SimpleNamespace(name="other")
    windows = {"one": [10.0 + m for m in more], "other": [10.0] * 4}
    monkeypatch.setattr(folds, "_points", lambda model: windows[model.name])
    monkeypatch.setattr(folds, "_window_square", lambda fold, point: point)
    found = {"one": np.array(densities), "other": np.zeros(len(densities))}
    monkeypatch.setattr(folds, "_densities", lambda model, points: found[model.name])
    assert folds.better(one, other) is better
    assert folds.better(one, other, as_good=True) is as_good


@pytest.mark.parametrize(
    "of_effects, densities, better",
    [
        (9.0, [5.0, 6.0, 5.0, 5.0], True),  # with the other parameters the effects predict better
        (11.0, [5.0, 6.0, 5.0, 5.0], False),  # nor with these
        (9.0, [5.0, -6.0, 5.0, -1.0], False),  # the density is greater by chance
    ],
)
def test_where_windows_and_density_contradict_each_other_the_effects_decide(monkeypatch, of_effects, densities, better):
    """Seen on a blind record: a gap of 3 mrad had 6232 nat in the folds, and its fit parameters 3.5 deviations off."""
    folds = CrossValidation([None] * 4)
    models = {"one": Point("astray", ("gap",)), "other": Point("right", ())}
    squares = {("astray", ("gap",)): 12.0, ("right", ()): 10.0, ("right", ("gap",)): of_effects}
    found = {"one": np.array(densities), "other": np.zeros(4)}
    monkeypatch.setattr(folds, "_points", lambda model: [models[model.name]] * 4)
    monkeypatch.setattr(folds, "_window_square", lambda fold, point: squares[point.theta, point.effects])
    monkeypatch.setattr(folds, "_densities", lambda model, points: found[model.name])
    one, other = SimpleNamespace(name="one"), SimpleNamespace(name="other")
    assert folds.better(one, other) is folds.better(one, other, as_good=True) is better
    assert folds.better(other, one)


def test_in_a_noise_that_open_loop_errors_refute_a_density_must_be_greater_beyond_chance(monkeypatch):
    """Nats of such a noise have no size, but their mean over its standard error has."""
    folds, asked = CrossValidation([None] * 4), []
    windows = {name: [13.0, 9.0, 9.0, 10.0] for name in ("more", "clearly", "never")}
    windows |= {"same": [10.0] * 4, "less": [9.0, 9.5, 9.0, 10.0]}
    densities = {"more": [9.0, -2.0, -1.0, -1.0], "clearly": [2.0, 1.0, 1.0, 1.0], "never": [-np.inf, 1.0, 1.0, 1.0]}
    monkeypatch.setattr(folds, "_points", lambda model: windows[model.name])
    monkeypatch.setattr(folds, "_window_square", lambda fold, point: point)
    monkeypatch.setattr(folds, "_densities", lambda model, points: np.array(densities.get(model.name, np.zeros(4))))

    def better(name: str, holds: bool, as_good: bool = False) -> bool:
        asked.clear()
        models = (SimpleNamespace(name=each) for each in (name, "same"))
        return folds.better(*models, lambda: bool(asked.append(name)) or holds, as_good)

    assert better("more", True) and asked == ["more"]
    assert not better("more", False) and asked == ["more"]
    assert better("more", False, as_good=True)  # more by chance
    assert better("clearly", False) and asked == ["clearly"]
    assert not better("never", False) and not better("never", True)  # a model that cannot be run
    assert better("less", False) and not asked  # the windows tell: nobody asks for the noise


def test_each_fold_is_predicted_by_parameters_fitted_to_the_others():
    folds, fitted = fits("coulomb_friction:joint=1,torque=0.02")
    model = fitted("coulomb_friction:joint=1,torque=0.02", "torque")
    points = folds._points(model)
    # the choice's own quarter was kept back from the fit already
    assert points[0] is model.fitted.point
    for fold, point in zip(folds.folds[1:], points[1:]):
        fit = PredictionFit(fold.predictor, model.weighting)
        # derivatives about itself, as exact as can be
        exact = fit.run(point, model.fitted.names, rounds=4)
        assert exact.objective > fit.objective(fit.errors(point), point) - 0.05
        assert point.key != model.fitted.point.key
    assert folds._points(model) is points


def test_the_errors_are_those_of_all_windows_together():
    folds, fitted = fits()
    model = fitted(None)
    points = folds._points(model)
    parts = [fold.validation.window_errors(folds._plant(point), "held_out") for fold, point in zip(folds.folds, points)]
    together = np.sqrt(sum((e**2).sum() for e in parts) / sum(len(e) for e in parts))
    assert np.allclose(folds.position_rms(model), together, rtol=1e-12)
    start = Point(folds.folds[0].predictor.mechanism.start, ())
    models = {"nominal": start, "retuned": model, "augmented": model}
    tables = folds.errors(models, NoiseFloor(np.array([0.1]), ones))
    assert np.array_equal(tables["held_out"].position_rms.augmented, folds.position_rms(model))
    assert np.array_equal(tables["unseen"].position_rms.retuned, folds.unseen(model.fitted.point))
    assert np.array_equal(tables["unseen"].position_rms.nominal, folds.unseen(start))


def test_what_the_other_folds_tell_nothing_of_follows_what_they_do_tell():
    blow = "impulse:joint=1,torque=0.5,time=5.0,width=0.1"
    folds, fitted = fits(blow, place=0.2)
    model = fitted(blow, "torque")
    holds = [bool(fold.predictor.validation_rows[int(5.0 / 2e-3)].all()) for fold in folds.folds]
    assert sum(holds) == 1 and not holds[0]
    point = folds._points(model)[holds.index(True)]
    assert not np.array_equal(point.theta, model.fitted.point.theta)
    # the torque is the best of the whole log beside the parameters without the fold
    fit = PredictionFit(folds.folds[0].predictor, model.weighting)

    def worse(torque):
        effect = point.effects[0]
        at = Point(point.theta, (Effect(effect.kind, 1, {**effect.values, "torque": torque}),))
        return fit.objective(fit.errors(at), at)

    best = minimize_scalar(worse, bounds=(0.2, 0.9), method="bounded", options={"xatol": 1e-6}).x
    before, after = (p.effects[0].values["torque"] for p in (model.fitted.point, point))
    assert abs(before - best) > 1e-4 and abs(after - best) < 0.1 * abs(before - best)
    # without the blow the parameters give way to it
    assert folds.better(model, fitted(None))


def test_what_a_fold_tells_nothing_of_spoils_none_of_its_rows(monkeypatch):
    """Seen where a joint rests but in one fold: a step that is linear took all friction from it in that fold."""
    blow = "impulse:joint=1,torque=0.5,time=5.0,width=0.1"
    folds, fitted = fits(blow, place=0.2)
    model, far = fitted(blow, "torque"), []

    def too_long(fit, whole, jacobian, free, point):
        far.append(Point(point.theta + 9.0 * folds.folds[0].predictor.mechanism.deviations, point.effects))
        return far[-1]

    monkeypatch.setattr(cross_validation, "_completed", too_long)
    points = folds._points(model)
    assert len(far) == 1 and far[0].key not in [point.key for point in points]
    for fold, point in zip(folds.folds, points):
        fit = PredictionFit(fold.predictor, model.weighting)
        own, whole = (fit.objective(fit.errors(at), at) for at in (point, model.fitted.point))
        assert own <= whole


def test_logs_for_validation_are_predicted_as_they_are():
    mechanism = load_mechanism("pendulum")
    problem, rows, predictor = pieces(mechanism, record(mechanism, mechanism.plant()))
    whole = Problem(problem.sampled, mechanism, None)
    folds = CrossValidation.of(whole, predictor, rows)
    assert len(folds.folds) == 1 and folds.folds[0].unseen
    point = Point(mechanism.start * 1.01, ())
    weighting = predictor.unfiltered_weighting(predictor.errors(mechanism.plant()))
    model = WeightedModel(Fitted(point, np.zeros((0, 1)), 0.0, ()), weighting)
    assert folds._points(model) == [point]
    assert set(
        folds.errors({"nominal": point, "retuned": model, "augmented": model}, NoiseFloor(np.ones(1), ones))
    ) == {"held_out"}


def test_without_any_window_nothing_is_said_against_a_name():
    mechanism = load_mechanism("pendulum")
    problem, _, predictor = pieces(mechanism, record(mechanism, mechanism.plant()))
    none = [lambda t: np.zeros(len(t), dtype=bool)]
    whole = problem.at(problem.place)
    whole.validation[:] = False
    bare = predictor.validated_at(none)
    folds = CrossValidation([Fold(bare, Validation(whole, bare), True)])
    weighting = predictor.unfiltered_weighting(predictor.errors(mechanism.plant()))
    model = WeightedModel(Fitted(Point(mechanism.start, ()), np.zeros((0, 1)), 0.0, ()), weighting)
    assert np.isnan(folds.position_rms(model)).all()
    assert folds.better(model, model)
