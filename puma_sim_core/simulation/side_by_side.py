# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Several models that follow one measured motion, side by side in the lanes of `dynamics.following_lanes`.

Their innovations are those of `tracking.innovations` but for the last bits of sines and cosines, at a fraction of the
time, and the same with and without numba.
"""

from collections.abc import Sequence

import numpy as np

from puma_sim_core.dynamics.array_lanes import follow_arrays
from puma_sim_core.dynamics.following_lanes import FOLLOWED, IN_LANES, LIMITS, follow_lanes, limits
from puma_sim_core.dynamics.lanes import LANES
from puma_sim_core.effects.base import VOLTAGE, Effect
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.run_inputs import kernel_rows, native, rows_of
from puma_sim_core.simulation.simulator import Simulator

#: models that one call takes: those that share registers or, in plain Python, as many as there are
TOGETHER = LANES if BACKEND == "numba" else 1024
#: models from which on they take less time together than one by one: two where all lanes slide and eight where none
#: does; arrays take what 16 models do
LEAST_TOGETHER = LANES // 2 if BACKEND == "numba" else 16


def goes_side_by_side(plant: Plant, first: Plant) -> bool:
    """Whether a plant may be one of those of `innovations_side_by_side` beside the first: an arm with the same stages
    of the kernel, of those that lanes have."""
    active = plant.constants.active
    return plant.joints == 3 and active & ~IN_LANES == 0 and active == first.constants.active


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
    """Innovations (n - 1, 3) [rad] of each model, not finite from where its state stopped being so.

    simulators : at most `TOGETHER`, without constraints, of one greatest step, of plants that go side by side; time,
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
        numbers[LIMITS : LIMITS + 9, lane] = limits(tables[lane])
    edges, first = np.ascontiguousarray(time), simulators[0]
    rows = kernel_rows(np.ascontiguousarray(voltage[:-1]), edges, np.diff(edges), first.max_step)
    seen, corrected = rows_of(measured[1:]), rows_of(np.ones(len(edges) - 1, dtype=bool))
    given = (first.constants.active, rows, seen, corrected, native(gain.ravel().tolist()))
    alike = all(_on_voltage(simulator) == _on_voltage(first) for simulator in simulators)
    if not compiled:
        with np.errstate(over="ignore", invalid="ignore"):
            return list(follow_arrays(numbers, *given, tables, alike, finer))
    out = np.empty((LANES, len(edges) - 1, 3))
    follow_lanes(numbers.ravel(), *given, np.array(tables), alike, np.array(finer), out)
    return list(out[: len(simulators)])
