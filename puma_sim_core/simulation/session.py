# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A session: commands in, one period of the arm at a time, states out.

The node runs one and so does a replay; there is no ROS, no clock and no file in it. Time is the
step times the period. A command that comes between states k and k + 1 acts from state k on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from math import isfinite
from typing import NamedTuple

import numpy as np

from puma_sim_core import __version__
from puma_sim_core.control.controllers import load_settings, make_controller
from puma_sim_core.dynamics.laws import AT_REST, SENSED
from puma_sim_core.dynamics.pid import Pid
from puma_sim_core.dynamics.runs import ROW, WIDE, WIDE_ROW, servo_memory, supply_voltages
from puma_sim_core.dynamics.sensed import settled_positions
from puma_sim_core.dynamics.servo import ServoConfig
from puma_sim_core.dynamics.two_mass_runs import links_at, run_servo
from puma_sim_core.dynamics.types import FREE, ServoLoop, State
from puma_sim_core.errors import CommandError, ModelError, NonFiniteStateError, ParameterError, PumaSimError
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.model_file import plant_of_mapping
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.delay import NO_DELAY, SampledDelay, delay_of
from puma_sim_core.simulation.feedback import ControlLoop, HeldRows, unpacked
from puma_sim_core.simulation.run_inputs import check_step, native, three

