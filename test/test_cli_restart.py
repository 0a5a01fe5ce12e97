# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Measured logs in open loop: where windows start, from which state, and what the errors say.

The logs here are runs of the simulator, so that their true velocities and currents are known.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from arm_reference import VISCOUS, plant_of
from cli_support import call, read_run, states

from puma_sim_core.errors import ParameterError
from puma_sim_core.recording.recording import Recording, write_csv
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.windows import driven_current, local_motion, measured_state, run_windows, window_starts

FRICTION = (
    "coulomb_friction:joint=1,torque=8",
    "asymmetric_coulomb_friction:joint=2,positive=9,negative=6",
    "stribeck_friction:joint=3,torque=2",
    "coulomb_friction:joint=3,torque=6",
)
#: one count of the encoders at the joints [rad], 1000 counts a motor turn
COUNT = 2.0 * np.pi / (1000.0 * np.array([62.55, 107.81, 53.63]))


def excitation(duration, row, seed=1):
    """(time, voltage): slow sines, 5 Hz and noise, as a dithered experiment has them."""
    random = np.random.default_rng(seed)
    time = row * np.arange(round(duration / row) + 1)
    phase = 2.0 * np.pi * np.outer(time, (0.4, 0.3, 0.5)) + (0.0, 1.0, 2.0)
    fast = 2.0 * np.pi * 5.0 * time[:, None] + (0.0, 1.0, 2.0)
    voltage = 12.0 * np.sin(phase) + 4.0 * np.sin(fast) + random.normal(size=(len(time), 3))
    # from 0 V: before its first row a log says nothing
    return time, voltage * np.minimum(1.0, time / 0.3)[:, None]


def simulated(plant, row, duration=6.0) -> Recording:
    return Simulator(plant).run(*excitation(duration, row))


@pytest.fixture(scope="module")
def plant():
    return plant_of(*VISCOUS, *FRICTION)


@pytest.fixture(scope="module", params=[0.028 / 30, 0.005, 0.028], ids=["1ms", "5ms", "28ms"])
def log(request, plant):
    return simulated(plant, request.param)


def option_words(effects):
    return [word for text in effects for word in ("--effect", text)]


# ---------------------------------------------------------------------------------- the command


def restart(log, folder, *options, interval=2.0):
    write_csv(log, folder / "log.csv")
    assert (
        call("simulate", folder / "log.csv", "--force", "--out", folder / "run.csv", "--restart", interval, *options)
        == 0
    )
    return read_run(folder / "run.csv")


def reported(capsys):
    """(windows, rms (3), worst (3)) as the command prints them."""
    err = capsys.readouterr().err
    windows = int(re.search(r"open-loop error of (\d+) window", err)[1])
    lines = re.findall(r"joint (\d): rms (\S+), worst (\S+) at", err)
    assert [int(joint) for joint, _, _ in lines] == [1, 2, 3]
    return windows, *np.array([[float(a), float(b)] for _, a, b in lines]).T


def test_a_complete_log_of_the_same_plant_has_no_error_at_all(log, tmp_path, capsys):
    run = restart(log, tmp_path, *option_words((*VISCOUS, *FRICTION)))
    windows, rms, worst = reported(capsys)
    assert windows == 3 and not rms.any() and not worst.any()
    assert np.array_equal(states(run), states(log)) and np.array_equal(run.time, log.time)
    assert np.array_equal(run.voltage, log.voltage)


def test_bristles_that_no_log_holds_go_on_from_window_to_window(tmp_path, capsys):
    effects = ("presliding_friction:joint=1,stiffness=3e4,torque=9", "presliding_friction:joint=2,torque=7")
    restart(simulated(plant_of(*effects), 0.005), tmp_path, *option_words(effects))
    assert not reported(capsys)[2].any()


def test_positions_in_counts_of_the_encoder_are_enough(log, plant, tmp_path, capsys):
    """Velocities and currents are estimated: within 0.3 mrad at 1 and 5 ms, 1 mrad at 28 ms, where
    one row of 28 ms is all that is known of a dither of 200 ms."""
    counted = Recording(time=log.time, voltage=log.voltage, position=np.round(log.position / COUNT) * COUNT)
    run = restart(counted, tmp_path, *option_words((*VISCOUS, *FRICTION)))
    _, rms, worst = reported(capsys)
    slow = log.time[1] > 0.02
    assert (rms < (5e-4 if slow else 1.5e-4)).all() and (worst < (1e-3 if slow else 3e-4)).all()
    starts = window_starts(log.time, 2.0)
    assert np.array_equal(run.position[starts], counted.position[starts])


def test_a_wrong_plant_shows(log, tmp_path, capsys):
    counted = Recording(time=log.time, voltage=log.voltage, position=np.round(log.position / COUNT) * COUNT)
    restart(counted, tmp_path, *option_words(VISCOUS))
    _, rms, worst = reported(capsys)
    assert (rms > 4e-3).all() and (worst > 1e-2).all()


