# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Explain many logs, each on its own: a folder with a report for each, and a table of all.

  puma-sim explain-many logs/*.csv --out reports
  puma-sim explain-many logs/*.csv --out reports --jobs 4
  puma-sim explain-many logs/*.csv --out reports --scheduler tcp://host:8786
  puma-sim explain-many logs/*.csv --out reports --shard 2/8; puma-sim merge reports

DIR/NAME has what `puma-sim explain` writes for the log NAME.csv, or error.json; DIR/summary.csv has a line for each
log, and DIR/agreement.csv, of several logs, tells whether they agree. The same command goes on where it stopped. The
bytes do not depend on the number of workers, nor on how the logs are dealt out among shards; so the reports do not say
how long they took.

With --scheduler the jobs go to a Dask cluster whose workers see the logs under the same paths and have the same version
of this program. With --shard i/n, for batch queues, each of n runs of the same command does its part; `puma-sim merge`
makes the table.

The exit status is 0 where each log has a line of its own, with an error or not. It is 1 where a worker process died:
the same command tries those logs again.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from puma_sim_core import __version__
from puma_sim_core.cli.arguments import (
    Command,
    add_columns_argument,
    add_mechanism_arguments,
    add_worker_arguments,
    column_names,
    whole_number,
    workers_of,
)
from puma_sim_core.cli.output import Progress, start_at_once
from puma_sim_core.errors import ParameterError

if TYPE_CHECKING:
    from puma_sim_core.executors import Failure
    from puma_sim_core.result_folder import ResultFolder

COMMAND_NAME = "explain-many"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("logs", metavar="LOG", nargs="+", help="CSV or bag; its name is that of its folder in DIR")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder of the reports; made if it does not exist")
    parser.add_argument("--strict", action="store_true", help="refuse logs with rows that cannot be used")
    add_columns_argument(parser)
    add_mechanism_arguments(parser)
    add_worker_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Explain what is not done yet, write the table, and print how many there are of each verdict."""
    from puma_sim_core.executors import Failure, open_executor, run_jobs
    from puma_sim_core.result_folder import ResultFolder, digest, job_names

    workers = workers_of(options)
    if workers.scheduler is not None and options.effects:
        expected = "PUMA_SIM_EFFECTS in the environment of the cluster's workers"
        raise ParameterError("--effects with --scheduler", where=COMMAND_NAME, expected=expected)
    asked = _asked(options)
    names = job_names(options.logs)
    settings = _settings(asked, digest)
    sources = [{"name": n, "source": path, "sha256": digest(path)} for n, path in zip(names, options.logs)]
    folder = ResultFolder(options.out, {"command": COMMAND_NAME, "settings": settings, "jobs": sources})
    _check_options(asked)
    folder.begin()
    left = [job for job in workers.shard.of(sources) if not folder.is_done(job["name"])]
    died: dict[str, str] = {}
    if left:
        from puma_sim_core.identify.several.many import Job, explained

        jobs = [Job(os.path.abspath(job["source"]), job["source"], asked) for job in left]
        # each job is a process of its own, which would compile by itself
        start_at_once(patient=True).wait()
        with Progress() as shown, open_executor(workers.jobs, workers.scheduler) as executor:
            done = 0

            def wrote(index: int, result: dict[str, str] | Failure) -> None:
                nonlocal done
                done += 1
                name = left[index]["name"]
                if isinstance(result, Failure):
                    result = replace(result, reason=result.reason.replace(jobs[index].path, jobs[index].name))
                    if result.died:
                        died[name] = result.reason
                folder.write(name, result)

            def show() -> None:
                shown(f"{done} of {len(left)} logs", done / len(left))

            for _ in run_jobs(explained, jobs, executor, wrote, show):
                pass
    return _finish(folder, died)


def _finish(folder: ResultFolder, died: dict[str, str]) -> int:
    waiting = [name for name in folder.names if not folder.is_done(name) and name not in died]
    if waiting:
        print(
            f"{len(waiting)} of {len(folder.names)} logs are left to other shards; then: puma-sim merge {folder.path}"
        )
        return 1 if died else 0
    print_table(folder, died)
    return 1 if died else 0


def print_table(folder: ResultFolder, died: dict[str, str] | None = None) -> None:
    """Write the tables, and print their paths and how many logs have each verdict; errors to standard error."""
    from collections import Counter

    from puma_sim_core.identify.several.many import AGREEMENT, COLUMNS, compared, summary

    rows = [dict(zip(COLUMNS, row)) for row in summary(folder, died)]
    path = folder.write_summary(COLUMNS, [list(row.values()) for row in rows])
    for row in rows:
        if row["error"]:
            print(f"puma-sim: {row['log']}: {row['error']}", file=sys.stderr)
    counts = Counter(row["verdict"] or "with an error" for row in rows)
    print(f"{len(rows)} logs: " + ", ".join(f"{count} {what}" for what, count in sorted(counts.items())))
    found = compared(folder)
    if found is not None:
        print(found[0])
        print(folder.write_summary(AGREEMENT, found[1], "agreement.csv"))
    print(path)


def _asked(options: argparse.Namespace) -> dict[str, Any]:
    """The options of `explain`, with paths that a worker elsewhere can open."""
    found: dict[str, Any] = {"seed": whole_number(options.seed, "--seed", 0), "strict": options.strict}
    found["columns"] = column_names(options.columns)
    for name in ("plant", "parameters", "model"):
        given = getattr(options, name)
        found[name] = os.path.abspath(given) if given is not None and Path(given).is_file() else given
    return found


def _check_options(asked: dict[str, Any]) -> None:
    """Refuse a mechanism, set or model that cannot be used, before any work."""
    from puma_sim_core.plant.mechanism_file import load_mechanism

    load_mechanism(asked["plant"], parameters=asked["parameters"], model=asked["model"])


def _settings(asked: dict[str, Any], digest: Any) -> dict[str, Any]:
    """What the results depend on beside the logs."""
    from puma_sim_core.effects.registry import VARIABLE

    found = {"version": __version__, **{name: value for name, value in asked.items() if value is not None}}
    for name in ("plant", "parameters", "model"):
        if asked[name] is not None and os.path.isfile(asked[name]):
            found[f"contents of {name}"] = digest(asked[name])
    for path in filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)):
        found[f"effect {os.path.basename(path)}"] = digest(path)
    return found


COMMAND = Command(
    COMMAND_NAME, "explain many logs, each on its own, on many cores or a cluster", __doc__, add_arguments, run
)
