# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The parameters of `sim_node`: declared with their ranges, turned into a session's configuration.

ROS checks types and the ranges of single numbers. Everything else (arrays, the plant, the length
of an integration step) is checked where it is defined, by building the configuration from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.control.controllers import load_settings
from puma_sim_core.dynamics.pid import PidGains
from puma_sim_core.dynamics.servo import DEFAULT_GAINS, ServoConfig
from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import ParameterError, PumaSimError
from puma_sim_core.plant.model_file import load_model
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.session import SessionConfig


class Declared(NamedTuple):
    """A parameter with its default; `span` is the closed range of a single number."""

    name: str
    default: Any
    description: str
    span: tuple[float, float] | None = None
    read_only: bool = True
    constraints: str = ""


_AT_RESET = "A change holds from the next ~/reset on."

PARAMETERS = (
    Declared(
        "joints",
        ["joint1", "joint2", "joint3"],
        "Names of the three joints, in the order of all arrays.",
        constraints="three different names, not empty",
    ),
    Declared(
        "command_interface",
        "voltage",
        "What commands are: motor voltages [V], or setpoints [rad] of the built-in digital "
        "joint servo. Only its topics are subscribed.",
        constraints="voltage or position",
    ),
    Declared(
        "mode",
        "realtime",
        "realtime: steps follow the wall clock. lockstep: each command makes one step.",
        constraints="realtime or lockstep",
    ),
    Declared("period", 0.028, "Simulated time between two states [s].", (0.001, 1.0)),
    Declared(
        "substeps",
        30,
        "Integration steps, and servo samples, in each period; one of them may last 8 ms at most.",
        (1, 10000),
    ),
    Declared(
        "real_time_factor",
        1.0,
        "Simulated seconds for each second of the wall clock, in realtime mode.",
        (0.001, 1000.0),
        read_only=False,
    ),
    Declared(
        "voltage_limit",
        40.0,
        f"Greatest voltage of a motor [V]; commands beyond it are clipped and counted. {_AT_RESET}",
        (0.0, 1000.0),
        read_only=False,
    ),
    Declared(
        "command_timeout",
        0.5,
        "Simulated time after the last command at which voltages go "
        "to zero, or setpoints are held [s]; 0 disables. Counted in steps. "
        f"{_AT_RESET}",
        (0.0, 3600.0),
        read_only=False,
    ),
    Declared(
        "initial_position",
        [0.0, 0.0, 0.0],
        f"Joint angles at the start and after ~/reset [rad]. {_AT_RESET}",
        read_only=False,
        constraints="three numbers within the joint ranges",
    ),
    Declared("parameter_set", "bejczy", "Name of a parameter set of the arm, or path of a parameter file."),
    Declared("effects", [""], "Effects that the thesis's model lacks, each as 'coulomb_friction:joint=2,torque=12'."),
    Declared(
        "model", "", "Path of a model.yaml that holds parameters and effects; in place of parameter_set and effects."
    ),
    Declared("publish_clock", False, "Publish simulated time on /clock."),
    Declared("frame_id", "base_link", "Root link of the arm, named in joint_states and in robot_description."),
    Declared(
        "bag_path",
        "",
        "Path of the bag to record; no bag when empty. A reset starts another one beside it, with a number added.",
        constraints="its folder exists, itself does not",
    ),
    Declared("paused", False, "Simulated time stands still; ~/step makes single steps.", read_only=False),
    Declared(
        "controller",
        "pid",
        "What computes the volts of the position interface: the joint "
        f"servo's PID, PID with gains that follow the pose, or computed torque. {_AT_RESET}",
        read_only=False,
        constraints="pid, scheduled or computed_torque; the last two with command_interface position",
    ),
    Declared(
        "controllers_file",
        "",
        "YAML file with the settings of the controllers scheduled and "
        f"computed_torque; config/controllers.yaml when empty. {_AT_RESET}",
        read_only=False,
    ),
    Declared(
        "servo.gain",
        [g.gain for g in DEFAULT_GAINS],
        f"Kg of each joint's PID [V/rad], in volts before the amplifier. {_AT_RESET}",
        read_only=False,
        constraints="three numbers, 0 or more",
    ),
    Declared(
        "servo.integral_time",
        [g.integral_time for g in DEFAULT_GAINS],
        f"Ti of each joint's PID [s]; 0 for no integral action. {_AT_RESET}",
        read_only=False,
        constraints="three numbers, 0 or more",
    ),
    Declared(
        "servo.derivative_time",
        [g.derivative_time for g in DEFAULT_GAINS],
        f"Td of each joint's PID [s]. {_AT_RESET}",
        read_only=False,
        constraints="three numbers, 0 or more",
    ),
    Declared(
        "servo.derivative_on_measurement",
        True,
        "Take the derivative of the measured "
        "position, not of the error: a step of the setpoint then does not kick. "
        f"{_AT_RESET}",
        read_only=False,
    ),
    Declared(
        "servo.amplifier_gain",
        1.0,
        f"Motor volts per volt of the converter. {_AT_RESET}",
        (0.001, 1000.0),
        read_only=False,
    ),
    Declared(
        "servo.converter_bits",
        0,
        "Bits of the digital-to-analogue converter, whose range is "
        f"that of voltage_limit; 0 for an ideal one, 1 is none. {_AT_RESET}",
        (0, 32),
        read_only=False,
    ),
    Declared(
        "servo.encoder_counts",
        0,
        f"Encoder counts in a turn of the motor (the PUMA has 1000); 0 for an ideal encoder. {_AT_RESET}",
        (0, 100_000_000),
        read_only=False,
    ),
)
_DEFAULTS = {declared.name: declared.default for declared in PARAMETERS}


