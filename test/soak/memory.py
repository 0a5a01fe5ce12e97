# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Memory of a node that makes very many steps and records them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from ros_support import Node, Peer, step_of

from soak.machine import memory_kb

#: growth that is none [bytes a step]
_FLAT = 1.0
#: the index of a bag's present file, which begins anew each hour of simulated time [bytes]
_INDEX = 8e6
#: messages that may wait in the three subscriptions
_QUEUES = 300


def run(folder: Path, count: int, _seed: int, _cold: bool) -> Iterator[tuple[str, bool]]:
    """Memory at each tenth of `count` steps; the growth from the first tenth to the last."""
    found: list[tuple[int, int]] = []
    variables = {"PUMA_SIM_KERNEL": "auto"}
    # the arm moves on with one command
    parameters = {"bag_path": folder / "bag", "real_time_factor": 1000.0, "paused": True, "command_timeout": 0.0}
    with Node(variables=variables, **parameters) as node, Peer(node.namespace) as peer:
        peer.find_simulator()
        peer.send(3.0, -2.0, 1.0)
        peer.call("pause", data=False)
        began = time.monotonic()
        for part in range(1, 11):
            while step_of(peer.states[-1]) < part * count // 10:
                # a look now and then: to take in each state would cost more than to make it
                time.sleep(1.0)
                for _ in range(_QUEUES):
                    peer.executor.spin_once(timeout_sec=0.0)
                for collected in (peer.states, peer.currents, peer.voltages):
                    del collected[:-1]
            step, size = step_of(peer.states[-1]), memory_kb(node.process.pid)
            found.append((step, size))
            yield f"step {step}: {size} kB, {step / (time.monotonic() - began):.0f} steps/s", True
    (first, low), (last, high) = found[0], found[-1]
    growth, steps = 1024 * (high - low), last - first
    yield f"{growth / steps:.2f} bytes a step from step {first} to {last}", growth < _INDEX + _FLAT * steps
