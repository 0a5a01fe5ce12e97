# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A measured log in open loop: its voltages through the model, started again every few seconds.

At the start of each window the model takes over the measured state; from there to the end of the
window it sees the voltages alone, and what it is then away from the measured positions is the
open-loop error. A log need hold no more than voltages and positions: the velocity is then the
slope of the positions about the row (`local_motion`), and the current that which the voltages
before the row drive against the back-EMF (`driven_current`). The bristles of
`presliding_friction` cannot be measured; they go on from the end of the window before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .effects import WIDTH, slot
from .effects.amplifier import CURRENT_LIMITER
from .errors import NonFiniteStateError, ParameterError, RecordingError
from .plant import Plant
from .recording import GROUPS, Recording
from .runs import terminal_voltages
from .simulator import Simulator, native

#: half of the stretch of positions that a slope is taken from [s]: a cubic through 40 ms of a
#: motion of 8 Hz gives its velocity to 0.3 %, and encoder counts of 1e-4 rad at 1 kHz spread it
#: by 1 mrad/s
HALF_STRETCH = 0.020
#: time constants L/R of past voltage that a current is made of; what is older counts e^-40
_MEMORY = 40.0


@dataclass(frozen=True)
class OpenLoopErrors:
    """How far the simulated positions are from the measured ones, joint by joint.

    rms (3) and worst (3) [rad], worst_time (3) [s], windows. Each row counts once, as the
    window that ends at it or goes through it predicts it; the row that a log starts with does
    not count.
    """

    rms: np.ndarray
    worst: np.ndarray
    worst_time: np.ndarray
    windows: int


def window_starts(time: np.ndarray, interval: float) -> np.ndarray:
    """Rows that windows start at: row 0 and those nearest to each further interval [s].

    time : (n,) [s]. Without a row within half a sample it is the first one after; the last row
    starts none.

    Raises
    ------
    ParameterError : an interval that is not a positive number.
    """
    if not 0.0 < interval < float("inf"):
        raise ParameterError(f"{interval!r} s", where="time between restarts",
                             expected="a positive number")
    if len(time) < 2:
        return np.zeros(1, dtype=int)
    sample = float(np.median(np.diff(time)))
    if interval <= sample:
        return np.arange(len(time) - 1)
    window = np.floor((time - time[0] + 0.5 * sample) / interval)
    starts = np.flatnonzero(np.diff(window, prepend=-1.0) > 0.0)
    return starts[starts < len(time) - 1]


