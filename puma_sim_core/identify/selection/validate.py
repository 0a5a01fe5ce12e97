# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Errors before and after: of voltages, and of positions in open loop.

In windows of half a second the model gets the voltages alone, from the state of its Kalman predictor, which holds what
no sensor shows. Windows overlap: what happens in a few rows must not fall between two of them.
"""

from collections.abc import Mapping

import numpy as np

from puma_sim_core.errors import NonFiniteStateError
from puma_sim_core.identify.arrays import Bools, Floats, runs
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise.open_loop import NoiseFloor, position_floor
from puma_sim_core.identify.parallel import parallel_map
from puma_sim_core.identify.result import Errors, StageErrors
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.settings import FITTING, SELECTION
from puma_sim_core.plant.plant import Plant

#: windows are run in so many turns, so that before each the predictor has its length to come back
_TURNS = round(2.0 * SELECTION.window / SELECTION.window_distance)


class Validation:
    """The windows of a problem's logs, those of the rows to fit and of the validation set apart."""

    def __init__(self, problem: Problem, predictor: Predictor):
        self.problem = problem
        self.predictor = predictor
        #: "fit" and "held_out" -> turns, each with the windows (number of the log, rows of its innovations) that are
        #: run together
        self.turns: dict[str, list[list[tuple[int, slice]]]] = {}
        for key in ("fit", "held_out"):
            turns: list[list[tuple[int, slice]]] = [[] for _ in range(_TURNS)]
            for number, stretch in enumerate(predictor.stretches):
                time, own = stretch.time[1:], problem.segment == number
                kept = problem.sampled.time[problem.kept[own]]
                for a, b in runs(problem.validation[own] == (key == "held_out")):
                    low, high = max(float(kept[a]), float(time[0]) + FITTING.settling_time), float(kept[b - 1])
                    for n, rows in enumerate(_windows(time, low, high)):
                        turns[n % _TURNS].append((number, rows))
            self.turns[key] = [turn for turn in turns if turn]

    def window_errors(self, plant: Plant, key: str) -> Floats:
        """(n, J) open-loop errors [rad or m] at the rows of the windows of "fit" or "held_out", turn by turn."""
        p = self.predictor

        def of(turn: list[tuple[int, slice]]) -> list[Floats]:
            corrected = [np.ones(n, dtype=bool) for n in p.lengths]
            for number, rows in turn:
                corrected[number][rows] = False
            try:
                parts = p.tracked(plant, corrected)
            except NonFiniteStateError:
                return [np.full((rows.stop - rows.start, plant.joints), SELECTION.not_finite) for _, rows in turn]
            return [parts[number].innovation[rows] for number, rows in turn]

        found = [part for turn in parallel_map(of, self.turns[key]) for part in turn]
        found.append(np.zeros((0, p.fit_rows.shape[1])))
        return np.clip(np.concatenate(found), -SELECTION.not_finite, SELECTION.not_finite)

    def volts(self, plant: Plant) -> Floats:
        """(N, J) voltages [V] that a plant lacks along the logs, at the rows of the innovations."""
        try:
            errors = self.predictor.errors(plant)
        except NonFiniteStateError:
            errors = np.full(self.predictor.fit_rows.shape, np.nan)
        return self.predictor.in_volts(errors, self.problem.sampled.cutoffs[1])

    def errors(self, plants: Mapping[str, Plant], residuals: Mapping[str, Floats], floor: NoiseFloor) -> Errors:
        """The table of errors of the rows that were fitted.

        plants, residuals : "nominal", "retuned", "augmented" -> plant, and `volts` of it; floor : what
        the noise of the fit leaves.
        """
        volts = {name: rms(values, self.predictor.fit_rows) for name, values in residuals.items()}
        windows = {name: rms(self.window_errors(plant, "fit")) for name, plant in plants.items()}
        least = position_floor(self.lengths("fit"), floor.spread)
        return Errors(StageErrors(**volts, floor=floor.volts), StageErrors(**windows, floor=least))

    def lengths(self, key: str) -> Floats:
        """(w,) rows of each window."""
        return np.array([rows.stop - rows.start for turn in self.turns[key] for _, rows in turn], dtype=int)


def rms(values: Floats, rows: Bools | None = None) -> Floats:
    """(J,) root mean squares of the rows (N, J) that count, None: of all; NaN without any."""
    rows = np.ones(values.shape, dtype=bool) if rows is None else rows
    counted = [own[counts] for own, counts in zip(values.T, rows.T)]
    return np.array([np.sqrt((own**2).mean()) if len(own) else np.nan for own in counted])


def _windows(time: Floats, low: float, high: float) -> list[slice]:
    """Rows of the windows that a span [s] holds: those after the start of each."""
    length = high - low
    if length < SELECTION.shortest_window:
        return []
    free = max(length - SELECTION.window, 0.0)
    starts = low + np.linspace(0.0, free, 1 + int(round(free / SELECTION.window_distance)))
    first, last = (
        np.searchsorted(time, edge, side="right").tolist() for edge in (starts, starts + min(SELECTION.window, length))
    )
    return [slice(a, b) for a, b in zip(first, last) if b - a >= SELECTION.window_rows]
