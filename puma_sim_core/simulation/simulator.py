# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The simulator of chapter 6: constraints, limits, reset, step and run.

Inputs are motor voltages that are piecewise constant, or setpoints of the digital servo; outputs
are positions, velocities, currents and, on demand, accelerations, sampled synchronously.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.checks import check_choice, check_numbers, check_positive, check_whole
from puma_sim_core.dynamics.laws import AT_REST, DELAYED, LOCKED, SENSED, TWO_MASS
from puma_sim_core.dynamics.runs import (
    ROW,
    WIDE,
    WIDE_ROW,
    accelerations,
    links_at,
    run_servo,
    run_voltages,
    servo_memory,
)
from puma_sim_core.dynamics.sensed import settled_positions
from puma_sim_core.dynamics.types import Constants, Rows, ServoLoop, State
from puma_sim_core.errors import LimitError, NonFiniteStateError, ParameterError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import Recording
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.conditions import Constraint, Limits
from puma_sim_core.simulation.delay import NO_DELAY, Past, SampledDelay, delay_of
from puma_sim_core.simulation.feedback import Controller, ControlLoop, samples_per_period
from puma_sim_core.simulation.open_circuit import enabled, opened, stretches
from puma_sim_core.simulation.run_inputs import (
    check_step,
    guarded,
    kernel_rows,
    native,
    rows_of,
    runs_compiled,
    setpoint_table,
    step_counts,
    table,
    widened,
)

#: one servo period [s], the natural step of integration (section 7.6)
SERVO_PERIOD = 0.028 / 30.0
_NOTHING = (0.0, 0.0, 0.0)


