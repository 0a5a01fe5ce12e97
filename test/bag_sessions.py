# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Small sessions for the tests of bags, and a recorder that runs as a process of its own."""

from __future__ import annotations

import itertools
import os
import random
import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from puma_sim_core.recording.bag import BagRecorder, RecordedCommand

PERIOD_NS = 28_000_000
JOINTS = ("joint1", "joint2", "joint3")
CONFIG = "version: 0\nplant: {name: tést, angle: 90°}\n# last line\n"
URDF = "<robot name='puma'>\n  <link name='base_link'/>\n</robot>\n"
# Zero with a sign, the smallest and the largest magnitudes, one that is no short decimal.
SPECIAL = (-0.0, 0.0, 5e-324, -2.2250738585072e-309, 1.7976931348623157e308, -1e-17, 0.1)


class State(NamedTuple):
    step: int
    time_ns: int
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    current: tuple[float, ...]
    voltage: tuple[float, ...]
    effort: tuple[float, ...]


def numbers(key: object) -> tuple[float, ...]:
    """Three numbers that depend on ``key`` only; special ones among them."""
    source = random.Random(repr(key))
    return tuple(source.choice(SPECIAL) if source.random() < 0.1 else source.gauss(0.0, 1.0) for _ in JOINTS)


def state(step: int, period_ns: int = PERIOD_NS) -> State:
    return State(step, step * period_ns, *(numbers((step, field)) for field in State._fields[2:]))


def commands(step: int, command_interface: str) -> list[RecordedCommand]:
    """Commands that ``step`` consumes: none, one, or several that name joints."""
    if step % 5 == 3:
        return []
    if command_interface == "voltage" or step % 3 == 0:
        return [RecordedCommand(None, numbers((step, "command")))]
    one, two, three = numbers((step, "joints"))
    return [
        RecordedCommand(("joint3", "joint1"), (three, one)),
        RecordedCommand(None, numbers((step, "between"))),
        RecordedCommand(("joint2",), (two,)),
    ][: 1 + step % 3]


def new_recorder(path, command_interface: str = "voltage", **changes) -> BagRecorder:
    options = {
        "config_text": CONFIG,
        "urdf": URDF,
        "joint_names": JOINTS,
        "frame_id": "base_link",
        "command_interface": command_interface,
        "period_ns": PERIOD_NS,
    }
    return BagRecorder(path, **{**options, **changes})


def record(path, steps: int, command_interface: str = "voltage", trailing=True, **changes):
    """Record states 0 to ``steps`` and the commands that lead to them; returns the path.

    With ``trailing`` the commands that the last step consumes are written too.
    """
    period_ns = changes.get("period_ns", PERIOD_NS)
    with new_recorder(path, command_interface, **changes) as recorder:
        for step in range(steps + 1):
            recorder.write_state(state(step, period_ns))
            if trailing or step < steps:
                for command in commands(step, command_interface):
                    recorder.write_command(step * period_ns, command)
    return path


def bits(values) -> list[int]:
    """The 64 bits of each number, so that -0.0 and 0.0 differ."""
    flat = [float(value) for value in values]
    return list(struct.unpack(f"<{len(flat)}Q", struct.pack(f"<{len(flat)}d", *flat)))


def endless(path, command_interface: str, every_ns: int = 0) -> subprocess.Popen:
    """A process that records, with a new file each ``every_ns``, and prints each step it wrote, until it is ended."""
    root = Path(__file__).resolve().parent.parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    command = [sys.executable, __file__, str(path), command_interface, str(every_ns)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


def record_for_ever(path: str, command_interface: str, every_ns: str) -> None:
    """Record and print each step after it was written, until somebody ends the process."""
    every = int(every_ns)
    recorder = new_recorder(path, command_interface, splits_ns=itertools.count(every, every) if every else ())
    step = 0
    while True:
        recorder.write_state(state(step))
        for command in commands(step, command_interface):
            recorder.write_command(step * PERIOD_NS, command)
        print(step, flush=True)
        step += 1


if __name__ == "__main__":
    record_for_ever(*sys.argv[1:])
