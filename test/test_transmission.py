# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Play, errors of the gear, and the other effects beside a drive with two masses."""

from __future__ import annotations

import numpy as np
import pytest
from arm_reference import bits, open_circuit, plant_of, smooth_voltages
from hypothesis import given
from hypothesis import strategies as st
from two_mass_support import (
    HELD,
    POSE,
    SHARE,
    VISCOUS,
    Oracle,
    drift,
    elastic,
    free_only,
    masses,
    rest,
    started,
    weightless,
)

from puma_sim_core.arm.rigid_body import gravity_torque, inertia
from puma_sim_core.effects import parse_effect
from puma_sim_core.effects.shared.drive_train import gear_output, in_series, transmitted
from puma_sim_core.plant.linkage.linkage_plant import LinkagePlant
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator

# -------------------------------------------------------------------------------------------- play


def test_play_on_one_joint_and_elasticity_on_another_move_as_their_equations_say():
    effects = ["backlash:joint=1,gap=0.002,stiffness=3e4,damping=40", elastic(3, 5e3, 2.0)]
    simulator = started(plant_of(*effects, *VISCOUS), max_step=1e-4)
    time = np.arange(0.0, 0.24, 0.02)
    volts = np.column_stack([np.where(time < 0.1, 10.0, -14.0), 0 * time - 4, 5 * np.cos(9 * time)])
    oracle = Oracle(simulator.plant, {0: (3e4, 40.0, 0.002), 2: (5e3, 2.0, 0.0)}, {})
    expected = oracle.run(simulator, time, volts, 1e-7, max_step=5e-4)
    found = simulator.run(time, volts)
    twist = found.position[:, 0] - simulator.link_motion[:, 0]
    assert twist.max() > 0.001 and twist.min() < -0.001
    # a contact begins somewhere within a step, and is not located
    assert np.abs(found.position - expected[:, :3]).max() < 2e-6
    assert np.abs(simulator.link_motion[:, 0] - expected[:, 9]).max() < 5e-6


def test_play_without_damping_keeps_the_energy():
    effects = [
        "backlash:joint=2,gap=0.004,stiffness=2e4,damping=0",
        "backlash:joint=3,gap=0.004,stiffness=1e4,damping=0",
        "transmission_error:joint=1,amplitude=0.01,order=6",
    ]
    assert drift(effects, {2: (2e4, 0.004), 3: (1e4, 0.004)}, 2e-4) < 2e-3


def test_a_link_falls_through_the_gap_in_the_time_of_a_free_fall():
    gap, pose = 0.002, (0.2, -0.5, 1.9)
    plant = plant_of(f"backlash:joint=3,gap={gap}")
    a = -gravity_torque(pose, plant.arm)[2] / masses(plant, 3, pose)[1]
    links = (*pose[:2], pose[2] - np.sign(a) * gap / 2, 0.0, 0.0, 0.0)
    run, motion = rest(started(plant, HELD, links, position=pose), 0.04, 1e-4)
    travel, speed = np.sign(a) * (motion[:, 2] - links[2]), np.sign(a) * motion[:, 5]
    across = run.time[np.argmax(travel > gap)]
    assert across == pytest.approx(np.sqrt(2 * gap / abs(a)), abs=2e-4) and across > 0.01
    inside = run.time < across
    assert speed[inside] == pytest.approx(abs(a) * run.time[inside], rel=2e-3)


def test_a_rotor_inside_the_gap_feels_nothing():
    plant = open_circuit(weightless(plant_of("backlash:joint=1,gap=0.01")))
    links = (POSE[0] + 0.004, *POSE[1:], 0.0, 0.0, 0.0)
    simulator = started(plant, links=links, velocity=(0.05, 0.0, 0.0))
    run, motion = rest(simulator, 0.16, 0.01)
    assert np.all(run.velocity[:, 0] == 0.05) and np.all(motion[:, 3:] == 0.0)
    run, motion = rest(simulator, 0.1, 0.01)
    # after the knock, the momentum of both is what the rotor brought
    rotor, _link = masses(plant, 1)
    assert np.ptp(run.velocity[:, 0]) > 0.01
    M = inertia(motion[-1, :3], plant.arm) + np.diag((1 - SHARE) * plant.arm.motor_inertia * (1, 0, 0))
    momentum = rotor * run.velocity[-1, 0] + M[0] @ motion[-1, 3:]
    assert momentum == pytest.approx(rotor * 0.05, rel=1e-9)


