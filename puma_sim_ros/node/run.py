# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`SimNode` from its start to its end by a signal."""

import signal
import sys
from typing import Any, NoReturn

from rclpy.exceptions import ParameterException

from puma_sim_core.errors import PumaSimError
from puma_sim_ros.node.simulator_node import SimNode
from puma_sim_ros.startup import ros_started


class _Stopped(BaseException):
    """A signal came while nothing had to be finished yet."""


def main(args: list[str] | None = None) -> int:
    """Entry point of ``sim_node``; returns the exit status: 2 where it does not start, 1 where it failed later."""
    stop: list[bool] = []

    def at_once(number: int, _frame: object) -> NoReturn:
        # kept as well: where a library takes up the exception, the node ends by itself when it runs
        stop.append(True)
        _heed(signal.SIG_IGN)
        raise _Stopped(number)

    _heed(at_once)
    try:
        with ros_started(args):
            node = SimNode()
            # from here on, Python's own handler could interrupt a record of the bag
            _heed(lambda *_: stop.append(True))
            node.open_bag()
            try:
                return _run(node, stop)
            finally:
                node.destroy_node()
    except (PumaSimError, ParameterException, OSError) as error:
        print(f"sim_node: {error}", file=sys.stderr)
        return 2
    except _Stopped as stopped:
        return 128 + stopped.args[0]


def _heed(handler: Any) -> None:
    """Use a handler for all signals that end the node."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, handler)


def _run(node: SimNode, stop: list[bool]) -> int:
    status = 0
    try:
        node.run(lambda: bool(stop))
    except (PumaSimError, OSError) as error:
        node.get_logger().error(str(error))
        status = 1
    finally:
        try:
            node.close()
        except (PumaSimError, OSError) as error:
            node.get_logger().error(str(error))
            status = 1
        node.get_logger().info(node.summary())
        # a second Ctrl-C, or the one that ros2 launch sends on, would kill Python while it ends
        _heed(signal.SIG_IGN)
    return status
