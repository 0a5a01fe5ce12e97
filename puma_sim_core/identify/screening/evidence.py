# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Marginal likelihood of hypotheses in closed form, parameters always competing.

The whitened residual is y = N a + X b + e: N the derivatives by the mechanism's parameters and the columns of effects
that are in the model already, X those of a hypothesis, all coefficients with Gaussian priors. With a integrated out,
the gain of log evidence by X needs X'PX and X'Py only, P = 1 - N (S^-2 + N'N)^-1 N'.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from puma_sim_core.effects.screening import Candidate, Illegal
from puma_sim_core.identify.arrays import Floats, Ints, cholesky, solved
from puma_sim_core.identify.settings import SCREENING

#: (name, joint 1-based, None for the whole arm) of an effect
Key = tuple[str, int | None]
#: makes the kept rows of a joint independent and of variance 1
Whitening = Callable[[Floats], Floats]

#: joint -> (m, p) columns of a candidate
Reduction = Callable[[Candidate], dict[int, Floats]]


@dataclass(frozen=True)
class Entry:
    """One candidate of a bank: hypothesis number, its candidate, and where its columns stand."""

    hypothesis: int
    candidate: Candidate
    columns: slice


class Bank:
    """The columns of all candidates, as they are at the kept rows [V].

    hypotheses : (name, joint 1-based or None) of each; entries; at[j] : for joint j the numbers of the columns that
    touch it; values[j] : (m, len(at[j])), None without any.
    """

    def __init__(self, joints: int):
        self.hypotheses: list[Key] = []
        self.entries: list[Entry] = []
        self.width = 0
        self._parts: list[list[Floats]] = [[] for _ in range(joints)]
        self._at: list[list[int]] = [[] for _ in range(joints)]

    def add(self, name: str, joint: int | None, candidates: Iterable[Candidate], reduce: Reduction) -> None:
        """Add one hypothesis."""
        number = len(self.hypotheses)
        self.hypotheses.append((name, joint))
        for candidate in candidates:
            columns = slice(self.width, self.width + len(candidate.mean))
            for j, values in reduce(candidate).items():
                self._parts[j].append(values)
                self._at[j] += range(columns.start, columns.stop)
            self.width = columns.stop
            # the columns at all rows are not asked for again: those of a minute at 1 kHz take half a gigabyte
            self.entries.append(Entry(number, replace(candidate, columns=()), columns))

    def freeze(self) -> None:
        """Join the columns once all hypotheses are there."""
        self.at: list[Ints] = [np.array(at, dtype=int) for at in self._at]
        self.values = [np.hstack(parts) if parts else None for parts in self._parts]
        self._parts = []

    def columns_of(self, entry: Entry, values: Sequence[Floats | None] | None = None) -> dict[int, Floats]:
        """Joint -> (m, p) of one candidate, of `values` or of other values in their place."""
        out, c = {}, entry.columns
        for j, (at, all_values) in enumerate(zip(self.at, values or self.values)):
            first = int(np.searchsorted(at, c.start))
            if all_values is not None and first < len(at) and at[first] == c.start:
                out[j] = all_values[:, first : first + c.stop - c.start]
        return out


class Estimate(NamedTuple):
    """A candidate as scored: gains of log evidence and of log likelihood [nat], coefficients (p,), their covariance."""

    gain: float
    entry: Entry
    coefficients: Floats
    covariance: Floats
    likelihood: float


@dataclass(frozen=True)
class Scored:
    """A hypothesis against the base.

    gain : of log evidence [nat], averaged over the grid; best : its best legal candidate, else its best one, None where
    it was not screened; values : of the parameters, None without a legal candidate; occam : what the gain is less than
    that of the likelihood [nat], for coefficients that were free.
    """

    name: str
    joint: int | None
    gain: float
    best: Estimate | None = None
    values: dict[str, float] | None = None
    occam: float = 0.0

    @property
    def key(self) -> Key:
        """(name, joint)."""
        return self.name, self.joint

    @property
    def estimate(self) -> Estimate:
        """`best` of a hypothesis that was screened."""
        assert self.best is not None
        return self.best


class Base:
    """Whitened residual with its nuisance columns.

    whiteners : one a joint; y (m, J) : residual about the prior mean [V]; nuisance (m, J, p) [V]; deviation (p,) prior.
    """

    def __init__(self, whiteners: Sequence[Whitening], y: Floats, nuisance: Floats, deviation: Floats):
        self.whiteners = whiteners
        self.deviation = deviation
        self.y = [w(y[:, j]) for j, w in enumerate(whiteners)]
        self.N = [w(nuisance[:, j, :] * deviation) for j, w in enumerate(whiteners)]
        A = np.eye(len(deviation)) + sum(N.T @ N for N in self.N)
        self.factor = cho_factor(A, lower=True)
        self.scaled = cho_solve(self.factor, sum(N.T @ y for N, y in zip(self.N, self.y)))

    @property
    def coefficients(self) -> Floats:
        """(p,) posterior mean of the nuisance coefficients."""
        return self.scaled * self.deviation

    def innovations(self) -> list[Floats]:
        """Whitened residuals of each joint after the nuisance is taken out."""
        return [y - N @ self.scaled for y, N in zip(self.y, self.N)]

    def whiten(self, bank: Bank) -> Whitened:
        """The bank's columns in this noise, with what every screening needs of them."""
        X = [None if v is None else w(v) for w, v in zip(self.whiteners, bank.values)]
        NX = np.zeros((len(self.deviation), bank.width))
        for at, N, x in zip(bank.at, self.N, X):
            if x is not None:
                NX[:, at] += N.T @ x
        return Whitened(bank, X, NX, cho_solve(self.factor, NX))


@dataclass(frozen=True)
class Whitened:
    """A bank in the noise of a base."""

    bank: Bank
    X: list[Floats | None]
    NX: Floats
    ANX: Floats

    def gram(self, entry: Entry) -> Floats:
        """(p, p) X'PX of a candidate."""
        G = -self.NX[:, entry.columns].T @ self.ANX[:, entry.columns]
        for part in self.bank.columns_of(entry, self.X).values():
            G = G + part.T @ part
        return G

    def products(self, ys: Sequence[Floats]) -> Floats:
        """(C, ...) X'y for whitened rows ys, a list over the joints of (mj, ...)."""
        out = np.zeros((self.bank.width, *ys[0].shape[1:]))
        for at, x, y in zip(self.bank.at, self.X, ys):
            if x is not None:
                out[at] += x.T @ y
        return out


def log_gain(G: Floats, b: Floats, mean: Floats, deviation: Floats) -> tuple[Floats, Floats, Floats]:
    """Gain of log evidence by columns with X'PX = G (p, p), X'Py = b (p,) or (p, r).

    Also the posterior mean of the coefficients, same shape as b, and their covariance (p, p).
    """
    mean = mean if b.ndim == 1 else mean[:, None]
    factor = cholesky(G + np.diag(1.0 / deviation**2))
    rest = b - G @ mean
    moved = solved(factor, rest)
    shift = (mean * (b + rest)).sum(axis=0)
    gain = 0.5 * shift + 0.5 * (rest * moved).sum(axis=0)
    gain -= float(np.log(factor.diagonal()).sum() + np.log(deviation).sum())
    return gain, mean + moved, solved(factor, np.eye(len(G)))


def score(entry: Entry, G: Floats, b: Floats) -> Estimate:
    """A candidate with X'PX = G (p, p), X'Py = b (p,)."""
    c = entry.candidate
    gain, coefficients, covariance = log_gain(G, b, c.mean, c.deviation)
    likelihood = 0.5 * float(coefficients @ (2.0 * b - G @ coefficients))
    return Estimate(float(gain) - np.log(c.tried), entry, coefficients, covariance, likelihood)


def screen(base: Base, whitened: Whitened) -> list[Scored]:
    """Every hypothesis of a bank against the base."""
    bank = whitened.bank
    b = whitened.products(base.y) - whitened.NX.T @ base.scaled
    found: list[list[Estimate]] = [[] for _ in bank.hypotheses]
    for entry in bank.entries:
        found[entry.hypothesis].append(score(entry, whitened.gram(entry), b[entry.columns]))
    return [scored_of(name, joint, rows) for (name, joint), rows in zip(bank.hypotheses, found) if rows]


def scored_of(name: str, joint: int | None, found: Sequence[Estimate]) -> Scored:
    """A hypothesis by the estimates of its candidates."""
    gains = np.array([each.gain for each in found])
    total = float(np.logaddexp.reduce(gains) - np.log(len(gains)))
    for each in sorted(found, key=lambda each: -each.gain):
        if each.gain < gains.max() - SCREENING.evidence_near_best:
            break
        try:
            values = each.entry.candidate.values(each.coefficients)
        except Illegal:
            continue
        return Scored(name, joint, total, each, values, each.likelihood - total)
    best = found[int(np.argmax(gains))]
    return Scored(name, joint, total, best, None, best.likelihood - total)
