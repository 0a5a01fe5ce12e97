# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What changes with time: the constants of one step.

A motor that warms up, grease that gets thin and an impact from outside depend on the simulated time,
which is that of the records. They are taken once a step: the slow ones at its middle, the impact as
its mean over the step, which keeps its momentum. Both are of second order in the step.
"""

from __future__ import annotations

from puma_sim_core.dynamics.laws import push_torque, resistance_factor, viscous_factor
from puma_sim_core.dynamics.types import Drive
from puma_sim_core.jit import inlined


@inlined
def drive_at(time, drive, p):
    """The constants of the drives at a time [s]."""
    y1, r1, k1, n1, h1, y2, r2, k2, n2, h2, y3, r3, k3, n3, h3 = drive
    return Drive(
        y1,
        r1 * resistance_factor(0, time, p),
        k1,
        n1,
        h1 * viscous_factor(0, time, p),
        y2,
        r2 * resistance_factor(1, time, p),
        k2,
        n2,
        h2 * viscous_factor(1, time, p),
        y3,
        r3 * resistance_factor(2, time, p),
        k3,
        n3,
        h3 * viscous_factor(2, time, p),
    )


@inlined
def push_over(time, step, p):
    """Torques [N.m] from outside in the direction of +q: the mean from `time` to `time` + `step`
    [s], or the value at an instant for step 0."""
    return (push_torque(0, time, step, p), push_torque(1, time, step, p), push_torque(2, time, step, p))
