# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The kernel against regression values, independent integrators, and laws of mechanics."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from arm_reference import (
    START,
    VISCOUS,
    bits,
    driving_torque,
    energy,
    mass_matrix,
    open_circuit,
    plant_of,
    reduced_accelerations,
    right_hand_side,
    smooth_voltages,
)
from scipy.integrate import solve_ivp

from puma_sim_core.arm.parameters import parameter_sets
from puma_sim_core.arm.third_order import acceleration_from_current, jerk
from puma_sim_core.jit import BACKEND
from puma_sim_core.simulation.conditions import CONSTRAINTS, Constraint
from puma_sim_core.simulation.simulator import Simulator

VOLTAGE = (20.0, -15.0, 10.0)
#: q(0.5 s) from START with VOLTAGE held, by form of equation 5.2
ENDS = {"physical": (0.68745378, -0.6102092, 1.07667885), "printed": (0.30113443, 0.48721605, 0.90871915)}


def random_state(seed):
    random = np.random.default_rng(seed)
    return random.uniform(-2.5, 2.5, 3), random.uniform(-1.5, 1.5, 3), random.uniform(-5, 5, 3)


# ------------------------------------------------------------------------- regression and peers


@pytest.mark.parametrize("form", ENDS)
def test_regression_value(form):
    simulator = Simulator(plant_of(*VISCOUS, torque_form=form))
    simulator.reset(*START)
    simulator.step(VOLTAGE, 0.5)
    np.testing.assert_allclose(simulator.state[:3], ENDS[form], rtol=0, atol=1e-7)


