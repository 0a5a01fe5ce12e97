# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Computed torque and velocity loops: inverse dynamics, decoupling, limits, what they bear."""

from __future__ import annotations

import numpy as np
import pytest
from arm_reference import plant_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_controllers import LOOPS, PLANT, START, columns, computed, follow

from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.control.computed_torque import InverseDynamics
from puma_sim_core.control.controllers import make_controller
from puma_sim_core.control.metrics import tracking_error
from puma_sim_core.control.setpoints import Move
from puma_sim_core.control.velocity_loop import VelocityLoop, VelocityLoopSettings
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.simulator import SERVO_PERIOD

SMOOTH = [Move(0.28, 1.2, (1.0, -0.8, 1.0))]


triple = st.lists(st.floats(-2.5, 2.5), min_size=3, max_size=3).map(np.array)


@settings(max_examples=60)
@given(
    triple,
    triple,
    triple,
    st.sampled_from(["bejczy", "corke_armstrong_1994"]),
    st.sampled_from(["physical", "printed"]),
)
def test_inverse_dynamics_are_those_of_the_matrices(q, v, a, name, form):
    plant = plant_of(name=name, torque_form=form)
    arm = plant.arm
    torque = (
        (inertia(q, arm) + np.diag(arm.motor_inertia)) @ a
        + np.einsum("ijk,j,k->i", coriolis(q, arm), v, v)
        + gravity_torque(q, arm)
    )
    current = torque / plant.torque_per_ampere
    expected = [m.resistance * i + m.back_emf * m.gear_ratio * w for m, i, w in zip(arm.motors, current, v)]
    np.testing.assert_allclose(InverseDynamics(plant).voltages(q, v, a), expected, rtol=1e-10, atol=1e-9)


def test_what_the_plant_has_beyond_its_arm_is_unknown_to_the_controller():
    plant = plant_of("payload:mass=2", "viscous_friction:joint=2,coefficient=9.5")
    q, v, a = (0.1, -0.4, 0.7), (0.3, -0.2, 0.5), (1.0, 2.0, 3.0)
    assert (
        InverseDynamics(plant).voltages(q, v, a)
        == InverseDynamics(PLANT).voltages(q, v, a)
        == InverseDynamics(PLANT.arm).voltages(q, v, a)
    )


@pytest.mark.parametrize("back_emf", ["measured", "reference"])
def test_smooth_paths_are_followed_within_a_milliradian(back_emf):
    run, path = follow(computed(back_emf=back_emf), SMOOTH, 2.8)
    assert tracking_error(run, path).worst.max() < 1.5e-3
    pid, _ = follow(make_controller("pid", PLANT), SMOOTH, 2.8)
    assert tracking_error(run, path).rms.max() < 0.1 * tracking_error(pid, path).rms.min()


def test_the_joints_are_decoupled():
    moves = [Move(0.28, 1.0, (1.0, 0.0, 0.0))]
    disturbed = [
        np.abs(follow(c, moves, 2.8)[0].position[:, 1:] - START[1:]).max()
        for c in (computed(), make_controller("pid", PLANT))
    ]
    assert disturbed[0] < 0.2e-3 < disturbed[1]


def test_an_unknown_load_is_lifted_by_the_sum():
    run, path = follow(computed(), SMOOTH, 5.6, plant_of("payload:mass=2.5"))
    np.testing.assert_allclose(run.position[-1], path[-1], atol=1e-6)
    assert tracking_error(run, path).worst.max() < 10e-3


def test_encoders_and_converter_do_not_upset_it():
    run, path = follow(computed(), SMOOTH, 2.8, chain=ServoConfig(encoder_counts=1000, converter_bits=12))
    assert tracking_error(run, path).worst.max() < 1.5e-3


@pytest.mark.parametrize("size", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("limit", [40.0, 20.0])
def test_a_step_is_a_bounded_move_that_hardly_overshoots(size, limit):
    controller = make_controller("computed_torque", PLANT, voltage_limit=limit)
    run, path = follow(controller, [Move(0.28, 0.0, (size,) * 3, "step")], 4.2, voltage_limit=limit)
    assert np.abs(run.voltage).max() <= limit
    beyond = (run.position - path[-1]).max(axis=0)
    assert beyond.max() < 0.01
    np.testing.assert_allclose(run.position[-1], path[-1], atol=1e-4)


def test_what_the_voltage_limit_kept_back_does_not_come_later():
    # 8 V hold the arm but cannot follow this path
    controller = make_controller("computed_torque", PLANT, voltage_limit=8.0)
    run, path = follow(controller, SMOOTH, 8.4, voltage_limit=8.0)
    assert (np.abs(run.voltage) == 8.0).mean() > 0.05
    assert (np.abs(run.position - path[-1]) < 0.01)[run.time > 5.0].all()


def test_the_velocity_loop_follows_smooth_paths_without_a_model():
    loop = VelocityLoop(VelocityLoopSettings(**LOOPS), SERVO_PERIOD, limit=40.0)
    run, path = follow(loop, SMOOTH, 2.8)
    assert tracking_error(run, path).worst.max() < 0.01
    again, _ = follow(loop, SMOOTH, 2.8)
    assert columns(run) == columns(again)
