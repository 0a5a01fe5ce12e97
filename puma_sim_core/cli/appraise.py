# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Appraise controllers on a battery of tasks and missing effects.

A controller is a name of `puma-sim appraise list`, or module:Class of your own: a class that is
made without arguments, with period [s], reset() and update(t, setpoint, measurement) -> 3 volts.
All controllers meet the same arms and disturbances. The same command resumes a battery that was
interrupted, and gives the same bytes on any number of processes.

  puma-sim appraise list
  puma-sim appraise pid computed_torque --out board --profile quick
  puma-sim appraise my_controller:Mine pid --out board
  puma-sim appraise pid scheduled --model report/model.yaml --out board
  puma-sim appraise pid --out shard1 --shard 1/2    (and 2/2 elsewhere, then)
  puma-sim appraise merge shard1 shard2 --out board

The folder gets report.html for a person, report.json (config/appraisal_report.schema.json describes
it), scoreboard.csv, and bags of failed trials, which `puma-sim replay` checks.
"""

from __future__ import annotations

import argparse

from puma_sim_core.cli.arguments import Command, whole_number
from puma_sim_core.cli.output import Progress, TimeLeft, start_at_once
from puma_sim_core.errors import ParameterError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "names", metavar="CONTROLLER", nargs="+", help="controllers; or `list`; or `merge` and the folders of shards"
    )
    parser.add_argument("--out", metavar="DIR", help="folder for results and report; made, or resumed")
    parser.add_argument("--profile", choices=("quick", "standard", "full"), help="how much is tried (standard)")
    parser.add_argument("--seed", metavar="N", help="whole number from which all that is random follows (0)")
    parser.add_argument("--plant", metavar="NAME|FILE", help="mechanism whose start is the nominal arm (puma560)")
    parser.add_argument("--model", metavar="FILE", help="augmented model, such as `explain` writes, to compare with")
    parser.add_argument("--task", metavar="NAME", action="append", default=[], help="only this task; may be repeated")
    parser.add_argument(
        "--perturbation", metavar="NAME", action="append", default=[], help="only this perturbation; may be repeated"
    )
    parser.add_argument("--no-searches", action="store_true", help="leave out the critical sizes of effects")
    parser.add_argument("--bags", metavar="N|all|none", help="failed trials of each controller that are recorded")
    parser.add_argument("--jobs", metavar="N", help="processes (default: one for each core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler, such as tcp://host:8786")
    parser.add_argument("--shard", metavar="I/N", help="only the I-th of N parts of the trials, to be merged")


def run(options: argparse.Namespace) -> int:
    """Appraise, list or merge; raises the errors of the package."""
    first = options.names[0]
    if first == "list":
        return _list(options)
    if options.out is None:
        raise ParameterError("no --out", where="appraise", expected="--out DIR")
    return _merge(options) if first == "merge" else _appraise(options)


def _refuse(options: argparse.Namespace, command: str, *names: str) -> None:
    """Refuse options that mean nothing with a command."""
    for name in names:
        if getattr(options, name) not in (None, [], False):
            what = f"--{name.replace('_', '-')} with {command}"
            raise ParameterError(what, where="appraise", expected=f"{command} without it")


_RUNNING = ("profile", "seed", "plant", "model", "task", "perturbation", "no_searches", "jobs", "scheduler", "shard")


def _appraise(options: argparse.Namespace) -> int:
    from puma_sim_core.appraisal.appraise import check_controllers, run_battery
    from puma_sim_core.appraisal.battery import Battery
    from puma_sim_core.appraisal.report.output import bag_limit, check_report_folder, write_report
    from puma_sim_core.errors import ModelError
    from puma_sim_core.executors import Shard, open_executor
    from puma_sim_core.files import read_yaml

    for name in ("list", "merge"):
        if name in options.names:
            raise ParameterError(
                f"'{name}' among controllers", where="appraise", expected=f"`appraise {name}` by itself"
            )
    shard = Shard() if options.shard is None else Shard.parse(options.shard)
    if shard.parts > 1:
        _refuse(options, "--shard", "bags")
    jobs = None if options.jobs is None else whole_number(options.jobs, "--jobs", 1)
    battery = Battery(
        controllers=tuple(options.names),
        profile=options.profile or "standard",
        seed=0 if options.seed is None else whole_number(options.seed, "--seed", 0),
        mechanism=options.plant or "puma560",
        model=None if options.model is None else read_yaml(options.model, ModelError),
        tasks=tuple(options.task),
        perturbations=tuple(options.perturbation),
        searches=not options.no_searches,
    )
    bags = bag_limit(options.bags, battery)
    check_controllers(battery)
    check_report_folder(options.out)
    # each trial is run by another process, which would compile by itself
    start_at_once(patient=True, trials=True).wait()
    with Progress() as shown, open_executor(jobs, options.scheduler) as executor:
        results = run_battery(battery, options.out, executor, shard, TimeLeft(shown))
        if shard.parts > 1:
            print(f"{options.out}: shard {shard.part} of {shard.parts}, {len(results)} of {len(battery.units)} units")
            return 0
        shown("report", 1.0)
        return _print(write_report(battery, results, options.out, bags))


def _merge(options: argparse.Namespace) -> int:
    _refuse(options, "merge", *_RUNNING)
    return merge_shards(options.names[1:], options.out, options.bags)


def merge_shards(folders: list[str], out: str, bags: str | None = None) -> int:
    """Merge the folders of shards, and write and print what the command without shards does; raises as it does."""
    from puma_sim_core.appraisal.report.output import bag_limit, check_report_folder, write_report
    from puma_sim_core.appraisal.store import merge

    check_report_folder(out)
    battery, results = merge(folders, out)
    return _print(write_report(battery, results, out, bag_limit(bags, battery)))


def _print(lines: list[str]) -> int:
    print("\n".join(lines))
    return 0


def _list(options: argparse.Namespace) -> int:
    from puma_sim_core.appraisal.listing import listing

    if len(options.names) > 1:
        raise ParameterError(f"'{options.names[1]}' behind list", where="appraise", expected="list by itself")
    _refuse(options, "list", "out", "bags", *(name for name in _RUNNING if name != "plant"))
    print(listing(options.plant or "puma560"))
    return 0


COMMAND = Command(
    "appraise", "appraise controllers on a battery of tasks and missing effects", __doc__, add_arguments, run
)
