# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Several models that follow one measured motion, side by side in the lanes of `dynamics.lanes.following`.

Their innovations are those of `tracking.innovations` but for the last bits of sines and cosines, at a fraction of the
time, and the same with and without numba.
"""

from collections.abc import Sequence

import numpy as np

from puma_sim_core.dynamics.circuit import with_damping
from puma_sim_core.dynamics.lanes.arrays import follow_arrays
from puma_sim_core.dynamics.lanes.following import IN_LANES, SLIDING, bounds, follow_lanes
from puma_sim_core.dynamics.lanes.places import DAMPING, FOLLOWED, LEVELS
from puma_sim_core.dynamics.lanes.registers import LANES
from puma_sim_core.dynamics.types import STILL
from puma_sim_core.effects.base import VOLTAGE, Effect
from puma_sim_core.jit import BACKEND, interpreted
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.delay import delay_of, measured_rows
from puma_sim_core.simulation.run_inputs import kernel_rows, native, rows_of
from puma_sim_core.simulation.simulator import Simulator

#: models that one call takes: those that share registers or, in plain Python, as many as there are
TOGETHER = LANES if BACKEND == "numba" else 1024
#: stages that these may have: arrays take none of which the torques depend on more than the direction of motion
_STAGES = IN_LANES if BACKEND == "numba" else SLIDING
#: models from which on they take less time together than one by one: two to four where most rows slide, eight where
#: none does; arrays take what 16 models do (measured, 10 s at 1 kHz)
LEAST_TOGETHER = LANES // 2 if BACKEND == "numba" else 16


def goes_side_by_side(plant: Plant, first: Plant) -> bool:
    """Whether a plant may be one of those of `innovations_side_by_side` beside the first: one with the same joints, the
    same delay of the voltages, and the same stages of the kernel, of those that lanes have."""
    active, table = plant.constants.active, plant.constants.table
    if active & ~_STAGES or active != first.constants.active:
        return False
    alike = plant.axes == first.axes and plant.rest == first.rest
    return alike and delay_of(active, table) == delay_of(active, first.constants.table)


def _on_voltage(simulator: Simulator) -> tuple[Effect, ...]:
    return tuple(effect for effect in simulator.plant.effects if effect.kind.acts == VOLTAGE)


def innovations_side_by_side(
    simulators: Sequence[Simulator],
    time: np.ndarray,
    voltage: np.ndarray,
    measured: np.ndarray,
    gain: np.ndarray,
    parts: Sequence[int] = (),
) -> list[np.ndarray]:
    """Innovations (n - 1, J) [rad] of each model, not finite from where its state stopped being so.

    simulators : at most `TOGETHER`, of the same constraints and greatest step, of plants that go side by side; time,
    voltage, measured, gain and parts (of each model, 1 by default) as for `tracking.innovations`.
    """
    compiled = BACKEND == "numba"
    # lanes without a run of their own repeat the last one
    filled = [*simulators, *[simulators[-1]] * (LANES - len(simulators) if compiled else 0)]
    finer = [*(parts or [1] * len(simulators)), *[1] * (len(filled) - len(simulators))]
    numbers, tables = np.zeros((FOLLOWED, len(filled))), [simulator.constants.table for simulator in filled]
    for lane, simulator in enumerate(filled):
        model = simulator.constants.model
        numbers[0:9, lane], numbers[12:32, lane], numbers[32:47, lane] = simulator.state, model.body, model.drive
        numbers[LEVELS:DAMPING, lane] = bounds(tables[lane])
        _, damped = interpreted(with_damping)(simulator.state, STILL, model)
        numbers[DAMPING : DAMPING + 3, lane] = damped.drive[4::5]
    time, first = np.ascontiguousarray(time), simulators[0]
    plant, axes = first.plant, list(first.plant.axes)
    pieces = measured_rows(first.past, time, np.ascontiguousarray(plant.spread(voltage[:-1])))
    rows = kernel_rows(pieces.voltage, pieces.edges, np.diff(pieces.edges), first.max_step)
    positions = np.tile(plant.rest, (len(time) - 1, 1))
    positions[:, axes] = measured[1:]
    target, seen, corrected = map(rows_of, (pieces.target, positions, np.ones(len(positions), dtype=bool)))
    given = (first.constants.active, rows, target, seen, corrected, native(plant.spread(gain.T).T.ravel().tolist()))
    alike = all(_on_voltage(simulator) == _on_voltage(first) for simulator in simulators)
    if not compiled:
        with np.errstate(over="ignore", invalid="ignore"):
            return list(follow_arrays(numbers, *given, tables, alike, finer, first.lock)[:, :, axes])
    out = np.empty((LANES, len(positions), 3))
    follow_lanes(numbers.ravel(), *given, np.array(tables), alike, np.array(finer), first.lock, out)
    # of a whole arm without a copy
    return list(out[: len(simulators)] if plant.joints == 3 else out[: len(simulators)][:, :, axes])