SESSION_FORMAT = "puma-sim session 1"
COMMAND_INTERFACES = ("voltage", "position")
_NOTHING = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class SessionConfig:
    """All that decides how a session goes, commands apart.

    Attributes
    ----------
    plant : the arm and its effects.
    command_interface : "voltage" (motor volts) or "position" (setpoints of the digital servo).
    period : between states and commands [s]; substeps : steps of integration, and servo samples,
        in a period.
    voltage_limit : commands beyond +- this [V] are clipped and counted.
    command_timeout : without a good command for this long [s], counted in steps, voltage commands
        fall to 0 V and the position servo holds where the arm is; 0 disables.
    initial_position [rad], initial_velocity [rad/s], initial_current [A] : of the three joints.
    servo : the digital servo of the position interface.
    controller : what computes its volts: "pid" with the servo's gains, "scheduled" or
        "computed_torque" with the servo's encoder, converter, amplifier and delay around it and
        the session's own arm, without its effects, as the model.
    controller_settings : of a controller other than "pid", see `control.controllers`; None for
        those of config/controllers.yaml.

    Raises
    ------
    ParameterError : names the value and what was expected.
    """

    plant: Plant
    command_interface: str = "voltage"
    period: float = 0.028
    substeps: int = 30
    voltage_limit: float = 40.0
    command_timeout: float = 0.5
    initial_position: tuple[float, float, float] = _NOTHING
    initial_velocity: tuple[float, float, float] = _NOTHING
    initial_current: tuple[float, float, float] = _NOTHING
    servo: ServoConfig = field(default_factory=ServoConfig)
    joint_names: tuple[str, str, str] = ("joint1", "joint2", "joint3")
    frame_id: str = "base_link"
    controller: str = "pid"
    controller_settings: Mapping | None = None

    def __post_init__(self):
        if self.plant.joints != 3:
            raise ParameterError(
                f"a model of {self.plant.joints} joint",
                where="session",
                expected="a model of an arm of three; `puma-sim simulate` runs models of one joint",
            )
        if self.command_interface not in COMMAND_INTERFACES:
            raise ParameterError(
                f"command_interface '{self.command_interface}'", expected=" or ".join(COMMAND_INTERFACES)
            )
        if isinstance(self.substeps, bool) or not isinstance(self.substeps, int) or self.substeps < 1:
            raise ParameterError(f"substeps {self.substeps!r}", expected="a whole number of at least 1")
        if not isfinite(self.period) or not 0.0 < self.period <= 10.0:
            raise ParameterError(f"period {self.period!r} s", expected="more than 0, at most 10 s")
        check_step(self.period / self.substeps, "period / substeps")
        if not (isfinite(self.voltage_limit) and self.voltage_limit > 0.0):
            raise ParameterError(f"voltage_limit {self.voltage_limit!r} V", expected="a positive number")
        if not (isfinite(self.command_timeout) and self.command_timeout >= 0.0):
            raise ParameterError(f"command_timeout {self.command_timeout!r} s", expected="0 or more")
        for name in ("period", "voltage_limit", "command_timeout"):
            object.__setattr__(self, name, float(getattr(self, name)))
        for name in ("initial_position", "initial_velocity", "initial_current"):
            object.__setattr__(self, name, three(getattr(self, name), name))
        names = tuple(self.joint_names)
        object.__setattr__(self, "joint_names", names)
        if len(names) != 3 or len(set(names)) != 3 or not all(isinstance(name, str) and name for name in names):
            raise ParameterError(f"joint_names {names!r}", expected="three different names")
        self._settle_controller()

    def _settle_controller(self) -> None:
        """Take over the controller's settings, so that a record of them is complete."""
        if self.controller == "pid":
            if self.controller_settings is not None:
                raise ParameterError(
                    "controller_settings of controller 'pid'", expected="none: its gains are the servo's"
                )
            return
        settings = self.controller_settings
        settings = load_settings(self.controller) if settings is None else deepcopy(settings)
        object.__setattr__(self, "controller_settings", settings)
        self.make_controller()
        if self.command_interface != "position":
            raise ParameterError(
                f"controller '{self.controller}'",
                expected="pid, or command_interface position: no controller acts on commands in volts",
            )

    def make_controller(self):
        """The controller of the position interface as an object (see `control.controllers`); for
        "pid" the servo is compiled, and this is its equal.

        Raises
        ------
        ParameterError : names the setting that cannot be.
        """
        h, limit = self.period / self.substeps, self.voltage_limit / self.servo.amplifier_gain
        if self.controller == "pid":
            return Pid(
                self.servo.gains,
                h,
                limit=limit,
                anti_windup=self.servo.anti_windup,
                on_measurement=self.servo.derivative_on_measurement,
            )
        return make_controller(
            self.controller,
            self.plant,
            self.controller_settings,
            h,
            self.voltage_limit,
            setpoint_period=self.period,
            amplifier_gain=self.servo.amplifier_gain,
        )

    @property
    def period_ns(self) -> int:
        """The period in whole nanoseconds, as time stamps have it."""
        return round(self.period * 1e9)

    @property
    def timeout_steps(self) -> int:
        """Steps without a command after which the watchdog acts; 0 for never."""
        return max(1, round(self.command_timeout / self.period)) if self.command_timeout else 0

    def to_mapping(self) -> dict:
        """Plain values from which `from_mapping` makes an equal session; every digit is kept."""
        return {
            "format": SESSION_FORMAT,
            "version": __version__,
            "kernel": BACKEND,
            "command_interface": self.command_interface,
            "period": self.period,
            "substeps": self.substeps,
            "voltage_limit": self.voltage_limit,
            "command_timeout": self.command_timeout,
            "initial_position": list(self.initial_position),
            "initial_velocity": list(self.initial_velocity),
            "initial_current": list(self.initial_current),
            "servo": self.servo.to_mapping(),
            **self._controller_mapping(),
            "joint_names": list(self.joint_names),
            "frame_id": self.frame_id,
            "model": self.plant.to_mapping(),
        }

    def _controller_mapping(self) -> dict:
        # without a key for the default, earlier versions read the sessions that they can run
        return (
            {}
            if self.controller == "pid"
            else {"controller": self.controller, "controller_settings": deepcopy(self.controller_settings)}
        )

    @classmethod
    def from_mapping(cls, mapping: Mapping, where: str | None = None) -> SessionConfig:
        """The inverse of `to_mapping`.

        Raises
        ------
        ModelError : another format, an unknown key or effect, a value that is not usable.
        """
        if not isinstance(mapping, Mapping) or mapping.get("format") != SESSION_FORMAT:
            found = mapping.get("format") if isinstance(mapping, Mapping) else mapping
            raise ModelError(
                f"session format {found!r}",
                where=where,
                expected=f"'{SESSION_FORMAT}', which version {__version__} reads",
            )
        values = {k: v for k, v in mapping.items() if k not in ("format", "version", "kernel")}
        plant = plant_of_mapping(values.pop("model", None), where)
        try:
            servo = ServoConfig.from_mapping(values.pop("servo", {}))
            return cls(plant=plant, servo=servo, **values)
        except ParameterError as error:
            raise ModelError(
                error.what, where=" ".join(filter(None, (where, error.where))) or None, expected=error.expected
            ) from None
        except TypeError as error:
            raise ModelError(str(error), where=where, expected="the keys of a session") from None


