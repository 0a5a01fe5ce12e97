# SPDX-License-Identifier: Apache-2.0
"""Our own rows: compiled, plain Python, with effects, in batches; and the time of the import."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from ..backend import BACKEND, compiled
from ..effects import parse_effect
from ..kernel import FREE, STILL, rk4_step
from ..plant import Plant
from ..simulator import Simulator, native
from .task import STEP, Row, Task

SINGLE = f"puma_sim, Simulator.run, {'compiled' if BACKEND == 'numba' else 'plain Python'}"
PLAIN = "puma_sim, Simulator.run, plain Python"
WITHOUT_STAGES = "puma_sim, compiled without any effect in it"
ALL_DRY = "puma_sim, all friction but the bristle"
ALL_FRICTION = "puma_sim, all friction effects"

#: (levels of the kind's parameters for joints 1, 2, 3): of a PUMA's size, where one is known
_FRICTION = {
    "viscous_friction": ("coefficient={}", (5.80,), (9.50,), (3.98,)),
    "coulomb_friction": ("torque={}", (5.0,), (4.0,), (2.0,)),
    "asymmetric_coulomb_friction": ("positive={},negative={}",
                                    (24.7, 27.2), (13.6, 7.65), (7.1, 5.6)),
    "stribeck_friction": ("torque={}", (5.0,), (4.0,), (2.0,)),
    "presliding_friction": ("torque={}", (5.0,), (4.0,), (2.0,)),
}


def friction(*kinds: str):
    """Effects of these kinds on all three joints."""
    return tuple(parse_effect(f"{kind}:joint={joint},{form.format(*values)}")
                 for kind in kinds
                 for form, *levels in [_FRICTION[kind]]
                 for joint, values in enumerate(levels, start=1))


def simulation(task: Task, effects=()):
    """The task as a user writes it; gives the final positions (3,) [rad]."""
    time = STEP * np.arange(task.steps + 1)
    voltages = np.vstack([task.voltages, task.voltages[-1:]])
    position, velocity, current = task.state.reshape(3, 3)
    simulator = Simulator(Plant(task.plant.arm, effects), max_step=STEP)

    def run():
        simulator.reset(position, velocity, current)
        return simulator.run(time, voltages).position[-1]

    return run


def without_stages(task: Task):
    """The run with the kernel compiled for `active` = 0: all that effects could cost is gone."""
    body, drive, _, table = task.plant.constants

    @compiled
    def run_bare(x, z, volts, h, body, drive, p, out):
        for r in range(len(volts)):
            v = (volts[r, 0], volts[r, 1], volts[r, 2])
            for j in range(9):
                out[r, j] = x[j]
            x, z = rk4_step(x, z, v, h, body, drive, 0, p, FREE, STILL)
        return x

    out = np.empty((task.steps + 1, 12))
    state, p = tuple(task.state.tolist()), native(table)
    return lambda: np.array(run_bare(state, STILL, task.voltages, STEP, body, drive, p, out)[:3])


class PlainPython:
    """A second process that runs the task with the interpreted kernel, on demand."""

    def __init__(self, task: Task):
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"{__package__}.child", repr(task.seconds)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=child_environment())

    def measure(self) -> tuple[float, np.ndarray]:
        """(seconds, final positions) of one run; this process waits meanwhile."""
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        elapsed, position = json.loads(self._process.stdout.readline())
        return elapsed, np.array(position)

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


def child_environment() -> dict[str, str]:
    """Environment of a process that has this package and the interpreted kernel."""
    root = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PUMA_SIM_KERNEL": "python", "PYTHONPATH": path}


def rows(task: Task, child: PlainPython | None) -> list[Row]:
    """The single runs, the reference of all ratios first."""
    made = [Row(SINGLE, simulation(task), task.seconds, calls=9, ours=True)]
    if BACKEND != "numba":
        made[0].calls = 1
        return made
    made.append(Row(WITHOUT_STAGES, without_stages(task), task.seconds, calls=9, ours=True,
                    note="the kernel with the stages of the effects taken out by the compiler"))
    if child is not None:
        made.append(Row(PLAIN, run=lambda: None, seconds=task.seconds, ours=True,
                        measure=child.measure, note="in a process of its own, in turn with this"))
    sets = {f"puma_sim, {kind}": (kind,) for kind in _FRICTION}
    sets[ALL_DRY] = tuple(kind for kind in _FRICTION if kind != "presliding_friction")
    sets[ALL_FRICTION] = tuple(_FRICTION)
    for label, kinds in sets.items():
        run = simulation(task, friction(*kinds))
        # friction moves the arm elsewhere: nothing to compare
        made.append(Row(label, lambda run=run: run() and None if False else _nothing(run),
                        task.seconds, calls=5, ours=True))
    return made


def _nothing(run) -> None:
    run()


def import_seconds(repetitions: int = 5, module: str = "puma_sim_core") -> list[float]:
    """Times [s] of the import in fresh processes that have no numba."""
    code = ("import sys; sys.modules['numba'] = None\n"
            "from time import perf_counter\n"
            f"start = perf_counter(); import {module}; print(perf_counter() - start)")
    return [float(subprocess.run([sys.executable, "-c", code], env=child_environment(), text=True,
                                 capture_output=True, check=True).stdout)
            for _ in range(repetitions + 1)][1:]
