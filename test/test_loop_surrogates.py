# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What chance gives, by surrogates and their fitted tail: alarms are as frequent as asked."""

from __future__ import annotations

import numpy as np
import pytest
from loop_logs import pieces, record

from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.prepare import library_of
from puma_sim_core.identify.screening.causal import CausalScreen, Placebos, placebo_shifts
from puma_sim_core.identify.screening.evidence import solved
from puma_sim_core.identify.screening.hypotheses import hypotheses
from puma_sim_core.identify.screening.surrogates import level
from puma_sim_core.identify.settings import SELECTION
from puma_sim_core.plant.mechanism_file import load_mechanism

NUMBER = SELECTION.placebos


def share_beyond(gains, probability):
    """How often the last of each row (n, k + 1) of gains is beyond the level of the others."""
    return float(np.mean([row[-1] > level(row[:-1], probability) for row in gains]))


@pytest.mark.parametrize("probability", [0.1, 0.02, 0.01])
def test_a_level_of_exponential_gains_is_exceeded_with_its_probability(probability):
    gains = np.random.default_rng(1).exponential(2.5, (20000, NUMBER + 1))
    error = np.sqrt(probability * (1.0 - probability) / len(gains))
    assert share_beyond(gains, probability) == pytest.approx(probability, abs=3.0 * error)
    # of as many gains the greatest alone is exceeded four times as often as asked of a name
    counted = np.mean(gains[:, -1] > gains[:, :-1].max(axis=1))
    assert counted > 3.0 * SELECTION.surrogate_level


@pytest.mark.parametrize("freedom", [1, 2, 4])
@pytest.mark.parametrize("hypotheses_asked", [1, 10, 100])
def test_maxima_of_gains_exceed_it_about_as_often_as_said(freedom, hypotheses_asked):
    rng = np.random.default_rng([2, freedom, hypotheses_asked])
    gains = 0.5 * rng.chisquare(freedom, (4000, NUMBER + 1, hypotheses_asked)).max(axis=2)
    assert 0.005 < share_beyond(gains, 0.01) < 0.015
    assert 0.08 < share_beyond(gains, 0.1) < 0.12


def test_a_level_goes_with_the_scale_and_the_place_of_the_gains_and_not_with_their_order():
    gains = np.random.default_rng(3).gumbel(size=NUMBER)
    assert level(3.0 + 7.0 * gains[::-1]) == pytest.approx(3.0 + 7.0 * level(gains))
    assert level(gains, 0.01) > level(gains, 0.1) > np.median(gains)
    assert level(np.zeros(NUMBER)) == 0.0


def test_white_innovations_raise_as_many_alarms_as_asked():
    """The whole library against white noise in the rows of a real fit, each with its own shifted copies."""
    mechanism = load_mechanism("pendulum")
    plant = mechanism.plant(mechanism.start)
    _, _, predictor = made = pieces(mechanism, record(mechanism, plant, volts=0.1, noise=1e-5))
    problem, point = made[0], Point(mechanism.start, ())
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(plant)))
    model, jacobian = fit.to_end(point, ())
    screen = CausalScreen(fit, model.point, model.errors, fit.whitened(jacobian), problem)
    pairs = [screen.pairs(kind, joint) for kind, joint in hypotheses(library_of(mechanism).values(), mechanism)]
    rng, draws = np.random.default_rng(4), 200
    white = rng.standard_normal((len(screen.y[0]), draws))
    shifts = placebo_shifts(0)

    def greatest(placebos):
        return np.max([placebos.gains(own) for own in pairs if own], axis=0)

    own = greatest(Placebos(screen, [white], solved(screen.factor, screen.N[0].T @ white)))
    shifted = np.hstack([np.column_stack([np.roll(y, int(s * len(y))) for s in shifts]) for y in white.T])
    others = greatest(Placebos(screen, [shifted], solved(screen.factor, screen.N[0].T @ shifted)))
    gains = np.column_stack([others.reshape(draws, len(shifts)), own])
    for probability in (0.2, 0.1, 0.05):
        error = np.sqrt(probability * (1.0 - probability) / draws)
        assert share_beyond(gains, probability) == pytest.approx(probability, abs=2.5 * error)
