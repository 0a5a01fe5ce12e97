# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Hypotheses against the innovations of a Kalman predictor, linear and without bias.

A part x(t) of the voltage that the model lacks shows in its innovations as x through the response of the predictor.
Columns are made of the motion that it predicts and of earlier voltages: of nothing that the present innovation, or a
controller that answers to it, has changed. So a delay or an elasticity gets no evidence from feedback. Innovations and
columns are averaged over blocks of rows that are short beside anything the columns do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import solve_triangular

from puma_sim_core.effects import Kind
from puma_sim_core.effects.screening import TORQUE_COLUMN, Candidate, Signals
from puma_sim_core.identify.arrays import Complexes, Floats, cholesky, log_rows, solved
from puma_sim_core.identify.data.sampling import Trajectory
from puma_sim_core.identify.fitting.point import Point, bounded
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.screening.coupling import Coupling, Pair
from puma_sim_core.identify.screening.evidence import Entry, Estimate, Key, Scored, log_gain, score, scored_of
from puma_sim_core.identify.screening.hypotheses import by_joint, candidates, screening_of, signals_of
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.settings import SCREENING, SELECTION

#: joint (0-based) -> its columns (b, p)
Columns = Mapping[int, Floats]
#: candidates, each with its columns in the innovations
Pairs = Iterable[tuple[Candidate, Columns]]


