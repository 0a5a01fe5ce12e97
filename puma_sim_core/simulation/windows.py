# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A measured log in open loop: its voltages through the model, started again every few seconds.

At the start of each window the model takes over the measured state; from there to the end of the window it sees the
voltages alone, and what it is then away from the measured positions is the open-loop error. A log need hold no more
than voltages and positions: the velocity is then the slope of the positions about the row (`local_motion`), and the
current that which the voltages before the row drive against the back-EMF (`driven_current`). The deflections of
bristles cannot be measured; they go on from the end of the window before.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from puma_sim_core.checks import check_positive
from puma_sim_core.dynamics.laws import SENSED, combined
from puma_sim_core.dynamics.runs import terminal_voltages
from puma_sim_core.dynamics.sensed import true_motion
from puma_sim_core.effects.base import VOLTAGE, Point
from puma_sim_core.errors import NonFiniteStateError, RecordingError
from puma_sim_core.jit import interpreted
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import GROUPS, Recording
from puma_sim_core.simulation.delay import delay_of
from puma_sim_core.simulation.run_inputs import native, runs_compiled
from puma_sim_core.simulation.simulator import Simulator

_bound: Callable[..., float] = combined(Point.CURRENT_BOUND, interpreted)
#: half of the stretch of positions that a slope is taken from [s]: a cubic through 40 ms of a motion of 8 Hz gives its
#: velocity to 0.3 %, and encoder counts of 1e-4 rad at 1 kHz spread it by 1 mrad/s
HALF_STRETCH = 0.020
#: time constants L/R of past voltage that a current is made of; what is older counts e^-40
_MEMORY = 40.0


@dataclass(frozen=True)
class OpenLoopErrors:
    """How far the simulated positions are from the measured ones, joint by joint.

    rms (J) and worst (J) [rad or m], worst_time (J) [s], windows. Each row counts once, as the
    window that ends at it or goes through it predicts it; the row that a log starts with does
    not count.
    """

    rms: np.ndarray
    worst: np.ndarray
    worst_time: np.ndarray
    windows: int


def window_starts(time: np.ndarray, interval: float) -> np.ndarray:
    """Rows that windows start at: row 0 and those nearest to each further interval [s].

    time : (n,) [s]. Without a row within half a sample it is the first one after; the last row starts none.

    Raises ParameterError: an interval that is not a positive number.
    """
    check_positive(interval, "interval", "s", "time between restarts")
    if len(time) < 2:
        return np.zeros(1, dtype=int)
    sample = float(np.median(np.diff(time)))
    if interval <= sample:
        return np.arange(len(time) - 1)
    window = np.floor((time - time[0] + 0.5 * sample) / interval)
    starts = np.flatnonzero(np.diff(window, prepend=-1.0) > 0.0)
    return starts[starts < len(time) - 1]


