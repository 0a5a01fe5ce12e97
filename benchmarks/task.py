# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What every row of the bench does, and what a row is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from puma_sim_core.plant.plant import Plant

#: the step [s] of all rows
STEP = 0.001


class Unavailable(Exception):
    """A row cannot be measured here; the text says why."""


@dataclass(frozen=True)
class Task:
    """The three joints of `plant` from `state` under `voltages`, each held for one STEP.

    state (9,): positions [rad], velocities [rad/s], currents [A]; voltages (n, 3) [V].
    """

    plant: Plant
    state: np.ndarray
    voltages: np.ndarray

    @classmethod
    def default(cls, seconds: float = 10.0) -> Task:
        """The published arm without friction, moved over several radians by smooth voltages."""
        t = STEP * np.arange(round(seconds / STEP))
        voltages = np.stack(
            (9.0 * np.sin(1.3 * t), 3.0 + 8.0 * np.sin(0.9 * t + 2.0), 7.0 * np.sin(1.7 * t + 1.0)), axis=1
        )
        state = np.array([0.1, -0.4, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        return cls(Plant.of("bejczy"), state, voltages)

    @property
    def steps(self) -> int:
        """Number of steps."""
        return len(self.voltages)

    @property
    def seconds(self) -> float:
        """Length of the motion [s]."""
        return self.steps * STEP

    def shortened(self, seconds: float) -> Task:
        """The beginning of the same motion."""
        return Task(self.plant, self.state, self.voltages[: round(seconds / STEP)])


@dataclass
class Row:
    """One way of doing the task.

    Attributes
    ----------
    label : how it is called in the table.
    run : does it once; gives the final positions (3,) [rad].
    seconds : simulated time of one call, all arms of a batch together [s].
    motion : length of the motion [s], for the comparison with our arm.
    calls : calls in a round; a round's figure is their median.
    tolerance : distance from our final positions [rad] within which it is the same arm.
    note : what a reader must know to read the row rightly.
    measure : does it once as `run` does; gives (elapsed seconds, final positions). The default
        times `run`.
    ours : whether it is one of our own rows.
    compared : False where its arm is meant to end elsewhere than ours, with friction or in a batch.
    """

    label: str
    run: Callable[[], np.ndarray]
    seconds: float
    motion: float | None = None
    calls: int = 1
    tolerance: float = 1e-9
    note: str = ""
    ours: bool = False
    compared: bool = True
    measure: Callable[[], tuple[float, np.ndarray]] | None = None

    def __post_init__(self):
        if self.measure is None:
            self.measure = self._timed
        if self.motion is None:
            self.motion = self.seconds

    def _timed(self):
        start = perf_counter()
        result = self.run()
        return perf_counter() - start, result
