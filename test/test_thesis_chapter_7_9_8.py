# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Sections 7.9 and 8: what they compare, and what they claim."""

from __future__ import annotations

import numpy as np
import pytest

from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.thesis import chapter_7_9, chapter_8
from puma_sim_core.thesis.registry import Context

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def measured():
    return chapter_7_9.run(Context(seed=1))


@pytest.fixture(scope="module")
def wish():
    return chapter_8.run(Context(seed=1))


# ------------------------------------------------------------------------------------------- 7.9


def test_the_gains_are_those_of_the_thesis():
    plant = Plant.of()
    horizontal, upright = (chapter_7_9.gains_of(plant, pose) for pose in chapter_7_9.POSES)
    assert horizontal["measured"] == PidGains(137.0, 0.315, 0.032)
    assert upright["measured"] == PidGains(176.0, 0.42, 0.04)
    # table 7.2 on Kmax = 220, Tp = .6 and on 150, .45
    assert horizontal["estimated, as printed"] == PidGains(132.0, 0.3, 0.075)
    assert upright["estimated, as printed"] == PidGains(90.0, 0.225, 0.05625)
    own = horizontal["estimated, corrected model"]
    assert own.gain == pytest.approx(0.6 * 4696, rel=1e-3)
    assert own.derivative_time == pytest.approx(0.0706 / 8, rel=1e-2)


def test_the_plots_and_what_is_printed_of_them_are_there(measured):
    assert [figure.key for figure in measured.figures] == ["7.25", "7.26", "7.9-schedule"]
    printed = {row.quantity: row.printed for row in measured.rows if row.printed is not None}
    assert printed["estimated from measured values, extended, horizontal"] == 35.0
    assert printed["estimated from measured values, vertical"] == 17.0
    assert len(printed) == 4


def test_measured_values_are_better_where_the_thesis_says_so(measured):
    n = measured.numbers
    for plot in ("7.25", "7.26"):
        rms = {
            name: n[f"{plot} {name}: rms_mrad"]
            for name in ("measured", "estimated, as printed", "estimated, corrected model", "scheduled")
        }
        assert rms["measured"] < rms["estimated, as printed"]
        assert max(rms["estimated, corrected model"], rms["scheduled"]) < 0.3 * rms["measured"]
        assert n[f"{plot} measured: damping"] > n[f"{plot} estimated, as printed: damping"] > 0.0


def test_scheduled_gains_do_at_both_poses_what_fixed_ones_do_at_their_own(measured):
    n = measured.numbers

    def overshoot(name, where):
        return n[f"descent {name}: {where} overshoot"]

    for where in ("upright", "horizontal"):
        assert overshoot("scheduled", where) == pytest.approx(overshoot(f"fixed, {where}", where), rel=0.15)
    assert overshoot("fixed, upright", "horizontal") > 1.5 * overshoot("scheduled", "horizontal")


# --------------------------------------------------------------------------------------------- 8


def worst(numbers, of, name, what):
    return max(numbers[f"{of}, {name}: {what}"])


def test_every_controller_is_beside_the_others_in_every_case(wish):
    quantities = " ".join(row.quantity for row in wish.rows)
    for of in chapter_8.CASES:
        for name in chapter_8.NAMES:
            assert f"{of}, {name}: step" in quantities
            assert f"{of}, {name}: abrupt path" in quantities
            assert f"{of}, {name}: smooth path" in quantities
    assert len(wish.figures) == 4


def test_computed_torque_is_the_most_exact_on_a_smooth_path_in_every_case(wish):
    for of in chapter_8.CASES:
        for what in ("smooth rms_mrad", "smooth worst_mrad"):
            ours = worst(wish.numbers, of, "computed torque", what)
            others = [worst(wish.numbers, of, name, what) for name in chapter_8.NAMES[:-1]]
            assert ours < min(others)
    right, wrong, friction = (worst(wish.numbers, of, "computed torque", "smooth worst_mrad") for of in chapter_8.CASES)
    assert right < 0.7 and right < wrong and right < friction


def test_smooth_setpoints_avoid_overshoot_as_the_thesis_concludes(wish):
    for name in chapter_8.NAMES:
        abrupt, smooth = (
            worst(wish.numbers, "model right", name, f"{kind} overshoot_mrad") for kind in ("ramp", "smooth")
        )
        assert smooth < abrupt


def test_decoupling_lessens_what_a_joint_does_to_the_others(wish):
    coupling = {name: max(wish.numbers[f"coupling, {name}"][1:]) for name in chapter_8.NAMES}
    assert coupling["computed torque"] == min(coupling.values())


def test_arms_with_wrong_parameters_differ_by_ten_percent_and_are_possible():
    plant = Plant.of()
    arms = chapter_8.arms(plant, np.random.default_rng(1))
    assert [len(arms[of]) for of in chapter_8.CASES] == [1, chapter_8.WRONG, 1]
    assert arms["model right"] == [plant] and arms["unknown friction"][0].arm == plant.arm
    assert len(arms["unknown friction"][0].effects) == 6
    for arm in (wrong.arm for wrong in arms["parameters 10 % wrong"]):
        for link, own in zip(arm.links, plant.arm.links):
            assert link.mass / own.mass == pytest.approx(1.0, abs=0.1 + 1e-12)
            assert link.mass != own.mass and link.centre == own.centre
        for motor, own in zip(arm.motors, plant.arm.motors):
            for name in ("inertia", "resistance", "torque_constant", "back_emf"):
                assert abs(getattr(motor, name) / getattr(own, name) - 1.0) == pytest.approx(0.1)
            assert motor.inductance == own.inductance
        for q2 in np.linspace(*arm.joint_ranges[1], 15):
            for q3 in np.linspace(*arm.joint_ranges[2], 15):
                mass = inertia((0.0, q2, q3), arm) + np.diag(arm.motor_inertia)
                assert np.linalg.eigvalsh(mass)[0] > 0.4
