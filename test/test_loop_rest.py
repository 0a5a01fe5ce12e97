# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs in which a joint mostly rests, held by its friction."""

from __future__ import annotations

import numpy as np
import pytest

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify import explain
from puma_sim_core.identify.data.machine_log import read_for
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise import innovations
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation import tracking
from puma_sim_core.simulation.simulator import Simulator

QUANTUM, STEP = 1.5e-3, 5e-3
PENDULUM, DOUBLE = load_mechanism("dfki_pendulum"), load_mechanism("dfki_double_c1")
FRICTION = parse_effect("coulomb_friction:joint=1,torque=0.2")


def servo_log(path, goal, seconds, seed=5, plant=None):
    """Write a log of a machine, a pendulum with dry friction, under servos without integral part. goal : time [s] ->
    [rad], of each joint."""
    plant = PENDULUM.plant(effects=(FRICTION,)) if plant is None else plant
    rng, time, axes = np.random.default_rng(seed), STEP * np.arange(round(seconds / STEP)), np.array(plant.axes)
    simulator = Simulator(plant)
    simulator.reset(np.atleast_1d(goal(0.0)))
    torque, position = np.empty((2, len(time), len(axes)))
    for k, t in enumerate(time):
        state = np.array(simulator.state)
        position[k] = QUANTUM * np.round(state[axes] / QUANTUM)
        torque[k] = 20.0 * (goal(t) - position[k]) - 0.8 * state[3 + axes]
        simulator.step(torque[k] + 0.05 * rng.standard_normal(len(axes)), STEP)
    names = [f"{channel}{j + 1}" for channel in ("voltage", "position") for j in range(len(axes))]
    table = np.column_stack([time, torque, position])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(["time", *names]), comments="")
    return str(path)


def all_but_held(path):
    """Write a log of the pendulum along a triangle at whose ends alone the servo's torque passes the friction."""
    return servo_log(path, lambda t: 0.022 * (np.abs((0.25 * t) % 4.0 - 2.0) - 1.0), 40.0)


def frictions(*torques):
    """Dry friction of the joints, one by one."""
    return tuple(parse_effect(f"coulomb_friction:joint={j},torque={torque}") for j, torque in enumerate(torques, 1))


def one_moves(path, *torques):
    """Write a log of the double pendulum whose elbow swings, while the friction of its shoulder all but holds that."""
    plant = DOUBLE.plant(effects=frictions(*torques))
    return servo_log(
        path, lambda t: np.array([0.05, 0.2 * np.sin(2.0 * t) + 0.06 * np.sin(5.0 * t)]), 15.0, plant=plant
    )


@pytest.mark.thorough
def test_dry_friction_is_named_where_the_joint_moves_now_and_then(tmp_path):
    goals = 0.4 * np.random.default_rng(2).uniform(-1.0, 1.0, 10)
    found = explain(servo_log(tmp_path / "log.csv", lambda t: float(goals[int(t / 3.0)]), 30.0), plant="dfki_pendulum")
    assert [(effect.name, effect.joint) for effect in found.effects] == [("coulomb_friction", 1)]
    torque = found.effects[0].parameters["torque"]
    assert torque.low < 0.2 < torque.high < 0.3


@pytest.mark.thorough
def test_dry_friction_is_named_on_a_joint_that_it_all_but_holds(tmp_path):
    found = explain(all_but_held(tmp_path / "log.csv"), plant="dfki_pendulum")
    (torque,) = (e.parameters["torque"] for e in found.effects if (e.name, e.joint) == ("coulomb_friction", 1))
    # with less the parameters answer to it; with 0.3 N.m it would be held at the ends as well
    assert torque.low < 0.2 < torque.high < 0.3


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


def test_a_joint_that_rests_has_the_noise_of_its_sensor(tmp_path):
    log = read_for(DOUBLE, one_moves(tmp_path / "log.csv", 0.4, 0.15))
    steps = np.count_nonzero(np.diff(log.position, axis=0), axis=0)
    assert 0 < steps[0] < 20 < steps[1]
    assert log.quantum == pytest.approx([QUANTUM, QUANTUM], rel=1e-3) == sample([log]).quantum
    noise = sample([log]).position_noise
    assert noise[0] == pytest.approx(QUANTUM / np.sqrt(12.0), rel=1e-3)
    predictor = Predictor([log], DOUBLE, [lambda t: t > 1e9], None, noise)
    errors = predictor.errors(DOUBLE.plant())
    for weighting in (predictor.unfiltered_weighting(errors), innovations.weighting(predictor, errors)):
        # what a sensor's white noise leaves in the rows of a joint that rests is not blown up
        shown = weighting(noise * np.random.default_rng(1).standard_normal(errors.shape))
        assert np.sqrt((shown[:, 0] ** 2).mean()) < 1.1


