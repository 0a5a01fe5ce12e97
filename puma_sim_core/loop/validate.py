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
        #: for each log: the number of the window that a row of the observer is in, -1 for none
        self.windows: list[np.ndarray] = []
        masks: dict[str, list[np.ndarray]] = {"fit": [], "held_out": []}
        count = 0
        for number, stretch in enumerate(predictor.stretches):
            time = stretch.time[1:]
            inside = np.full(len(time), -1)
            own = problem.segment == number
            kept, held = problem.sampled.time[problem.kept[own]], problem.held[own]
            spans = sorted((*span, key) for key, chosen in (("fit", ~held), ("held_out", held))
                           for span in _spans(kept, chosen))
            for mask in masks.values():
                mask.append(np.zeros(len(time), dtype=bool))
            for low, high, key in spans:
                for rows in _windows(time, max(low, float(time[0]) + SETTLING), high):
                    inside[rows] = count
                    masks[key][-1][rows] = True
                    count += 1
            self.windows.append(inside)
        #: rows (N,) of the observer in the windows of "fit" and of "held_out"
        self.rows = {key: np.concatenate(parts) for key, parts in masks.items()}

    def position_errors(self, plant) -> np.ndarray:
        """(N, J) open-loop errors [rad or m] at the observer's rows, 0 outside the windows.

        Windows take turns, so that before each the observer has had time to come back.
        """
        p = self.predictor
        total = np.zeros(p.fit_rows.shape)
        for turn in (0, 1):
            free = [(w >= 0) & (w % 2 == turn) for w in self.windows]
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

    def position_rms(self, plant, key: str) -> np.ndarray:
        """(J,) of the open-loop windows of "fit" or "held_out"; NaN without any."""
        return self._rms(self.position_errors(plant), key)

    def _rms(self, errors, key) -> np.ndarray:
        rows = self.rows[key]
        return (np.sqrt((errors[rows] ** 2).mean(axis=0)) if rows.any()
                else np.full(errors.shape[1], np.nan))

    def position_floor(self, key: str, volts: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """(J,) what noise alone makes of the windows, each joint by itself: that of the voltages
        volts (J,) [V a row] and of the sensor's positions noise (J,), before the start, which they
        make uncertain, and after it. NaN without windows."""
        number = np.concatenate(self.windows)
        lengths = np.unique(number[self.rows[key]], return_counts=True)[1]
        if not len(lengths):
            return np.full(len(noise), np.nan)
        spread = self.predictor.open_loop_variance(volts, noise, int(lengths.max()))
        total = np.cumsum(spread, axis=0)[lengths - 1].sum(axis=0)
        return np.sqrt(total / lengths.sum())

    def errors(self, plants: dict, residuals: dict, floor: np.ndarray) -> dict[str, Errors]:
        """Both tables.

        plants, residuals : "nominal", "retuned", "augmented" -> plant, and the voltages (N, J) [V]
        that it lacks at the observer's rows; floor (J,): noise of the residual [V].
        """
        p, result = self.predictor, {}
        left = np.where(p.fit_rows, p.errors(plants["augmented"]), np.nan)
        volts, noise = p.noise_behind(np.nanvar(left, axis=0), self.problem.sampled.position_noise)
        # what a remainder leaves in the innovations is no noise, nor is all that came before a name
        volts = np.minimum(volts, p.volts)
        open_loop = {name: self.position_errors(plant) for name, plant in plants.items()}
        for key, rows in (("fit", p.fit_rows), ("held_out", p.held_rows)):
            position = {name: self._rms(errors, key) for name, errors in open_loop.items()}
            voltage = {name: rms(values, rows) for name, values in residuals.items()}
            result[key] = Errors(
                StageErrors(**voltage, floor=floor),
                StageErrors(**position, floor=self.position_floor(key, volts, noise)))
        return result


def rms(values, rows) -> np.ndarray:
    """(J,) root mean squares of the rows (N, J) that count; NaN without any."""
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
