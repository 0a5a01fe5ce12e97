# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks``: one table, measured in one run."""

from __future__ import annotations

import argparse
import importlib
import json
import platform
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib import metadata
from pathlib import Path

import numpy as np

from benchmarks import c_reference, mujoco_peer, own, table, topics, trials
from benchmarks.measure import first_calls, measured, quiet, terminal_progress
from benchmarks.task import Row, Task, Unavailable
from puma_sim_core import __version__
from puma_sim_core.jit import BACKEND

PEERS = ("mujoco", "pinocchio", "roboticstoolbox", "casadi")
ROUNDS, QUICK_ROUNDS = 11, 3
SECONDS, QUICK_SECONDS = 10.0, 2.0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Speed of the simulator beside other libraries doing the same: 10 s of the "
        "three-joint arm with its motors, RK4 in steps of 1 ms. Measured in one run; "
        "ratios are taken within each round and their median and quartiles printed.",
    )
    p.add_argument(
        "--peers",
        metavar="A,B",
        default=",".join(PEERS),
        help=f"which of {', '.join(PEERS)} (default: all; '' for none)",
    )
    p.add_argument(
        "--quick", action="store_true", help=f"{QUICK_ROUNDS} rounds of {QUICK_SECONDS:g} s: a look, not a measurement"
    )
    p.add_argument("--rounds", type=int, default=None, metavar="N", help=f"rounds to measure (default {ROUNDS})")
    p.add_argument("--json", type=Path, default=None, metavar="FILE", help="write the numbers too")
    return p


class Bench:
    """The rows that can be measured here, with the final positions of their first call."""

    def __init__(self, task: Task, progress: Callable[[str], None] = quiet):
        self.task, self.progress = task, progress
        self.rows: list[Row] = []
        self.positions: list[np.ndarray] = []
        self.versions: dict[str, str] = {}
        #: why something is not measured, by its name
        self.missing: dict[str, str] = {}

    def add(self, name: str, make: Callable[[Task], list[Row]], packages: Sequence[str] = ()):
        """Rows of a peer with its packages; one that is absent or broken is noted and left out."""
        absent = [package for package in packages if not installed(package)]
        if absent:
            self.missing[name] = f"not installed (pip install {' '.join(absent)})"
            return
        try:
            rows = make(self.task)
            positions = first_calls(rows, self.progress)
        except Unavailable as reason:
            self.missing[name] = str(reason)
        except Exception as error:  # whatever a library of someone else may raise
            if not packages:
                raise
            first = (str(error).strip().splitlines() or [""])[0]
            self.missing[name] = f"failed with {type(error).__name__}: {first}"
        else:
            self.rows += rows
            self.positions += positions
            names = [package.partition(">=")[0] for package in packages]
            self.versions.update({name: metadata.version(name) for name in names})

    def differences(self) -> list[float | None]:
        """Greatest distance [rad] of each row's final positions from ours."""
        ends = {}
        found = []
        for row, position in zip(self.rows, self.positions):
            if not row.compared or row is self.rows[0]:
                found.append(None)
                continue
            if row.motion not in ends:
                ends[row.motion] = own.simulation(self.task.shortened(row.motion))()
            found.append(float(np.abs(position - ends[row.motion]).max()))
        return found


def installed(package: str) -> bool:
    """Whether a distribution is there, such as "numba", or "pin>=3" of its release 3 and above."""
    name, _, least = package.partition(">=")
    try:
        found = metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return not least or int(found.partition(".")[0]) >= int(least)


def targets(bench: Bench, times: np.ndarray, imports: dict[str, list[float]]) -> list[table.Target]:
    """What the simulator is to reach, with what was measured."""
    cost = {row.label: times[:, k] / row.seconds for k, row in enumerate(bench.rows)}

    def over(*labels: str) -> table.Spread | None:
        """Of the first label's cost by the second's, times the fourth's by the third's."""
        if any(label not in cost for label in labels):
            return None
        ratio = cost[labels[0]] / cost[labels[1]]
        if labels[2:]:
            ratio = ratio * cost[labels[3]] / cost[labels[2]]
        return table.Spread.of(ratio)

    def real_time(label: str) -> table.Spread | None:
        """Simulated time over elapsed time."""
        return table.Spread.of(1.0 / cost[label]) if label in cost else None

    cores = own.core_count()
    Target = table.Target
    return [
        Target("one compiled call / C -O3", over(own.ONE_CALL, c_reference.LABEL), True, 1.3),
        Target("Simulator.run / C -O3", over(own.COMPILED, c_reference.LABEL), True, 1.3),
        Target("MuJoCo rollout / one compiled call", over(mujoco_peer.ROLLOUT, own.ONE_CALL), False, 40.0),
        Target("plain Python / MuJoCo mj_step loop", over(own.PLAIN, mujoco_peer.STEP_LOOP), True, 1.5),
        Target("effects off: compiled / compiled without them", over(own.ONE_CALL, own.WITHOUT_STAGES), True, 1.05),
        Target("all friction effects on / off", over(own.ALL_FRICTION, own.COMPILED), True, 2.0),
        Target("all friction but the bristle / off", over(own.ALL_DRY, own.COMPILED), True, 2.0),
        Target("batch on one core: throughput / Simulator.run", over(own.COMPILED, own.BATCH_ONE), False, 2.5),
        Target(
            f"batch on {cores} cores: throughput / one core",
            over(own.FITTING_ONE, own.FITTING_ALL),
            False,
            round(0.85 * cores, 2),
        ),
        Target(
            f"gain of {cores} cores: batch / C",
            over(own.FITTING_ONE, own.FITTING_ALL, c_reference.LABEL, c_reference.LABEL_ALL_CORES),
            False,
            0.85,
        ),
        Target("appraisal, PID in the kernel: times real time", real_time(trials.COMPILED), False, 1500.0),
        Target("appraisal, PID as an object: times real time", real_time(trials.OBJECT), False, 150.0),
        Target("appraisal, scheduled PID as an object: times real time", real_time(trials.SCHEDULED), False, 150.0),
        Target("appraisal, computed torque as an object: times real time", real_time(trials.TORQUE), False, 150.0),
        Target("appraisal over topics: times real time", real_time(topics.LABEL), False, 20.0),
        *(
            Target(f"import {module} without numba", table.Spread.of(seconds), True, 0.3, " s")
            for module, seconds in imports.items()
        ),
    ]


