# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Hypotheses against the innovations of an observer, linear and without bias (step 4).

A part x(t) of the voltage that the model lacks shows in its innovations as x through the response
of the observer. Columns are made of the motion that the observer predicts and of voltages of
before: of nothing that the innovation of the moment, or a controller that answers to it, has
touched. So a delay or an elasticity gets no evidence from feedback. Innovations and columns are
averaged over blocks of rows that are short beside anything the columns do.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import cho_factor, cho_solve

from puma_sim_core.effects.screening import TORQUE_COLUMN, Candidate, Signals
from puma_sim_core.identify.fitting.prediction import Point, PredictionFit
from puma_sim_core.identify.screening.evidence import Entry, log_gain, scored_of
from puma_sim_core.identify.settings import SCREENING


class CausalScreen:
    """The innovations of one fitted model, ready to be asked for hypotheses.

    fit : `PredictionFit`; point : the model; errors (N, J): its white innovations; jacobian
    (N', p): their derivatives by the parameters, at the rows to fit, per deviation.
    """

    def __init__(self, fit: PredictionFit, point: Point, errors: np.ndarray, jacobian: np.ndarray, problem):
        self.fit = fit
        self.predictor = fit.predictor
        self.point = point
        self.problem = problem
        self.block = max(1, int(SCREENING.causal_block / self.predictor.step))
        self.errors = errors
        self._spectra: dict = {}
        rows = fit.rows
        self.J = errors.shape[1]
        self.lengths = self.predictor.lengths
        self.usable = [self._mean(rows[:, j].astype(float)[:, None])[:, 0] > 0.999 for j in range(self.J)]
        self.y = [self._blocks(errors[:, j : j + 1], j)[:, 0] for j in range(self.J)]
        p = jacobian.shape[1]
        self.jacobian = np.zeros((*errors.shape, p))
        self.jacobian[rows] = jacobian
        self.N = [self._blocks(self.jacobian[:, j], j) for j in range(self.J)]
        prior = np.full(p, 1e-4)
        prior[: len(fit.mechanism.start)] = 1.0
        A = np.diag(prior) + sum(N.T @ N for N in self.N)
        self.factor = cho_factor(A, lower=True)
        # the gradient of the prior: the fit need not have come to its very end
        m = fit.mechanism
        pull = np.zeros(p)
        pull[: len(m.start)] = (point.theta - m.start) / m.deviations
        self.Ny = sum(N.T @ y for N, y in zip(self.N, self.y)) + pull
        self.scaled = cho_solve(self.factor, self.Ny)
        self.signals = self._signals(point)

    def _mean(self, values: np.ndarray) -> np.ndarray:
        """(blocks, ...) means over blocks of rows, log by log."""
        parts, start = [], 0
        for n in self.lengths:
            k = n // self.block
            part = values[start : start + k * self.block]
            parts.append(part.reshape(k, self.block, *values.shape[1:]).mean(axis=1))
            start += n
        return np.concatenate(parts)

    def _blocks(self, values, joint) -> np.ndarray:
        return self._mean(values)[self.usable[joint]] * np.sqrt(self.block)

    def _signals(self, point: Point) -> Signals:
        """Signals of the motion that the observer predicts, voltages of the rows before."""
        f = self.fit
        plant = f.mechanism.plant(point.theta, point.effects)
        parts = self.predictor.tracked(plant)
        q = np.concatenate([t.position for t in parts])
        qd = np.concatenate([t.velocity for t in parts])
        qdd, volts, time, segment, enable = [], [], [], [], []
        for number, (t, s) in enumerate(zip(parts, self.predictor.stretches)):
            h = np.diff(s.time)[:, None]
            before = t.velocity + self.predictor.gain[:, 1] * t.innovation
            change = np.diff(t.velocity, axis=0, prepend=t.velocity[:1])
            change[1:] = t.velocity[1:] - before[:-1]
            qdd.append(change / h)
            volts.append(s.voltage[:-1])
            time.append(s.time[1:])
            segment.append(np.full(len(s.time) - 1, number))
            enable.append(np.ones_like(s.voltage[:-1]) if s.enable is None else s.enable[:-1])
        return self.problem.signals(
            point.theta,
            motion=(
                np.concatenate(time),
                self.predictor.step,
                np.concatenate(segment),
                np.concatenate(volts),
                np.concatenate(enable),
                q,
                qd,
                np.concatenate(qdd),
            ),
        )

    def columns(self, candidate: Candidate) -> dict[int, np.ndarray]:
        """Joint -> (b, p) white innovations that unit coefficients would make, in blocks."""
        return {j: self._blocks(full, j) for j, full in self._white(candidate).items()}

    def left(self, candidate: Candidate | None = None, coefficients=None) -> np.ndarray:
        """(N, J) white innovations at the rows to fit, 0 elsewhere, that a hypothesis leaves when
        the parameters have answered to it; None: that the parameters alone leave."""
        made = {} if candidate is None else {j: x @ coefficients for j, x in self._white(candidate).items()}
        pulled = self.Ny - sum(self.N[j].T @ self._blocks(x[:, None], j)[:, 0] for j, x in made.items())
        left = self.errors - self.jacobian @ cho_solve(self.factor, pulled)
        for j, x in made.items():
            left[:, j] -= x
        return np.where(self.fit.rows, left, 0.0)

    def volts(self, candidate: Candidate, coefficients) -> np.ndarray:
        """(N, J) voltage [V] of a hypothesis whose columns are voltages, at the rows before the
        innovations."""
        out = np.zeros_like(self.signals.voltage)
        for column, c in zip(candidate.columns, coefficients):
            for j, values in column.items():
                out[:, j] += c * values
        return out * self.signals.enable

    def _white(self, candidate: Candidate) -> dict[int, np.ndarray]:
        """Joint -> (N, p) white innovations that unit coefficients would make."""
        p = len(candidate.mean)
        joints = sorted({j for column in candidate.columns for j in column})
        s = self.signals
        out = {}
        for j in joints:
            full = np.zeros((len(s.time), p))
            for c, column in enumerate(candidate.columns):
                if j in column:
                    full[:, c] = column[j]
            if candidate.unit == TORQUE_COLUMN:
                full *= s.volts_per_torque[j]
                if s.lag[j] > 0.0:
                    full = full + s.lag[j] * np.gradient(full, s.step, axis=0)
            full *= s.enable[:, j : j + 1]
            start = 0
            for n in self.lengths:
                rows = slice(start, start + n)
                size, spectrum = self._spectrum(j, n)
                full[rows] = irfft(rfft(full[rows], size, axis=0) * spectrum, size, axis=0)[:n]
                start += n
            out[j] = full
        return out

    def _response(self, joint: int) -> np.ndarray:
        """White innovations of a joint after a volt in one row."""
        w = self.fit.weighting
        return np.convolve(self.predictor.responses[joint], w.filters[joint]) / w.scale[joint]

    def _spectrum(self, joint: int, rows: int) -> tuple[int, np.ndarray]:
        """Size of the transforms that convolve so many rows, and the response's one (f, 1)."""
        if (joint, rows) not in self._spectra:
            response = self._response(joint)
            size = next_fast_len(rows + len(response) - 1, real=True)
            self._spectra[joint, rows] = size, rfft(response, size)[:, None]
        return self._spectra[joint, rows]

    def score(self, name: str, joint: int | None, candidates, shifts=None):
        """`Scored` of one hypothesis, None without candidates; with shifts (k,), also the gains
        (k,) of placebos."""
        return self.score_columns(name, joint, [(c, self.columns(c)) for c in candidates], shifts)

    def score_columns(self, name, joint, pairs, shifts=None):
        """`score` for (candidate, its columns) pairs."""
        rows, chance = [], None
        for c, X in pairs:
            G, NX = self._gram(X)
            b = sum(x.T @ self.y[j] for j, x in X.items()) - NX.T @ self.scaled
            gain, coefficients, covariance = log_gain(G, b, c.mean, c.deviation)
            gain = float(gain) - np.log(c.tried)
            likelihood = 0.5 * float(coefficients @ (2.0 * b - G @ coefficients))
            entry = Entry(0, c, slice(0, len(c.mean)))
            rows.append((gain, entry, coefficients, covariance, likelihood))
            if shifts is not None:
                gains = self._placebo(c, X, NX, G, shifts) - np.log(c.tried)
                chance = gains if chance is None else np.logaddexp(chance, gains)
        if not rows:
            return None
        scored = scored_of(name, joint, rows)
        if shifts is None:
            return scored
        return scored, chance - np.log(len(rows))

    def chance(self, scored: list, shifts) -> float:
        """Greatest gain of placebos: the innovations after the best of several explanations,
        shifted in a circle, against all of them.

        scored : (`Scored`, its (candidate, columns) pairs) of each, the best one first.
        """
        best, pairs = scored[0]
        own = next(X for c, X in pairs if c is best.entry.candidate)
        left = [y.copy() for y in self.y]
        for j, x in own.items():
            left[j] -= x @ best.coefficients
        Ny = sum(N.T @ y for N, y in zip(self.N, left))
        left = [y - N @ cho_solve(self.factor, Ny) for y, N in zip(left, self.N)]
        ys = [np.column_stack([np.roll(y, int(s * len(y))) for s in shifts]) for y in left]
        pulled = cho_solve(self.factor, sum(N.T @ y for N, y in zip(self.N, ys)))
        greatest = 0.0
        for _, pairs in scored:
            total = None
            for c, X in pairs:
                G, NX = self._gram(X)
                b = sum(x.T @ ys[j] for j, x in X.items()) - NX.T @ pulled
                gain = log_gain(G, b, c.mean, c.deviation)[0]
                total = gain if total is None else np.logaddexp(total, gain)
            greatest = max(greatest, float(np.max(total - np.log(len(pairs)))))
        return greatest

    def gram(self, candidate: Candidate) -> np.ndarray:
        """(p, p) X'PX of a candidate."""
        return self._gram(self.columns(candidate))[0]

    def _gram(self, X):
        NX = sum(self.N[j].T @ x for j, x in X.items())
        return sum(x.T @ x for x in X.values()) - NX.T @ cho_solve(self.factor, NX), NX

    def block_times(self, joint: int) -> np.ndarray:
        """(b,) times [s] of the blocks of a joint."""
        return self._mean(self.signals.time)[self.usable[joint]]

    def response(self, joint: int, frequency: np.ndarray) -> np.ndarray:
        """Complex white innovation of a joint per volt at frequencies [Hz], blocks averaged."""
        h = self.predictor.step
        taps = self._response(joint)
        turn = np.exp(-2j * np.pi * np.outer(frequency, np.arange(len(taps))) * h)
        x = np.pi * np.asarray(frequency) * h * self.block
        return turn @ taps * np.sinc(x / np.pi) * np.sqrt(self.block)

    def _placebo(self, c, X, NX, G, shifts):
        ys, pulled = self._shifted(tuple(shifts))
        b = sum(x.T @ ys[j] for j, x in X.items()) - NX.T @ pulled
        return log_gain(G, b, c.mean, c.deviation)[0]

    @lru_cache(maxsize=2)
    def _shifted(self, shifts):
        """Innovations (J) shifted in a circle (b, k), and what the parameters make of them."""
        ys = [np.column_stack([np.roll(y, int(s * len(y))) for s in shifts]) for y in self.y]
        return ys, cho_solve(self.factor, sum(N.T @ y for N, y in zip(self.N, ys)))
