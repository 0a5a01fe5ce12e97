# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""All that decides how a session goes, commands apart, and its form in bags."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from puma_sim_core import __version__
from puma_sim_core.checks import check_choice, check_numbers, check_positive, check_whole
from puma_sim_core.control.controllers import load_settings, make_controller
from puma_sim_core.errors import ModelError, ParameterError
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.model_file import plant_of_mapping
from puma_sim_core.plant.plant import Plant, made_of_model
from puma_sim_core.servo.pid import Pid
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.feedback import Controller
from puma_sim_core.simulation.run_inputs import check_step

SESSION_FORMAT = "puma-sim session 1"
COMMAND_INTERFACES = ("voltage", "position")
Triple = tuple[float, ...]
_NOTHING = (0.0, 0.0, 0.0)


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
    brakes : the joints have brakes, which hold them until the first good command and again from a time-out on.

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
    brakes: bool = False

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
        if not isinstance(self.brakes, bool):
            raise ParameterError(f"brakes {self.brakes!r}", expected="true or false")
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
        brakes = {"brakes": True} if self.brakes else {}
        return {
            "format": SESSION_FORMAT,
            "version": __version__,
            "kernel": BACKEND,
            **{name: getattr(self, name) for name in plain},
            **{name: list(getattr(self, name)) for name in initial},
            "servo": self.servo.to_mapping(),
            **{name: deepcopy(getattr(self, name)) for name in controller},
            **brakes,
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
        values = {k: v for k, v in mapping.items() if k not in ("format", "version", "kernel", "topics")}
        plant = plant_of_mapping(values.pop("model", None), where)

        def make() -> SessionConfig:
            return cls(plant=plant, servo=ServoConfig.from_mapping(values.pop("servo", {})), **values)

        try:
            return made_of_model(make, where)
        except TypeError as error:
            raise ModelError(str(error), where=where, expected="the keys of a session") from None
