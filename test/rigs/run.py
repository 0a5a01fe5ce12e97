# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The bench of real machines: explains measured logs, compares with the expected answers, writes one page.

  python test/rigs/run.py --out build/rigs                       all machines; logs from PUMA_SIM_DATA
  python test/rigs/run.py --out build/rigs --only xl330,emps --no-invariances
  python test/rigs/run.py --out build/rigs --quick               the first run of each machine alone
  python test/rigs/run.py --out build/rigs --role development    no run with a test log
  python test/rigs/run.py --out build/rigs --invariances time_shifted,mirrored

Each explanation is a process of its own. Its outcome is kept in OUT/outcomes.jsonl as soon as it is there, so that a
bench that was interrupted goes on where it stopped, as long as the code, the mechanism and the logs are the same. The
page has all machines; what has no outcome yet says so.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

if __name__ == "__main__" and not __package__:
    # run as a script: the package is this folder, and puma_sim_core that of the checkout
    sys.path[0:1] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parents[2])]
    __package__ = "rigs"

from puma_sim_core.errors import PumaSimError
from rigs import catalogue, table
from rigs.catalogue import Rig, Run
from rigs.jobs import Job, fingerprint, in_a_process
from rigs.variants import VARIANTS

VARIABLE = "PUMA_SIM_DATA"
#: where the table stands in a page of the documentation
MARKERS = ("<!-- table of `make rigs` -->", "<!-- end of the table -->")

Outcomes = dict[tuple[str, str | None], dict[str, Any]]


def main(arguments: list[str] | None = None) -> int:
    given = _parser().parse_args(arguments)
    try:
        rigs = catalogue.read_rigs(given.rigs)
        chosen = {rig.name for rig in catalogue.chosen(rigs, _words(given.only))}
        selection = _selection(given)
        data = _data_folder(given.data)
        runs = [(rigs[name], run) for name in rigs if name in chosen for run in _asked(rigs[name], given)]
        if given.run and not runs:
            names = ", ".join(run.key for name in rigs if name in chosen for run in rigs[name].runs)
            raise UsageError(f"no run with '{given.run}'; expected a part of one of {names}")
    except (PumaSimError, UsageError) as error:
        print(f"rigs: {error}", file=sys.stderr)
        return 2
    except KeyError as error:
        print(f"rigs: no machine {error}; expected some of {', '.join(rigs)}", file=sys.stderr)
        return 2
    Path(given.out).mkdir(parents=True, exist_ok=True)
    bench = Bench(rigs, data, Path(given.out), given.jobs, given.limit)
    bench.explain([Job.of(rig, run, data, given.out) for rig, run in runs])
    bench.explain(
        [
            Job.of(rig, run, data, given.out, variant, bench.floor(run))
            for rig, run in runs
            for variant in selection
            if (run.variants or given.invariances == "all") and bench.answered(run)
        ]
    )
    rows = bench.rows()
    for name, text in (
        ("rigs.json", table.json_of(rows, bench.code)),
        ("rigs.html", table.page_of(list(rigs.values()), rows, bench.code)),
        ("rigs.md", table.markdown_of(list(rigs.values()), rows)),
    ):
        (bench.out / name).write_text(text, encoding="utf-8")
        print(bench.out / name)
    if given.docs:
        put_table(Path(given.docs), (bench.out / "rigs.md").read_text(encoding="utf-8"))
    for role, counts in table.summary(rows).items():
        print(f"{role}: " + ", ".join(f"{count} {mark}" for mark, count in counts.items()))
    return 0


class UsageError(ValueError):
    """Options that do not go together, or a folder that is not there."""


