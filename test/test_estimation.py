# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Estimation from recorded motions: its intervals, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from puma_sim_core.arm.rigid_body import inertia, lumped_constants
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import BACKEND
from puma_sim_core.thesis.chapter_7_4 import (
    LUMPS,
    SCALED,
    WAIST,
    Campaign,
    demand,
    gyration,
    lumps,
    with_friction,
    with_lumps,
)
from puma_sim_core.thesis.motions import UPRIGHT
from puma_sim_core.thesis.registry import Context
from puma_sim_core.tuning.estimation import (
    START_SPREAD,
    Instrument,
    ServoTest,
    _whitener,
    estimate,
    record_from_servo,
    with_gyration,
)

compiled_only = pytest.mark.skipif(BACKEND != "numba", reason="many runs: compiled kernel only")


@pytest.fixture(scope="module")
def campaign():
    return Campaign(Context(7))


def test_the_hidden_arm_is_none_that_the_estimator_knows(campaign):
    hidden, nominal = campaign.hidden(3), campaign.nominal
    for name in ("k3yy", "k2zz", *WAIST):
        assert gyration(hidden, name) != gyration(nominal, name)
    for own, other in zip(hidden.arm.links, nominal.arm.links):
        assert (own.mass, own.centre) == (other.mass, other.centre)
    assert hidden.arm.motors == nominal.arm.motors


def test_demand_goes_where_and_as_fast_as_it_says():
    pose = (0.1, -0.2, 0.3)
    setpoint = demand(pose, 2, 1.0, 0.8)
    steps = np.diff(setpoint[:, 1], prepend=pose[1]) / 0.028
    assert setpoint[-1, 1] == pytest.approx(1.0, abs=1e-12)
    assert (setpoint[:, [0, 2]] == (0.1, 0.3)).all()
    assert steps.min() >= -1e-12 and steps.max() <= 0.8 + 1e-9
    assert demand(pose, 2, -1.0, 0.8)[-1, 1] == pytest.approx(-1.0, abs=1e-12)


def test_an_instrument_rounds_to_its_steps_and_knows_its_spread():
    instrument = Instrument(3e-4, 0.03, (1e-4, 2e-4, 5e-4), 0.02)
    rng = np.random.default_rng(3)
    true = np.linspace(-1.0, 1.0, 40000)
    angle = instrument.angle(true, 3, rng)
    assert np.abs(angle / 5e-4 - np.round(angle / 5e-4)).max() < 1e-6
    assert np.std(angle - true) == pytest.approx(instrument.angle_deviation(3), rel=0.02)
    volts = instrument.voltage(10.0 * true, rng)
    assert np.std(volts - 10.0 * true) == pytest.approx(instrument.voltage_deviation, rel=0.02)


@compiled_only
def test_spread_of_open_loop_angles_is_what_the_weights_assume(campaign):
    # the same motion recorded 120 times, and simulated with the true parameters each time
    plant = campaign.hidden(1)
    residuals = []
    for n in range(120):
        test, rng = ServoTest(1, campaign.servo), np.random.default_rng(n)
        record, _ = record_from_servo(plant, demand(UPRIGHT, 1, 1.0, 1.6), test, campaign.instrument, rng)
        residuals.append(record.simulated(plant)[:, 0] - record.angle[:, 0])
    residuals = np.array(residuals)
    L = np.linalg.inv(_whitener(record, 1, plant, campaign.instrument))
    # contrasts to the start, since the angle of the start is free
    moving = slice(60, None, 20)
    contrast = residuals[:, moving] - residuals[:, :20].mean(axis=1, keepdims=True)
    weights = np.eye(len(L))[moving] - np.where(np.arange(len(L)) < 20, 0.05, 0.0)
    predicted = np.sqrt(((weights @ L) ** 2).sum(axis=1))
    ratio = contrast.std(axis=0) / predicted
    assert ratio.min() > 0.8 and ratio.max() < 1.2, ratio


@pytest.mark.thorough
@compiled_only
def test_intervals_hold_the_truth_as_often_as_they_say():
    covered, worst = [], 0.0
    for seed in range(200, 214):
        c = Campaign(Context(seed))
        hidden = c.hidden(1)
        weights = {n: hidden.arm.links[int(n[1]) - 1].mass for n in SCALED}
        scale = sum(m * gyration(c.nominal, n) for n, m in weights.items())
        found = [
            (c.elbow.of("k3yy"), gyration(hidden, "k3yy")),
            (c.shoulder.of("k2zz"), gyration(hidden, "k2zz")),
            (c.upright.combined({"factor": scale}), sum(m * gyration(hidden, n) for n, m in weights.items())),
            *((c.waist.of(n), v) for n, v in zip(LUMPS, lumps(hidden))),
        ]
        covered += [low <= true <= high for (_, low, high), true in found]
        worst = max(worst, *(abs(value - true) / (high - low) for (value, low, high), true in found))
        assert all(fit.probability > 1e-4 for fit in (c.elbow, c.shoulder, c.upright, c.waist))
    # 84 intervals of 95 per cent: fewer than 74 would happen once in a thousand times
    assert sum(covered) >= 74
    # not too wide either: an interval that always holds says nothing
    assert worst > 0.4


