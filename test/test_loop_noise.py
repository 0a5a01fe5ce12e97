# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The noise of innovations and the free curves that are judged in it, against independent forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter, oaconvolve

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.fitting import intervals
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise import innovations
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.residuals import shape
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator

pytestmark = pytest.mark.long
STEP = 1e-3
VOLTS, POSITION = 0.05, 3e-5


@pytest.fixture(scope="module")
def predictor():
    """Of the nominal arm, along a motion of its own with noise."""
    arm, rng = load_mechanism(), np.random.default_rng(5)
    time = np.arange(0.0, 10.0, STEP)
    volts = sum(
        rng.uniform(2.0, 5.0, 3) * np.sin(rng.uniform(2.0, 9.0, 3) * time[:, None] + rng.uniform(0.0, 6.0, 3))
        for _ in range(3)
    )
    simulator = Simulator(arm.plant(arm.start))
    simulator.reset((0.1, -0.9, 1.1))
    run = simulator.run(time, volts + VOLTS * rng.standard_normal(volts.shape))
    log = Log("own", time, volts, run.position + POSITION * rng.standard_normal(volts.shape))
    return Predictor([log], arm, [lambda t: (t > 4.0) & (t < 5.0)], np.full(3, VOLTS), np.full(3, POSITION))


def lasting(predictor, joint, seed, time=0.05, volts=0.3):
    """Innovations of a disturbance that lasts, past the observer, and white ones [rad]."""
    rng, n = np.random.default_rng(seed), predictor.lengths[0]
    keep = np.exp(-STEP / time)
    drive = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], volts * rng.standard_normal(n))
    passed = oaconvolve(drive, predictor.responses[joint])[:n]
    return passed + predictor.spread[joint] * rng.standard_normal(n)


def test_a_filter_of_minimum_phase_has_the_inverse_spectrum_and_the_greatest_first_tap():
    frequency = np.fft.rfftfreq(4096, STEP)
    turn = np.exp(-2j * np.pi * frequency * STEP)
    known = np.array([0.7, -0.4, 0.1])  # zeros within the unit circle, so of minimum phase
    spectrum = 2.0 * STEP / np.abs(np.polynomial.polynomial.polyval(turn, known)) ** 2
    taps = innovations._whitening(spectrum, STEP, 4096)
    assert np.abs(taps[:3] - known).max() < 1e-9
    assert np.abs(taps[3:]).max() < 1e-9


def test_noise_that_lasts_is_made_white_and_of_variance_one(predictor):
    errors = np.column_stack([lasting(predictor, j, 10 + j) for j in range(3)])
    white = innovations.weighting(predictor, errors)(errors)[2000:]
    for j in range(3):
        e = white[:, j]
        assert e.var() == pytest.approx(1.0, abs=0.12)
        slow = e[: len(e) // 50 * 50].reshape(-1, 50).mean(axis=1) * np.sqrt(50.0)
        raw = errors[2000:, j] / errors[2000:, j].std()
        assert slow.var() < 1.8
        # which is no wonder of the averaging: the innovations as they are fail by far
        assert raw[: len(e) // 50 * 50].reshape(-1, 50).mean(axis=1).var() * 50.0 > 4.0


def test_a_line_is_not_taken_for_noise(predictor):
    errors = np.column_stack([lasting(predictor, j, 20 + j) for j in range(3)])
    time = STEP * np.arange(len(errors))
    line = errors.copy()
    line[:, 1] += 3.0 * errors[:, 1].std() * np.sin(2.0 * np.pi * 6.0 * time)
    before = innovations.weighting(predictor, errors)(errors)[:, 1].std()
    with_line = innovations.weighting(predictor, line)
    assert with_line(errors)[:, 1].std() == pytest.approx(before, rel=0.1)
    # of white noise this is about 1
    wave = np.exp(-2j * np.pi * 6.0 * time) / np.sqrt(len(time))
    assert abs(wave @ with_line(errors)[:, 1]) < 4.0
    assert abs(wave @ with_line(line)[:, 1]) > 10.0


def test_slow_noise_that_a_fit_took_up_is_still_expected(predictor):
    n = predictor.lengths[0]
    modes = np.cos(np.pi / n * np.outer(np.arange(n) + 0.5, np.arange(20)))
    modes /= np.linalg.norm(modes, axis=0)  # a half to 10 periods in 10 s: slower than 1 Hz
    found = []
    for seed in range(40, 120, 10):
        errors = np.column_stack([lasting(predictor, j, seed + j, time=0.0265, volts=0.04) for j in range(3)])
        white = innovations.weighting(predictor, errors - modes @ (modes.T @ errors))(errors)
        found.append(((modes[:, 1:].T @ white) ** 2).mean(axis=0))
    # of white noise each is about 1; humps that go to zero at rest leave 8 on average, and 83 once
    assert np.mean(found) < 3.0 and np.max(found) < 10.0


def test_what_was_filtered_before_is_undone(predictor):
    errors = np.column_stack([lasting(predictor, j, 30 + j) for j in range(3)])
    before = Weighting(np.array([[1.0, -0.6]] * 3), np.array([2e-5] * 3), predictor.lengths)
    straight = innovations.weighting(predictor, errors)(errors)
    undone = innovations.weighting(predictor, before(errors), before)(errors)
    assert np.abs(undone - straight)[2000:].std() < 0.1


def test_a_filter_does_not_reach_from_one_log_into_the_next():
    taps = np.array([[1.0, 0.5, 0.25]])
    values = np.zeros((20, 1))
    values[9, 0] = 1.0
    out = Weighting(taps, np.ones(1), (10, 10))(values)
    assert out[9, 0] == 1.0 and not out[10:].any()
    assert Weighting(taps, np.ones(1), (20,))(values)[10, 0] == 0.5


def test_long_and_short_filters_do_the_same():
    rng = np.random.default_rng(3)
    taps = np.zeros((2, 200))
    taps[:, :40] = rng.standard_normal((2, 40))
    values = rng.standard_normal((700, 2, 3))
    long = Weighting(taps, np.array([1.0, 2.0]), (300, 400))(values)
    short = Weighting(taps[:, :40], np.array([1.0, 2.0]), (300, 400))(values)
    assert np.abs(long - short).max() < 1e-11


def test_a_play_follows_its_input_at_the_distance_of_its_half_width():
    values = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.0, -1.0, 100), np.linspace(-1.0, 0.5, 80)])
    held = shape.play(values, np.zeros(len(values)), 0.2)
    assert np.abs(held).max() <= 0.2 + 1e-12
    assert held[49] == pytest.approx(0.2) and held[149] == pytest.approx(-0.2)
    # the loop between two turning points does not depend on what went before (wiping out)
    other = shape.play(np.concatenate([np.sin(np.arange(40.0)), values]), np.zeros(len(values) + 40), 0.2)
    assert np.abs(other[40 + 60 :] - held[60:]).max() < 1e-12
    # and depends on the order of values alone, not on the rate
    twice = shape.play(np.repeat(values, 2), np.zeros(2 * len(values)), 0.2)
    assert np.array_equal(twice[::2], held)


