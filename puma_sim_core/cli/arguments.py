# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Options that subcommands share, and how their texts become numbers and plants."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from math import inf, isfinite
from typing import TYPE_CHECKING, NamedTuple

from puma_sim_core.errors import ParameterError

if TYPE_CHECKING:
    from puma_sim_core.plant.plant import Plant


class Command(NamedTuple):
    """A subcommand: its name, a summary, the text of its help, and what declares its options and runs it."""

    name: str
    summary: str
    description: str | None
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


def number(text: str, option: str) -> float:
    """The finite number that an option was given; raises ParameterError."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise ParameterError(f"'{text}'", where=option, expected="a finite number")
    return value


def positive_number(text: str, option: str) -> float:
    """The number above 0 that an option was given; raises ParameterError."""
    value = number(text, option)
    if value <= 0.0:
        raise ParameterError(f"'{text}'", where=option, expected="a number above 0")
    return value


def whole_number(text: str, option: str, least: float = -inf) -> int:
    """The whole number, `least` or more, that an option was given; raises ParameterError."""
    try:
        if (value := int(text)) >= least:
            return value
    except ValueError:
        pass
    expected = "a whole number" if least == -inf else f"a whole number, {least} or more"
    raise ParameterError(f"'{text}'", where=option, expected=expected)


def joint_numbers(text: str, option: str, unit: str, joints: int) -> tuple[float, ...]:
    """A finite number for each of three joints, or for a single one; raises ParameterError."""
    try:
        values = tuple(map(float, text.split(",")))
    except ValueError:
        values = ()
    if len(values) != joints or not all(map(isfinite, values)):
        wanted = "one finite number" if joints == 1 else "three finite numbers with commas between them"
        raise ParameterError(f"'{text}'", where=option, expected=f"{wanted} [{unit}]")
    return values


def add_source_arguments(parser: argparse.ArgumentParser, parameters: str, model: str) -> None:
    """Declare --parameters and --model, one of which may be given, with these texts."""
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--parameters", metavar="SET|FILE", help=parameters)
    source.add_argument("--model", metavar="FILE", help=model)


def add_mechanism_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare --plant, --parameters, --model and --seed."""
    parser.add_argument(
        "--plant",
        metavar="NAME|FILE",
        default="puma560",
        help="mechanism: puma560 (default), pendulum, slide, or a YAML file",
    )
    add_source_arguments(
        parser,
        "published set or parameter file to start from (`puma-sim list`)",
        "model file to start from: parameters and effects in one",
    )
    parser.add_argument(
        "--seed", metavar="N", default="0", help="whole number from which all that is random follows (default 0)"
    )


def add_plant_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that `plant_of` reads."""
    add_source_arguments(
        parser,
        "published set or parameter file of the arm (default bejczy; `puma-sim list` lists the sets)",
        "model file: parameters and effects in one",
    )
    parser.add_argument(
        "--effect",
        metavar="NAME:KEY=VALUE,...",
        action="append",
        default=[],
        help="add an effect, such as coulomb_friction:joint=2,torque=12; may "
        "stand more than once (`puma-sim list` lists them)",
    )
    parser.add_argument(
        "--torque-form",
        choices=("physical", "printed"),
        help="torque at the joint: N kt i (the default), or kt i as equation 5.2 prints it",
    )


def plant_of(options: argparse.Namespace) -> Plant:
    """The plant of the options; raises ParameterError or ModelError."""
    from puma_sim_core.effects import parse_effect
    from puma_sim_core.plant.model_file import load_model
    from puma_sim_core.plant.plant import Plant

    effects = tuple(parse_effect(text) for text in options.effect)
    if options.model is None:
        return Plant.of(options.parameters or "bejczy", effects, options.torque_form or "physical")
    base = load_model(options.model).with_effects(effects)
    if options.torque_form is None:
        return base
    if base.joints != 3:
        what = f"--torque-form with a model of {base.joints} joint"
        raise ParameterError(what, expected="a model of an arm: it is about its gears")
    return Plant(base.arm, base.effects, options.torque_form)


def input_files(options: argparse.Namespace) -> list[str]:
    """Files that `plant_of` may read, which no output may take the place of."""
    return [path for path in (options.parameters, options.model) if path is not None]