def conditions(task: Task, rounds: int, versions: dict[str, str]) -> dict:
    """What the numbers depend on."""
    packages = {name: metadata.version(name) for name in ("numpy", "numba") if installed(name)}
    return {
        "task": f"{task.seconds:g} s of the arm '{task.plant.arm.name}', no friction, smooth "
        "voltages, each held for 1 ms, RK4 in steps of 1 ms",
        "rounds": rounds,
        "kernel": BACKEND,
        "cores": own.core_count(),
        "cpu": _cpu(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "c_compiler": _compiler_version(),
        "versions": {"puma_sim": __version__, **packages, **versions},
    }


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"


def _compiler_version() -> str:
    cc = c_reference.compiler()
    if cc is None:
        return "none"
    done = subprocess.run([*cc.split(), "--version"], capture_output=True, text=True)
    return (done.stdout.splitlines() or [cc])[0]


def report(bench: Bench, found: Sequence[table.Result], aims: Sequence[table.Target], about: dict) -> str:
    """The whole output."""
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    lines = [
        f"{about['task']}",
        f"{about['rounds']} rounds, all rows in turn in each; {about['cores']} cores, "
        f"{about['cpu']}, {about['system']}",
        f"Python {about['python']}, {versions}; C: {about['c_compiler']}",
        "",
        table.table_text(found, SECONDS),
        "",
        "ratio: time / time of the first row, round by round; arm: distance of the final positions from ours",
        table.same_arm_text(found),
    ]
    lines += [f"{name}: {reason}" for name, reason in bench.missing.items()]
    return "\n".join([*lines, "", table.targets_text(aims)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and write the JSON; 2 for a wrong command line."""
    p = parser()
    options = p.parse_args(arguments)
    names = [name.strip() for name in options.peers.split(",") if name.strip()]
    for name in names:
        if name not in PEERS:
            p.error(f"--peers: unknown peer '{name}'; expected some of {', '.join(PEERS)}")
    if options.rounds is not None and options.rounds < 1:
        p.error(f"--rounds: {options.rounds}; expected 1 or more")
    if options.json is not None and not options.json.absolute().parent.is_dir():
        p.error(f"--json: no folder {options.json.parent}; expected one that is there")
    rounds = options.rounds or (QUICK_ROUNDS if options.quick else ROUNDS)
    task = Task.default(QUICK_SECONDS if options.quick else SECONDS)
    progress = terminal_progress()

    bench = Bench(task, progress)
    with own.helper(task) as child, ExitStack() as others:
        bench.add("puma_sim", lambda task: own.rows(task, child))
        bench.add("puma_sim appraise", trials.rows)
        bench.add("puma_sim over topics", lambda _: others.enter_context(topics.rows()))
        bench.add("C", lambda task: c_reference.rows(task, own.core_count()))
        for name in names:
            peer = importlib.import_module(f"{__package__}.{name}_peer")
            bench.add(name, peer.rows, peer.PACKAGES)
        times = measured(bench.rows, rounds, progress)
    progress("import in fresh processes")
    imports = {module: own.import_seconds(module) for module in ("puma_sim_core", "puma_sim_core.simulation.simulator")}
    progress("")

    found = table.results(bench.rows, times, bench.differences(), SECONDS)
    aims = targets(bench, times, imports)
    about = conditions(task, rounds, bench.versions)
    print(report(bench, found, aims, about))
    if options.json is not None:
        options.json.write_text(
            json.dumps(table.as_json(found, aims, bench.missing, about), indent=1) + "\n", encoding="utf-8"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
