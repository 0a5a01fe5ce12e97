# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Several models that follow one measured motion, side by side in the lanes of `dynamics.lanes`.

Their innovations are those of `tracking.innovations` but for the last bits of sines and cosines, at a fraction of the
time, and the same with and without numba.
"""

from collections.abc import Sequence

import numpy as np

from puma_sim_core.dynamics.array_lanes import follow_arrays
from puma_sim_core.dynamics.lanes import LANE_NUMBERS, LANES, follow_lanes
from puma_sim_core.effects.base import VOLTAGE, Effect
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.run_inputs import kernel_rows, native, rows_of
from puma_sim_core.simulation.simulator import Simulator

#: models that one call takes: those that share registers or, in plain Python, as many as there are
TOGETHER = LANES if BACKEND == "numba" else 1024


def goes_side_by_side(plant: Plant, first: Plant) -> bool:
    """Whether a plant may be one of those of `innovations_side_by_side` beside the first: an arm without constraints or
    effects that need a stage of the kernel, with the same effects on the voltages."""
    return plant.joints == 3 and plant.constants.active == 0 and _on_voltage(plant) == _on_voltage(first)


def _on_voltage(plant: Plant) -> tuple[Effect, ...]:
    return tuple(effect for effect in plant.effects if effect.kind.acts == VOLTAGE)


def innovations_side_by_side(
    simulators: Sequence[Simulator], time: np.ndarray, voltage: np.ndarray, measured: np.ndarray, gain: np.ndarray
) -> list[np.ndarray]:
    """Innovations (n - 1, 3) [rad] of each model, not finite from where its state stopped being so.

    simulators : at most `TOGETHER`, without constraints, of one greatest step, of plants that go side by side; time,
    voltage, measured and gain as for `tracking.innovations`.
    """
    compiled = BACKEND == "numba"
    # lanes without a run of their own repeat the last one
    filled = [*simulators, *[simulators[-1]] * (LANES - len(simulators) if compiled else 0)]
    numbers = np.zeros((LANE_NUMBERS, len(filled)))
    for lane, simulator in enumerate(filled):
        model = simulator.constants.model
        numbers[0:9, lane], numbers[12:32, lane], numbers[32:47, lane] = simulator.state, model.body, model.drive
    edges, table = np.ascontiguousarray(time), simulators[0].constants.table
    rows = kernel_rows(np.ascontiguousarray(voltage[:-1]), edges, np.diff(edges), simulators[0].max_step)
    seen, corrected = rows_of(measured[1:]), rows_of(np.ones(len(edges) - 1, dtype=bool))
    gains = native(gain.ravel().tolist())
    if not compiled:
        with np.errstate(over="ignore", invalid="ignore"):
            return list(follow_arrays(numbers, rows, seen, corrected, gains, table))
    out = np.empty((LANES, len(edges) - 1, 3))
    follow_lanes(numbers.ravel(), rows, seen, corrected, gains, table, out)
    return list(out[: len(simulators)])