def declare(node: Node) -> dict[str, Any]:
    """Declare all parameters at a node, and return their values by name.

    Raises
    ------
    ParameterError : a value given to the node has the wrong type or is out of its range.
    """
    if node.get_parameter("use_sim_time").value:
        raise ParameterError(
            "true", where="parameter 'use_sim_time'", expected="false: the simulator is the source of simulated time"
        )
    for declared in PARAMETERS:
        try:
            node.declare_parameter(declared.name, declared.default, _descriptor(declared))
        except InvalidParameterTypeException as error:
            raise ParameterError(
                _given(node, declared.name), where=f"parameter '{declared.name}'", expected=_form(declared)
            ) from error
        except InvalidParameterValueException as error:
            raise ParameterError(
                _given(node, declared.name),
                where=f"parameter '{declared.name}'",
                expected="{:g} to {:g}".format(*declared.span),
            ) from error
    return values_of(node.get_parameter_or(name) for name in _DEFAULTS)


def _given(node: Node, name: str) -> str:
    # rclpy keeps what the command line and the files gave in no public place
    override = getattr(node, "_parameter_overrides", {}).get(name)
    return repr(override.value) if override is not None else "the value given"


def unknown_names(node: Node) -> list[str]:
    """Names given to the node that it has no parameter for, as after a slip of the pen."""
    given = getattr(node, "_parameter_overrides", {})
    return sorted(name for name in given if not node.has_parameter(name) and not name.startswith("qos_overrides."))


def _form(declared: Declared) -> str:
    kind = type(declared.default)
    if kind is list:
        inner = (
            "a list of numbers with a decimal point, such as [0.0, 0.0, 0.0]"
            if isinstance(declared.default[0], float)
            else "a list of texts, such as [a, b]"
        )
        return inner
    return {
        float: "a number with a decimal point, such as 1.0",
        int: "an integer",
        bool: "true or false",
        str: "a text",
    }[kind]


def _descriptor(declared: Declared) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=declared.description, additional_constraints=declared.constraints, read_only=declared.read_only
    )
    if declared.span is not None:
        low, high = declared.span
        if isinstance(declared.default, int):
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    return descriptor


