# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Fits of prediction errors come to places that have no zero: where a stop begins, when a blow
fell, how many waves a gear has a turn."""

from __future__ import annotations

import numpy as np
import pytest

from loop_logs import pieces, record
from puma_sim_core.effects import Effect, parse_effect
from puma_sim_core.loop.prediction import _FARTHEST, Point, PredictionFit, _bounded_step
from puma_sim_core.mechanisms import load_mechanism

pytestmark = pytest.mark.long
NOISE = 0.02
PENDULUM = load_mechanism("pendulum")
#: how far the undisturbed motion goes [rad]
HIGHEST = float(record(PENDULUM, PENDULUM.plant()).position.max())


@pytest.mark.parametrize("text, off", [
    (f"soft_stop:joint=1,lower=-9,upper={HIGHEST - 0.1},stiffness=0.3,damping=0",
     {"upper": -0.005, "stiffness": 0.1}),
    (f"soft_stop:joint=1,lower=-9,upper={HIGHEST - 0.1},stiffness=0.3,damping=0", {"upper": 0.008}),
    ("impulse:joint=1,torque=0.3,time=7.3,width=0.06", {"time": 0.02, "width": 0.01}),
    ("impulse:joint=1,torque=0.3,time=7.3,width=0.06", {"time": -0.02}),
    ("transmission_error:joint=1,amplitude=0.002,order=40,phase=1", {"order": 0.4})])
def test_a_fit_comes_to_the_place(text, off):
    true = parse_effect(text)
    log = record(PENDULUM, PENDULUM.plant(effects=(true,)), volts=NOISE, noise=1e-5)
    problem, _, predictor = pieces(PENDULUM, log, NOISE, 1e-5)
    weighting = predictor.white_weighting(predictor.errors(PENDULUM.plant(effects=(true,))))
    fit = PredictionFit(predictor, weighting)
    start = Effect(true.kind, 1, {name: value + off.get(name, 0.0)
                                  for name, value in true.values.items()})
    found = fit.run(Point(PENDULUM.start, (start,)), [(0, name) for name in off], rounds=8)
    errors = fit.errors(Point(PENDULUM.start, (true,)))
    # better than the truth by what noise gives to so many parameters
    assert found.objective < fit.objective(errors, Point(PENDULUM.start, ()))
    for name, change in off.items():
        left = abs(found.point.effects[0].values[name] - true.values[name])
        assert left < 0.2 * abs(change), (name, found.point.effects[0].values)


@pytest.mark.parametrize("seed", range(5))
def test_a_bounded_step_is_the_least_that_its_bounds_allow(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((8, 5))
    normal, gradient = A.T @ A, 20.0 * rng.standard_normal(5)
    step = _bounded_step(normal, gradient, 2)
    held = np.abs(step) == _FARTHEST
    assert held[2:].any() and not held[:2].any() and np.all(np.abs(step[2:]) <= _FARTHEST)
    # nothing is gained by moving what is not held
    assert np.abs((normal @ step + gradient)[~held]).max() < 1e-9 * np.abs(gradient).max()


def fit_of(mechanism, effect):
    """A fit to a second of a plant with an effect, and its innovations."""
    plant = mechanism.plant(effects=(effect,))
    log = record(mechanism, plant, volts=NOISE, noise=1e-5, seconds=1.0)
    problem, _, predictor = pieces(mechanism, log, NOISE, 1e-5)
    raw = predictor.errors(plant)
    return PredictionFit(predictor, predictor.white_weighting(raw)), raw


@pytest.mark.parametrize("stiffness, damping", [(5e5, 150.0), (4e6, 20.0), (6e4, 900.0)])
def test_a_fit_is_told_the_slopes_of_the_priors_that_its_objective_has(stiffness, damping):
    arm = load_mechanism()
    effect = parse_effect(f"backlash:joint=2,gap=1e-3,stiffness={stiffness},damping={damping}")
    fit, errors = fit_of(arm, effect)
    names = ("gap", "stiffness", "damping")
    slopes, told = fit.prior(Point(arm.start, (effect,)), [(0, name) for name in names])

    def objective(name, share):
        moved = {**effect.values, name: effect.values[name] * np.exp(share)}
        return fit.objective(0.0 * errors, Point(arm.start, (Effect(effect.kind, 2, moved),)))

    for name, slope, curvature in zip(names, slopes, told):
        before, here, after = (objective(name, share) for share in (-1e-3, 0.0, 1e-3))
        assert slope == pytest.approx((after - before) / 2e-3, abs=1e-6)
        assert curvature == pytest.approx((after + before - 2.0 * here) / 1e-6, abs=1e-3)
    assert told[0] < 1e-3 < 1.0 < min(told[1:])


def test_of_the_sizes_of_other_mechanisms_nothing_is_known_beforehand():
    effect = parse_effect("backlash:joint=1,gap=0.01,stiffness=1e4,damping=3")
    fit, _ = fit_of(PENDULUM, effect)
    slopes, told = fit.prior(Point(PENDULUM.start, (effect,)), [(0, "gap"), (0, "stiffness")])
    assert not slopes.any() and told.max() < 1e-3
