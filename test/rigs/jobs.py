# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One explanation in a process of its own, so that its seconds and its memory can be measured.

  python test/rigs/jobs.py JOB.json OUTCOME.json

`Job` is what the program `run` asks for; the outcome has the report without its long tables, seconds, megabytes, or the
error's text.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

if __name__ == "__main__" and not __package__:
    # run as a script: the package is this folder
    sys.path[0:1] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parents[2])]
    __package__ = "rigs"

import puma_sim_core
from puma_sim_core.errors import PumaSimError
from puma_sim_core.files import read_yaml, yaml_text
from puma_sim_core.identify import explain
from puma_sim_core.identify.report.json import report_mapping
from puma_sim_core.identify.report.output import write_explanation
from puma_sim_core.resources import config_path
from rigs.catalogue import Log, Reference, Rig, Run
from rigs.logs import as_file, table_of, write_table
from rigs.measures import measured
from rigs.variants import BLAS, VARIANTS, Given

#: of a report, what the table does not need
_LEFT_OUT = ("detectability", "next_experiment", "ranking", "notes", "logs", "held_out_logs", "feedback_bias")
_SHAPE = ("axis", "axis_unit", "way", "joint", "line_hz")
#: files beside the package and the mechanism whose text an outcome depends on
_CODE = ("jobs.py", "logs.py", "measures.py", "variants.py")


@dataclass(frozen=True)
class Job:
    """An explanation: the logs of a run, changed by a variant where one is named.

    data : folder of the logs; mechanism : name or path; out : folder of the report; floor : of the voltage [V], which
    noise is added in proportion to; reference : the measure of ours that is wanted (see `measures.measured`).
    """

    run: str
    variant: str | None
    data: str
    logs: tuple[Log, ...]
    held_out: tuple[Log, ...]
    spare: tuple[Log, ...]
    mechanism: str
    columns: Mapping[str, str] | None
    reference: Mapping[str, Any] | None
    out: str
    floor: tuple[float, ...] | None = None
    seed: int = 0

    @classmethod
    def of(cls, rig: Rig, run: Run, data: str, out: str, variant: str | None = None, floor=None) -> Job:
        """The job of a run, or of a variant of it."""
        return cls(
            run=run.key,
            variant=variant,
            data=str(data),
            logs=run.logs,
            held_out=run.held_out,
            # only a log that is added needs them
            spare=run.spare if variant == "held_out_added" else (),
            mechanism=str(rig.mechanism),
            columns=rig.columns,
            reference=None if variant or run.reference is None else _computed(run.reference),
            out=str(Path(out, run.key, *(("variants", variant) if variant else ()))),
            floor=None if floor is None or variant != "noise_added" else tuple(floor),
        )

    @classmethod
    def from_mapping(cls, mapping: dict[str, Any]) -> Job:
        """The inverse of `asdict`, through JSON."""
        logs = {key: tuple(Log(**log) for log in mapping[key]) for key in ("logs", "held_out", "spare")}
        return cls(**{**mapping, **logs})

    @property
    def name(self) -> str:
        """Its words in progress and errors."""
        return self.run if self.variant is None else f"{self.run}, {self.variant}"

    def key(self) -> str:
        """Digest of all that is asked, the mechanism's text among it, but not where files stand."""
        asked = {name: value for name, value in asdict(self).items() if name not in ("data", "out")}
        asked["text"] = mechanism_path(self.mechanism).read_text(encoding="utf-8")
        asked["bytes"] = [_size(self.data, log) for log in (*self.logs, *self.held_out, *self.spare)]
        return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()[:24]


def _computed(reference: Reference) -> dict[str, Any]:
    """What of a reference our own error depends on."""
    asked = ("computed", "seconds", "cutoff", "logs")
    return {name: value for name, value in asdict(reference).items() if name in asked}


def _size(data: str, log: Log) -> int:
    path = Path(data) / log.file
    return path.stat().st_size if path.exists() else -1


def mechanism_path(name: str) -> Path:
    """The file of a mechanism by name or path."""
    path = Path(name)
    return path if path.suffix == ".yaml" else config_path("mechanisms", f"{name}.yaml")