class Bench:
    """Outcomes of one state of the code in a folder.

    jobs : explanations at the same time; limit : seconds that one may take.
    """

    def __init__(self, rigs: Mapping[str, Rig], data: Path, out: Path, jobs: int = 1, limit: float = 1800.0):
        self.rigs, self.data, self.out, self.jobs, self.limit = rigs, data, out, jobs, limit
        self.code = fingerprint()
        self.outcomes: Outcomes = {}
        self._kept = kept_outcomes(out / "outcomes.jsonl", self.code)
        self._durations: list[float] = []
        for rig in rigs.values():
            for run in rig.runs:
                if run.needs is None:
                    self._take_kept(rig, run)

    def _take_kept(self, rig: Rig, run: Run) -> None:
        """The outcomes of a run and its variants that are there already."""
        for variant in (None, *VARIANTS):
            if variant is None or self.answered(run):
                job = Job.of(rig, run, self.data, self.out, variant, None if variant is None else self.floor(run))
                if job.key() in self._kept:
                    self.outcomes[run.key, variant] = self._kept[job.key()]

    def answered(self, run: Run) -> bool:
        """Whether there is a report of a run."""
        return self.outcomes.get((run.key, None), {}).get("report") is not None

    def floor(self, run: Run) -> tuple[float, ...] | None:
        """Floor (J,) of the voltage [V] of a run, None without one."""
        held = self.outcomes[run.key, None]["report"]["errors"]["held_out"] if self.answered(run) else None
        values = () if held is None else held["voltage_rms"]["floor"]
        return None if not values or None in values else tuple(values)

    def explain(self, jobs: list[Job]) -> None:
        """The outcomes of jobs, of which those that are there already are not explained again."""
        left = [job for job in jobs if (job.run, job.variant) not in self.outcomes]
        if not jobs:
            return
        what = "changed logs" if jobs[0].variant else "runs"
        print(f"{len(jobs)} {what}, {len(jobs) - len(left)} of them explained before", flush=True)
        with open(self.out / "outcomes.jsonl", "a", encoding="utf-8") as kept:
            kept.write("\n")  # the line before may have been cut short
            for number, (job, outcome) in enumerate(self._outcomes(left), 1):
                entry = {"code": self.code, "key": job.key(), "name": job.name, "outcome": outcome}
                kept.write(json.dumps(entry) + "\n")
                kept.flush()
                self.outcomes[job.run, job.variant] = outcome
                print(f"{number:4d}/{len(left)} {self._said(job, outcome)}", flush=True)

    def _outcomes(self, jobs: list[Job]) -> Iterator[tuple[Job, dict[str, Any]]]:
        """(job, outcome) as they come, with a line for each that is begun."""
        waiting, running = list(jobs), {}
        with ThreadPoolExecutor(self.jobs) as pool:
            while waiting or running:
                while waiting and len(running) < self.jobs:
                    job = waiting.pop(0)
                    print(f"          explaining {job.name}; {self._time_left(len(waiting) + 1)}", flush=True)
                    future: Future = pool.submit(in_a_process, job, self.limit)
                    running[future] = job, time.perf_counter()
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job, begin = running.pop(future)
                    self._durations.append(time.perf_counter() - begin)
                    yield job, future.result()

    def _time_left(self, count: int) -> str:
        if not self._durations:
            return f"{count} left"
        seconds = count * sum(self._durations) / len(self._durations) / self.jobs
        return (
            f"{count} left, about {seconds / 60.0:.0f} min"
            if seconds > 90.0
            else f"{count} left, about {seconds:.0f} s"
        )

    def _said(self, job: Job, outcome: Mapping[str, Any]) -> str:
        rig = self.rigs[job.run.partition("/")[0]]
        run = next(run for run in rig.runs if run.key == job.run)
        if job.variant is None:
            return table.line(table.row_of(rig, run, outcome, {}))
        if not outcome["applies"]:
            return f"{job.name}: does not apply"
        flips = table.row_of(rig, run, self.outcomes[run.key, None], {job.variant: outcome})["flips"]["flips"]
        return f"{job.name}: {', '.join(flips.get(job.variant, ['the same']))}"

    def rows(self) -> list[dict[str, Any]]:
        """The rows of the table, of all machines."""
        return [
            table.row_of(
                rig,
                run,
                self.outcomes.get((run.key, None)),
                {variant: own for (key, variant), own in self.outcomes.items() if key == run.key and variant},
            )
            for rig in self.rigs.values()
            for run in rig.runs
        ]


