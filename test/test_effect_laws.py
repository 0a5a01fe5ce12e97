# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What each effect does to the motion, against closed forms and independent integrators."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from arm_reference import arm_of, bits, energy, mass_matrix, open_circuit, plant_of, right_hand_side, smooth_voltages
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from test_rigid_body import assert_same_dynamics, central_inertia, mujoco_chain
from trace_form import arm_table, trace_coriolis, trace_gravity, trace_inertia

from puma_sim_core.arm.kinematics import dh_table, link_transforms, wrist_position
from puma_sim_core.arm.rigid_body import arm_pseudo_inertias, coriolis, gravity_torque, inertia
from puma_sim_core.dynamics.torques import bristle_flow
from puma_sim_core.effects import KINDS
from puma_sim_core.effects.soft_stop import stop_torque
from puma_sim_core.jit import interpreted
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

HOLD = Constraint("hold")
R = 1.6
KT = np.array([m.torque_constant * m.gear_ratio for m in arm_of("bejczy").motors])


def on_joint_1(effects, time, torque, max_step=SERVO_PERIOD, position=0.0):
    """Run of joint 1 alone under static torques [N.m] at the joint, applied as volts."""
    simulator = Simulator(plant_of(*effects), constraints=(Constraint(), HOLD, HOLD), max_step=max_step)
    volts = np.zeros((len(time), 3))
    volts[:, 0] = np.asarray(torque) * R / KT[0]
    simulator.reset((position, -1.0, 0.5), current=(volts[0, 0] / R, 0.0, 0.0))
    return simulator.run(time, volts), simulator


# ------------------------------------------------------------------------- friction that slides


@pytest.mark.parametrize(
    "effects, positive, negative, viscous",
    [
        (["viscous_friction:joint=1,coefficient=5.8"], 0.0, 0.0, 5.8),
        (["coulomb_friction:joint=1,torque=20"], 20.0, 20.0, 0.0),
        (["asymmetric_coulomb_friction:joint=1,positive=24.7,negative=27.2"], 24.7, 27.2, 0.0),
        (
            [
                "coulomb_friction:joint=1,torque=20",
                "viscous_friction:joint=1,coefficient=5.8",
                "asymmetric_coulomb_friction:joint=1,positive=3,negative=0",
            ],
            23.0,
            20.0,
            5.8,
        ),
        (["presliding_friction:joint=1,torque=15"], 15.0, 15.0, 0.0),
        (
            [
                "presliding_friction:joint=1,torque=5",
                "coulomb_friction:joint=1,torque=10",
                "asymmetric_coulomb_friction:joint=1,positive=1,negative=2",
                "stribeck_friction:joint=1,torque=4",
            ],
            16.0,
            17.0,
            0.0,
        ),
    ],
)
def test_terminal_speed_shows_the_level_of_each_direction(effects, positive, negative, viscous):
    time = np.arange(0.0, 3.0, 0.1)
    back_emf = 0.26 * 62.55 * KT[0] / R
    for direction, level in ((1.0, positive), (-1.0, negative)):
        run, _ = on_joint_1(effects, time, np.full(len(time), direction * 300.0))
        speed = (300.0 - level) / (back_emf + viscous)
        assert run.velocity[-1, 0] == pytest.approx(direction * speed, rel=1e-9)


def test_stribeck_friction_falls_with_the_speed_as_its_equation_says():
    time = np.arange(0.0, 3.0, 0.1)
    effects = ["coulomb_friction:joint=1,torque=10", "stribeck_friction:joint=1,torque=8,velocity=0.5"]
    run, _ = on_joint_1(effects, time, np.full(len(time), 80.0))
    speed = run.velocity[-1, 0]
    level = 80.0 - 0.26 * 62.55 * KT[0] / R * speed
    assert 0.1 < speed < 0.5
    assert level == pytest.approx(10.0 + 8.0 * np.exp(-((speed / 0.5) ** 2)), rel=1e-9)


# --------------------------------------------------------------------------- bristle, presliding


