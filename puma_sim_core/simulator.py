# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The simulator of chapter 6: constraints, limits, reset, step and run.

Inputs are motor voltages that are piecewise constant, or setpoints of the digital servo; outputs
are positions, velocities, currents and, on demand, accelerations, sampled synchronously.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from .backend import BACKEND
from .closed_loop import Controller, ControlLoop, samples_per_period
from .control.servo import ServoConfig
from .errors import LimitError, NonFiniteStateError, ParameterError
from .kernel import LOCKED
from .plant import Plant
from .recording import Recording
from .runs import accelerations, run_servo, run_voltages, servo_memory

#: one servo period [s], the natural step of integration (section 7.6)
SERVO_PERIOD = 0.028 / 30.0
#: RK4 is stable up to about 8.4 ms with the electrical time constant L/R of 3 ms
GREATEST_STEP = 0.008

CONSTRAINTS = ("free", "hold", "velocity", "acceleration")


@dataclass(frozen=True)
class Constraint:
    """How a joint moves (section 6.1, a to d).

    kind : "free", "hold" (constant position), "velocity" (constant velocity) or "acceleration"
        (constant acceleration). value : the velocity [rad/s], None for the initial one, or the
        acceleration [rad/s^2].

    A joint that is not free has its row and column taken out of the equations; what it exerts on
    the others by its motion stays. (Section 6.2 overwrites its state after a free step, which
    leaves the others with a wrong inertia.)

    Raises
    ------
    ParameterError : unknown kind, or a value where none belongs or one is missing.
    """

    kind: str = "free"
    value: float | None = None

    def __post_init__(self):
        where = f"constraint '{self.kind}'"
        if self.kind not in CONSTRAINTS:
            raise ParameterError("unknown", where=where, expected=" or ".join(CONSTRAINTS))
        if self.kind in ("free", "hold") and self.value is not None:
            raise ParameterError(f"value {self.value}", where=where, expected="no value")
        if self.kind == "acceleration" and self.value is None:
            raise ParameterError("no value", where=where, expected="acceleration:RAD_PER_S2")
        if self.value is not None:
            if isinstance(self.value, (bool, str)) or not isfinite(self.value):
                raise ParameterError(f"value {self.value}", where=where,
                                     expected="a finite number")
            # a whole number here would be compiled as another kernel
            object.__setattr__(self, "value", float(self.value))

    @classmethod
    def parse(cls, text: str) -> Constraint:
        """From ``free``, ``hold``, ``velocity``, ``velocity:0.5`` or ``acceleration:1``."""
        kind, colon, value = text.partition(":")
        try:
            return cls(kind, float(value) if colon else None)
        except ValueError as error:
            if isinstance(error, ParameterError):
                raise
            raise ParameterError(f"value '{value}'", where=f"constraint '{kind}'",
                                 expected="a number") from None


@dataclass(frozen=True)
class Limits:
    """Ranges and greatest magnitudes that a run is checked against, at its samples.

    position ((low, high) x 3) [rad], velocity (3) [rad/s], acceleration (3) [rad/s^2]; None
    leaves a quantity unchecked. Limits stop nothing: a stop that acts is the effect `soft_stop`.
    """

    position: tuple[tuple[float, float], ...] | None = None
    velocity: tuple[float, float, float] | None = None
    acceleration: tuple[float, float, float] | None = None

    def first_exceeded(self, recording: Recording) -> list[str]:
        """One sentence for each joint and quantity that leaves its limits: where and by what."""
        ranges = {"position": (self.position, "rad"),
                  "velocity": (_symmetric(self.velocity), "rad/s"),
                  "acceleration": (_symmetric(self.acceleration), "rad/s^2")}
        found = []
        for name, (pairs, unit) in ranges.items():
            values = getattr(recording, name)
            if pairs is None or values is None:
                continue
            for j, (low, high) in enumerate(pairs):
                outside = np.flatnonzero((values[:, j] < low) | (values[:, j] > high))
                if outside.size:
                    r = int(outside[0])
                    found.append(f"joint {j + 1}: {name} {values[r, j]:.7g} {unit} at "
                                 f"{recording.time[r]:.6g} s is outside {low:.4g} to {high:.4g}")
        return found


def _symmetric(greatest):
    return None if greatest is None else tuple((-g, g) for g in greatest)


