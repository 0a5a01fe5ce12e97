# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The frames of the arm on /tf and /tf_static, where tf2_msgs is installed."""

from collections.abc import Sequence

from rclpy.node import Node

from puma_sim_core.errors import ParameterError
from puma_sim_core.recording.topics import FIXED_FRAMES, FRAMES
from puma_sim_core.simulation.session import SessionState
from puma_sim_ros.messages import qos

#: messages that are kept for a subscriber, as tf2's own broadcaster has it
_DEPTH = 100


class FramePublisher:
    """Publishes the frames of a session's states; the fixed ones once.

    Raises ParameterError where tf2_msgs, or rosbags, is not installed.
    """

    def __init__(self, node: Node, urdf: str, joint_names: Sequence[str]) -> None:
        try:
            from tf2_msgs.msg import TFMessage

            from puma_sim_core.recording.bag.frames import FrameMessages
        except ImportError as error:
            what, where = f"{error.name} is not installed", "parameter 'publish_tf'"
            expected = "the ROS package tf2_msgs and the Python package rosbags; record_tf needs no tf2_msgs"
            raise ParameterError(what, where=where, expected=expected) from error
        self._messages = FrameMessages(urdf, joint_names)
        self._moving = node.create_publisher(TFMessage, FRAMES.name, qos(_DEPTH))
        self._fixed = node.create_publisher(TFMessage, FIXED_FRAMES.name, qos(1, latched=True))
        # bytes go out as they are
        self._fixed.publish(self._messages.fixed)

    def publish(self, state: SessionState) -> None:
        """Publish the frames of a state."""
        self._moving.publish(self._messages.encode(state.time_ns, state.position))
