# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The validation set speaks against an effect only beyond chance."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from loop_fits import lacking, tried

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify.fitting.pieces import clearly_above_zero, pieces
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.identify.settings import FITTING, SELECTION

STEP = 0.01
LENGTH = int(SELECTION.noise_piece / STEP)


def test_pieces_cover_the_rows_that_count_and_cross_no_gap():
    rows = np.zeros(400, dtype=bool)
    rows[10:150] = rows[200:215] = rows[300:400] = True
    found = pieces(rows, STEP)
    assert np.array_equal(np.concatenate(found), np.flatnonzero(rows))
    assert all(np.all(np.diff(piece) == 1) for piece in found)
    assert all(len(piece) < 2 * LENGTH for piece in found)
    # what is too short for one is a piece of its own
    assert len(found) == 140 // LENGTH + 1 + 100 // LENGTH


def test_a_mean_counts_beyond_its_standard_error():
    rng = np.random.default_rng(1)
    above = [clearly_above_zero(rng.standard_normal(6)) for _ in range(4000)]
    assert np.mean(above) == pytest.approx(0.025, abs=0.008)
    assert clearly_above_zero(np.array([1.0, 1.1, 0.9]))
    assert clearly_above_zero(np.array([1.0])) and not clearly_above_zero(np.array([-1.0]))
    assert not clearly_above_zero(np.zeros(0))


def validation_gain(less):
    """Of a fit that gains 100 nat; less (k,) [nat]: what it gains on each piece of the validation set."""
    rows = np.repeat(len(less) * [True], LENGTH)
    fit = SimpleNamespace(predictor=SimpleNamespace(validation_rows=rows[:, None], step=STEP))
    fit.validation_sum = lambda errors: PredictionFit.validation_sum(fit, errors)
    fit.validation_pieces = lambda errors: PredictionFit.validation_pieces(fit, errors)
    before = np.full((len(rows), 1), 2.0)
    after = np.sqrt(before**2 - 2.0 * np.repeat(less, LENGTH)[:, None] / LENGTH)
    base, fitted = (SimpleNamespace(errors=errors) for errors in (before, after))
    return Trials.validation_gain(fit, base, fitted, 100.0)


def test_a_loss_within_chance_says_nothing_of_an_effect():
    # pieces that do not agree, as on a log of 6 s of the geared pendulum
    assert validation_gain(np.array([-129.3, -91.6, 25.9, 13.4])) == FITTING.untried
    assert validation_gain(np.array([20.0, 15.0, -190.0, 12.0, 18.0])) == FITTING.untried
    assert validation_gain(np.array([-20.0, -15.0, -30.0, -12.0, -18.0])) == pytest.approx(-95.0)
    assert validation_gain(np.array([20.0, 15.0, -30.0, 12.0, 18.0])) == pytest.approx(35.0)
    # what all but nothing acts on
    assert validation_gain(np.array([0.001, -0.001, 0.0])) == FITTING.untried


def test_a_trial_tells_what_the_priors_of_the_parameters_gain():
    """All of the gain is that of the rows, of the priors, and the Occam factor."""
    base, trials, _ = lacking(parse_effect("coulomb_friction:joint=1,torque=0.03"))
    one = tried(base, trials, "coulomb_friction:joint=1,torque=0.02")
    rows = 0.5 * sum(
        sign * float((m.errors[base.fit.rows] ** 2).sum()) for sign, m in ((1, base.model), (-1, one.model))
    )
    assert one.eased > 0.0  # without friction the parameters were strained
    assert one.gain == pytest.approx(rows + one.eased - one.occam, rel=1e-9)
    assert one.without_rows == one.eased - one.occam < one.gain