def ramp(*corners, steps=400, row=0.02):
    """Times and torques that pass slowly from corner to corner."""
    torque = np.concatenate(
        [np.linspace(a, b, steps, endpoint=False) for a, b in itertools.pairwise(corners)] + [corners[-1:]]
    )
    return row * np.arange(len(torque)), torque


def dahl(torque, level, stiffness):
    """Travel under a slow load: dF/dq = stiffness (1 - F sgn(qd) / level), integrated."""
    q, travel = 0.0, [0.0]
    for a, b in itertools.pairwise(torque):
        s = np.sign(b - a)
        q += s * level / stiffness * np.log((1.0 - s * a / level) / (1.0 - s * b / level))
        travel.append(q)
    return np.array(travel)


def test_presliding_is_a_spring_under_small_loads():
    time, torque = ramp(0.0, 0.2, -0.2, 0.0)
    run, _ = on_joint_1(["presliding_friction:joint=1,stiffness=2e4,torque=20"], time, torque)
    np.testing.assert_allclose(run.position[:, 0], torque / 2e4, rtol=0, atol=2e-7)


def test_presliding_has_the_hysteresis_loop_of_its_equation():
    level, stiffness = 20.0, 2e4
    time, torque = ramp(0.0, 15.0, -15.0, 15.0)
    run, _ = on_joint_1([f"presliding_friction:joint=1,stiffness={stiffness},torque={level}"], time, torque)
    q, expected = run.position[:, 0], dahl(torque, level, stiffness)
    # the load moves on by up to .075 N.m while the arm follows it
    np.testing.assert_allclose(q, expected, rtol=0, atol=0.02 * np.ptp(expected))
    loop = slice(400, None)
    area = np.trapezoid(torque[loop], q[loop]) if hasattr(np, "trapezoid") else np.trapz(torque[loop], q[loop])
    exact = (np.trapezoid if hasattr(np, "trapezoid") else np.trapz)(torque[loop], expected[loop])
    assert area > 0.0 and area == pytest.approx(exact, rel=0.02)
    assert abs(q[-1] - q[400]) < 0.02 * np.ptp(q)


def test_presliding_does_not_drift_under_a_constant_load():
    time = np.append(np.arange(0.0, 5.0, 0.1), [60.0, 120.0])
    for effects in (
        ["presliding_friction:joint=1,stiffness=2e4,torque=20"],
        [
            "presliding_friction:joint=1,stiffness=1e6",
            "coulomb_friction:joint=1,torque=15",
            "stribeck_friction:joint=1,torque=5",
        ],
    ):
        run, _ = on_joint_1(effects, time, np.full(len(time), 12.0))
        assert run.position[-1, 0] > 0.0
        assert abs(run.position[-1, 0] - run.position[-2, 0]) < 1e-9


@settings(max_examples=30)
@given(st.floats(1.0, 1e6), st.floats(0.0, 40.0), st.integers(0, 2**32 - 1))
def test_bristles_never_bend_beyond_their_level(stiffness, level, seed):
    plant = plant_of(*[f"presliding_friction:joint={j},stiffness={stiffness!r},torque={level!r}" for j in (1, 2, 3)])
    simulator = Simulator(plant)
    simulator.reset((0.1, -1.2, 1.0))
    random = np.random.default_rng(seed)
    for _ in range(40):
        simulator.step(random.uniform(-15, 15, 3), 0.01)
        assert np.abs(simulator.bristles).max() <= level / stiffness * (1.0 + 1e-12)


@given(z=st.floats(-1, 1), travel=st.floats(-1e3, 1e3), bound=st.floats(1e-9, 1.0))
def test_bristle_flow_is_a_flow(z, travel, bound):
    flow = interpreted(bristle_flow)
    z *= bound
    end = flow(z, travel, bound)
    assert abs(end) <= bound * (1.0 + 1e-15)
    half = flow(flow(z, travel / 2, bound), travel / 2, bound)
    assert half == pytest.approx(end, abs=1e-14 * bound + 1e-300)
    assert (end - z) * travel >= -1e-15 * bound * abs(travel)


