# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Open-loop windows of logs of any mechanism, what is kept back, and their floor."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from loop_logs import SECONDS, STEP, record, validation
from mechanism_support import NAMES
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import lfilter

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.fitting.steps import parts_of_steps, stable_step
from puma_sim_core.identify.noise.innovations import weighting
from puma_sim_core.identify.noise.open_loop import (
    RowNoise,
    noise_behind,
    position_floor,
    stationary_covariance,
    variance_of_innovations,
    variance_of_rows,
)
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.selection.validate import rms
from puma_sim_core.identify.settings import SELECTION
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.tracking import innovations

pytestmark = pytest.mark.long


@pytest.mark.parametrize("name", NAMES)
def test_windows_of_the_true_plant_stay_on_the_log(name):
    mechanism = load_mechanism(name)
    seen = validation(mechanism, record(mechanism, mechanism.plant()))
    for key in ("fit", "held_out"):
        true = rms(seen.window_errors(mechanism.plant(), key))
        # what the slopes at the start of the log leave of an error
        assert (true < 1e-4).all()
        assert (rms(seen.window_errors(mechanism.plant(mechanism.start * 1.1), key)) > 10.0 * true).all()


def test_windows_cover_their_spans_and_take_turns():
    mechanism = load_mechanism("pendulum")
    seen = validation(mechanism, record(mechanism, mechanism.plant()))
    p = seen.predictor
    time = p.stretches[0].time[1:]
    for key, mask in (("held_out", p.validation_rows), ("fit", p.fit_rows)):
        inside = np.zeros(len(time), dtype=int)
        for turn in seen.turns[key]:
            ends = sorted((rows.start, rows.stop) for _, rows in turn)
            # before each the observer has as long as a window to come back
            assert all(time[a] - time[b - 1] > 0.3 for (_, b), (a, _) in itertools.pairwise(ends))
            for first, stop in ends:
                assert 0.3 <= time[stop - 1] - time[first] <= 0.5
                inside[first:stop] += 1
        lengths = seen.lengths(key)
        assert lengths.sum() == inside.sum() and len(seen.window_errors(mechanism.plant(), key)) == inside.sum()
        # no row of the other kind, but where filtered rows meet; all of these, and most of them in
        # more than one window
        assert mask[inside > 0, 0].mean() > 0.98
        usable = mask[:, 0] & (time > time[0] + 0.2)
        assert (inside[usable] > 0).mean() > 0.97 and np.median(inside[usable]) >= 2


def test_a_window_is_the_model_by_itself_from_its_start_on():
    mechanism = load_mechanism("pendulum")
    log = record(mechanism, mechanism.plant(), volts=0.3, noise=1e-4)
    seen = validation(mechanism, log, volts=0.3, noise=1e-4)
    plant = mechanism.plant(mechanism.start * 1.05)
    turn = seen.turns["fit"][0]
    before = sum(rows.stop - rows.start for _, rows in turn[:2])
    _, window = turn[2]
    rows = np.arange(window.start, window.stop)
    errors = seen.window_errors(plant, "fit")[before : before + len(rows), 0]
    stretch = seen.predictor.stretches[0]
    closed = np.ones(len(stretch.time) - 1, dtype=bool)
    for _, other in turn:
        closed[other] = False
    tracked = seen.predictor.tracked(plant, [closed])[0]
    # by hand: from the corrected state of the row before, by the simulator alone
    k = rows[0] - 1
    gain = seen.predictor.gain[0]
    state = [
        tracked.position[k, 0] + gain[0] * tracked.innovation[k, 0],
        tracked.velocity[k, 0] + gain[1] * tracked.innovation[k, 0],
    ]
    simulator = Simulator(plant, max_step=stable_step(plant, 1.2e-3))
    # its winding has no inductance, so that there is no more to the state
    simulator.reset([state[0]], [state[1]], [0.0], time=stretch.time[rows[0]])
    run = simulator.run(stretch.time[rows[0] : rows[-1] + 2], stretch.voltage[rows[0] : rows[-1] + 2])
    expected = stretch.position[rows + 1, 0] - run.position[1:, 0]
    assert np.abs(errors - expected).max() < 1e-9


