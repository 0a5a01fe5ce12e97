# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stage 12: which effects make the readings of both sides of a transmission differ.

Effects are added one at a time, the one with the most evidence first. One is named where its evidence is beyond what
a name needs, what is left does not give it by chance, its sign is possible, and the rows of blocks that it was not
fitted to are predicted better. See `evidence` for the noise and `terms` for the effects.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from puma_sim_core.identify.arrays import Floats, Ints
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.link_side import terms
from puma_sim_core.identify.link_side.evidence import NoiseGrid, Posterior
from puma_sim_core.identify.link_side.sides import Sides, sides
from puma_sim_core.identify.link_side.terms import Term
from puma_sim_core.identify.result import LinkEffect, LinkSide
from puma_sim_core.identify.screening.surrogates import level
from puma_sim_core.identify.settings import FITTING, LINK_SIDE, SCREENING, SELECTION
from puma_sim_core.plant.mechanism import Mechanism


def compare(logs: Sequence[Log], mechanism: Mechanism, seed: int) -> tuple[LinkSide, ...]:
    """What is found on the link's side of each joint that has a sensor there and moves.

    logs : parts of logs without rows that cannot be used; seed : of the placebos.
    """
    both = sides(logs, mechanism) if any(mechanism.link_sensors) else None
    if both is None:
        return ()
    noise, found = NoiseGrid(both), list[LinkSide]()
    for joint, sensor in enumerate(mechanism.link_sensors):
        sensed = all(log.link_position is not None and np.isfinite(log.link_position[:, joint]).all() for log in logs)
        if sensor is not None and sensed and np.ptp(both.motor[:, joint]) > 10.0 * sensor.resolution:
            # of the difference of two rounded readings
            least = sensor.resolution / np.sqrt(6.0)
            found.append(_Joint(both, noise, mechanism, joint, least).explained(seed))
    return tuple(found)


@dataclass(frozen=True)
class _Fit:
    """Effects with the posterior of their model: coefficients of what is always fitted, then of the effects."""

    terms: tuple[Term, ...]
    posterior: Posterior

    def coefficient(self, number: int) -> tuple[float, float]:
        """Mean and deviation of the coefficient of an effect."""
        at = len(self.posterior.mean) - len(self.terms) + number
        return float(self.posterior.mean[at]), float(np.sqrt(max(self.posterior.covariance[at, at], 0.0)))

    def possible(self, number: int) -> bool:
        """Whether the coefficient of an effect has a sign that it may have."""
        term, mean = self.terms[number], self.coefficient(number)[0]
        return bool(mean < 0.0) if term.law == "delay" and term.sensor == terms.MOTOR else mean > 0.0


