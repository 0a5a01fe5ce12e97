# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The statistics of the loop against independent forms: filters, noise, evidence, innovations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import on_grid, resting, sample
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise import residual as noise
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.screening.evidence import log_gain
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator

pytestmark = pytest.mark.long
STEP = 1e-3


@pytest.fixture(scope="module")
def arm():
    return load_mechanism()


@pytest.fixture(scope="module")
def true_log(arm):
    """(log without noise, voltages that reached the motors) of the nominal arm in free motion."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 6.0, STEP)
    volts = sum(
        rng.uniform(2.0, 5.0, 3) * np.sin(rng.uniform(2.0, 9.0, 3) * time[:, None] + rng.uniform(0.0, 6.0, 3))
        for _ in range(3)
    )
    simulator = Simulator(arm.plant(arm.start))
    simulator.reset((0.1, -0.9, 1.1))
    run = simulator.run(time, volts)
    return Log("true", time, volts, run.position)


def noisy(log, arm, volts, position, seed):
    """The log of the same arm whose voltages were disturbed, with noise on its positions."""
    rng = np.random.default_rng(seed)
    simulator = Simulator(arm.plant(arm.start))
    simulator.reset(log.position[0])
    run = simulator.run(log.time, log.voltage + volts * rng.standard_normal(log.voltage.shape))
    return Log("noisy", log.time, log.voltage, run.position + position * rng.standard_normal(run.position.shape))


def nothing_held(time):
    return np.zeros(len(time), dtype=bool)


def test_the_filter_gives_derivatives_of_a_motion_and_its_lag():
    time = np.arange(0.0, 6.0, STEP)
    motion = np.sin(3.0 * time) + 2.0 * time
    exact = (motion, 3.0 * np.cos(3.0 * time) + 2.0, -9.0 * np.sin(3.0 * time))
    inside = slice(200, -200)
    for found, wanted, bound in zip(filters.low_pass(motion, STEP, 50.0, (0, 1, 2)), exact, (1e-9, 1e-7, 1e-5)):
        assert np.abs(found - wanted)[inside].max() < bound
    (lagged,) = filters.low_pass(motion, STEP, 25.0, (0,), lag=0.003)
    assert np.abs(lagged - motion - 0.003 * exact[1])[inside].max() < 1e-7


def test_the_filter_has_the_response_that_it_states():
    time = np.arange(0.0, 8.0, STEP)
    for frequency in (5.0, 20.0, 30.0):
        wave = np.sin(2.0 * np.pi * frequency * time)
        (found,) = filters.low_pass(wave, STEP, 25.0)
        gain = found[1000:-1000] @ wave[1000:-1000] / (wave[1000:-1000] @ wave[1000:-1000])
        assert gain == pytest.approx(float(filters.response(frequency, 25.0)), abs=2e-3)


def test_uneven_logs_and_even_ones_give_the_same_motion():
    rng = np.random.default_rng(3)
    even = np.arange(0.0, 5.0, 4e-3)
    uneven = np.cumsum(rng.uniform(3.6e-3, 4.4e-3, 1250))
    logs = []
    for time in (even, uneven):
        q = np.column_stack([np.sin(2.0 * time + j) for j in range(3)])
        logs.append(Log("x", time, np.cos(time)[:, None] * np.ones(3), q))
    for log, bound in zip(logs, (1e-4, 2e-3)):
        s = sample([log])
        inside = slice(60, -60)
        assert np.abs(s.velocity[:, 0] - 2.0 * np.cos(2.0 * s.time))[inside].max() < bound
        # the mean of a held voltage lags by half a row, which the grid makes good
        assert np.abs(s.voltage[:, 0] - np.cos(s.time))[inside].max() < 6e-3


def test_rows_that_are_missing_are_filled_in_and_rows_that_are_late_move_no_other():
    rng, step = np.random.default_rng(4), 2e-3
    q = np.sin(9.0 * step * np.arange(2500.0))[:, None] + 1e-4 * rng.standard_normal((2500, 1))
    volts = rng.standard_normal((2500, 1))
    even = Log("even", step * np.arange(2500.0), volts, q)
    whole, kept = on_grid(even, step), np.delete(np.arange(2500), [500, 1200, 1201])
    found = on_grid(even.part(kept), step)
    np.testing.assert_allclose(found.time, whole.time, atol=1e-12)
    there = kept[1:] - 1
    np.testing.assert_array_equal(found.position[there], whole.position[there])
    assert np.abs(found.position - whole.position).max() < 1e-3
    held = np.delete(there, np.searchsorted(there, [499, 500, 1199, 1200, 1201]))
    np.testing.assert_array_equal(found.voltage[held], whole.voltage[held])
    # the first rows come late: the grid lies on all others, and so keeps their noise
    late = Log("late", np.r_[0.0, np.cumsum(np.r_[np.full(5, 3.3e-3), np.full(2494, step)])], volts, q)
    found = on_grid(late, step)
    rows = np.round(np.interp(found.time, late.time, np.arange(2500.0))).astype(int)
    assert (
        np.abs(found.position - late.position[rows])[10:].max()
        < 1e-6
        < np.abs(np.diff(late.position, 3, axis=0)).mean()
    )


@pytest.mark.parametrize("later", [0.0, 1000.0, 1.7e9])
def test_a_drive_that_is_always_on_is_never_switched_whatever_the_clock_says(true_log, arm, later):
    # every tenth row, off its time by up to a tenth of the step: the mean of `enable` is an integral with rounding
    rows = slice(None, None, 10)
    time = true_log.time[rows] + np.random.default_rng(8).uniform(0.0, 1e-3, len(true_log.time[rows]))
    log = Log("uneven", time + later, true_log.voltage[rows], true_log.position[rows])
    s = sample([log])
    assert (s.enable == 1.0).all()
    rests = resting(s.velocity, s.velocity_noise, s.step, s.cutoffs[1], s.stretches)
    np.testing.assert_array_equal(Problem(s, arm).usable, ~rests[s.kept()])


def test_sources_of_noise_are_told_apart_and_a_line_is_not_taken_for_noise(true_log, arm):
    s = sample([true_log])
    kept = s.kept()
    source = noise.sources(s, 0.3, 16.0, 0.003, len(kept))
    rng = np.random.default_rng(1)
    white = s.second(0.05 * rng.standard_normal((len(s.time), 1)))[kept, 0]
    budget = np.zeros(len(source.spectra))
    good = np.ones(len(kept), dtype=bool)
    stretches = [slice(0, len(kept))]
    weights = noise.fit_weights(source, s, white, good, stretches, budget)
    expected = 0.05**2 * source.covariances[0, 0]
    assert weights @ source.covariances[:, 0] == pytest.approx(expected, rel=0.35)
    line = white + 0.2 * np.sin(2.0 * np.pi * 5.3 * s.time[kept])
    with_line = noise.fit_weights(source, s, line, good, stretches, budget)
    # the line has two hundred times the noise's variance
    assert with_line @ source.covariances[:, 0] < 4.0 * expected
    assert np.var(line) > 150.0 * expected


def test_the_gain_of_evidence_is_that_of_two_normal_distributions():
    rng = np.random.default_rng(2)
    n = 40
    N, X = rng.standard_normal((n, 3)), rng.standard_normal((n, 2))
    deviation, mean = np.array([0.5, 2.0]), np.array([0.3, -1.0])
    y = N @ [1.0, -0.5, 0.2] + X @ [0.6, -1.4] + rng.standard_normal(n)

    prior = np.array([1.0, 0.7, 2.0])
    before = np.eye(n) + N @ np.diag(prior**2) @ N.T
    after = before + X @ np.diag(deviation**2) @ X.T
    wanted = multivariate_normal(X @ mean, after).logpdf(y) - multivariate_normal(np.zeros(n), before).logpdf(y)
    P = np.linalg.inv(before)
    gain, coefficients, _ = log_gain(X.T @ P @ X, X.T @ P @ y, mean, deviation)
    assert gain == pytest.approx(wanted, rel=1e-9)
    assert coefficients == pytest.approx([0.6, -1.4], abs=0.5)


def test_a_true_model_has_no_innovations(true_log, arm):
    predictor = Predictor([true_log], arm, [nothing_held], np.full(3, 0.05), np.full(3, 3e-5))
    errors = predictor.errors(arm.plant(arm.start))
    settled = errors[1000:]
    assert np.abs(settled).max() < 2e-7
    # the step of integration of the log's own making is another one: 1.2e-7 rad


def test_innovations_of_a_true_model_are_white_and_as_large_as_its_noise_says(true_log, arm):
    log = noisy(true_log, arm, 0.05, 3e-5, 11)
    predictor = Predictor([log], arm, [nothing_held], np.full(3, 0.05), np.full(3, 3e-5))
    errors = predictor.errors(arm.plant(arm.start))[300:]
    for j in range(3):
        e = errors[:, j]
        # inertias vary along the motion, and the gain is that of their mean
        assert e.std() == pytest.approx(predictor.spread[j], rel=0.05)
        for lag in (1, 2, 5, 20, 100):
            assert abs(e[lag:] @ e[:-lag]) / (e @ e) < 4.5 / np.sqrt(len(e))


def test_a_voltage_that_the_model_lacks_is_read_back_from_innovations(true_log, arm):
    time = true_log.time
    missing = 0.3 * np.sin(2.0 * np.pi * 1.5 * time)
    volts = true_log.voltage.copy()
    volts[:, 1] += missing  # commanded, and lost on the way
    log = Log("lost", time, volts, true_log.position)
    predictor = Predictor([log], arm, [nothing_held], np.full(3, 0.05), np.full(3, 3e-5))
    found = predictor.in_volts(predictor.errors(arm.plant(arm.start)), 25.0)
    part = slice(600, -600)
    wanted = np.interp(predictor.stretches[0].time[1:], time, missing)
    assert np.abs(found[part, 1] - wanted[part]).max() < 0.03
    # joint 1 is shaken by joint 2 through its inertia: a tenth
    assert np.abs(found[part][:, [0]]).max() < 0.06


def test_a_fit_of_prediction_errors_finds_the_parameters_and_the_effect(true_log, arm):
    from puma_sim_core.effects import parse_effect

    start = parse_effect("voltage_offset:joint=2,voltage=0.05")
    volts = true_log.voltage.copy()
    volts[:, 1] += 0.12
    log = noisy(
        Log("offset", true_log.time, volts, true_log.position),
        type(
            "A",
            (),
            {
                "plant": lambda self, theta: arm.plant(
                    arm.start, (parse_effect("voltage_offset:joint=2,voltage=0.12"),)
                ),
                "start": arm.start,
            },
        )(),
        0.05,
        3e-5,
        4,
    )
    predictor = Predictor([log], arm, [nothing_held], np.full(3, 0.05), np.full(3, 3e-5))
    errors = predictor.errors(arm.plant(arm.start))
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(errors))
    found = fit.run(Point(arm.start, (start,)), ((0, "voltage"),), rounds=3)
    assert found.point.effects[0].values["voltage"] == pytest.approx(0.12, abs=0.02)
    assert np.abs((found.point.theta - arm.start) / arm.deviations).max() < 2.5


@pytest.mark.parametrize("step", (1e-3, 5e-3, 0.02))
@pytest.mark.parametrize("name, noise", (("pendulum", 1e-4), ("pendulum", 1e-3), ("slide", 1e-6)))
def test_a_predictor_without_a_noise_of_its_own_forgets_within_the_settling_time(name, noise, step):
    mechanism = load_mechanism(name)
    time = step * np.arange(int(3.0 / step))
    still = Log("still", time, np.zeros((len(time), 1)), np.zeros((len(time), 1)))
    predictor = Predictor([still], mechanism, [nothing_held], None, np.array([noise]))
    F, _, gain = predictor.linear[0]
    kept = F @ (np.eye(len(F)) - np.outer(gain, np.eye(1, len(F))))
    slowest = np.abs(np.linalg.eigvals(kept)).max()
    assert slowest ** (FITTING.settling_time / step) <= FITTING.forgotten * 1.001
    # and is no faster than that, or the least noise of the voltage, asks for
    drive = mechanism.drive(mechanism.start)
    least = FITTING.least_gain_noise * drive.volts_per_torque * mechanism.torque_scale
    assert np.all(predictor.volts >= least * (1.0 - 1e-12))
    if predictor.volts[0] == pytest.approx(float(least[0])):
        return
    slower = Predictor([still], mechanism, [nothing_held], 0.9 * predictor.volts, np.array([noise]))
    F, _, gain = slower.linear[0]
    kept = F @ (np.eye(len(F)) - np.outer(gain, np.eye(1, len(F))))
    assert np.abs(np.linalg.eigvals(kept)).max() > slowest


def test_what_is_read_back_at_the_end_of_a_log_is_as_good_as_elsewhere(true_log, arm):
    volts = true_log.voltage.copy()
    volts[:, 1] += 0.3
    predictor = Predictor(
        [Log("lost", true_log.time, volts, true_log.position)], arm, [nothing_held], np.full(3, 0.05), np.full(3, 3e-5)
    )
    found = predictor.in_volts(predictor.errors(arm.plant(arm.start)), 25.0)[:, 1]
    assert np.abs(found[600:] - 0.3).max() < 0.03


def test_the_floor_in_volts_is_that_of_innovations_which_the_weighting_makes_white(true_log, arm):
    predictor = Predictor([true_log], arm, [nothing_held], np.full(3, 0.05), np.full(3, 3e-5))
    rng = np.random.default_rng(2)
    taps = np.array([1.0, -0.6, 0.1])
    weighting = Weighting(np.tile(taps, (3, 1)), np.array([1e-5, 2e-5, 3e-5]), predictor.lengths)
    white = rng.standard_normal((predictor.lengths[0], 3))
    errors = lfilter([1.0], taps, white, axis=0) * weighting.scale
    assert np.allclose(weighting(errors), white)
    measured = predictor.in_volts(errors, 25.0)[200:-200].std(axis=0)
    assert predictor.floor_in_volts(25.0, weighting) == pytest.approx(measured, rel=0.15)
