# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What anyone would try first, on the same records and the same regressor columns.

"all at once": ordinary least squares of the residual on the columns of every effect of the
library, each at the point of its grid that alone explains most, beside the parameters of the arm
with their priors; what is significant at 5 % over all effects together is named. "forward": the
effect that lowers the Bayesian information criterion most enters, until none lowers it. Both work
in the noise of the retuned residual, look at no sign or size, and have no placebos. The third
one, retuning alone, is part of every report.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.effects.screening import Illegal
from puma_sim_core.errors import PumaSimError
from puma_sim_core.identify.screening.evidence import Bank
from puma_sim_core.identify.screening.search import Chosen

_SIGNIFICANT = 0.05
_MOST = 6
_WIDE = 1e3  # prior deviations that stand for none


def baselines(bench) -> dict[str, dict]:
    """Baseline -> names [(name, joint)], the first one best, and position_rms (J,) or None."""
    bank = _bank(bench)
    return {"all at once": _all_at_once(bench, bank), "forward": _forward(bench, bank)}


def _bank(bench) -> Bank:
    """The columns of the whole library about the retuned parameters."""
    p, theta = bench.problem, bench.retuned.theta
    signals = replace(p.signals(theta), residual=p.full_residual(theta))
    bank = Bank(p.sampled.joints)
    for name, kind in bench.library.items():
        for j in [None] if not kind.per_joint else range(p.sampled.joints):
            bank.add(
                name,
                None if j is None else j + 1,
                kind.screening.candidates(signals, j),
                lambda c: p.reduce(c, signals),
            )
    bank.freeze()
    return bank


class _System:
    """Whitened rows of the retuned residual and of all columns, parameters projected out as far
    as their priors let them."""

    def __init__(self, bench, bank: Bank, chosen=()):
        search = bench.search
        linear = bench.problem.linear(bench.retuned.theta)
        self.fit = search.base(linear, chosen, bench.retuned.weights)
        self.base = self.fit.base
        self.whitened = self.base.whiten(bank)
        self.rows = sum(map(len, self.base.y))
        Ny = sum(N.T @ y for N, y in zip(self.base.N, self.base.y))
        self.yPy = sum(float(y @ y) for y in self.base.y) - float(Ny @ self.base.scaled)
        self.b = self.whitened.products(self.base.y) - self.whitened.NX.T @ self.base.scaled

    def drop(self, columns: np.ndarray, gram: np.ndarray) -> float:
        """By how much columns lower the sum of squares."""
        b = self.b[columns]
        return float(b @ np.linalg.lstsq(gram, b, rcond=1e-10)[0])


def _all_at_once(bench, bank: Bank) -> dict:
    system = _System(bench, bank)
    chosen: dict[int, tuple] = {}
    for entry in bank.entries:
        gain = system.drop(np.arange(entry.columns.start, entry.columns.stop), system.whitened.gram(entry))
        if entry.hypothesis not in chosen or gain > chosen[entry.hypothesis][0]:
            chosen[entry.hypothesis] = gain, entry
    entries = [entry for _, entry in chosen.values()]
    columns = np.concatenate([np.arange(e.columns.start, e.columns.stop) for e in entries])
    gram = -system.whitened.NX[:, columns].T @ system.whitened.ANX[:, columns]
    for j, at in enumerate(bank.at):
        inside = np.flatnonzero(np.isin(columns, at))
        X = system.whitened.X[j][:, np.searchsorted(at, columns[inside])]
        gram[np.ix_(inside, inside)] += X.T @ X
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-30))
    inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-9, hermitian=True)
    inverse /= np.outer(scale, scale)
    coefficients = inverse @ system.b[columns]
    left = system.yPy - float(system.b[columns] @ coefficients)
    variance = max(left, 1e-12) / max(system.rows - len(columns), 1)
    limit, found, start = _SIGNIFICANT / len(entries), [], 0
    for entry in entries:
        own = slice(start, start + entry.columns.stop - entry.columns.start)
        start = own.stop
        value = coefficients[own]
        wald = float(value @ np.linalg.pinv(inverse[own, own], hermitian=True) @ value) / variance
        chance = float(chi2.logsf(wald, len(value)))
        if chance < np.log(limit):
            found.append((chance, entry, value))
    found.sort(key=lambda row: row[0])
    step = system.base.scaled - system.whitened.ANX[:, columns] @ coefficients
    m = bench.mechanism
    theta = m.clip(m.start + (step * system.base.deviation)[: len(m.start)])
    return _outcome(bench, bank, theta, [(entry, value) for _, entry, value in found])


def _forward(bench, bank: Bank) -> dict:
    chosen, taken = [], set()
    system = _System(bench, bank)
    rows = system.rows
    while len(chosen) < _MOST:
        best = None
        for entry in bank.entries:
            if entry.hypothesis in taken:
                continue
            left = system.yPy - system.drop(
                np.arange(entry.columns.start, entry.columns.stop), system.whitened.gram(entry)
            )
            width = entry.columns.stop - entry.columns.start
            change = rows * np.log(max(left, 1e-12) / system.yPy) + width * np.log(rows)
            if best is None or change < best[0]:
                best = change, entry
        if best is None or best[0] >= 0.0:
            break
        taken.add(best[1].hypothesis)
        chosen.append(_chosen(bench, bank, best[1]))
        system = _System(bench, bank, chosen)
    values = np.split(
        system.fit.coefficients, len(system.fit.linear.theta) + np.cumsum([0] + [_width(c) for c in chosen])
    )
    found = [(c.entry, own) for c, own in zip(chosen, values[1:])]
    return _outcome(bench, bank, system.fit.theta, found)


def _chosen(bench, bank: Bank, entry):
    """An entry as part of the model, with no prior to speak of."""
    c = entry.candidate
    free = replace(entry, candidate=replace(c, mean=np.zeros(len(c.mean)), deviation=_WIDE * np.asarray(c.deviation)))
    return Chosen(free, bank.columns_of(entry))


def _width(chosen: Chosen) -> int:
    return len(chosen.entry.candidate.mean)


def _outcome(bench, bank: Bank, theta, found) -> dict:
    """Names, and the errors of the plant with as many of them as it can have."""
    effects: list[Effect] = []
    for entry, coefficients in found:
        name, joint = bank.hypotheses[entry.hypothesis]
        kind = KINDS[name]
        try:
            values = entry.candidate.values(coefficients)
            for p in kind.parameters:
                if p.name in values:
                    values[p.name] = min(max(values[p.name], p.low), p.high)
            more = [*effects, Effect(kind, joint, values)]
            bench.mechanism.plant(theta, more)
        except (Illegal, PumaSimError):
            continue
        effects = more
    return {
        "names": [bank.hypotheses[entry.hypothesis] for entry, _ in found],
        "position_rms": bench.position_rms(theta, effects),
    }
