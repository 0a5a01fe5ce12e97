# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stick: what dry friction holds stays where it is, and lets go at the right load and time."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from arm_reference import arm_of, bits, driving_torque, energy, mass_matrix, open_circuit, plant_of
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from puma_sim_core.arm.rigid_body import gravity_torque
from puma_sim_core.effects import parse_effect
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator

pytestmark = pytest.mark.long
# rows of an hour; the interpreted kernel would take as long
HOUR = 3600.0 if BACKEND == "numba" else 2.0
DRIVE = np.array([m.torque_constant * m.gear_ratio / m.resistance for m in arm_of("bejczy").motors])
HOLD = Constraint("hold")
numbers = st.floats(-1, 1)
triples = st.tuples(numbers, numbers, numbers).map(np.array)
levels = st.tuples(*[st.floats(0, 25)] * 6)
signs = st.tuples(*[st.sampled_from((0, 0, 1, -1))] * 3)


def coulomb(*torques):
    return [f"coulomb_friction:joint={j},torque={c}" for j, c in enumerate(torques, start=1)]


def asymmetric(pairs):
    return [
        f"asymmetric_coulomb_friction:joint={j},positive={p!r},negative={n!r}"
        for j, (p, n) in enumerate(pairs, start=1)
    ]


def alone(joint):
    """Constraints that hold all joints but one (0-based)."""
    return [Constraint() if j == joint else HOLD for j in range(3)]


def static_volts(position):
    """Volts that hold the arm against gravity."""
    return gravity_torque(np.array(position, dtype=float), arm_of("bejczy")) / DRIVE


# ------------------------------------------------------------------------------------ at rest


def test_below_its_friction_an_arm_stays_at_rest_for_an_hour_bit_for_bit():
    position = (0.1, 0.3 - 0.1, 0.7)
    plant = plant_of(*coulomb(5.0, 8.0, 3.0))
    volts = static_volts(position) + 0.99 * np.array([5.0, -8.0, 3.0]) / DRIVE
    simulator = Simulator(plant)
    simulator.reset(position, current=volts / 1.6)
    simulator.step(volts, HOUR)
    assert bits(simulator.state[:3]) == bits(position)
    assert bits(simulator.state[3:6]) == bits([0.0] * 3)


def test_at_rest_without_volts_gravity_is_held_for_an_hour():
    simulator = Simulator(
        plant_of(*coulomb(1.0, 70.0, 12.0), *[f"stribeck_friction:joint={j},torque=1" for j in (1, 2, 3)])
    )
    simulator.reset((0.1, 0.2, 0.7))
    simulator.step((0.0, 0.0, 0.0), HOUR)
    assert bits(simulator.state) == bits([0.1, 0.2, 0.7] + [0.0] * 6)


@pytest.mark.parametrize("sticking", [s for s in product((False, True), repeat=3) if any(s)])
def test_any_of_the_joints_may_stick_while_the_others_move(sticking):
    plant = plant_of(*coulomb(*(400.0 if s else 1.0 for s in sticking)))
    simulator = Simulator(plant)
    simulator.reset((0.1, -1.0, 0.7))
    recording = simulator.run(np.arange(0.0, 0.3, 0.02), np.tile((4.0, 6.0, -4.0), (15, 1)))
    for j, sticks in enumerate(sticking):
        if sticks:
            assert len(set(bits(recording.position[:, j]))) == 1
            assert not recording.velocity[:, j].any()
        else:
            assert abs(recording.velocity[-1, j]) > 0.01


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_breakaway_is_at_the_level_of_its_direction(joint, direction):
    position = (0.2, -0.5, 0.4)
    pairs = [(9.0, 6.0), (20.0, 14.0), (7.0, 4.0)]
    plant = plant_of(*asymmetric(pairs), "stribeck_friction:joint=1,torque=2")
    level = pairs[joint][0 if direction > 0 else 1] + (2.0 if joint == 0 else 0.0)
    for share, moves in ((1.0 - 1e-9, False), (1.0 + 1e-9, True)):
        volts = static_volts(position)
        volts[joint] += direction * share * level / DRIVE[joint]
        simulator = Simulator(plant, constraints=alone(joint))
        simulator.reset(position, current=volts / 1.6)
        simulator.step(volts, 2.0)
        travel = direction * (simulator.state[joint] - position[joint])
        assert travel > 0.0 if moves else travel == 0.0


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("step", [0.0005, 0.001, 0.002])
def test_breakaway_time_is_located_far_below_a_step(joint, step):
    # The current of a joint at rest is known in closed form, and with it the time at which its
    # torque passes the level. An error of that time would show as acceleration times it.
    position, level, volts = np.array([0.2, -0.5, 0.4]), 15.0, np.zeros(3)
    gravity = gravity_torque(position, arm_of("bejczy"))[joint]
    kT = 1.6 * DRIVE[joint]
    volts[joint] = 1.7 * (gravity + level) / DRIVE[joint]
    start = 0.0048 / 1.6 * np.log(1.7 / 0.7)
    plant = plant_of(*coulomb(*[level] * 3))
    simulator = Simulator(plant, constraints=alone(joint), max_step=step)
    simulator.reset(position)
    simulator.step(volts, 0.008)
    inertia = mass_matrix(plant, position)[joint, joint]
    ke = 0.26 * arm_of("bejczy").motors[joint].gear_ratio

    def slide(t, y):
        q = position.copy()
        q[joint] = y[0]
        torque = kT * y[2] - gravity_torque(q, plant.arm)[joint] - level
        return [y[1], torque / inertia, (volts[joint] - 1.6 * y[2] - ke * y[1]) / 0.0048]

    run = solve_ivp(
        slide, (start, 0.008), [position[joint], 0.0, (gravity + level) / kT], method="DOP853", rtol=1e-12, atol=1e-14
    )
    acceleration = slide(0.0, run.y[:, -1])[1]
    error = abs(simulator.state[3 + joint] - run.y[1, -1]) / acceleration
    # what remains is the truncation of the step before it, 16-fold smaller for each halving
    assert error < 5e-6 * (step / 0.002) ** 4


