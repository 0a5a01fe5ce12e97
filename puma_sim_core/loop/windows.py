# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Open-loop windows of a log by simulation: how far the model is from the measured positions.

As `puma_sim_core.restart`, for any mechanism, and made for a fit that asks hundreds of times: what
does not depend on the plant (voltages, the measured motion where each window starts) is prepared
once, and each window is one call of the compiled kernel.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..errors import NonFiniteStateError, ParameterError
from ..plant import Plant
from ..restart import driven_current, local_motion, tell_past, true_start
from ..simulator import Simulator

#: greatest step of integration [s]: a row of 1 ms is one step. RK4 is stable up to 8.4 ms, and its
#: error at 1 ms is far below any sensor's noise
WINDOW_STEP = 1.2e-3
#: explicit steps of integration stay below so many time constants of a winding
_STABLE = 2.0
#: greatest error that a row counts with, and that of a window whose simulated state did not stay
#: finite [rad or m]
FAR_OFF = 1e3


@dataclass(frozen=True, eq=False)
class Windows:
    """Stretches of a log that are simulated from the measured state; `Windows.of` makes them.

    time (n,) [s]; voltage (n, J) [V]; position (n, J) [rad or m]; enable (n, J), 0.0 where a drive
    is off, or None; starts, ends (W,): first and last row; start_position, start_velocity,
    start_acceleration (W, J): the measured motion at the starts.
    """

    time: np.ndarray
    voltage: np.ndarray
    position: np.ndarray
    enable: np.ndarray | None
    starts: np.ndarray
    ends: np.ndarray
    start_position: np.ndarray
    start_velocity: np.ndarray
    start_acceleration: np.ndarray

    @classmethod
    def of(cls, time, voltage, position, enable=None, *, starts, length: float | None = None,
           ends=None, motion=None) -> Windows:
        """Windows from each of the rows `starts` on.

        Parameters
        ----------
        enable : (n,) or (n, J), or None where the drives are always on.
        length : [s]; a window ends at the last row within it, and at the end of the log.
        ends : (W,) last rows, in place of `length`.
        motion : (position, velocity, acceleration) at the starts, each (W, J), of a smoother;
            without it the slope and curvature of the positions about the row (`local_motion`).

        Raises
        ------
        ParameterError : shapes that do not go together, times that do not increase, or windows
            outside the log.
        """
        time = np.ascontiguousarray(time, dtype=float)
        voltage, position = (np.ascontiguousarray(values, dtype=float)
                             for values in (voltage, position))
        rows = len(time)
        if time.ndim != 1 or voltage.ndim != 2 or len(voltage) != rows \
                or position.shape != voltage.shape:
            raise ParameterError(f"time {time.shape}, voltage {voltage.shape}, position "
                                 f"{position.shape}", where="windows",
                                 expected="(n,), (n, J) and (n, J)")
        if not (np.diff(time) > 0.0).all():
            raise ParameterError("times that do not increase", where="windows",
                                 expected="increasing times")
        starts = np.asarray(starts, dtype=int)
        if (ends is None) == (length is None):
            raise ParameterError("length and ends", where="windows", expected="one of them")
        if ends is None:
            ends = np.searchsorted(time, time[starts] + length * (1.0 + 1e-9), side="right") - 1
        ends = np.asarray(ends, dtype=int)
        if ends.shape != starts.shape or not len(starts) or (starts < 0).any() \
                or (ends >= rows).any() or (ends <= starts).any():
            raise ParameterError(f"windows from rows {starts} to {ends}"[:200], where="windows",
                                 expected=f"one row at least in each, among {rows} rows")
        if enable is not None:
            enable = np.asarray(enable, dtype=float)
            if enable.ndim == 1:
                enable = np.repeat(enable[:, None], voltage.shape[1], axis=1)
            if enable.shape != voltage.shape:
                raise ParameterError(f"enable {enable.shape}", where="windows",
                                     expected="(n,) or (n, J)")
            if enable.all():
                enable = None
        if motion is None:
            slopes = [local_motion(time, position, row) for row in starts.tolist()]
            motion = (position[starts], *(np.array(each) for each in zip(*slopes)))
        start, velocity, acceleration = (np.asarray(values, dtype=float) for values in motion)
        return cls(time, voltage, position, enable, starts, ends, start, velocity, acceleration)

    def __len__(self) -> int:
        return len(self.starts)


@dataclass(frozen=True, eq=False)
class WindowRun:
    """What a plant predicts.

    predicted : one array (m, J) a window, its rows from the start row to the end row; error (N, J):
    predicted less measured, of all rows but the start rows, window after window; rms and worst
    (J,) [rad or m].
    """

    predicted: list[np.ndarray]
    error: np.ndarray
    rms: np.ndarray = field(init=False)
    worst: np.ndarray = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "rms", np.sqrt((self.error ** 2).mean(axis=0)))
        object.__setattr__(self, "worst", np.abs(self.error).max(axis=0))


def run_windows(plant: Plant, windows: Windows, *, max_step: float = WINDOW_STEP) -> WindowRun:
    """Run a plant through windows of a log, each from the measured state on.

    The current at a start is that which the voltages before it drive (`driven_current`), 0 where
    the drive is off. Bristles go on from the window before where one ends where the next starts.
    A window in which the state stops being finite counts as `FAR_OFF` throughout.

    Raises
    ------
    ParameterError : a plant of another number of joints.
    """
    if plant.joints != windows.position.shape[1]:
        raise ParameterError(f"a plant of {plant.joints} joints with a log of "
                             f"{windows.position.shape[1]}", where="windows",
                             expected="as many joints as the log has")
    simulator = Simulator(plant, max_step=stable_step(plant, max_step))
    predicted, errors, before = [], [], -1
    for k, (first, last) in enumerate(zip(windows.starts.tolist(), windows.ends.tolist())):
        _restart(simulator, windows, k, first, keep=first == before)
        rows = slice(first, last + 1)
        enable = None if windows.enable is None else windows.enable[rows]
        position = _position(simulator, windows.time[rows], windows.voltage[rows], enable)
        predicted.append(position)
        error = position[1:] - windows.position[first + 1:last + 1]
        errors.append(np.clip(error, -FAR_OFF, FAR_OFF))
        before = last
    return WindowRun(predicted, np.concatenate(errors))


def stable_step(plant: Plant, at_most: float) -> float:
    """Step of integration [s] at which a plant's windings are stable: a fit may make them quick."""
    lags = [m.inductance / m.resistance for m in plant.arm.motors[3 - plant.joints:]
            if m.inductance > 0.0]
    return min([at_most, *(_STABLE * lag for lag in lags)])


def _restart(simulator: Simulator, windows: Windows, k: int, row: int, keep: bool) -> None:
    acceleration = windows.start_acceleration[k]
    position, velocity = true_start(simulator.plant, windows.start_position[k],
                                    windows.start_velocity[k], acceleration)
    current = driven_current(simulator.plant, windows.time, windows.voltage, row, velocity,
                             acceleration)
    if windows.enable is not None:
        current = np.where(windows.enable[row] != 0.0, current, 0.0)
    bristles = simulator.bristles
    simulator.reset(position, velocity, current, time=windows.time[row])
    if keep:
        simulator.bristles = bristles
    tell_past(simulator, windows.time, windows.voltage, row)


def _position(simulator: Simulator, time, voltage, enable) -> np.ndarray:
    """(m, J) positions of one window; `FAR_OFF` where the state does not stay finite."""
    try:
        return simulator.run(time, voltage, enable=enable).position
    except NonFiniteStateError:
        return np.full(voltage.shape, FAR_OFF)
