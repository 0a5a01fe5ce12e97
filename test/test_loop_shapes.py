# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What no effect explains, told by its joint and its axis, on logs of the arm that got volts of
which the log knows nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loop_logs import pieces, record

from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate
from puma_sim_core.identify import explain
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.residuals.shape import Curve, again, axes, describe, noise, simplest_first
from puma_sim_core.identify.residuals.unnamed import Unnamed
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.evidence import Estimate, Scored
from puma_sim_core.plant.mechanism_file import load_mechanism

pytestmark = pytest.mark.timeout(600)
ARM = load_mechanism("puma560")
GEAR = 107.8  # of joint 2


def step(t, simulator):
    """Volts of joint 2 from half of the time on; the inertia couples it to the others."""
    return [0.0, 1.2 * (t > 3.0), 0.0]


def commutation(t, simulator):
    """Twice a turn, with the current of joint 2."""
    return [0.0, 0.3 * simulator.state[7] * np.sin(2.0 * GEAR * simulator.state[1]), 0.0]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "volts, axis, way", [(step, "time", "in one step"), (commutation, "motor_angle", "in proportion to the torque")]
)
def test_the_joint_and_the_axis_of_what_has_no_name(volts, axis, way):
    found = explain(record(ARM, ARM.plant(), 0.05, 2e-5, seconds=6.0, unlogged=volts))
    assert found.shape is not None, found.sentence
    assert (found.shape.joint, found.shape.axis, found.shape.way) == (2, axis, way)


def test_columns_in_blocks_are_a_wave_of_voltage_through_the_response_of_the_predictor():
    mechanism = load_mechanism("pendulum")
    log = record(mechanism, mechanism.plant(), 0.05, 2e-5, seconds=4.0)
    problem, _, predictor = pieces(mechanism, log, 0.05, 2e-5)
    point = Point(mechanism.start, ())
    raw = predictor.errors(point.plant(mechanism))
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(raw))
    causal = CausalScreen(fit, point, fit.weighting(raw), fit.whitened(fit.derivatives(point, ())), problem)
    assert causal.block > 1
    time, blocks = causal.signals.time, causal.block_times(0)
    settled = blocks > time[0] + 1.5
    for frequency in (2.0, 11.0, 90.0):
        wave = np.exp(2j * np.pi * frequency * time)
        candidate = Candidate(
            ({0: wave.imag}, {0: wave.real}), VOLTAGE_COLUMN, np.zeros(2), np.ones(2), lambda heights: {}, {}
        )
        (gain,) = causal.response(0, np.array([frequency]))
        # `response` has means over time, the columns those of rows
        x = np.pi * frequency * predictor.step
        expected = gain * x / np.sin(x) * np.exp(2j * np.pi * frequency * blocks)
        found = causal.columns(candidate)[0] @ [1j, 1.0]
        assert np.abs(found - expected)[settled].max() < 1e-4 * abs(gain)


def test_a_line_in_time_stays_the_same_in_another_noise():
    def shake(t, simulator):
        return [0.5 * np.sin(2.0 * np.pi * 6.0 * t), 0.0, 0.0]

    log = record(ARM, ARM.plant(), 0.05, 2e-5, seconds=4.0, unlogged=shake)
    problem, _, predictor = pieces(ARM, log, 0.05, 2e-5)
    unnamed = Unnamed(predictor, problem, seed=0)
    point = Point(ARM.start, ())
    causal, found = unnamed._about(Fitted(point, np.zeros(0), 0.0, ()))
    line = next(c for c in found if c.scored.name == "line")
    frequency = line.candidate.grid["frequency"]
    assert line.scored.joint == 1 and frequency == pytest.approx(6.0, abs=0.15)
    other = unnamed._causal(point, (), noise(causal, found))
    there = again(other, line)
    assert there.candidate.grid["frequency"] == frequency
    assert there.scored.gain > 20.0
    assert np.ptp(there.volts(other)[:, 0]) == pytest.approx(1.0, rel=0.25)
    assert not there.volts(other)[:, 1:].any()


class Gap:
    """A play of the voltage of joint 3, of which the log has what goes into it. half : half of its width [V]."""

    def __init__(self, half):
        self.half, self.left = half, 0.0

    def __call__(self, t, simulator):
        given = 3.0 * np.sin(2.1 * (t + 2.0)) + 2.0 * np.sin(5.3 * (t + 2.0))
        self.left = min(max(self.left, given - self.half), given + self.half)
        return [0.0, 0.0, self.left - given]


@pytest.mark.parametrize("half, near", [(0.15, 0.1), (0.42, 0.3)])
def test_one_gap_in_the_voltage_is_found_with_its_width(half, near):
    """near : share to which its height is known. It is in volts of the retuned drive, whose gain takes up a part of a
    wide gap."""
    log = record(ARM, ARM.plant(), 0.05, 2e-5, seconds=4.0, unlogged=Gap(half))
    problem, _, predictor = pieces(ARM, log, 0.05, 2e-5)
    found, chance = Unnamed(predictor, problem, seed=0).shapes(Fitted(Point(ARM.start, ()), np.zeros(0), 0.0, ()))
    best = found[0]
    assert (best.joint, best.axis.name, best.way) == (3, "voltage", "with the play of one gap")
    assert best.scored.gain > chance
    # with one height; an acceleration, which changes its sign as the voltage turns, is all but as good to a coarse bank
    assert best.axis.knots == pytest.approx([2.0 * half], rel=0.1)
    assert best.heights == pytest.approx([half], rel=near)
    shape = describe(best, ())
    assert shape.centre == pytest.approx([0.0, 2.0 * half], rel=0.1)
    assert shape.curve == pytest.approx([-half, half], rel=near)


@pytest.mark.parametrize("scale", [1.0, 1e-2])
def test_a_height_of_any_curve_is_a_voltage_whatever_the_voltages_of_the_machine(scale):
    log = record(ARM, ARM.plant(), 0.05, 2e-5, seconds=2.0)
    signals = pieces(ARM, log, 0.05, 2e-5)[0].signals(ARM.start)
    banks = axes(replace(signals, voltage=scale * signals.voltage), 0)
    plays = [bank for bank in banks if bank.way == "with hysteresis"]
    assert {bank.name for bank in plays} == {"position", "voltage"}
    for bank in banks:
        # at its knot a curve is the height; a play once its width is used up
        greatest = np.abs(bank.make()).max(axis=0)
        assert (greatest <= 1.0 + 1e-9).all() and (greatest[-1:] > 0.95).all()
        if bank.way == "with hysteresis":
            assert greatest == pytest.approx(np.ones(len(bank.knots)), abs=1e-9)


def curve(joint, gain, knots):
    estimate = Estimate(gain, None, np.zeros(knots), None, gain)
    return Curve(Scored("position", joint, gain, estimate), None, [])


def test_of_curves_that_gain_nearly_the_same_the_simplest_stands_first():
    many, few, lines, far, other = (
        curve(2, 1000.0, 20),
        curve(2, 980.0, 9),
        curve(2, 975.0, 2),
        curve(2, 960.0, 1),
        curve(1, 990.0, 2),
    )
    assert simplest_first([many, other, few, lines, far]) == [lines, many, other, few, far]
    assert simplest_first([few]) == [few] and simplest_first([]) == []
    # chance may leave no gain at all
    assert simplest_first([curve(2, -3.0, 9), curve(2, -4.0, 2)])[0].scored.gain == -3.0