@given(st.floats(-0.01, 0.01), st.floats(-5.0, 5.0), st.floats(1e-5, 0.01), st.floats(1e3, 1e6), st.floats(0.0, 1000.0))
def test_teeth_push_and_never_pull(twist, rate, gap, stiffness, damping):
    law = getattr(transmitted, "py_func", transmitted)
    train = [1.0, stiffness, damping, gap / 2, 1.0, 0.0, 0.0, 0.0]
    torque = law(train, 0, twist, rate)
    if abs(twist) <= gap / 2:
        assert torque == 0.0
    else:
        assert torque * twist >= 0.0
        pressed = stiffness * (abs(twist) - gap / 2) + damping * rate * np.sign(twist)
        assert abs(torque) == pytest.approx(max(pressed, 0.0), rel=1e-12, abs=1e-12)


def test_play_and_elasticity_of_one_joint_act_in_series():
    K, B = in_series([(2e4, 5.0), (2e5, 100.0)])
    assert pytest.approx(1 / 2e4 + 1 / 2e5) == 1 / K
    s = 1j * 1e-3  # far below resonance both springs share one torque
    assert (K + s * B).imag == pytest.approx((1 / (1 / (2e4 + s * 5.0) + 1 / (2e5 + s * 100.0))).imag, rel=1e-9)
    both = plant_of("backlash:joint=2,gap=0.001,stiffness=2e5,damping=100", elastic(2, 2e4, 5.0))
    one = plant_of(f"backlash:joint=2,gap=0.001,stiffness={K!r},damping={B!r}")
    ends = [rest(started(plant), 0.2, 0.01)[0].position for plant in (both, one)]
    assert bits(ends[0]) == bits(ends[1])


# -------------------------------------------------------------------------- friction and the others


def test_a_soft_rotor_that_sticks_is_a_held_one():
    time, volts = smooth_voltages((4.0, 3.0, 2.0), 0.5, 0.01)
    ends = []
    for effects, constraints in (
        (["coulomb_friction:joint=2,torque=500"], (Constraint(),) * 3),
        ([], free_only(1)[:1] + HELD[:1] + free_only(3)[2:]),
    ):
        simulator = started(plant_of(elastic(2, 3e3), *effects), constraints, links=(*POSE, 0.0, 0.0, 0.0))
        run = simulator.run(time, volts)
        assert np.ptp(simulator.link_motion[:, 1]) > 1e-3
        ends.append(np.hstack([run.position, run.velocity, simulator.link_motion]))
    assert bits(ends[0]) == bits(ends[1])


def test_friction_acts_on_the_rotor_and_holds_it_to_the_newton():
    # the rotor stays while the spring carries less than the level, and goes where it carries more
    level, stiffness, joint = 8.0, 5e3, 1
    for twist, moves in ((0.99, False), (1.01, True)):
        plant = weightless(plant_of(elastic(joint, stiffness), f"coulomb_friction:joint={joint},torque={level}"))
        links = (POSE[0] - twist * level / stiffness, *POSE[1:], 0.0, 0.0, 0.0)
        run, _ = rest(started(plant, free_only(joint), links), 0.02, 1e-3)
        assert (run.velocity[:, 0] != 0.0).any() == moves


