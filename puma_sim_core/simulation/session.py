# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A session: commands in, one period of the arm at a time, states out.

The node runs one and so does a replay; there is no ROS, no clock and no file in it. Time is the
step times the period. A command that comes between states k and k + 1 acts from state k on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from math import isfinite
from operator import mul
from typing import Any, NamedTuple, NoReturn

import numpy as np

from puma_sim_core import __version__
from puma_sim_core.checks import check_choice, check_numbers, check_positive, check_whole
from puma_sim_core.control.controllers import load_settings, make_controller
from puma_sim_core.dynamics.laws import AT_REST, SENSED
from puma_sim_core.dynamics.runs import ROW, WIDE, WIDE_ROW, links_at, run_servo, servo_memory, supply_voltages
from puma_sim_core.dynamics.sensed import settled_positions
from puma_sim_core.dynamics.types import FREE, ServoLoop, State
from puma_sim_core.errors import CommandError, ModelError, NonFiniteStateError, ParameterError, PumaSimError
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.model_file import plant_of_mapping
from puma_sim_core.plant.plant import Plant, made_of_model
from puma_sim_core.servo.pid import Pid
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.delay import NO_DELAY, SampledDelay, delay_of
from puma_sim_core.simulation.feedback import Controller, ControlLoop, HeldVoltage, Kernel, unpacked
from puma_sim_core.simulation.run_inputs import check_step, native, rows_of

SESSION_FORMAT = "puma-sim session 1"
COMMAND_INTERFACES = ("voltage", "position")
_NOTHING = (0.0, 0.0, 0.0)
Triple = tuple[float, ...]


