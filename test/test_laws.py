# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The laws as the step calls them equal the laws of the effects' own files, combined as their point says."""

from __future__ import annotations

from functools import reduce
from math import inf
from operator import add, mul

import numpy as np
import pytest

from puma_sim_core.dynamics.laws import combined
from puma_sim_core.effects import registry
from puma_sim_core.effects.base import Point
from puma_sim_core.jit import interpreted

FOLDS = {
    "sum": lambda values: reduce(add, values, 0.0),
    "product": lambda values: reduce(mul, values, 1.0),
    "any": any,
    "least": lambda values: min(values, default=inf),
    "triple": lambda values: tuple(np.sum(values, axis=0)) if values else (0.0, 0.0, 0.0),
}


def apply_each(point: Point, j: int, arguments: list, table: list) -> object:
    """The laws one by one, by calls of their own functions."""
    calls = [(interpreted(function), j * registry.WIDTH + place) for function, place in registry.laws(point)]
    if point.combined == "chain":
        for function, k in calls:
            arguments = [*arguments[:-1], function(table, k, *arguments)]
        return arguments[-1]
    return FOLDS[point.combined]([function(table, k, *arguments) for function, k in calls])


@pytest.mark.parametrize("point", list(Point), ids=lambda point: point.name)
@pytest.mark.parametrize("seed", range(4))
def test_a_point_equals_its_laws_one_by_one(point, seed):
    random = np.random.default_rng([4711, seed])
    table = random.uniform(0.1, 3.0, 3 * registry.WIDTH).tolist()
    law = combined(point, interpreted)
    whole_arm = point in (Point.ARM_TORQUE, Point.SUPPLY_SHARE, Point.DELAY)
    for j in (0,) if whole_arm else range(3):
        arguments = random.uniform(-2.0, 2.0, len([name for name in point.arguments.split(", ") if name])).tolist()
        if point is Point.ARM_TORQUE:
            arguments = [registry.WIDTH, 0.3, tuple(random.uniform(-1.0, 1.0, 4)), tuple(random.normal(size=20))]
        assert law(j, *arguments, table) == apply_each(point, j, arguments, table)