def test_instants_at_which_a_current_is_limited_are_resolved():
    arm, usual = load_mechanism(), 1.2e-3
    lag = max(m.inductance / m.resistance for m in arm.plant().arm.motors)
    limited = arm.plant(arm.start, (parse_effect("current_limit:joint=2,current=1.2"),))
    parts = parts_of_steps(limited, usual)
    assert parts_of_steps(arm.plant(), usual) == 1 and usual > 0.12 * lag >= usual / parts
    # models side by side, whose parameters differ by little, take the same steps
    beside = arm.plant(arm.start + 0.01 * arm.deviations, limited.effects[-1:])
    assert parts_of_steps(beside, usual) == parts
    time = np.arange(0.0, 3.0, usual)
    volts = np.where(np.mod(time, 0.5) < 0.25, 30.0, -30.0)[:, None] * [0.0, 1.0, 0.0]
    still = np.zeros_like(volts)

    def positions(plant, step, parts):
        """In open loop: errors beside a joint that rests are the positions."""
        simulator = Simulator(plant, max_step=step)
        simulator.reset([0.0, -1.2, 1.0])
        never = np.zeros(len(time) - 1, dtype=bool)
        return -innovations(simulator, time, volts, still, np.zeros((3, 3)), None, never, parts).innovation

    exact = positions(limited, 2e-5, 1)
    error, unresolved, fine = (
        np.abs(positions(limited, *steps) - exact).max() for steps in ((usual, parts), (usual, 1), (usual / parts, 1))
    )
    # the rows in which no current meets its limit need no finer steps
    assert error < 0.1 * unresolved and abs(error - fine) < 0.02 * unresolved
    # and where it is never met none are taken
    never = arm.plant(arm.start, (parse_effect("current_limit:joint=2,current=1000"),))
    assert np.array_equal(positions(never, usual, parts), positions(arm.plant(), usual, 1))


def test_a_winding_that_a_fit_makes_fast_costs_no_more_than_its_stability():
    arm = load_mechanism()
    plant = arm.plant(arm.start, (parse_effect("current_limit:joint=2,current=1.2"),))
    motors = [replace(motor, inductance=1e-4 * motor.inductance) for motor in plant.arm.motors]
    fast = replace(plant, arm=replace(plant.arm, motors=tuple(motors)))
    assert stable_step(fast, 1.2e-3) < 1e-5 and parts_of_steps(fast, 1.2e-3) == 1


def test_windows_know_where_in_its_play_a_gear_is():
    mechanism = load_mechanism()
    play = parse_effect("backlash:joint=2,gap=0.002")
    plant = mechanism.plant(mechanism.start, (play,))
    seen = validation(mechanism, record(mechanism, plant, seconds=6.0))
    true = rms(seen.window_errors(plant, "held_out"))
    rigid = rms(seen.window_errors(mechanism.plant(), "held_out"))
    assert true[1] < 0.1 * rigid[1]


def test_windows_know_when_the_drive_is_off():
    mechanism = load_mechanism("pendulum")
    time = np.arange(0.0, SECONDS, STEP)
    enable = (np.mod(time, 2.0) < 1.5).astype(float)
    log = record(mechanism, mechanism.plant(), enable=enable)
    blind = Log("own", log.time, log.voltage, log.position)
    aware = rms(validation(mechanism, log).window_errors(mechanism.plant(), "fit"))
    assert aware[0] < 1e-4
    assert rms(validation(mechanism, blind).window_errors(mechanism.plant(), "fit"))[0] > 0.02


@pytest.mark.parametrize("radius", (0.1, 0.95, 0.9999))
def test_what_noise_settles_at_solves_its_equation(radius):
    rng = np.random.default_rng(7)
    A, B = rng.standard_normal((2, 3, 3))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    P = stationary_covariance(A, B @ B.T)
    assert np.abs(A @ P @ A.T + B @ B.T - P).max() < 1e-12 * np.abs(P).max()
    assert np.allclose(P, solve_discrete_lyapunov(A, B @ B.T), rtol=1e-9)


