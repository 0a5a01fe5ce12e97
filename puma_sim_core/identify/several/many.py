# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Explanations of many logs, one each: what a job is, and its row of the table."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from puma_sim_core.identify.explain import explain
from puma_sim_core.identify.report.output import REPORT, texts_of
from puma_sim_core.identify.several.agreement import NAMED, TIED, agreement
from puma_sim_core.result_folder import ResultFolder

#: columns of summary.csv; voltages [V] are the root mean square over the joints, at rows that were not fitted
COLUMNS = (
    *("log", "folder", "verdict", "effects", "evidence", "nominal_V", "retuned_V", "augmented_V", "floor_V"),
    *("sentence", "error"),
)
#: columns of agreement.csv: an effect, of how many logs it is named and tied, and each of its sizes along the logs
AGREEMENT = (
    "effect",
    "joint",
    "named",
    "tied",
    "logs",
    "parameter",
    "law",
    "mean",
    "low",
    "high",
    "unit",
    "Q",
    "p",
    "I2",
)


@dataclass(frozen=True)
class Job:
    """A log to explain: path, which a worker elsewhere can open; name in the report; options of `explain`."""

    path: str
    name: str
    options: Mapping[str, Any]


def explained(job: Job) -> dict[str, str]:
    """The files of a report {name: text}; without the time that it took, the same job gives the same bytes."""
    found = explain(job.path, **job.options)
    return texts_of(replace(found, logs=(job.name,), seconds=0.0))


def summary(folder: ResultFolder, died: Mapping[str, str] | None = None) -> list[list[str]]:
    """Rows of `COLUMNS`, in the order of the logs; died : name of a folder -> why its job has no result."""
    return [_row(folder, job, (died or {}).get(job["name"])) for job in folder.run["jobs"]]


def compared(folder: ResultFolder) -> tuple[str, list[list[str]]] | None:
    """Whether the logs agree, as a sentence and rows of `AGREEMENT`; None of fewer than two logs."""
    names = [job["name"] for job in folder.run["jobs"]]
    if len(names) < 2:
        return None
    reports = [_report(folder, name) if folder.is_done(name) and folder.error(name) is None else None for name in names]
    found = agreement(names, reports)
    rows = []
    for effect in found.effects:
        joint = "" if effect.joint is None else str(effect.joint)
        counts = [str(effect.states.count(state)) for state in (NAMED, TIED)]
        for size in effect.sizes:
            mean = (None, None, None) if size.mean is None else (size.mean.value, size.mean.low, size.mean.high)
            tested = (size.q, size.p_value, size.i2)
            numbers = ["" if x is None else f"{x:.6g}" for x in (*mean, *tested)]
            about = [effect.name, joint, *counts, str(len(names)), size.parameter, size.law_words]
            rows.append([*about, *numbers[:3], size.unit, *numbers[3:]])
    return found.sentence, rows


def _report(folder: ResultFolder, name: str) -> Mapping[str, Any]:
    found: Mapping[str, Any] = json.loads((folder.path / name / REPORT).read_text(encoding="utf-8"))
    return found


def _row(folder: ResultFolder, job: Mapping[str, str], died: str | None) -> list[str]:
    error = died or folder.error(job["name"])
    row = {"log": job["source"], "folder": job["name"], "error": error or ""}
    if error is None:
        row |= _said(_report(folder, job["name"]))
    return [row.get(column, "") for column in COLUMNS]


def _said(report: Mapping[str, Any]) -> dict[str, str]:
    """What a row says of a report."""
    row = {"verdict": report["verdict"], "sentence": report["sentence"]}
    row["effects"] = "; ".join(map(_effect, report["effects"]))
    row["evidence"] = "; ".join(f"{effect['evidence']:.4g}" for effect in report["effects"])
    if report["errors"]["held_out"] is not None:
        for stage, volts in report["errors"]["held_out"]["voltage_rms"].items():
            if None not in volts:
                row[f"{stage}_V"] = f"{np.sqrt(np.mean(np.square(volts))):.6g}"
    return row


def _effect(effect: Mapping[str, Any]) -> str:
    """An effect as `simulate --effect` takes it."""
    values = {name: each["value"] for name, each in effect["parameters"].items()}
    joint = {} if effect["joint"] is None else {"joint": effect["joint"]}
    return f"{effect['name']}:" + ",".join(f"{name}={value:.6g}" for name, value in {**joint, **values}.items())
