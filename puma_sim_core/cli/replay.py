# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Give a bag's commands to the model again, and compare the states bit by bit.

The exit status is 0 where all agree and 1 at the first step that differs. With --publish the
bag's messages go back to their ROS 2 topics instead, at their times.
"""

from __future__ import annotations

import argparse

from puma_sim_core.cli.arguments import number
from puma_sim_core.cli.output import announce_compilation
from puma_sim_core.errors import PumaSimError

NAME = "replay"
SUMMARY = "run a bag's commands again and compare, or publish it"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("bag", metavar="BAG", help="the bag's directory or its .mcap file")
    parser.add_argument("--publish", action="store_true", help="publish the messages on their topics (needs ROS 2)")
    parser.add_argument("--rate", metavar="X", help="with --publish: simulated seconds a second (default 1.0)")


def run(options: argparse.Namespace) -> int:
    """Replay or publish; raises BagError."""
    if options.publish:
        rate = 1.0 if options.rate is None else number(options.rate, "--rate")
        print(f"{_publisher()(options.bag, rate=rate)} messages published")
        return 0
    if options.rate is not None:
        raise PumaSimError(
            f"--rate {options.rate} without --publish", expected="both, or neither: a comparison keeps no pace"
        )
    from puma_sim_core.jit import BACKEND
    from puma_sim_core.simulation.replay import replay

    announce_compilation()
    found = replay(options.bag)
    print(f"{options.bag}: recorded by version {found.recorded_version} ({found.recorded_kernel} kernel)")
    print(f"{found.steps} steps and {found.commands} commands given again ({BACKEND} kernel)")
    if found.identical:
        print("replay identical: every position, velocity, current, voltage and effort, to the last bit")
        return 0
    print(f"replay differs first at {found.first_difference}")
    print(f"greatest difference in position {found.greatest_difference:.3g} rad")
    return 1


def _publisher():
    """`puma_sim_ros.bag_publisher.publish_bag`, or an error that says what is missing."""
    try:
        from puma_sim_ros.bag_publisher import publish_bag
    except ImportError as error:
        raise PumaSimError(
            f"{error.name or error} cannot be imported ({error})",
            where="replay --publish",
            expected="ROS 2: source its setup file, or install the extra 'ros'",
        ) from None
    return publish_bag
