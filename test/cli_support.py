# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Calls of `puma-sim` and files for it, for the tests."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from puma_sim_core.cli import main
from puma_sim_core.compiling import STARTS
from puma_sim_core.files import yaml_text
from puma_sim_core.recording.bag import BagRecorder
from puma_sim_core.recording.recording import Recording, read_csv, write_csv
from puma_sim_core.simulation.session import Session, SessionConfig

ROOT = Path(__file__).resolve().parent.parent
STATE_GROUPS = ("position", "velocity", "current")
#: what reads an output file of the command
GROUPS = ("voltage", *STATE_GROUPS)
HEADER = "time,voltage1,voltage2,voltage3"


def puma_sim(*arguments, patience: float = 170.0, **environment: str) -> subprocess.CompletedProcess:
    """The command as a process of its own, for at most `patience` [s]."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return subprocess.run(
        [sys.executable, "-m", "puma_sim_core", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=patience,
        env={**os.environ, "PYTHONPATH": path, **environment},
    )


def complaints(process: subprocess.CompletedProcess) -> list[str]:
    """What a command wrote to standard error, without its progress and the note of a first start."""
    progress = re.compile(r"puma-sim: .+: +\d+%, \d+ s|puma-sim: " + re.escape(STARTS))
    return [line for line in process.stderr.splitlines() if not progress.fullmatch(line)]


def call(*arguments) -> int:
    """The command in this process."""
    return main([str(argument) for argument in arguments])


def write_volts(path, time, voltage) -> Path:
    write_csv(Recording(time=np.asarray(time, dtype=float), voltage=np.asarray(voltage, dtype=float)), path)
    return path


def read_run(path) -> Recording:
    return read_csv(path, GROUPS)


def states(recording: Recording) -> np.ndarray:
    """(n, 9): positions, velocities, currents."""
    return np.hstack([getattr(recording, name) for name in STATE_GROUPS])


def triple(values) -> str:
    """Three numbers as an option takes them, with every digit."""
    return ",".join(repr(float(value)) for value in values)


def random_volts(path, rows=150, amplitude=12.0, seed=3, row=0.004) -> Path:
    """Rows of random length about `row` [s], each with other voltages."""
    random = np.random.default_rng(seed)
    time = 0.5 + np.cumsum(random.uniform(0.2 * row, 3.0 * row, rows))
    return write_volts(path, time, random.uniform(-amplitude, amplitude, (rows, 3)))


def contents(folder: Path) -> dict[str, bytes]:
    """All that is below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def record_session(
    path, config: SessionConfig, commands: dict, steps: int, change=lambda state: state, **options
) -> Path:
    """A bag as the node writes it; `change(state)` may falsify what is written; options of the recorder."""
    session = Session(config)
    with BagRecorder(
        path,
        namespace="/",
        config_text=yaml_text(config.to_mapping()),
        joint_names=config.joint_names,
        frame_id=config.frame_id,
        command_interface=config.command_interface,
        period_ns=config.period_ns,
        **options,
    ) as recorder:
        recorder.write_state(change(session.state))
        for step in range(steps):
            for names, values in commands.get(step, ()):
                command = session.command(values) if names is None else session.command_joints(names, values)
                recorder.write_command(session.state.time_ns, command)
            recorder.write_state(change(session.step()))
    return path