@pytest.mark.parametrize("form", ENDS)
def test_third_order_form_integrated_by_dop853_agrees(form):
    plant = plant_of(*VISCOUS, torque_form=form)
    H = plant.viscous_friction
    q, qd, current = START
    qdd = acceleration_from_current(q, qd, current, plant.arm, H, form)
    run = solve_ivp(
        lambda t, y: np.concatenate([y[3:], jerk(y[:3], y[3:6], y[6:], VOLTAGE, plant.arm, H, form)]),
        (0.0, 0.5),
        [*q, *qd, *qdd],
        method="DOP853",
        rtol=1e-10,
        atol=1e-12,
    )
    simulator = Simulator(plant, max_step=2e-4)
    simulator.reset(*START)
    recording = simulator.run([0.0, 0.5], [VOLTAGE, VOLTAGE], acceleration=True)
    np.testing.assert_allclose(recording.position[-1], run.y[:3, -1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(recording.velocity[-1], run.y[3:6, -1], rtol=0, atol=1e-8)
    np.testing.assert_allclose(recording.acceleration[-1], run.y[6:, -1], rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", parameter_sets())
@pytest.mark.parametrize("form", ["physical", "printed"])
def test_agrees_with_dop853_on_the_matrix_equations(name, form):
    plant = plant_of(*VISCOUS, "payload:mass=2,x=0.1", name=name, torque_form=form)
    y = np.concatenate(random_state(1))
    time = np.arange(5) * 0.1
    volts = np.random.default_rng(2).uniform(-20, 20, (5, 3))
    simulator = Simulator(plant, max_step=2e-4)
    simulator.reset(y[:3], y[3:6], y[6:])
    recording = simulator.run(time, volts)
    for row in range(4):
        y = solve_ivp(right_hand_side(plant, volts[row]), (0.0, 0.1), y, method="DOP853", rtol=1e-10, atol=1e-12).y[
            :, -1
        ]
        ours = np.concatenate([recording.position[row + 1], recording.velocity[row + 1], recording.current[row + 1]])
        np.testing.assert_allclose(ours, y, rtol=0, atol=3e-8)


# ------------------------------------------------------------------------------- laws and order


def test_error_falls_sixteen_fold_for_a_halved_step():
    time, volts = smooth_voltages((12.0, 12.0, 8.0), 1.6)
    plant = plant_of(*VISCOUS)

    def position(step):
        simulator = Simulator(plant, max_step=step)
        simulator.reset(*START)
        return simulator.run(time, volts).position

    exact = position(0.032 / 2048)
    errors = [np.abs(position(0.032 / n) - exact).max() for n in (64, 128, 256)]
    ratios = [a / b for a, b in pairwise(errors)]
    assert all(15.0 < ratio < 17.0 for ratio in ratios), ratios


@pytest.mark.parametrize("name", parameter_sets())
def test_energy_is_kept_with_open_circuit_motors(name):
    plant = open_circuit(plant_of(name=name))
    duration = 10.0 if BACKEND == "numba" or name == "bejczy" else 1.0
    simulator = Simulator(plant)
    simulator.reset((0.0, 0.0, 0.0), (0.2, 0.0, 0.0))
    time = np.arange(0.0, duration + 0.01, 0.02)
    recording = simulator.run(time, np.zeros((len(time), 3)))
    assert not recording.current.any()
    total = [energy(plant, q, qd) for q, qd in zip(recording.position, recording.velocity)]
    kinetic = [0.5 * qd @ mass_matrix(plant, q) @ qd for q, qd in zip(recording.position, recording.velocity)]
    assert np.ptp(kinetic) > 20.0
    assert np.ptp(total) < 1e-6 * np.ptp(kinetic)


def test_open_circuit_arm_falls_and_short_circuit_arm_creeps():
    # free fall from q = 0: joint 2 at 43 deg after .39 s; with shorted motors after 7.3 s
    limit = np.radians(43.0)
    for plant, when, resolution in ((open_circuit(plant_of()), 0.39, 0.01), (plant_of(), 7.3, 0.1)):
        simulator = Simulator(plant)
        time = np.arange(0.0, when + 1.0, resolution / 2)
        q2 = simulator.run(time, np.zeros((len(time), 3))).position[:, 1]
        assert abs(time[np.argmax(q2 > limit)] - when) < resolution


# --------------------------------------------------------------------------- constrained joints

#: 64 combinations of free, constant position, constant velocity and constant acceleration
COMBINATIONS = list(product(CONSTRAINTS, repeat=3))
VALUES = {"free": None, "hold": None, "velocity": 0.7, "acceleration": -1.3}


def constrained(kinds, plant):
    """A simulator under constraints, its start, and the accelerations that are given."""
    simulator = Simulator(plant, constraints=[Constraint(kind, VALUES[kind]) for kind in kinds])
    q, qd, current = random_state(3)
    qd = [{"hold": 0.0, "velocity": VALUES["velocity"]}.get(kind, w) for kind, w in zip(kinds, qd)]
    given = [{"free": None, "acceleration": VALUES["acceleration"]}.get(kind, 0.0) for kind in kinds]
    simulator.reset(q, qd, current)
    return simulator, (q, np.array(qd), current), given


def test_there_are_64_combinations():
    assert len(COMBINATIONS) == 64


@pytest.mark.parametrize("kinds", COMBINATIONS, ids="-".join)
def test_rows_of_constrained_joints_are_removed(kinds):
    plant = plant_of(*VISCOUS)
    simulator, (q, qd, current), given = constrained(kinds, plant)
    time = np.arange(0.0, 0.1001, 0.02)
    volts = np.tile(VOLTAGE, (len(time), 1))
    run = simulator.run(time, volts, acceleration=True)
    expected = reduced_accelerations(mass_matrix(plant, q), driving_torque(plant, q, qd, current), given)
    np.testing.assert_allclose(run.acceleration[0], expected, rtol=1e-11, atol=1e-11)
    reference = solve_ivp(
        right_hand_side(plant, VOLTAGE, given),
        (0.0, time[-1]),
        np.concatenate([q, qd, current]),
        method="DOP853",
        rtol=1e-9,
        atol=1e-11,
    ).y[:, -1]
    np.testing.assert_allclose(simulator.state, reference, rtol=0, atol=1e-6)
    for j, kind in enumerate(kinds):
        if kind == "hold":
            assert set(bits(run.position[:, j])) == set(bits(q[j]))
            assert not run.velocity[:, j].any()
        elif kind == "velocity":
            assert set(bits(run.velocity[:, j])) == set(bits(VALUES[kind]))
            np.testing.assert_allclose(run.position[:, j], q[j] + VALUES[kind] * time, rtol=0, atol=1e-13)
        elif kind == "acceleration":
            a = VALUES[kind]
            np.testing.assert_allclose(run.velocity[:, j], qd[j] + a * time, rtol=0, atol=1e-13)
            np.testing.assert_allclose(run.position[:, j], q[j] + qd[j] * time + a / 2 * time**2, rtol=0, atol=1e-13)


def test_a_held_joint_keeps_its_position_bit_for_bit():
    simulator = Simulator(plant_of(), constraints=(Constraint(), Constraint("hold"), Constraint()))
    simulator.reset((0.1, 0.1 + 0.2, 0.7), current=(0.0, 30.0, 0.0))
    simulator.step((40.0, 40.0, -40.0), 2.0)
    assert bits(simulator.state[1]) == bits(0.1 + 0.2)
    assert bits(simulator.state[4]) == bits(0.0)


def test_constant_velocity_is_the_initial_one_where_none_is_given():
    simulator = Simulator(plant_of(), constraints=(Constraint("velocity"),) * 3)
    simulator.reset(velocity=(0.3, -0.1, 0.0))
    simulator.step((40.0, 40.0, -40.0), 1.0)
    assert simulator.state[3:6] == (0.3, -0.1, 0.0)


def test_moving_constrained_joints_act_on_the_free_one():
    plant = plant_of()
    accelerations = {}
    for kind in ("hold", "velocity", "acceleration"):
        simulator, (_q, _qd, _current), _given = constrained(("free", kind, kind), plant)
        simulator.reset((0.0, -1.0, 0.5), [0.0 if kind == "hold" else 0.7] * 3)
        accelerations[kind] = simulator.run([0.0, 1e-3], np.zeros((2, 3)), acceleration=True).acceleration[0, 0]
    assert accelerations["hold"] == 0.0
    assert abs(accelerations["velocity"]) > 0.1
    assert abs(accelerations["acceleration"] - accelerations["velocity"]) > 0.1


UPRIGHT = (0.0, -np.pi / 2, np.pi / 2)
LOCKED_INERTIA = (2.498, 6.328, 1.129)
FREE_INERTIA = (1.355, 2.975, 0.924)


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_locked_joints_give_the_inertia_that_overwriting_does_not(joint):
    # section 6.2 overwrites the other joints after a step in which they are free
    plant = plant_of()

    def apparent_inertia(constraint):
        constraints = [constraint] * 3
        constraints[joint - 1] = Constraint()
        found = []
        for current in (0.0, 1.0):
            simulator = Simulator(plant, constraints=constraints)
            currents = [0.0] * 3
            currents[joint - 1] = current
            simulator.reset(UPRIGHT, current=currents)
            found.append(simulator.run([0.0, 1e-3], np.zeros((2, 3)), acceleration=True).acceleration[0, joint - 1])
        return plant.torque_per_ampere[joint - 1] / (found[1] - found[0])

    locked, free = apparent_inertia(Constraint("hold")), apparent_inertia(Constraint())
    assert locked == pytest.approx(LOCKED_INERTIA[joint - 1], abs=6e-4)
    assert free == pytest.approx(FREE_INERTIA[joint - 1], abs=6e-4)
