# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Options that subcommands share, and how their texts become numbers and plants."""

from __future__ import annotations

import argparse
from math import isfinite
from typing import TYPE_CHECKING

from puma_sim_core.errors import ParameterError

if TYPE_CHECKING:
    from puma_sim_core.plant.plant import Plant


def number(text: str, option: str) -> float:
    """The finite number that an option was given; raises ParameterError."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise ParameterError(f"'{text}'", where=option, expected="a finite number")
    return value


def whole_number(text: str, option: str, least: int) -> int:
    """The whole number, `least` or more, that an option was given; raises ParameterError."""
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise ParameterError(f"'{text}'", where=option, expected=f"a whole number, {least} or more")
    return value


def three_numbers(text: str, option: str, unit: str) -> tuple[float, float, float]:
    """The three finite numbers that an option was given; raises ParameterError."""
    return joint_numbers(text, option, unit, 3)


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


def add_plant_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that `plant_of` reads."""
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--parameters",
        metavar="SET|FILE",
        help="published set or parameter file of the arm (default bejczy; `puma-sim list` lists the sets)",
    )
    source.add_argument("--model", metavar="FILE", help="model file: parameters and effects in one")
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
        raise ParameterError(
            f"--torque-form with a model of {base.joints} joint", expected="a model of an arm: it is about its gears"
        )
    return Plant(base.arm, base.effects, options.torque_form)


def input_files(options: argparse.Namespace) -> list[str]:
    """Files that `plant_of` may read, which no output may take the place of."""
    return [path for path in (options.parameters, options.model) if path is not None]
