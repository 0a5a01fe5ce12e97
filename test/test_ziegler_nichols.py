# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Ultimate gain and period: two methods against each other, against theory and published gains."""

from __future__ import annotations

from dataclasses import replace
from math import inf, pi, radians

import numpy as np
import pytest
from arm_reference import plant_of
from cli_support import call
from scipy.integrate import solve_ivp

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.rigid_body import gravity_torque, lumped_constants
from puma_sim_core.control.linear import (
    is_linear,
    least_damped,
    linearised,
    pid_loop,
    proportional_loop,
    radius,
    sampled,
)
from puma_sim_core.errors import LimitError, ParameterError, TuningError
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.tuning.ziegler_nichols import (
    Loop,
    Ultimate,
    settings,
    ultimate_by_eigenvalues,
    ultimate_by_simulation,
    ultimate_map,
)

PERIOD = 0.028 / 30.0
UPRIGHT, HORIZONTAL = (0.0, -pi / 2, pi / 2), (0.0, 0.0, pi / 2)
FOLDED = (0.0, -pi / 2 + 0.1143, -0.9075)
#: joint, pose, and Kmax, Tp at 28/30 ms, and at 28 ms with one sample of delay (found for the
#: exactly sampled joint before this package had the function)
KNOWN = [
    (1, UPRIGHT, 4703, 0.0454, 489, 0.227),
    (1, HORIZONTAL, 4696, 0.0706, 428, 0.297),
    (2, UPRIGHT, 8110, 0.0419, 863, 0.219),
    (2, FOLDED, 8119, 0.0360, 905, 0.205),
    (3, UPRIGHT, 4039, 0.0356, 452, 0.204),
]


@pytest.mark.parametrize("joint, pose, gain, period, slow_gain, slow_period", KNOWN)
def test_known_gains_of_the_five_poses(joint, pose, gain, period, slow_gain, slow_period):
    found = ultimate_by_eigenvalues(Loop(Plant.of(), joint, pose))
    assert (found.gain, found.period) == (pytest.approx(gain, abs=0.51), pytest.approx(period, abs=5.1e-5))
    slow = ultimate_by_eigenvalues(Loop(Plant.of(), joint, pose, 0.028, 1))
    assert (slow.gain, slow.period) == (pytest.approx(slow_gain, abs=0.51), pytest.approx(slow_period, abs=5.1e-4))


def random_loops(count):
    """Loops of any joint, pose, rate, delay, parameter set, viscous friction and torque form."""
    random = np.random.default_rng(11)
    loops = []
    for n in range(count):
        arm = load_parameters(["bejczy", "armstrong", "corke_armstrong_1994"][n % 3])
        effects = (
            [f"viscous_friction:joint={j},coefficient={random.uniform(0, 10)}" for j in (1, 2, 3)] if n % 2 else []
        )
        plant = replace(plant_of(*effects), arm=arm, torque_form="printed" if n % 7 == 6 else "physical")
        loops.append(
            Loop(
                plant,
                n % 3 + 1,
                [random.uniform(*pair) for pair in arm.joint_ranges],
                float(np.exp(random.uniform(np.log(4e-4), np.log(0.04)))),
                int(random.integers(0, 8)),
            )
        )
    return loops


#: the plain Python kernel takes minutes for all of it
compiled = pytest.mark.skipif(BACKEND != "numba", reason="long runs: compiled kernel only")


@compiled
@pytest.mark.parametrize(
    "loop",
    random_loops(18),
    ids=lambda loop: f"{loop.plant.arm.name}-{loop.joint}-{loop.period * 1e3:.2f}ms-{loop.delay}",
)
def test_simulation_and_eigenvalues_agree(loop):
    exact, simulated = ultimate_by_eigenvalues(loop), ultimate_by_simulation(loop)
    assert simulated.gain == pytest.approx(exact.gain, rel=0.03)
    assert simulated.period == pytest.approx(exact.period, rel=0.03)


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_fast_sampling_approaches_the_bound_of_routh(joint):
    # m L s^3 + m R s^2 + kT ke N s + kT K, without gravity: K < (R/L) ke N, s = j sqrt(kT ke N/mL)
    plant = replace(plant_of(), arm=replace(load_parameters("bejczy"), gravity=0.0))
    motor = plant.arm.motors[joint - 1]
    drive = motor.back_emf * motor.gear_ratio
    a, _ = linearised(plant, UPRIGHT, (joint,))
    speed = (a[1, 2] * drive / motor.inductance) ** 0.5
    errors = []
    for period in (2e-4, 1e-4):
        found = ultimate_by_eigenvalues(Loop(plant, joint, UPRIGHT, period))
        errors.append(1.0 - found.gain / (motor.resistance / motor.inductance * drive))
        assert found.period == pytest.approx(2.0 * pi / speed, rel=10 * period / 1e-3)
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05) and 0.0 < errors[1] < 0.02


