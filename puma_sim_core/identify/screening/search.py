# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The screening on filtered motion, in volts (steps 2 to 5).

The parameters are retuned with the effects chosen so far, the noise is estimated on what is then
left, and every hypothesis of the library is asked for its gain of evidence. What is done with the
best ones is `selection`'s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.identify.noise import noise
from puma_sim_core.identify.screening.evidence import Bank, Base, Scored, screen
from puma_sim_core.identify.screening.problem import Linear, Problem
from puma_sim_core.identify.settings import SCREENING


@dataclass(frozen=True)
class Chosen:
    """An effect in the model: its hypothesis as scored when it entered, and its columns [V]."""

    scored: Scored
    columns: dict[int, np.ndarray]

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.scored.name

    @property
    def joint(self) -> int | None:
        """Joint (1-based), None for the whole arm."""
        return self.scored.joint

    @property
    def key(self) -> tuple:
        """(name, joint)."""
        return self.scored.name, self.scored.joint


@dataclass
class Fit:
    """The model about theta with chosen effects, in its noise."""

    problem: Problem
    linear: Linear
    chosen: tuple[Chosen, ...]
    weights: list[np.ndarray]
    base: Base
    whiteners: list

    @property
    def coefficients(self) -> np.ndarray:
        """(p + c,) posterior means: parameters less their start, then coefficients of effects."""
        mean = np.concatenate([np.zeros(len(self.linear.theta)), *[c.scored.entry.candidate.mean for c in self.chosen]])
        return mean + self.base.coefficients

    @property
    def theta(self) -> np.ndarray:
        """Parameters by this fit, within their bounds."""
        m = self.problem.mechanism
        return m.clip(m.start + self.coefficients[: len(self.linear.theta)])

    def residual(self) -> np.ndarray:
        """(m, J) residual [V] of the fitted model, at all kept rows."""
        y, columns = assemble(self.problem, self.linear, self.chosen, centred=False)
        return y - columns @ self.coefficients

    def of(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (p,) of a chosen effect and their covariance (p, p)."""
        at = len(self.linear.theta) + sum(len(c.scored.entry.candidate.mean) for c in self.chosen[:number])
        rows = slice(at, at + len(self.chosen[number].scored.entry.candidate.mean))
        return self.coefficients[rows], self.base.covariance[rows, rows]


def assemble(problem: Problem, linear: Linear, chosen, centred: bool = True):
    """y (m, J) and the nuisance columns (m, J, p): parameters about their start, then effects.

    centred : y is about the prior means of the coefficients.
    """
    step = linear.theta - problem.mechanism.start
    y = linear.residual + linear.jacobian @ step
    columns = [linear.jacobian]
    for c in chosen:
        p = len(c.scored.entry.candidate.mean)
        block = np.zeros((*y.shape, p))
        for j, values in c.columns.items():
            block[:, j, :] = values
        if centred:
            y = y - block @ c.scored.entry.candidate.mean
        columns.append(block)
    return y, np.concatenate(columns, axis=2)


class Search:
    """The screening of one problem on filtered motion."""

    def __init__(self, problem: Problem, library, progress: Callable[[str, float], None] = lambda what, share: None):
        self.problem = problem
        self.library = library
        self.progress = progress
        p = problem
        s = p.sampled
        m = p.mechanism
        drive = m.drive(m.start)
        inertia = m.inertia(m.start, s.position).mean(axis=0) + drive.motor_inertia
        most = max(rows.stop - rows.start for rows in p.stretches)
        self.sources = [
            noise.sources(
                s, float(drive.volts_per_torque[j] * inertia[j]), float(drive.emf[j]), float(drive.lag[j]), most
            )
            for j in range(s.joints)
        ]
        self.place = np.concatenate([np.arange(rows.stop - rows.start) for rows in p.stretches])
        self._whiteners: dict = {}

    # the model with given effects

    def whitener(self, joint: int, weights, held: bool = False) -> noise.Whitener:
        """The whitener of a joint's rows for weights of the noise."""
        key = (joint, held, weights.tobytes())
        if key not in self._whiteners:
            rows = (self.problem.held_rows if held else self.problem.fit_rows)(joint)
            self._whiteners[key] = noise.Whitener(
                weights @ self.sources[joint].covariances, rows, self.place[rows], self.problem.segment[rows]
            )
        return self._whiteners[key]

    def base(self, linear, chosen, weights) -> Fit:
        """The fit of parameters and chosen effects in a given noise."""
        p = self.problem
        y, columns = assemble(p, linear, chosen)
        deviation = np.concatenate([p.mechanism.deviations, *[c.scored.entry.candidate.deviation for c in chosen]])
        whiteners = [self.whitener(j, weights[j]) for j in range(y.shape[1])]
        return Fit(p, linear, tuple(chosen), weights, Base(whiteners, y, columns, deviation), whiteners)

    def noise_of(self, residual: np.ndarray, white_only: bool = False) -> list[np.ndarray]:
        """Weights of the noise of each joint for a residual (m, J) [V] at all kept rows."""
        p = self.problem
        result = []
        for j in range(residual.shape[1]):
            usable = np.zeros(len(p.kept), dtype=bool)
            usable[p.fit_rows(j)] = True
            budget = noise.least_weights(p.sampled, j, len(self.sources[j].spectra))
            result.append(
                noise.fit_weights(self.sources[j], p.sampled, residual[:, j], usable, p.stretches, budget, white_only)
            )
        return result

    def settle(self, linear, chosen, weights=None, rounds: int = 2) -> Fit:
        """Fit and noise in turn, from given weights or from below.

        A fit in the noise of a residual that still holds an effect would leave the effect in the
        residual, and stay there. So the first noise is the least that the residual allows.
        """
        if weights is None:
            weights = self.noise_of(linear.residual, white_only=True)
        fit = self.base(linear, chosen, weights)
        for _ in range(rounds):
            fit = self.base(linear, chosen, self.noise_of(fit.residual()))
        return fit

    def retune(self, theta, chosen=()) -> Fit:
        """Parameters by maximum a posteriori: linearised again until they stay."""
        fit = None
        for _ in range(SCREENING.search_retunings):
            linear = self.problem.linear(theta)
            fit = self.settle(linear, chosen, None if fit is None else fit.weights, 2 if fit is None else 1)
            step = np.abs(fit.theta - theta) / self.problem.mechanism.deviations
            theta = fit.theta
            if step.max() < 0.05:
                break
        return fit

    def bank(self, theta) -> Bank:
        """Columns of the hypotheses of the library about theta, without the fast ones."""
        p, m = self.problem, self.problem.mechanism
        signals = replace(p.signals(theta), residual=p.full_residual(theta))
        bank = Bank(p.sampled.joints)
        known = {(e.kind.name, e.joint) for e in m.effects}
        jobs = [
            (name, kind, j)
            for name, kind in self.library.items()
            if not kind.screening.fast
            for j in ([None] if not kind.per_joint else range(p.sampled.joints))
            if (name, None if j is None else j + 1) not in known
        ]
        for number, (name, kind, j) in enumerate(jobs):
            self.progress("screening", 0.05 + 0.15 * number / len(jobs))
            bank.add(
                name,
                None if j is None else j + 1,
                kind.screening.candidates(signals, j),
                lambda c: p.reduce(c, signals),
            )
        bank.freeze()
        return bank

    # selection

    def choose(self, scored: Scored, bank: Bank) -> Chosen:
        """A hypothesis with its best candidate as part of the model."""
        return Chosen(scored, bank.columns_of(scored.entry))

    def stage(self, linear, chosen, bank) -> Stage:
        """One screening with the noise of the best explanation; see `Stage`."""
        fit = self.settle(linear, chosen, rounds=0)
        scores = self.ranked(fit, bank)
        best = None
        for _ in range(4):
            legal = [s for s in scores if s.values is not None]
            if not legal:
                return Stage(fit, scores, None, None)
            again = legal[0]
            if best is not None and again.name == best.name and again.joint == best.joint and again.entry is best.entry:
                break
            best = again
            with_best = self.settle(linear, (*chosen, self.choose(best, bank)))
            fit = self.base(linear, chosen, with_best.weights)
            scores = self.ranked(fit, bank)
        best = next((s for s in scores if s.values is not None), best)
        with_best = self.base(linear, (*chosen, self.choose(best, bank)), fit.weights)
        return Stage(fit, scores, best, with_best)

    def ranked(self, fit: Fit, bank: Bank) -> list[Scored]:
        """Scores of all hypotheses that are not in the model yet, best first."""
        taken = {c.key for c in fit.chosen}
        scores = [s for s in screen(fit.base, fit.base.whiten(bank)) if (s.name, s.joint) not in taken]
        return sorted(scores, key=lambda s: -s.gain)


@dataclass
class Stage:
    """What one screening found: the base fit in the noise of the best explanation, scores best
    first, the best legal hypothesis with its fit."""

    fit: Fit
    scores: list[Scored]
    best: Scored | None
    with_best: Fit | None