def floor_of_rows(seen, noise, key="fit"):
    """(J,) errors that noise of rows makes in windows."""
    return position_floor(seen.lengths(key), partial(variance_of_rows, seen.predictor, noise))


def of_rows(seen, plant):
    """(N, J) innovations of a plant at the rows to fit."""
    return np.where(seen.predictor.fit_rows, seen.predictor.errors(plant), np.nan)


@pytest.mark.parametrize("correlation", [0.0, 0.04])
def test_the_floor_is_what_a_true_model_reaches(correlation):
    mechanism = load_mechanism()
    volts, noise = 0.3, 5e-5
    log = record(mechanism, mechanism.plant(), volts, noise, seconds=40.0, correlation=correlation)
    # also where the observer was made for another noise
    for guess, room in ((volts, 1.6), (3.0 * volts, 2.5)):
        seen = validation(mechanism, log, guess, noise)
        left = of_rows(seen, mechanism.plant())
        found = noise_behind(seen.predictor, left, np.full(3, noise), correlation)
        # each joint by itself, with its mean inertia: joint 1's doubles with the arm stretched out
        assert (found.volts < room * volts).all() and (found.volts > volts / room).all()
        assert (found.position <= noise).all() and (found.position > 0.8 * noise).all()
        for key in ("fit", "held_out"):
            ratio = rms(seen.window_errors(mechanism.plant(), key)) / floor_of_rows(seen, found, key)
            assert (ratio > 1.0 / room).all() and (ratio < room).all()


def test_of_noises_behind_the_same_innovations_the_slower_makes_more_in_open_loop():
    mechanism = load_mechanism()
    seen = validation(mechanism, record(mechanism, mechanism.plant(), 0.3, 5e-5, correlation=0.04), 0.3, 5e-5)
    left = of_rows(seen, mechanism.plant())
    floors = [
        floor_of_rows(seen, noise_behind(seen.predictor, left, np.full(3, 5e-5), T))
        for T in (0.0, 0.01, 0.02, 0.04, 0.08)
    ]
    assert (np.diff(floors, axis=0) > 0.0).all()
    # a white noise would be called a misfit here
    assert (rms(seen.window_errors(mechanism.plant(), "fit")) > 2.0 * floors[0]).all()