def _value(parameter) -> Any:
    value = parameter.value
    if isinstance(_DEFAULTS.get(parameter.name), list):
        # an empty list arrives as a parameter without value; ROS has no empty list of texts
        return [item for item in value or () if item != ""]
    return value


def values_of(parameters) -> dict[str, Any]:
    """Values of those of `parameters` that are declared here, by name."""
    return {parameter.name: _value(parameter) for parameter in parameters if parameter.name in _DEFAULTS}


def build_plant(values: Mapping[str, Any]) -> Plant:
    """The plant that the parameters describe.

    Raises
    ------
    ParameterError, ModelError : names the parameter, and what of it cannot be used.
    """
    if values["model"]:
        for name in ("parameter_set", "effects"):
            if values[name] not in (_DEFAULTS[name], []):
                raise ParameterError(
                    f"given beside 'model' ({values['model']})",
                    where=f"parameter '{name}'",
                    expected="one of the two: a model file holds both",
                )
        return _named("model", load_model, values["model"])
    arm = _named("parameter_set", load_parameters, values["parameter_set"])
    effects = tuple(_named("effects", parse_effect, text) for text in values["effects"])
    return _named("effects", Plant, arm, effects)


def _named(name: str, build, *arguments):
    try:
        return build(*arguments)
    except (PumaSimError, OSError) as error:
        raise ParameterError(str(error), where=f"parameter '{name}'") from error


def build_config(values: Mapping[str, Any], plant: Plant) -> SessionConfig:
    """The session that the parameters describe.

    Raises
    ------
    ParameterError : a value, or values together, cannot be used.
    """
    if values["mode"] not in ("realtime", "lockstep"):
        raise ParameterError(repr(values["mode"]), where="parameter 'mode'", expected="realtime or lockstep")
    return SessionConfig(
        plant=plant,
        command_interface=values["command_interface"],
        period=values["period"],
        substeps=values["substeps"],
        voltage_limit=values["voltage_limit"],
        command_timeout=values["command_timeout"],
        initial_position=tuple(values["initial_position"]),
        joint_names=tuple(values["joints"]),
        frame_id=values["frame_id"],
        servo=_servo(values),
        controller=values["controller"],
        controller_settings=_controller_settings(values),
    )


def _servo(values: Mapping[str, Any]) -> ServoConfig:
    names = ("gain", "integral_time", "derivative_time")
    columns = {name: list(values[f"servo.{name}"]) for name in names}
    for name, column in columns.items():
        if len(column) != 3:
            raise ParameterError(
                repr(column), where=f"parameter 'servo.{name}'", expected="three numbers, one for each joint"
            )
    # ROS has no way to write infinity on a command line
    columns["integral_time"] = [t if t != 0.0 else inf for t in columns["integral_time"]]
    return ServoConfig(
        gains=tuple(
            _named(f"servo' of joint '{joint}", PidGains, *row)
            for joint, row in enumerate(zip(*columns.values()), start=1)
        ),
        amplifier_gain=values["servo.amplifier_gain"],
        converter_bits=values["servo.converter_bits"] or None,
        encoder_counts=values["servo.encoder_counts"] or None,
        derivative_on_measurement=values["servo.derivative_on_measurement"],
    )


def _controller_settings(values: Mapping[str, Any]) -> dict | None:
    path = values["controllers_file"]
    if values["controller"] == "pid":
        if path:
            raise ParameterError(
                f"given with controller pid ({path})",
                where="parameter 'controllers_file'",
                expected="controller scheduled or computed_torque; the gains of pid are servo.gain and so on",
            )
        return None
    return _named(
        "controllers_file" if path else "controller", load_settings, values["controller"], "servo", path or None
    )


def check_change(changes, values: Mapping[str, Any], plant: Plant) -> SetParametersResult:
    """Whether parameters of a running node may change so; `values` are those now in force."""
    if any(change.name == "use_sim_time" and change.value for change in changes):
        return SetParametersResult(
            successful=False, reason="use_sim_time: the simulator is the source of simulated time"
        )
    try:
        build_config({**values, **values_of(changes)}, plant)
    except PumaSimError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)
