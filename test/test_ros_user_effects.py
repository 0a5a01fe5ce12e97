# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A user's own effect in the node: it moves the arm, and the bag replays where the effect is known."""

from __future__ import annotations

import os

import pytest

pytest.importorskip("rclpy")

from ros_support import Peer, Program, arguments, run_program
from test_ros_lockstep import drive
from test_user_effects import COGGING, HYSTERESIS, command

EFFECTS = "['motor_cogging:joint=3,amplitude=2,order=4', 'gear_hysteresis:joint=2,torque=9,travel=0.02']"
FILES = ("--effects", str(COGGING), "--effects", str(HYSTERESIS))


def session(namespace: str, bag, effects: str | None, *files: str) -> list[float]:
    """Positions at the end of 60 steps in lockstep."""
    own = {} if effects is None else {"effects": effects}
    parameters = arguments({"mode": "lockstep", "bag_path": bag, "initial_position": "[0.0, -1.2, 1.0]", **own})
    with Program("puma_sim_ros.sim_node", *files, *parameters, "-r", f"__ns:={namespace}"), Peer(namespace) as peer:
        peer.find_simulator(reset=False)
        drive(peer, 60)
    return list(peer.states[-1].position)


def test_the_node_takes_effects_from_files_and_its_bag_replays(tmp_path):
    namespace = f"/own{os.getpid()}"
    with_effects = session(f"{namespace}a", tmp_path / "own", EFFECTS, *FILES)
    assert with_effects != session(f"{namespace}b", tmp_path / "plain", None)
    replayed = command("replay", tmp_path / "own", *FILES, kernel="python")
    assert replayed.returncode == 0 and "replay identical" in replayed.stdout
    unknown = command("replay", tmp_path / "own", kernel="python")
    assert unknown.returncode == 2 and "unknown effect" in unknown.stderr


def test_a_file_that_is_no_effect_ends_the_node_with_one_line(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("x = 1\n")
    done = run_program("puma_sim_ros.sim_node", "--effects", str(file), *arguments({"mode": "lockstep"}))
    assert done.returncode == 2
    assert done.stderr.strip() == (f"sim_node: effect file {file}: EFFECT is NoneType; expected EFFECT = Kind(...)")