@dataclass(frozen=True)
class SessionConfig:
    """All that decides how a session goes, commands apart.

    Attributes
    ----------
    plant : the arm and its effects.
    command_interface : "voltage" (motor volts) or "position" (setpoints of the digital servo).
    period : between states and commands [s]; substeps : steps of integration, and servo samples, in a period.
    voltage_limit : commands beyond +- this [V] are clipped and counted.
    command_timeout : without a good command for this long [s], counted in steps, voltage commands fall to 0 V and the
        position servo holds where the arm is; 0 disables.
    initial_position [rad], initial_velocity [rad/s], initial_current [A] : of the three joints.
    servo : the digital servo of the position interface.
    controller : what computes its volts: "pid" with the servo's gains, "scheduled" or "computed_torque" with the
        servo's encoder, converter, amplifier and delay around it and the session's own arm, without effects, as model.
    controller_settings : of a controller other than "pid", see `control.controllers`; by default those of
        config/controllers.yaml.

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
    initial_position: Triple = _NOTHING
    initial_velocity: Triple = _NOTHING
    initial_current: Triple = _NOTHING
    servo: ServoConfig = field(default_factory=ServoConfig)
    joint_names: tuple[str, str, str] = ("joint1", "joint2", "joint3")
    frame_id: str = "base_link"
    controller: str = "pid"
    controller_settings: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if self.plant.joints != 3:
            expected = "a model of an arm of three; `puma-sim simulate` runs models of one joint"
            raise ParameterError(f"a model of {self.plant.joints} joint", where="session", expected=expected)
        check_choice(self.command_interface, "command_interface", COMMAND_INTERFACES)
        check_whole(self.substeps, "substeps", 1)
        if not isfinite(self.period) or not 0.0 < self.period <= 10.0:
            raise ParameterError(f"period {self.period!r} s", expected="more than 0, at most 10 s")
        check_step(self.period / self.substeps, "period / substeps")
        check_positive(self.voltage_limit, "voltage_limit", "V")
        if not (isfinite(self.command_timeout) and self.command_timeout >= 0.0):
            raise ParameterError(f"command_timeout {self.command_timeout!r} s", expected="0 or more")
        for name in ("period", "voltage_limit", "command_timeout"):
            object.__setattr__(self, name, float(getattr(self, name)))
        for name in ("initial_position", "initial_velocity", "initial_current"):
            object.__setattr__(self, name, check_numbers(getattr(self, name), name))
        names = tuple(self.joint_names)
        object.__setattr__(self, "joint_names", names)
        if not len(names) == len(set(names)) == 3 or not all(isinstance(name, str) and name for name in names):
            raise ParameterError(f"joint_names {names!r}", expected="three different names")
        self._settle_controller()

    def _settle_controller(self) -> None:
        """Take over the controller's settings, so that a record of them is complete."""
        if self.controller == "pid":
            if self.controller_settings is not None:
                expected = "none: its gains are the servo's"
                raise ParameterError("controller_settings of controller 'pid'", expected=expected)
            return
        settings = self.controller_settings
        settings = load_settings(self.controller) if settings is None else deepcopy(settings)
        object.__setattr__(self, "controller_settings", settings)
        self.make_controller()
        if self.command_interface != "position":
            expected = "pid, or command_interface position: no controller acts on commands in volts"
            raise ParameterError(f"controller '{self.controller}'", expected=expected)

    def make_controller(self) -> Controller:
        """The controller of the position interface as an object; for "pid" the equal of the servo, which is compiled.

        Raises ParameterError: names the setting that cannot be.
        """
        h, limit, servo = self.period / self.substeps, self.voltage_limit, self.servo
        if self.controller != "pid":
            return make_controller(
                self.controller,
                self.plant,
                self.controller_settings,
                h,
                limit,
                setpoint_period=self.period,
                amplifier_gain=servo.amplifier_gain,
            )
        limit, on_measurement = limit / servo.amplifier_gain, servo.derivative_on_measurement
        return Pid(servo.gains, h, limit=limit, anti_windup=servo.anti_windup, on_measurement=on_measurement)

    @property
    def period_ns(self) -> int:
        """The period in whole nanoseconds, as time stamps have it."""
        return round(self.period * 1e9)

    @property
    def timeout_steps(self) -> int:
        """Steps without a command after which the watchdog acts; 0 for never."""
        return max(1, round(self.command_timeout / self.period)) if self.command_timeout else 0

    def to_mapping(self) -> dict[str, Any]:
        """Plain values from which `from_mapping` makes an equal session; every digit is kept."""
        plain = ("command_interface", "period", "substeps", "voltage_limit", "command_timeout")
        initial = ("initial_position", "initial_velocity", "initial_current")
        # without a key for the default, earlier versions read the sessions that they can run
        controller = ("controller", "controller_settings") if self.controller != "pid" else ()
        return {
            "format": SESSION_FORMAT,
            "version": __version__,
            "kernel": BACKEND,
            **{name: getattr(self, name) for name in plain},
            **{name: list(getattr(self, name)) for name in initial},
            "servo": self.servo.to_mapping(),
            **{name: deepcopy(getattr(self, name)) for name in controller},
            "joint_names": list(self.joint_names),
            "frame_id": self.frame_id,
            "model": self.plant.to_mapping(),
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str | None = None) -> SessionConfig:
        """The inverse of `to_mapping`.

        Raises ModelError: another format, an unknown key or effect, a value that is not usable.
        """
        found = mapping.get("format") if isinstance(mapping, Mapping) else mapping
        if found != SESSION_FORMAT:
            expected = f"'{SESSION_FORMAT}', which version {__version__} reads"
            raise ModelError(f"session format {found!r}", where=where, expected=expected)
        values = {k: v for k, v in mapping.items() if k not in ("format", "version", "kernel")}
        plant = plant_of_mapping(values.pop("model", None), where)

        def make() -> SessionConfig:
            return cls(plant=plant, servo=ServoConfig.from_mapping(values.pop("servo", {})), **values)

        try:
            return made_of_model(make, where)
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
    position: Triple  #: as the sensors give it [rad]
    velocity: Triple  #: [rad/s]
    current: Triple  #: [A]
    voltage: Triple  #: asked of the supply, last in the step [V]
    effort: Triple  #: torque of the motor at the joint, kT i [N.m]


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
        self._kernel: Kernel = (self._constants, FREE)
        self._h = config.period / config.substeps
        self._period_ns, self._timeout, self._kT = config.period_ns, config.timeout_steps, plant.torque_per_ampere
        by_volts, limit = config.command_interface == "voltage", config.voltage_limit
        self._ranges = ((-limit, limit),) * 3 if by_volts else plant.arm.joint_ranges
        self._servo = native(config.servo.table(self._h, limit, plant.gear_ratios))
        width = WIDE_ROW if active & WIDE else ROW
        self._target_row = rows_of(np.zeros((1, 3)))
        delay = delay_of(active, table)
        self._late = SampledDelay(delay, config.period if by_volts else self._h, self._h) if delay else None
        self._held = HeldVoltage(self._kernel, config.substeps, self._h, self._late)
        self._servo_out = np.empty((config.substeps + 1, width))
        self._servo_volts = np.empty((config.substeps, 3))
        self._loop: ControlLoop | None = None
        if config.controller != "pid":
            made, ratios = config.make_controller(), plant.gear_ratios
            self._loop = ControlLoop(made, config.servo, self._h, 1, limit, ratios, self._kernel, self._late)
        self.reset()

    def reset(self) -> None:
        """Back to the initial state: motors, servo, watchdog, counters and step count too."""
        c = self.config
        x = (*c.initial_position, *c.initial_velocity, *c.initial_current)
        z = (*_NOTHING, *links_at(x, 0.0, *self._kernel), *AT_REST[9:])
        sensed = self._constants.active & SENSED
        m = settled_positions(c.initial_position, self._constants.table) if sensed else c.initial_position
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

        Raises CommandError: not three finite numbers; the last good command stays.
        """
        return self._take(None, (0, 1, 2), values)

    def command_joints(self, names: Sequence[str], values: Sequence[float]) -> Command:
        """Take a command [rad] for some joints by name; the others keep theirs.

        Raises CommandError: unknown or repeated joint, numbers that are missing or not finite, or a session that takes
        volts; the last good command stays.
        """
        known, names = self.config.joint_names, tuple(names)
        unknown = [name for name in names if name not in known]
        problem = None
        if self.config.command_interface != "position":
            problem = "a command by joint name in a session that takes volts", "command_interface position"
        elif not names or unknown:
            problem = f"unknown joint '{unknown[0]}'" if unknown else "no joint names", f"some of {', '.join(known)}"
        elif len(set(names)) < len(names):
            problem = f"joint '{next(name for name in names if names.count(name) > 1)}' stands twice", "each joint once"
        if problem:
            self._refuse(*problem)
        return self._take(names, tuple(known.index(name) for name in names), values)

    def _refuse(self, what: str, expected: str) -> NoReturn:
        self.counters.rejected += 1
        raise CommandError(what, where="command", expected=expected)

    def _take(self, names: tuple[str, ...] | None, joints: Sequence[int], values: Sequence[float]) -> Command:
        values = tuple(values)
        try:
            numbers = tuple(map(float, values))
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) != len(joints) or not all(map(isfinite, numbers)):
            self._refuse(f"{list(values)!r}", f"{len(joints)} finite numbers")
        for j, value in zip(joints, numbers):
            low, high = self._ranges[j]
            self._target[j] = min(max(value, low), high)
            self.counters.saturated += self._target[j] != value
        self._fresh = True
        return Command(names, numbers)

    def step(self) -> SessionState:
        """One period; returns the new state.

        Raises NonFiniteStateError: names the step; the state stays the last finite one.
        """
        self._watch()
        step = self.state.step + 1
        voltage: Sequence[float] = _NOTHING
        try:
            if self.config.command_interface == "voltage":
                voltage = self._target
                row = self._held.run(self._whole, self.state.step * self.config.period, voltage)
            else:
                row, voltage = self._step_position()
        except PumaSimError:
            raise
        except (OverflowError, ValueError, ZeroDivisionError):
            row = None
        if row is None:
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

    def _seen(self) -> Sequence[float]:
        """Measured positions [rad]."""
        return self._whole.m if self._constants.active & SENSED else self._whole.x[:3]

    def _step_position(self) -> tuple[np.ndarray | None, Sequence[float]]:
        """The row at the end of a step under a controller, None where it is not finite, and the last voltages [V]."""
        time = self.state.step * self.config.period
        samples, out, volts = self.config.substeps, self._servo_out, self._servo_volts
        if self._loop is None:
            row = self._target_row[0]
            row[0], row[1], row[2] = self._target
            late = NO_DELAY if self._late is None else self._late.table
            loop = ServoLoop(time, samples, 1, self._h, self._servo, self._memory, late)
            bad = run_servo(self._whole, self._target_row, loop, *self._kernel, out, volts)
        else:
            bad = self._loop.run(self._whole, [self._target], samples, time, out, volts)
        return (None if bad >= 0 else out[-1]), volts[-1].tolist()

    def _state(self, step: int, voltage: Sequence[float]) -> SessionState:
        x, (v1, v2, v3) = self._whole.x, voltage
        return SessionState(
            step=step,
            time_ns=step * self._period_ns,
            position=tuple(self._seen()),
            velocity=x[3:6],
            current=x[6:9],
            voltage=tuple(supply_voltages(v1, v2, v3, self._constants.table)),
            effort=tuple(map(mul, self._kT, x[6:9])),
        )
