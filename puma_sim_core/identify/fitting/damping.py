# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How much a step is damped: from a guess to more or less of it, as long as that is better."""

from collections.abc import Callable

from puma_sim_core.identify.settings import FITTING


def best_damping(first: int, cost: Callable[[int], float]) -> int:
    """Number of the damping at which a cost has its minimum nearest to a first one; only some are evaluated."""
    costs: dict[int, float] = {}

    def at(number: int) -> float:
        if number not in costs:
            inside = 0 <= number < len(FITTING.dampings)
            costs[number] = cost(number) if inside else float("inf")
        return costs[number]

    best = first
    for way in (1, -1):
        while at(best + way) < at(best):
            best += way
    return best
