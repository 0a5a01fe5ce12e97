# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Many runs at once: different parameters, voltages, effects and starts, over all cores.

Runs without effects that need a stage of the kernel of their own go side by side in the lanes of
the vector registers (`dynamics.lanes`), the others one by one. With numba the cores are shared by threads,
which need no copies; without it by processes. The result does not depend on the number of
workers, bit for bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.dynamics.lanes.registers import LANE_NUMBERS, LANES, run_lanes
from puma_sim_core.dynamics.runs import terminal_voltages
from puma_sim_core.effects import Effect
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.run_inputs import check_step, native, runs_compiled, step_counts, table
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator


@dataclass(frozen=True)
class BatchResult:
    """Runs on common times: time (n,) [s]; position [rad], velocity [rad/s] and current [A], each (m, n, 3). finite
    (m,): False for a run whose state stopped being finite; its rows from there on are NaN."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    current: np.ndarray
    finite: np.ndarray


@dataclass(frozen=True)
class InitialState:
    """Where runs start: position [rad], velocity [rad/s] and current [A] of the joints, (3,) for all runs or (m, 3)."""

    position: ArrayLike = (0.0, 0.0, 0.0)
    velocity: ArrayLike = (0.0, 0.0, 0.0)
    current: ArrayLike = (0.0, 0.0, 0.0)


def run_batch(
    plants: Plant | Sequence[Plant],
    time: ArrayLike,
    voltage: ArrayLike,
    start: InitialState = InitialState(),
    *,
    max_step: float = SERVO_PERIOD,
    lanes: bool = True,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> BatchResult:
    """Run m plants, or one plant m times.

    plants : one, or m of them; time : (n,) [s], common to all runs; voltage : (n, 3), or (m, n, 3) [V]; start : one, or
    m of them; max_step [s]; lanes : False gives each run the bits that `Simulator.run` gives, at a fraction of the
    speed; workers : all cores by default; progress : called with (runs done, m).

    Raises ParameterError: shapes that do not go together, values as for `Simulator`.
    """
    check_step(max_step, "max_step")
    voltage = np.ascontiguousarray(voltage, dtype=float)
    volts = voltage if voltage.ndim == 3 else voltage[None]
    given = [plants] if isinstance(plants, Plant) else list(plants)
    starts = [np.atleast_2d(np.asarray(a, dtype=float)) for a in (start.position, start.velocity, start.current)]
    shared = [len(given), len(volts), *map(len, starts)]
    m = max(shared)
    if any(n not in (1, m) for n in shared) or any(a.shape[1:] != (3,) for a in starts):
        what = f"plants, voltages and starts of {shared} runs"
        raise ParameterError(what, expected="the same number of runs in each, or one for all")
    for rows in volts:
        time, _ = table(time, rows, "voltage")
    states = np.hstack([np.broadcast_to(a, (m, 3)) for a in starts])
    if not np.isfinite(states).all():
        raise ParameterError("initial states that are not finite", expected="finite numbers")
    if any(plant.joints != 3 for plant in given):
        raise ParameterError("a plant of one joint in a batch", expected="arms of three joints")
    jobs = _Jobs(given * (m // len(given)), np.asarray(time), volts, states, max_step)
    parts = jobs.parts(lanes and BACKEND == "numba")
    out = np.empty((m, len(jobs.time), 9))
    done = 0
    for runs in _spread(jobs, parts, min(workers or os.cpu_count() or 1, len(parts)), out):
        done += len(runs)
        if progress is not None:
            progress(done, m)
    finite = np.all(np.isfinite(out[:, -1]), axis=1)
    return BatchResult(jobs.time, out[:, :, 0:3], out[:, :, 3:6], out[:, :, 6:9], finite)


def _spread(jobs: _Jobs, parts: list[list[int]], workers: int, out: np.ndarray) -> Iterator[list[int]]:
    """Do the parts on several threads or processes, in order; yields each part when it is in `out`."""

    def fill(runs: list[int]) -> list[int]:
        jobs.work(runs, out)
        return runs

    if workers <= 1:
        yield from map(fill, parts)
    elif BACKEND == "numba":
        with ThreadPoolExecutor(workers) as executor:
            yield from executor.map(fill, parts)
    else:
        with ProcessPoolExecutor(workers) as processes:
            for (run,), states in zip(parts, processes.map(jobs.alone, [run for (run,) in parts])):
                out[run] = states
                yield [run]


@dataclass(frozen=True)
class _Jobs:
    """What the runs are made of; `work` does one part of them, in any thread or process."""

    plants: list[Plant]
    time: np.ndarray
    volts: np.ndarray
    start: np.ndarray
    max_step: float

    def parts(self, lanes: bool) -> list[list[int]]:
        """Groups of runs: up to LANES of those that can share registers, others alone."""
        plain = [r for r, plant in enumerate(self.plants) if lanes and not plant.constants.active]
        alone = sorted(set(range(len(self.plants))) - set(plain))
        return [plain[r : r + LANES] for r in range(0, len(plain), LANES)] + [[r] for r in alone]

    def work(self, runs: list[int], out: np.ndarray) -> None:
        """Write the states of one part to its rows of out (m, n, 9)."""
        if len(runs) > 1:
            self._side_by_side(runs, out)
        else:
            out[runs[0]] = self.alone(runs[0])

    def _voltage(self, run: int) -> np.ndarray:
        """The voltages (n, 3) [V] of a run."""
        return self.volts[run if len(self.volts) > 1 else 0]

    def alone(self, run: int) -> np.ndarray:
        """The states (n, 9) of one run; NaN from where it stops being finite."""
        simulator, x = Simulator(self.plants[run], max_step=self.max_step), self.start[run]
        states, rows = np.full((len(self.time), 9), np.nan), len(self.time)
        while True:
            simulator.reset(x[0:3], x[3:6], x[6:9])
            try:
                states[:rows] = simulator.run(self.time[:rows], self._voltage(run)[:rows]).states()
                return states
            except NonFiniteStateError as error:
                rows = error.step
                if rows <= 1:
                    return states

    def _side_by_side(self, runs: list[int], out: np.ndarray) -> None:
        """`work` of several runs at once; lanes without a run of their own repeat the last one."""
        filled = runs + [runs[-1]] * (LANES - len(runs))
        numbers = np.zeros((LANE_NUMBERS, LANES))
        for lane, run in enumerate(filled):
            model = self.plants[run].constants
            numbers[0:9, lane], numbers[12:32, lane], numbers[32:47, lane] = self.start[run], model.body, model.drive
        keys = [(run if len(self.volts) > 1 else 0, self._limits(run)) for run in filled]
        distinct = list(dict.fromkeys(keys))
        volts = np.stack([self._terminal(filled[keys.index(key)]) for key in distinct])
        which = np.array([distinct.index(key) for key in keys])
        duration = np.diff(self.time)
        counts = step_counts(duration, self.max_step)
        whole = runs == list(range(runs[0], runs[0] + LANES))
        states = out[runs[0] : runs[0] + LANES] if whole else np.empty((LANES, *out.shape[1:]))
        packed = native(self.plants[runs[0]].constants.table)
        run_lanes(numbers.ravel(), volts, which, counts, duration / counts, packed, states)
        for lane in np.flatnonzero(~np.isfinite(states[:, -1]).all(axis=1)).tolist():
            # it ends where `Simulator` would have stopped
            bad = ~np.isfinite(states[lane]).all(axis=1)
            states[lane, int(np.argmax(bad)) :] = np.nan
        if not whole:
            out[runs] = states[: len(runs)]

    def _limits(self, run: int) -> tuple[Effect, ...]:
        return tuple(e for e in self.plants[run].effects if e.kind.acts == "voltage")

    def _terminal(self, run: int) -> np.ndarray:
        """Terminal voltages (n - 1, 3) [V] of a run."""
        rows = self._voltage(run)[:-1]
        if not self._limits(run):
            return rows
        constants = self.plants[run].constants
        p = native(constants.table, runs_compiled(constants.active))
        return np.array([terminal_voltages(a, b, c, p) for a, b, c in rows.tolist()]).reshape(-1, 3)
