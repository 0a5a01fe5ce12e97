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
    problem, with_blocks = pieces(PENDULUM, log, NOISE, 1e-5)
    predictor = with_blocks(problem)
    weighting = predictor.white_weighting(predictor.errors(PENDULUM.plant(effects=(true,))))
    fit = PredictionFit(predictor, weighting)
    start = Effect(true.kind, 1, {name: value + off.get(name, 0.0)
                                  for name, value in true.values.items()})
    found = fit.run(Point(PENDULUM.start, (start,)), [(0, name) for name in off], rounds=8)
    errors = fit.errors(Point(PENDULUM.start, (true,)))
    # better than the truth by what noise gives to so many parameters
    assert found.objective < fit.objective(errors, PENDULUM.start)
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