def test_stiff_bristles_tend_to_coulomb_friction():
    time, volts = smooth_voltages((9.0, 12.0, 6.0), 2.0)
    levels = ((1, 15), (2, 20), (3, 8))

    def position(effects):
        simulator = Simulator(plant_of(*effects), max_step=SERVO_PERIOD / 4)
        simulator.reset((0.1, -1.2, 1.0))
        return simulator.run(time, volts).position

    coulomb = position([f"coulomb_friction:joint={j},torque={c}" for j, c in levels])
    errors = [
        np.abs(position([f"presliding_friction:joint={j},torque={c},stiffness={s}" for j, c in levels]) - coulomb).max()
        for s in (1e4, 1e5, 1e6)
    ]
    assert errors[2] < errors[1] / 2 < errors[0] / 10
    assert errors[2] < 3e-4 and np.ptp(coulomb, axis=0).min() > 0.1


def test_the_stiffest_bristles_are_stable_at_the_servo_rate():
    # as springs they turn the joints by a radian of phase in a step
    bound = next(p.high for p in KINDS["presliding_friction"].parameters if p.name == "stiffness")
    plant = plant_of(*[f"presliding_friction:joint={j},torque=60,stiffness={bound}" for j in (1, 2, 3)])
    simulator = Simulator(plant)
    simulator.reset((0.1, -1.2, 1.0))
    simulator.step((1.0, 1.0, 1.0), 2.0)
    before = simulator.state
    simulator.step((1.0, 1.0, 1.0), 1.0)
    assert np.abs(simulator.state[3:6]).max() < 1e-12
    assert np.abs(np.subtract(simulator.state[:3], before[:3])).max() < 1e-12


@pytest.mark.parametrize("joint", range(3))
def test_bristles_far_below_their_level_are_springs_of_the_order_of_the_method(joint):
    # a joint without motor and gravity then vibrates for ever, and no step may add to it
    stiffness, speed, duration = 1e5, 1e-8, 0.2
    plant = plant_of(f"presliding_friction:joint={joint + 1},stiffness={stiffness},torque=500")
    plant = open_circuit(Plant(replace(plant.arm, gravity=0.0), plant.effects))
    omega = np.sqrt(stiffness / mass_matrix(plant, (0.0, -1.0, 0.5))[joint, joint])
    start = np.zeros(3)
    start[joint] = speed
    errors = []
    for n in (1, 2, 4):
        simulator = Simulator(
            plant, max_step=SERVO_PERIOD / n, constraints=[Constraint() if j == joint else HOLD for j in range(3)]
        )
        simulator.reset((0.0, -1.0, 0.5), start)
        time = SERVO_PERIOD * np.arange(duration / SERVO_PERIOD)
        run = simulator.run(time, np.zeros((len(time), 3)))
        velocity = run.velocity[:, joint] / speed
        assert np.abs(velocity).max() <= 1.0
        errors.append(np.abs(velocity - np.cos(omega * time)).max())
    assert errors[0] / errors[1] > 12.0 and errors[1] / errors[2] > 12.0


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(1e2, 1e6))
def test_bristles_never_make_energy(seed, stiffness):
    plant = open_circuit(
        plant_of(
            *[
                f"presliding_friction:joint={j},torque={c},stiffness={stiffness!r}"
                for j, c in ((1, 20), (2, 20), (3, 10))
            ]
        )
    )
    random = np.random.default_rng(seed)
    simulator = Simulator(plant)
    simulator.reset(random.uniform(-2, 2, 3), random.uniform(-2, 2, 3))
    total = []
    for _ in range(60):
        stored = 0.5 * stiffness * np.square(simulator.bristles).sum()
        total.append(energy(plant, simulator.state[:3], simulator.state[3:6]) + stored)
        simulator.step((0.0, 0.0, 0.0), 0.01)
    assert np.max(np.diff(total)) < 1e-9


# ------------------------------------------------------------------------------------- amplifier