def test_a_play_starts_anew_in_each_log():
    values = np.array([0.0, 1.0, 1.0, 5.0, 5.1])
    held = shape.play(values, np.array([0.0, 0.0, 0.0, 1.0, 1.0]), 0.2)
    assert held[2] == pytest.approx(0.2) and held[3] == 0.0 and held[4] == pytest.approx(0.1)


def test_a_profile_is_the_interval_of_a_quadratic_and_wider_where_the_likelihood_is_not(predictor):
    arm = predictor.mechanism
    effect = parse_effect("voltage_offset:joint=2,voltage=0.05")
    raw = predictor.errors(arm.plant(arm.start, (effect,)))
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(raw))
    found = fit.run(Point(arm.start, (effect,)), ((0, "voltage"),), rounds=4)
    jacobian = fit.whitened(fit.derivatives(found.point, found.names))
    found = Fitted(found.point, found.errors, found.objective, found.names, jacobian)
    spread, wider = (each[0] for each in intervals.deviations(fit, found))
    for sign in (-1.0, 1.0):
        steps = [sign * share * 1.96 * spread for share in FITTING.profile_shares]
        reach, fallen, _ = intervals._profile(found, 0, steps, wider, intervals._fitted_on(fit, found, 0))
        assert fallen and reach == pytest.approx(1.96 * spread, rel=0.15)
    _value, low, high = intervals.intervals(fit, found)[0, "voltage"]
    assert low < 0.0 < high, "nothing was there"


@pytest.mark.parametrize("name, amplitude, friction", [("pendulum", 1.5, 0.02), ("puma560", 8.0, 5.0)])
def test_a_log_of_few_rows_is_predicted_with_the_greatest_step_that_is_exact(name, amplitude, friction):
    """A machine without windings needs fewer steps of integration than one with them; neither notices it."""
    mechanism, rng = load_mechanism(name), np.random.default_rng(7)
    time = np.arange(0.0, 10.0, 0.005)
    shape = (len(time), mechanism.joints)
    volts = amplitude * np.sin(np.linspace(2.0, 5.0, mechanism.joints) * time[:, None])
    plant = mechanism.plant(mechanism.start, (parse_effect(f"coulomb_friction:joint=1,torque={friction}"),))
    simulator = Simulator(plant, max_step=1e-4)
    simulator.reset((0.1, -0.9, 1.1)[: mechanism.joints])
    run = simulator.run(time, volts)
    log = Log("own", time, volts, run.position + POSITION * rng.standard_normal(shape))
    noise = np.full(mechanism.joints, POSITION)
    predictor = Predictor([log], mechanism, [lambda t: t > 9.0], None, noise)
    windings = max(motor.inductance for motor in plant.arm.motors) > 0.0
    assert predictor.greatest_step == (FITTING.greatest_step_time if windings else max(FITTING.further_steps))
    found = predictor.errors(plant)
    predictor.greatest_step = 1e-4
    exact = predictor.errors(plant)
    change = np.sqrt(np.mean((found - exact) ** 2, axis=0))
    assert np.all(change < 0.02 * np.array(predictor.spread))
