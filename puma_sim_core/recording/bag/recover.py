# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Recovery of what a killed recorder left."""

import shutil
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

from puma_sim_core.recording.bag.messages import STATE_FIELDS
from puma_sim_core.recording.bag.reader import BagContents, mcap_file, read_bag
from puma_sim_core.recording.bag.recorder import BagRecorder


class Recovered(NamedTuple):
    """The bag that `recover` wrote."""

    path: Path
    steps: int  #: periods from the first state to the last
    last_time_ns: int  #: simulated time of the last state [ns]
    was_complete: bool  #: the original lacked nothing but, perhaps, its ``metadata.yaml``


def recover(path: str | Path, out: str | Path | None = None) -> Recovered:
    """Read what is there of a bag and write it as a new, closed bag; the original is not touched.

    Whole periods are kept, and the commands that a written state shows: byte for byte the bag that
    an undisturbed recorder would have closed at that state.

    Parameters
    ----------
    path : the bag's directory or its MCAP file.
    out : the directory to make; by default the name of the bag with ``_recovered`` behind it.

    Raises
    ------
    BagError : nothing can be read, or ``out`` exists or cannot be written; nothing is left of it.
    """
    contents = read_bag(path, partial=True)
    target = Path(out) if out is not None else _default_target(Path(path))
    kept = ("namespace", "config_text", "urdf", "joint_names", "frame_id", "command_interface")
    # a single state stands at time 0 whatever the period
    recorder = BagRecorder(target, **{n: getattr(contents, n) for n in kept}, period_ns=contents.period_ns or 1)
    try:
        with recorder:
            _write(contents, recorder)
    except BaseException:
        shutil.rmtree(target, ignore_errors=True)
        raise
    last = len(contents.steps) - 1
    return Recovered(target, last, int(contents.time_ns[last]), contents.complete)


def _write(contents: BagContents, recorder: BagRecorder) -> None:
    names = ("step", "time_ns", *chain(*STATE_FIELDS.values()))
    columns = [contents.steps, *(getattr(contents, name) for name in names[1:])]
    commands = iter([*contents.commands, (-1, None)])
    step, command = next(commands)
    for values in zip(*(column.tolist() for column in columns)):
        state = SimpleNamespace(**dict(zip(names, values)))
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
