# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Find what the model lacks in measured logs: name the effect, add it, compare before and after.

A log is a CSV with columns time, voltage1..n, position1..n [s, V, rad or m], which may have
velocity*, current*, setpoint* and enable (0: drive off); or a bag of sim_node. Several logs are
explained together, and then one by one: the report compares the answers (--no-agreement leaves it out).

  puma-sim explain log.csv --out report
  puma-sim explain first.csv second.csv --held-out third.csv --out report
  puma-sim explain rig.csv --plant pendulum --columns time=t_s,voltage1=motor_V,position1=q_rad \\
      --out report
  puma-sim explain later.csv --model report/model.yaml --out report2
  puma-sim explain log.csv --dry-run

The folder gets report.json (config/explain_report.schema.json describes it), report.html for a
person, and model.yaml, the model with what was found in it, which simulate, sim_node and explain
take. The exit status is 0 for every verdict but DATA_FAULT, for which it is 3: the log was read, and
the report says what is wrong with it; there is no model.yaml. It is 2 where there is nothing to
report on, such as a file that cannot be read.
"""

import argparse
import os
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext

from puma_sim_core.cli.arguments import (
    Command,
    add_columns_argument,
    add_mechanism_arguments,
    column_names,
    whole_number,
)
from puma_sim_core.cli.output import Progress, add_force_argument, check_input, start_at_once
from puma_sim_core.errors import ParameterError

#: exit status of a log that was read and cannot be used
_FAULTY = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("logs", metavar="LOG", nargs="+", help="CSV or bag to explain")
    parser.add_argument(
        "--held-out",
        metavar="LOG",
        nargs="+",
        action="extend",
        default=[],
        help="logs outside the analysis, which errors are measured on as well",
    )
    parser.add_argument(
        "--strict", action="store_true", help="refuse a log with rows that cannot be used; default: leave them out"
    )
    parser.add_argument(
        "--agreement",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="explain several logs one by one as well, on the cores that are left, and compare the answers; on one core"
        " about doubles the time",
    )
    parser.add_argument(
        "--dry-run",
        action="store_true",
        help="print what is read, what is left out, and which effects can show; no --out",
    )
    parser.add_argument(
        "--out", metavar="DIR", help="folder for report.json, report.html and model.yaml; made if it does not exist"
    )
    add_force_argument(parser)
    parser.add_argument("--json", action="store_true", help="print report.json in place of the sentences; no --out")
    add_columns_argument(parser)
    add_mechanism_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Explain, write, and print the verdict and the paths; raises the errors of the package."""
    seed = whole_number(options.seed, "--seed", 0)
    columns = column_names(options.columns)
    _check_logs(options.logs, options.held_out)
    if options.dry_run:
        return _dry_run(options, columns)
    if (options.out is None) is not options.json:
        expected = "--out DIR for a report, or --json to print it, or --dry-run to look at the logs first"
        raise ParameterError("--out with --json" if options.json else "no --out", where="explain", expected=expected)

    from puma_sim_core.identify.report.json import report_text
    from puma_sim_core.identify.report.output import check_folder, write_explanation
    from puma_sim_core.identify.result import DATA_FAULT

    if not options.json:
        inputs = [*options.logs, *options.held_out, options.plant, options.parameters, options.model]
        check_folder(options.out, [path for path in inputs if path is not None], force=options.force)
    for path in (*options.logs, *options.held_out):
        check_input(path)
    from puma_sim_core.identify import explain

    start_at_once(patient=True)
    with Progress() as shown, _one_by_one(options) as agreement:
        explanation = explain(
            options.logs,
            held_out=options.held_out,
            plant=options.plant,
            parameters=options.parameters,
            model=options.model,
            columns=columns,
            seed=seed,
            strict=options.strict,
            agreement=agreement,
            progress=shown,
        )
        paths = [] if options.json else write_explanation(explanation, options.out)
    if options.json:
        print(report_text(explanation), end="")
    else:
        print(explanation.sentence)
        if explanation.agreement is not None:
            print(explanation.agreement.sentence)
    for path in paths:
        print(path)
    return _FAULTY if explanation.verdict == DATA_FAULT else 0


def _one_by_one(options: argparse.Namespace) -> AbstractContextManager[Executor | bool]:
    """Whether logs are explained one by one as well, or the processes for it, on the cores that all together leave."""
    from puma_sim_core.executors import open_executor, threads

    count = min(len(options.logs), threads() - 1)
    if options.agreement and len(options.logs) > 1 and count > 0:
        return open_executor(count)
    return nullcontext(options.agreement)


def _dry_run(options: argparse.Namespace, columns: dict[str, str] | None) -> int:
    """Print what the logs hold."""
    from puma_sim_core.identify.data.machine_log import read_for, with_volts
    from puma_sim_core.identify.overview import overview
    from puma_sim_core.plant.mechanism_file import load_mechanism

    mechanism = load_mechanism(options.plant, parameters=options.parameters, model=options.model)
    for path in (*options.logs, *options.held_out):
        found = overview(with_volts(read_for(mechanism, path, columns), mechanism), mechanism)
        print("\n".join(found.lines(mechanism.position_unit)))
    return 0


def _check_logs(logs: list[str], held_out: list[str]) -> None:
    """Refuse a log that stands twice: it would count twice, or not be held out."""
    seen: dict[str, str] = {}
    for role, paths in (("LOG", logs), ("--held-out", held_out)):
        for path in paths:
            real = os.path.realpath(path)
            if real in seen:
                what = "stands twice" if seen[real] == role else "is to be fitted and held out"
                raise ParameterError(what, where=path, expected="each log once")
            seen[real] = role


COMMAND = Command(
    "explain", "find the physical effect that the model lacks in a measured log", __doc__, add_arguments, run
)