def local_motion(time: np.ndarray, position: np.ndarray, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocity (J) [rad/s] and acceleration (J) [rad/s^2] at a row of measured positions.

    A cubic is fitted by least squares to the rows within `HALF_STRETCH`, or 2.5 samples where
    that is longer, on both sides alike: it shifts nothing in time. A parabola serves where rows are on one side only,
    and less where they are too few. time (n,) [s] may be uneven, n >= 2; position (n, J) [rad].
    """
    gaps = np.diff(time[max(0, row - 1) : row + 2])
    reach = max(HALF_STRETCH, 2.5 * float(gaps.min()))
    first = np.searchsorted(time, time[row] - reach, side="left")
    last = np.searchsorted(time, time[row] + reach, side="right")
    degree = min(3 if first < row < last - 1 else 2, last - first - 1)
    x = (time[first:last] - time[row]) / reach
    powers = x[:, None] ** np.arange(degree + 1)
    c = np.linalg.lstsq(powers, position[first:last] - position[row], rcond=None)[0]
    acceleration = 2.0 * c[2] / reach**2 if degree >= 2 else np.zeros(position.shape[1])
    return c[1] / reach, acceleration


def driven_current(
    plant: Plant, time: np.ndarray, voltage: np.ndarray, row: int, velocity: np.ndarray, acceleration: np.ndarray
) -> np.ndarray:
    """Current (J) [A] at a row, from the voltages before it and the motion at it (equation 5.1).

    L di/dt + R i = V - ke N qd makes i the quasi-static (V - ke N qd) / R, averaged over the
    past with the weight e^(-s R/L): V of the rows before, exactly as they were held, and
    qd(t - s) = qd - s qdd. At the first row its own voltage stands for the past. The amplifier's effects act on V, a
    delay of the input on its time, a current limit on the result. A motor without inductance has the current of the
    row's own voltage. voltage (n, J) [V], velocity (J) [rad/s], acceleration (J) [rad/s^2].
    """
    axes = list(plant.axes)
    motors = [plant.arm.motors[axis] for axis in axes]
    table = native(plant.constants.table, runs_compiled(plant.constants.active))
    longest = max(m.inductance / m.resistance for m in motors)
    # what arrives now was asked for then
    asked = time[row] - delay_of(plant.constants.active, table)
    if longest == 0.0:
        first = max(0, int(np.searchsorted(time, asked, side="right")) - 1)
        after = first + 1
    else:
        first = max(0, int(np.searchsorted(time, asked - _MEMORY * longest, side="right")) - 1)
        after = max(int(np.searchsorted(time, asked, side="left")), 1)
    held = voltage[first:after]
    if any(effect.kind.acts == VOLTAGE for effect in plant.effects):
        held = np.array([terminal_voltages(a, b, c, table) for a, b, c in plant.spread(held).tolist()])[:, axes]
    edges = asked - time[first : after + 1]
    edges[-1] = 0.0
    current = np.empty(len(motors))
    for j, motor in enumerate(motors):
        lag = motor.inductance / motor.resistance
        emf = motor.back_emf * motor.gear_ratio * (velocity[j] - lag * acceleration[j])
        mean = held[-1, j]
        if lag > 0.0:
            weight = np.diff(np.exp(-edges / lag))
            weight[0] = 1.0 - weight[1:].sum()
            mean = weight @ held[:, j]
        current[j] = (mean - emf) / motor.resistance
    limit = np.array([_bound(j, table) for j in axes])
    return np.clip(current, -limit, limit)


def measured_state(plant: Plant, log: Recording, row: int) -> tuple[np.ndarray, ...]:
    """Position [rad], velocity [rad/s] and current [A] (J each) at a row of a measured log.

    What the log holds is taken as it is; the rest comes from `local_motion` and `driven_current`.
    Where the plant's sensors measure another position, this is the true one behind the log's.
    """
    measured: Any = log.position
    velocity, acceleration = local_motion(log.time, measured, row)
    position, velocity = true_start(plant, measured[row], velocity, acceleration)
    velocity = velocity if log.velocity is None else log.velocity[row]
    if log.current is not None:
        return position, velocity, log.current[row]
    volts: Any = log.voltage
    return position, velocity, driven_current(plant, log.time, volts, row, velocity, acceleration)


def true_start(
    plant: Plant, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """True position [rad] and velocity [rad/s] (J each) behind a measured motion (J each)."""
    if not plant.constants.active & SENSED:
        return position, velocity
    axes = list(plant.axes)
    q, qd, qdd = (plant.spread(values) for values in (position, velocity, acceleration))
    position, velocity = true_motion(q, qd, qdd, plant.constants.table)
    return np.asarray(position)[axes], np.asarray(velocity)[axes]


def run_windows(
    simulator: Simulator,
    log: Recording,
    interval: float,
    *,
    acceleration: bool = False,
    report: Callable[[int], None] = lambda rows: None,
) -> tuple[Recording, OpenLoopErrors]:
    """Run a log's voltages in windows of `interval` [s], each from the measured state.

    simulator : its state is replaced; a joint that it constrains to a velocity takes that one.
    log : times, voltages and positions, velocities and currents if they were measured.
    acceleration : record it too [rad/s^2].
    report : called with the number of rows that are done, after each window.

    Returns the recording at the times of the log, whose row is the measured state where a window starts, and the errors
    of the predictions.

    Raises
    ------
    ParameterError : an interval that is not positive.
    RecordingError : a log without voltages or positions, or of one row.
    NonFiniteStateError : the state stopped being finite; ``step`` is the row of the log.
    """
    if log.voltage is None or log.position is None or len(log) < 2:
        present = ", ".join(name for name in GROUPS if getattr(log, name) is not None) or "times alone"
        what = f"{len(log)} row{'s' * (len(log) != 1)} with {present}"
        raise RecordingError(what, where="log", expected="two rows or more with voltage and position")
    starts = window_starts(log.time, interval)
    joints = log.position.shape[1]
    state = np.empty((len(log), 3 * joints))
    second = np.empty((len(log), joints)) if acceleration else None
    error = np.zeros_like(log.position)
    for first, last in itertools.pairwise([*starts.tolist(), len(log) - 1]):
        _restart(simulator, log, first)
        rows = slice(first, last + 1)
        try:
            run = simulator.run(log.time[rows], log.voltage[rows], acceleration=acceleration)
        except NonFiniteStateError as problem:
            raise NonFiniteStateError(first + problem.step) from None
        # the row that ends a window starts the next one, which then writes over it
        state[rows] = run.states()
        if second is not None:
            second[rows] = run.acceleration
        error[first + 1 : last + 1] = (run.position - log.position[rows])[1:]
        report(last + 1)
    position, velocity, current = np.hsplit(state, 3)
    size = np.abs(error)
    rms, worst_time = np.sqrt((error[1:] ** 2).mean(axis=0)), log.time[size.argmax(axis=0)]
    recording = Recording(log.time, log.voltage, position, velocity, current, acceleration=second)
    return recording, OpenLoopErrors(rms, size.max(axis=0), worst_time, len(starts))


def _restart(simulator: Simulator, log: Recording, row: int) -> None:
    """Start the simulator from the measured state at a row; bristles and other memories go on."""
    plant = simulator.plant
    measured: Any = log.position
    position, velocity, current = measured_state(plant, log, row)
    constraints = [simulator.constraints[axis] for axis in plant.axes]
    own = [c.kind == "hold" or (c.kind == "velocity" and c.value is not None) for c in constraints]
    bristles, further = simulator.bristles, simulator.further
    simulator.reset(position, np.where(own, 0.0, velocity), current, time=log.time[row])
    simulator.bristles, simulator.further = bristles, further
    if plant.constants.active & SENSED:
        # behind a lag it is not what a sensor at rest there would give
        simulator.measured = tuple(plant.spread(measured[row]).tolist())
    delay, volts = simulator.past.delay, log.voltage
    if delay > 0.0 and row > 0 and volts is not None:
        first = max(0, int(np.searchsorted(log.time, log.time[row] - delay, side="right")) - 1)
        simulator.remember(log.time[row] - log.time[first:row], volts[first:row])
