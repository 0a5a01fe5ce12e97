# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Controllers that a battery appraises: the baselines by name, a class of the user's as ``module:Class``, and processes
over topics, which `ros2 run puma_sim_ros appraise` meets."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

from puma_sim_core.appraisal.settings import ROWS, SETPOINT_PERIOD, VOLTAGE_LIMIT
from puma_sim_core.checks import check_choice, is_number
from puma_sim_core.control.computed_torque import ComputedTorque, Settings
from puma_sim_core.control.controllers import load_settings, make_controller
from puma_sim_core.control.velocity_loop import VelocityLoop, VelocityLoopSettings
from puma_sim_core.errors import ParameterError, one_of
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.pid import Pid, PidGains
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.feedback import Controller, samples_per_period
from puma_sim_core.tuning.ziegler_nichols import Loop, Ultimate, settings, ultimate_by_eigenvalues

#: servo period [s]
PERIOD = SETPOINT_PERIOD / ROWS
_UPRIGHT = -1.5707963267948966
#: pose [rad] of each joint's ultimate gain in the thesis, and the gain [V/rad] and period [s] that it prints
PRINTED = (
    ((0.0, 0.0, -_UPRIGHT), Ultimate(220.0, 0.6)),  # plot 7.18
    ((0.0, _UPRIGHT, -_UPRIGHT), Ultimate(475.0, 0.4)),  # plot 7.19
    ((0.0, _UPRIGHT, -_UPRIGHT), Ultimate(270.0, 0.18)),  # plot 7.21
)
#: of the velocity loop: 25 rad/s outside, an integral time of 50 ms inside, well damped on arms that differ by 10 %
VELOCITY_LOOP: dict[str, Any] = {
    "position_gain": (25.0, 25.0, 25.0),
    "velocity_gain": (25.0, 40.0, 15.0),
    "velocity_time": (0.05, 0.05, 0.05),
}
#: by how much the wrong model of computed torque is lighter than the arm
WRONG = 0.9


class DoNothing:
    """Zero volts: the control that every task must find out."""

    period = SETPOINT_PERIOD

    def reset(self) -> None:
        """Nothing to forget."""

    def update(self, t: float, setpoint: Any, measurement: Any) -> tuple[float, float, float]:
        """Zero volts."""
        return 0.0, 0.0, 0.0


@dataclass(frozen=True)
class Models:
    """What controllers may know of the arm: the nominal plant, and the augmented one of ``--model``."""

    nominal: Plant
    augmented: Plant | None = None


def _servo(gains: list[PidGains], on_measurement: bool) -> ServoConfig:
    first, second, third = gains
    return ServoConfig((first, second, third), derivative_on_measurement=on_measurement)


def _pid(models: Models) -> ServoConfig:
    found = load_settings("pid")
    gains = zip(found["gain"], found["integral_time"], found["derivative_time"])
    return _servo([PidGains(*values) for values in gains], found["derivative_on_measurement"])


def _thesis_pid(models: Models) -> ServoConfig:
    return _servo([settings(printed) for _, printed in PRINTED], False)


def _ziegler_nichols(models: Models) -> ServoConfig:
    loops = [Loop(models.nominal, joint, pose, PERIOD) for joint, (pose, _) in enumerate(PRINTED, 1)]
    return _servo([settings(ultimate_by_eigenvalues(loop)) for loop in loops], False)


def _bounds() -> dict[str, Any]:
    found = load_settings("computed_torque")
    return {name: found[name] for name in ("greatest_velocity", "greatest_acceleration")}


def _velocity_loop(models: Models) -> Controller:
    return VelocityLoop(VelocityLoopSettings(**VELOCITY_LOOP, **_bounds()), PERIOD, limit=VOLTAGE_LIMIT)


def _torque(plant: Plant) -> Controller:
    return ComputedTorque(plant, Settings.from_mapping(load_settings("computed_torque")), PERIOD, limit=VOLTAGE_LIMIT)


def wrong_model(plant: Plant) -> Plant:
    """The plant with masses, and inertias of the motors, ten per cent too small."""
    arm = plant.arm
    links: Any = tuple(replace(link, mass=WRONG * link.mass) for link in arm.links)
    motors: Any = tuple(replace(motor, inertia=WRONG * motor.inertia) for motor in arm.motors)
    return replace(plant, arm=replace(arm, links=links, motors=motors))


def _augmented(models: Models) -> Controller:
    if models.augmented is None:
        expected = "--model FILE with it: the model that it knows"
        raise ParameterError("no augmented model", where="computed_torque_augmented", expected=expected)
    # the load is part of what the arm weighs
    return _torque(replace(models.augmented, arm=models.augmented.loaded_arm, effects=()))


