# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Bags: sessions as rosbag2 directories with an MCAP file, written and read without ROS.

    NAME/NAME_0.mcap     the messages, in simulated time
    NAME/metadata.yaml   what `ros2 bag info` and the readers of other projects need

A bag starts with the model and the session as YAML text on ``sim_node/model``. State k stands
at the time k x period, behind it the commands that step k consumed, which leads to state k + 1.
So the commands can be given to the core again, at the same steps.
"""

from puma_sim_core.recording.bag.reader import BagContents, RecordedCommand, iterate_messages, read_bag
from puma_sim_core.recording.bag.recorder import BagRecorder
from puma_sim_core.recording.bag.recover import Recovered, recover
from puma_sim_core.recording.bag.scan import RawMessage

__all__ = [
    "BagContents",
    "BagRecorder",
    "RawMessage",
    "RecordedCommand",
    "Recovered",
    "iterate_messages",
    "read_bag",
    "recover",
]
