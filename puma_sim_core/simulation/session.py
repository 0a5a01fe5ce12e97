# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A session: commands in, one period of the arm at a time, states out.

The node runs one and so does a replay; there is no ROS, no clock and no file in it. Time is the
step times the period. What comes between states k and k + 1 acts from state k on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from operator import mul
from typing import Any, NamedTuple, NoReturn

import numpy as np

from puma_sim_core.dynamics.laws import AT_REST, BRISTLE, LOCKED, MEMORY, SENSED, TWO_MASS
from puma_sim_core.dynamics.runs import ROW, WIDE, WIDE_ROW, links_at, run_servo, servo_memory, supply_voltages
from puma_sim_core.dynamics.sensed import settled_positions
from puma_sim_core.dynamics.types import FREE, ServoLoop, State
from puma_sim_core.effects import Effect
from puma_sim_core.errors import CommandError, NonFiniteStateError, PumaSimError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.delay import NO_DELAY, SampledDelay, delay_of
from puma_sim_core.simulation.feedback import ControlLoop, HeldVoltage, Kernel, unpacked
from puma_sim_core.simulation.run_inputs import native, rows_of, runs_compiled
from puma_sim_core.simulation.session_config import SessionConfig, Triple

_NOTHING = (0.0, 0.0, 0.0)
#: all rows are taken out: the brakes hold
_HELD = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)


class Command(NamedTuple):
    """A command as it was accepted: joint names (None: all three in order) and values."""

    names: tuple[str, ...] | None
    values: tuple[float, ...]


class Placement(NamedTuple):
    """Joints as they were put somewhere: names, positions [rad] and velocities [rad/s], a number for each name."""

    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]


class Effects(NamedTuple):
    """Effects that act from a state on, in place of those before."""

    effects: tuple[Effect, ...]


class SessionState(NamedTuple):
    """The arm at the end of a step. Triples, joint by joint."""

    step: int
    time_ns: int
    position: Triple  #: as the sensors give it [rad]
    velocity: Triple  #: [rad/s]
    current: Triple  #: [A]
    voltage: Triple  #: asked of the supply, last in the step [V]
    effort: Triple  #: torque of the motor at the joint, kT i [N.m]


@dataclass
class Counters:
    """What happened: commands refused, values clipped, steps that ended with a joint at the end of its range or beyond,
    and times that the brakes engaged."""

    rejected: int = 0
    saturated: int = 0
    limited: int = 0
    braked: int = 0


