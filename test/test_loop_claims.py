# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a verdict claims: nothing is missing only where open-loop errors are of the noise's size."""

from dataclasses import replace

import numpy as np
import pytest
from loop_logs import record

from puma_sim_core.effects import parse_effect
from puma_sim_core.effects.shared.limits import limit_candidates
from puma_sim_core.identify import explain
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.checks.plausibility import Plausibility, coarse
from puma_sim_core.identify.outcome import beyond_noise
from puma_sim_core.identify.result import StageErrors
from puma_sim_core.identify.settings import CHECKS, RESIDUALS
from puma_sim_core.plant.mechanism_file import load_mechanism


def errors(augmented, nominal=4.0) -> StageErrors:
    augmented = np.array(augmented, dtype=float)
    return StageErrors(nominal * augmented, 2.0 * augmented, augmented, np.full(augmented.shape, np.nan))


def test_errors_of_the_noise_s_size_are_noise_and_the_worst_joint_is_named():
    limit = RESIDUALS.open_loop_beyond
    assert beyond_noise(errors([1.0, 0.99 * limit, 1.0]), np.ones(3)) is None
    assert beyond_noise(errors([1.0, 40.0, 2.0]), np.array([1.0, 1.0, 0.01])) == (3, pytest.approx(200.0))


def test_a_log_without_noise_has_no_size_of_noise():
    assert beyond_noise(errors([1e-7]), np.array([1e-10])) is not None
    assert beyond_noise(errors([1e-7], nominal=1e5), np.array([1e-10])) is None


@pytest.mark.parametrize("most", [0.0, np.nan])
def test_a_joint_without_noise_says_nothing(most):
    assert beyond_noise(errors([1.0, 5.0]), np.array([1.0, most])) is None
    assert beyond_noise(errors([np.nan, np.nan]), np.ones(2)) is None


def test_limits_come_from_the_motion_where_hardly_any_of_the_command_comes_through():
    time = np.linspace(0.0, 10.0, 4000)
    asked = 40.0 * np.sin(3.0 * time) + 60.0 * np.sin(1.3 * time)
    through = np.clip(asked, -0.8, 0.8)

    def limits(*args):
        return [c.grid["current"] for c in limit_candidates(0, asked, 0.1, "current", float, 1.0, *args)]

    by_command, by_both = limits(), limits(through)
    assert min(by_command) > 0.8 and min(abs(limit - 0.8) for limit in by_both) < 1e-6
    # an ordinary log has the limits of its command alone
    assert limits(asked) == by_command


def test_a_push_is_no_fault_of_the_voltage_but_a_voltage_of_another_log_is():
    mechanism = load_mechanism("dfki_pendulum")
    quiet = record(mechanism, mechanism.plant(), noise=2e-4)
    # ninety times the nominal friction, for as long as a hand may push
    push = parse_effect("impulse:joint=1,torque=-18,time=6.1,width=0.3")
    pushed = record(mechanism, mechanism.plant(effects=(push,)), noise=2e-4)
    assert np.abs(pushed.position - quiet.position).max() > 1.0
    model = Plausibility(mechanism)
    c = coarse(pushed)
    # it is more than any share that a wrong channel leaves, and gone with a few of the rows
    assert model.shares(model.fits(c), CHECKS.channel_another_floor)[0] > CHECKS.channel_another
    (lasting,) = model.lasting_fits(c)
    assert model.share(lasting, 0) < 0.1 and lasting.rows > 0.8 * model.fits(c)[0].rows
    assert not check(pushed, mechanism).doubts
    t = pushed.time[:, None]
    other = replace(pushed, voltage=3.0 * np.sin(5.1 * t) + 2.0 * np.sin(0.7 * t + 1.0))
    assert [doubt.channel for doubt in check(other, mechanism).doubts] == ["voltage1"]


@pytest.mark.long
def test_voltages_that_no_effect_explains_refuse_a_log():
    mechanism = load_mechanism("pendulum")
    log = record(mechanism, mechanism.plant(), volts=0.05, noise=2e-4)
    t = log.time[:, None]
    other = replace(log, voltage=3.0 * np.sin(5.1 * t) + 2.0 * np.sin(0.7 * t + 1.0))
    assert not check(log, mechanism).doubts
    found = check(other, mechanism)
    assert not found.faults and [doubt.channel for doubt in found.doubts] == ["voltage1"]
    refused = explain(other, plant="pendulum")
    assert refused.verdict == "DATA_FAULT" and refused.faults == found.doubts
