# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A node with nothing compiled: how long until its first state, and until it ends by SIGINT at a random moment."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Iterator
from pathlib import Path

from ros_support import Node, Peer

from soak.machine import ColdCache

#: greatest time to the first state, and to the end [s]
_FIRST_STATE, _END = 3.0, 0.5
#: latest moment of an interrupt [s]
_LATEST = 20.0


def run(folder: Path, count: int, seed: int, _cold: bool) -> Iterator[tuple[str, bool]]:
    """Start `count` nodes; a line for each."""
    chosen = random.Random(seed)
    first, ended = [], []
    for number in range(count):
        # half of them are interrupted while they start
        moment = chosen.uniform(0.0, 1.5) if number % 2 else chosen.uniform(1.5, _LATEST)
        namespace = f"/start{number}"
        with ColdCache(folder / f"cache{number}") as cache, Peer(namespace, None) as peer:
            began = time.monotonic()
            node = Node(namespace, variables=cache.variables, bag_path=folder / f"bag{number}")
            state = None
            while time.monotonic() < began + moment:
                peer.executor.spin_once(timeout_sec=min(0.02, moment))
                if state is None and peer.states:
                    state = time.monotonic() - began
            asked = time.monotonic()
            node.process.send_signal(signal.SIGINT)
            node.process.wait(60.0)
            end = time.monotonic() - asked
            node.wait()
        ended.append(end)
        if state is not None:
            first.append(state)
        words = "none yet" if state is None else f"after {state:.2f} s"
        # before the first line of the program the interpreter itself says what interrupted it
        ours = "Traceback" in node.errors and "puma_sim" in node.errors
        held = end <= _END and (state is None or state <= _FIRST_STATE) and not ours
        yield (
            f"first state {words}; SIGINT at {moment:.2f} s: ended in {end:.3f} s, status {node.process.returncode}",
            held,
        )
    words = f"{min(first):.2f} to {max(first):.2f} s" if first else "none was waited for"
    yield (
        f"first state: {words}; end: at most {max(ended):.3f} s, {sum(e <= _END for e in ended)} of {count} in time",
        True,
    )