def work(job: Job) -> dict[str, Any]:
    """The outcome of a job: report (without its long tables) or error (text), applies, seconds, megabytes, ours."""
    outcome: dict[str, Any] = {"report": None, "error": None, "crash": None, "applies": True, "seconds": None}
    outcome |= {"ours": None}
    with tempfile.TemporaryDirectory(prefix="rigs-") as folder:
        try:
            asked = _as_they_are(job, folder) if job.variant is None else _changed(job, folder)
            if asked is None:
                return {**outcome, "applies": False}
            logs, held_out, mechanism, columns = asked
            several = job.variant is None  # a changed log is compared with the unchanged one, not with others
            explanation = explain(
                logs, held_out=held_out, plant=mechanism, columns=columns, seed=job.seed, agreement=several
            )
            write_explanation(explanation, job.out)
            report = report_mapping(explanation)
            outcome |= {"report": _short(report), "seconds": round(explanation.seconds, 1)}
            others = [str(as_file(Log(**log), job.data, _time(columns), folder)) for log in _reference_logs(job)]
            outcome["ours"] = measured(job.reference, explanation, others or logs, columns)
        except PumaSimError as error:
            outcome["error"] = str(error)
        except Exception:  # anything else is a defect, and is shown as one
            outcome["crash"] = traceback.format_exc()
            outcome["error"] = outcome["crash"].strip().rpartition("\n")[2]
    outcome["megabytes"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    return outcome


def _reference_logs(job: Job) -> list[dict[str, Any]]:
    return [] if job.reference is None else list(job.reference["logs"])


def _time(columns: Mapping[str, str] | None) -> str:
    return (columns or {}).get("time", "time")


def _as_they_are(job: Job, folder: str):
    time = _time(job.columns)
    logs, held_out = (
        [str(as_file(log, job.data, time, folder)) for log in group] for group in (job.logs, job.held_out)
    )
    return logs, held_out, job.mechanism, job.columns


def _changed(job: Job, folder: str):
    """As the variant of a job makes them; None where it does not apply."""
    time = _time(job.columns)
    tables = {
        key: tuple(table_of(log, job.data, time) for log in getattr(job, key)) for key in ("logs", "held_out", "spare")
    }
    mechanism = read_yaml(mechanism_path(job.mechanism))
    own = mechanism if mechanism["kind"] != "arm" else None
    given = VARIANTS[job.variant].change(
        Given(**tables, columns=job.columns, mechanism=own, floor=job.floor, seed=job.seed)
    )
    if given is None:
        return None
    path: str | Path = job.mechanism
    if given.mechanism is not own:
        path = Path(folder) / "mechanism.yaml"
        path.write_text(yaml_text(given.mechanism), encoding="utf-8")
    logs, held_out = ([str(write_table(table, folder)) for table in group] for group in (given.logs, given.held_out))
    return logs, held_out, str(path), given.columns


def _short(report: dict[str, Any]) -> dict[str, Any]:
    short = {key: value for key, value in report.items() if key not in _LEFT_OUT}
    if short["shape"] is not None:
        short["shape"] = {key: short["shape"][key] for key in _SHAPE}
    return short


def in_a_process(job: Job, limit: float) -> dict[str, Any]:
    """The outcome of a job in a process of its own, which has so many seconds."""
    environment = dict(os.environ) | dict.fromkeys(BLAS, "1")  # as `make score` does
    environment |= {} if job.variant is None else VARIANTS[job.variant].environment
    with tempfile.TemporaryDirectory(prefix="rigs-") as folder:
        asked, answer = Path(folder) / "job.json", Path(folder) / "outcome.json"
        asked.write_text(json.dumps(asdict(job)), encoding="utf-8")
        try:
            command = [sys.executable, __file__, str(asked), str(answer)]
            ended = subprocess.run(command, capture_output=True, text=True, timeout=limit, env=environment)
        except subprocess.TimeoutExpired:
            return _failed(f"not finished after {limit:g} s")
        if not answer.exists():
            last = ended.stderr.strip().rpartition("\n")[2]
            return _failed(f"the process ended with {ended.returncode}: {last}", ended.stderr)
        return json.loads(answer.read_text(encoding="utf-8"))


def _failed(error: str, crash: str | None = None) -> dict[str, Any]:
    return {
        "report": None,
        "error": error,
        "crash": crash,
        "applies": True,
        "seconds": None,
        "ours": None,
        "megabytes": None,
    }


def fingerprint() -> str:
    """Digest of all code that an outcome depends on: outcomes of other code are not reused."""
    digest = hashlib.sha256()
    root = Path(puma_sim_core.__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    for name in _CODE:
        digest.update(Path(__file__).with_name(name).read_bytes())
    return digest.hexdigest()[:16]


def main(arguments: list[str]) -> int:
    asked, answer = map(Path, arguments)
    outcome = work(Job.from_mapping(json.loads(asked.read_text(encoding="utf-8"))))
    answer.write_text(json.dumps(outcome), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
