# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One record of a batch: made, explained without its answer, then set beside what was possible."""

from __future__ import annotations

import gc
import hashlib
import resource
import time
import traceback
from pathlib import Path

from blind import generate

from puma_sim_core.errors import PumaSimError
from puma_sim_core.identify import explain
from puma_sim_core.identify.report.json import report_mapping
from score.baselines import baselines
from score.reference import Bench
from score.scoring import LEAST_SIZE, kind_of

#: of a report, what a score does not need
_LEFT_OUT = ("detectability", "next_experiment", "parameters", "notes", "logs", "held_out_logs")


def work(recipe, folder, small: bool = True) -> dict:
    """The outcome of one recipe.

    small : explain records whose effect is too small to be told from retuning as well.

    Returns
    -------
    record, answer; report (without its long tables) or error (text); seconds of `explain`,
    megabytes at most so far; true_structure and baselines with position errors [rad] held out.
    """
    path, answer = generate.make(recipe, folder)
    answer.pop("seconds_to_make")
    outcome = {
        "record": path.stem,
        "answer": answer,
        "report": None,
        "error": None,
        "crash": None,
        "skipped": False,
        "seconds": None,
    }
    try:
        if not small and min((e["size"] for e in answer["effects"]), default=1.0) < LEAST_SIZE:
            return {**outcome, "skipped": True}
        started = time.perf_counter()
        try:
            outcome["report"] = _short(report_mapping(explain(str(path))))
        except PumaSimError as error:
            outcome["error"] = str(error)
        except Exception:  # anything else is a defect, and is shown as one
            outcome["error"] = outcome["crash"] = traceback.format_exc()
        outcome["seconds"] = round(time.perf_counter() - started, 2)
        outcome["megabytes"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        if kind_of(answer) != "fault":
            bench = Bench(path)
            outcome["baselines"] = baselines(bench)
            if answer["effects"] or kind_of(answer) == "nothing":
                outcome["true_structure"] = bench.true_structure(answer)
    finally:
        path.unlink()
        gc.collect()
    return outcome


def seconds_alone(recipe, folder) -> float:
    """Seconds [s] of `explain` on a recipe's record, with nothing beside it."""
    path, _ = generate.make(recipe, folder)
    try:
        started = time.perf_counter()
        explain(str(path))
        return round(time.perf_counter() - started, 2)
    finally:
        path.unlink()


def warm_up() -> None:
    """Compile what is compiled before any record is timed; processes that follow inherit it."""
    explain(str(sorted((Path(generate.__file__).parent / "records").glob("*.csv"))[0]))


def _short(report: dict) -> dict:
    return {key: value for key, value in report.items() if key not in _LEFT_OUT}


def fingerprint() -> str:
    """Digest of all code that an outcome depends on: outcomes of other code are not reused."""
    import blind

    import puma_sim_core

    digest = hashlib.sha256()
    for module in (puma_sim_core, blind):
        root = Path(module.__file__).parent
        for path in sorted(root.rglob("*.py")):
            digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    here = Path(__file__).parent
    for name in ("jobs.py", "reference.py", "baselines.py"):
        digest.update((here / name).read_bytes())
    return digest.hexdigest()[:16]
