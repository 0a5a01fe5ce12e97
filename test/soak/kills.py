# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""SIGKILL of a node that records, at random moments: what its bag keeps, and whether that replays."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Iterator
from pathlib import Path

from ros_support import PERIOD_NS, Node, Peer, step_of

from puma_sim_core.recording.bag import recover
from puma_sim_core.simulation.replay import replay

#: simulated time that a kill may lose [s]: what is written each half second, and the step at its end
_LOST = 0.5 + PERIOD_NS * 1e-9


def run(folder: Path, count: int, seed: int, _cold: bool) -> Iterator[tuple[str, bool]]:
    """Kill `count` nodes; a line for each."""
    chosen = random.Random(seed)
    worst = 0.0
    for number in range(count):
        bag = folder / f"bag{number}"
        mode, moment = chosen.choice(("realtime", "lockstep")), chosen.uniform(0.0, 4.0)
        last, commands = _killed(bag, mode, moment, chosen)
        found = recover(bag)
        lost = (last - found.steps) * PERIOD_NS * 1e-9
        worst = max(worst, lost)
        result = replay(found.path)
        held = lost <= _LOST and result.identical
        yield f"{mode}, {commands} commands, step {last}: {lost:.3f} s lost, replay {result.identical}", held
    yield f"{count} kills: at most {worst:.3f} s lost", True


def _killed(bag: Path, mode: str, moment: float, chosen: random.Random) -> tuple[int, int]:
    """Drive a node for a while [s], kill it; the last state that was seen, and the number of commands."""
    # nothing of this is ended but by the kill
    node = Node(mode=mode, bag_path=bag, real_time_factor=3.0)
    sent = 0
    try:
        with Peer(node.namespace) as peer:

            def answer(state) -> None:
                nonlocal sent
                sent += 1
                peer.commands.publish(peer.commands.msg_type(data=[chosen.uniform(-20.0, 20.0) for _ in range(3)]))

            peer.wait_for(lambda: peer.commands.get_subscription_count() > 0 and peer.states, "a first state")
            answer(peer.states[-1])
            peer.on_state = answer
            end = time.monotonic() + moment
            while time.monotonic() < end:
                peer.executor.spin_once(timeout_sec=0.01)
            node.process.send_signal(signal.SIGKILL)
            node.process.wait()
            # what it had sent before
            seen = -1
            while seen != len(peer.states):
                seen = len(peer.states)
                for _ in range(5):
                    peer.executor.spin_once(timeout_sec=0.05)
            return step_of(peer.states[-1]), sent
    finally:
        node.process.kill()
        node.process.wait()
