# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A node in real time for a while: lateness of its steps, also while another process compiles the model."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

from ros_support import Diagnostics, Node, Peer

from puma_sim_core.recording.bag import read_bag
from soak.machine import ColdCache, load

#: greatest median of lateness [ms]
_MEDIAN = 0.5


def run(folder: Path, seconds: int, _seed: int, cold: bool) -> Iterator[tuple[str, bool]]:
    """Run for some seconds with a bag and a controller; a line with the statistics."""
    cache = ColdCache(folder / "cache") if cold else None
    variables = cache.variables if cache else {"PUMA_SIM_KERNEL": "auto"}
    bag = folder / "bag"
    with cache or nullcontext(), Node(variables=variables, bag_path=bag) as node, Peer(node.namespace) as peer:
        peer.find_simulator(reset=False)
        peer.on_state = lambda state: peer.commands.publish(peer.commands.msg_type(data=[3.0, -20.0, 1.0]))
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            peer.executor.spin_once(timeout_sec=0.1)
        compiling = len(cache.compilers()) if cache else 0
        peer.on_state = None
        values = Diagnostics(peer)()[2]
    steps = read_bag(bag).steps
    lost = steps[-1] + 1 - len(steps)
    late = ", ".join(f"{name} {values[f'lateness {name} [ms]']} ms" for name in ("median", "p99", "worst"))
    words = f"{values['kernel']} kernel at the end, {compiling} compilers; {load()}"
    ahead = float(values["lateness median [ms]"]) < _MEDIAN
    yield (
        f"{steps[-1]} steps, {lost} lost, {values['overruns']} overruns, {values['stalls']} stalls, {late}; {words}",
        lost == 0 and ahead,
    )
