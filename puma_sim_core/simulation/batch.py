# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Many runs at once: different parameters, voltages, effects and starts, over all cores.

Runs without effects that need a stage of the kernel of their own go side by side in the lanes of
the vector registers (`lanes`), the others one by one. With numba the cores are shared by threads,
which need no copies; without it by processes. The result does not depend on the number of
workers, bit for bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from puma_sim_core.dynamics.lanes import LANE_NUMBERS, LANES, run_lanes
from puma_sim_core.dynamics.runs import terminal_voltages
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator, check_step, native, step_counts, table


@dataclass(frozen=True)
class BatchResult:
    """Runs on common times: time (n,) [s]; position [rad], velocity [rad/s] and current [A], each
    (m, n, 3). finite (m,): False for a run whose state stopped being finite; its rows from there
    on are NaN."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    current: np.ndarray
    finite: np.ndarray


def run_batch(
    plants: Plant | Sequence[Plant],
    time,
    voltage,
    *,
    position=(0.0, 0.0, 0.0),
    velocity=(0.0, 0.0, 0.0),
    current=(0.0, 0.0, 0.0),
    max_step: float = SERVO_PERIOD,
    lanes: bool = True,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> BatchResult:
    """Run m plants, or one plant m times.

    plants : one, or m of them; time : (n,) [s], common to all runs; voltage : (n, 3), or (m, n, 3)
    [V]; position, velocity, current : (3,) or (m, 3), the initial states; max_step [s]; lanes :
    False gives each run the bits that `Simulator.run` gives, at a fraction of the speed; workers :
    all cores by default; progress : called with (runs done, m).

    Raises
    ------
    ParameterError : shapes that do not go together, values as for `Simulator`.
    """
    check_step(max_step, "max_step")
    voltage = np.ascontiguousarray(voltage, dtype=float)
    starts = [np.atleast_2d(np.asarray(a, dtype=float)) for a in (position, velocity, current)]
    shared = [
        1 if isinstance(plants, Plant) else len(plants),
        voltage.shape[0] if voltage.ndim == 3 else 1,
        *(len(a) for a in starts),
    ]
    m = max(shared)
    if any(n not in (1, m) for n in shared) or any(a.shape[1:] != (3,) for a in starts):
        raise ParameterError(
            f"plants, voltages and starts of {shared} runs", expected="the same number of runs in each, or one for all"
        )
    volts = voltage if voltage.ndim == 3 else voltage[None]
    for rows in volts:
        time, _ = table(time, rows, "voltage")
    start = np.hstack([np.broadcast_to(a, (m, 3)) for a in starts])
    if not np.isfinite(start).all():
        raise ParameterError("initial states that are not finite", expected="finite numbers")
    if any(plant.joints != 3 for plant in ([plants] if isinstance(plants, Plant) else plants)):
        raise ParameterError("a plant of one joint in a batch", expected="arms of three joints")
    all_plants = [plants] * m if isinstance(plants, Plant) else list(plants) * (m // len(plants))
    jobs = _Jobs(all_plants, time, volts, start, max_step)
    parts = jobs.parts(lanes and BACKEND == "numba")
    workers = min(workers or os.cpu_count() or 1, len(parts))
    out = np.empty((m, len(time), 9))
    done = 0
    for runs in _spread(jobs, parts, workers, out):
        done += len(runs)
        if progress is not None:
            progress(done, m)
    return BatchResult(time, out[:, :, 0:3], out[:, :, 3:6], out[:, :, 6:9], np.isfinite(out[:, -1]).all(axis=1))


def _spread(jobs, parts, workers, out):
    """Do the parts on several threads or processes, in order; yields each part when it is in
    `out`."""

    def fill(runs):
        jobs.work(runs, out)
        return runs

    if workers <= 1:
        yield from map(fill, parts)
    elif BACKEND == "numba":
        with ThreadPoolExecutor(workers) as executor:
            yield from executor.map(fill, parts)
    else:
        with ProcessPoolExecutor(workers) as executor:
            for runs, states in zip(parts, executor.map(jobs.states, parts)):
                out[runs] = states
                yield runs


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
            out[runs[0]] = self._alone(runs[0])

    def states(self, runs: list[int]) -> np.ndarray:
        """The states (runs, n, 9) of one part."""
        return np.stack([self._alone(run) for run in runs])

    def _rows(self, run: int) -> np.ndarray:
        return self.volts[run if len(self.volts) > 1 else 0]

    def _alone(self, run: int) -> np.ndarray:
        simulator = Simulator(self.plants[run], max_step=self.max_step)
        x = self.start[run]
        simulator.reset(x[0:3], x[3:6], x[6:9])
        try:
            r = simulator.run(self.time, self._rows(run))
        except NonFiniteStateError as error:
            states = np.full((len(self.time), 9), np.nan)
            if error.step > 1:
                states[: error.step] = self._until(run, error.step)
            return states
        return np.hstack([r.position, r.velocity, r.current])

    def _until(self, run: int, row: int) -> np.ndarray:
        """The states of the first rows, up to one that is not finite."""
        simulator = Simulator(self.plants[run], max_step=self.max_step)
        x = self.start[run]
        simulator.reset(x[0:3], x[3:6], x[6:9])
        r = simulator.run(self.time[:row], self._rows(run)[:row])
        return np.hstack([r.position, r.velocity, r.current])

    def _side_by_side(self, runs: list[int], out: np.ndarray) -> None:
        # lanes without a run of their own repeat the last one
        filled = runs + [runs[-1]] * (LANES - len(runs))
        numbers = np.zeros((LANE_NUMBERS, LANES))
        for lane, run in enumerate(filled):
            model = self.plants[run].constants
            numbers[0:9, lane] = self.start[run]
            numbers[12:32, lane] = model.body
            numbers[32:47, lane] = model.drive
        distinct: dict[tuple, int] = {}
        volts = []
        for run in filled:
            if self._voltage_key(run) not in distinct:
                distinct[self._voltage_key(run)] = len(volts)
                volts.append(self._terminal(run))
        which = np.array([distinct[self._voltage_key(run)] for run in filled])
        duration = np.diff(self.time)
        counts = step_counts(duration, self.max_step)
        whole = len(runs) == LANES and runs == list(range(runs[0], runs[0] + LANES))
        states = out[runs[0] : runs[0] + LANES] if whole else np.empty((LANES, *out.shape[1:]))
        run_lanes(
            numbers.ravel(),
            np.stack(volts),
            which,
            counts,
            duration / counts,
            native(self.plants[runs[0]].constants.table),
            states,
        )
        for lane in np.flatnonzero(~np.isfinite(states[:, -1]).all(axis=1)):
            # it ends where `Simulator` would have stopped
            bad = ~np.isfinite(states[lane]).all(axis=1)
            states[lane, int(np.argmax(bad)) :] = np.nan
        if not whole:
            out[runs] = states[: len(runs)]

    def _voltage_key(self, run: int) -> tuple:
        """Equal for runs with the same terminal voltages."""
        return (
            run if len(self.volts) > 1 else 0,
            tuple(e for e in self.plants[run].effects if e.kind.acts == "voltage"),
        )

    def _terminal(self, run: int) -> np.ndarray:
        """Terminal voltages (n - 1, 3) [V] of a run."""
        rows = self._rows(run)[:-1]
        saturation = [e for e in self.plants[run].effects if e.kind.acts == "voltage"]
        if not saturation:
            return rows
        p = native(self.plants[run].constants.table)
        return np.array([terminal_voltages(*row, p) for row in rows.tolist()]).reshape(-1, 3)
