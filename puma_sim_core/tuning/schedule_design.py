# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How the tables of `scheduled` are made: from the model by the poles of the loop, or from the ultimate gains.

`placed_gains`, for the servo's rate. One joint moves, its motor without inductance:
``(R M / kT) qdd + ke N qd = v``, M its element of D + Ia at the pose, gravity left to the integral
action. PID gives it three poles at -b with ``Kg = 3 b^2 R M / kT``, ``Ti = 3 / b`` and
``Kg Td = 3 b R M / kT - ke N`` (no derivative where the back-EMF damps by more).

`ultimate_gains`, for slow and late samples: fixed shares of Kmax and Tp of each pose.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.control.scheduled import GainSchedule
from puma_sim_core.errors import TuningError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.tuning.ziegler_nichols import ultimate_map

#: shares of Kmax, Tp and Tp: gentler than table 7.2, for a well damped loop at all poses
GENTLE = (0.3, 0.66, 0.09)


def placed_gains(plant: Plant, poses: ArrayLike, bandwidth: Sequence[float]) -> np.ndarray:
    """(..., 3 joints, 3) Kg [V/rad], Ti [s], Td [s] at poses (..., 3) [rad].

    bandwidth : (3,) [rad/s], b of each joint.
    """
    arm = plant.loaded_arm
    b = np.asarray(bandwidth, dtype=float)
    mass = np.einsum("...jj->...j", inertia(poses, arm)) + np.array(arm.motor_inertia)
    per = mass * [m.resistance / kT for m, kT in zip(arm.motors, plant.torque_per_ampere)]
    own = np.array([m.back_emf * m.gear_ratio for m in arm.motors])
    gain = 3.0 * b**2 * per
    return np.stack([gain, np.broadcast_to(3.0 / b, gain.shape), np.maximum(3.0 * b * per - own, 0.0) / gain], axis=-1)


def ultimate_gains(
    plant: Plant, poses: ArrayLike, period: float, delay: int, shares: Sequence[float] = GENTLE
) -> np.ndarray:
    """(..., 3 joints, 3) Kg [V/rad], Ti [s], Td [s] at poses (..., 3) [rad].

    period : between samples [s]; delay : in samples.

    Raises TuningError: a pose has no ultimate gain.
    """
    joints = []
    for joint in (1, 2, 3):
        gain, tp, _ = ultimate_map(plant, joint, poses, period=period, delay=delay)
        if np.isnan(gain).any():
            what = "a pose of the table has no ultimate gain"
            raise TuningError(what, where=f"joint {joint}", expected="another period or delay")
        joints.append(np.stack([shares[0] * gain, shares[1] * tp, shares[2] * tp], axis=-1))
    return np.stack(joints, axis=-2)


def schedule_of(q2: Sequence[float], q3: Sequence[float], gains_at: Callable[[np.ndarray], np.ndarray]) -> GainSchedule:
    """The schedule over a grid; gains_at(poses) gives (..., 3, 3), one of the two above.

    q2, q3 : angles of the grid [rad]. Columns that are the same everywhere become one number.
    """
    poses = np.zeros((len(q2), len(q3), 3))
    poses[..., 1], poses[..., 2] = np.asarray(q2)[:, None], q3
    gains = gains_at(poses)

    def entry(joint: int, k: int) -> Any:
        values = gains[..., joint, k]
        return float(values[0, 0]) if (values == values[0, 0]).all() else values.tolist()

    return GainSchedule(tuple(q2), tuple(q3), *(tuple(entry(j, k) for j in range(3)) for k in range(3)))
