# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Speed of this checkout over that of another revision, measured in one run.

  python benchmarks/against.py REVISION [--rounds N] [--kernels numba,python] [--explain-rounds N] [--logs TEXT]

Each case runs in two processes, one a checkout, that take turns; the ratio is taken within each round. `explain` runs
on logs of 10 s at 1 kHz that this checkout's `examples/make_logs.py` makes, and counts seconds of processors, for which
what else the machine does matters less, and those of the clock, which a user waits. It is a script: the package that it
runs is the one of PYTHONPATH.
"""

from __future__ import annotations

import argparse
import importlib
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
#: effects of each case
CASES = {
    "no effect": (),
    "Coulomb friction": tuple(f"coulomb_friction:joint={j},torque=3" for j in (1, 2, 3)),
    "four kinds of friction": (
        "stribeck_friction:joint=1,torque=3,sliding=4",
        "load_dependent_friction:joint=2,coefficient=0.1",
        "position_dependent_friction:joint=2,torque=2,amplitude=1",
        "presliding_friction:joint=3,torque=3",
    ),
    "joint elasticity": ("joint_elasticity:joint=2,stiffness=20000",),
}
#: logs to explain: mechanism, effects that the model lacks, seed
LOGS = {
    "explain, nothing missing": ("puma560", (), 3),
    "explain, friction": ("puma560", ("asymmetric_coulomb_friction:joint=2,positive=12.6,negative=7.1",), 5),
    "explain, two effects": ("puma560", ("payload:mass=1.5", "coulomb_friction:joint=3,torque=3"), 11),
    "explain, pendulum": ("pendulum", ("coulomb_friction:joint=1,torque=0.03",), 7),
}
#: simulated time of a run by kernel [s]
SECONDS = {"numba": 10.0, "python": 0.2}
PERIOD = 0.01
#: where a name stands, today and in older revisions
PLACES = {
    "load_parameters": ("arm.parameters", "parameters"),
    "Plant": ("plant.plant", "plant"),
    "Simulator": ("simulation.simulator", "simulator"),
    "parse_effect": ("effects.registry", "effects"),
    "explain": ("identify", "loop"),
}


def found(name: str):
    """A name of the package, in the first module that has it."""
    for place in PLACES[name]:
        try:
            return getattr(importlib.import_module(f"puma_sim_core.{place}"), name)
        except (ImportError, AttributeError):
            continue
    raise SystemExit(f"{name} is in none of {PLACES[name]}")


def serve(case: str, seconds: float) -> None:
    """Time one run for each line of input; print its seconds of all processors, those of the clock, and the most memory
    that the process has had [MB]."""
    run = _explanation(case) if case in LOGS else _simulation(case, seconds)
    for _ in sys.stdin:
        processors, clock = time.process_time(), time.perf_counter()
        run()
        took = time.process_time() - processors, time.perf_counter() - clock
        print(*took, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, flush=True)


def _explanation(case: str) -> Callable[[], None]:
    """Explains the log of a case."""
    explain = found("explain")
    return lambda: explain(str(log_of(case)), plant=LOGS[case][0])


def _simulation(case: str, seconds: float) -> Callable[[], None]:
    """Simulates a case."""
    effects = tuple(map(found("parse_effect"), CASES[case]))
    simulator = found("Simulator")(found("Plant")(found("load_parameters")("bejczy"), effects))
    times = np.arange(round(seconds / PERIOD) + 1) * PERIOD
    volts = np.column_stack([6.0 * np.sin(times + j) + (4.0, -12.0, 3.0)[j] for j in range(3)])

    def run() -> None:
        simulator.reset((0.0, -1.0, 0.5))
        simulator.run(times, volts)

    return run


def log_of(case: str) -> Path:
    """The log of a case of `LOGS`, in build/against."""
    return ROOT / "build" / "against" / f"{case.replace(', ', '_').replace(' ', '_')}.csv"


def make_logs() -> None:
    """Write the logs to explain."""
    sys.path[:0] = [str(ROOT), str(ROOT / "examples")]
    examples = importlib.import_module("make_logs")
    examples.PERIOD = 0.001
    log_of("").parent.mkdir(parents=True, exist_ok=True)
    for case, (mechanism, effects, seed) in LOGS.items():
        motion = examples.PENDULUM if mechanism == "pendulum" else examples.ARM
        examples.write(log_of(case), *examples.record(mechanism, effects, seed, **motion))


def checkout(revision: str) -> Path:
    """The files of a revision, in build/against."""
    name = subprocess.check_output(
        ["git", "rev-parse", "--short", f"{revision}^{{commit}}"], cwd=ROOT, text=True
    ).strip()
    folder = ROOT / "build" / "against" / name
    if not folder.exists():
        folder.mkdir(parents=True)
        packed = subprocess.run(["git", "archive", name], cwd=ROOT, check=True, stdout=subprocess.PIPE)
        subprocess.run(["tar", "-x", "-C", str(folder)], input=packed.stdout, check=True)
    return folder


def measured(case: str, kernel: str, folders: tuple[Path, Path], rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of all processors and of the clock (rounds, 2, 2) of this checkout and of the other one, and the most
    memory [MB] (2,) that each has had."""
    sides, megabytes = [], np.zeros(2)
    for folder in folders:
        command = [sys.executable, str(Path(__file__).resolve()), "--serve", case, str(SECONDS[kernel])]
        environment = {**os.environ, "PYTHONPATH": str(folder), "PUMA_SIM_KERNEL": kernel}
        pipe = subprocess.PIPE
        sides.append(subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True, bufsize=1))
    seconds = np.zeros((rounds + 1, 2, 2))
    for n in range(rounds + 1):
        for side in ((0, 1), (1, 0))[n % 2]:
            sides[side].stdin.write("run\n")
            answer = sides[side].stdout.readline()
            if not answer:
                raise SystemExit(f"{case}, {kernel}: the process of {folders[side]} ended")
            *seconds[n, :, side], megabytes[side] = map(float, answer.split())
    for process in sides:
        process.stdin.close()
        process.wait()
    return seconds[1:], megabytes  # the first run compiles


