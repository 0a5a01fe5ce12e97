# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What no effect explains, told by its joint and its axis, on logs of the arm that got volts of
which the log knows nothing."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from loop_logs import record
from puma_sim_core.loop import explain
from puma_sim_core.loop.shape import Curve, simplest_first
from puma_sim_core.mechanisms import load_mechanism

pytestmark = pytest.mark.timeout(600)
ARM = load_mechanism("puma560")
GEAR = 107.8  # of joint 2


def step(t, simulator):
    """Volts of joint 2 from half of the time on; the inertia couples it to the others."""
    return [0.0, 1.2 * (t > 3.0), 0.0]


def commutation(t, simulator):
    """Twice a turn, with the current of joint 2."""
    return [0.0, 0.3 * simulator.state[7] * np.sin(2.0 * GEAR * simulator.state[1]), 0.0]


@pytest.mark.long
@pytest.mark.parametrize("volts, axis, way", [
    (step, "time", "in one step"), (commutation, "motor_angle", "in proportion to the torque")])
def test_the_joint_and_the_axis_of_what_has_no_name(volts, axis, way):
    found = explain(record(ARM, ARM.plant(), 0.05, 2e-5, seconds=6.0, unlogged=volts))
    assert found.shape is not None, found.sentence
    assert (found.shape.joint, found.shape.axis, found.shape.way) == (2, axis, way)


def curve(joint, gain, knots):
    return Curve(SimpleNamespace(joint=joint, gain=gain, coefficients=np.zeros(knots)), None, [])


def test_of_curves_that_gain_nearly_the_same_the_simplest_stands_first():
    many, few, lines, far, other = (curve(2, 1000.0, 20), curve(2, 980.0, 9), curve(2, 975.0, 2),
                                    curve(2, 960.0, 1), curve(1, 990.0, 2))
    assert simplest_first([many, other, few, lines, far]) == [lines, many, other, few, far]
    assert simplest_first([few]) == [few] and simplest_first([]) == []
    # chance may leave no gain at all
    assert simplest_first([curve(2, -3.0, 9), curve(2, -4.0, 2)])[0].scored.gain == -3.0
