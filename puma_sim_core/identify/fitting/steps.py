# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Steps of integration with which plants are run along a log."""

from math import ceil, log2

from puma_sim_core.effects.base import Point
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.plant import Plant


def stable_step(plant: Plant, at_most: float) -> float:
    """Step of integration [s] at which a plant's windings are stable, since a fit may make them fast."""
    return min([at_most, *(FITTING.greatest_step_lags * lag for lag in _lags(plant).values())])


def followed_rate(plant: Plant, row: float) -> float:
    """Steps in a second [1/s] in which a plant's links are followed where they do not follow their motors.

    row : of the log [s]. A vibration that is too fast for rows to show need not be right, but must stay bounded.
    """
    shown = FITTING.steps_of_shown / row
    return min(plant.least_rate, max(shown, FITTING.unseen_steps * plant.least_rate))


def parts_of_steps(plant: Plant, at_most: float) -> int:
    """Parts of a step of integration that resolve the instants at which a law switches a current; 1 where none does.

    The finest step is a power of two of the greatest: models whose parameters differ by little take the same steps.
    """
    switched = {e.joint for e in plant.effects if any(law.point is Point.CURRENT_RATE for law in e.kind.laws)}
    own = (lag for joint, lag in _lags(plant).items() if joint in switched)
    resolved = min((FITTING.switched_step_lags * lag for lag in own), default=at_most)
    if at_most <= resolved:
        return 1
    finest = at_most * 0.5 ** min(ceil(log2(at_most / resolved)), FITTING.switched_halves)
    return max(1, ceil(stable_step(plant, at_most) / finest))


def _lags(plant: Plant) -> dict[int, float]:
    """Time constants [s] of the windings that have an inductance, by joint."""
    motors = ((joint, plant.arm.motors[axis]) for joint, axis in enumerate(plant.axes, start=1))
    return {joint: m.inductance / m.resistance for joint, m in motors if m.inductance > 0.0}
