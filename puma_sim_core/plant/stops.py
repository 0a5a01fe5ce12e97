# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Mechanical stops at the ends of the joints' ranges: the effect `soft_stop`, stiff, on each joint that has none."""

from dataclasses import replace

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.plant.plant import Plant

_KIND = KINDS["soft_stop"]
#: stiffness [N.m/rad] and damping [N.m.s/rad]. Driven into either end by 40 V on all joints, no joint of the set bejczy
#: goes further than 1.0 deg beyond it, in steps of up to 7 ms; with three times the damping these would not be stable.
_STIFF = {"stiffness": 5e4, "damping": 300.0}


def with_stops(plant: Plant) -> Plant:
    """The plant with stops at the ends of its arm's ranges; a `soft_stop` that it has on a joint stays as it is."""
    stopped = {effect.joint for effect in plant.effects if effect.kind is _KIND}
    missing = [Effect(_KIND, joint, _STIFF) for joint in (1, 2, 3) if joint not in stopped]
    return replace(plant, effects=(*plant.effects, *missing))
