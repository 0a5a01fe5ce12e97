# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The demonstration runs from nothing to a picture, and leaves what it finds alone."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

from ros_support import ROOT, run_program

from puma_sim_core.simulation.replay import replay

LINE = ROOT / "examples" / "sessions" / "line.py"


def test_demo(tmp_path):
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "precious").write_text("data")
    done = run_program(LINE, "--out", str(tmp_path), "--mode", "lockstep")
    assert done.returncode == 0, done.stdout + done.stderr
    for words in ("tracking error", "steps: ", " 0 lost", "replay identical", str(tmp_path / "bag_1")):
        assert words in done.stdout
    assert replay(tmp_path / "bag_1").identical
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["precious"]
    assert (tmp_path / "motion.png").read_bytes().startswith(b"\x89PNG")


def test_demo_says_what_failed(tmp_path):
    (tmp_path / "file").write_text("")
    done = run_program(LINE, "--out", str(tmp_path / "file"))
    assert done.returncode == 1
    assert str(tmp_path / "file") in done.stderr
    assert "Traceback" not in done.stderr
