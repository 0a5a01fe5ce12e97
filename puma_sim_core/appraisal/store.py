# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The folder of a battery: what it is, and the results of the units that are done, each in a folder of its own.

So a battery that was killed goes on where it stopped, shards may share a folder, and a unit is there whole or not at
all. What the units depend on beside the battery, such as the file of a controller, is known by its SHA-256.
"""

from __future__ import annotations

import hashlib
import json
import os
import shlex
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from puma_sim_core.appraisal import controllers
from puma_sim_core.appraisal.battery import Battery, Unit
from puma_sim_core.effects.registry import VARIABLE
from puma_sim_core.errors import RecordingError
from puma_sim_core.json_text import json_text
from puma_sim_core.result_folder import ResultFolder, digest, merged

COMMAND, RESULT = "appraise", "result.json"
Results = dict[int, dict[str, Any]]


class Store:
    """Results of a battery in a folder, by the index of their unit; `open_store` makes one."""

    def __init__(self, folder: ResultFolder, results: Results):
        self._folder = folder
        self.results = results

    def add(self, result: Mapping[str, Any]) -> None:
        """Write the result of a unit, unless it stands already; raises RecordingError."""
        number = result["unit"]
        if number not in self.results:
            text = json_text(result)
            self._folder.write(_name(number), {RESULT: text})
            self.results[number] = json.loads(text)


def open_store(folder: str | os.PathLike[str], battery: Battery) -> Store:
    """The results of a battery in its folder, which is made if it does not exist.

    Raises RecordingError: a folder of another battery or of something else, or one that cannot be written.
    """
    found = ResultFolder(folder, _run(battery))
    found.begin()
    return Store(found, read_results(found))


def _run(battery: Battery) -> dict[str, Any]:
    """The command, its settings and its jobs, as a `ResultFolder` has them."""
    settings = battery.to_mapping()
    processes = {process.name: process for process in battery.processes}
    for name in filter(controllers.is_foreign, battery.controllers):
        if name in processes:
            files = filter(os.path.isfile, shlex.split(processes[name].command))
            settings |= {f"contents of {name}, {os.path.basename(file)}": digest(file) for file in files}
            continue
        spec = find_spec(name.partition(":")[0])
        if spec is not None and spec.origin is not None and os.path.isfile(spec.origin):
            settings[f"contents of {name}"] = digest(spec.origin)
    if os.path.isfile(battery.mechanism):
        settings["contents of plant"] = digest(battery.mechanism)
    for path in filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)):
        settings[f"effect {os.path.basename(path)}"] = digest(path)
    return {"command": COMMAND, "settings": settings, "jobs": [_job(unit) for unit in battery.units]}


def _job(unit: Unit) -> dict[str, Any]:
    described = hashlib.sha256(repr(unit).encode()).hexdigest()
    return {"name": _name(unit.number), "source": f"unit {unit.number} of {unit.controller}", "sha256": described}


def _name(number: int) -> str:
    return f"units/{number:05}"


def read_battery(folder: ResultFolder) -> Battery:
    """The battery of a folder; raises RecordingError or ParameterError."""
    found = folder.run["command"]
    if found != COMMAND:
        raise RecordingError(f"is of `{found}`", where=str(folder.path), expected="the folder of an appraisal")
    return Battery.from_mapping(folder.run["settings"], str(folder.path))


def read_results(folder: ResultFolder) -> Results:
    """Results of a folder by the index of their unit; raises RecordingError."""
    found: Results = {}
    for number, name in enumerate(folder.names):
        path = folder.path / name / RESULT
        if not folder.is_done(name):
            continue
        try:
            found[number] = json.loads(path.read_text(encoding="utf-8"))
            if found[number]["unit"] != number:
                raise ValueError(f"unit {found[number]['unit']}")
        except (OSError, ValueError, KeyError, TypeError) as error:
            expected = "a unit's results; remove its folder to have it done again"
            raise RecordingError(f"cannot be used ({error})", where=str(path), expected=expected) from None
    return found


def merge(paths: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]) -> tuple[Battery, Results]:
    """Put the results of shards into a folder, which may be one of theirs.

    Raises RecordingError: no folder, folders of different batteries, units with different results, or units missing.
    """
    if not paths:
        raise RecordingError("no folder", where="merge", expected="the folders of all shards")
    battery = read_battery(ResultFolder.opened(paths[0]))
    return battery, read_results(merged(paths, Path(out)))
