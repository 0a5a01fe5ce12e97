# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Open-loop experiments of sections 7.2 to 7.5."""

from __future__ import annotations

from math import inf, radians

import numpy as np
import pytest
from arm_reference import open_circuit as reference_open_circuit
from arm_reference import right_hand_side
from scipy.integrate import solve_ivp
from trace_form import arm_table, trace_gravity

from puma_sim_core.arm.rigid_body import arm_pseudo_inertias
from puma_sim_core.effects import parse_effect
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.plant import Plant
from puma_sim_core.thesis import chapter_7_2, chapter_7_3, chapter_7_4, chapter_7_5
from puma_sim_core.thesis.motions import crossing_time, drive, first_time, one_joint, open_circuit
from puma_sim_core.thesis.registry import Context

pytestmark = [pytest.mark.long, pytest.mark.skipif(BACKEND != "numba", reason="whole experiments: compiled only")]

EXPERIMENTS = {
    "7.2": chapter_7_2.run,
    "7.3": chapter_7_3.run,
    "7.4.1": chapter_7_4.elbow,
    "7.4.2": chapter_7_4.shoulder,
    "7.4.3": chapter_7_4.upright,
    "7.4.4": chapter_7_4.remaining,
    "7.5": chapter_7_5.run,
}


@pytest.fixture(scope="module")
def results():
    return {number: run(Context(1)) for number, run in EXPERIMENTS.items()}


@pytest.fixture(scope="module")
def plant():
    return Plant.of()


def row(result, text):
    found = [r for r in result.rows if text in r.quantity]
    assert len(found) == 1, [r.quantity for r in result.rows]
    return found[0]


@pytest.mark.parametrize("number", EXPERIMENTS)
def test_an_experiment_repeats_to_the_bit_and_reports_its_progress(number, results):
    chapter_7_4._campaign.cache_clear()
    shares = []
    again = EXPERIMENTS[number](Context(1, shares.append))
    first = results[number]
    assert (again.summary, again.rows, again.numbers) == (first.summary, first.rows, first.numbers)
    for a, b in zip(again.figures, first.figures):
        assert all(x.y.tobytes() == y.y.tobytes() for x, y in zip(a.curves, b.curves))
    assert shares == sorted(shares) and shares[-1] == 1.0


@pytest.mark.parametrize(
    "number, keys",
    [
        ("7.2", {"7.1", "7.2"}),
        ("7.3", {"7.3", "7.5"}),
        ("7.4.1", {"7.6", "7.7"}),
        ("7.4.2", {"7.8", "7.9"}),
        ("7.4.3", {"7.10", "7.11"}),
        ("7.4.4", {"7.12", "7.13"}),
        ("7.5", {"7.14", "7.15", "7.16"}),
    ],
)
def test_the_plots_of_the_section_are_drawn(number, keys, results):
    found = [figure.key for figure in results[number].figures]
    assert keys <= set(found) and len(found) == len(set(found))


# --------------------------------------------------------------------------------------------- 7.2


@pytest.mark.parametrize("index, volts", [(0, 3.553), (1, 2.499), (2, 1.190)])
def test_least_static_voltage_is_that_of_the_greatest_gravity_torque(plant, index, volts):
    test = chapter_7_2.TESTS[index]
    j = test.joint - 1
    links, table = arm_pseudo_inertias(plant.arm), arm_table(plant.arm)
    greatest = 0.0
    for angle in np.linspace(*plant.arm.joint_ranges[j], 2001):
        q = np.array(test.pose)
        q[j] = angle
        greatest = max(greatest, abs(trace_gravity(q, links, table)[j]))
    motor = plant.arm.motors[j]
    static = 1.6 * greatest / (motor.gear_ratio * 0.2611)
    assert static == pytest.approx(volts, abs=1e-3)
    assert chapter_7_2.greatest_gravity(plant, test) * chapter_7_2.volts_per_torque(plant, j + 1) == pytest.approx(
        static, rel=1e-5
    )
    # a little below it the arm never arrives, a little above it does
    simulator = one_joint(plant, j + 1, chapter_7_2.COARSE)
    assert crossing_time(simulator, j + 1, test.pose, 0.98 * static, 200.0) == inf
    assert crossing_time(simulator, j + 1, test.pose, 1.02 * static, 400.0) < 400.0