class Simulator:
    """The arm, from a state on.

    The state is the true one. Positions of a recording are what the sensors give, the same unless the plant has effects
    of sensing; its voltages are those asked for, before anything the amplifiers do to them.

    plant : the arm and its effects.
    constraints : one `Constraint` a joint of the plant; free by default.
    max_step : greatest step of integration [s]; rows that hold longer are divided evenly.
    train_rate : steps in a second [1/s] in which links that swing against their motors are followed, None: as many as
    `Plant.least_rate`; without such links it does not matter.
    limits : what runs are checked against; none by default.
    on_limit : "report" gathers sentences in `exceeded`, "error" raises LimitError after a run.

    The state is taken by `reset` and moves on with each `step` and `run`: ``state``, the tuple (q1, q2, q3, qd1, qd2,
    qd3, i1, i2, i3) of the kernel's joints (`Plant.axes` move); ``measured`` positions [rad]; ``bristles``, their
    deflections [rad]; ``further``, those of other effects with a memory; ``links``, their positions [rad] and
    velocities [rad/s]; ``past``, the voltages that a delay of the input still holds back; ``time`` [s], at which
    effects that change with time are taken. ``link_motion`` has the links at the rows of the last run, (n, 6), where
    they do not follow their motors, else None. A triple below has a number for each joint of the plant.

    Raises ParameterError: a step above 8 ms, constraints of another length.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        constraints: Sequence[Constraint] | None = None,
        max_step: float = SERVO_PERIOD,
        train_rate: float | None = None,
        limits: Limits | None = None,
        on_limit: str = "report",
    ):
        constraints = (Constraint(),) * plant.joints if constraints is None else constraints
        if len(constraints) != plant.joints or not all(isinstance(c, Constraint) for c in constraints):
            raise ParameterError(f"constraints {constraints!r}", expected="one Constraint a joint")
        check_choice(on_limit, "on_limit", ("report", "error"))
        self.plant = plant
        given = dict(zip(plant.axes, constraints))
        self.constraints = tuple(given.get(axis, Constraint("hold")) for axis in range(3))
        self.max_step = check_step(max_step, "max_step")
        self.limits = limits or Limits()
        self.on_limit = on_limit
        self.exceeded: list[str] = []
        self.link_motion: np.ndarray | None = None
        constants, active = plant.constants, plant.constants.active
        if any(c.kind != "free" for c in self.constraints):
            active |= LOCKED
        self._compiled = runs_compiled(active)
        numbers = constants.table
        if train_rate is not None and plant.least_rate:
            numbers = [*numbers[:-1], check_positive(train_rate, "train_rate")]
        #: constants of the plant as a run takes them, and the rows that constraints take out
        self.constants = Constants(constants.model._replace(active=active), native(numbers, self._compiled))
        self.lock = (
            *(0.0 if c.kind == "free" else 1.0 for c in self.constraints),
            *(c.value if c.kind == "acceleration" and c.value else 0.0 for c in self.constraints),
        )
        self._row = WIDE_ROW if active & WIDE else ROW
        self.reset()

    def reset(
        self,
        position: ArrayLike = _NOTHING,
        velocity: ArrayLike | None = None,
        current: ArrayLike = _NOTHING,
        time: float = 0.0,
    ) -> None:
        """Start from a state: true position [rad], velocity [rad/s], current [A] of the joints.

        The velocity of a joint with a constant velocity of its own is that one. Sensors have
        settled; of a delay the first voltage of the next run counts as asked for since ever.

        Raises ParameterError: not three finite numbers, or a velocity that contradicts a constraint.
        """
        axes = self.plant.axes
        q, i = widened(position, "position", axes, self.plant.rest), widened(current, "current", axes)
        given = None if velocity is None else widened(velocity, "velocity", axes)
        start = list(given or _NOTHING)
        for j, c in enumerate(self.constraints):
            fixed = 0.0 if c.kind == "hold" else c.value if c.kind == "velocity" else None
            if fixed is not None:
                if given is not None and given[j] not in (0.0, fixed):
                    what = f"initial velocity {given[j]} rad/s of joint {j + 1}"
                    raise ParameterError(what, expected=f"{fixed} rad/s, as its constraint says")
                start[j] = fixed
        self.state: tuple[float, ...] = (*q, *start, *i)
        self.bristles, self.further = AT_REST[:3], AT_REST[9:]
        self.links = links_at(self.state, time, self.constants, self.lock)
        self.measured = settled_positions(q, self.constants.table)
        self.past = self._past()
        self.time = float(time)

    def remember(self, age: ArrayLike, voltage: ArrayLike) -> None:
        """Tell a delay of the input what was asked for before now.

        age (k,) : falling [s]; voltage (k, J) [V]: asked for from age[i] ago on, the
        first one since ever. Without a delay it does nothing.
        """
        self.past = self._past(age, self.plant.spread(np.asarray(voltage, dtype=float)))

    def _past(self, age: ArrayLike = (), voltage: ArrayLike = ()) -> Past:
        return Past(delay_of(self.constants.active, self.constants.table), age, voltage)

    def step(self, voltage: ArrayLike, duration: float = SERVO_PERIOD) -> tuple[float, ...]:
        """Hold three voltages [V] for a duration [s]; returns the new state.

        Raises
        ------
        ParameterError : not three finite numbers, a duration that is not positive.
        NonFiniteStateError : the state stopped being finite; the last finite one is kept.
        """
        if not 0.0 < duration < inf:
            check_positive(duration, "duration", "s")
        volts = widened(voltage, "voltage", self.plant.axes)
        self._advance(np.array([volts]), np.array([self.time, self.time + duration]), np.array([float(duration)]))
        self.time += duration
        return self.state

    def run(
        self, time: ArrayLike, voltage: ArrayLike, *, acceleration: bool = False, enable: ArrayLike | None = None
    ) -> Recording:
        """Run through rows of voltages from the present state.

        time : (n,) [s], increasing; voltage : (n, 3) [V], row r held until time[r + 1]; the last
        row is held by nobody. acceleration : record it too [rad/s^2]. enable : (n,) or (n, 3), 0
        where a drive is off and no current flows (without it the drives are on).

        Returns a recording with the states at the same n times.

        Raises
        ------
        ParameterError : shapes, values that are not finite, times that do not increase.
        NonFiniteStateError : the state stopped being finite; names the row, keeps the state.
        LimitError : a limit was exceeded and on_limit is "error".
        """
        edges, volts = table(time, voltage, "voltage", self.plant.joints)
        volts = self.plant.spread(volts)
        past = self.past
        self._settle_form()
        try:
            if enable is None:
                out = self._advance(volts[:-1], edges, np.diff(edges))
            else:
                out = self._switched(volts, edges, enable)
        except NonFiniteStateError as error:
            self.time = float(edges[error.step - 1])
            raise
        self.time = float(edges[-1])
        return self._recorded(edges, volts, out, acceleration, past)

    def run_servo(
        self,
        setpoint: ArrayLike,
        servo: ServoConfig = ServoConfig(),
        *,
        period: float = 0.028,
        samples: int = 30,
        voltage_limit: float = 40.0,
        acceleration: bool = False,
        held_voltage: Sequence[float] = _NOTHING,
    ) -> Recording:
        """Run under the digital servo from the present state.

        setpoint : (n, 3) [rad], each held for one period [s] of `samples` servo samples, which
        are integrated in steps of at most max_step; voltage_limit : at the motors [V]; held_voltage : what was asked
        for before the first sample [V], for a servo with a delay and, where nothing ran before, a delay of the input.

        Returns a recording of n * samples + 1 rows, one a servo sample; its last voltage is held by nobody.

        Raises ParameterError, NonFiniteStateError, LimitError: as `run`.
        """
        rows = self._setpoints(setpoint, period, voltage_limit)
        held_voltage = check_numbers(held_voltage, "held_voltage")
        h = period / check_whole(samples, "samples", 1)
        compiled = self._compiled
        servo_table = native(servo.table(h, voltage_limit, self.plant.gear_ratios), compiled)
        start = servo_memory(tuple(rows[0].tolist()), self._seen(), servo_table)
        memory = native([*start, *servo.held_back(held_voltage)], compiled)

        def run(steps: int, late: SampledDelay | None, out: np.ndarray, volts: np.ndarray) -> int:
            delay = native(NO_DELAY, compiled) if late is None else late.table
            loop = ServoLoop(self.time, samples, steps, h / steps, servo_table, memory, delay)
            targets, given = rows_of(rows, compiled), (self.constants, self.lock, out, volts)
            return guarded(out, compiled, run_servo, self.whole, targets, loop, *given)

        return self._closed_loop(run, rows, h, samples, held_voltage, acceleration)

    def run_controller(
        self,
        controller: Controller,
        setpoint: ArrayLike,
        *,
        period: float = 0.028,
        voltage_limit: float = 40.0,
        chain: ServoConfig = ServoConfig(),
        acceleration: bool = False,
    ) -> Recording:
        """Run under any controller (see `closed_loop`) from the present state; it is reset first.

        setpoint : (n, 3) [rad], each held for one period [s], a whole number of the controller's own; voltage_limit :
        at the motors [V]; chain : encoder, converter, amplifier and delay around the controller, ideal by default.

        Returns a recording of a row a sample, as `run_servo`. Raises as `run`, and ParameterError for a rate that does
        not fit, or other than three voltages.
        """
        rows = self._setpoints(setpoint, period, voltage_limit)
        samples = samples_per_period(controller, period)
        h = period / samples

        def run(steps: int, late: SampledDelay | None, out: np.ndarray, volts: np.ndarray) -> int:
            kernel = (self.constants, self.lock)
            loop = ControlLoop(controller, chain, h, steps, voltage_limit, self.plant.gear_ratios, kernel, late)
            return loop.run(self.whole, rows, samples, self.time, out, volts)

        return self._closed_loop(run, rows, h, samples, _NOTHING, acceleration)

    def _settle_form(self) -> None:
        """Go over to the compiled kernel where it has become ready since the last run."""
        if runs_compiled(self.constants.active) and not self._compiled:
            self._compiled = True
            self.constants = self.constants._replace(table=native(self.constants.table))

    def _setpoints(self, setpoint: ArrayLike, period: float, voltage_limit: float) -> np.ndarray:
        """Checked setpoints (n, 3) [rad] of a closed loop, which begins."""
        self._settle_form()
        if self.plant.joints != 3:
            expected = "an arm of three: servo and controllers have its gains"
            raise ParameterError(
                f"a plant of {self.plant.joints} of the arm's joints", where="closed loop", expected=expected
            )
        return setpoint_table(setpoint, period, voltage_limit)

    @property
    def whole(self) -> State:
        """The whole state, as a step takes it."""
        return State(self.state, (*self.bristles, *self.links, *self.further), self.measured)

    def _seen(self) -> tuple[float, ...]:
        """Measured positions [rad]: the true ones where nothing is between."""
        return self.measured if self.constants.active & SENSED else self.state[:3]

    def _closed_loop(
        self,
        run: Callable[[int, SampledDelay | None, np.ndarray, np.ndarray], int],
        setpoint: np.ndarray,
        h: float,
        samples: int,
        held_voltage: Sequence[float],
        acceleration: bool,
    ) -> Recording:
        """The recording of a loop with samples each h [s], which `run` fills; returns its first bad row or -1."""
        steps, rows = int(step_counts(np.array([h]), self.max_step)[0]), len(setpoint) * samples + 1
        late, past = None, self.past
        if self.constants.active & DELAYED:
            late = SampledDelay(past.delay, h, self.max_step, self._compiled)
            late.hold(held_voltage, past)
        out, volts = np.empty((rows, self._row)), np.zeros((rows, 3))
        self._finish(run(steps, late, out, volts), out)
        if late is not None:
            if not len(past.age):
                past = Past(past.delay, [0.0], [late.first])
            self.past = late.past(past.delay)
        volts[-1] = volts[-2]
        time = self.time + h * np.arange(rows)
        self.time = float(time[-1])
        held = np.repeat(setpoint, samples, axis=0)
        return self._recorded(time, volts, out, acceleration, past, setpoint=np.vstack([held, held[-1:]]))

    def _advance(self, voltage: np.ndarray, time: np.ndarray, duration: np.ndarray) -> np.ndarray:
        """Rows of what the kernel stores, one more than there are of voltage; time: their edges."""
        rows = None
        if self.constants.active & DELAYED:
            (time, voltage, rows), past = self.past.arriving(time, voltage)
            duration = np.diff(time)
        compiled, out = self._compiled, np.empty((len(duration) + 1, self._row))
        try:
            held = kernel_rows(voltage, time, duration, self.max_step, compiled)
            self._finish(guarded(out, compiled, run_voltages, self.whole, held, self.constants, self.lock, out), out)
        except NonFiniteStateError as error:
            if rows is None:
                raise
            raise NonFiniteStateError(int(np.searchsorted(rows, error.step))) from None
        if rows is None:
            return out
        self.past = past
        return out[rows]

    def _switched(self, voltage: np.ndarray, time: np.ndarray, enable: ArrayLike) -> np.ndarray:
        """`_advance` with drives that are off in some rows; voltage has a row more, unused."""
        on = enabled(enable, len(voltage), self.plant.axes)[:-1]
        if not len(on):
            return self._advance(voltage[:-1], time, np.diff(time))
        voltage = np.where(on, voltage[:-1], 0.0)
        constants, parts = self.constants, []
        try:
            for first, after in stretches(on):
                cut = constants.model._replace(drive=opened(constants.drive, on[first]))
                self.constants = constants._replace(model=cut)
                current = np.where(on[first], self.state[6:9], 0.0).tolist()
                self.state = (*self.state[:6], *current)
                try:
                    edges = time[first : after + 1]
                    out = self._advance(voltage[first:after], edges, np.diff(edges))
                except NonFiniteStateError as error:
                    raise NonFiniteStateError(first + error.step) from None
                out[:, 6:9] *= on[first]
                # the row that ends a stretch is the first of the next
                parts.append(out if after == len(on) else out[:-1])
        finally:
            self.constants = constants
        return np.concatenate(parts)

    def _finish(self, bad_row: int, out: np.ndarray) -> None:
        """Take over the last finite state of a run, and complain where it was cut short."""
        last = len(out) - 1 if bad_row < 0 else bad_row - 1
        row = tuple(out[last].tolist())
        self.state, self.bristles = row[:9], row[9:12]
        self.measured, self.links = (row[12:15], row[15:21]) if len(row) > ROW else (row[:3], row[:6])
        self.further = row[21:] or AT_REST[9:]
        if bad_row >= 0:
            raise NonFiniteStateError(bad_row)

    def _recorded(
        self,
        time: np.ndarray,
        voltage: np.ndarray,
        out: np.ndarray,
        acceleration: bool,
        past: Past,
        setpoint: np.ndarray | None = None,
    ) -> Recording:
        result = None
        if acceleration or self.limits.acceleration is not None:
            result, acting = np.empty((len(out), 3)), voltage
            if self.constants.active & DELAYED:
                # a row longer, so that something arrives at the last one too
                pieces, _ = past.arriving(np.append(time, time[-1] + 1.0), voltage)
                acting = pieces.voltage[pieces.row[:-1]]
            rows = Rows(rows_of(acting, self._compiled), rows_of(time, self._compiled), None, None)
            accelerations(out, rows, self.constants, self.lock, result)
        self.link_motion = out[:, ROW + 3 : ROW + 9] if self.constants.active & TWO_MASS else None
        axes, seen = np.array(self.plant.axes), ROW if self.constants.active & SENSED else 0
        recording = Recording(
            time=time,
            voltage=voltage[:, axes],
            position=out[:, seen + axes],
            velocity=out[:, 3 + axes],
            current=out[:, 6 + axes],
            setpoint=setpoint,
            acceleration=None if result is None else result[:, axes],
        )
        self.exceeded = self.limits.first_exceeded(recording)
        if self.exceeded and self.on_limit == "error":
            raise LimitError(self.exceeded[0], expected="a run within its limits")
        return recording