def test_the_errors_are_those_of_each_window_run_by_itself(plant, tmp_path, capsys):
    """With a wrong plant: row by row against runs of one window each, ends included."""
    log, wrong = simulated(plant, 0.005), plant_of(*VISCOUS)
    run = restart(log, tmp_path, *option_words(VISCOUS), interval=1.5)
    windows, rms, worst = reported(capsys)
    edges = [*np.searchsorted(log.time, (0.0, 1.5, 3.0, 4.5)), len(log) - 1]
    error = []
    for first, last in itertools.pairwise(edges):
        simulator = Simulator(wrong)
        simulator.reset(*np.split(states(log)[first], 3))
        alone = simulator.run(log.time[first : last + 1], log.voltage[first : last + 1])
        assert np.array_equal(states(run)[first:last], states(alone)[:-1])
        error.append((alone.position - log.position[first : last + 1])[1:])
    error = np.vstack(error)
    assert windows == 4
    np.testing.assert_allclose(rms, np.sqrt((error**2).mean(axis=0)), rtol=1e-3)
    np.testing.assert_allclose(worst, np.abs(error).max(axis=0), rtol=1e-3)
    assert np.array_equal(run.position[-1], alone.position[-1])


def test_an_unevenly_sampled_log_works(plant, tmp_path, capsys):
    random = np.random.default_rng(4)
    time, voltage = excitation(6.0, 0.005)
    kept = np.sort(random.choice(len(time), len(time) * 3 // 4, replace=False))
    log = Simulator(plant).run(time[kept], voltage[kept])
    restart(Recording(log.time, log.voltage, log.position), tmp_path, *option_words((*VISCOUS, *FRICTION)))
    _, _, worst = reported(capsys)
    assert (worst < 1e-3).all()


def test_a_joint_can_be_held(plant, tmp_path, capsys):
    held = (Constraint(), Constraint("hold"), Constraint())
    log = Simulator(plant, constraints=held).run(*excitation(4.0, 0.005))
    run = restart(log, tmp_path, *option_words((*VISCOUS, *FRICTION)), "--constrain", "joint2=hold", interval=1.0)
    assert not reported(capsys)[2].any() and not run.velocity[:, 1].any()


def test_one_window_is_an_open_loop_run(plant, tmp_path, capsys):
    log = simulated(plant, 0.005)
    run = restart(log, tmp_path, *option_words(VISCOUS), interval=1e6)
    assert reported(capsys)[0] == 1
    alone = Simulator(plant_of(*VISCOUS)).run(log.time, log.voltage)
    assert np.array_equal(states(run), states(alone))


# -------------------------------------------------------------------------------------- windows


def test_windows_start_at_the_nearest_rows():
    time = 0.028 * np.arange(300)  # 2 s is 71.4 rows
    assert window_starts(time, 2.0).tolist() == [0, 71, 143, 214, 286]
    rounded = np.round(np.arange(0.0, 10.0, 0.1) + 5.0, 9)
    assert window_starts(rounded, 2.0).tolist() == [0, 20, 40, 60, 80]


def test_a_gap_in_a_log_is_followed_by_a_start_and_the_last_row_starts_nothing():
    time = np.concatenate([np.arange(0.0, 3.0, 0.1), np.arange(9.7, 12.05, 0.1)])
    starts = window_starts(time, 2.0)
    assert time[starts] == pytest.approx([0.0, 2.0, 9.7, 10.0])
    assert window_starts(np.arange(0.0, 4.05, 0.1), 2.0).tolist() == [0, 20]


def test_an_interval_below_the_sampling_starts_at_each_row():
    assert window_starts(np.arange(5.0), 1e-300).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("interval", [0.0, -1.0, float("nan"), float("inf")])
def test_an_interval_that_is_no_time_is_refused(interval):
    with pytest.raises(ParameterError, match="a positive number"):
        window_starts(np.arange(5.0), interval)


# ------------------------------------------------------------------------------------ estimates


def test_a_cubic_motion_gives_its_derivatives_at_any_row_and_spacing():
    """At the first and last row a parabola serves, which a quadratic motion needs."""
    random = np.random.default_rng(2)
    time = np.cumsum(random.uniform(0.5e-3, 4e-3, 200))
    c = random.normal(size=(4, 3)) * [[1.0], [1.0], [10.0], [100.0]]
    for degree, rows in ((3, range(1, 199)), (2, (0, 199))):
        t = time[:, None]
        position = sum(c[n] * t**n for n in range(degree + 1))
        for row in rows:
            velocity, acceleration = local_motion(time, position, row)
            v = sum(n * c[n] * time[row] ** (n - 1) for n in range(1, degree + 1))
            a = sum(n * (n - 1) * c[n] * time[row] ** (n - 2) for n in range(2, degree + 1))
            np.testing.assert_allclose(velocity, v, rtol=0, atol=1e-9)
            np.testing.assert_allclose(acceleration, a, rtol=0, atol=1e-6)


def test_the_slope_has_no_lag():
    """Time reversed, the velocity is the opposite: nothing is shifted forward or back."""
    random = np.random.default_rng(5)
    time = np.cumsum(random.uniform(0.5e-3, 2e-3, 101))
    position = random.normal(size=(101, 3))
    velocity, acceleration = local_motion(time, position, 50)
    back, again = local_motion(-time[::-1], position[::-1], 50)
    np.testing.assert_allclose(back, -velocity, rtol=1e-10)
    np.testing.assert_allclose(again, acceleration, rtol=1e-10)


def test_the_slope_of_an_8_hz_motion_and_of_encoder_counts_is_as_good_as_documented():
    time = 1e-3 * np.arange(1000)
    w = 2.0 * np.pi * 8.0
    position = np.sin(w * time)[:, None] * np.ones(3)
    slopes = np.array([local_motion(time, position, r)[0] for r in range(30, 970)])
    true = w * np.cos(w * time[30:970])[:, None]
    assert np.abs(slopes - true).max() < 0.003 * w
    counted = np.round(position / 1e-4) * 1e-4
    noisy = np.array([local_motion(time, counted, r)[0] for r in range(30, 970)])
    assert np.sqrt(((noisy - slopes) ** 2).mean()) < 1.5e-3


@pytest.mark.parametrize("rows", [2, 3, 4, 5])
def test_few_rows_are_enough(rows):
    time = 0.028 * np.arange(rows)
    position = np.outer(time, (1.0, -2.0, 0.5)) + 0.3
    for row in range(rows):
        velocity, acceleration = local_motion(time, position, row)
        np.testing.assert_allclose(velocity, (1.0, -2.0, 0.5), atol=1e-12)
        np.testing.assert_allclose(acceleration, 0.0, atol=1e-10)


def test_the_current_of_constant_motion_is_exact(plant):
    """At constant velocity the circuit is linear: its solution, row by row, is the estimate."""
    random = np.random.default_rng(6)
    time = np.cumsum(random.uniform(1e-3, 4e-3, 80))
    voltage = random.uniform(-20.0, 20.0, (80, 3))
    velocity = np.array([0.7, -0.3, 1.1])
    motors = plant.arm.motors
    R, L, k = (
        np.array([f(m) for m in motors])
        for f in (lambda m: m.resistance, lambda m: m.inductance, lambda m: m.back_emf * m.gear_ratio)
    )
    current = (voltage[0] - k * velocity) / R
    for r in range(80):
        estimate = driven_current(plant, time, voltage, r, velocity, np.zeros(3))
        np.testing.assert_allclose(estimate, current, rtol=0, atol=1e-12)
        if r < 79:
            end = (voltage[r] - k * velocity) / R
            current = end + (current - end) * np.exp(-(time[r + 1] - time[r]) * R / L)


def test_the_estimated_current_follows_the_true_one(plant):
    """Ten times nearer than the quasi-static current of the row's own voltage."""
    log = simulated(plant, 0.028 / 30)
    bare = replace(log, velocity=None, current=None)
    rows = range(50, len(log) - 50, 37)
    estimate = np.array([measured_state(plant, bare, r)[2] for r in rows])
    true = log.current[list(rows)]
    k = np.array([m.back_emf * m.gear_ratio for m in plant.arm.motors])
    static = (log.voltage[list(rows)] - k * log.velocity[list(rows)]) / 1.6
    error = np.sqrt(((estimate - true) ** 2).mean(axis=0))
    assert (error < 0.1).all()
    assert (error < 0.1 * np.sqrt(((static - true) ** 2).mean(axis=0))).all()


def test_the_amplifier_acts_on_the_estimated_current():
    plant = plant_of("voltage_saturation:joint=1,voltage=10", "current_limit:joint=2,current=3")
    time = 0.01 * np.arange(50)
    voltage = np.tile((25.0, 25.0, 25.0), (50, 1))
    estimate = driven_current(plant, time, voltage, 40, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(estimate, (10.0 / 1.6, 3.0, 25.0 / 1.6), rtol=1e-12)


def test_what_was_measured_is_taken_as_it_is(plant):
    log = simulated(plant, 0.005, 1.0)
    position, velocity, current = measured_state(plant, log, 77)
    assert np.array_equal(np.concatenate([position, velocity, current]), states(log)[77])
    some = replace(log, current=None)
    assert np.array_equal(measured_state(plant, some, 77)[1], log.velocity[77])


def test_the_simulator_ends_in_the_last_state(plant):
    log = simulated(plant, 0.005, 1.0)
    simulator = Simulator(plant)
    seen = []
    recording, errors = run_windows(simulator, log, 0.3, acceleration=True, report=seen.append)
    assert np.array_equal(simulator.state, states(recording)[-1]) and simulator.time == log.time[-1]
    assert errors.windows == len(seen) and seen[-1] == len(log)
    assert recording.acceleration.shape == (len(log), 3)