def kept_outcomes(path: Path, code: str) -> dict[str, dict[str, Any]]:
    """Outcomes of the same code in a file, which may end inside a line; not those of processes that ended early."""
    found: dict[str, dict[str, Any]] = {}
    if not path.exists():
        return found
    for text in path.read_text(encoding="utf-8").splitlines():
        try:
            entry = json.loads(text)
        except ValueError:
            continue
        if entry["code"] == code and entry["outcome"].get("megabytes", 0) is not None:
            found[entry["key"]] = entry["outcome"]
    return found


def put_table(page: Path, text: str) -> None:
    """Replace what stands between the markers of a page of the documentation."""
    before, begin, rest = page.read_text(encoding="utf-8").partition(MARKERS[0])
    _, end, after = rest.partition(MARKERS[1])
    if not (begin and end):
        raise UsageError(f"{page}: no markers {MARKERS[0]} and {MARKERS[1]}")
    page.write_text(f"{before}{begin}\n\n{text}\n{end}{after}", encoding="utf-8")


def _asked(rig: Rig, given: argparse.Namespace) -> list[Run]:
    """The runs of a machine that can be described and are asked for."""
    roles = catalogue.ROLES if given.role is None else (given.role,)
    named = [run for run in rig.runs if given.run in run.key or given.run in f"{rig.name}/{run.name}"]
    runs = [run for run in named if run.needs is None and run.role in roles]
    return runs[:1] if given.quick else runs


def _selection(given: argparse.Namespace) -> list[str]:
    """The names of the variants to apply."""
    if given.quick or given.invariances == "none":
        return []
    if given.invariances in ("listed", "all"):
        return list(VARIANTS)
    names = _words([given.invariances])
    for name in names:
        if name not in VARIANTS:
            raise UsageError(f"no invariance '{name}'; expected listed, all, none or some of {', '.join(VARIANTS)}")
    return names


def _data_folder(given: str | None) -> Path:
    folder = given or os.environ.get(VARIABLE)
    if not folder:
        raise UsageError(f"{VARIABLE} is not set; expected the folder with the measured logs")
    if not Path(folder).is_dir():
        raise UsageError(f"{folder} is no folder; expected the folder with the measured logs ({VARIABLE})")
    return Path(folder)


def _words(texts: list[str]) -> list[str]:
    return [word for text in texts for word in text.replace(",", " ").split()]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="build/rigs", metavar="FOLDER")
    parser.add_argument(
        "--only", action="append", default=[], metavar="RIG,...", help="machines to explain (default: all)"
    )
    parser.add_argument(
        "--run", default="", metavar="TEXT", help="runs whose RIG/NAME, in tables or of folders, has this"
    )
    parser.add_argument("--role", choices=catalogue.ROLES, help="runs of this role alone (default: both)")
    parser.add_argument("--quick", action="store_true", help="the first run of each machine, no invariances")
    parser.add_argument(
        "--invariances",
        default="listed",
        metavar="WHICH",
        help="changes that must not change an answer. listed (default): all of them, on the runs that rigs.yaml marks "
        "with variants (a development run of a machine); all: on every run; none; or names, such as "
        "time_shifted,mirrored, on the marked runs. Each costs an explanation",
    )
    parser.add_argument(
        "--no-invariances",
        dest="invariances",
        action="store_const",
        const="none",
        help="the same as --invariances none",
    )
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="explanations at the same time (default 1)")
    parser.add_argument(
        "--limit", type=float, default=1800.0, metavar="S", help="seconds an explanation may take (default %(default)g)"
    )
    parser.add_argument("--data", metavar="FOLDER", help=f"folder of the logs (default: {VARIABLE})")
    parser.add_argument("--docs", metavar="FILE", help="page whose table is replaced, such as docs/rigs_start.md")
    parser.add_argument("--rigs", default=str(catalogue.RIGS), metavar="FILE", help="another list of machines")
    return parser


if __name__ == "__main__":
    sys.exit(main())
