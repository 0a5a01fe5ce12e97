# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs in which a joint mostly rests, held by its friction."""

from __future__ import annotations

import numpy as np
import pytest

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify import explain
from puma_sim_core.identify.data.machine_log import read_for
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise import innovations
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator

QUANTUM, STEP = 1.5e-3, 5e-3
PENDULUM = load_mechanism("dfki_pendulum")
FRICTION = parse_effect("coulomb_friction:joint=1,torque=0.2")


def servo_log(path, goal, seconds, seed=5):
    """Write a log of a pendulum with dry friction under a servo without integral part. goal : time [s] -> [rad]."""
    rng, time = np.random.default_rng(seed), STEP * np.arange(round(seconds / STEP))
    simulator = Simulator(PENDULUM.plant(effects=(FRICTION,)))
    simulator.reset([0.0])
    q, qd = PENDULUM.plant().axes[0], 3 + PENDULUM.plant().axes[0]
    torque, position = np.empty((len(time), 1)), np.empty((len(time), 1))
    for k, t in enumerate(time):
        position[k] = QUANTUM * np.round(simulator.state[q] / QUANTUM)
        torque[k] = 20.0 * (goal(t) - position[k]) - 0.8 * simulator.state[qd]
        simulator.step(torque[k] + 0.05 * rng.standard_normal(1), STEP)
    table = np.column_stack([time, torque, position])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header="time,voltage1,position1", comments="")
    return str(path)


@pytest.mark.long
def test_dry_friction_is_named_where_the_joint_moves_now_and_then(tmp_path):
    goals = 0.4 * np.random.default_rng(2).uniform(-1.0, 1.0, 10)
    found = explain(servo_log(tmp_path / "log.csv", lambda t: float(goals[int(t / 3.0)]), 30.0), plant="dfki_pendulum")
    assert [(effect.name, effect.joint) for effect in found.effects] == [("coulomb_friction", 1)]
    torque = found.effects[0].parameters["torque"]
    assert torque.low < 0.2 < torque.high < 0.3


@pytest.mark.long
def test_dry_friction_is_named_on_a_joint_that_it_all_but_holds(tmp_path):
    # of this triangle the servo's torque passes the friction at the ends alone
    found = explain(
        servo_log(tmp_path / "log.csv", lambda t: 0.022 * (np.abs((0.25 * t) % 4.0 - 2.0) - 1.0), 40.0),
        plant="dfki_pendulum",
    )
    (torque,) = (e.parameters["torque"] for e in found.effects if (e.name, e.joint) == ("coulomb_friction", 1))
    # a joint that is held fits as well with any more, and no evidence goes with an interval that holds zero
    assert 0.1 < torque.low < 0.2 and torque.high == np.inf
    assert f"torque at least {torque.low:.3g} N.m" in found.sentence


def test_the_noise_of_a_joint_is_that_of_its_motion_however_short_that_is(tmp_path):
    # to and fro every four seconds: in no segment of 1.5 s does it move for half
    path = servo_log(tmp_path / "log.csv", lambda t: 0.03 * (-1.0) ** int(t / 4.0), 80.0)
    log = read_for(PENDULUM, path)
    predictor = Predictor([log], PENDULUM, [lambda t: t > 1e9], None, np.array([QUANTUM / np.sqrt(12.0)]))
    moving = predictor.noisy_rows
    assert 0.02 < moving.mean() < 0.4
    errors = predictor.errors(PENDULUM.plant(effects=(FRICTION,)))
    for weighting in (predictor.unfiltered_weighting(errors), innovations.weighting(predictor, errors)):
        assert 0.1 < float((weighting(errors)[moving] ** 2).mean()) < 10.0
