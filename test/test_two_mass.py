# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Elastic drives against equations written down a second time, eigenvalues, energy and limits."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from arm_reference import bits, open_circuit, plant_of, smooth_voltages
from cli_support import GROUPS, call, record_session, write_volts
from scipy.linalg import expm
from two_mass_support import (
    HELD,
    POSE,
    SHARE,
    START,
    VISCOUS,
    Oracle,
    drift,
    elastic,
    free_only,
    masses,
    rest,
    started,
    weightless,
    whole_energy,
)

from puma_sim_core.arm.rigid_body import gravity_torque, inertia
from puma_sim_core.errors import ParameterError
from puma_sim_core.recording.recording import read_csv
from puma_sim_core.simulation.session import SessionConfig
from puma_sim_core.simulation.simulator import SERVO_PERIOD

pytestmark = pytest.mark.long
SYSTEMS = {
    "one elastic joint": ([elastic(2, 2e4, 5.0)], {1: (2e4, 5.0, 0.0)}, {}),
    "three elastic joints": (
        [elastic(1, 9e3, 3.0), elastic(2, 2e4, 5.0), elastic(3, 3e3, 1.0)],
        {0: (9e3, 3.0, 0.0), 1: (2e4, 5.0, 0.0), 2: (3e3, 1.0, 0.0)},
        {},
    ),
    "transmission error": (
        [
            "transmission_error:joint=2,amplitude=0.002,order=25,phase=0.4",
            "transmission_error:joint=1,amplitude=0.01,order=3",
        ],
        {},
        {1: (0.002, 25.0, 0.4), 0: (0.01, 3.0, 0.0)},
    ),
    "error behind an elastic joint": (
        [
            elastic(3, 1e4, 2.0),
            "transmission_error:joint=3,amplitude=0.003,order=12,phase=1",
            "transmission_error:joint=2,amplitude=0.005,order=4",
        ],
        {2: (1e4, 2.0, 0.0)},
        {2: (0.003, 12.0, 1.0), 1: (0.005, 4.0, 0.0)},
    ),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_whole_arm_moves_as_its_equations_say(name):
    effects, spring, wave = SYSTEMS[name]
    simulator = started(plant_of(*effects, *VISCOUS), position=START[0], velocity=START[1], current=START[2])
    time, volts = smooth_voltages((12.0, 9.0, 7.0), 0.3, 0.02)
    expected = Oracle(simulator.plant, spring, wave).run(simulator, time, volts, 1e-10)
    found = simulator.run(time, volts)
    assert np.abs(found.position - expected[:, :3]).max() < 2e-7
    assert np.abs(found.velocity - expected[:, 3:6]).max() < 2e-5
    soft = sorted(spring)
    assert np.abs(simulator.link_motion[:, soft] - expected[:, 9 : 9 + len(soft)]).max(initial=0.0) < 2e-7


# ------------------------------------------------------------------------------- linear vibrations


def crossings(time, values):
    """Moments at which the values pass zero upward, between rows by a line."""
    at = np.flatnonzero((values[:-1] < 0.0) & (values[1:] >= 0.0))
    return time[at] - values[at] * np.diff(time)[at] / np.diff(values)[at]


@pytest.mark.parametrize("joint, stiffness", [(1, 5e4), (2, 2e4), (3, 4e3)])
def test_a_held_motor_leaves_the_antiresonance_and_a_free_one_the_resonance(joint, stiffness):
    plant = open_circuit(weightless(plant_of(elastic(joint, stiffness))))
    rotor, link = masses(plant, joint)
    for constraints, expected in (
        (HELD, np.sqrt(stiffness / link)),
        (free_only(joint), np.sqrt(stiffness * (1 / rotor + 1 / link))),
    ):
        links = np.array([*POSE, 0.0, 0.0, 0.0])
        links[joint - 1] += 1e-5
        run, motion = rest(started(plant, constraints, links), 40.0 / expected * np.pi, 5e-4)
        twist = run.position[:, joint - 1] - motion[:, joint - 1]
        passed = crossings(run.time, twist)
        period = (passed[-1] - passed[0]) / (len(passed) - 1)
        assert len(passed) > 15 and 2 * np.pi / period == pytest.approx(expected, rel=2e-4)


def test_vibrations_of_the_arm_are_those_of_its_linear_eigenvalues():
    stiffness = (3e4, 2e4, 8e3)
    effects = (elastic(j + 1, k) for j, k in enumerate(stiffness))
    plant = open_circuit(weightless(plant_of(*effects)))
    own = np.array(plant.arm.motor_inertia)
    K, links = np.diag(stiffness), inertia(POSE, plant.arm) + np.diag((1 - SHARE) * own)
    M = np.block([[np.diag(SHARE * own), np.zeros((3, 3))], [np.zeros((3, 3)), links]])
    A = np.block([[np.zeros((6, 6)), np.eye(6)], [-np.linalg.solve(M, np.block([[K, -K], [-K, K]])), np.zeros((6, 6))]])
    twist = 1e-6 * np.array([3.0, -2.0, 5.0])
    simulator = started(plant, links=(*(np.array(POSE) + twist), 0.0, 0.0, 0.0))
    run, motion = rest(simulator, 0.2, 0.01)
    for r in (1, 7, 20):
        expected = expm(A * run.time[r]) @ np.concatenate([np.zeros(3), twist, np.zeros(6)])
        found = np.concatenate([run.position[r] - POSE, motion[r, :3] - POSE])
        assert np.abs(found - expected[:6]).max() < 5e-9


def test_the_drive_of_one_joint_is_its_linear_system():
    # joint 1 with the others held has neither weight nor other forces: currents, rotor and link
    joint, stiffness, damping = 1, 6e3, 8.0
    plant = plant_of(elastic(joint, stiffness, damping), VISCOUS[0])
    motor, (J, M) = plant.arm.motors[0], masses(plant_of(), joint)
    kT, ke, H = plant.torque_per_ampere[0], motor.back_emf * motor.gear_ratio, 5.8
    A = np.array(
        [
            [0, 1, 0, 0, 0],
            [-stiffness / J, -(damping + H) / J, stiffness / J, damping / J, kT / J],
            [0, 0, 0, 1, 0],
            [stiffness / M, damping / M, -stiffness / M, -damping / M, 0],
            [0, -ke / motor.inductance, 0, 0, -motor.resistance / motor.inductance],
        ]
    )
    time = np.arange(0.0, 0.5, 0.01)
    volts = 15.0 * np.sin(2 * np.pi * np.cumsum(2 + 30 * time) * 0.01)
    b = np.array([0, 0, 0, 0, 1 / motor.inductance])
    step = expm(np.block([[A, b[:, None]], [np.zeros((1, 6))]]) * 0.01)
    simulator = started(plant, free_only(joint), max_step=2e-4)
    run = simulator.run(time, np.outer(volts, (1, 0, 0)))
    y = np.zeros(5)
    for r in range(len(time)):
        found = (
            run.position[r, 0] - POSE[0],
            run.velocity[r, 0],
            simulator.link_motion[r, 0] - POSE[0],
            simulator.link_motion[r, 3],
        )
        assert np.abs(found - y[:4]).max() < 1e-6
        y = (step @ np.append(y, volts[r]))[:5]


# ------------------------------------------------------------------------ energy, order and limits


def test_a_free_fall_on_springs_keeps_its_energy_with_the_order_of_the_step():
    effects, springs = (
        [elastic(1, 9e3), elastic(2, 6e3), elastic(3, 3e3)],
        {1: (9e3, 0.0), 2: (6e3, 0.0), 3: (3e3, 0.0)},
    )
    coarse, fine = drift(effects, springs, 1e-3), drift(effects, springs, 5e-4)
    # kinetic and potential energy exchange some 30 J meanwhile
    assert coarse < 2e-4 and coarse / fine > 14.0


def test_halving_the_step_divides_the_error_by_sixteen():
    effects = [
        elastic(1, 3e3, 2.0),
        elastic(3, 1e3, 2.0),
        *VISCOUS,
        "transmission_error:joint=2,amplitude=0.01,order=6",
    ]
    time, volts = smooth_voltages((12.0, 9.0, 7.0), 0.512, 0.032)
    ends = []
    for step in (1e-3, 5e-4, 2.5e-4):
        simulator = started(plant_of(*effects), max_step=step)
        simulator.run(time, volts)
        ends.append(np.array([*simulator.state[:6], *simulator.links]))
    ratio = np.abs(ends[0] - ends[1]).max() / np.abs(ends[1] - ends[2]).max()
    assert 13.0 < ratio < 20.0


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_a_stiffer_drive_comes_nearer_to_the_rigid_one_in_proportion(joint):
    time, volts = smooth_voltages((8.0, 9.0, 5.0), 0.3, 0.01)
    rigid = started(plant_of(*VISCOUS)).run(time, volts).position
    away = []
    for stiffness in (1e6, 1e7):
        effect = elastic(joint, stiffness, 300.0)
        away.append(np.abs(started(plant_of(effect, *VISCOUS)).run(time, volts).position - rigid).max())
    assert away[0] < 3e-5 and 9.0 < away[0] / away[1] < 11.5


@pytest.mark.parametrize(
    "effects",
    [
        [f"joint_elasticity:joint={j},stiffness=5e4,damping=0" for j in (1, 2, 3)],
        [f"backlash:joint={j},gap=0.001,stiffness=3e5,damping=0" for j in (1, 2, 3)],
        ["backlash:joint=3,gap=0.001,stiffness=1e7,damping=1000"],
        ["joint_elasticity:joint=3,stiffness=1e7,damping=0"],
        ["joint_elasticity:joint=2,stiffness=2e4,damping=1000"],
    ],
)
@pytest.mark.parametrize("max_step", [SERVO_PERIOD, 0.008])
def test_stiff_trains_stay_within_their_energy(effects, max_step):
    plant = open_circuit(plant_of(*effects))
    run, motion = rest(started(plant, max_step=max_step), 0.4, 0.016)
    twist = np.abs(run.position - motion[:, :3])
    assert twist.max() < 0.01
    springs = {e.joint: (e.values["stiffness"], e.values.get("gap", 0.0)) for e in plant.effects}
    first, last = (whole_energy(plant, run, motion, r, springs) for r in (0, -1))
    assert last < first + 0.05


def test_a_run_starts_without_a_swing():
    # the links hang in their springs from the first row on: no vibration of its own begins
    plant = plant_of(elastic(2, 8e3), *VISCOUS, *(f"coulomb_friction:joint={j},torque=70" for j in (1, 2, 3)))
    run, motion = rest(started(plant), 0.3, 2e-3)
    assert np.all(run.velocity == 0.0)
    twist = run.position[:, 1] - motion[:, 1]
    assert np.ptp(twist) < 1e-9
    expected = gravity_torque((POSE[0], POSE[1] - twist[0], POSE[2]), plant.arm)[1] / 8e3
    assert twist[0] == pytest.approx(expected, rel=1e-6) and abs(twist[0]) > 4e-3


# ------------------------------------------------------------------------------------------ errors


@pytest.mark.parametrize(
    "effects, name, message",
    [
        (
            [
                "joint_elasticity:joint=2,stiffness=2e4,motor_share=1",
                "joint_elasticity:joint=3,stiffness=2e4,motor_share=1",
            ],
            "bejczy",
            r"on joint 2, 3: the inertia of the links, D \+ \(1 - motor_share\) Ia, is not positive "
            r"definite: its smallest eigenvalue is -0.* at q2 = .* deg.*; expected a smaller motor_share",
        ),
        (
            ["joint_elasticity:joint=2,stiffness=2e4", "backlash:joint=2,gap=0.001,motor_share=0.5"],
            "bejczy",
            "backlash of joint 2: motor_share 0.5 and 0.7; expected the same",
        ),
        (["joint_elasticity:joint=1,stiffness=1e-4"], "bejczy", "stiffness=0.0001; expected 0.001 to 1e"),
        (["backlash:joint=1"], "bejczy", "'gap' is missing"),
    ],
)
def test_a_drive_train_that_cannot_be_is_refused(effects, name, message):
    with pytest.raises(ParameterError, match=message):
        plant_of(*effects, name=name)


# ----------------------------------------------------------------------- the same bits everywhere


PROGRAM = """
import hashlib
import numpy as np
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.session import Session
from puma_sim_core.simulation.session import SessionConfig
from puma_sim_core.simulation.simulator import Simulator

def digest():
    effects = ["joint_elasticity:joint=2,stiffness=2e4", "backlash:joint=3,gap=0.001",
               "joint_elasticity:joint=1,stiffness=5e4", "coulomb_friction:joint=2,torque=9",
               "transmission_error:joint=3,amplitude=0.001,order=10",
               "stribeck_friction:joint=3,torque=3", "presliding_friction:joint=1,torque=5",
               "soft_stop:joint=2", "current_limit:joint=3,current=2", "base_tilt:x=0.03",
               "torque_ripple:joint=3,amplitude=2,order=1",
               "impulse:joint=2,torque=80,time=0.2,width=0.05",
               "sensor_lag:joint=1,time_constant=0.003"]
    plant = Plant.of("bejczy", map(parse_effect, effects))
    simulator = Simulator(plant)
    simulator.reset((0.1, -0.4, 0.7))
    time = np.arange(0.0, 0.4, 0.02)
    volts = np.column_stack([12 * np.sin(9 * time), 9 * np.cos(7 * time), -9 * np.sin(11 * time)])
    run = simulator.run(time, volts, acceleration=True)
    numbers = [run.position, run.velocity, run.current, run.acceleration, simulator.link_motion]
    session = Session(SessionConfig(plant, "position", initial_position=(0.0, -1.0, 0.8)))
    for target in ((0.1, -0.9, 0.7), (0.0, -1.0, 0.8), (-0.1, -1.1, 0.9)):
        session.command(target)
        numbers.append(session.step()[2:])
    return hashlib.sha256(b"".join(np.ascontiguousarray(n).tobytes() for n in numbers)).hexdigest()
"""


def test_both_kernels_and_reruns_give_the_same_bits():
    here = {}
    exec(PROGRAM, here)
    first = here["digest"]()
    assert here["digest"]() == first
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM + "\nprint(digest())"],
        text=True,
        capture_output=True,
        env={**os.environ, "PUMA_SIM_KERNEL": "python"},
    )
    assert done.stdout.strip() == first, done.stderr