@pytest.mark.long
@pytest.mark.parametrize("more", [(), (parse_effect("joint_elasticity:joint=1,stiffness=200,damping=0.15"),)])
def test_errors_of_prediction_change_with_the_friction_and_do_not_jump(more, tmp_path):
    """Along a motion that turns round slowly: four times finer steps of the level change them a quarter as much."""
    true = PENDULUM.plant(effects=(*more, FRICTION))
    log = read_for(PENDULUM, servo_log(tmp_path / "log.csv", lambda t: 0.1 * np.sin(0.6 * t), 20.0, plant=true))
    predictor = Predictor([log], PENDULUM, [lambda t: t > 1e9], None, sample([log]).position_noise)
    rows = predictor.fit_rows[:, 0]

    def greatest_change(step):
        plants = (PENDULUM.plant(effects=(*more, *frictions(level))) for level in np.arange(0.16, 0.24, step))
        squares = [float((predictor.errors(plant)[rows, 0] ** 2).sum()) for plant in plants]
        return np.abs(np.diff(squares)).max()

    assert greatest_change(5e-4) < 0.35 * greatest_change(2e-3)


@pytest.mark.parametrize("share", [0.5, 0.99, 1.5, 3.0, -3.0])
def test_a_joint_that_sticks_is_moved_by_the_torque_that_its_friction_does_not_bear(share):
    """The torque that gives it a velocity within a row, over its friction: what is left stops within v^2 / 2a."""
    slide = load_mechanism("slide")
    plant = slide.plant(effects=(parse_effect("coulomb_friction:joint=1,torque=4"),))
    mass = float((slide.inertia(slide.start, np.zeros((1, 1))) + slide.drive(slide.start).motor_inertia)[0, 0])
    stop, gain, h = 4.0 / mass, 10.0, 0.01
    measured = share * stop * h / gain
    rows = np.full((4, 1), measured)
    simulator = Simulator(plant, max_step=1e-4)
    simulator.reset([0.0])
    # only the first row corrects, and its velocity alone
    corrected = np.array([True, False, False])
    found = tracking.innovations(simulator, h * np.arange(4), 0.0 * rows, rows, [[0.0, gain, 0.0]], None, corrected)
    left = np.sign(share) * max(abs(share) - 1.0, 0.0) * stop * h
    assert found.position[0, 0] == 0.0 and found.velocity[2, 0] == 0.0
    # its damping stops it a little earlier
    assert found.position[2, 0] == pytest.approx(left * abs(left) / (2.0 * stop), rel=0.05, abs=0.0)


@pytest.mark.thorough
def test_friction_is_named_on_the_joint_that_moves_while_another_rests(tmp_path):
    found = explain(one_moves(tmp_path / "log.csv", 0.6, 0.15), plant="dfki_double_c1")
    torques = {(e.name, e.joint): e.parameters["torque"] for e in found.effects}
    assert set(torques) == {("coulomb_friction", 1), ("coulomb_friction", 2)}
    moves, holds = torques["coulomb_friction", 2], torques["coulomb_friction", 1]
    assert moves.low < 0.15 < moves.high and moves.value == pytest.approx(0.15, rel=0.1)
    # a joint that is held fits as well with any more
    assert 0.0 < holds.low < 0.6 and holds.at_least
    assert f"torque at least {holds.low:.3g} N.m" in found.sentence


@pytest.mark.thorough
def test_fits_from_far_parameters_end_where_that_from_the_truth_does(tmp_path):
    """Where friction holds a joint in most rows, parts of a step of Gauss and Newton lead astray."""
    log = read_for(PENDULUM, all_but_held(tmp_path / "log.csv"))
    predictor = Predictor([log], PENDULUM, [lambda t: t > 1e9], None, sample([log]).position_noise)
    errors = predictor.errors(PENDULUM.plant(effects=(FRICTION,)))
    fit, rng = PredictionFit(predictor, predictor.unfiltered_weighting(errors)), np.random.default_rng(3)
    best, _ = fit.to_end(Point(PENDULUM.start, (FRICTION,)), ((0, "torque"),))
    less = (parse_effect("coulomb_friction:joint=1,torque=0.05"),)
    for _ in range(8):
        far = PENDULUM.clip(PENDULUM.start + 2.5 * PENDULUM.deviations * rng.standard_normal(len(PENDULUM.start)))
        found, _ = fit.to_end(Point(far, less), ((0, "torque"),), times=6)
        assert found.objective < 1.1 * best.objective
