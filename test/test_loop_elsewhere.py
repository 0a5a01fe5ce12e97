# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A push is named only where it stands out among what a push would gain elsewhere in the log."""

from __future__ import annotations

import numpy as np
import pytest
from loop_logs import pieces, record

from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.identify import explain
from puma_sim_core.identify.fitting.dispersion import blocks
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.elsewhere import gains_elsewhere, level_elsewhere, level_of_pieces
from puma_sim_core.plant.mechanism_file import load_mechanism

PENDULUM = load_mechanism("dfki_pendulum")
PUSH = parse_effect("impulse:joint=1,torque=-6,time=2.6,width=0.2")


def greatest_gains(rng, pieces):
    """The greatest of 20 gains with 3 degrees of freedom in each of so many pieces [nat]."""
    return 0.5 * rng.chisquare(3, (pieces, 20)).max(axis=1) - 5.0


@pytest.mark.parametrize("further", (0, 3))
@pytest.mark.parametrize("count", (6, 12, 30, 75))
def test_the_greatest_of_further_pieces_is_above_the_level_as_often_as_asked_for(count, further):
    rng, probability, trials = np.random.default_rng(count), 0.05, 2000
    above = [
        greatest_gains(rng, count).max() > level_of_pieces(greatest_gains(rng, count), probability, further)
        for _ in range(trials)
    ]
    # the scale is known by few pieces: the share is right within a factor of three, and never far above
    assert probability / 4.0 < np.mean(above) < 1.5 * probability


def test_more_pushes_do_not_hide_one():
    rng, found = np.random.default_rng(4), []
    for _ in range(200):
        gains = greatest_gains(rng, 12)
        gains[:3] = (60.0, 80.0, 1000.0)
        found.append(level_of_pieces(gains, 0.005, 3) < 60.0)
        assert level_of_pieces(gains, 0.005, 3) <= level_of_pieces(gains, 0.005)
    assert np.mean(found) > 0.9
    # with a push in every other piece none stands out, and of a few pieces at most a quarter may have one
    gains = greatest_gains(rng, 12)
    gains[::2] = 60.0
    assert level_of_pieces(gains, 0.005, 3) > 60.0
    assert level_of_pieces(np.array([60.0, 61.0, 1.0, 0.9, 0.8, 0.7]), 0.005, 3) > 60.0


def test_of_a_single_piece_nothing_stands_out():
    assert level_of_pieces(np.array([3.0]), 0.005) == np.inf
    assert level_of_pieces(np.full(8, 3.0), 0.005) == 3.0


def beside(*pushes):
    """(gain of the push of 2.6 s [nat], gains elsewhere, level) in a log with more pushes, as (time, torque)."""

    def unlogged(t, _):
        own = [(2.6, PUSH.values["torque"]), *pushes]
        return np.array([sum(p * np.cos(np.pi * (t - at) / 0.2) ** 2 for at, p in own if abs(t - at) < 0.1)])

    log = record(PENDULUM, PENDULUM.plant(), 0.05, 2e-5, seconds=8.0, unlogged=unlogged)
    problem, _, predictor = pieces(PENDULUM, log, 0.05, 2e-5, place=0.0)
    found = []
    for effects in ((), (PUSH,)):
        point = Point(PENDULUM.start, effects)
        raw = predictor.errors(point.plant(PENDULUM))
        if not found:
            fit = PredictionFit(predictor, predictor.unfiltered_weighting(raw))
        found.append((fit.objective(fit.weighting(raw), point), point, fit.weighting(raw)))
    (without, _, _), (with_it, point, errors) = found
    causal = CausalScreen(fit, point, errors, fit.whitened(fit.derivatives(point, ())), problem)
    args = causal, KINDS["impulse"], 1, blocks(predictor)
    return without - with_it, gains_elsewhere(*args), level_elsewhere(*args)


def test_one_push_stands_out_and_one_of_many_does_not():
    gain, elsewhere, level = beside()
    assert len(elsewhere) >= 8 and gain > 100.0 > level
    # bumps as a wrong model leaves them: one in nearly every piece
    rng = np.random.default_rng(8)
    bumps = [(float(at), float(rng.choice([-6.0, 6.0]))) for at in np.arange(0.5, 7.8, 0.8) if abs(at - 2.6) > 0.3]
    gain, elsewhere, level = beside(*bumps)
    assert np.median(elsewhere) > 100.0 and level > gain


@pytest.mark.thorough
def test_a_push_by_hand_is_named_where_it_came_and_beside_the_friction():
    """Its shape is a bell and not the effect's own: place and momentum are what is asked for."""
    at, sigma, greatest = 6.2, 0.09, 0.8

    def unlogged(t, _):
        return np.array([greatest * np.exp(-0.5 * ((t - at) / sigma) ** 2)])

    friction = parse_effect("coulomb_friction:joint=1,torque=0.15")
    log = record(PENDULUM, PENDULUM.plant(effects=(friction,)), 0.1, 1e-4, unlogged=unlogged)
    found = {(effect.name, effect.joint): effect for effect in explain(log, plant="dfki_pendulum").effects}
    assert set(found) == {("coulomb_friction", 1), ("impulse", 1)}
    values = {name: p.value for name, p in found["impulse", 1].parameters.items()}
    assert values["time"] == pytest.approx(at, abs=0.03)
    # half of the peak times the width, and the bell's
    momentum = 0.5 * values["torque"] * values["width"]
    assert momentum == pytest.approx(np.sqrt(2.0 * np.pi) * sigma * greatest, rel=0.1)
