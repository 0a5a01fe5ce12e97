# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Kalman predictor: the model follows a measured motion, and its innovations tell how well.

Each row the model predicts the measured positions of the next one; what they are away from the
prediction, the innovation, moves the model's state by a constant gain. With the gain of a steady
Kalman filter the innovations of a true model are independent of one another and of all voltages
before, also where feedback made those voltages out of the measured positions.

The correction w of a velocity stands for a torque M w / h that acted over the h seconds since the
last one and that the model does not know of. A joint that sticks under a torque T, below a level F
of friction, gets of it what that torque gives beyond its friction (`contact.past_friction`),

    sign(T + M w / h) max(|T + M w / h| - F, 0) h / M,

so that innovations do not jump where a little more friction makes the joint stick.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.dynamics.following import Track, follow, follow_trains
from puma_sim_core.dynamics.laws import TWO_MASS
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.simulation.delay import measured_rows
from puma_sim_core.simulation.open_circuit import enabled
from puma_sim_core.simulation.run_inputs import kernel_rows, native, rows_of
from puma_sim_core.simulation.simulator import Simulator


class Tracked(NamedTuple):
    """Innovations [rad], predicted positions [rad] and velocities [rad/s], (n - 1, J) each."""

    innovation: np.ndarray
    position: np.ndarray
    velocity: np.ndarray


def innovations(
    simulator: Simulator,
    time: ArrayLike,
    voltage: ArrayLike,
    measured: ArrayLike,
    gain: ArrayLike,
    enable: ArrayLike | None = None,
    corrected: ArrayLike | None = None,
    parts: int = 1,
) -> Tracked:
    """Innovations of a model from its present state on.

    simulator : at time[0], its state is used up; time (n,) [s]; voltage (n, J) [V], row r held until time[r + 1];
    measured (n, J) positions [rad]; gain (J, 3): of position [1], velocity [1/s] and current [A/rad] for an innovation
    of a joint; enable (n, J), 0 where a drive is off; corrected (n - 1,): whether the innovation of a row moves the
    state, None: each does. Where it does not the model runs in open loop, and innovations are its errors; parts : that
    a step of integration is divided into where a current meets its limit or leaves it.

    Returns `Tracked`, at time[1:]. Raises ParameterError: shapes that do not go together; NonFiniteStateError: the
    state stopped being finite.
    """
    time = np.ascontiguousarray(time, dtype=float)
    plant, n = simulator.plant, len(time)
    J, axes = plant.joints, np.array(plant.axes)
    voltage, measured, gain = (np.asarray(a, dtype=float) for a in (voltage, measured, gain))
    if voltage.shape != (n, J) or measured.shape != (n, J) or gain.shape != (J, 3) or n < 2:
        what = f"time {time.shape}, voltage {voltage.shape}, measured {measured.shape}, gain {gain.shape}"
        raise ParameterError(what, where="innovations", expected=f"(n,), (n, {J}), (n, {J}), ({J}, 3)")
    volts = np.ascontiguousarray(plant.spread(voltage[:-1]))
    out = np.zeros((n - 1, 9))
    out[:, :3] = np.array(plant.rest)
    out[:, axes] = measured[1:]
    on = np.ones((n - 1, 3)) if enable is None else enabled(enable, n, plant.axes)[:-1].astype(float)
    corrected = np.ones(n - 1, dtype=bool) if corrected is None else np.asarray(corrected, bool)
    if corrected.shape != (n - 1,):
        raise ParameterError(f"corrected {corrected.shape}", where="innovations", expected=f"({n - 1},)")
    gains = native(plant.spread(gain.T).T.ravel().tolist())
    run = follow_trains if simulator.constants.active & TWO_MASS else follow
    pieces = measured_rows(simulator.past, time, volts)
    rows = kernel_rows(pieces.voltage, pieces.edges, np.diff(pieces.edges), simulator.max_step)
    track = Track(rows_of(on[pieces.row]), rows_of(pieces.target), rows_of(corrected), gains, parts)
    bad = run(simulator.whole, rows, track, simulator.constants, simulator.lock, out)
    if bad >= 0 or not np.isfinite(out).all():
        raise NonFiniteStateError(int(bad))
    # of a whole arm without a copy
    own = [slice(first, first + 3) if J == 3 else first + axes for first in (0, 3, 6)]
    return Tracked(*(out[:, columns] for columns in own))