@compiled_only
def test_estimates_are_the_same_when_repeated():
    first, second = Campaign(Context(5)).elbow, Campaign(Context(5)).elbow
    assert first.values.tobytes() == second.values.tobytes()
    assert first.covariance.tobytes() == second.covariance.tobytes()
    assert Campaign(Context(6)).elbow.values.tobytes() != first.values.tobytes()


def test_five_radii_enter_the_equations_of_motion_as_three_sums(campaign):
    nominal = campaign.nominal
    m1, m2, m3 = (link.mass for link in nominal.arm.links)
    k = {name: gyration(nominal, name) for name in WAIST}
    other = with_gyration(
        nominal,
        {
            "k1yy": k["k1yy"] - (m2 * 0.004 - m3 * 0.01) / m1,
            "k2xx": k["k2xx"] + 0.004,
            "k2yy": k["k2yy"] + 0.004,
            "k3xx": k["k3xx"] - 0.01,
            "k3zz": k["k3zz"] - 0.01,
        },
    )
    np.testing.assert_allclose(lumped_constants(other.arm), lumped_constants(nominal.arm), rtol=0, atol=1e-14)
    np.testing.assert_allclose(lumps(other), lumps(nominal), rtol=1e-13)
    np.testing.assert_allclose(lumps(with_lumps(nominal, 1.7, 2.9, -0.3)), (1.7, 2.9, -0.3), rtol=1e-13)


def test_parameters_that_a_test_cannot_tell_apart_are_refused(campaign):
    def model(x):
        return with_friction(with_gyration(campaign.nominal, {"k1yy": x[0], "k2xx": x[1]}), 1, 8.0, 6.0)

    with pytest.raises(ParameterError, match="do not tell k1yy, k2xx apart"):
        estimate(model, campaign.upright_records[:1], ("k1yy", "k2xx"), (0.0152, 0.0596), campaign.instrument)


def test_parameters_that_do_nothing_are_refused(campaign):
    with pytest.raises(ParameterError, match="do not depend on k2zz"):
        estimate(
            lambda x: with_gyration(campaign.nominal, {"k3yy": x[0], "k2zz": x[1]}),
            campaign.elbow_records[:1],
            ("k3yy", "k2zz"),
            (0.0786, 0.1514),
            campaign.instrument,
        )


@pytest.mark.parametrize(
    "records, guess, text",
    [([], (0.1,), "no records"), (None, (0.0,), "other than 0"), (None, (0.1, 0.2), "1 numbers")],
)
def test_estimation_without_records_or_scale_is_refused(campaign, records, guess, text):
    records = campaign.elbow_records if records is None else records
    with pytest.raises(ParameterError, match=text):
        estimate(lambda x: campaign.nominal, records, ("k3yy",), guess, campaign.instrument)


@pytest.mark.parametrize("name", ["k4yy", "k3xy", "kyy", "m3yy"])
def test_unknown_radii_are_refused(campaign, name):
    with pytest.raises(ParameterError, match="k1xx to k3zz"):
        with_gyration(campaign.nominal, {name: 0.1})


def test_weights_are_the_inverse_of_the_covariance_summed_voltage_by_voltage(campaign):
    record, plant, instrument = campaign.upright_records[0], campaign.hidden(1), campaign.instrument
    motor, torque = plant.arm.motors[0], plant.torque_per_ampere[0]
    M = float(inertia(np.array(UPRIGHT), plant.arm)[0, 0]) + motor.inertia
    slope = motor.back_emf * motor.gear_ratio + motor.resistance * plant.viscous_friction[0] / torque
    lag = motor.resistance * M / (torque * slope)
    t, h = record.time[:: record.every], record.time[1]

    def ramp(age):
        return np.where(age > 0.0, age - lag * (1.0 - np.exp(-np.maximum(age, 0.0) / lag)), 0.0)

    age = t[:, None] - record.time[None, :-1]
    reply = (ramp(age) - ramp(age - h)) / slope
    covariance = (
        instrument.angle_deviation(1) ** 2 * np.eye(len(t))
        + START_SPREAD**2
        + instrument.voltage_deviation**2 * reply @ reply.T
    )
    W = _whitener(record, 1, plant, instrument)
    assert (np.tril(W) == W).all()
    np.testing.assert_allclose(W @ covariance @ W.T, np.eye(len(t)), rtol=0, atol=1e-10)
