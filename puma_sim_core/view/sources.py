# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Sessions, reports and tables as motions."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from puma_sim_core.arm.urdf import arm_urdf
from puma_sim_core.errors import NonFiniteStateError, RecordingError
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.report.output import MODEL, REPORT
from puma_sim_core.identify.settings import SELECTION
from puma_sim_core.plant.model_file import load_model
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.bag import BagContents, read_bag
from puma_sim_core.recording.recording import GROUPS, Recording, read_csv
from puma_sim_core.simulation.replay import session_of
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.windows import run_windows
from puma_sim_core.view.chain import Chain, chain_of_plant, chain_of_urdf
from puma_sim_core.view.motion import Motion


def session_motion(path: str | os.PathLike[str]) -> Motion:
    """The motion of a bag, with the setpoints that it was commanded.

    Raises BagError or ModelError: no bag of this simulator, or a URDF that cannot be drawn.
    """
    bag = read_bag(Path(path))
    urdf = bag.urdf or arm_urdf(session_of(path, bag.config_text)[0].plant.arm, inertias=False)
    return Motion(
        name=str(path),
        chain=chain_of_urdf(urdf),
        time=bag.time_ns * 1e-9,
        position=bag.position,
        setpoint=_commanded(bag) if bag.command_interface == "position" else None,
        # that of the step which leads to the next state
        voltage=np.concatenate([bag.voltage[1:], bag.voltage[-1:]]),
        current=bag.current,
    )


def log_motion(
    path: str | os.PathLike[str],
    plant: Plant,
    columns: Mapping[str, str] | None = None,
    interval: float | None = None,
    *,
    compare: bool = True,
    drawn: bool = True,
) -> Motion:
    """The motion of a CSV log or a bag; with `compare` beside that of a model which gets the same voltages.

    plant : the machine and its model, which starts again from the measured state every `interval` [s], by default in
    the open-loop windows of `explain`; columns : as `read_log` takes them; drawn : whether the machine is to be seen,
    which not every one can be; else its chain is empty.

    Raises RecordingError, BagError: a log that cannot be read, whose times do not rise, that the model cannot follow.
    """
    log = read_log(path, columns, plant.joints)
    rows, notes = _usable(log)
    position: Any = rows.position
    motion = Motion(
        name=str(path),
        chain=chain_of_plant(plant) if drawn else Chain("", (), {}),
        time=rows.time,
        position=position,
        unit=plant.position_unit,
        setpoint=rows.setpoint,
        voltage=rows.voltage,
        current=rows.current,
        notes=(*log.notes, *notes),
    )
    return replace(motion, model=_simulated(path, plant, rows, interval or SELECTION.window)) if compare else motion


def report_motion(
    path: str | os.PathLike[str], columns: Mapping[str, str] | None = None, interval: float | None = None
) -> Motion:
    """The first log of a report of `explain` beside the model that the report found.

    path : the report's folder, or its report.json. The log is looked for where `explain` read it and beside the report.

    Raises RecordingError, ModelError: no report, none with a model, or a log that is not there any more.
    """
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    try:
        logs = json.loads((folder / REPORT).read_text(encoding="utf-8"))["logs"]
        first = Path(logs[0])
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise RecordingError(
            f"cannot be read ({getattr(error, 'strerror', None) or error})",
            where=str(folder / REPORT),
            expected="a report",
        ) from None
    if not (folder / MODEL).exists():
        what, expected = (
            f"has no {MODEL}, as after a DATA_FAULT",
            f"a report with a model, or the log: puma-sim view {first}",
        )
        raise RecordingError(what, where=str(folder), expected=expected)
    found = [
        place for place in (first, folder / first, folder / first.name, folder.parent / first.name) if place.exists()
    ]
    if not found:
        what, expected = f"its log {first} is not there", f"puma-sim view LOG --model {folder / MODEL}"
        raise RecordingError(what, where=str(folder / REPORT), expected=expected)
    motion = log_motion(found[0], load_model(folder / MODEL), columns, interval)
    more = (f"The report has {len(logs)} logs; this is the first.",) if len(logs) > 1 else ()
    return replace(motion, name=f"{folder}: {found[0].name}", notes=(*motion.notes, *more))


def with_setpoints(motion: Motion, path: str | os.PathLike[str]) -> Motion:
    """The motion with the setpoints of a CSV, which hold until its next row; raises RecordingError."""
    joints = motion.position.shape[1]
    table = read_csv(path, ("setpoint",), [group for group in GROUPS if group != "setpoint"], joints)
    setpoint: Any = table.setpoint
    row = np.searchsorted(table.time, motion.time + 1e-9, side="right") - 1
    return replace(motion, setpoint=setpoint[np.clip(row, 0, None)])


def _commanded(bag: BagContents) -> np.ndarray:
    """(n, J) position commands that act from each state on; the first position before there is one."""
    target, setpoints, given = bag.position[0].copy(), np.empty_like(bag.position), iter(bag.commands)
    pending = next(given, None)
    for k in range(len(setpoints)):
        while pending is not None and pending[0] <= k:
            names = pending[1].names or bag.joint_names
            target[[bag.joint_names.index(name) for name in names]] = pending[1].values
            pending = next(given, None)
        setpoints[k] = target
    return setpoints


def _usable(log: Log) -> tuple[Recording, tuple[str, ...]]:
    """Rows of numbers, and a note on the others; raises RecordingError."""
    groups = {name: getattr(log, name) for name in GROUPS}
    table = np.column_stack([log.time, *(values for values in groups.values() if values is not None)])
    whole = np.isfinite(table).all(axis=1)
    if whole.sum() < 2:
        raise RecordingError(f"{whole.sum()} rows of numbers", where=log.name, expected="two or more")
    groups = {name: None if values is None else values[whole] for name, values in groups.items()}
    rows = Recording(log.time[whole], **groups)
    back = np.flatnonzero(~(np.diff(rows.time) > 0.0))
    if back.size:
        k = int(np.flatnonzero(whole)[back[0] + 1])
        what = f"time {log.time[k]:.9g} s after {rows.time[back[0]]:.9g} s"
        raise RecordingError(what, where=f"{log.name}, {log.place(k)}", expected="times that increase")
    lost = len(log) - len(rows)
    return rows, (f"{lost} rows without numbers are left out.",) if lost else ()


def _simulated(path: str | os.PathLike[str], plant: Plant, rows: Recording, interval: float) -> np.ndarray:
    """(n, J) positions of the model; raises RecordingError."""
    try:
        return run_windows(Simulator(plant), rows, interval)[0].position  # type: ignore[return-value]
    except NonFiniteStateError as error:
        where = f"{path}, {rows.time[error.step]:.9g} s"
        raise RecordingError(
            "the model's state is no longer finite", where=where, expected="a model of this machine"
        ) from None
