# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`puma-sim identify-controller`: what it prints of logs, and which logs it refuses."""

from __future__ import annotations

import re

import numpy as np
import pytest
from cli_support import call
from controller_records import COUNT, H, record, write

from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import write_csv
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.tuning.controller_log import read_controller_log

GAINS = (137.0, 0.315, 0.032)


@pytest.fixture
def printed(capsys):
    """The output of a call that must succeed."""

    def run(*arguments):
        capsys.readouterr()
        assert call("identify-controller", *arguments) == 0
        out, err = capsys.readouterr()
        assert err == ""
        return out

    return run


@pytest.fixture
def assert_refused(capsys):
    """The one line of a call that must fail."""

    def run(*arguments):
        capsys.readouterr()
        assert call("identify-controller", *arguments) == 2
        out, err = capsys.readouterr()
        assert out == "" and re.fullmatch(r"puma-sim: .+; expected .+\n", err), err
        return err

    return run


def intervals(text):
    """(low, high) of Kg, Ti and Td of the first log in the output."""
    return [
        tuple(map(float, re.search(rf"{name}.* (\S+) to (\S+)", text).groups()))
        for name in ("Kg, V/rad", "Ti, s", "Td, s")
    ]


@pytest.mark.parametrize("joint", [None, 2])
def test_a_log_reads_back_and_gives_its_gains(tmp_path, printed, joint):
    log = record(GAINS, 1)
    path = write(log, tmp_path / "log.csv", joint)
    back = read_controller_log(path, joint)
    for name in ("setpoint", "position", "voltage"):
        assert np.array_equal(getattr(back, name), getattr(log, name))
    assert back.period == pytest.approx(H, rel=1e-9)
    out = printed(path, *(() if joint is None else ("--joint", joint)))
    assert "certain interval" in out and "4095 samples of 0.93333 ms" in out
    assert "voltage in steps of 19.53 mV, position in steps of 0.1 mrad" in out
    assert "derivative of the error" in out
    assert all(low <= gain <= high for gain, (low, high) in zip(GAINS, intervals(out)))


def test_a_run_of_the_simulators_own_servo_gives_its_gains(tmp_path, printed):
    time = 0.028 * np.arange(60)
    setpoint = np.array([0.3, -0.5, 1.0]) + 0.02 * np.outer(1.0 - np.cos(9.0 * time), [1, 1, 1])
    gains = (GAINS, (600.0, 0.2, 0.02), (400.0, 0.3, 0.01))
    servo = ServoConfig(tuple(PidGains(*g) for g in gains), converter_bits=12, encoder_counts=1000)
    plant = Plant.of("bejczy", (), "physical")
    simulator = Simulator(plant)
    simulator.reset(setpoint[0])
    write_csv(simulator.run_servo(setpoint, servo), tmp_path / "run.csv")
    for joint, gains in enumerate(servo.gains, start=1):
        step = 2.0 * np.pi / (1000 * plant.arm.motors[joint - 1].gear_ratio)
        out = printed(tmp_path / "run.csv", "--joint", joint, "--position-step", repr(step), "--limit", "40")
        assert "certain interval" in out and "derivative of the measurement" in out
        expected = (gains.gain, gains.integral_time, gains.derivative_time)
        assert all(low <= gain <= high for gain, (low, high) in zip(expected, intervals(out)))
    # without the encoder's step the positions are not those that the controller read
    assert "times what rounding of the voltage leaves" in printed(tmp_path / "run.csv", "--joint", 1)


def test_two_logs_are_compared(tmp_path, printed):
    one, same, other = (
        write(record(gains, seed), tmp_path / f"{seed}.csv")
        for gains, seed in ((GAINS, 1), (GAINS, 2), ((150.0, 0.315, 0.032), 3))
    )
    assert "the gains may be the same" in printed(one, same)
    assert "the gains differ" in printed(one, other)
    noisy = [
        write(record(gains, seed, noise=0.03), tmp_path / f"noisy{seed}.csv")
        for gains, seed in ((GAINS, 1), ((150.0, 0.315, 0.032), 3))
    ]
    assert "the gains differ: chance" in printed(*noisy, "--level", "0.001")


def test_options_reach_the_estimate(tmp_path, printed):
    path = write(record(GAINS, 1), tmp_path / "log.csv")
    assert "99 % interval" in printed(path, "--confidence", "0.99", "--forgetting", "0.999")
    low, high = intervals(printed(path, "--form", "velocity"))[0]
    assert low <= GAINS[0] * (1.0 + H / GAINS[1]) <= high


def test_logs_that_cannot_be_used_are_refused(tmp_path, assert_refused):
    good = record(GAINS, 1, samples=300)
    three = write(good, tmp_path / "three.csv", 1)
    one = write(good, tmp_path / "one.csv")
    assert "three.csv: has the columns of three joints; expected --joint" in assert_refused(three)
    assert "joint 1 of a log of one joint" in assert_refused(one, "--joint", 1)
    assert "joint 4; expected 1 or 2 or 3" in assert_refused(three, "--joint", 4)
    assert "--joint: '1.5'" in assert_refused(three, "--joint", "1.5")
    assert "no excitation" in assert_refused(three, "--joint", 2) or "not change" in assert_refused(three, "--joint", 2)
    assert "no.csv: cannot be read" in assert_refused(tmp_path / "no.csv")
    assert "--level with one log" in assert_refused(one, "--level", "0.05")
    lines = one.read_text().splitlines()
    for content, says in (
        (lines[:100] + lines[103:], "evenly spaced samples"),
        (lines[:12], "11 rows; expected more than 16"),
        ([line.rpartition(",")[0] for line in lines], "columns time, setpoint, position"),
        ([f"{line},1" for line in lines], "unknown column '1'"),
        ([lines[0], *lines[2:9], "0.1,x,0,0"], "column setpoint: 'x'"),
    ):
        bad = tmp_path / "bad.csv"
        bad.write_text("\n".join(content) + "\n")
        assert says in assert_refused(bad)


def test_the_bound_of_the_counts_is_the_encoders(tmp_path, printed):
    """A log of positions that were not rounded gives the gains once they are."""
    log = record(GAINS, 5)
    rng = np.random.default_rng(5)
    within = log.position + rng.uniform(-0.49, 0.49, len(log)) * COUNT
    path = write(type(log)(log.period, log.setpoint, within, log.voltage), tmp_path / "log.csv")
    out = printed(path, "--position-step", COUNT)
    assert "certain interval" in out
    assert all(low <= gain <= high for gain, (low, high) in zip(GAINS, intervals(out)))
