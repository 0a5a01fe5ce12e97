# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Experiments of chapters 5 and 6: third-order form, integration, constraints, inversion."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.third_order import joint_torque_per_ampere
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.thesis import chapter_5_6, chapter_6
from puma_sim_core.thesis.misprints import chapter_6 as misprints_6
from puma_sim_core.thesis.misprints.reference import nominal
from puma_sim_core.thesis.registry import Context

pytestmark = pytest.mark.long
UPRIGHT = np.array([0.0, -math.pi / 2, math.pi / 2])
RUNS = {
    "5.2": chapter_5_6.third_order,
    "6.1": chapter_6.constraints,
    "6.2": chapter_6.run,
    "6.2.1": chapter_6.locks_and_run_time,
    "6.3": chapter_5_6.inversion,
    "6.4": chapter_5_6.program_matrices,
}


@pytest.fixture(scope="module")
def results():
    return {number: run(Context(seed=1)) for number, run in RUNS.items()}


def row(result, start):
    found = [each for each in result.rows if each.quantity.startswith(start)]
    assert len(found) == 1, start
    return found[0].ours


@pytest.mark.parametrize("number", [number for number in RUNS if number != "6.2"])
def test_progress_rises_to_one(number):
    seen = []
    RUNS[number](Context(seed=3, progress=seen.append))
    assert seen == sorted(seen) and seen[-1] == 1.0 and seen[0] >= 0.0


# --------------------------------------------------------------------------------------- section 5


def test_both_states_end_where_the_regression_says(results):
    numbers = results["5.2"].numbers
    assert numbers["two states agree to 1e-10"] is True
    np.testing.assert_allclose(numbers["q(0.5 s), F = N kt i"], (0.68745378, -0.6102092, 1.07667885), rtol=0, atol=2e-8)
    np.testing.assert_allclose(
        numbers["q(0.5 s), F = kt i, as printed"], (0.30113443, 0.48721605, 0.90871915), rtol=0, atol=2e-8
    )


@pytest.mark.parametrize("form", ["physical", "printed"])
def test_motion_is_one_in_both_states(form):
    one, other = (chapter_5_6.motion(state, form) for state in ("acceleration", "current"))
    np.testing.assert_allclose(one[1], other[1], rtol=0, atol=1e-8)
    # fast motion as printed: accelerations of some 100 rad/s^2
    np.testing.assert_allclose(one[2], other[2], rtol=0, atol=1e-6)


def test_named_matrices_have_their_structure(results):
    numbers = {name: np.array(value) for name, value in results["5.2"].numbers.items() if name[0].isupper()}
    for name in ("HMAT", "KMAT", "LKMAT"):
        assert np.array_equal(numbers[name], np.diag(np.diag(numbers[name])))
    scaled = np.linalg.solve(numbers["LKMAT"], numbers["Dbar"])
    np.testing.assert_allclose(scaled, scaled.T, rtol=1e-7)


# ------------------------------------------------------------------------------------- section 6.2


def test_orders_of_convergence(results):
    for orders in ("orders, smooth", "orders, random"):
        rk4, euler = results["6.2"].numbers[orders]
        assert rk4 == pytest.approx(4.0, abs=0.35)
        assert euler == pytest.approx(1.0, abs=0.1)


def test_servo_sample_is_accurate_beyond_need(results):
    assert row(results["6.2"], "error of RK4 at the servo sample of 28/30 ms, smooth") < 1e-8
    assert row(results["6.2"], "error of RK4 at the servo sample of 28/30 ms, random") < 1e-6


def test_euler_pays_more_than_fifty_times(results):
    start = "evaluations of the derivative for an error of 1e-6 rad, "
    assert row(results["6.2"], start + "Euler") > 50 * row(results["6.2"], start + "RK4")


