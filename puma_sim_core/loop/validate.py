# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Errors before and after, on the rows that were fitted and on those that were kept back (step 7)."""

from __future__ import annotations

import numpy as np

from .result import Errors, StageErrors
from .windows import Windows, run_windows

#: length of an open-loop window [s], and the shortest one that counts
_WINDOW, _SHORTEST = 0.5, 0.3
#: standard deviations of the noise of a smoothed start position, as a share of a raw sample's
_SMOOTHED = 0.3
_SETTLED = 0.15


class Validation:
    """The windows of a problem's logs, fit and held out apart."""

    def __init__(self, problem, logs, seed: int):
        self.problem = problem
        self.seed = seed
        self.windows = {"fit": [], "held_out": []}
        s = problem.sampled
        for number, (log, rows) in enumerate(zip(logs, s.stretches)):
            kept = problem.kept[problem.segment == number]
            time, held = s.time[kept], problem.held[problem.segment == number]
            for key, inside in (("fit", ~held), ("held_out", held)):
                spans = _spans(time, inside)
                starts, ends = _windows(log.time, spans)
                if len(starts):
                    at = log.time[starts]
                    motion = tuple(np.column_stack([
                        np.interp(at, s.time[rows], a[rows, j]) for j in range(s.joints)])
                        for a in (s.position, s.velocity, s.acceleration))
                    self.windows[key].append(Windows.of(
                        log.time, log.voltage, log.position, log.enable, starts=starts,
                        ends=ends, motion=motion))

    def position_rms(self, plant, key: str) -> np.ndarray:
        """(J,) of the open-loop windows of "fit" or "held_out"; NaN without any."""
        squares, count = 0.0, 0
        for windows in self.windows[key]:
            error = run_windows(plant, windows).error
            squares, count = squares + (error ** 2).sum(axis=0), count + len(error)
        J = self.problem.sampled.joints
        return np.sqrt(squares / count) if count else np.full(J, np.nan)

    def position_floor(self, plant, key: str, volts: np.ndarray) -> np.ndarray:
        """(J,) what noise alone makes of the windows: the model against itself with the noise of
        voltage (J,) [V a row] and of the start state."""
        s, rng = self.problem.sampled, np.random.default_rng(self.seed)
        squares, count = 0.0, 0
        for w in self.windows[key]:
            clean = run_windows(plant, w)
            noisy = Windows.of(
                w.time, w.voltage + volts * rng.standard_normal(w.voltage.shape), w.position,
                w.enable, starts=w.starts, ends=w.ends,
                motion=(w.start_position + _SMOOTHED * s.position_noise
                        * rng.standard_normal(w.start_position.shape),
                        w.start_velocity + s.velocity_noise
                        * rng.standard_normal(w.start_velocity.shape), w.start_acceleration))
            moved = run_windows(plant, noisy)
            for a, b in zip(clean.predicted, moved.predicted):
                d = (a - b)[1:]
                squares, count = squares + (d ** 2).sum(axis=0), count + len(d)
        return (np.sqrt(squares / count + s.position_noise ** 2) if count
                else np.full(s.joints, np.nan))

    def errors(self, plants: dict, residuals: dict, predictor, volts: np.ndarray,
               floor: np.ndarray) -> dict[str, Errors]:
        """Both tables.

        plants, residuals : "nominal", "retuned", "augmented" -> plant, and the voltages (N, J) [V]
        that it lacks at the observer's rows; volts (J,): noise of a row's voltage; floor (J,): that
        of the residual [V].
        """
        result = {}
        for key, rows in (("fit", predictor.fit_rows), ("held_out", predictor.held_rows)):
            position = {name: self.position_rms(plant, key) for name, plant in plants.items()}
            voltage = {name: _rms(values, rows) for name, values in residuals.items()}
            result[key] = Errors(
                StageErrors(**voltage, floor=floor),
                StageErrors(**position,
                            floor=self.position_floor(plants["augmented"], key, volts)))
        return result


def _rms(values, rows) -> np.ndarray:
    """(J,) root mean squares of the rows (N, J) that count; NaN without any."""
    return np.array([np.sqrt((values[rows[:, j], j] ** 2).mean()) if rows[:, j].any() else np.nan
                     for j in range(values.shape[1])])


def _spans(time, inside) -> list[tuple[float, float]]:
    """(from, to) [s] of the stretches in which `inside` holds."""
    change = np.flatnonzero(np.diff(np.r_[0, inside.astype(int), 0]))
    return [(float(time[a]), float(time[b - 1])) for a, b in zip(change[::2], change[1::2])]


def _windows(time, spans) -> tuple[list[int], list[int]]:
    """First and last rows of windows that lie within the spans."""
    starts, ends = [], []
    for low, high in spans:
        low = max(low, float(time[0]) + _SETTLED)
        count = max(1, int((high - low) / _WINDOW))
        length = min(_WINDOW, high - low)
        if length < _SHORTEST:
            continue
        for k in range(count):
            a = int(np.searchsorted(time, low + k * length))
            b = int(np.searchsorted(time, low + (k + 1) * length, side="right")) - 1
            if b > a + 3:
                starts.append(a)
                ends.append(b)
    return starts, ends
