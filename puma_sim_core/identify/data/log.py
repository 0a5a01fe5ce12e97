# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A measured log: times, voltages and positions of a machine, and what else was recorded."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from puma_sim_core.identify.arrays import Floats, Ints
from puma_sim_core.identify.settings import DATA

#: what has an entry for each row
_BY_ROW = ("time", "voltage", "position", "velocity", "current", "setpoint", "link_position", "enable", "lines", "rows")


@dataclass(frozen=True)
class Log:
    """A measured log: n rows, J joints.

    name : the path that was read; time (n,) [s]; voltage (n, J) [V]; position (n, J) [rad or m];
    velocity, current, setpoint, enable : (n, J), or None where the log has none of them.
    link_position (n, J) : of the sensors on the link's side [rad or m], NaN of joints without; None without any.
    lines (n,) : line of each row in its file, None for a bag.
    quantum (J,) : step of the encoder in `position`, 0.0 where none can be seen.
    notes : what was left out or changed, as sentences. rows (n,) : number of each row in the log that was read, from 1.
    """

    name: str
    time: Floats
    voltage: Floats
    position: Floats
    velocity: Floats | None = None
    current: Floats | None = None
    setpoint: Floats | None = None
    link_position: Floats | None = None
    enable: Floats | None = None
    lines: Ints | None = None
    quantum: Floats = field(default_factory=lambda: np.zeros(0))
    notes: tuple[str, ...] = ()
    rows: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __post_init__(self) -> None:
        if len(self.quantum) == 0:
            object.__setattr__(self, "quantum", np.array([encoder_step(column) for column in self.position.T]))
        if len(self.rows) != len(self.time):
            object.__setattr__(self, "rows", np.arange(1, len(self.time) + 1))

    def __len__(self) -> int:
        return len(self.time)

    @property
    def joints(self) -> int:
        """Number of joints J."""
        return self.position.shape[1]

    @property
    def span(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def step(self) -> float:
        """Time from a row to the next [s]: the median of those that increase, 0.0 without any."""
        steps = np.diff(self.time)
        steps = steps[steps > 0.0]
        return float(np.median(steps)) if len(steps) else 0.0

    @property
    def extent(self) -> str:
        """Its rows and its span, for people."""
        return f"{len(self)} {'row' if len(self) == 1 else 'rows'} over {self.span:.4g} s"

    def row(self, index: int) -> int:
        """Number of the row with an index from 0; rows of a log count from 1."""
        return int(self.rows[index])

    def part(self, rows: slice | Ints) -> Log:
        """Some rows in their order, as a log."""
        own = {name: getattr(self, name) for name in _BY_ROW}
        taken: dict[str, Any] = {name: None if values is None else values[rows] for name, values in own.items()}
        return replace(self, **taken)

    def place(self, index: int) -> str:
        """Row and, for a file, line of the row with an index from 0, for sentences."""
        row = f"row {self.row(index)}"
        return row if self.lines is None else f"{row} (line {self.lines[index]})"


def channels(group: str, joints: int) -> list[str]:
    """Names of a group's channels, one a joint."""
    return [f"{group}{j}" for j in range(1, joints + 1)]


def changes(position: Floats) -> Floats:
    """(k,) magnitudes of the changes from row to row of an (n,) series of positions, without those of rounding."""
    steps = np.abs(np.diff(position))
    return steps[steps > 1e-9 * max(float(np.max(np.abs(position), initial=0.0)), 1e-12)]


def step_of_few(steps: Floats, rows: int) -> float:
    """Step of the encoder of a joint that all but rests, by its few changes (k,): the least of them, since a reading
    without steps repeats in no row; 0.0 without any."""
    return float(steps.min()) if 0 < steps.size < DATA.encoder_repeated * rows else 0.0


def encoder_step(position: Floats) -> float:
    """Step of the encoder that an (n,) series of positions shows, 0.0 where it shows none.

    Differences of quantised positions are whole multiples of the step; text with few digits blurs them a little.
    """
    finite = position[np.isfinite(position)]
    steps = np.sort(changes(finite))
    if steps.size < DATA.encoder_changes:
        return step_of_few(steps, finite.size)
    step = float(steps[: max(1, steps.size // 50)].mean())
    for reach in DATA.encoder_reaches:
        near = steps[steps < reach * step]
        counts = np.round(near / step)
        if not counts.any():  # none that is near
            return 0.0
        step = float((near * counts).sum() / (counts * counts).sum())
    near = steps[steps < DATA.encoder_reaches[-1] * step]
    off = np.abs(near / step - np.round(near / step))
    whole = near.size >= DATA.encoder_changes and np.mean(off < 0.1) > 0.95 and float(near[0]) > 0.5 * step
    return step if whole else 0.0
