# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""An error of a position is one of the machine only where it is clearly more than that of its encoder."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from loop_fits import PENDULUM, lacking

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify.fitting.intervals import deviations
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted
from puma_sim_core.identify.fitting.resolution import unresolved
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.plant.mechanism_file import load_mechanism

#: amplitude [N.m] of the torque of joint 2
TORQUE = 30.0


@pytest.mark.parametrize(
    "effect, least",
    [
        ("transmission_error:joint=2,order=12,amplitude={:.17g}", 0.5),
        ("sensor_nonlinearity:joint=2,period=3,amplitude={:.17g}", 0.5),
        ("backlash:joint=2,gap={:.17g}", 1.0),
        ("joint_elasticity:joint=2,stiffness={:.17g}", 0.5),
    ],
)
def test_an_error_within_the_encoders_step_is_none_of_the_machine(effect, least):
    turns = np.linspace(0.0, 6.0 * np.pi, 600, endpoint=False)
    signals = SimpleNamespace(link_torque=TORQUE * np.stack([0.0 * turns, np.sin(turns), 9.0 * np.cos(turns)], axis=1))

    def problem(size, step):
        """What is said of an error of the size [rad], which a shaft has by its twist under the torque."""
        position = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
        sampled = SimpleNamespace(joints=3, position=position, quantum=np.array([0.0, step, 1.0]))
        arm = load_mechanism()
        chooser = Trials(None, SimpleNamespace(mechanism=arm, sampled=sampled, signals=lambda theta: signals))
        value = TORQUE / size if "elasticity" in effect else size
        model = Fitted(Point(arm.start, (parse_effect(effect.format(value)),)), np.zeros((4, 3)), 0.0, ())
        return chooser.problem_of(SimpleNamespace(mechanism=arm), model, 0)

    step = 2e-3
    assert "the encoder's own error (a step of 0.002 rad)" in problem(0.99 * least * step, step)
    assert problem(1.01 * least * step, step) is None
    # without a step that shows, any size may be told
    assert problem(0.99 * least * step, 0.0) is None


@pytest.mark.parametrize(
    "effect, name",
    [
        ("transmission_error:joint=1,amplitude=0.003,order=8,phase=0.4", "amplitude"),
        ("joint_elasticity:joint=1,stiffness=1.5,damping=0.003", "stiffness"),
    ],
)
def test_it_is_named_where_it_is_more_by_two_standard_errors(effect, name):
    base, trials, _ = lacking(parse_effect(effect))
    model = base.fit.run(Point(PENDULUM.start, (parse_effect(effect),)), ((0, name),))
    value, spread = model.point.effects[0].values[name], deviations(base.fit, model)[0][0]
    assert 0.0 < 5.0 * spread < value
    if name == "stiffness":
        # the twist, and its standard error to the first order
        torque = trials.problem.signals(model.point.theta).link_torque[:, 0]
        twist = np.sqrt(2.0 * np.mean(torque**2)) / value
        value, spread = twist, twist * spread / value

    def found(away, of=model):
        """With half a step of the encoder some standard errors below the size."""
        quantum = np.array([2.0 * (value - away * spread)])
        of_step = SimpleNamespace(sampled=SimpleNamespace(quantum=quantum), signals=trials.problem.signals)
        return unresolved(of_step, base.fit, of, 0)

    assert found(2.1) is None and "not clearly more than the encoder's own error" in found(1.9)
    assert "+-" in found(-0.1)
    # without derivatives nothing is known of the standard error
    bare = replace(model, jacobian=None)
    assert found(0.1, bare) is None and found(-0.1, bare) is not None