def three(values, name: str) -> tuple[float, float, float]:
    """Three finite floats, or a ParameterError that names them."""
    try:
        result = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        result = ()
    if len(result) != 3 or not all(map(isfinite, result)):
        raise ParameterError(f"{name} = {values!r}", expected="three finite numbers")
    return result


def check_step(step: float, where: str = "step") -> float:
    """The step [s], or a ParameterError where RK4 would not be stable."""
    if not isfinite(step) or not 0.0 < step <= GREATEST_STEP:
        raise ParameterError(f"{step * 1e3:.6g} ms", where=where,
                             expected=f"more than 0 and at most {GREATEST_STEP * 1e3:g} ms: RK4 is "
                                      "unstable above 8.4 ms with L/R = 3 ms")
    return float(step)


def step_counts(duration: np.ndarray, max_step: float) -> np.ndarray:
    """Steps of integration for each duration [s], of at most `max_step` [s].

    Rounding of the times that a duration is the difference of does not make a step more: a step
    may exceed max_step by a millionth.
    """
    return np.maximum(1, np.ceil(duration / max_step * (1.0 - 1e-6))).astype(np.int64)


def native(numbers: Sequence[float]):
    """Flat numbers as the kernel reads them fastest: an array when compiled, else a list."""
    return np.array(numbers, dtype=float) if BACKEND == "numba" else [float(n) for n in numbers]


