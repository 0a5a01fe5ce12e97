# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Errors held out fold by fold over the whole of a log."""

from __future__ import annotations

import numpy as np
import pytest

from loop_logs import pieces, record
from puma_sim_core.effects import parse_effect
from puma_sim_core.loop.cross_validation import PLACES, Folds
from puma_sim_core.loop.prediction import Point, PredictionFit
from puma_sim_core.loop.problem import Problem
from puma_sim_core.mechanisms import load_mechanism

pytestmark = pytest.mark.long
NOISE = 0.05


def fits(*true):
    """(folds, models fitted with these effects, weighting) of a log of the pendulum with them."""
    mechanism = load_mechanism("pendulum")
    effects = tuple(parse_effect(text) for text in true)
    log = record(mechanism, mechanism.plant(effects=effects), volts=NOISE, noise=1e-5)
    problem, with_blocks = pieces(mechanism, log, NOISE, 1e-5)
    predictor = with_blocks(problem)
    weighting = predictor.white_weighting(predictor.errors(mechanism.plant(effects=effects)))
    fit = PredictionFit(predictor, weighting)

    def fitted(text, *names):
        point = Point(mechanism.start, (parse_effect(text),) if text else ())
        return fit.run(point, [(0, name) for name in names])

    return Folds(problem, with_blocks), fitted, weighting


def test_folds_cover_a_log_without_overlap():
    mechanism = load_mechanism("pendulum")
    problem, _ = pieces(mechanism, record(mechanism, mechanism.plant()))
    times = sum(Problem(problem.sampled, mechanism, (), True, place).held.astype(int)
                for place in PLACES)
    # but for a row at a border
    assert np.mean(times == 1) > 0.99


def test_what_is_there_lowers_the_error_and_what_is_not_does_not():
    friction = "coulomb_friction:joint=1,torque=0.02"
    folds, fitted, weighting = fits(friction)
    with_it, without = fitted(friction, "torque"), fitted(None)
    assert folds.lowers(with_it, without, weighting)
    assert not folds.lowers(without, with_it, weighting)
    assert not folds.lowers(without, without, weighting)


def test_a_fold_is_left_out_where_the_others_tell_nothing_of_an_effect():
    blow = "impulse:joint=1,torque=0.5,time=5.0,width=0.1"
    folds, fitted, weighting = fits(blow)
    model, raw = folds._known(fitted(blow, "torque"), weighting)
    told = [folds._told(PredictionFit(predictor, weighting), model, raw)
            for predictor, _ in folds.parts]
    holds = [bool(predictor.held_rows[int(5.0 / 2e-3)].all()) for predictor, _ in folds.parts]
    assert sum(holds) == 1 and told == [not each for each in holds]
    # without it the parameters give way to the blow, and the other folds show that
    assert folds.lowers(model, fitted(None), weighting)


@pytest.mark.parametrize("place", PLACES)
def test_a_fold_is_not_fitted_to(place):
    mechanism = load_mechanism("pendulum")
    problem, with_blocks = pieces(mechanism, record(mechanism, mechanism.plant()))
    predictor = with_blocks(Problem(problem.sampled, mechanism, (), True, place))
    assert predictor.held_rows.any() and not (predictor.held_rows & predictor.fit_rows).any()
