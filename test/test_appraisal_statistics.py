# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Statistics of scores: values by hand and by SciPy, and intervals that hold as often as they say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest, trim_mean, ttest_rel

from puma_sim_core.appraisal.statistics import (
    compare,
    failure_share,
    paired_change,
    score,
    sensitivity,
    summaries,
    trials_needed,
)
from puma_sim_core.errors import ParameterError


def test_a_score_is_one_half_at_the_limit():
    assert [score(v, 2.0) for v in (0.0, 2.0, 6.0, math.inf)] == [1.0, 0.5, 0.25, 0.0]
    assert [score(v, 2.0, smaller_is_better=False) for v in (0.0, 2.0, 6.0, math.inf)] == [0.0, 0.5, 0.75, 1.0]
    for value, limit in ((-1.0, 1.0), (math.nan, 1.0), (1.0, 0.0), (1.0, math.inf)):
        with pytest.raises(ParameterError, match="expected 0 or more, and a positive number"):
            score(value, limit)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=4, max_size=40).filter(lambda x: len(x) % 4 == 0))
def test_the_interquartile_mean_is_scipys_trimmed_mean(values):
    (found,) = summaries(np.array(values)[:, None], ["all"] * len(values), resamples=100)
    assert found.value == pytest.approx(trim_mean(values, 0.25), abs=1e-12)
    assert found.low <= found.value <= found.high


def test_parts_of_trials_count_by_their_share():
    # of five, 20 % each, the middle half has 15 % of the second, 20 % of the third, 15 % of the fourth
    (found,) = summaries(np.array([[10.0], [0.0], [4.0], [1.0], [3.0]]), ["all"] * 5, resamples=100)
    assert found.value == pytest.approx((0.15 * 1.0 + 0.2 * 3.0 + 0.15 * 4.0) / 0.5, abs=1e-12)


def test_strata_have_equal_weights_and_single_trials_no_spread():
    # a stratum of four at 1 counts no more than one of a single trial at 0, and one at 2
    scores, strata = np.array([[1.0], [1.0], [1.0], [1.0], [0.0], [2.0]]), ["a"] * 4 + ["b", "c"]
    (found,) = summaries(scores, strata)
    # from 25 to 33 % it is 0, to 67 % it is 1, to 75 % it is 2
    assert found == pytest.approx((1.0, 1.0, 1.0), abs=1e-12)


@pytest.mark.parametrize("failures, trials", [(0, 10), (10, 10), (3, 20), (1, 400)])
def test_failure_shares_have_the_exact_interval(failures, trials):
    found, exact = failure_share(failures, trials), binomtest(failures, trials).proportion_ci(method="exact")
    assert found == pytest.approx((failures / trials, exact.low, exact.high), abs=1e-12)


def test_no_failure_of_ten_leaves_31_per_cent():
    assert failure_share(0, 10).high == pytest.approx(1.0 - 0.025**0.1, abs=1e-12)


def battery(rng, strata, draws, shifts, bound=1.2):
    """Scores of controllers that are worse by `shifts`, with tasks of unlike difficulty and scatter; what is beyond
    the bound failed, a tenth by default."""
    fixed = np.random.default_rng(7)
    level, spread = fixed.normal(0.0, 1.0, strata), fixed.uniform(0.1, 1.0, strata)
    own = fixed.uniform(0.05, 0.5, strata)
    response = 1.0 + fixed.normal(0.0, 0.3, (strata, 1, len(shifts)))
    common = rng.normal(size=(strata, draws, 1)) * spread[:, None, None]
    noise = rng.normal(size=(strata, draws, len(shifts))) * own[:, None, None]
    worse = level[:, None, None] + common + np.asarray(shifts) * response + noise
    scores = np.where(worse > bound, 0.0, 1.0 / (1.0 + np.exp(worse)))
    return scores.reshape(-1, len(shifts)), np.repeat(np.arange(strata), draws).tolist()


def test_intervals_hold_the_true_difference_as_often_as_they_say():
    many, _ = battery(np.random.default_rng(1), 12, 40000, (0.0, 0.3))
    first, second = (trim_mean(column, 0.25) for column in many.T)
    batteries, held, alone = 500, 0, 0
    for k in range(batteries):
        scores, strata = battery(np.random.default_rng(1000 + k), 12, 5, (0.0, 0.3))
        found = compare(scores, strata, seed=k, resamples=300)
        held += found.low[0, 1] <= first - second <= found.high[0, 1]
        one = summaries(scores[:, :1], strata, seed=k, resamples=300)[0]
        alone += one.low <= first <= one.high
    assert 0.93 <= held / batteries <= 0.97
    assert 0.93 <= alone / batteries <= 0.97


def test_intervals_hold_where_a_quarter_of_the_trials_fail():
    """The interquartile mean has a kink there: beyond it, it sees the failures."""
    many, _ = battery(np.random.default_rng(1), 40, 12000, (0.0, 0.4), 0.6)
    assert 0.15 < (many[:, 0] == 0.0).mean() < 0.25 < (many[:, 1] == 0.0).mean() < 0.35
    first, second = (trim_mean(column, 0.25) for column in many.T)
    batteries, held = 500, 0
    for k in range(batteries):
        found = compare(*battery(np.random.default_rng(1000 + k), 40, 3, (0.0, 0.4), 0.6), seed=k, resamples=300)
        held += found.low[0, 1] <= first - second <= found.high[0, 1]
    assert 0.93 <= held / batteries <= 0.97


