# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What scores of trials say about controllers, and how surely.

Scores are (n, C): n trials, C controllers, each trial the same draw for all of them. Trials come in strata (a task with
a perturbation), whose draws are independent; the strata are a fixed list. Every stratum has the same weight, however
many draws it has. A stratum of one trial counts as known exactly: a trial in which nothing is drawn.

Intervals are those of the studentised bootstrap, which the plain percentile bootstrap is no match for with the few
draws that a stratum has: measured in docs/appraisal_statistics.md, with the equations and their sources.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from math import ceil, inf, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv, ndtri, stdtrit

from puma_sim_core.checks import check_shapes, check_whole
from puma_sim_core.errors import ParameterError

#: level of intervals; 1 - LEVEL is the chance at most that any two of several equal controllers are ranked
LEVEL = 0.95
#: resamples; their number blurs the level by sqrt(0.95 0.05 / 2000), half a per cent
RESAMPLES = 2000
#: share of the trials that the interquartile mean leaves out at either end
_CUT = 0.25
#: least standard error of a resample, as a share of the sample's: of few trials some are drawn without any spread
_LEAST_ERROR = 0.25
#: which of B resamples a quantile p is: number p (B + 1), with which an interval has its level whatever B is
_RANK: Final = "weibull"
#: numbers held at once while resampling
_AT_ONCE = 2_000_000
_WHERE = "appraisal statistics"


class Interval(NamedTuple):
    """An estimate and its interval."""

    value: float
    low: float
    high: float


def score(value: float, limit: float, smaller_is_better: bool = True) -> float:
    """Score of a measure, 0 to 1: limit / (limit + value), which is 1 at 0, 1/2 at the limit and 0 for a failed trial.

    value, limit : at least 0, positive. Of a measure that is better when larger, value / (limit + value).
    Raises ParameterError on others.
    """
    if not (value >= 0.0 and 0.0 < limit < inf):
        what = f"value {value!r}, limit {limit!r}"
        raise ParameterError(what, where="score", expected="0 or more, and a positive number")
    good = limit / (limit + value)
    return good if smaller_is_better else 1.0 - good


def failure_share(failures: int, trials: int, level: float = LEVEL) -> Interval:
    """Share of trials that fail, with the interval of Clopper and Pearson (Biometrika 26 (1934): 404-413).

    Raises ParameterError: more failures than trials, no trials, a level outside 0 to 1.
    """
    check_whole(trials, "trials", 1, where=_WHERE)
    check_whole(failures, "failures", 0, trials, _WHERE)
    if not 0.0 < level < 1.0:
        raise ParameterError(f"level {level!r}", where=_WHERE, expected="between 0 and 1")
    tail = 0.5 * (1.0 - level)
    low = float(betaincinv(failures, trials - failures + 1, tail)) if failures else 0.0
    high = float(betaincinv(failures + 1, trials - failures, 1.0 - tail)) if failures < trials else 1.0
    return Interval(failures / trials, low, high)


