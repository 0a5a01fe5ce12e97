# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The screening on filtered motion, in volts.

The parameters are retuned with the effects chosen so far, the noise is estimated on the residual, and every hypothesis
of the library is scored by its gain of evidence. `selection` tries the best ones in the model.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.effects import Kind
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.noise import residual as noise
from puma_sim_core.identify.screening.evidence import Bank, Base, Entry, Scored, screen
from puma_sim_core.identify.screening.hypotheses import candidates, hypotheses, open_to
from puma_sim_core.identify.screening.problem import Linear, Problem
from puma_sim_core.identify.settings import SCREENING


@dataclass(frozen=True)
class Chosen:
    """An effect in the model: its candidate, and its columns [V] by joint."""

    entry: Entry
    columns: dict[int, Floats]


@dataclass(frozen=True)
class Fit:
    """The model about theta with chosen effects, in its noise: weights of its sources, joint by joint."""

    problem: Problem
    linear: Linear
    chosen: tuple[Chosen, ...]
    weights: list[Floats]
    base: Base

    @property
    def coefficients(self) -> Floats:
        """(p + c,) posterior means: parameters less their start, then coefficients of effects."""
        means = [c.entry.candidate.mean for c in self.chosen]
        return np.concatenate([np.zeros(len(self.linear.theta)), *means]) + self.base.coefficients

    @property
    def theta(self) -> Floats:
        """Parameters by this fit, within their bounds."""
        m = self.problem.mechanism
        return m.clip(m.start + self.coefficients[: len(self.linear.theta)])

    def residual(self) -> Floats:
        """(m, J) residual [V] of the fitted model, at all kept rows."""
        y, columns = assemble(self.problem, self.linear, self.chosen, centred=False)
        return y - columns @ self.coefficients


def assemble(problem: Problem, linear: Linear, chosen: Sequence[Chosen], centred: bool = True) -> tuple[Floats, Floats]:
    """y (m, J) and the nuisance columns (m, J, p): parameters about their start, then effects.

    centred : y is about the prior means of the coefficients.
    """
    y = linear.residual + linear.jacobian @ (linear.theta - problem.mechanism.start)
    columns = [linear.jacobian]
    for c in chosen:
        mean = c.entry.candidate.mean
        block = np.zeros((*y.shape, len(mean)))
        for j, values in c.columns.items():
            block[:, j, :] = values
        if centred:
            y = y - block @ mean
        columns.append(block)
    return y, np.concatenate(columns, axis=2)


