# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The files of a report, each complete or not at all."""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from puma_sim_core.appraisal.battery import Battery, Group
from puma_sim_core.appraisal.perturbations.drawing import NOMINAL
from puma_sim_core.appraisal.report.content import content
from puma_sim_core.appraisal.report.figures import PATH_TASK, STEP_TASK
from puma_sim_core.appraisal.report.html import page
from puma_sim_core.appraisal.report.table import Place, Table
from puma_sim_core.appraisal.trials.replays import Again, again, write_bag
from puma_sim_core.appraisal.trials.response import Response
from puma_sim_core.checks import check_whole
from puma_sim_core.errors import ParameterError, RecordingError
from puma_sim_core.files import whole_file
from puma_sim_core.json_text import json_text

JSON_NAME, CSV_NAME, PAGE_NAME, BAGS_NAME = "report.json", "scoreboard.csv", "report.html", "bags"


def bag_limit(text: str | None, battery: Battery) -> int | None:
    """How many failed trials of a controller are recorded, None for all; of ``--bags``, or the profile's.

    Raises ParameterError: neither a number nor all nor none.
    """
    if text is None:
        return battery.settings.bags
    if text in ("all", "none"):
        return None if text == "all" else 0
    try:
        return check_whole(int(text), "number", 0, where="--bags")
    except ValueError:
        raise ParameterError(f"'{text}'", where="--bags", expected="a whole number, all or none") from None


def check_report_folder(folder: str) -> None:
    """Refuse, before the work, a folder that cannot be made; raises RecordingError."""
    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise RecordingError("is a file", where=folder, expected="a folder")
    above = path if path.exists() else path.resolve().parent
    while not above.exists():
        above = above.parent
    if not os.access(above, os.W_OK):
        raise RecordingError("cannot be written", where=str(above), expected="a folder that can be written")


def write_report(
    battery: Battery,
    results: Mapping[int, Mapping[str, Any]],
    folder: str,
    bags: int | None,
    again: Callable[[Battery, str, Group, int], Again] = again,
) -> list[str]:
    """Write all files; returns the lines to print: the scoreboard, and where the files are.

    bags : failed trials of a controller that are recorded, None for all; again : does a trial of a controller, by its
    name, once more. Raises RecordingError, BagError.
    """
    table = Table(battery, results)
    found = content(table)
    path = Path(folder)
    _write_bags(table, found, path, bags, again)
    texts = {
        PAGE_NAME: page(table, found, _drawn(table, again)),
        JSON_NAME: json_text(found),
        CSV_NAME: csv_text(found),
    }
    for name, text in texts.items():
        with whole_file(path / name, RecordingError) as file:
            file.write(text)
    return [*scoreboard_lines(found), *(str(path / name) for name in texts)]


def _drawn(table: Table, again: Callable[[Battery, str, Group, int], Again]) -> dict[str, dict[str, Response]]:
    """Nominal responses for the figures, by figure and controller."""
    found: dict[str, dict[str, Response]] = {"steps": {}, "path": {}}
    for figure, task in (("steps", STEP_TASK), ("path", PATH_TASK)):
        place = Place(task, NOMINAL, 0)
        for name, trials in table.trials.items():
            if place in trials:
                response = again(table.battery, name, Group(task, NOMINAL, 1), 0).response
                if response is not None and len(response.time) > 1:
                    found[figure][name] = response
    return found


def bag_path(folder: Path, controller: str, group: Group, draw: int) -> Path:
    """Where the bag of a trial is."""
    parts = (controller, group.task, group.perturbation, str(draw))
    return folder / BAGS_NAME / re.sub(r"[^A-Za-z0-9_.-]", "-", "_".join(parts))


def record_trial(folder: Path, battery: Battery, controller: str, group: Group, draw: int, trial: Again) -> None:
    """Record a trial of a controller, in place of what a run may have left that was killed meanwhile."""
    bag = bag_path(folder, controller, group, draw)
    bag.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(bag, ignore_errors=True)
    write_bag(bag, battery, group, draw, trial)


def _write_bags(
    table: Table,
    found: dict[str, Any],
    folder: Path,
    most: int | None,
    again: Callable[[Battery, str, Group, int], Again],
) -> None:
    """Record failed trials, and put the names of their bags into the content; bags that stand already stay."""
    count: dict[str, int] = {}
    for failure in found["failures"]:
        name = failure["controller"]
        if most is not None and count.get(name, 0) >= most:
            continue
        group, draw = Group(failure["task"], failure["perturbation"], 1), failure["draw"]
        bag = bag_path(folder, name, group, draw)
        if not (bag / "metadata.yaml").exists():
            trial = again(table.battery, name, group, draw)
            if not len(trial.commands):
                continue
            record_trial(folder, table.battery, name, group, draw, trial)
        count[name] = count.get(name, 0) + 1
        failure["bag"] = str(bag.relative_to(folder))


def csv_text(found: Mapping[str, Any]) -> str:
    """The scoreboard as rows that can be put together with those of other batteries."""
    battery, file = found["battery"], io.StringIO()
    rows = csv.writer(file, lineterminator="\n")
    kinds = ("profile", "seed", "mechanism", "model")
    rows.writerow(["controller", "family", *kinds, "rank", "score", "score_low", "score_high", "trials", "passed"])
    for row in found["scoreboard"]:
        kind = [battery[key] for key in kinds]
        score = [row["score"][key] for key in ("value", "low", "high")]
        rows.writerow([row["controller"], "overall", *kind, row["rank"], *score, row["trials"], row["passed"]])
        for each in row["families"]:
            own = [each["family"], *kind, "", each["score"], "", "", each["trials"], each["passed"]]
            rows.writerow([row["controller"], *own])
    return file.getvalue()


def scoreboard_lines(found: Mapping[str, Any]) -> list[str]:
    """The scoreboard as text."""
    width = max(len(row["controller"]) for row in found["scoreboard"])
    lines = [f"rank  {'controller':{width}}  score (95 %)         passed"]
    for row in sorted(found["scoreboard"], key=lambda each: (each["rank"], -each["score"]["value"])):
        value, low, high = (row["score"][key] for key in ("value", "low", "high"))
        passed = f"{row['passed']} of {row['trials']}"
        lines.append(f"{row['rank']:4}  {row['controller']:{width}}  {value:.3f} ({low:.3f} to {high:.3f})  {passed}")
    if len(found["scoreboard"]) > 1:
        lines.append(_needed(found))
    return lines


def _needed(found: Mapping[str, Any]) -> str:
    """How many trials would tell the first two apart where they differ by 5 %."""
    first, second = sorted(found["scoreboard"], key=lambda each: (each["rank"], -each["score"]["value"]))[:2]
    both = {first["controller"], second["controller"]}
    needed = next(each["trials_needed"] for each in found["comparisons"] if {each["first"], each["second"]} == both)
    said = "cannot be told from these" if needed is None else f"needs {needed} trials; each controller had"
    return f"A difference of 5 % between the first two {said}" + ("" if needed is None else f" {first['trials']}.")
