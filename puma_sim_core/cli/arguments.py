# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Options that subcommands share, and how their texts become numbers and plants."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from math import inf, isfinite, nan, pi
from typing import TYPE_CHECKING, NamedTuple

from puma_sim_core.errors import ParameterError, one_of

if TYPE_CHECKING:
    from puma_sim_core.executors import Shard
    from puma_sim_core.plant.plant import Plant

#: channels that --columns may name
_GROUPS = ("voltage", "position", "velocity", "current", "setpoint", "link_position")
_COLUMN = re.compile(rf"time|enable|({'|'.join(_GROUPS)})[1-9][0-9]*")


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


_COUNTS = {2: "two", 3: "three"}
#: units of angles and lengths that may stand behind a number, each with its size in the unit of the program
_UNITS = {"rad": {"rad": 1.0, "deg": pi / 180.0}, "deg": {"deg": 1.0, "rad": 180.0 / pi}, "m": {"m": 1.0, "mm": 1e-3}}
_QUANTITY = re.compile(r"(?P<number>[-+.\d][-+.\deE]*?)\s*(?P<unit>[a-zA-Z][a-zA-Z/^2]*)?")


def quantity(text: str, unit: str) -> float | None:
    """A finite number in a unit, such as rad, m or rad/s, from a text that may name its own: 90deg; None for another
    text."""
    found = _QUANTITY.fullmatch(text.strip())
    base, slash, behind = unit.partition("/")
    factors = {f"{name}{slash}{behind}": size for name, size in _UNITS.get(base, {unit: 1.0}).items()}
    try:
        value = float(found["number"]) * factors[found["unit"] or unit] if found else nan
    except (ValueError, KeyError):
        return None
    return value if isfinite(value) else None


def joint_numbers(text: str, option: str, unit: str, joints: int) -> tuple[float, ...]:
    """A finite number for each of three joints, or for a single one, as `quantity` reads it; raises ParameterError."""
    parts = text.split(",")
    values = tuple(value for part in parts if (value := quantity(part, unit)) is not None)
    if len(parts) != joints or len(values) != joints:
        many = f"{_COUNTS.get(joints, joints)} finite numbers with commas between them"
        wanted = "one finite number" if joints == 1 else many
        other = {"rad": ", or 90deg", "deg": ", or 1.57rad", "m": ", or 20mm"}.get(unit, "")
        raise ParameterError(f"'{text}'", where=option, expected=f"{wanted} [{unit}]{other}")
    return values


def joint_angles(text: str, option: str, unit: str, joints: int) -> tuple[float, ...]:
    """As `joint_numbers`, of positions: a number of radians beyond a turn must name its unit; raises ParameterError."""
    values = joint_numbers(text, option, unit, joints)
    for part, value in zip(text.split(","), values):
        if unit == "rad" and abs(value) > 2.0 * pi and not part.strip().endswith(("rad", "deg")):
            what = f"'{text}': {part.strip()} rad is {abs(value) / (2.0 * pi):.0f} turns; degrees?"
            raise ParameterError(what, where=option, expected=f"radians, or {part.strip()}deg")
    return values


def add_columns_argument(parser: argparse.ArgumentParser) -> None:
    """Declare --columns, which `column_names` reads."""
    parser.add_argument(
        "--columns",
        metavar="OURS=THEIRS,...",
        action="append",
        default=[],
        help="names of a CSV's columns, such as time=t_s,voltage1=motor_V,position1=q_rad; may stand more than once",
    )


def column_names(texts: list[str]) -> dict[str, str] | None:
    """Our names to the file's; None without any; raises ParameterError."""
    found: dict[str, str] = {}
    for item in (part for text in texts for part in text.split(",")):
        ours, equals, theirs = (part.strip() for part in item.partition("="))
        if not (ours and equals and theirs):
            raise ParameterError(f"'{item}'", where="--columns", expected="OURS=THEIRS, such as time=t_s")
        if not _COLUMN.fullmatch(ours):
            known = ["time", "enable", *(f"{group}{joint}" for joint in (1, 2, 3) for group in _GROUPS)]
            expected = one_of(ours, known, f"the columns {', '.join(known[: 2 + len(_GROUPS)])}, voltage2 and so on")
            raise ParameterError(f"unknown column '{ours}'", where="--columns", expected=expected)
        if ours in found:
            raise ParameterError(f"'{ours}' is given twice", where="--columns", expected="each once")
        if theirs in found.values():
            what = f"'{theirs}' is given for two columns"
            raise ParameterError(what, where="--columns", expected="a column of the file for one of ours")
        found[ours] = theirs
    return found or None


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


class Workers(NamedTuple):
    """Where the jobs of a command run, and which of them: jobs, processes at a time (None: one for each core), or a
    Dask scheduler."""

    jobs: int | None
    scheduler: str | None
    shard: Shard


def add_worker_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare --jobs, --scheduler and --shard."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", metavar="N", help="processes at a time (default: as many as there are cores)")
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="Dask scheduler, such as tcp://host:8786, whose workers do the jobs (needs the extra `cluster`)",
    )
    parser.add_argument("--shard", metavar="I/N", help="do part I of N alone, for batch queues")


def workers_of(options: argparse.Namespace) -> Workers:
    """What `add_worker_arguments` declared; raises ParameterError."""
    from puma_sim_core.executors import Shard

    jobs = None if options.jobs is None else whole_number(options.jobs, "--jobs", 1)
    return Workers(jobs, options.scheduler, Shard() if options.shard is None else Shard.parse(options.shard))


def add_plant_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that `plant_of` reads."""
    parser.add_argument(
        "--plant", metavar="NAME|FILE", help="machine, as explain takes it (`puma-sim list mechanisms`; the arm)"
    )
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
    if options.plant is not None:
        return _machine_of(options).with_effects(effects)
    if options.model is None:
        return Plant.of(options.parameters or "bejczy", effects, options.torque_form or "physical")
    base = load_model(options.model).with_effects(effects)
    if options.torque_form is None:
        return base
    if base.joints != 3:
        what = f"--torque-form with a model of {base.joints} joint"
        raise ParameterError(what, expected="a model of an arm: it is about its gears")
    return Plant(base.arm, base.effects, options.torque_form)


def _machine_of(options: argparse.Namespace) -> Plant:
    """The plant of --plant."""
    from puma_sim_core.plant.mechanism_file import load_mechanism

    for name in ("model", "torque_form"):
        if getattr(options, name) is not None:
            what = f"--{name.replace('_', '-')} with --plant"
            raise ParameterError(what, expected="one of the two: a model file has its machine in it")
    return load_mechanism(options.plant, parameters=options.parameters).plant()


def input_files(options: argparse.Namespace) -> list[str]:
    """Files that `plant_of` may read, which no output may take the place of."""
    return [path for path in (options.plant, options.parameters, options.model) if path is not None]