class Session:
    """The arm under commands, one period a step. See `SessionConfig` for the rules.

    Positions are given and taken as the sensors measure them; the initial position and placements are true ones.
    Voltages are given within the supply, without what else the amplifiers do.

    Brakes stop their motors at once and hold them; voltages are 0 V meanwhile, and what a delay of the input held back
    is gone. Behind a soft joint the link swings on. When they let go the controller starts from rest.
    """

    def __init__(self, config: SessionConfig):
        self.config = config
        self._h = config.period / config.substeps
        self._period_ns, self._timeout = config.period_ns, config.timeout_steps
        self._by_volts, limit = config.command_interface == "voltage", config.voltage_limit
        self._ranges = ((-limit, limit),) * 3 if self._by_volts else config.plant.arm.joint_ranges
        self._servo_volts = np.empty((config.substeps, 3))
        self._late: SampledDelay | None = None
        self._loop: ControlLoop | None = None
        self._memory: Any = ()
        self._asked: Sequence[float] = _NOTHING
        self.reset()

    def reset(self) -> None:
        """Back to the initial state and plant: motors, servo, watchdog, brakes, counters and step count too."""
        c = self.config
        self._start(c.plant)
        self._whole = self._rest((*c.initial_position, *c.initial_velocity, *c.initial_current), 0.0)
        self._target = list(_NOTHING if self._by_volts else self._whole.m)
        self._fresh = False
        self._memory = self._servo_at_rest()
        if self._late is not None:
            self._late.hold(_NOTHING)
        if self._loop is not None:
            self._loop.reset()
        #: whether the brakes will hold in the next step, and whether they did in the last one
        self.braking = self.braked = c.brakes
        if c.brakes:
            self._hold()
        self.command_age_steps = 0
        self.counters = Counters()
        self._asked = _NOTHING
        self.state = self._state(0)

    # ---- what acts from the present state on

    def command(self, values: Sequence[float]) -> Command:
        """Take a command for all joints: volts or radians, as the command interface says.

        Returns the command as it was given; values out of range act clipped and are counted. The brakes let go.

        Raises CommandError: not three finite numbers; the last good command stays.
        """
        return self._take(None, (0, 1, 2), values)

    def command_joints(self, names: Sequence[str], values: Sequence[float]) -> Command:
        """Take a command [rad] for some joints by name; the others keep theirs.

        Raises CommandError: unknown or repeated joint, numbers that are missing or not finite, or a session that takes
        volts; the last good command stays.
        """
        if self._by_volts:
            self._refuse("a command by joint name in a session that takes volts", "command_interface position")
        return self._take(tuple(names), self._joints(names), values)

    def brake(self, engaged: bool) -> None:
        """Engage the brakes, or let go without a command: voltages are then 0 V, and setpoints where the arm is.

        Raises CommandError: a session without brakes.
        """
        if not self.config.brakes:
            self._refuse("this arm has no brakes", "parameter brakes true")
        self.braking = bool(engaged)

    def place(self, names: Sequence[str], position: Sequence[float], velocity: Sequence[float]) -> Placement:
        """Put joints at true positions [rad] and velocities [rad/s]; without velocities they are at rest.

        Their motors have no current, sensors have settled, the servo is at rest with the setpoints of these joints
        where they are. Brakes that hold in the next step stop them. Returns what was done.

        Raises CommandError: unknown or repeated joint, not a finite number for each, a position out of its joint's
        range.
        """
        joints = self._joints(names)
        q, w = self._numbers(position, len(joints)), self._numbers(velocity or [0.0] * len(joints), len(joints))
        x, ranges = list(self._whole.x), self.config.plant.arm.joint_ranges
        for name, j, angle, speed in zip(names, joints, q, w):
            low, high = ranges[j]
            if not low <= angle <= high:
                self._refuse(f"{name} at {angle!r} rad", f"{low:.4f} to {high:.4f}")
            x[j], x[3 + j], x[6 + j] = angle, speed, 0.0
        self._whole = self._rest(tuple(x), self.state.step * self.config.period)
        if not self._by_volts:
            for j in joints:
                self._target[j] = self._seen()[j]
        self._rest_controller()
        self.state = self._state(self.state.step)
        return Placement(tuple(names), q, w)

    def use_effects(self, effects: Iterable[Effect]) -> Effects:
        """Go on with other effects from the present state: loads, friction and all else.

        What both plants have, such as links on elastic joints or a lag of the sensors, goes on as it is; what is new
        begins at rest. Returns what was done.

        Raises ParameterError: effects that this arm cannot have; nothing changes then.
        """
        plant = replace(self.plant, effects=tuple(effects))
        before = self._constants.active
        _ = plant.constants
        self._start(plant)
        x, z, m = self._whole
        now = self._constants.active
        rest = self._rest(x, self.state.step * self.config.period)
        bristles = z[:3] if before & now & BRISTLE else rest.z[:3]
        links = z[3:9] if before & now & TWO_MASS else rest.z[3:9]
        further = z[9:] if before & now & MEMORY else rest.z[9:]
        self._whole = State(x, (*bristles, *links, *further), m if before & now & SENSED else rest.m)
        self.state = self._state(self.state.step)
        return Effects(plant.effects)

    def _refuse(self, what: str, expected: str) -> NoReturn:
        self.counters.rejected += 1
        raise CommandError(what, where="command", expected=expected)

    def _joints(self, names: Sequence[str]) -> tuple[int, ...]:
        """Numbers of joints by name."""
        known, names = self.config.joint_names, tuple(names)
        unknown = [name for name in names if name not in known]
        if not names or unknown:
            what = f"unknown joint '{unknown[0]}'" if unknown else "no joint names"
            self._refuse(what, f"some of {', '.join(known)}")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            self._refuse(f"joint '{twice}' stands twice", "each joint once")
        return tuple(known.index(name) for name in names)

    def _numbers(self, values: Sequence[float], count: int) -> tuple[float, ...]:
        values = tuple(values)
        try:
            numbers = tuple(map(float, values))
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) != count or not all(map(isfinite, numbers)):
            self._refuse(f"{list(values)!r}", f"{count} finite numbers")
        return numbers

    def _take(self, names: tuple[str, ...] | None, joints: Sequence[int], values: Sequence[float]) -> Command:
        numbers = self._numbers(values, len(joints))
        for j, value in zip(joints, numbers):
            low, high = self._ranges[j]
            self._target[j] = min(max(value, low), high)
            self.counters.saturated += self._target[j] != value
        self._fresh = True
        self.braking = False
        return Command(names, numbers)

    # ---- steps

    def step(self) -> SessionState:
        """One period; returns the new state.

        Raises NonFiniteStateError: names the step; the state stays the last finite one.
        """
        if runs_compiled(self._constants.active) and not self._compiled:
            self._start(self.plant)
        self._watch()
        step, time = self.state.step + 1, self.state.step * self.config.period
        self._asked = _NOTHING
        try:
            if self.braked:
                row = self._parked.run(self._whole, time, _NOTHING)
            elif self._by_volts:
                self._asked = tuple(self._target)
                row = self._held.run(self._whole, time, self._asked)
            else:
                row, self._asked = self._step_position(time)
        except PumaSimError:
            raise
        except (OverflowError, ValueError, ZeroDivisionError):
            row = None
        if row is None:
            raise NonFiniteStateError(step)
        self._whole = unpacked(row)
        self.state = self._state(step)
        self.counters.limited += any(self.at_limit)
        return self.state

    @property
    def setpoint(self) -> tuple[float, ...]:
        """The setpoint in force [rad], or the voltages [V]."""
        return tuple(self._target)

    @property
    def compiled(self) -> bool:
        """Whether the last step was made by the compiled kernel."""
        return self._compiled

    @property
    def at_limit(self) -> tuple[bool, ...]:
        """Whether each joint is at an end of its range, or beyond it."""
        return tuple(not low < q < high for q, (low, high) in zip(self._whole.x, self.config.plant.arm.joint_ranges))

    def _watch(self) -> None:
        """Count the age of the command, let go of one that is too old, and move the brakes."""
        self.command_age_steps = 0 if self._fresh else self.command_age_steps + 1
        self._fresh = False
        if self.command_age_steps == self._timeout and self._timeout:
            self._target = list(_NOTHING if self._by_volts else self._seen())
            self.braking = self.config.brakes
        if self.braking:
            self.counters.braked += not self.braked
            self._hold()
        elif self.braked:
            self._rest_controller()
        self.braked = self.braking

    def _hold(self) -> None:
        """The brakes hold the motors where they are."""
        x, z, m = self._whole
        self._whole = State((*x[:3], *_NOTHING, *x[6:]), z, m)
        self._target = list(_NOTHING if self._by_volts else self._seen())

    def _rest_controller(self) -> None:
        """What acts on the drives begins again where the arm is."""
        self._memory = self._servo_at_rest()
        if self._late is not None:
            self._late.hold(_NOTHING)
        if self._loop is not None:
            self._loop.reset()

    def _seen(self) -> Sequence[float]:
        """Measured positions [rad]."""
        return self._whole.m if self._constants.active & SENSED else self._whole.x[:3]

    def _servo_at_rest(self) -> Any:
        """Memory of the servo with its setpoints where the arm is."""
        seen = tuple(self._seen())
        return native([*servo_memory(seen, seen, self._servo), *self.config.servo.held_back()], self._compiled)

    def _step_position(self, time: float) -> tuple[np.ndarray | None, Sequence[float]]:
        """The row at the end of a step under a controller, None where it is not finite, and the last voltages [V]."""
        samples, out, volts = self.config.substeps, self._servo_out, self._servo_volts
        if self._loop is None:
            row = self._target_row[0]
            row[0], row[1], row[2] = self._target
            late = self._no_delay if self._late is None else self._late.table
            loop = ServoLoop(time, samples, 1, self._h, self._servo, self._memory, late)
            bad = run_servo(self._whole, self._target_row, loop, *self._kernel, out, volts)
        else:
            bad = self._loop.run(self._whole, [self._target], samples, time, out, volts)
        return (None if bad >= 0 else out[-1]), volts[-1].tolist()

    # ---- the plant, in the form in which the kernel runs

    def _start(self, plant: Plant) -> None:
        """Go on with a plant, and with the compiled kernel where that is ready."""
        config, constants = self.config, plant.constants
        active, compiled = constants.active, runs_compiled(constants.active)
        self.plant, self._compiled, self._kT = plant, compiled, plant.torque_per_ampere
        self._constants = constants._replace(table=native(constants.table, compiled))
        self._kernel: Kernel = (self._constants, FREE)
        self._servo = native(config.servo.table(self._h, config.voltage_limit, plant.gear_ratios), compiled)
        self._target_row = rows_of(np.zeros((1, 3)), compiled)
        self._no_delay = native(NO_DELAY, compiled)
        self._take_delay(delay_of(active, constants.table))
        self._memory = native(self._memory, compiled)
        self._held = HeldVoltage(self._kernel, config.substeps, self._h, self._late)
        locked = self._constants._replace(model=constants.model._replace(active=active | LOCKED))
        self._parked = HeldVoltage((locked, _HELD), config.substeps, self._h, None)
        self._servo_out = np.empty((config.substeps + 1, WIDE_ROW if active & WIDE else ROW))
        if self._loop is not None:
            self._loop.use(self._kernel, self._late)
        elif config.controller != "pid":
            made, limit, ratios = config.make_controller(), config.voltage_limit, plant.gear_ratios
            self._loop = ControlLoop(made, config.servo, self._h, 1, limit, ratios, self._kernel, self._late)

    def _take_delay(self, delay: float) -> None:
        """A delay [s] of the input; one that is new begins with the voltages that are asked for now."""
        former, self._late = self._late, None
        if delay:
            sample = self.config.period if self._by_volts else self._h
            self._late = SampledDelay(delay, sample, self._h, self._compiled)
            if former is not None and former.delay == delay:
                self._late.table = native(former.table, self._compiled)
            else:
                self._late.hold(self._asked)

    def _rest(self, x: tuple[float, ...], time: float) -> State:
        """The whole state whose bristles are slack, links follow their motors, and sensors have settled."""
        z = (*_NOTHING, *links_at(x, time, *self._kernel), *AT_REST[9:])
        sensed = self._constants.active & SENSED
        return State(x, z, settled_positions(x[:3], self._constants.table) if sensed else x[:3])

    def _state(self, step: int) -> SessionState:
        x, (v1, v2, v3) = self._whole.x, self._asked
        return SessionState(
            step=step,
            time_ns=step * self._period_ns,
            position=tuple(self._seen()),
            velocity=x[3:6],
            current=x[6:9],
            voltage=tuple(supply_voltages(v1, v2, v3, self._constants.table)),
            effort=tuple(map(mul, self._kT, x[6:9])),
        )