class _Trials:
    """Values (n, C) of trials, put in order of the strata that they belong to.

    weight (n,) : of each trial, 1/H of each of the H strata; spread (n,) : what its squared distance from its stratum's
    mean counts in the variance of a weighted mean, 0 in a stratum of one.
    """

    def __init__(self, values: ArrayLike, strata: Sequence[Hashable], columns: str = "c"):
        (found,) = check_shapes(f"(n, {columns})", _WHERE, values=values)
        labels = list(strata)
        if len(labels) != len(found) or not labels:
            what = f"{len(found)} trials of {len(labels)} strata"
            raise ParameterError(what, where=_WHERE, expected="a stratum for each trial, one trial at least")
        number = {label: k for k, label in enumerate(dict.fromkeys(labels))}
        stratum = np.array([number[label] for label in labels])
        #: places of the trials as given
        self.order = np.argsort(stratum, kind="stable")
        self.stratum, self.values = stratum[self.order], found[self.order]
        self.sizes = np.bincount(self.stratum)
        self.starts = np.concatenate([[0], np.cumsum(self.sizes)[:-1]])
        H, size = len(self.sizes), self.sizes[self.stratum].astype(float)
        self.weight = 1.0 / (H * size)
        self.spread = np.where(size > 1.0, 1.0 / (H * H * size * np.maximum(size - 1.0, 1.0)), 0.0)
        self.columns = [np.argsort(column, kind="stable") for column in self.values.T]

    def resampled(self, seed: int, count: int) -> Iterator[np.ndarray]:
        """Blocks (b, n) of how often each trial is drawn: from each stratum as many as it has."""
        check_whole(count, "resamples", 100, where=_WHERE)
        rng = np.random.default_rng(seed)
        rows = max(1, _AT_ONCE // self.values.size)
        for first in range(0, count, rows):
            b = min(rows, count - first)
            parts = [rng.multinomial(n, np.full(n, 1.0 / n), size=b) for n in self.sizes]
            yield np.concatenate(parts, axis=1).astype(float)

    def interquartile(self, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Interquartile means (b, C) of resamples (b, n), and the influences (b, n, C) of the trials on them.

        An influence is clipped at the quartiles. Which trials those are is known but for the standard error of a
        share: they are taken that much further out. Where scores have a gap, as between failed trials at 0 and the
        others, a quartile that lies beside it in the sample may lie beyond it in truth, where the influence differs.
        """
        out = _CUT - sqrt(_CUT * (1.0 - _CUT) * float((self.weight**2).sum()))
        last = len(self.values) - 1
        means = np.empty((len(drawn), len(self.columns)))
        influence = np.empty((*drawn.shape, len(self.columns)))
        for c, order in enumerate(self.columns):
            x = self.values[order, c]
            share = np.cumsum((drawn * self.weight)[:, order], axis=1)
            inside = np.clip(share, _CUT, 1.0 - _CUT)
            means[:, c] = np.diff(inside, axis=1, prepend=_CUT) @ x / (1.0 - 2.0 * _CUT)
            # a quartile that rounding puts a hair beyond a trial is that trial
            places = ((share < p - 1e-12).sum(axis=1) for p in (out, 1.0 - out))
            low, high = (x[np.minimum(place, last)][:, None] for place in places)
            influence[:, :, c] = np.clip(self.values[:, c], low, high) / (1.0 - 2.0 * _CUT)
        return means, influence

    def mean(self, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weighted means (b, C) of resamples (b, n), and the influences of the trials: their values."""
        return (drawn * self.weight) @ self.values, np.broadcast_to(self.values, (*drawn.shape, self.values.shape[1]))

    def covariance(self, drawn: np.ndarray, influence: np.ndarray) -> np.ndarray:
        """(b, C, C) covariance of weighted means of influences (b, n, C), from their scatter in each stratum."""
        sums = np.add.reduceat(drawn[:, :, None] * influence, self.starts, axis=1)
        off = influence - (sums / self.sizes[:, None])[:, self.stratum]
        return np.swapaxes(off * (drawn * self.spread)[:, :, None], 1, 2) @ off


Estimate = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def _studentised(
    trials: _Trials, estimate: Estimate, contrasts: np.ndarray, seed: int, resamples: int, together: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Values (k,) of contrasts (k, C) of estimates, and half-widths (k,) of their intervals.

    together : the intervals hold all at once, else each by itself.
    """

    def of(drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, influence = estimate(drawn)
        covariance = trials.covariance(drawn, influence)
        return values @ contrasts.T, np.sqrt(
            np.maximum(np.einsum("kc,bcd,kd->bk", contrasts, covariance, contrasts), 0.0)
        )

    (value,), (error,) = of(np.ones((1, len(trials.values))))
    ratios = []
    for drawn in trials.resampled(seed, resamples):
        values, errors = of(drawn)
        least = np.maximum(errors, _LEAST_ERROR * error)
        away = np.abs(values - value)
        ratios.append(np.where(error > 0.0, away / np.where(least > 0.0, least, 1.0), 0.0))
    every = np.concatenate(ratios)
    if together:
        return value, error * np.quantile(every.max(axis=1), LEVEL, method=_RANK)
    return value, error * np.quantile(every, LEVEL, axis=0, method=_RANK)


def summaries(
    scores: ArrayLike, strata: Sequence[Hashable], *, seed: int = 0, resamples: int = RESAMPLES
) -> list[Interval]:
    """Interquartile mean of each controller's scores (n, C), each with its own interval.

    strata : (n,) labels. Raises ParameterError: no trials, other shapes, scores that are not finite.
    """
    trials = _Trials(scores, strata)
    C = trials.values.shape[1]
    value, half = _studentised(trials, trials.interquartile, np.eye(C), seed, resamples, together=False)
    return [Interval(v, v - w, v + w) for v, w in zip(value.tolist(), half.tolist())]


class Comparison(NamedTuple):
    """Controllers compared in pairs, on the same draws.

    difference, low, high : (C, C) interquartile mean of the first less that of the second, with intervals that hold
    for all pairs at once. rank (C,) : 1 and as many as are better by an interval that excludes zero; ties share a rank.
    """

    difference: np.ndarray
    low: np.ndarray
    high: np.ndarray
    rank: np.ndarray


def compare(scores: ArrayLike, strata: Sequence[Hashable], *, seed: int = 0, resamples: int = RESAMPLES) -> Comparison:
    """Differences of the interquartile means of scores (n, C), and the ranks that they allow.

    Arguments and errors of `summaries`. Of equal controllers any two are ranked in at most 1 - LEVEL of all batteries.
    """
    trials = _Trials(scores, strata)
    C = trials.values.shape[1]
    first, second = np.triu_indices(C, 1)
    difference, half = np.zeros((2, C, C))
    if C > 1:
        contrasts = np.eye(C)[first] - np.eye(C)[second]
        value, width = _studentised(trials, trials.interquartile, contrasts, seed, resamples, together=True)
        difference[first, second], difference[second, first] = value, -value
        half[first, second] = half[second, first] = width
    worse = difference + half < 0.0
    return Comparison(difference, difference - half, difference + half, 1 + worse.sum(axis=1))


def sensitivity(
    nominal: ArrayLike,
    perturbed: ArrayLike,
    size: ArrayLike,
    strata: Sequence[Hashable],
    *,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> Interval:
    """Score that a unit of an effect's size costs: the slope of the line through the nominal scores, by least squares.

    nominal, perturbed : (n,) scores of the same draws without and with the effect; size : (n,) of the effect, the same
    within a stratum; strata : (n,) labels. Raises ParameterError on others.
    """
    before, after, sizes = check_shapes("(n,)", _WHERE, nominal=nominal, perturbed=perturbed, size=size)
    trials = _Trials(((before - after) * sizes)[:, None], strata)
    s = sizes[trials.order]
    if (s != s[trials.starts][trials.stratum]).any() or not (s != 0.0).any():
        raise ParameterError("sizes of an effect", where=_WHERE, expected="one in each stratum, and not all zero")
    trials.values /= float((trials.weight * s * s).sum())
    (value,), (half,) = _studentised(trials, trials.mean, np.eye(1), seed, resamples, together=False)
    return Interval(float(value), float(value - half), float(value + half))


def paired_change(before: ArrayLike, after: ArrayLike) -> Interval:
    """Mean of what a measure is more on the second of two models than on the first, with the interval of Student.

    before, after : (n,) of the same draws. Of one draw nothing is known but its own difference. Raises ParameterError:
    other shapes, values that are not finite.
    """
    first, second = check_shapes("(n,)", _WHERE, before=before, after=after)
    more = second - first
    n, mean = len(more), float(more.mean())
    half = float(stdtrit(n - 1, 0.5 + 0.5 * LEVEL) * more.std(ddof=1) / sqrt(n)) if n > 1 else 0.0
    return Interval(mean, mean - half, mean + half)


class Needed(NamedTuple):
    """draws : in each stratum in which anything is drawn; trials : of a controller, over all strata."""

    draws: int
    trials: int


def trials_needed(
    scores: ArrayLike, strata: Sequence[Hashable], difference: float = 0.05, power: float = 0.8
) -> Needed:
    """Trials with which a difference of two controllers would be seen.

    scores : (n, 2), of a battery that was run; difference : as a share of the mean of both interquartile means; power :
    chance that the interval then excludes zero. With v/m the variance of the difference with m draws in each stratum, m
    is the least with (t(LEVEL) + t(power))^2 v/m <= difference^2, t of Student with m - 1 degrees of freedom a stratum.

    Raises ParameterError: shapes, no score above zero, a difference that is not positive, a power outside 0.5 to 1.
    """
    trials = _Trials(scores, strata, "2")
    ones = np.ones((1, len(trials.values)))
    (means,), influence = trials.interquartile(ones)
    wanted = difference * float(means.mean())
    if not (wanted > 0.0 and 0.5 < power < 1.0):
        what = f"difference {difference!r} of a mean score of {means.mean():.4g}, power {power!r}"
        raise ParameterError(what, where=_WHERE, expected="a positive difference, and a power between 0.5 and 1")
    apart = influence[0, :, 0] - influence[0, :, 1]
    off = apart - (np.add.reduceat(apart, trials.starts) / trials.sizes)[trials.stratum]
    # with one draw in each stratum
    variance = float((trials.spread * trials.sizes[trials.stratum] * off * off).sum())
    drawn = int((trials.sizes > 1).sum())
    fixed = len(trials.sizes) - drawn
    if variance <= 1e-24:
        return Needed(1, drawn + fixed)
    draws = max(2, ceil((ndtri(0.5 + 0.5 * LEVEL) + ndtri(power)) ** 2 * variance / wanted**2))
    while True:
        freedom = drawn * (draws - 1)
        reach = float(stdtrit(freedom, 0.5 + 0.5 * LEVEL) + stdtrit(freedom, power))
        if reach * sqrt(variance / draws) <= wanted:
            return Needed(draws, draws * drawn + fixed)
        draws += 1
