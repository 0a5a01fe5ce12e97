# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Marginal likelihood of hypotheses in closed form, parameters always competing (step 4).

The whitened residual is y = N a + X b + e: N the derivatives by the mechanism's parameters and the
columns of effects that are already in the model, X those of a hypothesis, all coefficients
Gaussian beforehand. With a integrated out, the gain of log evidence by X needs X'PX and X'Py
only, P = 1 - N (S^-2 + N'N)^-1 N'.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from puma_sim_core.effects.screening import Candidate, Illegal


@dataclass(frozen=True)
class Entry:
    """One candidate of a bank: hypothesis number, its candidate, and where its columns stand."""

    hypothesis: int
    candidate: Candidate
    columns: slice


class Bank:
    """The columns of all candidates, as they are at the kept rows [V].

    hypotheses : (name, joint 1-based or None) of each; entries; at[j]: for joint j the numbers of
    the columns that touch it; values[j]: (m, len(at[j])).
    """

    def __init__(self, joints: int):
        self.hypotheses: list[tuple[str, int | None]] = []
        self.entries: list[Entry] = []
        self.width = 0
        self._parts = [[] for _ in range(joints)]
        self._at = [[] for _ in range(joints)]

    def add(self, name: str, joint: int | None, candidates, reduce) -> None:
        """Add one hypothesis; reduce: candidate -> {joint: (m, p)}."""
        number = len(self.hypotheses)
        self.hypotheses.append((name, joint))
        for candidate in candidates:
            p = len(candidate.mean)
            columns = slice(self.width, self.width + p)
            for j, values in reduce(candidate).items():
                self._parts[j].append(values)
                self._at[j] += range(columns.start, columns.stop)
            self.width += p
            self.entries.append(Entry(number, candidate, columns))

    def freeze(self) -> None:
        """Join the columns once all hypotheses are there."""
        self.at = [np.array(at, dtype=int) for at in self._at]
        self.values = [np.hstack(parts) if parts else None for parts in self._parts]

    def columns_of(self, entry: Entry) -> dict[int, np.ndarray]:
        """Joint -> (m, p) of one candidate."""
        out = {}
        for j, at in enumerate(self.at):
            first = np.searchsorted(at, entry.columns.start)
            if first < len(at) and at[first] == entry.columns.start:
                out[j] = self.values[j][:, first : first + entry.columns.stop - entry.columns.start]
        return out


@dataclass(frozen=True)
class Scored:
    """A hypothesis against the base: gain of log evidence, averaged over the grid; its best legal
    candidate with coefficients (p,) and their covariance; why it is illegal, None if it is not;
    price: what the gain is less than that of the likelihood, for coefficients that were free."""

    name: str
    joint: int | None
    gain: float
    best_gain: float
    entry: Entry | None
    coefficients: np.ndarray | None
    covariance: np.ndarray | None
    values: dict[str, float] | None
    illegal: str | None = None
    price: float = 0.0


class Base:
    """Whitened residual with its nuisance columns.

    whiteners: one a joint; y: (m, J) residual about the prior mean [V]; nuisance (m, J, p) [V];
    deviation (p,) prior.
    """

    def __init__(self, whiteners, y: np.ndarray, nuisance: np.ndarray, deviation: np.ndarray):
        self.whiteners = whiteners
        self.deviation = deviation
        self.y = [w(y[:, j]) for j, w in enumerate(whiteners)]
        self.N = [w(nuisance[:, j, :] * deviation) for j, w in enumerate(whiteners)]
        A = np.eye(len(deviation)) + sum(N.T @ N for N in self.N)
        self.factor = cho_factor(A, lower=True)
        self.Ny = sum(N.T @ y for N, y in zip(self.N, self.y))
        self.scaled = cho_solve(self.factor, self.Ny)
        self.yPy = sum(float(y @ y) for y in self.y) - float(self.Ny @ self.scaled)
        self.log_determinant = 2.0 * float(np.log(np.diag(self.factor[0])).sum())

    @property
    def rows(self) -> int:
        """Number of rows over all joints."""
        return sum(len(y) for y in self.y)

    @property
    def log_evidence(self) -> float:
        """Log marginal likelihood of the base, with the determinants of the noise."""
        noise = sum(w.log_determinant for w in self.whiteners)
        return -0.5 * (self.yPy + self.log_determinant + noise + self.rows * np.log(2.0 * np.pi))

    @property
    def coefficients(self) -> np.ndarray:
        """(p,) posterior mean of the nuisance coefficients."""
        return self.scaled * self.deviation

    @property
    def covariance(self) -> np.ndarray:
        """(p, p) posterior covariance of the nuisance coefficients."""
        inverse = cho_solve(self.factor, np.eye(len(self.deviation)))
        return inverse * np.outer(self.deviation, self.deviation)

    def innovations(self) -> list[np.ndarray]:
        """Whitened residuals of each joint after the nuisance is taken out."""
        return [y - N @ self.scaled for y, N in zip(self.y, self.N)]

    def whiten(self, bank: Bank) -> Whitened:
        """The bank's columns in this noise, with what every screening needs of them."""
        X = [None if v is None else w(v) for w, v in zip(self.whiteners, bank.values)]
        NX = np.zeros((len(self.deviation), bank.width))
        for j, at in enumerate(bank.at):
            if X[j] is not None:
                NX[:, at] += self.N[j].T @ X[j]
        return Whitened(bank, X, NX, cho_solve(self.factor, NX))


@dataclass(frozen=True)
class Whitened:
    """A bank in the noise of a base."""

    bank: Bank
    X: list
    NX: np.ndarray
    ANX: np.ndarray

    def gram(self, entry: Entry) -> np.ndarray:
        """(p, p) X'PX of a candidate."""
        c = entry.columns
        G = -self.NX[:, c].T @ self.ANX[:, c]
        for j, at in enumerate(self.bank.at):
            first = np.searchsorted(at, c.start)
            if first < len(at) and at[first] == c.start:
                part = self.X[j][:, first : first + c.stop - c.start]
                G = G + part.T @ part
        return G

    def products(self, ys) -> np.ndarray:
        """(C, ...) X'y for whitened rows ys, a list over the joints of (mj, ...)."""
        out = np.zeros((self.bank.width, *ys[0].shape[1:]))
        for j, at in enumerate(self.bank.at):
            if self.X[j] is not None:
                out[at] += self.X[j].T @ ys[j]
        return out


def log_gain(G, b, mean, deviation):
    """Gain of log evidence by columns with X'PX = G (p, p), X'Py = b (p,) or (p, r).

    Also the posterior mean of the coefficients, same shape as b, and their covariance (p, p).
    """
    mean = mean if b.ndim == 1 else mean[:, None]
    inner = G + np.diag(1.0 / deviation**2)
    factor = cho_factor(inner, lower=True)
    rest = b - G @ mean
    moved = cho_solve(factor, rest)
    shift = (mean * (b + rest)).sum(axis=0)
    gain = 0.5 * shift + 0.5 * (rest * moved).sum(axis=0)
    gain -= float(np.log(np.diag(factor[0])).sum() + np.log(deviation).sum())
    return gain, mean + moved, cho_solve(factor, np.eye(len(G)))


def screen(base: Base, whitened: Whitened) -> list[Scored]:
    """Every hypothesis of a bank against the base."""
    bank = whitened.bank
    b = whitened.products(base.y) - whitened.NX.T @ base.scaled
    found: list[list] = [[] for _ in bank.hypotheses]
    for entry in bank.entries:
        G = whitened.gram(entry)
        c = entry.candidate
        gain, coefficients, covariance = log_gain(G, b[entry.columns], c.mean, c.deviation)
        gain = gain - np.log(c.tried)
        likelihood = 0.5 * float(coefficients @ (2.0 * b[entry.columns] - G @ coefficients))
        found[entry.hypothesis].append((float(gain), entry, coefficients, covariance, likelihood))
    return [scored_of(name, joint, rows) for (name, joint), rows in zip(bank.hypotheses, found) if rows]


def scored_of(name, joint, rows) -> Scored:
    """The best legal candidate of a hypothesis among (gain, entry, coefficients, covariance, gain
    of log likelihood) rows."""
    gains = np.array([row[0] for row in rows])
    total = float(np.logaddexp.reduce(gains) - np.log(len(gains)))
    reason = None
    for k in np.argsort(-gains, kind="stable"):
        gain, entry, coefficients, covariance, likelihood = rows[k]
        if gain < gains.max() - 6.0:
            break
        try:
            values = entry.candidate.values(coefficients)
        except Illegal as problem:
            reason = reason or str(problem)
            continue
        return Scored(name, joint, total, gain, entry, coefficients, covariance, values, None, likelihood - total)
    best = rows[int(np.argmax(gains))]
    return Scored(
        name, joint, total, best[0], best[1], best[2], best[3], None, reason or "no legal coefficients", best[4] - total
    )
