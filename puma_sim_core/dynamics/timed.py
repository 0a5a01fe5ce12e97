# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What changes with time: the constants of one step.

A motor that warms up, grease that gets thin and a blow from outside depend on the simulated time,
which is that of the records. They are taken once a step: the slow ones at its middle, the blow as
its mean over the step, which keeps its momentum. Both are of second order in the step.
"""

from __future__ import annotations

from puma_sim_core import effects as _registry
from puma_sim_core.dynamics.rigid import WIDTH
from puma_sim_core.effects.friction import WARM_UP, warmed_share
from puma_sim_core.effects.motor import DRIFT, resistance_growth
from puma_sim_core.effects.outside import IMPULSE, pulse_torque
from puma_sim_core.jit import inlined

_WARM_UP = _registry.slot(WARM_UP)
_DRIFT = _registry.slot(DRIFT)
_IMPULSE = _registry.slot(IMPULSE)


@inlined
def drive_at(time, drive, p):
    """The kernel's `drive` at a time [s]."""
    y1, r1, k1, n1, h1, y2, r2, k2, n2, h2, y3, r3, k3, n3, h3 = drive
    return (
        y1,
        r1 * resistance_growth(p, _DRIFT, time),
        k1,
        n1,
        h1 * warmed_share(p, _WARM_UP, time),
        y2,
        r2 * resistance_growth(p, WIDTH + _DRIFT, time),
        k2,
        n2,
        h2 * warmed_share(p, WIDTH + _WARM_UP, time),
        y3,
        r3 * resistance_growth(p, 2 * WIDTH + _DRIFT, time),
        k3,
        n3,
        h3 * warmed_share(p, 2 * WIDTH + _WARM_UP, time),
    )


@inlined
def push_over(time, step, p):
    """Torques [N.m] from outside in the direction of +q: the mean from `time` to `time` + `step`
    [s], or the value at an instant for step 0."""
    return (
        pulse_torque(p, _IMPULSE, time, step),
        pulse_torque(p, WIDTH + _IMPULSE, time, step),
        pulse_torque(p, 2 * WIDTH + _IMPULSE, time, step),
    )
