# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs of machines with passive joints, and with a servo inside the drive."""

from __future__ import annotations

import numpy as np
import pytest
from cli_support import call
from linkage_support import known, linkage, passive, torque_drive
from numpy.testing import assert_allclose

from puma_sim_core.errors import ParameterError, RecordingError
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.machine_log import read_for, with_volts
from puma_sim_core.identify.experiment.design import suspects_of
from puma_sim_core.identify.experiment.next_experiment import next_experiment
from puma_sim_core.identify.result import Hypothesis
from puma_sim_core.plant.linkage.linkage_mechanism import LinkageMechanism
from puma_sim_core.simulation.simulator import Simulator

GAIN, DAMPING, LIMIT = 40.0, 1.5, 6.0


def servo_drive(**changes):
    numbers = {
        "resistance": known(4.0, "ohm"),
        "torque_constant": known(0.9, "N.m/A"),
        "motor_inertia": known(0.02, "kg.m^2"),
        "viscous_friction": known(0.05, "N.m.s/rad"),
        "servo_gain": known(GAIN, "V/rad"),
        "servo_damping": known(DAMPING, "V.s/rad"),
        "servo_limit": known(LIMIT, "V"),
    }
    return {"amplifier": "position", **numbers, **changes}


def machine(**axes):
    return LinkageMechanism.of(linkage(**axes))


def file_of(path, **columns):
    path.write_text(
        ",".join(columns) + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in zip(*columns.values())) + "\n"
    )
    return path


def test_volts_of_a_servo_are_those_that_drove_the_joint():
    """A pendulum under its servo, sampled finely; the log has every tenth sample."""
    light = {"mass": 0.2, "across": 0.0, "inertia": 0.002}
    mechanism = machine(shoulder=servo_drive(), numbers={"shoulder": light})
    fine, every = 1e-3, 10
    time = np.arange(0.0, 4.0, fine)
    goal = np.repeat(0.8 * np.sign(np.sin(1.7 * time[::every])) + 0.2 * np.sin(9.0 * time[::every]), every)
    simulator = Simulator(mechanism.plant(), max_step=fine)
    simulator.reset([0.1])
    position, volts = np.empty(len(time)), np.empty(len(time))
    for r in range(len(time)):
        _, _, position[r], _, _, speed, *_ = simulator.state
        volts[r] = np.clip(GAIN * (goal[r] - position[r]) - DAMPING * speed, -LIMIT, LIMIT)
        simulator.step([volts[r]], fine)
    rows = slice(None, None, every)
    log = Log("log", time[rows], np.zeros((400, 1)), position[rows, None], setpoint=goal[rows, None])
    found = with_volts(log, mechanism)
    mean = volts.reshape(-1, every).mean(axis=1)
    assert np.abs(mean).max() == LIMIT and np.mean(np.abs(mean) < 0.9 * LIMIT) > 0.5
    # the position bends between rows, and the limit begins in the middle of a row
    difference = found.voltage[:-1, 0] - mean[:-1]
    assert np.sqrt(np.mean(difference**2)) < 0.05 * np.sqrt(np.mean(mean**2))
    assert "servo in the drive" in found.notes[-1] and not log.voltage.any()


def test_a_servo_at_rest_hangs_below_its_goal_by_weight_over_gain():
    mechanism = machine(shoulder=servo_drive())
    q = np.linspace(-1.0, 1.0, 21)[:, None]
    still = np.zeros_like(q)
    weight = mechanism.gravity(None, q)
    droop = weight * mechanism.drive(None).volts_per_torque / GAIN
    time = 0.1 * np.arange(2.0)
    for angle, below in zip(q[:, 0], droop[:, 0]):
        log = Log("log", time, np.zeros((2, 1)), np.full((2, 1), angle), setpoint=np.full((2, 1), angle + below))
        volts = with_volts(log, mechanism).voltage[0, 0]
        assert_allclose(volts, np.clip(GAIN * below, -LIMIT, LIMIT), atol=1e-12)
    assert_allclose(mechanism.model_voltage(None, q, still, still), GAIN * droop, atol=1e-12)