def test_a_blow_hits_the_link_and_a_stop_holds_it():
    plant = plant_of(elastic(1, 2e4), "impulse:joint=1,torque=100,time=0.01,width=0.01")
    simulator = started(open_circuit(weightless(plant)), free_only(1))
    run, motion = rest(simulator, 0.03, 1e-3)
    rotor, link = masses(plant, 1)
    assert motion[6, 3] > 2 * run.velocity[6, 0] >= 0.0
    assert rotor * run.velocity[-1, 0] + link * motion[-1, 3] == pytest.approx(0.5, rel=1e-6)
    stopped = plant_of(elastic(1, 500.0), "soft_stop:joint=1,lower=-1,upper=0.3,stiffness=1e6")
    simulator = started(stopped, free_only(1))
    time = np.arange(0.0, 1.0, 0.02)
    run = simulator.run(time, np.outer(np.full(50, 3.0), (1, 0, 0)))
    assert simulator.link_motion[:, 0].max() < 0.301 < run.position[-1, 0]


# ------------------------------------------------------------------------------ transmission error


def test_the_gear_and_its_derivatives_agree():
    law = getattr(gear_output, "py_func", gear_output)
    train = [0.0, 0.0, 0.0, 0.0, 1.0, 0.004, 17.0, 0.3]
    for q in np.linspace(-2.0, 2.0, 9):
        u, slope, bend = law(train, 0, q)
        before, after = law(train, 0, q - 1e-6), law(train, 0, q + 1e-6)
        assert u == pytest.approx(q + 0.004 * np.sin(17.0 * q + 0.3), abs=1e-15)
        assert slope == pytest.approx((after[0] - before[0]) / 2e-6, rel=1e-8)
        assert bend == pytest.approx((after[1] - before[1]) / 2e-6, rel=1e-6, abs=1e-7)


def test_a_link_behind_an_error_is_where_the_gear_puts_it():
    plant = plant_of("transmission_error:joint=3,amplitude=0.002,order=30,phase=0.5", *VISCOUS)
    simulator = started(plant)
    time, volts = smooth_voltages((4.0, 3.0, 9.0), 0.6, 0.02)
    run, e = simulator.run(time, volts), 0.002
    angle = 30.0 * run.position[:, 2] + 0.5
    assert np.ptp(angle) > 3.0
    expected = run.position[:, 2] + e * np.sin(angle)
    assert simulator.link_motion[:, 2] == pytest.approx(expected, abs=1e-15)
    assert simulator.link_motion[:, 5] == pytest.approx(run.velocity[:, 2] * (1 + 30.0 * e * np.cos(angle)), abs=1e-15)
    assert bits(simulator.link_motion[:, :2]) == bits(run.position[:, :2])


@pytest.mark.parametrize("effect", ["backlash:joint=2,gap=0", "transmission_error:joint=3,amplitude=0,order=9"])
def test_without_play_or_error_the_plant_is_the_plain_one(effect):
    time, volts = smooth_voltages((6.0, 9.0, 5.0), 0.5)
    assert plant_of(effect).constants.active == 0
    assert bits(started(plant_of(effect)).run(time, volts).position) == bits(
        started(plant_of()).run(time, volts).position
    )


def test_a_pendulum_behind_a_held_motor_swings_on_its_spring_and_its_weight():
    stiffness, mass, length, inertia_of_motor = 50.0, 0.49, 0.1, 0.0019
    body = load_mechanism("pendulum").body
    effect = parse_effect(f"joint_elasticity:joint=1,stiffness={stiffness},damping=0")
    simulator = Simulator(LinkagePlant.of(body, [effect]), constraints=[Constraint("hold")])
    simulator.links = (0.0, 0.0, 1e-4, 0.0, 0.0, 0.0)
    time = np.arange(0.0, 0.2, 5e-4)
    run = simulator.run(time, np.zeros((len(time), 1)))
    moment = mass * length**2 + (1 - SHARE) * inertia_of_motor
    expected = 1e-4 * np.cos(np.sqrt((stiffness + mass * 9.81 * length) / moment) * time)
    assert np.all(run.position == 0.0)
    assert simulator.link_motion[:, 2] == pytest.approx(expected, abs=2e-6)