@settings(max_examples=30)
@given(limits=st.tuples(*[st.floats(0.01, 10)] * 3), seed=st.integers(0, 2**32 - 1))
def test_current_never_exceeds_its_limit(limits, seed):
    plant = plant_of(*[f"current_limit:joint={j},current={c!r}" for j, c in zip((1, 2, 3), limits)])
    time = np.arange(0.0, 0.5, 0.003)
    volts = np.random.default_rng(seed).uniform(-40, 40, (len(time), 3))
    current = Simulator(plant).run(time, volts).current
    assert (np.abs(current) <= limits).all()
    assert (np.abs(current) == limits).any(axis=0).all()


def test_current_reaches_its_limit_and_leaves_it_when_it_should():
    # motors of held joints are resistors and inductors: the current is known in closed form
    limit, tau, step = 4.0, 0.003, 1e-4
    simulator = Simulator(plant_of(f"current_limit:joint=1,current={limit}"), constraints=(HOLD,) * 3, max_step=step)
    time = np.arange(0.0, 0.0201, step)
    volts = np.zeros((len(time), 3))
    volts[:, 0] = np.where(time < 0.01 - step / 2, 16.0, -3.2)
    current = simulator.run(time, volts).current[:, 0]
    reached = -tau * np.log(1.0 - limit / 10.0)
    up = time < reached
    np.testing.assert_allclose(current[up], 10.0 * -np.expm1(-time[up] / tau), rtol=0, atol=1e-7)
    held = (time > reached + step) & (time <= 0.01 + step / 2)
    assert (current[held] == limit).all()
    down = time > 0.01 + step / 2
    np.testing.assert_allclose(current[down], -2.0 + 6.0 * np.exp(-(time[down] - 0.01) / tau), rtol=0, atol=1e-7)


def test_saturated_voltages_are_those_of_the_supply():
    time, volts = smooth_voltages((60.0, 50.0, 30.0), 1.0)
    limited = Simulator(
        plant_of(*[f"voltage_saturation:joint={j},voltage={v}" for j, v in ((1, 24.0), (2, 40.0), (3, 10.0))])
    )
    clipped = Simulator(plant_of())
    supply = np.array([24.0, 40.0, 10.0])
    assert bits(limited.run(time, volts).position) == bits(clipped.run(time, np.clip(volts, -supply, supply)).position)


# -------------------------------------------------------------------------------- stops and loads


@pytest.mark.parametrize("stiffness, damping", [(1e4, 100.0), (3e3, 0.0), (5e4, 400.0)])
def test_soft_stop_agrees_with_an_independent_integration(stiffness, damping):
    lower, upper = np.array([-0.2, -1.0, 0.3]), np.array([0.25, -0.5, 0.9])
    effects = [
        f"soft_stop:joint={j + 1},lower={lower[j]},upper={upper[j]},stiffness={stiffness},damping={damping}"
        for j in range(3)
    ]
    plant, volts = plant_of(*effects), np.array([8.0, 10.0, -6.0])
    touched = []

    def stop(q, qd):
        torque = np.zeros(3)
        for j in range(3):
            for depth, side in ((q[j] - upper[j], 1.0), (lower[j] - q[j], -1.0)):
                if depth > 0.0:
                    torque[j] = -side * max(stiffness * depth + damping * side * qd[j], 0.0)
                    touched.append(j)
        return torque

    y = solve_ivp(
        right_hand_side(plant, volts, torque=stop),
        (0.0, 1.0),
        [0.0, -0.7, 0.6, 1.5, 1.0, -1.0, 0, 0, 0],
        rtol=1e-9,
        atol=1e-11,
        max_step=0.002,
    ).y[:, -1]
    simulator = Simulator(plant, max_step=SERVO_PERIOD / 8)
    simulator.reset((0.0, -0.7, 0.6), (1.5, 1.0, -1.0))
    simulator.step(volts, 1.0)
    assert set(touched) == {0, 1, 2}
    np.testing.assert_allclose(simulator.state, y, rtol=0, atol=2e-5)


