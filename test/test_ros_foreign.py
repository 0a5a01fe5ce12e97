# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A controller that knows the documentation alone tracks in each interface and mode."""

from __future__ import annotations

import ast
import re
import subprocess
import sys

import pytest

pytest.importorskip("rclpy")

from ros_support import ROOT, Node, environment

from puma_sim_core.recording.bag import read_bag
from puma_sim_core.simulation.replay import replay

CONTROLLER = ROOT / "examples" / "foreign_controller.py"


def test_it_is_short_and_imports_nothing_of_this_project():
    text = CONTROLLER.read_text()
    assert len(text.splitlines()) <= 50
    names = [alias.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
    assert names and not [name for name in names if name.startswith("puma_sim")]


@pytest.mark.long
@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
@pytest.mark.parametrize("interface", ["voltage", "position", "joints"])
def test_it_tracks(interface, mode, tmp_path):
    taken = "voltage" if interface == "voltage" else "position"
    with Node(mode=mode, command_interface=taken, bag_path=tmp_path / "bag") as node:
        done = subprocess.run(
            [sys.executable, CONTROLLER, interface, "--ros-args", "-r", f"__ns:={node.namespace}"],
            env=environment(),
            text=True,
            capture_output=True,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
    said = re.fullmatch(r"(\d+) states answered, error: rms (\S+) rad, greatest (\S+) rad\n", done.stdout)
    answered, rms, greatest = map(float, said.groups())
    print(interface, mode, done.stdout)
    # the way is 0.47 rad long; on a busy machine states and commands come late
    assert answered > 100 and rms < 0.05
    assert mode == "realtime" or greatest < 0.03
    contents = read_bag(tmp_path / "bag")
    if mode == "lockstep":
        # one step a command
        assert [step for step, _ in contents.commands] == list(range(len(contents.steps) - 1))
    assert replay(tmp_path / "bag").identical