# -------------------------------------------------------------------------- several at once


def decision(M, b, pairs, moving):
    """Accelerations of joints at rest, by trying stick and both directions for each.

    moving : signs of the velocities, 0 at rest.
    """
    found = []
    for states in product((0, 1, -1), repeat=3):
        if any(m and m != s for m, s in zip(moving, states)):
            continue
        level = [0.0 if s == 0 else s * pair[0 if s > 0 else 1] for s, pair in zip(states, pairs)]
        free = [j for j in range(3) if states[j]]
        a = np.zeros(3)
        if free:
            a[free] = np.linalg.solve(M[np.ix_(free, free)], (b - level)[free])
        load = b - M @ a
        if all(
            m or (s * a[j] > 0.0 if s else -pair[1] <= load[j] <= pair[0])
            for j, (m, s, pair) in enumerate(zip(moving, states, pairs))
        ):
            found.append((states, a))
    return found


@settings(max_examples=300)
@given(q=triples, load=triples, values=levels, moving=signs)
def test_stick_and_slip_of_three_joints_is_the_only_consistent_choice(q, load, values, moving):
    pairs = list(zip(values[::2], values[1::2]))
    plant = plant_of(*asymmetric(pairs))
    q, velocity = 3.0 * q, 0.4 * np.array(moving)
    current = (gravity_torque(q, plant.arm) + 60.0 * load) / (1.6 * DRIVE)
    choices = decision(mass_matrix(plant, q), driving_torque(plant, q, velocity, current), pairs, moving)
    simulator = Simulator(plant)
    simulator.reset(q, velocity, current)
    got = simulator.run([0.0, 1e-4], np.zeros((2, 3)), acceleration=True).acceleration[0]
    assert any(np.allclose(got, a, rtol=1e-9, atol=1e-9) for _, a in choices) or not choices
    assert len(choices) <= 1 or np.allclose(choices[0][1], choices[1][1], atol=1e-9)


def test_a_joint_held_again_by_its_neighbours_does_not_start():
    # Each of the three is pushed beyond its level while the other two stick; once joints 1 and 3
    # give way, joint 2 is pushed less. Letting go one by one would start it the wrong way.
    simulator = Simulator(plant_of(*coulomb(1.0, 23.0, 1.0)))
    simulator.reset((0.0, -1.8, 0.5), current=(2.0, -1.3, -1.5))
    recording = simulator.run([0.0, 1e-4], np.zeros((2, 3)), acceleration=True)
    assert recording.acceleration[0, 1] == 0.0 and recording.velocity[1, 1] == 0.0
    assert recording.acceleration[0, 0] != 0.0 and recording.acceleration[0, 2] != 0.0


def test_a_joint_that_sticks_bears_what_bristles_of_another_one_hold():
    """Dry friction is the limit of friction through ever stiffer bristles, also beside a joint with bristles that stay
    soft: the distance falls with the root of the stiffness."""
    mechanism = load_mechanism("so101_pitch")
    time = np.arange(2000 if BACKEND == "numba" else 500) * 2e-3
    volts = np.stack([0.3 + 0.4 * np.sin(3.0 * time), 0.4 + 0.03 * np.sin(1.3 * time)], axis=1)

    def run(friction, step):
        effects = ("presliding_friction:joint=1,stiffness=100,torque=0.1", f"{friction}joint=2,torque=0.1")
        simulator = Simulator(mechanism.plant(mechanism.start, tuple(map(parse_effect, effects))), max_step=step)
        simulator.reset([0.3, 0.4])
        return simulator.run(time, volts)

    dry = run("coulomb_friction:", 1e-3)
    assert 0.2 < np.mean(dry.velocity[:, 1] == 0.0) < 0.8
    stiff, stiffer = (
        abs(run(f"presliding_friction:stiffness={stiffness},", step).position - dry.position).max()
        for stiffness, step in ((1e3, 2e-4), (1e4, 6e-5))
    )
    assert stiff / stiffer > 2.8


