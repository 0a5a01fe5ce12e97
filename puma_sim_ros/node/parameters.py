# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The parameters of `sim_node` (parameters.yaml): declared with their ranges, turned into a session's configuration.

ROS checks types and the ranges of single numbers. Everything else (arrays, the plant, the length
of an integration step) is checked where it is defined, by building the configuration from it.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.urdf import LINKS
from puma_sim_core.control.controllers import load_settings
from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import ParameterError, PumaSimError
from puma_sim_core.files import read_yaml
from puma_sim_core.plant.model_file import load_model
from puma_sim_core.plant.plant import Plant
from puma_sim_core.plant.stops import with_stops
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.servo.servo import DEFAULT_GAINS, ServoConfig
from puma_sim_core.simulation.session_config import SessionConfig

_GAINS = ("gain", "integral_time", "derivative_time")
_AT_JOINTS = {f"servo.{name}": {"default": [getattr(gains, name) for gains in DEFAULT_GAINS]} for name in _GAINS}
#: name -> default, description and, where it has them, span, constraints, change
PARAMETERS: dict[str, dict[str, Any]] = {
    name: {**entry, **_AT_JOINTS.get(name, {})}
    for name, entry in read_yaml(Path(__file__).with_name("parameters.yaml")).items()
}
#: how a parameter of a type is written
FORMS: dict[Any, str] = {
    float: "a number with a decimal point, such as 1.0",
    int: "an integer",
    bool: "true or false",
    str: "a text",
    (list, float): "a list of numbers with a decimal point, such as [0.0, 0.0, 0.0]",
    (list, str): "a list of texts, such as [a, b]",
}


def declare(node: Node) -> tuple[dict[str, Any], list[str]]:
    """Declare all parameters at a node that has declared what it was given by itself.

    Returns their values by name, and names that were given and that the node has no parameter for, as after a slip of
    the pen.

    Raises
    ------
    ParameterError : a value given to the node has the wrong type or is out of its range.
    """
    if simulated := node.get_parameter("use_sim_time").value:
        expected = "false: the simulator is the source of simulated time"
        raise ParameterError(repr(simulated), where="parameter 'use_sim_time'", expected=expected)
    # each is declared anew, with its type and range
    given = {name: each.value for name, each in node.get_parameters_by_prefix("").items() if not of_ros(name)}
    for name in given:
        node.undeclare_parameter(name)
    lockstep = given.get("mode") == "lockstep"
    for name, entry in PARAMETERS.items():
        default = entry.get("default_in_lockstep", entry["default"]) if lockstep else entry["default"]
        try:
            node.declare_parameter(name, default, _descriptor(entry))
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            wrong_type = isinstance(error, InvalidParameterTypeException)
            expected = _form(entry["default"]) if wrong_type else "{:g} to {:g}".format(*entry["span"])
            what = repr(given[name]) if name in given else "the value given"
            raise ParameterError(what, where=f"parameter '{name}'", expected=expected) from error
    return values_of(map(node.get_parameter_or, PARAMETERS)), sorted(given.keys() - PARAMETERS.keys())


def of_ros(name: str) -> bool:
    """Whether a parameter is one of rclpy's own."""
    return name in ("use_sim_time", "start_type_description_service") or name.startswith("qos_overrides.")


def _form(default: Any) -> str:
    return FORMS[(list, type(default[0])) if isinstance(default, list) else type(default)]


def _descriptor(entry: Mapping[str, Any]) -> ParameterDescriptor:
    later = " A change holds from the next ~/reset on." if entry.get("change") == "at reset" else ""
    descriptor = ParameterDescriptor(
        description=entry["description"] + later,
        additional_constraints=entry.get("constraints", ""),
        read_only="change" not in entry,
    )
    if "span" in entry:
        low, high = entry["span"]
        if isinstance(entry["default"], int):
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    return descriptor


def values_of(parameters) -> dict[str, Any]:
    """Values of those of `parameters` that are declared here, by name."""
    values = {parameter.name: parameter.value for parameter in parameters if parameter.name in PARAMETERS}
    for name, value in values.items():
        if isinstance(PARAMETERS[name]["default"], list):
            # an empty list arrives as a parameter without value; ROS has no empty list of texts
            values[name] = [item for item in value or () if item != ""]
    return values