def test_inputs_of_passive_joints_and_of_servos_in_files(tmp_path):
    time = 0.01 * np.arange(50)
    wave = np.sin(time)
    rotary = machine(base=torque_drive(), shoulder=passive())
    path = file_of(tmp_path / "a.csv", time=time, voltage1=wave, position1=2 * wave, position2=3 * wave)
    log = read_for(rotary, path)
    assert_allclose(log.voltage, np.column_stack([wave, 0 * wave]), atol=1e-8)
    assert_allclose(log.position, np.column_stack([2 * wave, 3 * wave]), atol=1e-8)
    more = file_of(tmp_path / "b.csv", time=time, voltage1=wave, voltage2=wave, position1=wave, position2=wave)
    assert not read_for(rotary, more).voltage[:, 1].any()
    assert "not used: voltage2" in read_for(rotary, more).notes[0]
    servo = machine(shoulder=servo_drive(), elbow=passive())
    path = file_of(tmp_path / "c.csv", t_s=time, goal1_deg=90 * wave, q1_rad=wave, q2_rad=wave)
    with pytest.raises(
        RecordingError, match="--columns time=t_s,setpoint1=goal1_deg,position1=q1_rad,position2=q2_rad"
    ):
        read_for(servo, path)
    columns = {"time": "t_s", "setpoint1": "goal1_deg", "position1": "q1_rad", "position2": "q2_rad"}
    log = with_volts(read_for(servo, path, columns), servo)
    assert_allclose(log.setpoint[:, 0], 0.5 * np.pi * wave, atol=1e-7)
    assert log.voltage[:, 0].any() and not log.voltage[:, 1].any()
    with pytest.raises(RecordingError, match="setpoint1.*'test' has a servo in its drive"):
        with_volts(Log("log", time, wave[:, None], wave[:, None]), machine(shoulder=servo_drive()))


def test_logs_of_another_number_of_joints_are_refused(tmp_path):
    time, two = 0.01 * np.arange(50), machine(shoulder=torque_drive(), elbow=torque_drive())
    one = file_of(tmp_path / "one.csv", time=time, voltage1=time, position1=time)
    with pytest.raises(RecordingError, match=r"line 1: channel 'voltage2' is missing; .* The plant has 2 joints"):
        read_for(two, one)
    names = [f"{group}{j}" for group in ("voltage", "position") for j in (1, 2, 3)]
    three = file_of(tmp_path / "three.csv", time=time, **dict.fromkeys(names, time))
    with pytest.raises(RecordingError, match=r"line 1: column 'voltage3'; expected a log of 2 joints"):
        read_for(two, three)
    with pytest.raises(RecordingError, match=r"unknown channel 'position3'; expected "):
        read_for(two, three, {"position3": "position3"})


def test_no_motion_is_designed_where_a_joint_takes_no_volts():
    for joints in ({"base": torque_drive(), "shoulder": passive()}, {"shoulder": servo_drive()}):
        mechanism = machine(**joints)
        with pytest.raises(ParameterError, match="'test' has a joint that cannot be given volts"):
            suspects_of(["coulomb_friction@1"], mechanism)
        friction = [Hypothesis("coulomb_friction", 1), Hypothesis("stribeck_friction", 1)]
        assert next_experiment(mechanism, [friction], friction, "log.csv") is None


def test_numbers_of_a_servo_are_known_and_of_all_drives(tmp_path, capsys):
    wide = {"value": GAIN, "unit": "V/rad", "relative_deviation": 0.1}
    with pytest.raises(ParameterError, match="shoulder.drive.servo_gain: relative_deviation; expected known: true"):
        linkage(shoulder=servo_drive(servo_gain=wide))
    with pytest.raises(ParameterError, match="elbow.drive.amplifier: torque; expected position, as on the other axes"):
        linkage(shoulder=servo_drive(), elbow=torque_drive())
    assert call("mechanism", "new", tmp_path / "arm.yaml", "--kind", "pendulum", "--drive", "position") == 0
    assert "servo_gain: {value: , unit: V/rad, known: true" in (tmp_path / "arm.yaml").read_text()
