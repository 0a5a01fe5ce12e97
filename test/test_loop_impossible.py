# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Values that no machine has: they are not named, and do not let a verdict say that nothing is missing."""

import numpy as np
import pytest
from loop_fits import lacking
from loop_logs import record

from puma_sim_core.effects import KINDS, Effect, parse_effect
from puma_sim_core.effects.screening import reached
from puma_sim_core.identify import explain
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