@pytest.mark.parametrize("drive", [[], ["joint_elasticity:joint=1,stiffness=20000,damping=5"]], ids=["rigid", "soft"])
def test_finer_steps_move_no_joint_that_sticks_beside_one_with_bristles(drive):
    plant = plant_of(
        *drive, "presliding_friction:joint=3,stiffness=2000,torque=6", "coulomb_friction:joint=2,torque=25"
    )
    time = np.arange(0.0, 2.0 if BACKEND == "numba" else 0.3, 0.01)
    volts = np.stack([0.0 * time, 1.5 * np.sin(9.0 * time) + 0.3, 4.0 * np.sin(5.0 * time)], axis=1)

    def run(step):
        simulator = Simulator(plant, max_step=step)
        simulator.reset((0.1, -1.2, 1.0))
        return simulator.run(time, volts)

    coarse, fine = run(2.5e-4), run(1.25e-4)
    assert 0.2 < np.mean(fine.velocity[:, 1] == 0.0) < 0.8
    np.testing.assert_allclose(coarse.position, fine.position, rtol=0.0, atol=1e-7)


def test_a_joint_pulls_another_one_loose():
    plant = plant_of(*coulomb(10.0, 5.0, 2.0))
    position = (0.0, -np.pi / 2, np.pi / 2)
    volts = (0.0, 3.0, 0.0)

    def run(constraints):
        simulator = Simulator(plant, constraints=constraints)
        simulator.reset(position)
        return simulator.run(np.arange(0.0, 0.02, 0.0002), np.tile(volts, (100, 1)))

    both, held = run([HOLD, Constraint(), Constraint()]), run([HOLD, HOLD, Constraint()])
    assert not held.velocity[:, 2].any()
    starts = [int(np.argmax(both.velocity[:, j] != 0.0)) for j in (1, 2)]
    # joint 2 starts first; joint 3 holds for a while, then is thrown back by the coupling
    assert 0 < starts[0] < starts[1]
    assert both.velocity[-1, 1] > 0.0 > both.velocity[starts[1], 2]


# -------------------------------------------------------------------------------- invariants


@settings(max_examples=40)
@given(q=triples, qd=triples, values=levels, bump=st.floats(0, 10))
@example(q=np.zeros(3), qd=np.array([1.0, 0.0, -5e-324]), values=(0.0, 0.0, 0.0, 0.0, 0.0, 2.0), bump=0.0)
def test_friction_never_makes_energy(q, qd, values, bump):
    bumps = [f"stribeck_friction:joint={j},torque={bump}" for j in (1, 2, 3)]
    plant = open_circuit(plant_of(*asymmetric(list(zip(values[::2], values[1::2]))), *bumps))
    simulator = Simulator(plant)
    simulator.reset(2.5 * q, 3.0 * qd)
    time = np.arange(0.0, 0.6, 0.01)
    run = simulator.run(time, np.zeros((len(time), 3)))
    total = [energy(plant, q, qd) for q, qd in zip(run.position, run.velocity)]
    # 5e-6 J of some tens was seen, in a row with a stop from 3 rad/s: the error of the steps there
    assert np.max(np.diff(total)) < 5e-5


@settings(max_examples=40)
@given(joint=st.integers(0, 2), speed=st.floats(0.01, 1), volts=numbers, level=st.floats(20, 60), bump=st.floats(0, 10))
def test_a_joint_stops_for_good_where_friction_exceeds_the_drive(joint, speed, volts, level, bump):
    # No gravity, and no back-EMF, whose current outlasts the motion. A reversal that skipped the
    # decision to stick would move on.
    plant = plant_of(
        f"coulomb_friction:joint={joint + 1},torque={level}", f"stribeck_friction:joint={joint + 1},torque={bump}"
    )
    plant = open_circuit(Plant(replace(plant.arm, gravity=0.0), plant.effects))
    drive = np.zeros(3)
    drive[joint] = 0.8 * volts * level / DRIVE[joint]
    start = np.zeros(3)
    start[joint] = speed
    simulator = Simulator(plant, constraints=alone(joint))
    simulator.reset((0.1, 0.2, 0.3), start, drive / 1.6)
    time = np.arange(0.0, 3.0, 0.001)
    velocity = simulator.run(time, np.tile(drive, (len(time), 1))).velocity[:, joint]
    assert (velocity >= 0.0).all()
    stopped = int(np.argmax(velocity == 0.0))
    assert stopped > 0 and not velocity[stopped:].any()


@pytest.mark.parametrize("constraint", [HOLD, Constraint("velocity", 0.4), Constraint("acceleration", -0.8)])
def test_dry_friction_of_a_constrained_joint_changes_nothing(constraint):
    time, volts = np.arange(0.0, 1.0, 0.02), np.tile((5.0, -3.0, 8.0), (50, 1))
    found = []
    for effects in ([], coulomb(0.0, 30.0) + ["stribeck_friction:joint=2,torque=5"]):
        simulator = Simulator(plant_of(*effects), constraints=[Constraint(), constraint, Constraint()])
        simulator.reset((0.1, -0.3, 0.5), None if constraint.kind != "acceleration" else (0.0, 0.2, 0.0))
        found.append(simulator.run(time, volts))
    assert bits(found[0].position) == bits(found[1].position)
    assert bits(found[0].velocity) == bits(found[1].velocity)
