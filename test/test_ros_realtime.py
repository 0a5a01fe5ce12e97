# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Realtime: simulated time keeps up with the clock, commands act at once, bags survive the end."""

from __future__ import annotations

import signal
import time

import pytest

pytest.importorskip("rclpy")

from ros_support import PERIOD_NS, Diagnostics, Node, Peer, step_of, time_ns

from puma_sim_core.recording.bag import read_bag
from puma_sim_core.simulation.replay import replay


class Running:
    """A node in realtime, its peer, and its bag."""

    def __init__(self, bag, **parameters):
        self.bag = bag
        self.node = Node(bag_path=bag, **parameters)
        self.peer = Peer(self.node.namespace)

    def find(self, paused=False):
        self.peer.find_simulator(reset=False)
        if not paused:
            self.peer.wait_for(
                lambda: self.peer.voltages and self.peer.states and step_of(self.peer.states[-1]) > 2, "states"
            )

    def end(self, number=signal.SIGINT):
        self.peer.close()
        return self.node.end(number)


@pytest.fixture
def running(tmp_path):
    started = []

    def start(**parameters):
        started.append(Running(tmp_path / "bag", **parameters))
        started[-1].find(parameters.get("paused", False))
        return started[-1]

    yield start
    for one in started:
        one.node.end(signal.SIGKILL)


def test_no_step_is_lost_when_the_process_is_held_up(running):
    run = running()
    peer, process = run.peer, run.node.process
    started, first = time.monotonic(), time_ns(peer.states[-1])
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.6)
    process.send_signal(signal.SIGCONT)

    def behind():
        return time.monotonic() - started - (time_ns(peer.states[-1]) - first) * 1e-9

    # the 21 steps of the hold are made good: time runs with the clock again, less what a machine that stood still for
    # longer than that has made the node give up
    diagnostics = Diagnostics(peer)
    given_up = []

    def caught_up():
        given_up.append(float(diagnostics()[2]["time given up [s]"]))
        return behind() < given_up[-1] + 0.2

    peer.wait_for(caught_up, "simulated time")
    assert run.end() == 0, run.node.errors
    assert replay(run.bag).identical
    contents = read_bag(run.bag)
    assert contents.time_ns.tolist() == [k * PERIOD_NS for k in range(len(contents.steps))]
    overruns = int(run.node.errors.rsplit("overruns ", 1)[1].split(",")[0])
    assert overruns >= 15 or given_up[-1] > 0.0


def test_the_pace_can_be_changed(running):
    run = running(paused=True, real_time_factor=0.001)  # a step each 28 s
    peer = run.peer
    peer.call("pause", data=False)
    for _ in range(10):
        peer.executor.spin_once(timeout_sec=0.02)
    assert all(step_of(state) == 0 for state in peer.states)
    assert peer.set(real_time_factor=1000.0)[0].successful
    peer.wait_for(lambda: peer.states and step_of(peer.states[-1]) > 100, "fast steps")
    assert run.end() == 0, run.node.errors


def test_a_command_is_shown_within_one_period(running):
    run = running()
    peer = run.peer
    sent = {}

    def answer(state):
        step = step_of(state)
        sent[step] = (0.001 * step, 0.0, 0.0)
        peer.commands.publish(peer.commands.msg_type(data=sent[step]))

    peer.on_state = answer
    peer.wait_for(lambda: len(sent) >= 60, "60 states")
    peer.on_state = None
    # who leaves before the step that takes its last command is a controller that is lost: the brakes hold in that step
    last = list(sent.values())[-1]
    peer.wait_for(lambda: last in peer.voltages, "the last command")
    assert run.end(signal.SIGTERM) == 0, run.node.errors
    assert replay(run.bag).identical
    contents = read_bag(run.bag)
    # the answer to state k acts from k on and is shown by state k + 1; a machine that was busy
    # for a whole period may have kept some of them back
    shown = [
        contents.voltage[step + 1].tolist() == list(volts)
        for step, volts in sent.items()
        if step + 1 < len(contents.steps)
    ]
    assert sum(shown) >= 0.5 * len(shown)
    by_step = {}
    for step, command in contents.commands:
        by_step.setdefault(step, []).append(command.values)
    # each step shows the last command that it consumed
    for step, values in by_step.items():
        assert tuple(contents.voltage[step + 1]) == values[-1]


def test_a_reset_starts_a_new_bag(running):
    run = running()
    peer = run.peer
    for number in (1, 2):
        peer.send(5.0, 5.0, 5.0)
        peer.wait_for(lambda: step_of(peer.states[-1]) > 3, "some steps")
        assert peer.call("reset").success
        peer.wait_for(lambda: step_of(peer.states[-1]) <= 3, "the start")
    assert run.end() == 0, run.node.errors
    bags = [run.bag, *(run.bag.with_name(f"bag_{number}") for number in (1, 2))]
    assert sorted(run.bag.parent.iterdir()) == sorted(bags)
    for bag in bags:
        assert replay(bag).identical
        assert (bag / f"{bag.name}_0.mcap").exists()


def test_a_reset_that_cannot_start_its_bag_is_refused(running):
    run = running(paused=True)
    run.peer.call("step")
    moved = run.bag.rename(run.bag.parent / "moved")
    run.bag.parent.rename(run.bag.parent.with_name("gone"))
    try:
        answer = run.peer.call("reset")
        assert not answer.success
        assert "cannot be made" in answer.message
        assert run.peer.call("step").message == "step 2, time 0.056 s"
    finally:
        run.bag.parent.with_name("gone").rename(run.bag.parent)
        moved.rename(run.bag)


def test_a_killed_node_leaves_all_but_the_last_second(running):
    run = running(real_time_factor=5.0)
    peer = run.peer
    peer.send(3.0, 2.0, 1.0)
    peer.wait_for(lambda: step_of(peer.states[-1]) >= 150, "150 steps")
    last = step_of(peer.states[-1])
    run.end(signal.SIGKILL)
    contents = read_bag(run.bag, partial=True)
    assert (contents.steps[-1] + 1) * PERIOD_NS >= last * PERIOD_NS - 1_000_000_000
