# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a recorder on the controller board gives of one joint (section 7.8), and its file."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.checks import check_choice, check_positive, check_shapes, check_whole
from puma_sim_core.errors import RecordingError
from puma_sim_core.recording.recording import read_columns

#: fewer samples than this identify nothing
FEWEST = 16
#: greatest difference of a sample time from its place, as a share of the period
_JITTER = 0.05
_GROUPS = ("setpoint", "position", "voltage")
_OTHERS = ("velocity", "current")


@dataclass(frozen=True)
class ControllerLog:
    """Samples of one joint's controller, evenly spaced.

    period : h [s]. setpoint, position (n,) [rad]: what the controller read; voltage (n,) [V]: what
    it gave for them. where : names the record in errors.

    Raises RecordingError: unequal lengths, fewer than 16 samples, numbers that are not finite.
    """

    period: float
    setpoint: np.ndarray
    position: np.ndarray
    voltage: np.ndarray
    where: str = "log"

    def __post_init__(self) -> None:
        if not (np.isfinite(self.period) and self.period > 0.0):
            raise RecordingError(f"period {self.period!r} s", where=self.where, expected="a positive number")
        given = {name: np.array(getattr(self, name), dtype=float) for name in _GROUPS}
        for name, values in zip(given, check_shapes("(n,)", self.where, RecordingError, **given)):
            object.__setattr__(self, name, values)
        if len(self) < FEWEST:
            expected = f"at least {FEWEST}, better some thousands"
            raise RecordingError(f"{len(self)} samples", where=self.where, expected=expected)

    def __len__(self) -> int:
        return len(self.voltage)

    @property
    def error(self) -> np.ndarray:
        """(n,) setpoint less position [rad]."""
        return self.setpoint - self.position

    def with_counts(self, step: float) -> ControllerLog:
        """The positions rounded to an encoder's step [rad], as the controller read them.

        Raises ParameterError: a step that is not positive.
        """
        check_positive(step, "step", "rad", "step of the positions")
        return replace(self, position=np.floor(self.position / step + 0.5) * step)

    def with_delay(self, samples: int) -> ControllerLog:
        """Each voltage beside the sample that it answers, for a controller that is late.

        samples : by which the recorded voltage is later than the setpoint and position it is for.

        Raises ParameterError: a number that is negative or leaves fewer than 16 samples.
        """
        kept = len(self) - check_whole(samples, "samples", 0, len(self) - FEWEST, where="delay")
        first = {"setpoint": self.setpoint[:kept], "position": self.position[:kept]}
        return replace(self, **first, voltage=self.voltage[samples:])  # type: ignore[arg-type]


def lattice_step(values: np.ndarray) -> float:
    """The step of which all differences of the values are multiples; 0.0 where there is none."""
    levels = np.unique(values)
    if len(levels) < 3:
        return 0.0
    gaps = np.diff(levels)
    # levels that differ by rounding alone are one level
    gaps = gaps[gaps > 1e-9 * (levels[-1] - levels[0])]
    for part in range(1, 9):  # the least gap of a short record may be several steps
        step = float(gaps.min()) / part
        multiples = gaps / step
        if np.abs(multiples - np.round(multiples)).max() < 1e-3:
            span = float(levels[-1] - levels[0])
            return span / round(span / step)
    return 0.0


def even_period(time: np.ndarray, where: str) -> float:
    """The period [s] of evenly spaced times; raises RecordingError, which names the first gap."""
    steps = np.diff(time)
    period = float(np.median(steps))
    uneven = np.flatnonzero(np.abs(steps - period) > _JITTER * period)
    if uneven.size:
        row = int(uneven[0])
        what = f"{steps[row] * 1e3:.6g} ms after {time[row]:.9g} s"
        expected = f"evenly spaced samples, here {period * 1e3:.6g} ms apart (one row a sample, none left out)"
        raise RecordingError(what, where=where, expected=expected)
    # the mean of all, since printed times are rounded
    return float((time[-1] - time[0]) / (len(time) - 1))


def read_controller_log(path: str | os.PathLike[str], joint: int | None = None) -> ControllerLog:
    """Read columns time, setpoint, position, voltage, or setpoint1..3 and so on with a joint.

    One row a sample of the controller [s, rad, rad, V]. The last row is left out: its voltage
    holds until a next row, and recorders that have none repeat the one before.

    Raises
    ------
    RecordingError : as `recording.read_csv`; samples that are not evenly spaced; numbered columns without a joint.
    ParameterError : a joint other than 1, 2, 3.
    """
    if joint is not None:
        check_choice(joint, "joint", (1, 2, 3))
    numbered, others = ([f"{group}{j}" for group in groups for j in (1, 2, 3)] for groups in (_GROUPS, _OTHERS))
    table = read_columns(path, ((_GROUPS, _OTHERS), (numbered, others)))
    single = _GROUPS[0] in table
    if single and joint is not None:
        expected = "columns setpoint1..3, position1..3, voltage1..3, or no joint"
        raise RecordingError(f"joint {joint} of a log of one joint", where=str(path), expected=expected)
    if not single and joint is None:
        raise RecordingError("has the columns of three joints", where=str(path), expected="--joint 1, 2 or 3")
    rows = len(table["time"])
    if rows <= FEWEST:
        expected = f"more than {FEWEST}, better some thousands"
        raise RecordingError(f"{rows} rows", where=str(path), expected=expected)
    setpoint, position, voltage = (table[group if single else f"{group}{joint}"][:-1] for group in _GROUPS)
    where = str(path) if joint is None else f"{path}, joint {joint}"
    return ControllerLog(even_period(table["time"], str(path)), setpoint, position, voltage, where)
