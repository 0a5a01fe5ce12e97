# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Steps in which models of two masses on a joint follow a log."""

from __future__ import annotations

import numpy as np
import pytest
from loop_logs import record

from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.steps import followed_rate
from puma_sim_core.identify.selection.validate import rms
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.tracking import innovations


@pytest.mark.parametrize(
    "text",
    [
        "joint_elasticity:joint=1,stiffness=20000,damping=0.05",
        "joint_elasticity:joint=1,stiffness=20,damping=12",
        "backlash:joint=1,gap=0.002,stiffness=2000,damping=0.2",
    ],
)
def test_a_vibration_that_rows_do_not_show_is_followed_coarsely(text):
    mechanism, row = load_mechanism("pendulum"), 5e-3
    plant = mechanism.plant(mechanism.start, (parse_effect(text), parse_effect("coulomb_friction:joint=1,torque=0.03")))
    coarse, shown = followed_rate(plant, row), FITTING.steps_of_shown / row
    assert shown <= coarse <= max(shown, FITTING.unseen_steps * plant.least_rate) < plant.least_rate
    # rows that show it, and a vibration that rows show, have all steps
    slow = mechanism.plant(mechanism.start, (parse_effect("joint_elasticity:joint=1,stiffness=1,damping=0.001"),))
    assert followed_rate(plant, 1e-5) == plant.least_rate > slow.least_rate == followed_rate(slow, row) > 0.0
    assert followed_rate(mechanism.plant(), row) == 0.0
    time = np.arange(0.0, 3.0, row)
    volts = 3.0 * np.sin(6.0 * time)[:, None]
    measured = Simulator(mechanism.plant(mechanism.start, (plant.effects[1],))).run(time, volts).position
    measured += 1e-4 * np.random.default_rng(5).standard_normal(measured.shape)

    def errors(rate):
        simulator = Simulator(plant, max_step=1.2e-3, train_rate=rate)
        return innovations(simulator, time, volts, measured, np.array([[0.3, 12.0, 0.0]])).innovation

    fine, found = (errors(rate) for rate in (4.0 * plant.least_rate, coarse))
    np.testing.assert_array_equal(errors(plant.least_rate), errors(None))
    assert 0.0 < rms(found - fine)[0] < 0.05 * rms(fine)[0]


def test_an_error_of_the_transmission_has_no_vibration_to_follow():
    arm = load_mechanism()
    plant = arm.plant(arm.start, (parse_effect("transmission_error:joint=2,amplitude=0.002,order=12"),))
    log = record(arm, plant, seconds=2.0)
    assert followed_rate(plant, 1e-3) == 0.0
    along = Predictor([log], arm, [lambda time: time > 1e9], np.full(3, 0.05), np.full(3, 2e-5))
    with_it, without = (rms(along.errors(each))[1] for each in (plant, arm.plant()))
    assert with_it < 0.1 * without


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), "fast"])
def test_a_rate_that_is_none_is_refused(rate):
    plant = load_mechanism().plant(effects=(parse_effect("joint_elasticity:joint=2,stiffness=20000"),))
    with pytest.raises(ParameterError, match="train_rate"):
        Simulator(plant, train_rate=rate)
