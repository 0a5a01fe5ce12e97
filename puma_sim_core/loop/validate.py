# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Errors before and after, on the rows that were fitted and on those that were kept back (step 7).

The residual in volts, and the error of the position in open loop: in windows of half a second the
model sees the voltages alone. Each starts from the state to which the model's own observer has come
along the log, which holds what no sensor shows: currents, bristles, where in its play a gear is.
"""

from __future__ import annotations

import numpy as np

from ..errors import NonFiniteStateError
from .predictor import SETTLING
from .result import Errors, StageErrors

#: length of an open-loop window [s], and the shortest one that counts
_WINDOW, _SHORTEST = 0.5, 0.3
#: what an error of position is set to where the state does not stay finite [rad or m]
FAR_OFF = 1e3


class Validation:
    """The windows of a problem's logs, fit and held out apart.

    problem : `Problem`; predictor : `Predictor` of the same logs.
    """

    def __init__(self, problem, predictor):
        self.problem = problem
        self.predictor = predictor
        #: for "fit" and "held_out", for each log: the number of the window that a row of the
        #: observer is in, -1 for none
        self.windows: dict[str, list[np.ndarray]] = {"fit": [], "held_out": []}
        for number, stretch in enumerate(predictor.stretches):
            time = stretch.time[1:]
            own = problem.segment == number
            kept, held = problem.sampled.time[problem.kept[own]], problem.held[own]
            for key, chosen in (("fit", ~held), ("held_out", held)):
                spans = [_windows(time, max(low, float(time[0]) + SETTLING), high)
                         for low, high in _spans(kept, chosen)]
                inside = np.full(len(time), -1)
                for span in spans:
                    # those beside each other take turns; the first of every span is even
                    first = inside.max() + 2 - inside.max() % 2 if inside.max() >= 0 else 0
                    for n, rows in enumerate(span):
                        inside[rows] = first + n
                self.windows[key].append(inside)
        #: rows (N,) of the observer in the windows of each
        self.rows = {key: np.concatenate(parts) >= 0 for key, parts in self.windows.items()}

    def position_errors(self, plant, key: str) -> np.ndarray:
        """(N, J) open-loop errors [rad or m] at the observer's rows, 0 outside the windows of "fit"
        or "held_out".

        Windows take turns, so that before each the observer has had time to come back.
        """
        p = self.predictor
        total = np.zeros(p.fit_rows.shape)
        for turn in (0, 1):
            free = [(w >= 0) & (w % 2 == turn) for w in self.windows[key]]
            open_loop = np.concatenate(free)
            if not open_loop.any():
                continue
            try:
                parts = p.tracked(plant, [~rows for rows in free])
                errors = np.concatenate([part.innovation for part in parts])
            except NonFiniteStateError:
                errors = np.full(total.shape, FAR_OFF)
            total[open_loop] = np.clip(errors[open_loop], -FAR_OFF, FAR_OFF)
        return total

    def window_errors(self, plant, key: str) -> np.ndarray:
        """(n, J) open-loop errors [rad or m] at the rows of the windows alone."""
        return self.position_errors(plant, key)[self.rows[key]]

    def volts(self, plant) -> np.ndarray:
        """(N, J) voltages [V] that a plant lacks along the logs, at the rows of the observer."""
        try:
            errors = self.predictor.errors(plant)
        except NonFiniteStateError:
            errors = np.full(self.predictor.fit_rows.shape, np.nan)
        return self.predictor.in_volts(errors, self.problem.sampled.cutoffs[1])

    def errors(self, plants: dict, residuals: dict, floor: np.ndarray, noise) -> Errors:
        """The table of the rows that were fitted.

        plants, residuals : "nominal", "retuned", "augmented" -> plant, and `volts` of it; floor
        (J,): noise of the residual [V]; noise: ((J,), (J,)), as for `position_floor`.
        """
        windows = {name: self.window_errors(plant, "fit") for name, plant in plants.items()}
        return Errors(
            StageErrors(**{name: rms(values, self.predictor.fit_rows)
                           for name, values in residuals.items()}, floor=floor),
            StageErrors(**{name: rms(values) for name, values in windows.items()},
                        floor=position_floor(self.predictor, self.lengths("fit"), *noise)))

    def lengths(self, key: str) -> np.ndarray:
        """(w,) rows of each window."""
        counts = [np.unique(inside[inside >= 0], return_counts=True)[1]
                  for inside in self.windows[key]]
        return np.concatenate(counts)


def position_floor(predictor, lengths, volts, noise) -> np.ndarray:
    """(J,) what noise alone makes of windows of so many rows (w,), each joint by itself: that of
    the voltages volts (J,) [V a row] and of the sensor's positions noise (J,), before the start,
    which they make uncertain, and after it. NaN without windows."""
    if not len(lengths):
        return np.full(len(noise), np.nan)
    spread = predictor.open_loop_variance(volts, noise, int(lengths.max()))
    total = np.cumsum(spread, axis=0)[lengths - 1].sum(axis=0)
    return np.sqrt(total / lengths.sum())


def rms(values, rows=None) -> np.ndarray:
    """(J,) root mean squares of the rows (N, J) that count, None: of all; NaN without any."""
    rows = np.ones(values.shape, dtype=bool) if rows is None else rows
    return np.array([np.sqrt((values[rows[:, j], j] ** 2).mean()) if rows[:, j].any() else np.nan
                     for j in range(values.shape[1])])


def _spans(time, inside) -> list[tuple[float, float]]:
    """(from, to) [s] of the stretches in which `inside` holds."""
    change = np.flatnonzero(np.diff(np.r_[0, inside.astype(int), 0]))
    return [(float(time[a]), float(time[b - 1])) for a, b in zip(change[::2], change[1::2])]


def _windows(time, low, high) -> list[slice]:
    """Rows of the windows that a span [s] holds: those after the start of each."""
    length = high - low
    if length < _SHORTEST:
        return []
    count = max(1, int(length / _WINDOW))
    edges = low + min(_WINDOW, length) * np.arange(count + 1)
    rows = np.searchsorted(time, edges, side="right")
    return [slice(a, b) for a, b in zip(rows[:-1].tolist(), rows[1:].tolist()) if b > a + 3]
