# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Find what the model lacks in measured logs: name the effect, add it, compare before and after.

A log is a CSV with columns time, voltage1..n, position1..n [s, V, rad or m], which may have
velocity*, current*, setpoint* and enable (0: drive off); or a bag of sim_node. Several logs are
explained together.

  puma-sim explain run.csv --out report
  puma-sim explain first.csv second.csv --held-out third.csv --out report
  puma-sim explain rig.csv --plant pendulum --columns time=t_s,voltage1=motor_V,position1=q_rad \\
      --out report
  puma-sim explain later.csv --model report/model.yaml --out report2
  puma-sim explain run.csv --dry-run

The folder gets report.json (config/explain_report.schema.json describes it), report.html for a
person, and model.yaml, the model with what was found in it, which simulate, sim_node and explain
take. The exit status is 0 for every verdict, DATA_FAULT among them: the log was read, and the
report says what is wrong with it; a DATA_FAULT has no model.yaml. It is 2 where there is nothing
to report on, such as a file that cannot be read.
"""

import argparse
import os
import re

from puma_sim_core.cli.arguments import Command, add_mechanism_arguments, whole_number
from puma_sim_core.cli.output import Progress, announce_compilation
from puma_sim_core.errors import ParameterError

_COLUMN = re.compile(r"time|enable|(voltage|position|velocity|current|setpoint)[1-9][0-9]*")


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
        "--dry-run",
        action="store_true",
        help="print what is read, what is left out, and which effects can show; no --out",
    )
    parser.add_argument(
        "--out", metavar="DIR", help="folder for report.json, report.html and model.yaml; made if it does not exist"
    )
    parser.add_argument(
        "--columns",
        metavar="OURS=THEIRS,...",
        action="append",
        default=[],
        help="names of a CSV's columns, such as time=t_s,voltage1=motor_V,position1=q_rad; may stand more than once",
    )
    add_mechanism_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Explain, write, and print the verdict and the paths; raises the errors of the package."""
    seed = whole_number(options.seed, "--seed", 0)
    columns = _columns(options.columns)
    _check_logs(options.logs, options.held_out)
    if options.dry_run:
        return _dry_run(options, columns)
    if options.out is None:
        raise ParameterError("no --out", where="explain", expected="--out DIR, or --dry-run to look at the logs first")

    from puma_sim_core.identify.report.output import check_folder, write_explanation

    inputs = [*options.logs, *options.held_out, options.plant, options.parameters, options.model]
    check_folder(options.out, [path for path in inputs if path is not None])
    from puma_sim_core.identify import explain

    announce_compilation()
    with Progress() as shown:
        explanation = explain(
            options.logs,
            held_out=options.held_out,
            plant=options.plant,
            parameters=options.parameters,
            model=options.model,
            columns=columns,
            seed=seed,
            strict=options.strict,
            progress=shown,
        )
        paths = write_explanation(explanation, options.out)
    print(explanation.sentence)
    for path in paths:
        print(path)
    return 0


def _dry_run(options: argparse.Namespace, columns: dict[str, str] | None) -> int:
    """Print what the logs hold."""
    from puma_sim_core.identify.data.ingest import read_log
    from puma_sim_core.identify.overview import overview
    from puma_sim_core.plant.mechanism_file import load_mechanism

    mechanism = load_mechanism(options.plant, parameters=options.parameters, model=options.model)
    for path in (*options.logs, *options.held_out):
        found = overview(read_log(path, columns, mechanism.joints), mechanism)
        print("\n".join(found.lines(mechanism.position_unit)))
    return 0


def _columns(texts: list[str]) -> dict[str, str] | None:
    """Our names to the file's; None without any; raises ParameterError."""
    found: dict[str, str] = {}
    for item in (part for text in texts for part in text.split(",")):
        ours, equals, theirs = (part.strip() for part in item.partition("="))
        if not (ours and equals and theirs):
            raise ParameterError(f"'{item}'", where="--columns", expected="OURS=THEIRS, such as time=t_s")
        if not _COLUMN.fullmatch(ours):
            expected = "time, enable, voltage1, position1, velocity1, current1, setpoint1, voltage2 and so on"
            raise ParameterError(f"unknown column '{ours}'", where="--columns", expected=expected)
        if ours in found:
            raise ParameterError(f"'{ours}' is given twice", where="--columns", expected="each once")
        if theirs in found.values():
            what = f"'{theirs}' is given for two columns"
            raise ParameterError(what, where="--columns", expected="a column of the file for one of ours")
        found[ours] = theirs
    return found or None


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