def main() -> None:
    """Print one line a case and kernel."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("revision", nargs="?", default="HEAD", help="commit, tag or branch (default: HEAD)")
    parser.add_argument("--rounds", type=int, default=21, help="runs of each (default: 21; 0: none)")
    parser.add_argument("--kernels", default="numba,python", help="default: numba,python")
    parser.add_argument("--explain-rounds", type=int, default=3, help="explanations of each log (default: 3; 0: none)")
    parser.add_argument("--logs", default="", metavar="TEXT", help="explain logs whose name has this text alone")
    parser.add_argument("--serve", nargs=2, metavar=("CASE", "SECONDS"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve:
        serve(given.serve[0], float(given.serve[1]))
        return
    folders = (ROOT, checkout(given.revision))
    print(
        f"time of this checkout over that of {folders[1].name}, {given.rounds} runs: median (quartiles), ratio of least"
    )
    for kernel in given.kernels.split(",") if given.rounds else ():
        for case in CASES:
            report(case, kernel, *measured(case, kernel, folders, given.rounds))
    if given.explain_rounds:
        make_logs()
        for case in (case for case in LOGS if given.logs in case):
            report(case, "numba", *measured(case, "numba", folders, given.explain_rounds))


def report(case: str, kernel: str, seconds: np.ndarray, megabytes: np.ndarray) -> None:
    """Print the line of a case: a simulation by the clock, an explanation by the processors."""
    counted = seconds[:, 0 if case in LOGS else 1]
    low, middle, high = np.quantile(counted[:, 0] / counted[:, 1], (0.25, 0.5, 0.75))
    least = counted[:, 0].min() / counted[:, 1].min()
    text = f"  {kernel:6}  {case:24}  {middle:.3f} ({low:.3f} to {high:.3f}), {least:.3f}"
    if case in LOGS:
        (ours, theirs), (own, other) = np.median(seconds, axis=0)
        text += f"; {ours:.1f} s of {theirs:.1f} s, {megabytes[0]:.0f} MB of {megabytes[1]:.0f} MB"
        text += f"; by the clock {own / other:.3f}, {own:.1f} s of {other:.1f} s"
    print(text, flush=True)


if __name__ == "__main__":
    main()
