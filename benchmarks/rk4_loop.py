# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""RK4 and the motors in NumPy, around a library's forward dynamics.

For the peers that give accelerations but do not simulate a motor: what their user would write.
"""

from __future__ import annotations

import numpy as np

from benchmarks.task import STEP, Task


def simulate(task: Task, acceleration) -> np.ndarray:
    """Final positions (3,) [rad]; ``acceleration(q, qd, torque)`` gives qdd, all (3,)."""
    motors = task.plant.arm.motors
    rate = np.array([1.0 / m.inductance for m in motors])
    resistance = np.array([m.resistance for m in motors])
    emf = np.array([m.back_emf * m.gear_ratio for m in motors])
    torque = np.array(task.plant.torque_per_ampere)

    def derivative(x, volts):
        dx = np.empty(9)
        dx[:3] = x[3:6]
        dx[3:6] = acceleration(x[:3], x[3:6], torque * x[6:])
        dx[6:] = rate * (volts - resistance * x[6:] - emf * x[3:6])
        return dx

    x = task.state.copy()
    for volts in task.voltages:
        k1 = derivative(x, volts)
        k2 = derivative(x + 0.5 * STEP * k1, volts)
        k3 = derivative(x + 0.5 * STEP * k2, volts)
        k4 = derivative(x + STEP * k3, volts)
        x = x + STEP / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return x[:3]
