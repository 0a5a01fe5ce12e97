# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Zeros of joints that no sensor has, as the trials of a selection show them."""

from __future__ import annotations

import numpy as np
import pytest

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify.checks.wrong_zero import wrong_zeros
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection.state import Stage, Threshold

#: why an offset of 0.9 rad is none
TOO_MUCH = "more than any machine has"


def offset(gain, angle, problem):
    effect = parse_effect(f"encoder_offset:joint=2,angle={angle}")
    model = Fitted(Point(np.zeros(1), (effect,)), np.zeros((4, 2)), 0.0, ())
    return Trial(Scored("encoder_offset", 2, 0.0), gain, 5.0, model, 3.0, problem)


def stage(gain, problem, rival, beyond=None):
    other = Trial(Scored("coulomb_friction", 1, 0.0), rival, 10.0, None, 3.0, beyond)
    return Stage((offset(gain, 0.9, problem), other), Threshold.alike(15.0), None)


@pytest.mark.parametrize(
    "gain, rival, beyond, problem, found",
    [
        (120.0, 90.0, None, TOO_MUCH, True),
        (105.0, 90.0, None, TOO_MUCH, False),  # not clearly better than an effect
        (120.0, 90.0, None, None, False),  # one that a sensor may have is an effect like others
        (60.0, 0.0, None, TOO_MUCH, True),
        (25.0, 0.0, None, TOO_MUCH, False),  # not above the threshold by enough
        (120.0, 110.0, "impossible", TOO_MUCH, True),
        (120.0, 130.0, "impossible", TOO_MUCH, False),  # what no machine has fits better still
    ],
)
def test_a_zero_that_no_sensor_has_is_a_fault_of_the_data(gain, rival, beyond, problem, found):
    faults = wrong_zeros([stage(gain, problem, rival, beyond)])
    assert [(f.channel, f.row) for f in faults] == ([("position2", None)] if found else [])
    assert all("offset by about 0.9 rad" in f.what for f in faults)


JUMP = Fault.of("position2", 380, "a jump by 1.3 at row 380 (line 381)", "a motion that the drive can make")
SPIKE = Fault.of("position2", 380, "a spike: 2.1 at row 380", "a motion that the drive can make", 1)


@pytest.mark.parametrize(
    "cuts, row",
    [
        ([JUMP], 380),
        ([SPIKE, JUMP], 380),
        ([], None),
        # rows that are left out change no zero, and neither does what another channel does
        ([SPIKE], None),
        ([Fault("position1", 380, JUMP.what)], None),
        ([Fault("time", 380, "a gap")], None),
    ],
)
def test_where_the_position_jumped_for_good_the_zero_is_wrong_from_there_on(cuts, row):
    (found,) = wrong_zeros([stage(120.0, TOO_MUCH, 90.0)], cuts)
    assert (found.channel, found.row, found.rows) == ("position2", row, 0)
    assert ("a jump by 1.3 at row 380" in found.what) is (row is not None)
    assert "offset" in found.what
