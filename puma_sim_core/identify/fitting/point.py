# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Models as fits change them: parameters of the mechanism and effects."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass

import numpy as np

from puma_sim_core.effects import Effect, Kind
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.settings import FITTING, RESIDUALS
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.plant import Plant

#: (number of an effect in a model, one of its parameters), one by one
Pairs = tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class Point:
    """A model: parameters theta (p,) and effects."""

    theta: Floats
    effects: tuple[Effect, ...]

    @property
    def two_mass(self) -> bool:
        """Whether a joint has two masses."""
        return any(effect.kind.two_masses for effect in self.effects)

    @property
    def key(self) -> Hashable:
        """Equal for models that are equal to the bit."""
        effects = ((effect.kind.name, effect.joint, *sorted(effect.values.items())) for effect in self.effects)
        return self.theta.tobytes(), tuple(effects)

    def plant(self, mechanism: Mechanism) -> Plant:
        """The plant of a mechanism with these parameters and effects."""
        return mechanism.plant(self.theta, self.effects)

    def strain(self, mechanism: Mechanism) -> float:
        """Half the sum of squares [nat] of the parameters' distances from their start, in deviations of the priors."""
        far = (self.theta - mechanism.start) / mechanism.deviations
        return 0.5 * float(far @ far)

    def stretched(self, mechanism: Mechanism) -> bool:
        """Whether parameters are farther from their start than their priors allow."""
        return bool(np.any(np.abs(self.theta - mechanism.start) > RESIDUALS.stretched * mechanism.deviations))


def size_of(effect: Effect, name: str) -> float:
    """What derivatives by a parameter are per: its size, or its `step`, as of a stop or an impact."""
    parameter = effect.kind.parameter(name)
    if parameter.step is not None:
        return effect.values[parameter.step] if isinstance(parameter.step, str) else parameter.step
    small = FITTING.typical_size.get(parameter.unit, FITTING.typical_other)
    return max(abs(effect.values[name]), FITTING.least_share_of_typical * small)


def bounded(kind: Kind, joint: int | None, values: Mapping[str, float]) -> Effect:
    """An effect with its values within their bounds."""
    spec = kind.parameter
    return Effect(kind, joint, {n: min(max(value, spec(n).low), spec(n).high) for n, value in values.items()})


def with_value(
    effects: tuple[Effect, ...], number: int, name: str, value: float, clip: bool = False
) -> tuple[Effect, ...] | None:
    """The effects with one value replaced; None where it is out of bounds."""
    effect = effects[number]
    values = {**effect.values, name: float(value)}
    try:
        changed = (bounded if clip else Effect)(effect.kind, effect.joint, values)
    except ParameterError:
        return None
    return (*effects[:number], changed, *effects[number + 1 :])
