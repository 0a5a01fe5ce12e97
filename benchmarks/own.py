# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Our own rows: compiled, plain Python, with effects, in batches; and the time of the import."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.task import STEP, Row, Task
from puma_sim_core.dynamics.laws import AT_REST
from puma_sim_core.dynamics.runs import ROW, advance, is_finite, run_voltages, store, terminals
from puma_sim_core.dynamics.types import FREE, STILL, Model, Rows, State
from puma_sim_core.effects import parse_effect
from puma_sim_core.jit import BACKEND, compiled
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.batch import InitialState, run_batch
from puma_sim_core.simulation.run_inputs import native
from puma_sim_core.simulation.simulator import Simulator

COMPILED = "puma_sim, Simulator.run, compiled"
PLAIN = "puma_sim, Simulator.run, plain Python"
ONE_CALL = "puma_sim, run_voltages, compiled"
WITHOUT_STAGES = "puma_sim, run_voltages without any effect in it"
BATCH_ONE = "puma_sim, batch on one core"
BATCH_ALL = "puma_sim, batch on all cores"
ALL_DRY = "puma_sim, all friction but the bristle"
ALL_FRICTION = "puma_sim, all friction effects"

FITTING_ONE = "puma_sim, batch with states each 28 ms, on one core"
FITTING_ALL = "puma_sim, batch with states each 28 ms, on all cores"

#: 23 MB of states: the allocator keeps that much, and the system's page faults do not count
BATCH_RUNS = 32
#: as a fit of parameters runs them, some tenth of a second at a time
FITTING_RUNS = 256
#: rows of 1 ms in one of 28 ms
_HELD = 28

#: (levels of the kind's parameters for joints 1, 2, 3): of a PUMA's size, where one is known
_FRICTION = {
    "viscous_friction": ("coefficient={}", (5.80,), (9.50,), (3.98,)),
    "coulomb_friction": ("torque={}", (5.0,), (4.0,), (2.0,)),
    "asymmetric_coulomb_friction": ("positive={},negative={}", (24.7, 27.2), (13.6, 7.65), (7.1, 5.6)),
    "stribeck_friction": ("torque={}", (5.0,), (4.0,), (2.0,)),
    "presliding_friction": ("torque={}", (5.0,), (4.0,), (2.0,)),
}


def friction(*kinds: str):
    """Effects of these kinds on all three joints."""
    return tuple(
        parse_effect(f"{kind}:joint={joint},{form.format(*values)}")
        for kind in kinds
        for form, *levels in [_FRICTION[kind]]
        for joint, values in enumerate(levels, start=1)
    )


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


def one_call(task: Task):
    """The compiled call that is behind `Simulator.run`, alone."""
    out, rows, state, constants = _call(task)

    def run():
        run_voltages(state, rows, constants, FREE, out)
        return out[-1, :3].copy()

    return run


def _call(task: Task):
    """What a compiled call takes."""
    out = np.empty((task.steps + 1, ROW))
    counts, steps = np.ones(task.steps, dtype=np.int64), np.full(task.steps, STEP)
    rows = Rows(task.voltages, STEP * np.arange(task.steps), counts, steps)
    state = State(tuple(task.state.tolist()), AT_REST, STILL)
    return out, rows, state, task.plant.constants._replace(table=native(task.plant.constants.table))


def batch(task: Task, workers: int, runs: int | None = None, held: int = 1):
    """Runs (BATCH_RUNS of them) of arms that differ in their masses, the first the task's own.

    held : rows of the task for which each voltage is held, and after which a state is given.
    """
    arm = task.plant.arm
    plants = [
        Plant(replace(arm, links=tuple(replace(link, mass=link.mass * (1.0 + 0.001 * k)) for link in arm.links)))
        for k in range(runs or BATCH_RUNS)
    ]
    time = (STEP * np.arange(task.steps + 1))[::held]
    voltages = np.vstack([task.voltages, task.voltages[-1:]])[::held]
    start = InitialState(*task.state.reshape(3, 3))

    def run():
        return run_batch(plants, time, voltages, start, max_step=STEP, workers=workers).position[0, -1]

    return run