class _Joint:
    """The comparison of one joint; least : deviation that its sensors' steps alone leave [rad or m]."""

    def __init__(self, both: Sides, noise: NoiseGrid, mechanism: Mechanism, joint: int, least: float):
        self.both, self.noise, self.mechanism, self.joint, self.least = both, noise, mechanism, joint, least
        self.always, self.prior = terms.always(both, joint, mechanism)
        self.y = both.difference[:, joint]
        # one grid of deviations for all models: their evidence is compared
        self.deviations = noise.deviations(self.y - self._plain(self.y), least)

    def explained(self, seed: int) -> LinkSide:
        """The effects of the joint, the strongest first, with their errors."""
        base = fit = self.fit(())
        for _ in range(LINK_SIDE.most_effects):
            tried = sorted(self.trials(fit), key=lambda trial: -trial.posterior.log_evidence)
            better = next((trial for trial in tried if self.named(fit, trial, seed)), None)
            if better is None:
                break
            fit = better
        named = []
        for n, term in enumerate(fit.terms):
            less = self.fit(fit.terms[:n] + fit.terms[n + 1 :])
            gain = fit.posterior.log_evidence - less.posterior.log_evidence
            own = terms.sizes(term, *fit.coefficient(n), self.mechanism)
            named.append(LinkEffect(term.name, term.sensor, term.law, own, float(gain), self._alike(fit, n)))
        before, after = (self.errors(each) for each in (base, fit))
        return LinkSide(
            self.joint + 1,
            tuple(sorted(named, key=lambda each: -each.evidence)),
            float(np.sqrt(np.mean(self.residual(base) ** 2))),
            float(np.sqrt(np.mean(self.residual(fit) ** 2))),
            float(np.sqrt(np.mean(before))),
            float(np.sqrt(np.mean(after))),
            self.least,
        )

    def fit(self, chosen: tuple[Term, ...]) -> _Fit:
        """A model with effects; a delay is made linear about the time that it is found at."""
        found = self._linear(chosen)
        for _ in range(LINK_SIDE.rounds):
            at = next((n for n, term in enumerate(found.terms) if term.law == "delay"), None)
            if at is None:
                break
            time = found.coefficient(at)[0]
            moved = terms.delay(self.both, self.joint, float(np.clip(time, -LINK_SIDE.latest, LINK_SIDE.latest)))
            found = self._linear((*found.terms[:at], moved, *found.terms[at + 1 :]))
        return found

    def _linear(self, chosen: tuple[Term, ...]) -> _Fit:
        X, prior, y = self._model(chosen)
        (posterior,) = self.noise.posteriors(y[:, None], X, prior, self.deviations)
        return _Fit(chosen, posterior)

    def _model(self, chosen: tuple[Term, ...]) -> tuple[Floats, Floats, Floats]:
        """Columns (m, k), deviations (k,), and rows (m,) of a model."""
        X = np.column_stack([self.always, *(term.column for term in chosen)])
        prior = np.array([*self.prior, *(term.deviation for term in chosen)])
        return X, prior, self.y - sum(term.shift for term in chosen)

    def trials(self, fit: _Fit) -> Iterator[_Fit]:
        """Models with one effect more: of a late reading both laws."""
        names = {term.name for term in fit.terms}
        if terms.LAG not in names:
            late = self.fit((*fit.terms, terms.delay(self.both, self.joint, 0.0)))
            sensor = next(term.sensor for term in late.terms if term.law == "delay")
            yield late
            yield self.fit((*fit.terms, terms.lag(self.both, self.joint, sensor or terms.LINK)))
        for term in self.transmission:
            if term.name not in names:
                yield self.fit((*fit.terms, term))

    @cached_property
    def transmission(self) -> list[Term]:
        """Effects of the transmission whose action is not that of what is always fitted."""
        found = terms.transmission(self.both, self.joint, self.mechanism)
        least = LINK_SIDE.least_row_share
        return [t for t in found if np.std(t.column - self._plain(t.column)) > least * np.std(t.column)]

    def _plain(self, values: Floats) -> Floats:
        """(m,) what is always fitted of some rows, by least squares."""
        return self.always @ np.linalg.lstsq(self.always, values, rcond=None)[0]

    def named(self, fit: _Fit, trial: _Fit, seed: int) -> bool:
        """Whether the last effect of a trial may be named."""
        gain = trial.posterior.log_evidence - fit.posterior.log_evidence
        if not (trial.possible(len(trial.terms) - 1) and gain >= SELECTION.least_gain):
            return False
        if gain < self.chance(trial, seed):
            return False
        change = self.errors(trial) - self.errors(fit)
        spread = float(np.std(change, ddof=1)) / np.sqrt(len(change))
        return bool(change.mean() < SELECTION.standard_errors * spread)

    def chance(self, trial: _Fit, seed: int) -> float:
        """The gain [nat] that chance gives the last effect of a trial (`surrogates.level`): by what the trial leaves,
        shifted in each log."""
        left, term = self.residual(trial), trial.terms[-1]
        rng = np.random.default_rng(seed)
        low, high = SELECTION.placebo_shifts
        shifted = np.empty((len(left), SELECTION.placebos))
        for n, share in enumerate(rng.uniform(low, high, SELECTION.placebos).tolist()):
            for segment in np.unique(self.both.segment):
                rows = np.flatnonzero(self.both.segment == segment)
                shifted[rows, n] = np.roll(left[rows], int(share * len(rows)))
        X = np.column_stack([self.always, term.column])
        prior = np.array([*self.prior, term.deviation])
        with_it = self.noise.posteriors(shifted, X, prior, self.deviations)
        without = self.noise.posteriors(shifted, self.always, self.prior, self.deviations)
        return level(np.array([a.log_evidence - b.log_evidence for a, b in zip(with_it, without)]))

    def residual(self, fit: _Fit) -> Floats:
        """(m,) what a model leaves of the difference [rad or m]."""
        X, _, y = self._model(fit.terms)
        return y - X @ fit.posterior.mean

    def errors(self, fit: _Fit) -> Floats:
        """(K,) mean squares of the difference in the rows of each fold, by coefficients of the other folds."""
        X, prior, y = self._model(fit.terms)
        first = {s: self.both.time[self.both.segment == s][0] for s in np.unique(self.both.segment).tolist()}
        begin = np.array([first[s] for s in self.both.segment.tolist()])
        block = ((self.both.time - begin) / SCREENING.residual_validation_block).astype(int) % LINK_SIDE.folds
        squares = []
        for fold in range(LINK_SIDE.folds):
            inside = block == fold
            if inside.any() and not inside.all():
                rows: Ints = np.flatnonzero(~inside)
                white = self.noise.whitener(fit.posterior.noise, rows)(np.column_stack([X, y]))
                A, b = white[:, :-1] * prior / fit.posterior.deviation, white[:, -1] / fit.posterior.deviation
                own = prior * np.linalg.solve(A.T @ A + np.eye(len(prior)), A.T @ b)
                squares.append(float(np.mean((y[inside] - X[inside] @ own) ** 2)))
        return np.array(squares)

    def _alike(self, fit: _Fit, number: int) -> bool:
        """Whether the other law of a late reading has the same evidence."""
        term = fit.terms[number]
        if term.name != terms.LAG:
            return False
        other = terms.delay(self.both, self.joint, 0.0) if term.law == "lag" else None
        other = other or terms.lag(self.both, self.joint, term.sensor or terms.LINK)
        tried = self.fit((*fit.terms[:number], other, *fit.terms[number + 1 :]))
        return abs(tried.posterior.log_evidence - fit.posterior.log_evidence) < FITTING.tie
