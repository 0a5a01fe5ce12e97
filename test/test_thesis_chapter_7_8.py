# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 7.8: its records, what its equations imply, and what the experiment claims."""

from __future__ import annotations

from math import log

import numpy as np
import pytest

from puma_sim_core.arm.kinematics import wrist_position
from puma_sim_core.servo.pid import PidGains, recursive_coefficients
from puma_sim_core.thesis import chapter_7_8 as section
from puma_sim_core.thesis.registry import Context, experiments
from puma_sim_core.tuning.pid_identification import identify_pid

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def maker():
    return section.Maker()


@pytest.fixture(scope="module")
def result():
    return section.run(Context(seed=1))


def test_the_motions_are_ten_millimetres_in_x_where_the_section_has_them(maker):
    arm = maker.plant.arm
    places = section.motions(arm)
    for motion in places.values():
        setpoint = section.repeated(arm, motion, 0.3, 80)
        wrist = np.array([wrist_position(q, arm) for q in setpoint])
        assert np.ptp(wrist[:, 0]) == pytest.approx(0.010, rel=0.02)
        assert np.ptp(wrist[:, 1:], axis=0) == pytest.approx([0.0, 0.0], abs=1e-12)
        for q, (low, high) in zip(setpoint.T, arm.joint_ranges):
            assert low <= q.min() and q.max() <= high
    reach = arm.a2 + np.hypot(arm.a3, arm.d4)
    horizontal = wrist_position(np.array(places["7.9"].start), arm)
    assert horizontal[2] == pytest.approx(0.0, abs=1e-12)
    assert np.hypot(*horizontal[:2]) == pytest.approx(np.hypot(reach, arm.d3), abs=1e-3)
    highest = wrist_position(np.array(places["7.10"].start), arm)
    assert reach - 0.03 < highest[2] < reach
    # along x, the motion does not turn joint 1
    along = section.repeated(arm, places["along x"], 0.3, 80)
    assert np.ptp(along[:, 0]) < 1e-12


def test_a_record_is_what_the_controller_saw(maker):
    gains = section.EQUATIONS[0].gains
    record = maker.log("7.9", gains, np.random.default_rng(3))
    assert len(record) == section.RECORD
    found = identify_pid(record)
    assert found.rounding_only
    assert found.voltage_step == pytest.approx(80.0 / 4096.0)
    for value, interval in zip(
        (gains.gain, gains.integral_time, gains.derivative_time),
        (found.gain, found.integral_time, found.derivative_time),
    ):
        assert value in interval
    # in the form of 7.5 to 7.7 the same record has gains that differ by h/Ti
    velocity = identify_pid(record, form="velocity")
    for value, interval in zip(
        section.true_gains(gains), (velocity.gain, velocity.integral_time, velocity.derivative_time)
    ):
        assert value in interval


def test_the_quoted_gains_do_not_follow_from_the_equations_with_any_signs():
    for equation in section.EQUATIONS:
        for distance, gains, _ in section.readings(equation):
            assert distance > log(100.0) and min(gains) > 0.0
    seven_nine, seven_ten = section.EQUATIONS
    h = 0.028 / 30.0
    assert section.implied_gains(seven_nine.numerator, h) == pytest.approx(
        (6739 - 5743, 996 * h / (6739 + 1430 + 5743), 5743 * h / 996)
    )
    assert section.implied_gains(seven_ten.numerator, h).gain == -295.0
    assert not section.readings(seven_ten)


def test_the_sensitivity_is_that_of_a_small_change():
    h = section.SERVO_PERIOD
    for equation in section.EQUATIONS:
        numbers = {}
        section.sensitivity_rows(equation, numbers)
        q = np.array(recursive_coefficients(equation.gains, h))
        share = 0.01 * numbers[f"{equation.key}_needed_q0_percent"]
        moved = section.implied_gains(q * [1.0 + share, 1.0, 1.0], h).gain
        assert moved / equation.gains.gain - 1.0 == pytest.approx(0.01 * equation.percent[0])
        share = 0.01 * numbers[f"{equation.key}_needed_q1_percent"]
        moved = section.implied_gains(q * [1.0, 1.0 + share, 1.0], h).integral_time
        assert equation.gains.integral_time / moved - 1.0 == pytest.approx(-0.01 * equation.percent[1])


def test_the_experiment_finds_the_gains_and_the_bias_that_it_tells_of(result):
    for equation in section.EQUATIONS:
        true = section.true_gains(equation.gains)
        assert result.numbers[f"{equation.key}_known_mean"] == pytest.approx(true, rel=1e-3)
        assert max(result.numbers[f"{equation.key}_known_half_range_percent"]) < 0.3
    true = section.true_gains(section.EQUATIONS[0].gains)
    free = np.array(result.numbers["7.9_free_mean"]) / true - 1.0
    assert 0.005 < free[0] < 0.05 and -0.3 < free[1] < -0.05 and -0.05 < free[2] < -0.005
    found = result.numbers
    pairs = section.PAIRS
    assert found["scheduling_equal gains"][0] == 0
    for name in ("Kg 0.02 % greater", "Kg 1 % greater", "the gains quoted for the two poses"):
        assert found[f"scheduling_{name}"] == [pairs, found[f"scheduling_{name}"][1], pairs]


def test_the_experiment_is_registered_and_gives_the_same_numbers_again(result):
    assert experiments()["7.8"].run is section.run
    again = section.run(Context(seed=1))
    assert again.rows == result.rows and again.numbers == result.numbers
    assert [f.key for f in again.figures] == [f.key for f in result.figures]
    assert {"7.8", "7.24"} <= {f.key for f in result.figures}


def test_printed_gains_are_those_of_the_section():
    assert section.EQUATIONS[0].gains == PidGains(137.0, 0.315, 0.032)
    assert section.EQUATIONS[1].gains == PidGains(176.0, 0.42, 0.04)
