# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""ROS around a program of this package: started for its node, and ended with it."""

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import rclpy
from rclpy.signals import SignalHandlerOptions

from puma_sim_core.errors import PumaSimError

#: the settings of a participant that is found at once, and where Fast DDS 2 looks for such
_PROFILE = Path(__file__).with_name("discovery.xml")
_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
#: how users set Fast DDS up by themselves: variables, and files in the folder that a program is started in
_VARIABLES = (_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML", "ROS_DISCOVERY_SERVER")
_FILES = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")


class StartError(PumaSimError):
    """ROS does not start."""


@contextlib.contextmanager
def ros_started(
    args: Sequence[str] | None = None, handlers: SignalHandlerOptions = SignalHandlerOptions.NO
) -> Iterator[None]:
    """ROS with the arguments of a command line; its end is the end of ROS.

    A node that is made in it is found at once, with Fast DDS and unless the user has set that up otherwise.

    args : the command line, None for that of the process; handlers : what rclpy does of its own at a signal: it would
    shut ROS down in the middle of a step.

    Raises StartError: arguments that ROS does not take.
    """
    # read when the first node is made
    with _variable(_VARIABLE, str(_PROFILE) if _is_up_to_us() else None):
        try:
            rclpy.init(args=args, signal_handler_options=handlers)
        except Exception as error:  # the binding's own types
            raise StartError(str(error).splitlines()[0]) from error
        try:
            yield
        finally:
            rclpy.try_shutdown()


def users_environment() -> dict[str, str]:
    """The environment without what `ros_started` adds, for programs of the user's."""
    return {name: value for name, value in os.environ.items() if (name, value) != (_VARIABLE, str(_PROFILE))}


def _is_up_to_us() -> bool:
    return not any(os.environ.get(name) for name in _VARIABLES) and not any(Path(name).exists() for name in _FILES)


@contextlib.contextmanager
def _variable(name: str, value: str | None) -> Iterator[None]:
    """An environment variable for a while; None leaves it as it is."""
    if value is None:
        yield
        return
    os.environ[name] = value
    try:
        yield
    finally:
        os.environ.pop(name, None)
