# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The commands `model`, `replay` and `recover`: model files and bags."""

import argparse
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from puma_sim_core.cli.arguments import Command, add_plant_arguments, input_files, number, plant_of
from puma_sim_core.cli.output import add_force_argument, check_output, output_file, start_at_once
from puma_sim_core.errors import ModelError, PumaSimError

_REPLAY = """Give a bag's commands to the model again, and compare the states bit by bit.

The exit status is 0 where all agree and 1 at the first step that differs. With --publish the
bag's messages go back to their ROS 2 topics instead, at their times.
"""
_RECOVER = """Read what a killed recorder left of a bag, and write it as a closed bag beside it.

All whole periods are kept, with the commands that a written state shows. It says where reading stopped and how many
bytes were not used, and goes on behind a damaged chunk or a missing file: the steps in it are missing then. The
original is not touched.
"""


def add_model_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `model`."""
    add_plant_arguments(parser)
    parser.add_argument("--out", metavar="FILE", default="-", help="the file to write (default -, standard output)")
    add_force_argument(parser)


def write_model(options: argparse.Namespace) -> int:
    """Write a model file; raises ParameterError or ModelError."""
    from puma_sim_core.files import yaml_text

    check_output(options.out, input_files(options), force=options.force)
    text = yaml_text(plant_of(options).to_mapping())
    with output_file(options.out, ModelError) as file:
        file.write(text)
    return 0


def add_replay_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `replay`."""
    parser.add_argument("bag", metavar="BAG", help="the bag's directory, or its first .mcap file alone")
    parser.add_argument("--publish", action="store_true", help="publish the messages on their topics (needs ROS 2)")
    parser.add_argument("--json", action="store_true", help="print what was found as JSON")
    parser.add_argument("--rate", metavar="X", help="with --publish: simulated seconds a second (default 1.0)")


def replay_bag(options: argparse.Namespace) -> int:
    """Replay or publish; raises BagError."""
    if options.publish:
        rate = 1.0 if options.rate is None else number(options.rate, "--rate")
        print(f"{_publisher()(options.bag, rate=rate)} messages published")
        return 0
    if options.rate is not None:
        expected = "both, or neither: a comparison keeps no pace"
        raise PumaSimError(f"--rate {options.rate} without --publish", expected=expected)
    from puma_sim_core.jit import kernel_in_use
    from puma_sim_core.json_text import json_text
    from puma_sim_core.recording.bag.files import BagFiles
    from puma_sim_core.simulation.replay import replay

    BagFiles(Path(options.bag))  # one that cannot be read ends here, before anything is compiled
    start_at_once()
    found = replay(options.bag)
    if options.json:
        print(json_text({"identical": found.identical, **asdict(found)}), end="")
        return int(not found.identical)
    print(f"{options.bag}: recorded by version {found.recorded_version} ({found.recorded_kernel} kernel)")
    print(f"{found.steps} steps and {found.commands} commands given again ({kernel_in_use()} kernel)")
    if found.missing:
        first, after = found.missing
        print(f"steps {first} to {after} are missing in the bag: what stands behind them is not compared")
    if found.identical:
        print("replay identical: every position, velocity, current, voltage and effort, to the last bit")
        return 0
    print(f"replay differs first at {found.first_difference}")
    print(f"greatest difference in position {found.greatest_difference:.3g} rad")
    return 1


def _publisher() -> Callable[..., int]:
    """`puma_sim_ros.bag_publisher.publish_bag`, or an error that says what is missing."""
    try:
        from puma_sim_ros.bag_publisher import publish_bag
    except ImportError as error:
        what, expected = f"{error.name or error} cannot be imported ({error})", "install the extra 'ros'"
        expected = f"ROS 2: source its setup file, or {expected}"
        raise PumaSimError(what, where="replay --publish", expected=expected) from None
    return publish_bag


def add_recover_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `recover`."""
    parser.add_argument("bag", metavar="BAG", help="the bag's directory, or its first .mcap file alone")
    parser.add_argument("--out", metavar="DIR", help="the bag to make (default: BAG with _recovered behind its name)")
    add_force_argument(parser)


def recover_bag(options: argparse.Namespace) -> int:
    """Recover and say what was there; raises BagError."""
    from puma_sim_core.recording.bag import recover

    found = recover(options.bag, options.out, force=options.force)
    whole = ", all of it: the original was closed" if found.was_complete else ""
    print(f"{found.path}: {found.steps} steps, {found.last_time_ns * 1e-9:.3f} s{whole}")
    for path, offset, size, what in found.damage:
        print(f"{path}, offset {offset}: {what}; {size} bytes not used")
    for first, last in found.missing:
        print(f"steps {first} to {last} are missing")
    return 0


MODEL = Command(
    "model",
    "write parameters and effects as one model file",
    "Write a model file: the parameters of an arm and effects in one, for --model.",
    add_model_arguments,
    write_model,
)
REPLAY = Command(
    "replay", "run a bag's commands again and compare, or publish it", _REPLAY, add_replay_arguments, replay_bag
)
RECOVER = Command(
    "recover", "close the bag of a recorder that was killed", _RECOVER, add_recover_arguments, recover_bag
)
