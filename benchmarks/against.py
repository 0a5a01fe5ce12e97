# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Speed of this checkout over that of another revision, measured in one run.

  python benchmarks/against.py REVISION [--rounds N] [--kernels numba,python]

Each case runs in two processes, one a checkout, that take turns; the ratio is taken within each round. It is a script:
the package that it runs is the one of PYTHONPATH.
"""

from __future__ import annotations

import argparse
import importlib
import os
import subprocess
import sys
import time
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
#: simulated time of a run by kernel [s]
SECONDS = {"numba": 10.0, "python": 0.2}
PERIOD = 0.01
#: where a name stands, today and in older revisions
PLACES = {
    "load_parameters": ("arm.parameters", "parameters"),
    "Plant": ("plant.plant", "plant"),
    "Simulator": ("simulation.simulator", "simulator"),
    "parse_effect": ("effects.registry", "effects"),
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
    """Time one run for each line of input; print the seconds."""
    effects = tuple(map(found("parse_effect"), CASES[case]))
    simulator = found("Simulator")(found("Plant")(found("load_parameters")("bejczy"), effects))
    times = np.arange(round(seconds / PERIOD) + 1) * PERIOD
    volts = np.column_stack([6.0 * np.sin(times + j) + (4.0, -12.0, 3.0)[j] for j in range(3)])
    for _ in sys.stdin:
        simulator.reset((0.0, -1.0, 0.5))
        start = time.perf_counter()
        simulator.run(times, volts)
        print(time.perf_counter() - start, flush=True)


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


def ratios(case: str, kernel: str, folders: tuple[Path, Path], rounds: int) -> np.ndarray:
    """Seconds (rounds, 2) of this checkout and of the other one."""
    sides = []
    for folder in folders:
        command = [sys.executable, str(Path(__file__).resolve()), "--serve", case, str(SECONDS[kernel])]
        environment = {**os.environ, "PYTHONPATH": str(folder), "PUMA_SIM_KERNEL": kernel}
        pipe = subprocess.PIPE
        sides.append(subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True, bufsize=1))
    seconds = np.zeros((rounds + 1, 2))
    for n in range(rounds + 1):
        for side in ((0, 1), (1, 0))[n % 2]:
            sides[side].stdin.write("run\n")
            answer = sides[side].stdout.readline()
            if not answer:
                raise SystemExit(f"{case}, {kernel}: the process of {folders[side]} ended")
            seconds[n, side] = float(answer)
    for process in sides:
        process.stdin.close()
        process.wait()
    return seconds[1:]  # the first run compiles


def main() -> None:
    """Print one line a case and kernel."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("revision", nargs="?", default="HEAD", help="commit, tag or branch (default: HEAD)")
    parser.add_argument("--rounds", type=int, default=21, help="runs of each (default: 21)")
    parser.add_argument("--kernels", default="numba,python", help="default: numba,python")
    parser.add_argument("--serve", nargs=2, metavar=("CASE", "SECONDS"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve:
        serve(given.serve[0], float(given.serve[1]))
        return
    folders = (ROOT, checkout(given.revision))
    print(
        f"time of this checkout over that of {folders[1].name}, {given.rounds} runs: median (quartiles), ratio of least"
    )
    for kernel in given.kernels.split(","):
        for case in CASES:
            seconds = ratios(case, kernel, folders, given.rounds)
            low, middle, high = np.quantile(seconds[:, 0] / seconds[:, 1], (0.25, 0.5, 0.75))
            least = seconds[:, 0].min() / seconds[:, 1].min()
            print(f"  {kernel:6}  {case:24}  {middle:.3f} ({low:.3f} to {high:.3f}), {least:.3f}", flush=True)


if __name__ == "__main__":
    main()
