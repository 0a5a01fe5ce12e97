# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Bags: sessions as rosbag2 directories with MCAP files, written and read without ROS.

    NAME/NAME_0.mcap     the messages, in simulated time
    NAME/NAME_1.mcap     those of the second hour, and so on
    NAME/metadata.yaml   what `ros2 bag info` and the readers of other projects need

A bag starts with the model and the session as YAML text on ``sim_node/model``. State k stands
at the time k x period, behind it what step k consumed, which leads to state k + 1: commands, placements of joints,
brakes, other effects. So all of it can be given to the core again, at the same steps.
"""

from puma_sim_core.recording.bag.reader import (
    BagContents,
    RecordedBrakes,
    RecordedCommand,
    RecordedEffects,
    RecordedPlacement,
    iterate_messages,
    names_told,
    read_bag,
)
from puma_sim_core.recording.bag.recorder import BagRecorder
from puma_sim_core.recording.bag.recover import Recovered, recover
from puma_sim_core.recording.bag.scan import Damage, RawMessage

__all__ = [
    "BagContents",
    "BagRecorder",
    "Damage",
    "RawMessage",
    "RecordedBrakes",
    "RecordedCommand",
    "RecordedEffects",
    "RecordedPlacement",
    "Recovered",
    "iterate_messages",
    "names_told",
    "read_bag",
    "recover",
]