class Command(NamedTuple):
    """A command as it was accepted: joint names (None: all three in order) and values."""

    names: tuple[str, ...] | None
    values: tuple[float, ...]


class SessionState(NamedTuple):
    """The arm at the end of a step. Triples, joint by joint."""

    step: int
    time_ns: int
    position: tuple[float, float, float]  #: as the sensors give it [rad]
    velocity: tuple[float, float, float]  #: [rad/s]
    current: tuple[float, float, float]  #: [A]
    voltage: tuple[float, float, float]  #: asked of the supply, last in the step [V]
    effort: tuple[float, float, float]  #: torque of the motor at the joint, kT i [N.m]


@dataclass
class Counters:
    """What happened to commands: refused ones, and values that were clipped."""

    rejected: int = 0
    saturated: int = 0


class Session:
    """The arm under commands, one period a step. See `SessionConfig` for the rules.

    Positions are given and taken as the sensors measure them; the initial position alone is the
    true one. Voltages are given within the supply, without what else the amplifiers do.
    """

    def __init__(self, config: SessionConfig):
        self.config = config
        plant = config.plant
        active, table = plant.constants.active, plant.constants.table
        self._constants = plant.constants._replace(table=native(table))
        self._kernel = (self._constants, FREE)
        self._h = config.period / config.substeps
        self._period_ns = config.period_ns
        self._timeout = config.timeout_steps
        self._kT = plant.torque_per_ampere
        self._ranges = (
            plant.arm.joint_ranges
            if config.command_interface == "position"
            else ((-config.voltage_limit, config.voltage_limit),) * 3
        )
        self._servo = native(
            config.servo.table(self._h, config.voltage_limit, [m.gear_ratio for m in plant.arm.motors])
        )
        width = WIDE_ROW if active & WIDE else ROW
        self._target_row = np.zeros((1, 3)) if BACKEND == "numba" else [[0.0, 0.0, 0.0]]
        delay = delay_of(active, table)
        sample = config.period if config.command_interface == "voltage" else self._h
        self._late = SampledDelay(delay, sample, self._h) if delay else None
        self._rows = HeldRows(1 if self._late is None else 2, width)
        self._servo_out = np.empty((config.substeps + 1, width))
        self._servo_volts = np.empty((config.substeps, 3))
        self._loop = (
            None
            if config.controller == "pid"
            else ControlLoop(
                config.make_controller(),
                config.servo,
                self._h,
                1,
                config.voltage_limit,
                [m.gear_ratio for m in plant.arm.motors],
                self._kernel,
            )
        )
        if self._loop is not None:
            self._loop.late = self._late
        self.reset()

    def reset(self) -> None:
        """Back to the initial state: motors, servo, watchdog, counters and step count too."""
        c = self.config
        x = (*c.initial_position, *c.initial_velocity, *c.initial_current)
        z = (*_NOTHING, *links_at(x, 0.0, *self._kernel), *AT_REST[9:])
        m = c.initial_position
        if self._constants.active & SENSED:
            m = settled_positions(c.initial_position, self._constants.table)
        self._whole = State(x, z, m)
        self._target = list(m if c.command_interface == "position" else _NOTHING)
        self._memory = native([*servo_memory(m, m, self._servo), *c.servo.held_back()])
        if self._late is not None:
            self._late.hold(_NOTHING)
        if self._loop is not None:
            self._loop.reset()
        self._fresh = False
        self.command_age_steps = 0
        self.counters = Counters()
        self.state = self._state(0, _NOTHING)

    def command(self, values: Sequence[float]) -> Command:
        """Take a command for all joints: volts or radians, as the command interface says.

        Returns the command as it was given; values out of range act clipped and are counted.

        Raises
        ------
        CommandError : not three finite numbers; the last good command stays.
        """
        return self._take(None, (0, 1, 2), values)

    def command_joints(self, names: Sequence[str], values: Sequence[float]) -> Command:
        """Take a command [rad] for some joints by name; the others keep theirs.

        Raises
        ------
        CommandError : unknown or repeated joint, numbers that are missing or not finite, or a
            session that takes volts; the last good command stays.
        """
        known = self.config.joint_names
        names = tuple(names)
        problem = None
        if self.config.command_interface != "position":
            problem = ("a command by joint name in a session that takes volts", "command_interface position")
        elif not names:
            problem = ("no joint names", f"some of {', '.join(known)}")
        else:
            for name in names:
                if name not in known:
                    problem = (f"unknown joint '{name}'", f"some of {', '.join(known)}")
                elif names.count(name) > 1:
                    problem = (f"joint '{name}' stands twice", "each joint once")
        if problem:
            self.counters.rejected += 1
            raise CommandError(problem[0], where="command", expected=problem[1])
        return self._take(names, tuple(known.index(name) for name in names), values)

    def _take(self, names, joints, values) -> Command:
        values = tuple(values)
        try:
            numbers = tuple(map(float, values))
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) != len(joints) or not all(map(isfinite, numbers)):
            self.counters.rejected += 1
            raise CommandError(f"{list(values)!r}", where="command", expected=f"{len(joints)} finite numbers")
        for j, value in zip(joints, numbers):
            low, high = self._ranges[j]
            clipped = min(max(value, low), high)
            if clipped != value:
                self.counters.saturated += 1
            self._target[j] = clipped
        self._fresh = True
        return Command(names, numbers)

    def step(self) -> SessionState:
        """One period; returns the new state.

        Raises
        ------
        NonFiniteStateError : names the step; the state stays the last finite one.
        """
        self._watch()
        try:
            if self.config.command_interface == "voltage":
                bad, row, voltage = self._step_voltage()
            elif self._loop is None:
                bad, row, voltage = self._step_servo()
            else:
                bad, row, voltage = self._step_controller()
        except PumaSimError:
            raise
        except (OverflowError, ValueError, ZeroDivisionError):
            bad, row, voltage = 1, None, _NOTHING
        step = self.state.step + 1
        if bad >= 0:
            raise NonFiniteStateError(step)
        self._whole = unpacked(row)
        self.state = self._state(step, voltage)
        return self.state

    def _watch(self) -> None:
        """Count the age of the command, and let go of one that is too old."""
        if self._fresh:
            self._fresh = False
            self.command_age_steps = 0
            return
        self.command_age_steps += 1
        if self.command_age_steps == self._timeout:
            self._target = list(self._seen() if self.config.command_interface == "position" else _NOTHING)

    def _seen(self):
        """Measured positions [rad]."""
        return self._whole.m if self._constants.active & SENSED else self._whole.x[:3]

    def _time(self) -> float:
        """Simulated time at the start of the step [s]."""
        return self.state.step * self.config.period

    def _step_voltage(self):
        rows = (
            ([self._target], [self.config.substeps], [self._h])
            if self._late is None
            else (self._late.take(self._target), self._late.counts, self._late.steps)
        )
        end = self._rows.run(self._whole, self._time(), rows, self._kernel)
        return (1, None, _NOTHING) if end is None else (-1, end, self._target)

    def _step_servo(self):
        row = self._target_row[0]
        row[0], row[1], row[2] = self._target
        loop = ServoLoop(
            self._time(),
            self.config.substeps,
            1,
            self._h,
            self._servo,
            self._memory,
            NO_DELAY if self._late is None else self._late.table,
        )
        bad = run_servo(self._whole, self._target_row, loop, *self._kernel, self._servo_out, self._servo_volts)
        return bad, self._servo_out[-1], self._servo_volts[-1].tolist()

    def _step_controller(self):
        bad = self._loop.run(
            self._whole, [self._target], self.config.substeps, self._time(), self._servo_out, self._servo_volts
        )
        return bad, self._servo_out[-1], self._servo_volts[-1].tolist()

    def _state(self, step, voltage) -> SessionState:
        _, _, _, w1, w2, w3, i1, i2, i3 = self._whole.x
        k1, k2, k3 = self._kT
        return SessionState(
            step,
            step * self._period_ns,
            tuple(self._seen()),
            (w1, w2, w3),
            (i1, i2, i3),
            tuple(supply_voltages(*voltage, self._constants.table)),
            (k1 * i1, k2 * i2, k3 * i3),
        )
