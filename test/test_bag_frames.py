# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Frames in bags and on /tf: those of the thesis's arm, in messages that other programs read."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from puma_sim_core.arm.kinematics import link_transforms
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.urdf import arm_urdf
from puma_sim_core.recording.bag.frames import FrameMessages
from puma_sim_core.recording.bag.messages import decode
from puma_sim_core.recording.topics import TF_MESSAGE

NAMES = ("waist", "shoulder", "elbow")


def placed(transforms, root="base_link"):
    """World transform of each frame, by name."""
    found = {root: np.eye(4)}
    for message in transforms:
        local, t, r = np.eye(4), message.transform.translation, message.transform.rotation
        local[:3, :3] = Rotation.from_quat([r.x, r.y, r.z, r.w]).as_matrix()
        local[:3, 3] = t.x, t.y, t.z
        found[message.child_frame_id] = found[message.header.frame_id] @ local
    return found


@pytest.mark.parametrize("name", ["bejczy", "corke_armstrong_1994"])
def test_the_frames_are_those_of_the_denavit_hartenberg_chain(name):
    arm = load_parameters(name)
    messages = FrameMessages(arm_urdf(arm, NAMES), NAMES)
    fixed = decode(messages.fixed, TF_MESSAGE).transforms
    rng = np.random.default_rng(3)
    for step in range(30):
        q, time_ns = rng.uniform(-np.pi, np.pi, 3), 28_000_000 * step * 37
        moving = decode(messages.encode(time_ns, q), TF_MESSAGE).transforms
        stamps = {m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for m in moving}
        assert stamps == {time_ns}
        chain, found = link_transforms(q, arm), placed([*moving, *fixed])
        for joint in range(3):
            # joint i turns about z of frame i-1, and its link has the origin of that frame
            assert np.allclose(found[f"link{joint + 1}"][:3, 2:], chain[joint][:3, 2:], atol=1e-14, rtol=0)
        tool = chain[3].copy()
        tool[:3, 3] += arm.d4 * tool[:3, 2]
        assert np.allclose(found["tool0"], tool, atol=1e-14, rtol=0)


def test_equal_states_give_equal_bytes_whatever_came_before():
    urdf = arm_urdf(load_parameters("bejczy"), NAMES)
    used, fresh = FrameMessages(urdf, NAMES), FrameMessages(urdf, NAMES)
    used.encode(10**9 + 1, (3.0, -2.0, 1.0))
    assert used.encode(56_000_000, (0.1, 0.2, 0.3)) == fresh.encode(56_000_000, (0.1, 0.2, 0.3))
