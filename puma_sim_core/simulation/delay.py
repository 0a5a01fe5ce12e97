# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Voltages on their way: what a delay of the input holds back.

An amplifier at the end of a delay of T seconds gets at t exactly what was asked for at t - T. T need be no multiple of
rows or samples: a row is integrated in the pieces between the moments at which the voltage that arrives changes. `Past`
does that for rows of any length, `SampledDelay` for samples of one length, as a servo gives them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.dynamics.laws import combined
from puma_sim_core.dynamics.runs import LATE_WIDTH
from puma_sim_core.effects.base import Point, Stage
from puma_sim_core.jit import BACKEND, interpreted
from puma_sim_core.simulation.run_inputs import native, step_counts

_delay: Callable[..., float] = combined(Point.DELAY, interpreted)
#: moments closer than this are one [s]
_SAME = 1e-10


def delay_of(active: int, table: Sequence[float]) -> float:
    """T [s] of a plant's stages and packed table; 0.0 without a delay."""
    return float(_delay(0, table)) if active & Stage.DELAYED else 0.0


class Pieces(NamedTuple):
    """Rows cut into pieces: time (k + 1,) [s], their voltage (k, 3) [V] as it arrives, and the
    number of each row's first edge among `time`, (n + 1,)."""

    time: np.ndarray
    voltage: np.ndarray
    row: np.ndarray


class Past:
    """The voltages that were asked for, as far as they may still be on their way.

    delay : T [s].
    age (k,) : falling; voltage (k, 3) [V]: asked for from age[i] seconds ago on, the first one
        since ever. Without any, the first voltage of a run counts as asked for since ever.
    """

    def __init__(self, delay: float, age: ArrayLike = (), voltage: ArrayLike = ()):
        self.delay = delay
        self.age = np.asarray(age, dtype=float)
        self.voltage = np.asarray(voltage, dtype=float).reshape(-1, 3)

    def before(self, age: float, default: Sequence[float]) -> tuple[float, ...]:
        """Voltages [V] that were asked for `age` seconds ago."""
        if not len(self.age):
            return tuple(default)
        n = int(np.searchsorted(-self.age, -age + _SAME, side="right")) - 1
        return tuple(self.voltage[max(n, 0)].tolist())

    def arriving(self, time: np.ndarray, voltage: np.ndarray) -> tuple[Pieces, Past]:
        """What arrives over rows of voltages, and the past at their end.

        time (n + 1,) [s]; voltage (n, 3) [V], asked for from time[r] on.
        """
        asked = np.concatenate([time[0] - self.age, time[:-1]])
        volts = np.concatenate([self.voltage, voltage])
        change = asked + self.delay
        inner = change[(change > time[0]) & (change < time[-1])]
        place = np.searchsorted(time, inner)
        after, before = (time[np.clip(n, low, len(time) - 1)] for n, low in ((place, 1), (place - 1, 0)))
        inner = inner[(after - inner > _SAME) & (inner - before > _SAME)]
        edges = np.concatenate([time, inner])
        order = np.argsort(edges, kind="stable")
        edges = edges[order]
        row = np.empty(len(order), dtype=np.int64)
        row[order] = np.arange(len(order))
        acts = np.searchsorted(change, edges[:-1] + _SAME, side="right") - 1
        kept = max(int(np.searchsorted(change, time[-1] + _SAME, side="right")) - 1, 0)
        later = Past(self.delay, time[-1] - asked[kept:], volts[kept:])
        return Pieces(edges, volts[np.maximum(acts, 0)], row[: len(time)]), later


class Measured(NamedTuple):
    """Pieces of rows: their edges (k + 1,) [s], the voltages (k, 3) [V] that arrive, the row (k,) that each is of, and
    the row (k,) at whose end it ends, -1 for a piece that ends within one."""

    edges: np.ndarray
    voltage: np.ndarray
    row: np.ndarray
    target: np.ndarray


def measured_rows(past: Past, time: np.ndarray, voltage: np.ndarray) -> Measured:
    """The pieces of rows that a motion is measured at, time (n + 1,) [s], with voltages (n, 3) [V] that arrive late."""
    rows = np.arange(len(voltage))
    if not past.delay:
        return Measured(time, voltage, rows, rows)
    pieces, _ = past.arriving(time, voltage)
    target = np.full(len(pieces.voltage), -1)
    target[pieces.row[1:] - 1] = rows
    row = np.searchsorted(pieces.row, np.arange(len(target)), side="right") - 1
    return Measured(pieces.time, pieces.voltage, np.clip(row, 0, len(rows) - 1), target)


class SampledDelay:
    """The delay of a loop with samples of one length.

    With T = M sample + f, the part f of each sample still sees the voltage asked for M + 1 samples
    ago, the rest that of M samples ago.

    delay : T [s]; sample [s]; max_step : greatest step of integration [s]; compiled : the form of `table`.
    counts, steps : of integration in the two parts of a sample, and their length [s].
    table : for `runs.run_servo`: steps and their length [s] in the first part, in the rest, M + 1,
        and, joint by joint, the M + 1 voltages [V] that are on their way, the oldest first.
    """

    def __init__(self, delay: float, sample: float, max_step: float, compiled: bool = BACKEND == "numba"):
        self.delay, self._compiled = delay, compiled
        whole = int((delay + _SAME) / sample)
        first = max(delay - whole * sample, 0.0)
        first = 0.0 if first <= _SAME else first
        self._sample = sample
        self.size = whole + 1
        parts = (first, sample - first)
        self.counts = [int(step_counts(np.array([part]), max_step)[0]) if part > 0.0 else 0 for part in parts]
        self.steps = [part / count if count else 0.0 for part, count in zip(parts, self.counts)]
        self.hold((0.0, 0.0, 0.0))

    def hold(self, voltage: Sequence[float], past: Past | None = None) -> None:
        """Start with what `past` says was asked for, and `voltage` [V] where it says nothing."""
        rows = [
            tuple(map(float, voltage)) if past is None else past.before((self.size - n - 0.5) * self._sample, voltage)
            for n in range(self.size)
        ]
        #: what arrived before the first sample
        self.first = rows[0]
        late = (row[j] for j in range(3) for row in rows)
        head = [self.counts[0], self.steps[0], self.counts[1], self.steps[1], self.size]
        self.table = native([*head, *late], self._compiled)

    def past(self, delay: float) -> Past:
        """What is on its way, as the `Past` of a simulator."""
        held = np.array(self.table[LATE_WIDTH:], dtype=float).reshape(3, self.size).T
        return Past(delay, self._sample * np.arange(self.size, 0, -1), held)

    def take(self, voltage: Sequence[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Voltages [V] that arrive in the two parts of a sample in which `voltage` is asked for."""
        held = np.array(self.table[LATE_WIDTH:], dtype=float).reshape(3, self.size)
        oldest = tuple(held[:, 0].tolist())
        held[:, :-1] = held[:, 1:]
        held[:, -1] = voltage
        self.table[LATE_WIDTH:] = held.ravel() if self._compiled else held.ravel().tolist()
        return oldest, tuple(held[:, 0].tolist())


#: stands for the delay in calls of `runs.run_servo` without one
NO_DELAY = (0.0,) * LATE_WIDTH