class Search:
    """The screening of one problem on filtered motion. library : name -> effect."""

    def __init__(
        self,
        problem: Problem,
        library: Mapping[str, Kind],
        progress: Callable[[str, float], None] = lambda what, share: None,
    ):
        self.problem, self.library, self.progress = problem, library, progress
        s, m = problem.sampled, problem.mechanism
        drive = m.drive(m.start)
        stiffness = drive.volts_per_torque * (m.inertia(m.start, s.position).mean(axis=0) + drive.motor_inertia)
        lengths = [rows.stop - rows.start for rows in problem.stretches]
        self.sources = [
            noise.sources(s, float(stiffness[j]), float(drive.emf[j]), float(drive.lag[j]), max(lengths))
            for j in range(s.joints)
        ]
        self.place = np.concatenate([np.arange(length) for length in lengths])
        self._whiteners: dict[tuple[int, bytes], noise.Whitener] = {}

    # the model with given effects

    def whitener(self, joint: int, weights: Floats) -> noise.Whitener:
        """The whitener of a joint's rows to fit for weights of the noise."""
        key = (joint, weights.tobytes())
        if key not in self._whiteners:
            rows, covariance = self.problem.fit_rows(joint), weights @ self.sources[joint].covariances
            # dense factors: those of the noises that were asked for last are kept
            while len(self._whiteners) >= SCREENING.search_whiteners * len(self.sources):
                del self._whiteners[next(iter(self._whiteners))]
            self._whiteners[key] = noise.Whitener(covariance, rows, self.place[rows], self.problem.segment[rows])
        return self._whiteners[key]

    def base(self, linear: Linear, chosen: Sequence[Chosen], weights: list[Floats]) -> Fit:
        """The fit of parameters and chosen effects in a given noise."""
        p = self.problem
        y, columns = assemble(p, linear, chosen)
        deviation = np.concatenate([p.mechanism.deviations, *[c.entry.candidate.deviation for c in chosen]])
        whiteners = [self.whitener(j, own) for j, own in enumerate(weights)]
        return Fit(p, linear, tuple(chosen), weights, Base(whiteners, y, columns, deviation))

    def noise_of(self, residual: Floats, white_only: bool = False) -> list[Floats]:
        """Weights of the noise of each joint for a residual (m, J) [V] at all kept rows."""
        p = self.problem
        result = []
        for j, source in enumerate(self.sources):
            usable = np.zeros(len(p.kept), dtype=bool)
            usable[p.fit_rows(j)] = True
            budget = noise.least_weights(p.sampled, j, len(source.spectra))
            result.append(noise.fit_weights(source, p.sampled, residual[:, j], usable, p.stretches, budget, white_only))
        return result

    def settle(
        self, linear: Linear, chosen: Sequence[Chosen] = (), weights: list[Floats] | None = None, rounds: int = 2
    ) -> Fit:
        """Fit and noise in turn, from given weights or from the least that the residual allows: a fit in the noise of a
        residual that holds an effect would leave the effect there."""
        fit = self.base(linear, chosen, weights or self.noise_of(linear.residual, white_only=True))
        for _ in range(rounds):
            fit = self.base(linear, chosen, self.noise_of(fit.residual()))
        return fit

    def retune(self, theta: Floats) -> Fit:
        """Parameters by maximum a posteriori: linearised again until they stay."""
        fit = self.settle(self.problem.linear(theta))
        for _ in range(SCREENING.search_retunings - 1):
            if np.max(np.abs(fit.theta - theta) / self.problem.mechanism.deviations) < SCREENING.search_stays:
                break
            theta = fit.theta
            fit = self.settle(self.problem.linear(theta), (), fit.weights, 1)
        return fit

    # hypotheses

    def bank(self, theta: Floats) -> Bank:
        """Columns of the hypotheses of the library about theta, without the fast ones."""
        p = self.problem
        signals = replace(p.signals(theta), residual=p.full_residual(theta))
        bank = Bank(p.sampled.joints)
        known = {(e.kind.name, e.joint) for e in p.mechanism.effects}
        slow = [kind for kind in self.library.values() if kind.screening is not None and not kind.screening.fast]
        # of what a joint may have several of, those after the first are sought in what the first ones leave
        jobs = [(kind, joint) for kind, joint in hypotheses(slow, p.mechanism) if open_to(kind, joint, known)]
        for number, (kind, joint) in enumerate(jobs):
            self.progress("screening", 0.05 + 0.15 * number / len(jobs))
            bank.add(kind.name, joint, candidates(kind, joint, signals), lambda c: p.reduce(c, signals))
        bank.freeze()
        return bank

    def scores(self, linear: Linear, bank: Bank) -> list[Scored]:
        """Scores of all hypotheses, best first, in the noise of the best explanation."""
        scores = self.ranked(self.settle(linear, rounds=0), bank)
        best: Entry | None = None
        for _ in range(SCREENING.search_rounds):
            entry = next((s.estimate.entry for s in scores if s.values is not None), None)
            if entry is None or entry is best:
                break
            best = entry
            with_best = self.settle(linear, (Chosen(entry, bank.columns_of(entry)),))
            scores = self.ranked(self.base(linear, (), with_best.weights), bank)
        return scores

    @staticmethod
    def ranked(fit: Fit, bank: Bank) -> list[Scored]:
        """Scores of all hypotheses, best first."""
        return sorted(screen(fit.base, fit.base.whiten(bank)), key=lambda s: -s.gain)