@dataclass(frozen=True)
class Baseline:
    """A controller of the library: what it is, and how it is made, as a servo that is compiled or as an object."""

    name: str
    sentence: str
    make: Callable[[Models], Controller | ServoConfig]


BASELINES: Mapping[str, Baseline] = {
    one.name: one
    for one in (
        Baseline("pid", "PID with the gains of sim_node (config/controllers.yaml)", _pid),
        Baseline("thesis_pid", "PID by table 7.2 from the ultimate gains that the thesis prints", _thesis_pid),
        Baseline("ziegler_nichols", "PID by table 7.2 from the corrected model's ultimate gains", _ziegler_nichols),
        Baseline("scheduled", "PID whose gains follow the pose", lambda m: make_controller("scheduled", m.nominal)),
        Baseline("velocity_loop", "velocity loops inside position loops, without a model", _velocity_loop),
        Baseline("computed_torque", "computed torque that knows the nominal arm", lambda m: _torque(m.nominal)),
        Baseline(
            "computed_torque_wrong",
            "computed torque whose masses and motor inertias are 10 % too small",
            lambda m: _torque(wrong_model(m.nominal)),
        ),
        Baseline("computed_torque_augmented", "computed torque that knows the arm of --model", _augmented),
        Baseline("do_nothing", "zero volts: the control that no task may let pass", lambda m: DoNothing()),
    )
}


class Process(NamedTuple):
    """A controller in a process of its own, over topics.

    name : in reports; command : that starts it; interface : voltage, or position for setpoints of the digital servo;
    period : between its commands [s].
    """

    name: str
    command: str
    interface: str = "voltage"
    period: float = SETPOINT_PERIOD

    def check(self) -> None:
        """Raise ParameterError: a name that means something else, an unknown interface, a period that does not fit."""
        where = f"process {self.name}"
        if self.name in BASELINES or not self.name.isidentifier():
            expected = "letters, digits and _, other than a baseline's name"
            raise ParameterError(f"the name '{self.name}'", where=where, expected=expected)
        check_choice(self.interface, "interface", ("voltage", "position"), where)
        if not is_number(self.period) or not self.period > 0.0:
            raise ParameterError(f"its period is {self.period!r}", where=where, expected="a positive number of seconds")
        if self.interface == "position" and self.period != SETPOINT_PERIOD:
            what, expected = f"its period is {self.period!r} s", f"{SETPOINT_PERIOD} s, that of the servo's setpoints"
            raise ParameterError(what, where=where, expected=expected)
        samples_per_period(cast(Controller, self), SETPOINT_PERIOD)


@dataclass(frozen=True)
class Made:
    """A controller, ready: the object, its period [s], and the servo where the kernel has it compiled."""

    controller: Controller
    period: float
    servo: ServoConfig | None = None


def is_foreign(name: str) -> bool:
    """Whether it is a class of the user's."""
    return name not in BASELINES


def check_name(name: str) -> None:
    """Raise ParameterError for a name that is neither a baseline nor ``module:Class``."""
    module, colon, cls = name.partition(":")
    if name not in BASELINES and not (colon and cls.isidentifier() and all(map(str.isidentifier, module.split(".")))):
        expected = f"module:Class, or {one_of(name, BASELINES, '`puma-sim appraise list`')}"
        raise ParameterError(f"unknown controller '{name}'", expected=expected)


def make(name: str, models: Models) -> Made:
    """The controller of a name.

    Raises ParameterError: an unknown name, a class that cannot be imported or made, or that lacks the interface.
    """
    check_name(name)
    if name in BASELINES:
        made = BASELINES[name].make(models)
        if not isinstance(made, ServoConfig):
            return Made(made, made.period)
        on_measurement = made.derivative_on_measurement
        return Made(Pid(made.gains, PERIOD, limit=VOLTAGE_LIMIT, on_measurement=on_measurement), PERIOD, made)
    controller = _of_user(name)
    return Made(controller, controller.period)


def _of_user(name: str) -> Controller:
    module, _, cls = name.partition(":")
    here = os.getcwd()
    if here not in sys.path:
        sys.path.insert(0, here)
    where = f"controller {name}"
    try:
        found = getattr(importlib.import_module(module), cls)()
    except Exception as error:
        expected = "a module on the path, or in this folder, and a class that is made without arguments"
        raise ParameterError(f"{type(error).__name__}: {error}", where=where, expected=expected) from error
    for method in ("reset", "update"):
        if not callable(getattr(found, method, None)):
            expected = "period, reset() and update(t, setpoint, measurement)"
            raise ParameterError(f"it has no {method}()", where=where, expected=expected)
    period: Any = getattr(found, "period", None)
    if not is_number(period) or not period > 0.0:
        raise ParameterError(f"its period is {period!r}", where=where, expected="a positive number of seconds")
    samples_per_period(found, SETPOINT_PERIOD, where)
    return found
