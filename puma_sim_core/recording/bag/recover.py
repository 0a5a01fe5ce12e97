# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Recovery of what a killed recorder left."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

from puma_sim_core.recording.bag.reader import BagContents, mcap_file, read_bag
from puma_sim_core.recording.bag.recorder import BagRecorder


class _State(NamedTuple):
    step: int
    time_ns: int
    position: list[float]
    velocity: list[float]
    current: list[float]
    voltage: list[float]
    effort: list[float]


class Recovered(NamedTuple):
    """The bag that `recover` wrote.

    ``steps`` is the number of periods from the first state to the last, ``last_time_ns`` the
    simulated time of the last [ns]. ``was_complete`` says that the original lacked nothing but,
    perhaps, its ``metadata.yaml``.
    """

    path: Path
    steps: int
    last_time_ns: int
    was_complete: bool


def recover(path: str | Path, out: str | Path | None = None) -> Recovered:
    """Read what is there of a bag and write it as a new, closed bag.

    Whole periods are kept: joint states, currents and volts of one time. Commands are kept up to
    the last one that a written state shows. The result is, byte for byte, the bag that an
    undisturbed recorder would have closed at that state. The original is not touched.

    Parameters
    ----------
    path : the bag's directory or its MCAP file.
    out : the directory to make; by default the name of the bag with ``_recovered`` behind it.

    Raises
    ------
    BagError : nothing can be read, or ``out`` exists or cannot be written; then nothing is
        left of ``out``.
    """
    contents = read_bag(path, partial=True)
    target = Path(out) if out is not None else _default_target(Path(path))
    recorder = BagRecorder(
        target,
        namespace=contents.namespace,
        config_text=contents.config_text,
        urdf=contents.urdf,
        joint_names=contents.joint_names,
        frame_id=contents.frame_id,
        command_interface=contents.command_interface,
        # A single state stands at time 0 whatever the period.
        period_ns=contents.period_ns or 1,
    )
    try:
        with recorder:
            _write(contents, recorder)
    except BaseException:
        shutil.rmtree(target, ignore_errors=True)
        raise
    last = len(contents.steps) - 1
    return Recovered(target, last, int(contents.time_ns[last]), contents.complete)


def _write(contents: BagContents, recorder: BagRecorder) -> None:
    columns = [
        column.tolist()
        for column in (
            contents.steps,
            contents.time_ns,
            contents.position,
            contents.velocity,
            contents.current,
            contents.voltage,
            contents.effort,
        )
    ]
    commands = iter([*contents.commands, (None, None)])
    step, command = next(commands)
    for values in zip(*columns):
        state = _State(*values)
        recorder.write_state(state)
        while step == state.step:
            recorder.write_command(state.time_ns, command)
            step, command = next(commands)


def _default_target(path: Path) -> Path:
    if not path.is_dir():
        file, _ = mcap_file(path, partial=True)
        # NAME/NAME_0.mcap belongs to the bag NAME; any other file stands for itself.
        bag = file.resolve().parent
        path = bag if file.stem == f"{bag.name}_0" else file.with_suffix("")
    path = path.resolve()
    return path.with_name(path.name + "_recovered")
