# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""ROS around the programs: what they ask of Fast DDS, and that a user's own settings of it stay in force."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
import weakref

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from ros_support import Program, arguments, run_program

from puma_sim_core.simulation.replay import replay
from puma_sim_ros.node import run
from puma_sim_ros.startup import StartError, ros_started, users_environment

VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
#: how users set Fast DDS up
SETTINGS = (VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "RMW_FASTRTPS_USE_QOS_FROM_XML", "ROS_DISCOVERY_SERVER")
#: no other test has it, see ros_support
_DOMAIN = 101


@pytest.fixture(autouse=True)
def plain(monkeypatch, tmp_path):
    """A folder and an environment in which nobody has set Fast DDS up."""
    for name in SETTINGS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)


def test_the_settings_are_there_for_the_node_and_not_for_programs_of_the_users():
    before = dict(os.environ)
    with ros_started([]):
        assert os.environ[VARIABLE].endswith("discovery.xml") and os.path.exists(os.environ[VARIABLE])
        assert users_environment() == before
    assert dict(os.environ) == before


@pytest.mark.parametrize("name", SETTINGS)
def test_variables_of_the_users_stay_as_they_are(monkeypatch, name):
    monkeypatch.setenv(name, "mine")
    before = dict(os.environ)
    with ros_started([]):
        assert dict(os.environ) == before
        assert users_environment() == before
    assert dict(os.environ) == before


@pytest.mark.parametrize("name", ["DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml"])
def test_a_file_of_the_users_is_not_pushed_aside(tmp_path, name):
    (tmp_path / name).write_text("")
    with ros_started([]):
        assert VARIABLE not in os.environ


def test_bad_arguments_are_one_line_and_leave_nothing_behind():
    with pytest.raises(StartError, match="x:y:"), ros_started(["--ros-args", "-p", "x:y::=1"]):
        pass
    assert VARIABLE not in os.environ and not rclpy.ok()


@pytest.mark.parametrize("program", ["external_controller", "appraised_controller", "viewer", "appraise", "sim_node"])
def test_all_programs_refuse_arguments_that_ros_does_not_take(program):
    done = run_program(f"puma_sim_ros.{program}", *arguments({"x:y:": 1}))
    assert done.returncode in (1, 2)
    assert done.stderr.strip().splitlines()[-1].startswith(f"{program}: ")
    assert "x:y:" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_at_any_moment_of_the_start_leaves_a_closed_bag_or_none(tmp_path, monkeypatch, number):
    # before the first line of a program coverage is imported by what passes over any exception, that of Ctrl-C as well
    for name in ("COVERAGE_PROCESS_START", "COVERAGE_PROCESS_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    for moment in np.linspace(0.3, 1.8, 6):
        bag = tmp_path / f"bag{moment:.1f}"
        node = Program("puma_sim_ros.sim_node", *arguments({"bag_path": bag}))
        time.sleep(moment)
        status = node.end(number)
        if status == 1 and number == signal.SIGINT and "sim_node.py" not in node.errors:
            assert "KeyboardInterrupt" in node.errors  # of the interpreter, before the first line of the program
            continue
        assert status in (0, 128 + number, -number), node.errors
        assert "Traceback" not in node.errors
        if status == 0:
            assert replay(bag).identical
        else:
            assert not bag.exists()


def test_a_signal_while_python_collects_an_object_is_neither_lost_nor_a_traceback(monkeypatch, capfd):
    """Python cannot hand on what is raised there, for instance when the lock of an import is no longer needed."""

    class Node:
        def __init__(self):
            class Lock: ...

            lock = Lock()
            _kept = weakref.ref(lock, lambda _: signal.raise_signal(signal.SIGTERM))
            del lock

        def destroy_node(self): ...

        def open_bag(self):
            pytest.fail("a bag is opened after the signal")

    before = [(number, signal.getsignal(number)) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    told: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", told.append)
    monkeypatch.setattr(run, "SimNode", Node)
    try:
        assert run.main([]) == 128 + signal.SIGTERM
    finally:
        for number, handler in before:
            signal.signal(number, handler)
    assert not told and capfd.readouterr().err == ""


def test_fast_dds_takes_the_settings_and_announces_the_node_more_often():
    """A socket where a participant would listen counts announcements: one a second, where others send one each 3 s.

    The counts are compared with those of a node whose user has set Fast DDS up.
    """
    found = {}
    for name, variables in (("ours", {}), ("default", {"RMW_FASTRTPS_USE_QOS_FROM_XML": "0"})):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
            listener.settimeout(0.2)
            # that of the second participant of the domain, next to that of the node
            listener.bind(("127.0.0.1", 7400 + 250 * _DOMAIN + 12))
            with Program("puma_sim_ros.sim_node", ROS_DOMAIN_ID=str(_DOMAIN), **variables) as node:
                node.wait_for("commands on")
                # the first ones come at shorter intervals
                time.sleep(3.0)
                found[name] = _announcements(listener, 12.0)
            assert "XMLPARSER" not in node.output + node.errors
    assert found["ours"] > 1.5 * found["default"] > 0


def _announcements(listener: socket.socket, seconds: float) -> int:
    end, count = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        try:
            count += listener.recv(1 << 16).startswith(b"RTPS")
        except TimeoutError:
            continue
    return count