@pytest.mark.parametrize("test", chapter_7_2.TESTS, ids=lambda t: t.key)
@pytest.mark.parametrize("volts", [-12.0, 8.0])
def test_crossing_time_is_that_of_the_balance_of_torques(plant, test, volts):
    # so slow that inertia plays no part but at the start: time = integral of dq over the speed
    j = test.joint - 1
    motor = plant.arm.motors[j]
    q = np.tile(test.pose, (4001, 1))
    q[:, j] = np.linspace(*plant.arm.joint_ranges[j], len(q))
    G = np.array([trace_gravity(x, arm_pseudo_inertias(plant.arm), arm_table(plant.arm))[j] for x in q])
    speed = (volts - motor.resistance * G / (motor.gear_ratio * motor.torque_constant)) / (
        motor.back_emf * motor.gear_ratio
    )
    expected = abs(np.sum(0.5 * (1.0 / speed[1:] + 1.0 / speed[:-1]) * np.diff(q[:, j])))
    found = crossing_time(one_joint(plant, test.joint, chapter_7_2.COARSE), test.joint, test.pose, volts, 60.0)
    assert found == pytest.approx(expected, rel=5e-3)


def test_coarse_steps_do_not_show_in_crossing_times(plant):
    for test in chapter_7_2.TESTS:
        fine, coarse = (
            crossing_time(one_joint(plant, test.joint, h), test.joint, test.pose, 9.0, 30.0)
            for h in (0.0005, chapter_7_2.COARSE)
        )
        assert coarse == pytest.approx(fine, abs=1e-6)


@pytest.mark.parametrize("joint, speed", [(1, 2.4596), (2, 1.4270), (3, 2.8687)])
def test_speed_at_forty_volts(plant, joint, speed):
    assert chapter_7_2.steady_speed(plant, joint, 40.0) == pytest.approx(speed, abs=1e-4)


def test_dry_friction_adds_the_same_voltage_whatever_the_load_and_the_time(plant):
    level = 17.6
    for test in chapter_7_2.TESTS[:2]:
        rubbed = Plant(plant.arm, (parse_effect(f"coulomb_friction:joint=2,torque={level}"),))
        for allowed in (12.0, 25.0):
            added = chapter_7_2.voltage_for_time(rubbed, test, allowed) - chapter_7_2.voltage_for_time(
                plant, test, allowed
            )
            assert added == pytest.approx(level * 1.6 / (107.81 * 0.2611), abs=5e-3)


def test_motor_tests_report_what_the_model_gives(results):
    r = results["7.2"]
    assert row(r, "within 20 s, joint 2, arm extended").ours == pytest.approx(7.56, abs=0.01)
    assert row(r, "residual torque, joint 2, arm extended").ours == pytest.approx(17.593, abs=1e-3)
    assert row(r, "residual torque, joint 3").ours == pytest.approx(17.503, abs=1e-3)
    assert row(r, "moments of inertia").ours < 0.05
    times = r.numbers["crossing_time_joint2_s"]
    assert times[8] is None and all(np.diff(times[9:]) < 0) and all(np.diff(times[:8]) > 0)


def test_the_search_for_a_voltage_ends_at_the_time_allowed(plant):
    for test in chapter_7_2.TESTS:
        for sign in (1.0, -1.0):
            volts = chapter_7_2.voltage_for_time(plant, test, 15.0, sign)
            taken = crossing_time(one_joint(plant, test.joint), test.joint, test.pose, sign * volts, 30.0)
            assert taken == pytest.approx(15.0, abs=0.01)


def test_first_time_is_interpolated_and_may_be_never():
    time = np.array([0.0, 1.0, 2.0])
    assert first_time(time, np.array([0.0, 1.0, 3.0]), 2.0) == 1.5
    assert first_time(time, np.array([0.0, -1.0, -3.0]), -2.0) == 1.5
    assert first_time(time, np.array([0.0, 1.0, 3.0]), 4.0) == inf


def test_a_driven_joint_moves_alone(plant):
    r = drive(one_joint(plant, 2), 2, (0.1, -0.5, 0.4), 10.0, 1.0)
    assert (r.position[:, [0, 2]] == (0.1, 0.4)).all()
    assert np.ptp(r.position[:, 1]) > 0.1


# --------------------------------------------------------------------------------------------- 7.3


def test_open_circuit_motors_carry_no_current(plant):
    r = chapter_7_3.fall(open_circuit(plant), duration=2.0)
    assert not r.current.any()
    # and the arm then moves as one without motors does, their rotors apart
    f = right_hand_side(reference_open_circuit(plant), np.zeros(3))
    solution = solve_ivp(f, (0.0, 0.35), np.zeros(9), rtol=1e-10, atol=1e-12)
    free = chapter_7_3.fall(open_circuit(plant), (), duration=0.35)
    np.testing.assert_allclose(free.position[-1], solution.y[:3, -1], atol=1e-7)