class Simulator:
    """The arm, from a state on.

    Parameters
    ----------
    plant : the arm and its effects.
    constraints : one `Constraint` a joint; free by default.
    max_step : greatest step of integration [s]; rows that hold longer are divided evenly.
    limits : what runs are checked against; none by default.
    on_limit : "report" gathers sentences in `exceeded`, "error" raises LimitError after a run.

    The state is taken by `reset` and moves on with each `step` and `run`. ``state`` is the tuple
    (q1, q2, q3, qd1, qd2, qd3, i1, i2, i3), ``bristles`` the deflections [rad] of
    `presliding_friction`, ``time`` the simulated time [s].

    Raises
    ------
    ParameterError : a step above 8 ms, constraints of another length.
    """

    def __init__(self, plant: Plant, *, constraints: Sequence[Constraint] = (Constraint(),) * 3,
                 max_step: float = SERVO_PERIOD, limits: Limits | None = None,
                 on_limit: str = "report"):
        if len(constraints) != 3 or not all(isinstance(c, Constraint) for c in constraints):
            raise ParameterError(f"constraints {constraints!r}", expected="one Constraint a joint")
        if on_limit not in ("report", "error"):
            raise ParameterError(f"on_limit '{on_limit}'", expected="report or error")
        self.plant = plant
        self.constraints = tuple(constraints)
        self.max_step = check_step(max_step, "max_step")
        self.limits = limits or Limits()
        self.on_limit = on_limit
        self.exceeded: list[str] = []
        body, drive, active, table = plant.constants
        if any(c.kind != "free" for c in self.constraints):
            active |= LOCKED
        lock = (*(0.0 if c.kind == "free" else 1.0 for c in self.constraints),
                *(c.value if c.kind == "acceleration" else 0.0 for c in self.constraints))
        self._kernel = (body, drive, active, native(table), lock)
        self.reset()

    def reset(self, position=(0.0, 0.0, 0.0), velocity=None, current=(0.0, 0.0, 0.0),
              time: float = 0.0) -> None:
        """Start from a state: position [rad], velocity [rad/s], current [A] of the joints.

        The velocity of a joint with a constant velocity of its own is that one.

        Raises
        ------
        ParameterError : not three finite numbers, or a velocity that contradicts a constraint.
        """
        position, current = three(position, "position"), three(current, "current")
        given = None if velocity is None else three(velocity, "velocity")
        start = list(given or (0.0, 0.0, 0.0))
        for j, c in enumerate(self.constraints):
            fixed = 0.0 if c.kind == "hold" else c.value if c.kind == "velocity" else None
            if fixed is not None:
                if given is not None and given[j] not in (0.0, fixed):
                    raise ParameterError(f"initial velocity {given[j]} rad/s of joint {j + 1}",
                                         expected=f"{fixed} rad/s, as its constraint says")
                start[j] = fixed
        self.state = (*position, *start, *current)
        self.bristles = (0.0, 0.0, 0.0)
        self.time = float(time)

    def step(self, voltage, duration: float = SERVO_PERIOD) -> tuple[float, ...]:
        """Hold three voltages [V] for a duration [s]; returns the new state.

        Raises
        ------
        ParameterError : not three finite numbers, a duration that is not positive.
        NonFiniteStateError : the state stopped being finite; the last finite one is kept.
        """
        if not isfinite(duration) or duration <= 0.0:
            raise ParameterError(f"duration {duration!r} s", expected="a positive number")
        volts = three(voltage, "voltage")
        self._advance(np.array([volts]), np.array([float(duration)]))
        self.time += duration
        return self.state

    def run(self, time, voltage, *, acceleration: bool = False) -> Recording:
        """Run through rows of voltages from the present state.

        time : (n,) [s], increasing; voltage : (n, 3) [V], row r held until time[r + 1]; the last
        row is held by nobody. acceleration : record it too [rad/s^2].

        Returns
        -------
        Recording with the states at the same n times.

        Raises
        ------
        ParameterError : shapes, values that are not finite, times that do not increase.
        NonFiniteStateError : the state stopped being finite; names the row, keeps the state.
        LimitError : a limit was exceeded and on_limit is "error".
        """
        time, voltage = table(time, voltage, "voltage")
        try:
            out = self._advance(voltage[:-1], np.diff(time))
        except NonFiniteStateError as error:
            self.time = float(time[error.step - 1])
            raise
        self.time = float(time[-1])
        return self._recorded(time, voltage, out, acceleration)

    def run_servo(self, setpoint, servo: ServoConfig = ServoConfig(), *, period: float = 0.028,
                  samples: int = 30, voltage_limit: float = 40.0,
                  acceleration: bool = False, held_voltage=(0.0, 0.0, 0.0)) -> Recording:
        """Run under the digital servo from the present state.

        setpoint : (n, 3) [rad], each held for one period [s] of `samples` servo samples, which
        are integrated in steps of at most max_step; voltage_limit : at the motors [V];
        held_voltage : what a servo with a delay asked for before the first sample [V].

        Returns
        -------
        Recording of n * samples + 1 rows, one a servo sample; its last voltage is held by nobody.

        Raises
        ------
        ParameterError, NonFiniteStateError, LimitError : as `run`.
        """
        setpoint = _setpoints(setpoint, period, voltage_limit)
        if isinstance(samples, bool) or not isinstance(samples, int) or samples < 1:
            raise ParameterError(f"samples {samples!r}", expected="a whole number of at least 1")
        h = period / samples
        steps = int(step_counts(np.array([h]), self.max_step)[0])
        servo_table = native(servo.table(h, voltage_limit,
                                   [m.gear_ratio for m in self.plant.arm.motors]))
        memory = native([*servo_memory(tuple(setpoint[0].tolist()), self.state[:3], servo_table),
                         *servo.held_back(three(held_voltage, "held_voltage"))])
        n = len(setpoint) * samples
        out, volts = np.empty((n + 1, 12)), np.zeros((n + 1, 3))
        self._finish(_guarded(out, run_servo, self.state, self.bristles, _rows(setpoint), samples,
                              steps, h / steps, servo_table, memory, *self._kernel, out, volts),
                     out)
        return self._sampled(setpoint, samples, h, out, volts, acceleration)

    def run_controller(self, controller: Controller, setpoint, *, period: float = 0.028,
                       voltage_limit: float = 40.0, chain: ServoConfig = ServoConfig(),
                       acceleration: bool = False) -> Recording:
        """Run under any controller (see `closed_loop`) from the present state; it is reset first.

        setpoint : (n, 3) [rad], each held for one period [s], a whole number of the controller's
        own; voltage_limit : at the motors [V]; chain : encoder, converter, amplifier and delay
        around the controller, ideal by default.

        Returns
        -------
        Recording of a row a sample, as `run_servo`.

        Raises
        ------
        ParameterError : also for a rate that does not fit, or other than three voltages.
        NonFiniteStateError, LimitError : as `run`.
        """
        setpoint = _setpoints(setpoint, period, voltage_limit)
        samples = samples_per_period(controller, period)
        h = period / samples
        loop = ControlLoop(controller, chain, h, int(step_counts(np.array([h]), self.max_step)[0]),
                           voltage_limit, [m.gear_ratio for m in self.plant.arm.motors],
                           self._kernel)
        n = len(setpoint) * samples
        out, volts = np.empty((n + 1, 12)), np.zeros((n + 1, 3))
        self._finish(loop.run(self.state, self.bristles, setpoint, samples, self.time, out, volts),
                     out)
        return self._sampled(setpoint, samples, h, out, volts, acceleration)

    def _sampled(self, setpoint, samples, h, out, volts, acceleration) -> Recording:
        """The recording of a closed loop with samples each h; volts (n, 3), the last row free."""
        volts[-1] = volts[-2]
        time = self.time + h * np.arange(len(out))
        self.time = float(time[-1])
        held = np.repeat(setpoint, samples, axis=0)
        return self._recorded(time, volts, out, acceleration,
                              setpoint=np.vstack([held, held[-1:]]))

    def _advance(self, voltage: np.ndarray, duration: np.ndarray) -> np.ndarray:
        """Rows of state and bristles, one more than there are rows of voltage."""
        counts = step_counts(duration, self.max_step)
        out = np.empty((len(duration) + 1, 12))
        self._finish(_guarded(out, run_voltages, self.state, self.bristles, _rows(voltage),
                              counts if BACKEND == "numba" else counts.tolist(),
                              _rows(duration / counts), *self._kernel, out), out)
        return out

    def _finish(self, bad_row: int, out: np.ndarray) -> None:
        """Take over the last finite state of a run, and complain where it was cut short."""
        last = len(out) - 1 if bad_row < 0 else bad_row - 1
        row = tuple(out[last].tolist())
        self.state, self.bristles = row[:9], row[9:]
        if bad_row >= 0:
            raise NonFiniteStateError(bad_row)

    def _recorded(self, time, voltage, out, acceleration, setpoint=None) -> Recording:
        result = None
        if acceleration or self.limits.acceleration is not None:
            result = np.empty((len(out), 3))
            accelerations(out, _rows(voltage), *self._kernel, result)
        recording = Recording(time=time, voltage=voltage, position=out[:, 0:3],
                              velocity=out[:, 3:6], current=out[:, 6:9], setpoint=setpoint,
                              acceleration=result)
        self.exceeded = self.limits.first_exceeded(recording)
        if self.exceeded and self.on_limit == "error":
            raise LimitError(self.exceeded[0], expected="a run within its limits")
        return recording


