# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Errors before and after: of voltages, and of positions in open loop (step 7).

In windows of half a second the model sees the voltages alone. Each starts from the state to which
the model's own observer has come along the log, which holds what no sensor shows: currents,
bristles, where in its play a gear is. Windows overlap: what happens in a few rows, such as the
touch of a stop, must not fall between two of them.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.errors import NonFiniteStateError
from puma_sim_core.identify.fitting.predictor import SETTLING
from puma_sim_core.identify.parallel import each
from puma_sim_core.identify.result import Errors, StageErrors

#: length of an open-loop window [s], the shortest one that counts, and how far the next begins
_WINDOW, _SHORTEST, _HOP = 0.5, 0.3, 0.125
#: windows are run in so many turns, so that before each the observer has its length to come back
_TURNS = round(2.0 * _WINDOW / _HOP)
#: what an error of position is set to where the state does not stay finite [rad or m]
FAR_OFF = 1e3


class Validation:
    """The windows of a problem's logs, fit and held out apart.

    problem : `Problem`; predictor : `Predictor` of the same logs.
    """

    def __init__(self, problem, predictor):
        self.problem = problem
        self.predictor = predictor
        #: "fit" and "held_out" -> turns, each with the windows (number of the log, rows of its
        #: observer) that are run together
        self.turns: dict[str, list[list[tuple[int, slice]]]] = {}
        for key in ("fit", "held_out"):
            turns: list[list[tuple[int, slice]]] = [[] for _ in range(_TURNS)]
            for number, stretch in enumerate(predictor.stretches):
                time = stretch.time[1:]
                own = problem.segment == number
                chosen = problem.held[own] == (key == "held_out")
                for low, high in _spans(problem.sampled.time[problem.kept[own]], chosen):
                    found = _windows(time, max(low, float(time[0]) + SETTLING), high)
                    for n, rows in enumerate(found):
                        turns[n % _TURNS].append((number, rows))
            self.turns[key] = [turn for turn in turns if turn]

    def window_errors(self, plant, key: str) -> np.ndarray:
        """(n, J) open-loop errors [rad or m] at the rows of the windows of "fit" or "held_out",
        turn by turn."""
        p = self.predictor

        def of(turn) -> list[np.ndarray]:
            corrected = [np.ones(n, dtype=bool) for n in p.lengths]
            for number, rows in turn:
                corrected[number][rows] = False
            try:
                parts = p.tracked(plant, corrected)
            except NonFiniteStateError:
                return [np.full((rows.stop - rows.start, plant.joints), FAR_OFF) for _, rows in turn]
            return [parts[number].innovation[rows] for number, rows in turn]

        found = [errors for turn in each(of, self.turns[key]) for errors in turn]
        found.append(np.zeros((0, p.fit_rows.shape[1])))
        return np.clip(np.concatenate(found), -FAR_OFF, FAR_OFF)

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
            StageErrors(
                **{name: rms(values, self.predictor.fit_rows) for name, values in residuals.items()}, floor=floor
            ),
            StageErrors(
                **{name: rms(values) for name, values in windows.items()},
                floor=position_floor(self.predictor, self.lengths("fit"), *noise),
            ),
        )

    def lengths(self, key: str) -> np.ndarray:
        """(w,) rows of each window."""
        return np.array([rows.stop - rows.start for turn in self.turns[key] for _, rows in turn], dtype=int)


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
    return np.array(
        [np.sqrt((values[rows[:, j], j] ** 2).mean()) if rows[:, j].any() else np.nan for j in range(values.shape[1])]
    )


def _spans(time, inside) -> list[tuple[float, float]]:
    """(from, to) [s] of the stretches in which `inside` holds."""
    change = np.flatnonzero(np.diff(np.r_[0, inside.astype(int), 0]))
    return [(float(time[a]), float(time[b - 1])) for a, b in zip(change[::2], change[1::2])]


def _windows(time, low, high) -> list[slice]:
    """Rows of the windows that a span [s] holds: those after the start of each."""
    length = high - low
    if length < _SHORTEST:
        return []
    free = max(length - _WINDOW, 0.0)
    starts = low + np.linspace(0.0, free, 1 + int(round(free / _HOP)))
    first, last = (
        np.searchsorted(time, edge, side="right").tolist() for edge in (starts, starts + min(_WINDOW, length))
    )
    return [slice(a, b) for a, b in zip(first, last) if b > a + 3]
