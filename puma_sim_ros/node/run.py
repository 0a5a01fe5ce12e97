# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`SimNode` from its start to its end by a signal."""

import contextlib
import signal
import sys
from collections.abc import Iterator
from typing import Any, NoReturn

from rclpy.exceptions import ParameterException

from puma_sim_core.errors import PumaSimError
from puma_sim_ros.node.simulator_node import SimNode
from puma_sim_ros.startup import ros_started


class _Stopped(BaseException):
    """A signal came while nothing had to be finished yet."""


def main(args: list[str] | None = None) -> int:
    """Entry point of ``sim_node``; returns the exit status: 2 where it does not start, 1 where it failed later."""
    stop: list[int] = []

    def at_once(number: int, _frame: object) -> NoReturn:
        # kept as well: a library may take up the exception, and Python itself does where the signal comes while it
        # collects an object
        stop.append(number)
        _heed(signal.SIG_IGN)
        raise _Stopped(number)

    try:
        _heed(at_once)
        with _silent_about(_Stopped), ros_started(args):
            node = SimNode()
            try:
                # from here on, Python's own handler could interrupt a record of the bag
                _heed(lambda number, _: stop.append(number))
                if stop:
                    raise _Stopped(stop[0])
                node.open_bag()
                return _run(node, stop)
            finally:
                node.destroy_node()
    except (PumaSimError, ParameterException, OSError) as error:
        print(f"sim_node: {error}", file=sys.stderr)
        return 2
    except _Stopped as stopped:
        return 128 + stopped.args[0]


@contextlib.contextmanager
def _silent_about(kind: type[BaseException]) -> Iterator[None]:
    """Print no traceback of an exception of this kind that Python cannot hand on, from a callback of its memory."""
    before = sys.unraisablehook

    def hook(unraisable: Any) -> None:
        if not issubclass(unraisable.exc_type, kind):
            before(unraisable)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


def _heed(handler: Any) -> None:
    """Use a handler for all signals that end the node."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, handler)


def _run(node: SimNode, stop: list[int]) -> int:
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