def test_the_command_simulates_an_elastic_joint(tmp_path):
    time = np.arange(0.0, 0.5, 0.01)
    volts = write_volts(tmp_path / "volts.csv", time, np.outer(np.ones(50), (3.0, -9.0, 2.0)))
    option = "joint_elasticity:joint=2,stiffness=2e4"
    assert call("simulate", volts, "--effect", option, "--out", tmp_path / "out.csv") == 0
    found = read_csv(tmp_path / "out.csv", GROUPS).position
    simulator = started(plant_of(option), position=(0.0, 0.0, 0.0))
    expected = simulator.run(time, np.outer(np.ones(50), (3.0, -9.0, 2.0))).position
    assert bits(found) == bits(expected)


@pytest.mark.parametrize(
    "interface, commands",
    [
        ("voltage", {0: [(None, (12.0, -20.0, 7.0))], 9: [(None, (8.0, 3.0, -5.0))]}),
        ("position", {0: [(None, (0.2, -0.3, 0.1))], 7: [(None, (0.0, -0.2, 0.3))]}),
    ],
)
def test_a_bag_of_an_elastic_arm_replays_identical(interface, commands, tmp_path, capsys):
    effects = [
        "joint_elasticity:joint=2,stiffness=2e4",
        "backlash:joint=1,gap=0.001",
        "coulomb_friction:joint=2,torque=5",
    ]
    bag = record_session(tmp_path / "run", SessionConfig(plant_of(*effects), interface), commands, 20)
    assert call("replay", bag) == 0
    assert "replay identical" in capsys.readouterr().out
