# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Nobody waits for the compiler: the node begins as plain Python, and goes over to what another process compiles."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from ros_support import PATIENCE, Diagnostics, Node, Peer, environment, step_of

from puma_sim_core import jit
from puma_sim_core.recording.bag import read_bag
from puma_sim_core.simulation.replay import replay

pytestmark = [pytest.mark.long, pytest.mark.skipif(jit.BACKEND != "numba", reason="there is nothing to compile")]


def compilers(cache: Path) -> list[int]:
    """Process numbers of those that compile into a cache."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
            variables = (folder / "environ").read_bytes().split(b"\0")
            ours = f"NUMBA_CACHE_DIR={cache}".encode() in variables
            if ours and b"puma_sim_core.identify.compile_ahead" in words:
                found.append(int(folder.name))
        except OSError:  # it has ended
            continue
    return found


@pytest.fixture
def cache(tmp_path):
    """A folder for compiled code, and an end for who compiles into it."""
    folder = tmp_path / "cache"
    folder.mkdir()
    yield folder
    for number in compilers(folder):
        os.kill(number, signal.SIGKILL)


def variables(cache: Path) -> dict[str, str]:
    return {"PUMA_SIM_KERNEL": "auto", "NUMBA_CACHE_DIR": str(cache)}


def test_from_a_cold_cache_the_node_moves_and_ends_while_another_process_compiles(cache, tmp_path):
    bag = tmp_path / "bag"
    with Node(variables=variables(cache), bag_path=bag) as node, Peer(node.namespace) as peer:
        peer.find_simulator(reset=False)
        peer.wait_for(lambda: peer.states and step_of(peer.states[-1]) > 5, "steps")
        assert Diagnostics(peer)()[2]["kernel"] == "python"
        assert len(compilers(cache)) == 1
        assert node.end() == 0
    assert "another process compiles it" in node.errors
    # which goes on, behind all other work; a second program finds it at work and adds none
    (compiler,) = compilers(cache)
    assert os.getpriority(os.PRIO_PROCESS, compiler) == 10
    group = Path(f"/proc/{compiler}/autogroup")
    assert not group.exists() or "nice 10" in group.read_text()
    done = subprocess.run(
        [sys.executable, "-m", "puma_sim_core", "replay", bag],
        env={**environment(), **variables(cache)},
        text=True,
        capture_output=True,
    )
    assert "python kernel" in done.stdout and "replay identical" in done.stdout, done.stderr
    assert "another process compiles it" in done.stderr
    assert len(compilers(cache)) == 1
    assert not list(cache.rglob("compiled-arm"))


def test_the_node_goes_over_to_the_compiled_model_without_a_change_of_a_bit(cache, tmp_path):
    """With a cache that has the code and lacks the marks: the other process loads it, and says that it is there."""
    assert jit.cache_directory() is not None
    subprocess.run(
        [sys.executable, "-m", "puma_sim_core.identify.compile_ahead"],
        env={**environment(), "PUMA_SIM_KERNEL": "numba"},
        check=True,
    )
    kernel = Path(str(jit.cache_directory()))
    shutil.copytree(kernel, cache / "puma_sim" / kernel.name, ignore=shutil.ignore_patterns("compiled-*"))
    bag = tmp_path / "bag"
    with Node(variables=variables(cache), bag_path=bag) as node, Peer(node.namespace) as peer:
        peer.find_simulator(reset=False)
        diagnostics = Diagnostics(peer)
        commands = 0

        def compiled():
            nonlocal commands
            commands += 1
            peer.commands.publish(peer.commands.msg_type(data=[0.01 * commands, 0.0, 0.0]))
            return diagnostics()[2]["kernel"] == "numba"

        # what loads it leaves the processors to all others, and loads the whole kernel
        peer.wait_for(compiled, "the compiled model", patience=5 * PATIENCE)
        last = step_of(peer.states[-1])
        peer.wait_for(lambda: step_of(peer.states[-1]) > last + 10, "steps")
    assert "the compiled model runs from step" in node.errors
    switched = int(node.errors.split("the compiled model runs from step ")[1].split()[0])
    contents = read_bag(bag)
    assert 0 < switched < contents.steps[-1] and contents.commands
    assert replay(bag).identical