def test_rk4_oscillates_by_itself_just_above_its_limit():
    # the linear limit of the arm where it stands, tried on the whole equations for a second
    limit = misprints_6.stability_limit(chapter_6.pose_eigenvalues(UPRIGHT))
    plant, start = Plant.of("bejczy"), (*UPRIGHT, *[0.0] * 3, 0.1, 0.1, 0.1)
    volts = np.zeros((120, 3))
    below = chapter_6.rk4(plant, start, volts, 1, 0.99 * limit)
    above = chapter_6.rk4(plant, start, volts, 1, 1.03 * limit)
    # currents start at 0.1 A and would die out within a few milliseconds
    assert np.max(np.abs(below.states[20:, 6:])) < 0.2
    assert above.failed >= 0 or np.max(np.abs(above.states[20:, 6:])) > 5.0


def test_limit_is_nowhere_below_that_of_the_motor_alone():
    motor = nominal().motors[0]
    alone = misprints_6.stability_limit(np.array([-motor.resistance / motor.inductance]))
    assert 1e3 * alone == pytest.approx(8.36, abs=0.01)
    assert np.min(chapter_6.limit_map()[1]) > 1e3 * alone


def test_fifty_milliseconds_overflow_at_once():
    assert 0 < chapter_6.failure_row(0.050) < 10
    assert chapter_6.failure_row(0.005) == -1


def test_adaptive_reference_agrees_with_rk4_at_a_tiny_step():
    plant = Plant.of("bejczy")
    volts = np.tile((20.0, -15.0, 10.0), (4, 1))
    start = (0.1, -0.4, 0.7, 0.3, -0.2, 0.5, 0.5, -1.0, 0.8)
    reference = chapter_6.adaptive(plant, start, volts)
    fine = chapter_6.rk4(plant, start, volts, 400)
    np.testing.assert_allclose(reference.states, fine.states, rtol=0, atol=1e-9)
    assert fine.evaluations == 4 * 4 * 400


def test_euler_step_is_the_derivative_times_the_step():
    plant = Plant.of("bejczy")
    start = np.array([0.1, -0.4, 0.7, 0.3, -0.2, 0.5, 0.5, -1.0, 0.8])
    volts = np.array([[20.0, -15.0, 10.0]])
    run = chapter_6.euler(plant, start, volts, 1)
    expected = start + chapter_6.ROW * misprints_6.rates(start, volts[0])
    np.testing.assert_allclose(run.states[1], expected, rtol=1e-12)


# ------------------------------------------------------------------------- sections 6.1 and 6.2.1


def test_all_combinations_of_constraints_ran(results):
    assert row(results["6.1"], "combinations") == len(list(itertools.product("abcd", repeat=3)))
    assert row(results["6.1"], "greatest distance") == "below 1e-12"


def test_effective_inertias_of_locked_joints(results):
    numbers = results["6.2.1"].numbers
    np.testing.assert_allclose(numbers["upright: inertia, kg.m^2"], (2.498, 6.328, 1.129), atol=1e-3)
    np.testing.assert_allclose(numbers["upright: inertia by overwriting, kg.m^2"], (1.355, 2.975, 0.924), atol=1e-3)
    for way, name in (("", ", right"), (" by overwriting", ", overwritten")):
        np.testing.assert_allclose(
            numbers[f"upright: inertia seen in the motion{name}"], numbers[f"upright: inertia{way}, kg.m^2"], rtol=1e-8
        )


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_simulator_locks_joints_rightly(joint):
    # the acceleration that a current gives to the one free joint
    right, overwritten = misprints_6.locked_inertias(UPRIGHT)
    locks = [Constraint() if j == joint else Constraint("hold") for j in range(3)]
    simulator = Simulator(Plant.of("bejczy"), constraints=locks)
    accelerations = []
    for current in (0.0, 5.0):
        simulator.reset(UPRIGHT, current=[current if j == joint else 0.0 for j in range(3)])
        run = simulator.run([0.0, 1e-4], np.zeros((2, 3)), acceleration=True)
        accelerations.append(run.acceleration[0, joint])
    torque = 5.0 * joint_torque_per_ampere(nominal())[joint]
    found = torque / (accelerations[1] - accelerations[0])
    assert found == pytest.approx(right[joint], rel=1e-9)
    assert abs(found - overwritten[joint]) > 0.1