def test_a_voltage_of_correlation_zero_is_white():
    mechanism = load_mechanism("pendulum")
    seen = validation(mechanism, record(mechanism, mechanism.plant(), 0.02, 1e-5), 0.02, 1e-5)
    left, sensed = of_rows(seen, mechanism.plant()), np.array([1e-5])
    white, fast = (noise_behind(seen.predictor, left, sensed, T) for T in (0.0, 1e-3 * STEP))
    assert np.allclose(white.volts, fast.volts, rtol=1e-12) and np.array_equal(white.position, fast.position)
    both = [floor_of_rows(seen, noise) for noise in (white, fast)]
    assert np.allclose(*both, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_innovations_of_the_noise_that_the_gain_is_made_for_spread_as_that_noise(name):
    mechanism = load_mechanism(name)
    volts, sensed = 0.02, 1e-5
    p = validation(mechanism, record(mechanism, mechanism.plant()), volts, sensed).predictor
    J = mechanism.joints
    white = Weighting(np.ones((J, 1)), np.array(p.spread), p.lengths)
    of_noise = RowNoise(p.volts, np.full(J, sensed))
    spread = variance_of_innovations(p, white, 300)
    assert np.allclose(spread, variance_of_rows(p, of_noise, 300), rtol=1e-3)
    assert np.array_equal(variance_of_innovations(p, white, 1), spread[:1])
    # a log without any window has no such error
    none = position_floor(np.zeros(0, dtype=int), partial(variance_of_innovations, p, white))
    assert none.shape == (J,) and np.isnan(none).all()


def test_the_spread_of_coloured_innovations_is_that_of_simulated_ones():
    mechanism = load_mechanism("pendulum")
    p = validation(mechanism, record(mechanism, mechanism.plant()), 0.02, 1e-5).predictor
    taps, rows, runs = np.array([[1.0, -1.2, 0.5]]), 60, 4000
    noise = Weighting(taps, np.array([2.0]), p.lengths)
    (F, _, gain), rng = p.linear[0], np.random.default_rng(5)
    e = lfilter([2.0], taps[0], rng.standard_normal((runs, 200 + rows)), axis=1)[:, 200:]
    x, seen = np.zeros((runs, len(F))), np.empty((runs, rows))
    for m in range(rows):
        seen[:, m] = x[:, 0] + e[:, m]
        x = (x + e[:, m, None] * gain) @ F.T
    expected = variance_of_innovations(p, noise, rows)[:, 0]
    # five standard errors of a variance
    assert np.abs((seen**2).mean(axis=0) / expected - 1.0).max() < 5.0 * np.sqrt(2.0 / runs)


@pytest.mark.parametrize("correlation", [0.0, 0.04])
def test_the_floor_of_the_noise_of_a_fit_is_what_a_true_model_reaches(correlation):
    mechanism = load_mechanism()
    log = record(mechanism, mechanism.plant(), 0.3, 5e-5, seconds=40.0, correlation=correlation)
    seen = validation(mechanism, log, 0.3, 5e-5)
    noise = weighting(seen.predictor, seen.predictor.errors(mechanism.plant()))
    for key in ("fit", "held_out"):
        floor = position_floor(seen.lengths(key), partial(variance_of_innovations, seen.predictor, noise))
        ratio = rms(seen.window_errors(mechanism.plant(), key)) / floor
        assert (ratio > 1.0 / 1.6).all() and (ratio < 1.6).all()


def test_no_more_is_noise_than_changes_from_row_to_row_allow():
    mechanism = load_mechanism("pendulum")
    seen = validation(mechanism, record(mechanism, mechanism.plant(), 0.02, 1e-5), 0.02, 1e-5)
    seen.predictor.expected = np.array([1e-3])
    left = of_rows(seen, mechanism.plant())
    for T in (0.0, 0.05):
        found = noise_behind(seen.predictor, left, np.array([1e-5]), T)
        # standard deviation of the changes of such a voltage, and of a white one as expected
        kept = np.exp(-STEP / T) if T else 0.0
        assert found.volts[0] * np.sqrt(2.0 * (1.0 - kept)) == pytest.approx(1e-3 * np.sqrt(2.0), rel=1e-3)


def test_a_state_that_does_not_stay_finite_counts_as_far_off():
    mechanism = load_mechanism("pendulum")
    log = record(mechanism, mechanism.plant())
    wild = Log("own", log.time, np.where(log.time[:, None] > 5.0, 1e300, log.voltage), log.position)
    seen = validation(mechanism, log)
    seen.predictor.stretches[0].voltage[2000:] = wild.voltage[
        2000 : 2000 + len(seen.predictor.stretches[0].voltage) - 2000
    ]
    assert 0.5 * SELECTION.not_finite < rms(seen.window_errors(mechanism.plant(), "fit"))[0] <= SELECTION.not_finite


@pytest.mark.parametrize("height", [50.0, 6.0])  # more of power than all others, and a peak alone
def test_validation_blocks_lie_where_rows_are_like_the_others(height):
    mechanism = load_mechanism("pendulum")
    problem = Problem(sample([record(mechanism, mechanism.plant())]), mechanism)
    quiet = np.ones((len(problem.kept), 1))
    assert problem.like(quiet) is problem
    blow = quiet.copy()
    centre = np.flatnonzero(problem.validation)[3]
    blow[centre - 1 : centre + 2] = height
    other = problem.like(blow)
    assert other is not problem and not (other.validation | other.guard)[centre - 1 : centre + 2].any()
    assert abs(other.validation.mean() - problem.validation.mean()) < 0.05
    kept = Problem(problem.sampled, mechanism, None)
    assert kept.like(blow) is kept