@given(
    q=st.floats(-3, 3),
    qd=st.floats(-5, 5),
    ends=st.tuples(st.floats(-2, 0), st.floats(0.1, 2)),
    stiffness=st.floats(0, 1e6),
    damping=st.floats(0, 1e3),
)
def test_a_stop_never_pulls_back(q, qd, ends, stiffness, damping):
    torque = interpreted(stop_torque)((*ends, stiffness, damping), 0, q, qd)
    if ends[0] <= q <= ends[1]:
        assert torque == 0.0
    else:
        assert torque * (1.0 if q > ends[1] else -1.0) >= 0.0


@pytest.mark.parametrize("q, qd", [(1.001, -5.0), (-1.001, 5.0)])
def test_a_stop_lets_go_of_a_joint_that_leaves_it_fast(q, qd):
    # its damping alone would hold the joint back with 500 N.m; the spring gives 10 N.m
    assert interpreted(stop_torque)((-1.0, 1.0, 1e4, 100.0), 0, q, qd) == 0.0
    assert abs(interpreted(stop_torque)((-1.0, 1.0, 1e4, 100.0), 0, q, -qd)) > 500.0


def test_an_arm_rests_on_its_stop_by_load_over_stiffness():
    time = np.arange(0.0, 3.0, 0.1)
    run, _ = on_joint_1(["soft_stop:joint=1,lower=-1,upper=0.1"], time, np.full(len(time), 50.0))
    assert run.position[-1, 0] == pytest.approx(0.1 + 50.0 / 1e4, abs=1e-12)


PAYLOADS = [(5.0, 0.0, 0.0, 0.4331), (2.3, 0.11, -0.2, 0.5), (50.0, -0.3, 0.1, -0.1)]


@pytest.mark.parametrize("mass, x, y, z", PAYLOADS)
def test_payload_equals_a_mass_added_to_link_3_in_the_trace_form(mass, x, y, z):
    plant = plant_of(f"payload:mass={mass},x={x},y={y},z={z}")
    bodies, table = arm_pseudo_inertias(plant.arm), arm_table(plant.arm)
    bodies[2] += mass * np.outer((x, y, z, 1.0), (x, y, z, 1.0))
    arm = plant.loaded_arm
    for q in np.random.default_rng(5).uniform(-3, 3, (30, 3)):
        for closed, trace in (
            (inertia(q, arm), trace_inertia(q, bodies, table)),
            (coriolis(q, arm), trace_coriolis(q, bodies, table)),
            (gravity_torque(q, arm), trace_gravity(q, bodies, table)),
        ):
            np.testing.assert_allclose(closed, trace, rtol=1e-12, atol=2e-12)


@pytest.mark.parametrize("mass, x, y, z", PAYLOADS)
def test_payload_equals_a_body_in_mujoco(mass, x, y, z):
    plant = plant_of(f"payload:mass={mass},x={x},y={y},z={z}")
    bodies = [(link.mass, np.array(link.centre), central_inertia(link)) for link in plant.arm.links]
    m3, centre, tensor = bodies[2]
    both = (m3 * centre + mass * np.array([x, y, z])) / (m3 + mass)

    def shifted(m, offset):
        return m * (offset @ offset * np.eye(3) - np.outer(offset, offset))

    tensor = tensor + shifted(m3, centre - both) + shifted(mass, np.array([x, y, z]) - both)
    bodies[2] = (m3 + mass, both, tensor)
    model, data = mujoco_chain(dh_table(plant.arm)[:3], bodies, plant.arm.motor_inertia, plant.arm.gravity)
    assert_same_dynamics(plant.loaded_arm, model, data)


def test_payload_hangs_at_the_wrist_unless_it_is_put_elsewhere():
    plant = plant_of("payload:mass=2")
    values = plant.effects[0].values
    q = np.array([0.3, -0.4, 0.8])
    tip = link_transforms(q, arm_table(plant.arm))[3] @ (values["x"], values["y"], values["z"], 1.0)
    np.testing.assert_allclose(tip[:3], wrist_position(q, plant.arm), atol=1e-15)