def build_plant(values: Mapping[str, Any]) -> Plant:
    """The plant that the parameters describe; raises ParameterError, which names the parameter."""
    if values["model"]:
        if values["parameter_set"] != PARAMETERS["parameter_set"]["default"]:
            what, expected = f"given beside 'model' ({values['model']})", "one of the two: a model file holds both"
            raise ParameterError(what, where="parameter 'parameter_set'", expected=expected)
        return with_effects(_named("model", load_model, values["model"]), values)
    arm = _named("parameter_set", load_parameters, values["parameter_set"])
    return with_effects(Plant(arm), values)


def with_effects(plant: Plant, values: Mapping[str, Any]) -> Plant:
    """The plant with the effects, and the stops, that the parameters tell; raises ParameterError."""
    if values["model"] and values["effects"]:
        what, expected = f"given beside 'model' ({values['model']})", "one of the two: a model file holds both"
        raise ParameterError(what, where="parameter 'effects'", expected=expected)
    if not values["model"]:
        effects = tuple(_named("effects", parse_effect, text) for text in values["effects"])
        plant = _named("effects", replace, plant, effects=effects)
    plant = with_stops(plant) if values["stops"] and plant.joints == 3 else plant
    _named("effects", lambda: plant.constants)
    return plant


def _named(name: str, build, *arguments, **named):
    """The result of `build`; its errors name the parameter."""
    try:
        return build(*arguments, **named)
    except (PumaSimError, OSError) as error:
        raise ParameterError(str(error), where=f"parameter '{name}'") from error


def build_config(values: Mapping[str, Any], plant: Plant) -> SessionConfig:
    """The session that the parameters describe; raises ParameterError."""
    if values["mode"] not in ("realtime", "lockstep"):
        raise ParameterError(repr(values["mode"]), where="parameter 'mode'", expected="realtime or lockstep")
    if values["frame_id"] in ("", *LINKS):
        expected = f"a name, other than the arm's own {', '.join(LINKS)}"
        raise ParameterError(repr(values["frame_id"]), where="parameter 'frame_id'", expected=expected)
    same = ("command_interface", "period", "substeps", "voltage_limit", "command_timeout", "frame_id", "controller")
    config = SessionConfig(
        plant=plant,
        initial_position=tuple(values["initial_position"]),
        joint_names=tuple(values["joints"]),
        servo=_servo(values),
        controller_settings=_controller_settings(values),
        brakes=values["brakes"],
        **{name: values[name] for name in same},
    )
    for j, (angle, (low, high)) in enumerate(zip(config.initial_position, plant.arm.joint_ranges), start=1):
        if not low <= angle <= high:
            where, expected = f"parameter 'initial_position', joint {j}", f"{low:.4f} to {high:.4f}"
            raise ParameterError(f"{angle!r} rad", where=where, expected=expected)
    return config


def _servo(values: Mapping[str, Any]) -> ServoConfig:
    columns = [list(values[f"servo.{name}"]) for name in _GAINS]
    for name, column in zip(_GAINS, columns):
        if len(column) != 3:
            expected = "three numbers, one for each joint"
            raise ParameterError(repr(column), where=f"parameter 'servo.{name}'", expected=expected)
    # ROS has no way to write infinity on a command line
    rows = [(gain, integral or inf, derivative) for gain, integral, derivative in zip(*columns)]
    return ServoConfig(
        gains=tuple(_named(f"servo' of joint '{joint}", PidGains, *row) for joint, row in enumerate(rows, start=1)),
        amplifier_gain=values["servo.amplifier_gain"],
        converter_bits=values["servo.converter_bits"] or None,
        encoder_counts=values["servo.encoder_counts"] or None,
        derivative_on_measurement=values["servo.derivative_on_measurement"],
    )


def _controller_settings(values: Mapping[str, Any]) -> dict | None:
    kind, path = values["controller"], values["controllers_file"]
    if kind == "pid":
        if path:
            expected = "controller scheduled or computed_torque; the gains of pid are servo.gain and so on"
            what = f"given with controller pid ({path})"
            raise ParameterError(what, where="parameter 'controllers_file'", expected=expected)
        return None
    return _named("controllers_file" if path else "controller", load_settings, kind, "servo", path or None)


def check_change(changes, values: Mapping[str, Any], plant: Plant) -> SetParametersResult:
    """Whether parameters of a running node may change so; `values` are those now in force."""
    if any(change.name == "use_sim_time" and change.value for change in changes):
        reason = "use_sim_time: the simulator is the source of simulated time"
        return SetParametersResult(successful=False, reason=reason)
    changed = values_of(changes)
    wanted = {**values, **changed}
    try:
        if "effects" in changed:
            plant = with_effects(plant, wanted)
        if any(PARAMETERS[name].get("change") == "at reset" for name in changed):
            build_config(wanted, plant)
    except PumaSimError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)