def test_right_lock_responds_as_the_simulator():
    at, velocity = chapter_6.locked_response(False, duration=0.028)
    simulator = Simulator(Plant.of("bejczy"), constraints=[Constraint(), Constraint("hold"), Constraint("hold")])
    simulator.reset(UPRIGHT)
    run = simulator.run(at, np.tile((20.0, 0.0, 0.0), (len(at), 1)))
    np.testing.assert_allclose(velocity, run.velocity[:, 0], rtol=0, atol=2e-4)
    # overwriting is another motion by far
    _, wrong = chapter_6.locked_response(True, duration=0.028)
    assert np.max(np.abs(wrong - velocity)) > 0.05


def test_run_times_are_on_the_page_only(results):
    result = results["6.2.1"]
    assert any("run time" in each.quantity for each in result.page_rows)
    assert not any("run time" in each.quantity for each in result.rows)
    assert all(each.printed in (None, 540.0) for each in result.page_rows)


# ----------------------------------------------------------------------------- sections 6.3 and 6.4


def test_d_is_indefinite_and_the_sum_is_not(results):
    numbers = results["6.3"].numbers
    assert numbers["smallest eigenvalue of D"] == pytest.approx(-0.405, abs=5e-4)
    assert numbers["smallest eigenvalue of D + Ia"] == pytest.approx(0.760, abs=5e-4)
    assert (
        0.0 < numbers["share that meets the conditions and is indefinite"] < numbers["share of poses with D indefinite"]
    )


def test_conditions_of_section_6_3():
    good = np.diag([1.0, 2.0, 3.0])
    fooled = np.full((3, 3), -0.9) + 1.9 * np.eye(3)
    bad = np.array([[1.0, 2.0, 0], [2.0, 1.0, 0], [0, 0, 1]])
    assert chapter_5_6.meets_conditions(np.array([good, fooled, bad])).tolist() == [True, True, False]
    assert np.linalg.eigvalsh(fooled)[0] < 0


def test_gauss_jordan_inverts_in_either_precision():
    rng = np.random.default_rng(4)
    for _ in range(50):
        matrix = rng.normal(size=(3, 3)) + 3 * np.eye(3)
        np.testing.assert_allclose(chapter_5_6.gauss_jordan(matrix) @ matrix, np.eye(3), rtol=0, atol=1e-12)
        single = chapter_5_6.gauss_jordan(matrix, np.float32)
        assert single.dtype == np.float32
        np.testing.assert_allclose(single @ matrix, np.eye(3), rtol=0, atol=1e-4)
    # without its exchange of rows the elimination would divide by zero
    turned = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    np.testing.assert_array_equal(chapter_5_6.gauss_jordan(turned), turned.T)
    with pytest.raises(ZeroDivisionError):
        chapter_5_6.gauss_jordan(np.zeros((3, 3)))


def test_corrected_p_moves_the_arm_rightly_and_each_misprint_does_not(results):
    numbers = dict(results["6.4"].numbers)
    true = numbers.pop("q(0.5 s), corrected")
    np.testing.assert_allclose(true, (0.68745378, -0.6102092, 1.07667885), rtol=0, atol=1e-7)
    assert len(numbers) == 8
    for slip, apart in numbers.items():
        assert max(apart) > 1e-6, slip
    assert max(numbers["LMAT sign"]) > 0.05


def test_corrected_jerk_is_that_of_the_third_order_module():
    from puma_sim_core.arm.third_order import jerk

    rng = np.random.default_rng(6)
    for _ in range(20):
        q, qd, qdd, v = rng.normal(size=(4, 3))
        np.testing.assert_allclose(
            misprints_6.jerk_6_2(q, qd, qdd, v),
            jerk(q, qd, qdd, v, load_parameters("bejczy"), misprints_6.VISCOUS),
            rtol=1e-9,
            atol=1e-9,
        )
