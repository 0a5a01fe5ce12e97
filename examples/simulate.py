# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""From Python: the arm under PID control with and without friction. ``python simulate.py``"""

from __future__ import annotations

import numpy as np

import puma_sim_core as ps

friction = ps.parse_effect("coulomb_friction:joint=2,torque=12")
gains = ps.PidGains(900.0, 0.2, 0.03)  # V/rad, s, s
start = np.array((0.0, -1.2, 1.0))
setpoints = start + 0.3 * np.sin(0.028 * np.arange(70))[:, None]  # rad, one every 28 ms

for plant in (ps.Plant.of("bejczy"), ps.Plant.of("bejczy", [friction])):
    simulator = ps.Simulator(plant)
    simulator.reset(position=start)
    run = simulator.run_controller(ps.Pid((gains,) * 3, 0.028 / 30, limit=40.0), setpoints)
    error = run.position[30::30] - setpoints[: len(run.position[30::30])]
    print([effect.kind.name for effect in plant.effects], "rms error [rad]:", np.sqrt(np.mean(error**2, axis=0)))