def local_motion(time: np.ndarray, position: np.ndarray, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocity (3) [rad/s] and acceleration (3) [rad/s^2] at a row of measured positions.

    A cubic is fitted by least squares to the rows within `HALF_STRETCH`, or 2.5 samples where
    that is longer, on both sides alike: it shifts nothing in time. A parabola serves where rows
    are on one side only, and less where they are too few. time (n,) [s] may be uneven, n >= 2;
    position (n, 3) [rad].
    """
    gaps = np.diff(time[max(0, row - 1):row + 2])
    reach = max(HALF_STRETCH, 2.5 * float(gaps.min()))
    first = np.searchsorted(time, time[row] - reach, side="left")
    last = np.searchsorted(time, time[row] + reach, side="right")
    degree = min(3 if first < row < last - 1 else 2, last - first - 1)
    x = (time[first:last] - time[row]) / reach
    powers = x[:, None] ** np.arange(degree + 1)
    c = np.linalg.lstsq(powers, position[first:last] - position[row], rcond=None)[0]
    acceleration = 2.0 * c[2] / reach ** 2 if degree >= 2 else np.zeros(position.shape[1])
    return c[1] / reach, acceleration


def driven_current(plant: Plant, time: np.ndarray, voltage: np.ndarray, row: int,
                   velocity: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Current (3) [A] at a row, from the voltages before it and the motion at it (equation 5.1).

    L di/dt + R i = V - ke N qd makes i the quasi-static (V - ke N qd) / R, averaged over the
    past with the weight e^(-s R/L): V of the rows before, exactly as they were held, and
    qd(t - s) = qd - s qdd. At the first row its own voltage stands for the past. The amplifier's
    effects act on V, a current limit on the result.
    """
    motors, table = plant.arm.motors, native(plant.constants.table)
    longest = max(m.inductance / m.resistance for m in motors)
    first = max(0, int(np.searchsorted(time, time[row] - _MEMORY * longest, side="right")) - 1)
    rows = range(first, max(row, 1))
    held = np.array([terminal_voltages(*voltage[r].tolist(), table) for r in rows])
    edges = time[row] - time[first:rows.stop + 1]
    edges[-1] = 0.0
    current = np.empty(3)
    for j, motor in enumerate(motors):
        lag = motor.inductance / motor.resistance
        weight = np.diff(np.exp(-edges / lag))
        weight[0] = 1.0 - weight[1:].sum()
        emf = motor.back_emf * motor.gear_ratio * (velocity[j] - lag * acceleration[j])
        current[j] = (weight @ held[:, j] - emf) / motor.resistance
    limit = np.array([table[j * WIDTH + slot(CURRENT_LIMITER)] for j in range(3)])
    return np.clip(current, -limit, limit)


def measured_state(plant: Plant, log: Recording, row: int) -> tuple[np.ndarray, ...]:
    """Position [rad], velocity [rad/s] and current [A] (3 each) at a row of a measured log.

    What the log holds is taken as it is; the rest comes from `local_motion` and `driven_current`.
    """
    velocity, acceleration = local_motion(log.time, log.position, row)
    if log.velocity is not None:
        velocity = log.velocity[row]
    if log.current is not None:
        current = log.current[row]
    else:
        current = driven_current(plant, log.time, log.voltage, row, velocity, acceleration)
    return log.position[row], velocity, current


def run_windows(simulator: Simulator, log: Recording, interval: float, *,
                acceleration: bool = False, report: Callable[[int], None] = lambda rows: None
                ) -> tuple[Recording, OpenLoopErrors]:
    """Run a log's voltages in windows of `interval` [s], each from the measured state.

    Parameters
    ----------
    simulator : its state is replaced; a joint that it constrains to a velocity takes that one.
    log : times, voltages and positions, velocities and currents if they were measured.
    acceleration : record it too [rad/s^2].
    report : told how many rows are done, after each window.

    Returns
    -------
    Recording at the times of the log, whose row is the measured state where a window starts, and
    the errors of the predictions.

    Raises
    ------
    ParameterError : an interval that is not positive.
    RecordingError : a log without voltages or positions, or of one row.
    NonFiniteStateError : the state stopped being finite; ``step`` is the row of the log.
    """
    if log.voltage is None or log.position is None or len(log) < 2:
        raise RecordingError(f"{len(log)} row{'s' * (len(log) != 1)} with {_present(log)}",
                             where="log", expected="two rows or more with voltage and position")
    starts = window_starts(log.time, interval)
    ends = np.append(starts[1:], len(log) - 1)
    state = np.empty((len(log), 9))
    second = np.empty((len(log), 3)) if acceleration else None
    error = np.zeros((len(log), 3))
    for first, last in zip(starts.tolist(), ends.tolist()):
        _restart(simulator, log, first)
        rows = slice(first, last + 1)
        try:
            run = simulator.run(log.time[rows], log.voltage[rows], acceleration=acceleration)
        except NonFiniteStateError as problem:
            raise NonFiniteStateError(first + problem.step) from None
        # the row that ends a window starts the next one, which then writes over it
        state[rows] = np.hstack([run.position, run.velocity, run.current])
        if second is not None:
            second[rows] = run.acceleration
        error[first + 1:last + 1] = (run.position - log.position[rows])[1:]
        report(last + 1)
    recording = Recording(time=log.time, voltage=log.voltage, position=state[:, 0:3],
                          velocity=state[:, 3:6], current=state[:, 6:9], acceleration=second)
    row = np.abs(error).argmax(axis=0)
    return recording, OpenLoopErrors(
        rms=np.sqrt((error[1:] ** 2).mean(axis=0)), worst=np.abs(error).max(axis=0),
        worst_time=log.time[row], windows=len(starts))


def _restart(simulator: Simulator, log: Recording, row: int) -> None:
    position, velocity, current = measured_state(simulator.plant, log, row)
    own = [c.kind == "hold" or (c.kind == "velocity" and c.value is not None)
           for c in simulator.constraints]
    bristles = simulator.bristles
    simulator.reset(position, np.where(own, 0.0, velocity), current, time=log.time[row])
    simulator.bristles = bristles


def _present(log: Recording) -> str:
    names = [name for name in GROUPS if getattr(log, name) is not None]
    return ", ".join(names) or "times alone"