def core_count() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def without_stages(task: Task):
    """`one_call` compiled for a plant without effects: all that they could cost is gone."""

    @compiled
    def run_bare(state, rows, constants, out):
        model, p = constants
        plain = Model(model.body, model.drive, 0)
        store(out, 0, state.x, state.z)
        for r in range(len(rows.count)):
            v = terminals(rows.voltage, r, p)
            # rows of any length, as in the kernel: a constant step would be a gain of its own
            state = advance(state, v, 0.0, rows.step[r], rows.count[r], plain, p, FREE)
            if not is_finite(state.x):
                return r + 1
            store(out, r + 1, state.x, state.z)
        return -1

    out, rows, state, constants = _call(task)

    def run():
        run_bare(state, rows, constants, out)
        return out[-1, :3].copy()

    return run


class PlainPython:
    """A second process that runs the task with the interpreted kernel, on demand."""

    def __init__(self, task: Task):
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"{__package__}.child", repr(task.seconds)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=child_environment(),
        )

    def measure(self) -> tuple[float, np.ndarray]:
        """(seconds, final positions) of one run; this process waits meanwhile."""
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"the process with the interpreted kernel ended with status {self._process.wait()}")
        elapsed, position = json.loads(answer)
        return elapsed, np.array(position)

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()


@contextmanager
def helper(task: Task):
    """The process for plain Python while the bench runs; None where this process is that."""
    if BACKEND != "numba":
        yield None
        return
    child = PlainPython(task)
    try:
        yield child
    finally:
        child.close()


def child_environment() -> dict[str, str]:
    """Environment of a process that has this package and the interpreted kernel."""
    root = str(Path(__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PUMA_SIM_KERNEL": "python", "PYTHONPATH": path}


def rows(task: Task, child: PlainPython | None) -> list[Row]:
    """The single runs, the reference of all ratios first."""
    if BACKEND != "numba":
        return [Row(PLAIN, simulation(task), task.seconds, calls=2, ours=True)]
    made = [Row(COMPILED, simulation(task), task.seconds, calls=9, ours=True)]
    made.append(
        Row(
            ONE_CALL,
            one_call(task),
            task.seconds,
            calls=9,
            ours=True,
            note="without the making of its arrays and of the recording",
        )
    )
    made.append(
        Row(
            WITHOUT_STAGES,
            without_stages(task),
            task.seconds,
            calls=9,
            ours=True,
            note="the kernel with the stages of the effects taken out by the compiler",
        )
    )
    if child is not None:
        made.append(
            Row(
                PLAIN,
                lambda: child.measure()[1],
                task.seconds,
                calls=2,
                ours=True,
                measure=child.measure,
                note="in a process of its own, in turn with ours",
            )
        )
    sets = {f"puma_sim, {kind}": (kind,) for kind in _FRICTION}
    sets[ALL_DRY] = tuple(kind for kind in _FRICTION if kind != "presliding_friction")
    sets[ALL_FRICTION] = tuple(_FRICTION)
    for label, kinds in sets.items():
        run = simulation(task, friction(*kinds))
        made.append(Row(label, run, task.seconds, calls=5, ours=True, compared=False))
    for label, workers in ((BATCH_ONE, 1), (BATCH_ALL, core_count())):
        made.append(
            Row(
                label,
                batch(task, workers),
                BATCH_RUNS * task.seconds,
                task.seconds,
                calls=5,
                ours=True,
                note=f"time a run, of {BATCH_RUNS} runs of arms that differ",
            )
        )
    for label, workers in ((FITTING_ONE, 1), (FITTING_ALL, core_count())):
        made.append(
            Row(
                label,
                batch(task, workers, FITTING_RUNS, _HELD),
                FITTING_RUNS * task.seconds,
                task.seconds,
                calls=2,
                ours=True,
                compared=False,
                note=f"time a run, of {FITTING_RUNS} runs; voltages held for {_HELD} ms",
            )
        )
    return made


def import_seconds(module: str, repetitions: int = 5) -> list[float]:
    """Times [s] of the import of `module` in fresh processes that have no numba."""
    code = (
        "import sys; sys.modules['numba'] = None\n"
        "from time import perf_counter\n"
        f"start = perf_counter(); import {module}; print(perf_counter() - start)"
    )
    return [
        float(
            subprocess.run(
                [sys.executable, "-c", code], env=child_environment(), text=True, capture_output=True, check=True
            ).stdout
        )
        for _ in range(repetitions + 1)
    ][1:]