@pytest.mark.parametrize("controllers", [2, 4])
def test_equal_controllers_are_seldom_ranked(controllers):
    batteries, ranked = 300, 0
    for k in range(batteries):
        scores, strata = battery(np.random.default_rng(5000 + k), 12, 5, (0.0,) * controllers)
        ranked += (compare(scores, strata, seed=k, resamples=300).rank > 1).any()
    assert ranked / batteries <= 0.05


def test_ranks_with_ties():
    scores, strata = battery(np.random.default_rng(3), 12, 6, (0.0, 0.0, 1.0, 2.0))
    found = compare(scores, strata)
    assert found.rank.tolist() == [1, 1, 3, 4]
    np.testing.assert_array_equal(found.difference, -found.difference.T)
    np.testing.assert_array_equal(found.low, -found.high.T)
    assert (found.low <= found.difference).all() and (found.difference <= found.high).all()


def test_the_same_controller_twice_is_a_tie_and_what_is_not_drawn_is_certain():
    scores, strata = battery(np.random.default_rng(3), 6, 4, (0.0,))
    twice = compare(np.hstack([scores, scores]), strata)
    assert twice.rank.tolist() == [1, 1] and not twice.low.any() and not twice.high.any()
    # nominal trials alone: nothing is drawn, a difference is a difference
    nominal = compare([[0.5, 0.4], [0.7, 0.6], [0.6, 0.5]], ["a", "b", "c"])
    assert nominal.rank.tolist() == [1, 2]
    np.testing.assert_allclose(nominal.high - nominal.low, 0.0, atol=1e-12)


def test_the_same_seed_gives_the_same_bytes():
    scores, strata = battery(np.random.default_rng(3), 5, 4, (0.0, 0.2, 0.4))
    first, again, other = (compare(scores, strata, seed=seed) for seed in (1, 1, 2))
    for a, b in zip(first, again):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(first.low, other.low)
    # which trials are given first does not matter to the estimate
    order = np.random.default_rng(0).permutation(len(scores))
    shuffled = compare(scores[order], [strata[k] for k in order], seed=1)
    np.testing.assert_allclose(shuffled.difference, first.difference, atol=1e-15)


def test_the_cost_of_an_effect_is_the_slope_through_the_nominal_score():
    size = np.repeat([1.0, 2.0, 3.0], 4)
    strata = [f"size {s}" for s in size]
    rng = np.random.default_rng(2)
    nominal = rng.uniform(0.5, 0.9, 12)
    exact = sensitivity(nominal, nominal - 0.07 * size, size, strata)
    assert exact == pytest.approx((0.07, 0.07, 0.07), abs=1e-12)
    lost = 0.07 * size + 0.01 * rng.normal(size=12)
    found = sensitivity(nominal, nominal - lost, size, strata)
    assert found.value == pytest.approx((lost @ size) / (size @ size), abs=1e-12)
    assert found.low < 0.07 < found.high and found.high - found.low < 0.02
    with pytest.raises(ParameterError, match="one in each stratum, and not all zero"):
        sensitivity(nominal, nominal, size, ["all"] * 12)


def test_the_change_of_a_measure_has_the_interval_of_the_paired_t_test():
    before, after = np.random.default_rng(5).normal(size=(2, 6))
    found, exact = paired_change(before, after), ttest_rel(after, before).confidence_interval(0.95)
    assert found == pytest.approx((np.mean(after - before), exact.low, exact.high), abs=1e-12)
    assert paired_change([1.0], [3.0]) == (2.0, 2.0, 2.0)


def test_as_many_trials_as_are_said_to_be_needed_see_the_difference():
    pilot, strata = battery(np.random.default_rng(11), 12, 40, (0.0, 0.1))
    many, _ = battery(np.random.default_rng(1), 12, 40000, (0.0, 0.1))
    means = [trim_mean(column, 0.25) for column in many.T]
    share = abs(means[0] - means[1]) / np.mean(means)
    needed = trials_needed(pilot, strata, share)
    assert needed.trials == 12 * needed.draws
    seen, batteries = 0, 120
    for k in range(batteries):
        found = compare(*battery(np.random.default_rng(9000 + k), 12, needed.draws, (0.0, 0.1)), seed=k, resamples=200)
        seen += found.low[0, 1] > 0.0 or found.high[0, 1] < 0.0
    # 80 %, give or take what 120 batteries and a pilot allow
    assert 0.70 <= seen / batteries <= 0.90
    assert trials_needed(pilot, strata, share / 2).draws > 3 * needed.draws
    assert trials_needed([[0.5, 0.4], [0.6, 0.6]], ["a", "b"]) == (1, 2)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: summaries([[0.5], [0.6]], ["a"]), "2 trials of 1 strata; expected a stratum for each trial"),
        (lambda: summaries(np.empty((0, 2)), []), "0 trials of 0 strata"),
        (lambda: summaries([[math.nan], [0.6]], ["a", "a"]), "not finite"),
        (lambda: compare([0.5, 0.6], ["a", "a"]), "shape"),
        (lambda: compare([[0.5, 0.6]], ["a"], resamples=10), "resamples"),
        (lambda: failure_share(3, 2), "failures"),
        (lambda: failure_share(0, 0), "trials"),
        (lambda: failure_share(1, 2, level=1.0), "level"),
        (lambda: trials_needed([[0.0, 0.0], [0.0, 0.0]], ["a", "a"]), "a positive difference"),
        (lambda: trials_needed([[0.5, 0.4], [0.6, 0.6]], ["a", "a"], power=0.4), "power"),
    ],
)
def test_what_cannot_be_told_is_named(call, message):
    with pytest.raises(ParameterError, match=message):
        call()
