# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Values that no machine has: they are not named, and do not let a verdict say that nothing is missing."""

from types import SimpleNamespace

import numpy as np
import pytest
from loop_fits import lacking
from loop_logs import record

from puma_sim_core.effects import KINDS, Effect, parse_effect
from puma_sim_core.effects.screening import reached
from puma_sim_core.identify import explain
from puma_sim_core.identify.fitting.trial import IMPOSSIBLE, Trial
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection import refits
from puma_sim_core.plant.mechanism_file import load_mechanism

pytestmark = pytest.mark.long


def test_friction_that_would_be_none_in_a_part_of_the_range_is_none_of_a_machine():
    _, trials, _ = lacking(parse_effect("coulomb_friction:joint=1,torque=0.05"))
    for amplitude, refused in ((0.03, False), (0.09, True)):
        effect = parse_effect(f"position_dependent_friction:joint=1,torque=0.05,amplitude={amplitude},angle=3")
        assert ("negative level" in (trials.implausible(effect) or "")) == refused


def test_a_part_of_the_range_that_a_log_does_not_visit_counts_as_well():
    """Seen on the double pendulum, which turns over: a level of 0.01 N.m that varied by 0.19 in its motion."""
    _, trials, _ = lacking(parse_effect("coulomb_friction:joint=1,torque=0.05"))
    position, kind = trials.problem.sampled.position[:, 0], KINDS["position_dependent_friction"]
    motion = float(position.min()), float(position.max())
    values = {"torque": 0.05, "amplitude": 0.09, "angle": sum(motion) / 2.0}
    reach = trials.mechanism.ranges[0]
    assert reach[0] < motion[0] and motion[1] < reach[1]
    assert 0.05 + 0.09 * np.cos((motion[1] - motion[0]) / 2.0) > 0.0
    assert kind.screening.illegal(values, motion, motion) is None
    assert "negative level" in trials.implausible(Effect(kind, 1, values))
    # of a joint that reaches no further it may be
    assert reached((np.nan, np.nan), motion) == reached((0.0, 0.0), motion) == motion
    assert reached((motion[0] - 1.0, motion[1] - 1.0), motion) == (motion[0] - 1.0, motion[1])


def test_a_spring_that_a_fit_took_far_outside_the_motion_is_a_constant_torque():
    """Seen on a lever that is lifted once: the screened spring was slack nearer, the fitted one at -4.7 rad."""
    _, trials, _ = lacking(parse_effect("coulomb_friction:joint=1,torque=0.05"))
    position = trials.problem.sampled.position[:, 0]
    low, high = float(position.min()), float(position.max())
    for share, refused in ((-1.6, True), (-1.4, False), (0.5, False), (2.4, False), (2.6, True)):
        spring = parse_effect(f"joint_spring:joint=1,stiffness=0.1,angle={low + share * (high - low)}")
        assert ("far outside the range" in (trials.implausible(spring) or "")) == refused


def test_an_effect_of_a_size_that_no_machine_has_is_no_name_and_not_nothing():
    """Seen on a blind record: a gap of 9.4 mrad, more than machines have, had 666 nat, and nothing was missing."""
    mechanism = load_mechanism("pendulum")
    small = parse_effect("voltage_dead_band:joint=1,voltage=0.006")
    log = record(mechanism, mechanism.plant(effects=(small,)), volts=5e-4, noise=1e-5)
    found = explain(log, plant="pendulum")
    assert (found.verdict, found.effects) == ("UNNAMED", ())
    assert "voltage dead-band on joint 1 has" in found.sentence
    assert " mV, less than any machine has (35.2 mV)" in found.sentence


@pytest.mark.parametrize("current", [0.043, pytest.param(0.02, marks=pytest.mark.thorough)])
def test_a_drive_may_be_set_to_any_limit_that_leaves_the_motion(current):
    """Seen on a blind record: 0.262 A where machines have 0.267 A at least, and a log at its limit was a data fault."""
    mechanism = load_mechanism("pendulum")
    log = record(mechanism, mechanism.plant(effects=(parse_effect(f"current_limit:joint=1,current={current}"),)), 0.02)
    found = explain(log, plant="pendulum")
    assert (found.verdict, [(e.name, e.joint) for e in found.effects]) == ("NAMED", [("current_limit", 1)])
    assert found.effects[0].parameters["current"].value == pytest.approx(current, rel=0.05)


def test_fits_that_ran_away_are_those_of_more_gain_than_all_that_explain():
    """Seen on a blind record: about parameters that a payload had stretched a limit of 1 A ran off to 176 A, which no
    machine has, and was not tried from the nominal ones."""

    def trial(name, gain, problem=None):
        effect = parse_effect(KINDS[name].example)
        fitted = SimpleNamespace(point=SimpleNamespace(effects=(effect,)))
        return Trial(Scored(name, effect.joint, gain), gain, 0.0, fitted, 0.0, problem)

    impossible = f"{IMPOSSIBLE}: current 176 A"
    named, away = trial("coulomb_friction", 90.0), trial("current_limit", 100.0, impossible)
    behind = trial("joint_spring", 80.0, impossible)
    unresolved = trial("backlash", 900.0, "not clearly more than nothing")
    assert refits._run_away([behind, named, unresolved, away]) == [away]
    assert refits._run_away([behind, away]) == [away, behind]
    # a wrong zero explains a log with any value
    assert refits._run_away([trial("encoder_offset", 200.0, impossible), away]) == []
    assert refits._run_away([trial("current_limit", 10.0, impossible)]) == []


def test_a_limit_that_leaves_no_motion_is_none_of_a_machine():
    _, trials, _ = lacking(parse_effect("coulomb_friction:joint=1,torque=0.05"))
    needed = np.sqrt(np.mean(trials.problem.signals(trials.mechanism.start).current ** 2))
    for share, refused in ((0.6, False), (0.04, True)):
        limit = parse_effect(f"current_limit:joint=1,current={share * needed}")
        assert ("less than any machine has" in (trials.implausible(limit) or "")) == refused
    assert 0.04 * needed < 0.043 < 0.6 * needed
