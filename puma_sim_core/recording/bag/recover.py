# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Recovery of what a killed recorder left."""

import os
import shutil
import tempfile
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import metadata
from puma_sim_core.recording.bag.reader import (
    BagContents,
    RecordedBrakes,
    RecordedCommand,
    RecordedEffects,
    RecordedPlacement,
    read_bag,
)
from puma_sim_core.recording.bag.recorder import BagRecorder
from puma_sim_core.recording.bag.scan import Damage
from puma_sim_core.recording.topics import STATE_FIELDS


class Recovered(NamedTuple):
    """The bag that `recover` wrote."""

    path: Path
    steps: int  #: the last one, counted from the first state
    last_time_ns: int  #: simulated time of the last state [ns]
    was_complete: bool  #: the original lacked nothing but, perhaps, its ``metadata.yaml``
    damage: tuple[Damage, ...]  #: where reading stopped, or was taken up again behind what could not be read
    missing: tuple[tuple[int, int], ...]  #: (first, last) step of what is missing in between


def recover(path: str | Path, out: str | Path | None = None, *, force: bool = False) -> Recovered:
    """Read what is there of a bag and write it as a new, closed bag; the original is not touched.

    Whole periods are kept, and the commands that a written state shows: byte for byte the bag that
    an undisturbed recorder would have closed at that state, split into files at the same states. Behind a damaged chunk
    and a missing file reading goes on; the new bag lacks its steps.

    Parameters
    ----------
    path : the bag's directory, or its first MCAP file alone.
    out : the directory to make; by default the name of the bag with ``_recovered`` behind it.
    force : a bag that ``out`` is already is replaced, once the new one is whole.

    Raises
    ------
    BagError : nothing can be read, or ``out`` exists or cannot be written; nothing is left of it.
    """
    target = Path(out) if out is not None else _default_target(Path(path))
    _check_target(target, Path(path), force)
    contents = read_bag(path, partial=True)
    if not target.exists():
        return _recovered(contents, target)
    # named as the bag is: the names of its files follow
    try:
        with tempfile.TemporaryDirectory(prefix=".new-", dir=target.resolve().parent) as beside:
            found = _recovered(contents, Path(beside) / target.resolve().name)
            shutil.rmtree(target)
            found.path.rename(target)
    except OSError as error:
        what = f"cannot be replaced ({error.strerror})"
        raise BagError(what, where=target, expected="a folder that can be written") from error
    return found._replace(path=target)


def _check_target(target: Path, source: Path, force: bool) -> None:
    if not os.path.lexists(target):
        return
    if not force:
        raise BagError("exists already", where=target, expected="another name, or --force to replace it")
    if target.is_symlink() or not target.is_dir() or any(not _of_a_bag(path) for path in target.iterdir()):
        raise BagError("is no bag", where=target, expected="a bag to replace, or a name that is not taken")
    bag = source if source.is_dir() else source.parent
    if bag.exists() and os.path.samefile(bag, target):
        raise BagError("is the bag that is recovered", where=target, expected="another name")


def _of_a_bag(path: Path) -> bool:
    return path.is_file() and (path.name == metadata.NAME or path.suffix == ".mcap")


def _recovered(contents: BagContents, target: Path) -> Recovered:
    kept = ("namespace", "config_text", "urdf", "frames", "joint_names", "frame_id", "command_interface", "splits_ns")
    # a single state stands at time 0 whatever the period
    recorder = BagRecorder(target, **{n: getattr(contents, n) for n in kept}, period_ns=contents.period_ns or 1)
    try:
        with recorder:
            _write(contents, recorder)
    except BaseException:
        shutil.rmtree(target, ignore_errors=True)
        raise
    last_time = int(contents.time_ns[-1])
    return Recovered(target, int(contents.steps[-1]), last_time, contents.complete, contents.damage, contents.missing)


def _write(contents: BagContents, recorder: BagRecorder) -> None:
    names = ("step", "time_ns", *chain(*STATE_FIELDS.values()))
    columns = [contents.steps, *(getattr(contents, name) for name in names[1:])]
    inputs = iter([*contents.inputs, (-1, None)])
    step, given = next(inputs)
    for values in zip(*(column.tolist() for column in columns)):
        state = SimpleNamespace(**dict(zip(names, values)))
        if state.step > recorder.steps:
            recorder.skip_to(state.step)
        recorder.write_state(state)
        while step == state.step:
            match given:
                case RecordedCommand():
                    recorder.write_command(state.time_ns, given)
                case RecordedPlacement():
                    recorder.write_placement(state.time_ns, given)
                case RecordedBrakes(engaged):
                    recorder.write_brakes(state.time_ns, engaged)
                case RecordedEffects(text):
                    recorder.write_effects(state.time_ns, text)
            step, given = next(inputs)


def _default_target(path: Path) -> Path:
    if not path.is_dir():
        # NAME/NAME_0.mcap belongs to the bag NAME; any other file stands for itself.
        bag = path.resolve().parent
        path = bag if path.stem == f"{bag.name}_0" else path.with_suffix("")
    path = path.resolve()
    return path.with_name(path.name + "_recovered")
