# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Models run along the logs: their innovations before whitening, and derivatives of these."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting.point import Pairs, Point, size_of, with_value
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.together import errors_side_by_side
from puma_sim_core.identify.parallel import parallel_map
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.plant import Plant


class Ran(NamedTuple):
    """A model's innovations (N, J), None where it cannot be run, and whether it was run beside others."""

    errors: Floats | None
    beside: bool


class Running:
    """Runs of models along a predictor's logs."""

    def __init__(self, predictor: Predictor):
        self.predictor = predictor
        self.mechanism = predictor.mechanism

    def one(self, point: Point) -> Floats | None:
        """(N, J) innovations of a model, None where it cannot be run. Read-only: they are cached."""
        plant = self._plant(point)
        return None if plant is None else self._alone(point, plant)

    def many(self, points: Sequence[Point]) -> list[Ran]:
        """Those of several models: beside each other where the kernel has lanes for them, else on all cores."""
        plants = [self._plant(point) for point in points]
        lanes = errors_side_by_side(self.predictor, plants)
        alone = [(points[n], plant) for n, plant in enumerate(plants) if plant is not None and n not in lanes]
        runs = iter(parallel_map(lambda pair: self._alone(*pair), alone))
        return [
            Ran(lanes[n], True) if n in lanes else Ran(None if plant is None else next(runs), False)
            for n, plant in enumerate(plants)
        ]

    def derivatives(self, point: Point, pairs: Pairs, near: Floats | None = None, central: bool = False) -> Floats:
        """(N, J, p + c) derivatives of the innovations, by the mechanism's parameters per standard deviation, and by
        parameters of effects per size (`size_of`). Read-only: they are cached.

        near : those about a model near by; a two-mass model takes its derivatives by the mechanism's parameters over;
        central : by small steps to both sides, whose error is of second order.
        Raises ParameterError where the model cannot be run along the log.
        """
        if near is not None and point.two_mass:
            return np.concatenate([near[:, :, : len(point.theta)], self.by_effects(point, pairs)], axis=2)
        return self.predictor.derived(
            (point.key, tuple(pairs), central), lambda: self._derived(point, pairs, central=central)
        )

    def by_effects(self, point: Point, pairs: Pairs) -> Floats:
        """(N, J, c) derivatives by parameters of effects per size. Raises ParameterError as `derivatives`."""
        return self._differences(point, [], pairs, FITTING.effect_difference)

    def _derived(self, point: Point, pairs: Pairs, central: bool) -> Floats:
        share = FITTING.central_difference if central else FITTING.difference
        sides = (share, -share) if central else (share,)
        steps = np.diag(self.mechanism.deviations)
        moved = [[(Point(point.theta + side * step, point.effects), side) for step in steps] for side in sides]
        if not central:
            return self._differences(point, moved[0], pairs, FITTING.effect_difference)
        ahead, behind = (self._differences(point, to, pairs, side) for to, side in zip(moved, sides))
        # a model that cannot be run to one side has the difference to the other
        both = ahead.any(axis=(0, 1)) & behind.any(axis=(0, 1))
        return np.where(both, 0.5, 1.0) * (ahead + behind)

    def _differences(
        self, point: Point, moved: Sequence[tuple[Point, float]], pairs: Pairs, effect_share: float
    ) -> Floats:
        """(N, J, p + c) differences between models with other parameters, each with its share, then with other effects,
        and one near them, over the shares; 0.0 for those that cannot be run."""
        to: list[tuple[Point | None, float]] = [*moved]
        to += [self._further(point, pair, effect_share) for pair in pairs]
        found = self._differences_to(point, to)
        # the other way where the first one is out of bounds
        again = [k for k, column in enumerate(found) if column is None and k >= len(moved)]
        if again:
            back = [self._further(point, pairs[k - len(moved)], -effect_share) for k in again]
            for k, column in zip(again, self._differences_to(point, back)):
                found[k] = column
        out = np.zeros((sum(self.predictor.lengths), self.mechanism.joints, len(found)))
        for k, column in enumerate(found):
            if column is not None:
                out[:, :, k] = column
        return out

    def _differences_to(self, point: Point, to: Sequence[tuple[Point | None, float]]) -> list[Floats | None]:
        """(N, J) differences to models over a share, None where one cannot be run."""
        given = [(n, other) for n, (other, _) in enumerate(to) if other is not None]
        # with the model itself in a lane too, what lanes differ by falls out of the differences
        (first, first_beside), *rest = self.many([point, *(other for _, other in given)])
        if first is None:
            raise cannot_be_run()
        out: list[Floats | None] = [None] * len(to)
        for (n, _), (errors, beside) in zip(given, rest):
            raw = first if first_beside == beside else self.one(point)
            if errors is not None and raw is not None:
                out[n] = (errors - raw) / to[n][1]
        return out

    def _further(self, point: Point, pair: tuple[int, str], share: float) -> tuple[Point | None, float]:
        """The model with a parameter of an effect a share of its size further; None where that is out of bounds."""
        number, name = pair
        effect = point.effects[number]
        effects = with_value(point.effects, number, name, effect.values[name] + share * size_of(effect, name))
        return None if effects is None else Point(point.theta, effects), share

    def _plant(self, point: Point) -> Plant | None:
        try:
            plant = point.plant(self.mechanism)
            # a drive train as fast as this is rigid in any log, and takes millions of steps along it
            return None if plant.least_rate > FITTING.greatest_rate else plant
        except ParameterError:
            return None

    def _alone(self, point: Point, plant: Plant) -> Floats | None:
        try:
            return self.predictor.remembered(point.key, lambda: self.predictor.errors(plant))
        except (NonFiniteStateError, ParameterError):
            return None


def cannot_be_run() -> ParameterError:
    """The error of a start that cannot be run along the log."""
    return ParameterError("a model that cannot be run", where="prediction", expected="the parameters of a fit")