def _rows(values: np.ndarray):
    """An array for the compiled kernel, nested lists of floats for the interpreted one."""
    return np.ascontiguousarray(values) if BACKEND == "numba" else values.tolist()


def _guarded(out, run, *arguments) -> int:
    """A run's first row of `out` that is not finite; plain Python tells some of those by an
    exception."""
    if BACKEND == "numba":
        return run(*arguments)
    out[:] = np.nan
    try:
        return run(*arguments)
    except (OverflowError, ValueError, ZeroDivisionError):
        return int(np.flatnonzero(np.isnan(out[:, 0]))[0])


def _setpoints(setpoint, period, voltage_limit) -> np.ndarray:
    """(n, 3) setpoints [rad] as an array, or a ParameterError on what a closed loop cannot use."""
    setpoint = np.ascontiguousarray(setpoint, dtype=float)
    if setpoint.ndim != 2 or setpoint.shape[1] != 3 or not np.isfinite(setpoint).all():
        raise ParameterError(f"setpoint of shape {setpoint.shape}", expected="(n, 3), finite")
    if not len(setpoint):
        raise ParameterError("no setpoint", expected="one at least")
    if not voltage_limit > 0.0:
        raise ParameterError(f"voltage_limit {voltage_limit!r} V", expected="a positive number")
    if not (isfinite(period) and period > 0.0):
        raise ParameterError(f"period {period!r} s", expected="a positive number")
    return setpoint


def table(time, values, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(n,) times [s] and (n, 3) values as arrays, or a ParameterError on what they lack."""
    time = np.ascontiguousarray(time, dtype=float)
    values = np.ascontiguousarray(values, dtype=float)
    if time.ndim != 1 or len(time) < 1 or values.shape != (len(time), 3):
        raise ParameterError(f"time of shape {time.shape} and {name} of shape {values.shape}",
                             expected="(n,) and (n, 3)")
    if not (np.isfinite(time).all() and np.isfinite(values).all()):
        raise ParameterError(f"time or {name} has values that are not finite",
                             expected="finite numbers")
    if (np.diff(time) <= 0.0).any():
        raise ParameterError("times that do not increase", expected="increasing times")
    return time, values