def test_linearised_arm_is_the_derivative_of_the_simulator():
    plant = plant_of("viscous_friction:joint=2,coefficient=4")
    pose, step = np.array([0.3, -0.7, 1.1]), 1e-3
    f, g = sampled(*linearised(plant, pose), step)
    current = gravity_torque(pose, plant.arm) / plant.torque_per_ampere
    rest = np.concatenate([pose, np.zeros(3), current])
    volts = current * [m.resistance for m in plant.arm.motors]
    simulator = Simulator(plant, max_step=step / 8)

    def after(change, more):
        state = rest + change
        simulator.reset(state[:3], state[3:6], state[6:])
        return np.array(simulator.step(volts + more, step))

    for column in range(12):
        change, more = np.zeros(9), np.zeros(3)
        (change if column < 9 else more)[column % 9] = 1e-4
        numeric = (after(change, more) - after(-change, -more)) / 2e-4
        expected = f[:, column] if column < 9 else g[:, column - 9]
        np.testing.assert_allclose(numeric, expected, rtol=1e-5, atol=1e-7)


def test_sampling_is_the_solution_of_the_differential_equation():
    a, b = linearised(Plant.of(), UPRIGHT, (2,))
    f, g = sampled(a, b, 0.01)
    start, volts = np.array([0.01, -0.2, 0.5]), 3.0
    run = solve_ivp(lambda t, x: a @ x + b[:, 0] * volts, (0.0, 0.01), start, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(f @ start + g[:, 0] * volts, run.y[:, -1], rtol=1e-8)


@pytest.mark.parametrize("delay", [0, 3])
def test_pid_loop_predicts_the_simulated_servo(delay):
    plant, gains = Plant.of(), (PidGains(900.0, 0.2, 0.03), PidGains(1600.0), PidGains(800.0, inf, 0.02))
    # where gravity is balanced, links 2 and 3 both on end
    k = lumped_constants(plant.arm)
    q2 = np.arctan2(-k.g3, k.g4) - pi
    pose = np.array([0.2, q2, np.arctan2(-k.g1, k.g2) - q2 - pi])
    np.testing.assert_allclose(gravity_torque(pose, plant.arm), 0.0, atol=1e-12)
    f, g = sampled(*linearised(plant, pose), PERIOD)
    loop = pid_loop(f, g, gains, PERIOD, delay)
    simulator = Simulator(plant)
    small = np.array([1e-6, -2e-6, 1.5e-6])
    simulator.reset(pose + small)
    record = simulator.run_servo(np.tile(pose, (4, 1)), ServoConfig(gains, delay_samples=delay), voltage_limit=inf)
    x = np.zeros(len(loop))
    x[:3] = small
    x[10:12] = small[[0, 2]]  # the last positions, behind the one sum
    for row in range(120):
        np.testing.assert_allclose(x[:3], record.position[row] - pose, rtol=0, atol=1e-10)
        x = loop @ x


def test_a_map_is_the_same_as_pose_after_pose():
    plant = Plant.of()
    poses = np.array([[UPRIGHT, HORIZONTAL], [FOLDED, (0.0, 0.2, 0.0)]])
    gain, period, least = ultimate_map(plant, 2, poses, delay=2)
    for at in np.ndindex(2, 2):
        one = ultimate_by_eigenvalues(Loop(plant, 2, poses[at], delay=2))
        assert (gain[at], period[at]) == (pytest.approx(one.gain, rel=1e-8), pytest.approx(one.period, rel=1e-8))
        assert least[at] == pytest.approx(one.least_gain, rel=1e-8)


def test_below_the_least_gain_the_arm_falls_over():
    # R |dG2/dq2| / kT: the current of the voltage K q holds less than gravity takes
    loop = Loop(Plant.of(), 2, UPRIGHT)
    found = ultimate_by_eigenvalues(loop)
    f, g = sampled(*linearised(loop.plant, UPRIGHT, (2,)), loop.period)
    stiffness = -62.52
    expected = -loop.plant.arm.motors[1].resistance * stiffness / loop.plant.torque_per_ampere[1]
    assert found.least_gain == pytest.approx(expected, rel=1e-3)
    for share, stable in ((0.99, False), (1.01, True)):
        assert (radius(proportional_loop(f, g, share * found.least_gain)) < 1.0) == stable


def test_settings_of_table_7_2():
    ultimate = Ultimate(150.0, 0.45)
    assert settings(ultimate, "P") == PidGains(75.0)
    assert settings(ultimate, "PI") == PidGains(67.5, 0.45 / 1.2)
    assert settings(ultimate) == PidGains(90.0, 0.225, 0.45 / 8)
    with pytest.raises(ParameterError, match="'PD'.*; expected P or PI or PID"):
        settings(ultimate, "PD")


def test_damping_of_a_known_oscillator():
    ratio, speed, step = 0.2, 9.0, 0.01
    a = np.array([[0.0, 1.0], [-(speed**2), -2.0 * ratio * speed]])
    f, _ = sampled(a, np.zeros((2, 1)), step)
    found, period = least_damped(f, step)
    assert found == pytest.approx(ratio, rel=1e-9)
    assert period == pytest.approx(2.0 * pi / (speed * (1.0 - ratio**2) ** 0.5), rel=1e-9)
    assert np.isnan(least_damped(np.diag([0.5, 0.9]), step)).all()


@pytest.mark.parametrize("method", [ultimate_by_eigenvalues, pytest.param(ultimate_by_simulation, marks=compiled)])
def test_requests_without_an_answer_are_refused(method):
    with pytest.raises(TuningError, match="no ultimate gain below 3000 V/rad"):
        method(Loop(Plant.of(), 3, UPRIGHT), limit=3000.0)
    printed = replace(plant_of(), torque_form="printed")
    with pytest.raises(TuningError, match="no proportional gain .* keeps the joint stable"):
        method(Loop(printed, 2, UPRIGHT, 0.1, 3))
    with pytest.raises(ParameterError, match="limit -1"):
        method(Loop(Plant.of(), 3, UPRIGHT), limit=-1.0)


@pytest.mark.parametrize(
    "arguments, error, message",
    [
        ({"pose": (0.0, 1.0, 0.0)}, LimitError, r"pose: joint 2 at 57\.\d+ deg; expected -223 to 43"),
        ({"pose": (0.0, 0.0, np.nan)}, ParameterError, "pose"),
        ({"joint": 4}, ParameterError, "joint 4; expected 1 or 2 or 3"),
        ({"period": 0.0}, ParameterError, "period 0.0 s"),
        ({"delay": -1}, ParameterError, "delay -1"),
        ({"delay": 1.0}, ParameterError, "delay 1.0; expected a whole number"),
    ],
)
def test_loops_that_cannot_be_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        Loop(**{"plant": Plant.of(), "joint": 1, "pose": UPRIGHT, **arguments})


def test_locked_joints_are_truly_locked():
    # the pose of a locked joint cannot move, whatever the other does
    simulator = Simulator(Plant.of(), constraints=(Constraint(), Constraint("hold"), Constraint("hold")))
    a, _ = linearised(simulator.plant, HORIZONTAL, (1,))
    simulator.reset(HORIZONTAL, current=(1.0, 0.0, 0.0))
    simulator.step((1.6, 0.0, 0.0), 1e-5)
    assert simulator.state[3] / 1e-5 == pytest.approx(a[1, 2], rel=1e-3)


# --------------------------------------------------------------------------------------- command


@compiled
def test_command_prints_both_methods_and_table_7_2(capsys):
    assert call("tune", "--joint", 2, "--pose", "0,-90,90") == 0
    text = capsys.readouterr().out
    found = ultimate_by_eigenvalues(Loop(Plant.of(), 2, tuple(map(radians, (0, -90, 90)))))
    lines = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line.strip()}
    assert float(lines["eigenvalues"][0]) == pytest.approx(found.gain, rel=1e-4)
    assert float(lines["simulation"][1]) == pytest.approx(found.period, rel=0.03)
    assert float(lines["PID"][0]) == pytest.approx(0.6 * found.gain, rel=1e-4)
    assert lines["P"][1:] == ["-", "-"] and "falls over" in text


