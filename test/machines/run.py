# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Simulated logs of other machines than the PUMA 560: makes them, explains them, prints what was right.

  python test/machines/run.py --seed 1000 --count 70
  python test/machines/run.py --only qube_pendulum --count 20

All seeds are of development. An outcome is kept in FOLDER/outcomes.jsonl as soon as it is there, and a run that was
interrupted goes on where it stopped.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before NumPy: one record a process

import argparse
import json
import multiprocessing
import sys
import tempfile
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

if __name__ == "__main__" and not __package__:
    # run as a script: the package is this folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
    __package__ = "machines"

from machines import judging
from machines.records import MACHINES, Record
from puma_sim_core.errors import PumaSimError
from puma_sim_core.identify import explain

_MARKS = (judging.RIGHT, judging.ALIKE, judging.HIDDEN, judging.MISSED, judging.NEEDLESS, judging.ALARM, judging.FAULT)


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1000, metavar="N", help="of the first record (default %(default)s)")
    parser.add_argument("--count", type=int, default=70, metavar="N", help="records (default %(default)s)")
    parser.add_argument("--only", choices=list(MACHINES), help="records of one machine alone")
    parser.add_argument("--processes", type=int, default=2, metavar="N")
    parser.add_argument("--out", default="build/machines", metavar="FOLDER")
    given = parser.parse_args(arguments)
    kept = Path(given.out) / "outcomes.jsonl"
    kept.parent.mkdir(parents=True, exist_ok=True)
    outcomes = _read(kept)
    left = [(seed, given.only) for seed in range(given.seed, given.seed + given.count)]
    left = [key for key in left if key not in outcomes]
    with ProcessPoolExecutor(given.processes, multiprocessing.get_context("fork")) as pool, open(kept, "a") as file:
        for future in as_completed([pool.submit(outcome, *key) for key in left]):
            made = future.result()
            outcomes[made["seed"], made["only"]] = made
            file.write(json.dumps(made) + "\n")
            file.flush()
            print(f"{len(outcomes):4d} {line(made)}", flush=True)
    print("\n" + table([outcomes[key] for key in sorted(outcomes, key=str)]))
    return 0


def outcome(seed: int, only: str | None) -> dict:
    """A record made and explained: its machine, what was there, what was said, its mark, and seconds."""
    record = Record(seed, only)
    row = {"seed": seed, "only": only, "machine": record.name, "kind": record.kind}
    row["true"] = [(e.kind.name, e.joint, {k: float(f"{v:.4g}") for k, v in e.values.items()}) for e in record.effects]
    with tempfile.TemporaryDirectory(prefix="machine-") as folder:
        try:
            path = record.write(Path(folder))
            found = explain(str(path), plant=record.name)
            said, true = ([(n, j) for n, j, *_ in rows] for rows in (_named(found), row["true"]))
            gap = None
            if true and found.model is not None and set(said) != set(true):
                gap = judging.behind(path, record.mechanism, record.theta, record.effects, found)
            mark = judging.judged(said, found.verdict, true, gap)
        except PumaSimError:
            return {
                **row,
                "verdict": None,
                "said": [],
                "mark": "error",
                "behind": None,
                "error": traceback.format_exc(),
            }
    seconds = round(found.seconds, 1)
    said = _named(found)
    return {**row, "verdict": found.verdict, "said": said, "mark": mark, "behind": gap, "seconds": seconds}


def line(row: dict) -> str:
    """One outcome in a line."""
    true, said = (
        ", ".join(_word(name, joint) for name, joint, *_ in row[key]) or "nothing" for key in ("true", "said")
    )
    gap = "" if row["behind"] is None else f" (behind by {row['behind']:.1f} nat)"
    return f"{row['seed']} {row['machine']}: {true} -> {row['verdict']}: {said}: {row['mark']}{gap}"


def table(rows: list[dict]) -> str:
    """How many of each machine have each mark, and those that are not right, in Markdown."""
    marks = [mark for mark in (*_MARKS, "error") if any(row["mark"] == mark for row in rows)]
    out = ["| machine | records | " + " | ".join(marks) + " |", "|" + "---|" * (len(marks) + 2)]
    for name in MACHINES:
        own = [row for row in rows if row["machine"] == name]
        if own:
            count = Counter(row["mark"] for row in own)
            out.append(f"| {name} | {len(own)} | " + " | ".join(str(count[mark]) for mark in marks) + " |")
    fine = (judging.RIGHT, judging.ALIKE, judging.HIDDEN)
    return "\n".join([*out, "", *(line(row) for row in rows if row["mark"] not in fine)])


def _named(found) -> list[tuple]:
    return [(e.name, e.joint, {k: float(f"{v.value:.4g}") for k, v in e.parameters.items()}) for e in found.effects]


def _word(name: str, joint: int | None) -> str:
    return name if joint is None else f"{name}@{joint}"


def _read(path: Path) -> dict:
    """Outcomes in a file, which may end inside a line."""
    found = {}
    for text in path.read_text().splitlines() if path.exists() else ():
        try:
            row = json.loads(text)
        except ValueError:
            continue
        found[row["seed"], row["only"]] = row
    return found


if __name__ == "__main__":
    sys.exit(main())
