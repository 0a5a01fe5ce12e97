# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A bag given back to the topics that it was recorded from, at its own pace or another."""

import argparse
import importlib.util
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.duration import Duration

from puma_sim_core.errors import BagError, PumaSimError
from puma_sim_core.recording.bag import iterate_messages, names_told
from puma_sim_core.recording.topics import (
    ARRAY_COMMANDS,
    FIXED_FRAMES,
    JOINT_COMMANDS,
    STATES,
    TF_MESSAGE,
    TOPICS,
    Topic,
)
from puma_sim_ros.messages import LOSSLESS, qos
from puma_sim_ros.startup import ros_started

#: topics on which a simulator listens
_COMMANDS = (*ARRAY_COMMANDS.values(), JOINT_COMMANDS)
_LATCHED = tuple(topic for topic in TOPICS if topic.latched)
#: longest wait for a simulator or, where it is said what goes out, for a first subscriber, whom the
#: middleware announces each 3 s; and the wait for the others, and for them to have found us [s]
_LONGEST, _OTHERS = 4.0, 1.0


def _message_type(name: str, topic: str):
    """The Python class of a message type such as ``std_msgs/msg/String``."""
    package, _, kind = name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError) as error:
        what, expected = f"type {name} is not installed", "a message type of this ROS installation"
        raise BagError(what, where=f"topic {topic}", expected=expected) from error


def publish_bag(path: str | Path, *, rate: float = 1.0, commands_only: bool | None = None) -> int:
    """Publish the messages of a closed bag at their times; returns how many.

    Parameters
    ----------
    rate : simulated seconds for each second of the wall clock.
    commands_only : leave out what a simulator publishes. By default that is done where a
        simulator is there, publishing ``joint_states``: two of them would mix on one topic.

    Raises BagError where not all can be read; nothing is published then.
    """
    if not 0.0 < rate < float("inf"):
        raise BagError(f"rate {rate}", where=path, expected="a finite number above 0")
    recorded = list(iterate_messages(path))
    names = names_told(recorded)

    def is_one_of(name: str, topics: Sequence[Topic]) -> bool:
        return any(name == names[t.name] if t.name in names else name.endswith(f"/{t.name}") for t in topics)

    commands = [message for message in recorded if is_one_of(message.topic, _COMMANDS)]
    if importlib.util.find_spec("tf2_msgs") is None:
        # where no program can take frames, the rest of the bag is still of use
        recorded = [message for message in recorded if message.type != TF_MESSAGE]
    if commands_only:
        recorded = commands
    # an interruption ends a wait here, not ROS under our feet
    with ros_started():
        node = rclpy.create_node("bag_publisher")
        publishers = {}
        for topic, kind in {message.topic: message.type for message in recorded}.items():
            profile = qos(LOSSLESS, latched=topic == FIXED_FRAMES.name or is_one_of(topic, _LATCHED))
            publishers[topic] = node.create_publisher(_message_type(kind, topic), topic, profile)

        def simulator_runs() -> bool:
            return any(node.count_publishers(topic) > 1 for topic in publishers if is_one_of(topic, [STATES]))

        def heard() -> bool:
            return any(publisher.get_subscription_count() for publisher in publishers.values())

        # a viewer is found sooner than a simulator may be, whom it must not be mixed with
        awaited = simulator_runs if commands_only is None else heard
        end = time.monotonic() + _LONGEST
        while time.monotonic() < end and not awaited():
            time.sleep(0.02)
        time.sleep(_OTHERS)
        if commands_only is None and simulator_runs():
            node.get_logger().info("a simulator is running: only the commands are published")
            recorded = commands
        start = time.monotonic()
        for message in recorded:
            time.sleep(max(0.0, start + message.time_ns * 1e-9 / rate - time.monotonic()))
            # bytes go out as they are: what is received is what was recorded
            publishers[message.topic].publish(message.data)
        for publisher in publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=1))
        node.destroy_node()
    return len(recorded)


def main(args: Sequence[str] | None = None) -> int:
    """Command line of the module; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--rate", type=float, default=1.0, help="simulated seconds for each second of the wall clock")
    help_text = "leave out what a simulator publishes"
    parser.add_argument("--commands-only", action="store_true", default=None, help=help_text)
    options = parser.parse_args(args)
    try:
        count = publish_bag(options.bag, rate=options.rate, commands_only=options.commands_only)
    except PumaSimError as error:
        print(f"bag_publisher: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    print(f"{count} messages published")
    return 0


if __name__ == "__main__":
    sys.exit(main())