def test_command_takes_rate_delay_and_plant(capsys):
    assert (
        call(
            "tune",
            "--joint",
            1,
            "--period",
            0.028,
            "--delay",
            1,
            "--method",
            "eigenvalues",
            "--effect",
            "payload:mass=2",
            "--effect",
            "coulomb_friction:joint=1,torque=3",
        )
        == 0
    )
    text = capsys.readouterr().out
    plant = plant_of("payload:mass=2")
    found = ultimate_by_eigenvalues(Loop(plant, 1, (0, 0, 0), 0.028, 1))
    assert f"{found.gain:.6g}" in text and "simulation " not in text.split("note")[0]
    assert "note: the plant has friction" in text


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("--joint", 2, "--pose", "0,90,0"), "joint 2 at 90 deg; expected -223 to 43 deg"),
        (("--joint", 3, "--limit", 100, "--method", "eigenvalues"), "no ultimate gain below 100 V/rad"),
        (("--joint", "two"), "--joint: 'two'; expected a whole number"),
        (("--joint", 4), "joint 4; expected 1 or 2 or 3"),
        (("--joint", 1, "--pose", "0,0"), "--pose: '0,0'; expected three finite numbers"),
    ],
)
def test_command_refuses_in_one_line(arguments, message, capsys):
    assert call("tune", *arguments) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_plants_that_eigenvalues_cannot_see():
    assert is_linear(plant_of("viscous_friction:joint=1,coefficient=2"))
    assert not is_linear(plant_of("coulomb_friction:joint=1,torque=2"))
