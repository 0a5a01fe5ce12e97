# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Scatter of a model's scores between blocks: what noise makes of it, and what a misfit does."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from puma_sim_core.identify.fitting.dispersion import blocks, clearly_better, dispersion
from puma_sim_core.identify.settings import FITTING, SELECTION

ROWS, STEP, JOINTS = 2000, 0.01, 2


def predictor(*lengths):
    """Logs of so many innovations; the first quarter second is not fitted to."""
    stretches = [SimpleNamespace(time=STEP * np.arange(n + 1)) for n in lengths]
    settled = np.concatenate([np.arange(n) >= 25 for n in lengths])
    mechanism = SimpleNamespace(start=np.array([2.0, -1.0]), deviations=np.array([0.5, 0.1]))
    return SimpleNamespace(stretches=stretches, fit_rows=np.column_stack([settled] * JOINTS), mechanism=mechanism)


def model(seed, p=6, size=1.0):
    """Derivatives at the rows to fit, and white innovations of a size."""
    rng = np.random.default_rng(seed)
    one = predictor(ROWS)
    errors = size * rng.standard_normal((ROWS, JOINTS))
    return one, rng.standard_normal((int(one.fit_rows.sum()), p)), errors


@pytest.mark.parametrize("seed", range(8))
def test_a_true_model_has_none(seed):
    assert dispersion(*model(seed), 2) == pytest.approx(1.0, abs=0.02)


def test_noise_that_is_assumed_too_small_is_seen_by_its_square():
    one, jacobian, errors = model(3)
    found = [dispersion(one, scale * jacobian, scale * errors, 0) for scale in (4.0, 8.0)]
    assert found[1] / found[0] == pytest.approx(4.0, rel=1e-3)
    count = blocks(one).max() + 1
    uncertain = FITTING.dispersion_errors * np.sqrt(2.0 / (count * jacobian.shape[1]))
    assert found[0] * (1.0 + uncertain) == pytest.approx(16.0, rel=0.25)


def test_it_is_the_trace_by_its_definition():
    one, jacobian, errors = model(5, p=3, size=3.0)
    number, p = np.repeat(blocks(one)[:, None], JOINTS, axis=1)[one.fit_rows], 3
    e, normal, scatter, count = errors[one.fit_rows], np.zeros((p, p)), np.zeros((p, p)), blocks(one).max() + 1
    scores = [sum(e[r] * jacobian[r] for r in np.flatnonzero(number == k)) for k in range(count)]
    for row in jacobian:
        normal += np.outer(row, row)
    for score in scores:
        scatter += np.outer(score - np.mean(scores, axis=0), score - np.mean(scores, axis=0))
    inverse = np.linalg.inv(normal + np.diag([1.0, FITTING.least_precision, FITTING.least_precision]))
    effective = np.trace(inverse @ normal)
    wanted = np.trace(inverse @ scatter) / effective * count / (count - 1.0)
    wanted /= 1.0 + FITTING.dispersion_errors * np.sqrt(2.0 / (count * effective))
    assert dispersion(one, jacobian, errors, 1) == pytest.approx(wanted, rel=1e-9)


def test_a_misfit_that_pulls_parameters_another_way_in_each_block_counts():
    one, jacobian, errors = model(7, p=1)
    turn = np.where(blocks(one) % 2, 1.0, -1.0)
    column = np.zeros_like(errors)
    column[one.fit_rows] = jacobian[:, 0]
    lacks = errors + 0.5 * turn[:, None] * column
    assert dispersion(one, jacobian, lacks, 0) > 10.0
    # the same misfit from row to row is noise
    mixed = errors + 0.5 * np.random.default_rng(1).choice([-1.0, 1.0], (ROWS, 1)) * column
    assert dispersion(one, jacobian, mixed, 0) < 2.0


def test_blocks_end_with_their_log_and_last_as_long_as_said():
    lengths = (830, 400, 90)
    number = blocks(predictor(*lengths))
    logs = np.repeat([0, 1, 2], lengths)
    assert all(len(set(logs[number == k])) == 1 for k in range(number.max() + 1))
    assert [len(set(number[logs == k])) for k in range(3)] == [10, 5, 1]


def test_few_blocks_show_no_scatter():
    one = predictor(200)
    jacobian, errors = np.ones((int(one.fit_rows.sum()), 1)), 100.0 * np.ones((200, JOINTS))
    assert dispersion(one, jacobian, errors, 0) == 1.0


def fitted(one, errors, strained=(0.0, 0.0)):
    """A model with these innovations, its parameters so many standard deviations from their start."""
    m = one.mechanism
    objective = 0.5 * float((errors[one.fit_rows] ** 2).sum() + np.dot(strained, strained))
    point = SimpleNamespace(theta=m.start + m.deviations * np.asarray(strained))
    return SimpleNamespace(errors=errors, objective=objective, point=point)


def better_by(errors, away, strained=(0.0, 0.0)):
    """Whether a model with these innovations is clearly better than one that adds some to them, and has parameters so
    far from their start."""
    one = predictor(ROWS)
    return clearly_better(one, fitted(one, errors), fitted(one, errors + away, strained))


def test_of_true_models_two_standard_errors_are_those_of_the_log_likelihood_ratio():
    """A model that is off by w in a true one's innovations is worse by w'w/2 + w'e, of standard error |w|."""
    one, found = predictor(ROWS), 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        errors, away = rng.standard_normal((2, ROWS, JOINTS))
        away[~one.fit_rows] = 0.0
        away *= 2.0 * SELECTION.standard_errors / np.linalg.norm(away)
        found += better_by(errors, away)
    # the difference lies at twice its standard error: chance decides, less where blocks scatter more than noise
    assert 0.3 < found / 300 < 0.55


def test_a_difference_that_turns_with_what_the_better_model_lacks_is_no_clear_one():
    rng = np.random.default_rng(6)
    errors, away = rng.standard_normal((2, ROWS, JOINTS))
    away *= 6.0 / np.linalg.norm(away)
    assert better_by(errors, away)
    # the same mean, and blocks of which half would have the other model, half more than this one
    turn = np.where(blocks(predictor(ROWS)) % 2, 1.0, -1.0)[:, None]
    assert not better_by(errors + 3.0 * turn * away / np.abs(away).max(), away)


def test_rows_that_are_not_fitted_to_do_not_count():
    one, away = predictor(ROWS), np.zeros((ROWS, JOINTS))
    away[~one.fit_rows.any(axis=1)] = 100.0
    assert not better_by(np.zeros((ROWS, JOINTS)), away)


def test_a_model_that_fits_as_well_by_parameters_far_from_their_start_is_worse():
    """Seen with friction that differs by direction: one level fitted as well with a link 8 deviations heavier."""
    errors, away = np.random.default_rng(9).standard_normal((2, ROWS, JOINTS))
    away *= 1.0 / np.linalg.norm(away)
    assert not better_by(errors, away)
    # in a true model a difference is two standard errors from 8 nat on, wherever it is
    assert better_by(errors, away, (4.5, 0.0)) and not better_by(errors, away, (3.0, 0.0))