class CausalScreen:
    """The innovations of one fitted model, ready to score hypotheses.

    point : the model; errors (N, J) : its innovations after whitening; jacobian (N', p) : their derivatives by the
    parameters, at the rows to fit, per deviation.
    """

    def __init__(self, fit: PredictionFit, point: Point, errors: Floats, jacobian: Floats, problem: Problem):
        self.fit = fit
        self.predictor = fit.predictor
        self.point = point
        self.problem = problem
        self.block = max(1, int(SCREENING.causal_block / self.predictor.step))
        self.errors = errors
        self._spectra: dict[tuple[int, int, int], tuple[int, Complexes]] = {}
        self._foldings: dict[tuple[int, int, int], tuple[int, Complexes]] = {}
        self._two_mass: dict[Key, list[tuple[Candidate, Columns]]] = {}
        rows = fit.rows
        self.J = errors.shape[1]
        self.lengths = self.predictor.lengths
        self.usable = [self._mean(rows[:, j].astype(float)[:, None])[:, 0] > 0.999 for j in range(self.J)]
        self.y = [self._blocks(errors[:, j : j + 1], j)[:, 0] for j in range(self.J)]
        p = jacobian.shape[1]
        self.jacobian = jacobian
        #: of each joint its rows of the jacobian, in the order of the log
        self._own = np.cumsum(rows).reshape(rows.shape) - 1
        self.N = [self._blocks(self._at_all_rows(jacobian, j), j) for j in range(self.J)]
        m = fit.mechanism
        prior = np.full(p, SCREENING.causal_precision)
        prior[: len(m.start)] = 1.0
        self.factor = cholesky(np.diag(prior) + sum(N.T @ N for N in self.N))
        # the gradient of the prior: the fit need not have come to its very end
        pull = np.zeros(p)
        pull[: len(m.start)] = (point.theta - m.start) / m.deviations
        self.Ny = self._nuisance(self.y) + pull
        self.scaled = solved(self.factor, self.Ny)
        self.signals = self._signals()
        self.coupling = Coupling.of(self.predictor, point.theta, self.signals)
        self.moved = self._pairs()

    def _nuisance(self, ys: Sequence[Floats]) -> Floats:
        """(p, ...) N'y of blocks (b, ...) of each joint."""
        return sum(N.T @ y for N, y in zip(self.N, ys))

    def _mean(self, values: Floats) -> Floats:
        """(blocks, ...) means over blocks of rows, log by log."""
        parts = []
        for rows in log_rows(self.lengths):
            k = (rows.stop - rows.start) // self.block
            part = values[rows.start : rows.start + k * self.block]
            parts.append(part.reshape(k, self.block, *values.shape[1:]).mean(axis=1))
        return np.concatenate(parts)

    def _blocks(self, values: Floats, joint: int) -> Floats:
        return self._mean(values)[self.usable[joint]] * np.sqrt(self.block)

    def _at_all_rows(self, values: Floats, joint: int) -> Floats:
        """(N, p) of a joint by those (N', p) of all joints at the rows to fit; 0 elsewhere."""
        own = self.fit.rows[:, joint]
        out = np.zeros((len(own), values.shape[1]))
        out[own] = values[self._own[own, joint]]
        return out

    def _signals(self) -> Signals:
        """Signals of the motion that the predictor gives, voltages of the rows before."""
        p, m, s = self.predictor, self.fit.mechanism, self.problem.sampled
        tracked = p.tracked(m.plant(self.point.theta, self.point.effects))
        acceleration = []
        for t, stretch in zip(tracked, p.stretches):
            corrected = t.velocity + p.gain[:, 1] * t.innovation
            change = np.diff(t.velocity, axis=0, prepend=t.velocity[:1])
            change[1:] = t.velocity[1:] - corrected[:-1]
            acceleration.append(change / np.diff(stretch.time)[:, None])
        motion = Trajectory(
            time=np.concatenate([x.time[1:] for x in p.stretches]),
            step=p.step,
            segment=np.concatenate([np.full(n, number) for number, n in enumerate(self.lengths)]),
            voltage=np.concatenate([x.voltage[:-1] for x in p.stretches]),
            enable=np.concatenate(
                [np.ones_like(x.voltage[:-1]) if x.enable is None else x.enable[:-1] for x in p.stretches]
            ),
            position=np.concatenate([t.position for t in tracked]),
            velocity=np.concatenate([t.velocity for t in tracked]),
            acceleration=np.concatenate(acceleration),
        )
        signals = signals_of(m, self.point.theta, motion, s.velocity_noise, s.quantum)
        left = p.in_volts(np.concatenate([t.innovation for t in tracked]), s.cutoffs[1])
        # what is to be placed by it must not lie in rows that are not fitted to
        return replace(signals, residual=np.where(self.fit.rows, left, 0.0))

    def _pairs(self) -> list[Pair]:
        """(joint that is moved, joint of a voltage), without those that change the innovations by no more than
        `SCREENING.coupling` of what the voltage does to its own joint."""
        shown = {pair: float(np.linalg.norm(self._response(*pair))) for pair in self.coupling.responses}
        return [(i, j) for i, j in shown if shown[i, j] > SCREENING.coupling * shown[j, j] or i == j]

    def columns(self, candidate: Candidate) -> Columns:
        """Joint -> (b, p) whitened innovations that unit coefficients would make, in blocks."""
        return self._on_all(self._volts(candidate), self._in_blocks)

    def _on_all(self, volts: dict[int, Floats], passed: Callable[[Floats, int, int], Floats]) -> dict[int, Floats]:
        """Joint that is moved -> sum of what voltages (N, p) of the joints make of it.

        passed : (voltages, joint that is moved, joint of the voltages) -> that part.
        """
        out = dict[int, Floats]()
        for i, j in self.moved:
            if j in volts:
                share = self.coupling.shares.get((i, j))
                part = passed(volts[j] if share is None else share[:, None] * volts[j], i, j)
                out[i] = out[i] + part if i in out else part
        return out

    def _in_blocks(self, volts: Floats, joint: int, source: int) -> Floats:
        """(b, p) whitened innovations by voltages (N, p) of a joint, in blocks: `_blocks` of what `_passed` gives.

        Means over blocks are a filter, of whose output each `block`-th row is taken: what folds its spectrum.
        """
        parts, block = [], self.block
        for rows in log_rows(self.lengths):
            count = (rows.stop - rows.start) // block
            size, spectrum = self._folding(joint, source, rows.stop - rows.start)
            X = rfft(np.ascontiguousarray(volts[rows].T), size) * spectrum
            half, length = size // block // 2, size // block
            folded = X[:, : half + 1].copy()
            for n in range(1, block):
                # above the highest frequency stand the conjugates
                part = X[:, n * length : n * length + half + 1]
                if 2 * n >= block:
                    part = X[:, size - n * length - half : size - n * length + 1][:, ::-1].conj()
                folded += part
            parts.append(irfft(folded, length)[:, :count].T)
        return np.concatenate(parts)[self.usable[joint]] * (np.sqrt(block) / block)

    def _folding(self, joint: int, source: int, rows: int) -> tuple[int, Complexes]:
        """Size of the transforms of so many rows, a multiple of two blocks, and the transform (f,) of the response
        averaged over a block from a row on."""
        if (joint, source, rows) not in self._foldings:
            response = np.convolve(self._response(joint, source), np.full(self.block, 1.0 / self.block))
            size = 2 * self.block * next_fast_len(-(-(rows + len(response)) // (2 * self.block)), real=True)
            turn = np.exp(2j * np.pi * np.arange(size // 2 + 1) * ((self.block - 1) / size))
            self._foldings[joint, source, rows] = size, rfft(response, size) * turn
        return self._foldings[joint, source, rows]

    def left(self, best: Estimate | None = None) -> Floats:
        """(N, J) innovations after whitening at the rows to fit, 0 elsewhere, that a hypothesis leaves when the
        parameters have answered to it; None: that the parameters alone leave."""
        made = {}
        if best is not None:
            made = {j: x @ best.coefficients for j, x in self._innovations(best.entry.candidate).items()}
        pulled = self.Ny - sum(self.N[j].T @ self._blocks(x[:, None], j)[:, 0] for j, x in made.items())
        left = np.where(self.fit.rows, self.errors, 0.0)
        left[self.fit.rows] -= self.jacobian @ solved(self.factor, pulled)
        for j, x in made.items():
            left[:, j] -= x
        return np.where(self.fit.rows, left, 0.0)

    def volts(self, candidate: Candidate, coefficients: Floats) -> Floats:
        """(N, J) voltage [V] of a hypothesis whose columns are voltages, at the rows before the innovations."""
        out = np.zeros_like(self.signals.voltage)
        for column, c in zip(candidate.columns, coefficients):
            for j, values in column.items():
                out[:, j] += c * values
        return out * self.signals.enable

    def _volts(self, candidate: Candidate) -> dict[int, Floats]:
        """Joint -> (N, p) voltages [V] of unit coefficients."""
        s, out = self.signals, by_joint(candidate, len(self.signals.time))
        for j, full in out.items():
            if candidate.unit == TORQUE_COLUMN:
                full *= s.volts_per_torque[j]
                if s.lag[j] > 0.0:
                    full = full + s.lag[j] * np.gradient(full, s.step, axis=0)
            full *= s.enable[:, j : j + 1]
            out[j] = full
        return out

    def _innovations(self, candidate: Candidate) -> dict[int, Floats]:
        """Joint -> (N, p) whitened innovations that unit coefficients would make."""
        return self._on_all(self._volts(candidate), self._passed)

    def _passed(self, volts: Floats, joint: int, source: int) -> Floats:
        """(N, p) whitened innovations of a joint by voltages (N, p) of one."""
        out = np.empty_like(volts)
        for rows in log_rows(self.lengths):
            n = rows.stop - rows.start
            size, spectrum = self._spectrum(joint, source, n)
            out[rows] = irfft(rfft(np.ascontiguousarray(volts[rows].T), size) * spectrum, size)[:, :n].T
        return out

    def _response(self, joint: int, source: int) -> Floats:
        """Whitened innovations of a joint after a volt on one in one row."""
        w = self.fit.weighting
        return np.convolve(self.coupling.responses[joint, source], w.filters[joint]) / w.scale[joint]

    def _spectrum(self, joint: int, source: int, rows: int) -> tuple[int, Complexes]:
        """Size of the transforms that convolve so many rows, and the response's one (f,)."""
        if (joint, source, rows) not in self._spectra:
            response = self._response(joint, source)
            size = next_fast_len(rows + len(response) - 1, real=True)
            self._spectra[joint, source, rows] = size, rfft(response, size)
        return self._spectra[joint, source, rows]

    def pairs(self, kind: Kind, joint: int | None) -> list[tuple[Candidate, Columns]]:
        """The candidates of a hypothesis with their columns; joint 1-based, None for the whole arm."""
        if (runs := screening_of(kind).runs) is None or joint is None:
            return self._by_columns(kind, joint)
        if (kind.name, joint) not in self._two_mass:
            # about parameters that a wide gap has stretched, a run with one is no better than with none: columns, of
            # the measured motion, are, where the rotor is not light
            ran = self._in_model(kind, joint, runs(self.signals, joint - 1))
            self._two_mass[kind.name, joint] = [*self._by_columns(kind, joint), *ran]
        return self._two_mass[kind.name, joint]

    def _by_columns(self, kind: Kind, joint: int | None) -> list[tuple[Candidate, Columns]]:
        return [(c, self.columns(c)) for c in candidates(kind, joint, self.signals)]

    def _in_model(self, kind: Kind, joint: int, found: Sequence[Candidate]) -> list[tuple[Candidate, Columns]]:
        """Candidates of coefficient 1, each with what a run of the model with it takes from the innovations; those that
        can be run."""
        effects = (bounded(kind, joint, c.values(c.mean)) for c in found)
        points = [Point(self.point.theta, (*self.point.effects, effect)) for effect in effects]
        ran = zip(found, self.fit.errors_of(points))
        return [
            (c, {j: self._blocks((self.errors - errors)[:, j : j + 1], j) for j in range(self.J)})
            for c, errors in ran
            if errors is not None
        ]

    def score(self, kind: Kind, joint: int | None) -> Scored | None:
        """A hypothesis as scored, None without candidates."""
        return self.score_columns(kind.name, joint, self.pairs(kind, joint))

    def score_columns(self, name: str, joint: int | None, pairs: Pairs) -> Scored | None:
        """`score` for (candidate, its columns) pairs."""
        found = self.products(pairs, self.y, self.scaled)
        rows = [score(Entry(0, c, slice(0, len(c.mean))), G, b) for c, G, b in found]
        return scored_of(name, joint, rows) if rows else None

    def products(
        self, pairs: Pairs, ys: Sequence[Floats], pulled: Floats
    ) -> Iterator[tuple[Candidate, Floats, Floats]]:
        """(candidate, X'PX (p, p), X'Py (p, ...)) of each pair.

        ys : for each joint blocks (b, ...) of innovations; pulled (q, ...) : what the parameters make of them.
        """
        for group in _side_by_side(pairs):
            X = {j: np.hstack([own[j] for _, own in group]) for j in group[0][1]}
            NX: Floats = sum(self.N[j].T @ x for j, x in X.items())
            shares = solve_triangular(self.factor, NX, lower=True, check_finite=False)
            b = sum(x.T @ ys[j] for j, x in X.items()) - NX.T @ pulled
            end = 0
            for c, own in group:
                at = slice(end, end := end + len(c.mean))
                G: Floats = sum(x.T @ x for x in own.values()) - shares[:, at].T @ shares[:, at]
                yield c, G, b[at]

    def placebos(self, shifts: Floats) -> Placebos:
        """The innovations, shifted in a circle by shares (k,) of their length."""
        return self._placebos(self.y, shifts)

    def placebos_without(self, best: Estimate, own: Columns, shifts: Floats) -> Placebos:
        """`placebos` of what an explanation leaves, when the parameters have answered to it. own : its columns."""
        left = [y.copy() for y in self.y]
        for j, x in own.items():
            left[j] -= x @ best.coefficients
        Ny = self._nuisance(left)
        return self._placebos([y - N @ solved(self.factor, Ny) for y, N in zip(left, self.N)], shifts)

    def _placebos(self, y: Sequence[Floats], shifts: Floats) -> Placebos:
        ys = [np.column_stack([np.roll(own, int(s * len(own))) for s in shifts]) for own in y]
        return Placebos(self, ys, solved(self.factor, self._nuisance(ys)))

    def gram(self, candidate: Candidate) -> Floats:
        """(p, p) X'PX of a candidate."""
        ((_, found, _),) = self.products([(candidate, self.columns(candidate))], self.y, self.scaled)
        return found

    def block_times(self, joint: int) -> Floats:
        """(b,) times [s] of the blocks of a joint."""
        return self._mean(self.signals.time)[self.usable[joint]]

    def response(self, joint: int, frequency: Floats) -> Complexes:
        """Whitened innovation of a joint per volt at frequencies [Hz], blocks averaged."""
        h = self.predictor.step
        taps = self._response(joint, joint)
        turn = np.exp(-2j * np.pi * np.outer(frequency, np.arange(len(taps))) * h)
        x = np.pi * np.asarray(frequency) * h * self.block
        return turn @ taps * np.sinc(x / np.pi) * np.sqrt(self.block)


def _side_by_side(pairs: Pairs) -> Iterator[list[tuple[Candidate, Columns]]]:
    """Pairs that follow each other on the same joints, as many as have `SCREENING.causal_together` columns together."""
    group: list[tuple[Candidate, Columns]] = []
    width = 0
    for candidate, columns in pairs:
        if group and (columns.keys() != group[0][1].keys() or width >= SCREENING.causal_together):
            yield group
            group, width = [], 0
        group.append((candidate, columns))
        width += len(candidate.mean)
    if group:
        yield group


def placebo_shifts(seed: int) -> Floats:
    """(k,) shifts of placebos, as shares of the record."""
    return np.sort(np.random.default_rng(seed).uniform(*SELECTION.placebo_shifts, SELECTION.placebos))


@dataclass(frozen=True)
class Placebos:
    """Innovations shifted in a circle: what a hypothesis gains of them is chance.

    ys : for each joint (b, k), one column a shift; pulled (p, k) : what the parameters make of them.
    """

    screen: CausalScreen
    ys: list[Floats]
    pulled: Floats

    def gains(self, pairs: Pairs) -> Floats:
        """(k,) gains [nat] of a hypothesis in each of them by its (candidate, columns) pairs; 0 without any."""
        gains = [
            log_gain(G, b, c.mean, c.deviation)[0] - np.log(c.tried)
            for c, G, b in self.screen.products(pairs, self.ys, self.pulled)
        ]
        if not gains:
            return np.zeros(self.pulled.shape[1])
        found: Floats = np.logaddexp.reduce(gains) - np.log(len(gains))
        return found