@pytest.mark.parametrize(
    "motors, low, high, q1",
    [("shorted", 7.25, 7.35, None), ("open-circuit", 0.37, 0.40, -8.0), ("as-printed", 0.40, 0.45, None)],
)
def test_falls_take_as_long_as_the_model_says(results, motors, low, high, q1):
    r = results["7.3"]
    assert low < row(r, f"time to 43 deg of joint 2, {motors}").ours < high
    if q1 is not None:
        assert row(r, f"joint 1 then, {motors}").ours == pytest.approx(q1, abs=0.5)


def test_only_falling_motors_let_joint_3_overshoot(plant):
    shorted = chapter_7_3.fall(plant, duration=4.0)
    printed = chapter_7_3.fall(Plant(plant.arm, torque_form="printed"))
    assert chapter_7_3.overshoot(shorted) < 0.0 < chapter_7_3.overshoot(printed)
    damped = chapter_7_3.fall(
        Plant(plant.arm, torque_form="printed"), chapter_7_3.STOPS + chapter_7_3.coulomb((0.0, 0.0, 4.0))
    )
    assert chapter_7_3.overshoot(damped) < chapter_7_3.overshoot(printed)


def test_dry_friction_above_the_reaction_holds_joint_1(plant):
    greatest = float(np.abs(chapter_7_3.reaction(open_circuit(plant))).max())
    for share, moves in ((0.8, True), (1.05, False)):
        r = chapter_7_3.fall(open_circuit(plant), chapter_7_3.coulomb((share * greatest, 0.0, 0.0)), duration=0.38)
        assert bool(np.abs(r.position[:, 0]).max() > 1e-6) is moves


def test_friction_intervals_hold_the_truth_as_often_as_they_say(plant):
    covered = []
    for seed in range(30, 46):
        _, numbers = chapter_7_3.estimation(Context(seed), plant)
        covered += [
            numbers[f"friction{j}_low"] <= numbers[f"friction{j}_truth"] <= numbers[f"friction{j}_high"]
            for j in (1, 2, 3)
        ]
        assert numbers["misfit_with_other_links"] > 10.0
    # 48 intervals of 95 per cent: fewer than 40 would happen once in a thousand times
    assert sum(covered) >= 40


# --------------------------------------------------------------------------------------------- 7.4


def test_radii_that_a_test_sees_are_found_and_the_others_are_said_not_to_be(results):
    for number, names in (("7.4.1", ("k3yy",)), ("7.4.2", ("k2zz",)), ("7.4.3", ("sum",)), ("7.4.4", ("s", "p", "r"))):
        numbers = results[number].numbers
        for name in names:
            value, truth = numbers[f"{name}_estimate"], numbers[f"{name}_truth"]
            assert numbers[f"{name}_low"] < value < numbers[f"{name}_high"]
            assert value == pytest.approx(truth, rel=0.03)
    for number in ("7.4.3", "7.4.4"):
        assert row(results[number], "each").ours == "not identifiable"
    assert not results["7.4.4"].numbers["k2yy_covered"]


# --------------------------------------------------------------------------------------------- 7.5


def test_an_arm_that_is_replayed_on_itself_follows_the_record(results):
    numbers = results["7.5"].numbers
    for j in (2, 3):
        assert numbers[f"way_ratio_joint{j}_with_friction"] == pytest.approx(1.0, abs=0.005)
        assert numbers[f"way_ratio_joint{j}"] > 1.1


def test_the_first_drop_comes_from_the_brakes_and_not_from_the_missing_current(results, plant):
    numbers = results["7.5"].numbers
    assert np.abs(numbers["drop_without_current_rad"]).max() < 1e-3
    drop = np.array(numbers["drop_on_its_brakes_rad"])
    assert (drop[1:] > 0.01).all()
    # a shorted motor under a load G creeps at R G / (kT ke N)
    from puma_sim_core.arm.rigid_body import gravity_torque

    G = gravity_torque(np.array(chapter_7_5.START), plant.arm)
    creep = (
        np.array(
            [
                -m.resistance * g / (m.gear_ratio**2 * m.torque_constant * m.back_emf)
                for m, g in zip(plant.arm.motors, G)
            ]
        )
        * chapter_7_5.FIRST
    )
    np.testing.assert_allclose(drop[1:], creep[1:], rtol=0.2)
    assert radians(1.0) < drop[1] < radians(5.0)
