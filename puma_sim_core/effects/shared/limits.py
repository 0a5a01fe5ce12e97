# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Limits: the law of a quantity that is clipped, and candidates of the limits that a log exceeds."""

from collections.abc import Callable

import numpy as np

from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate
from puma_sim_core.effects.shared.columns import candidate, on_joint, visible
from puma_sim_core.jit import Table, inlined

#: shares of the samples that lie beyond a limit, for the grids of limits
_BEYOND = (0.003, 0.008, 0.016, 0.03, 0.055, 0.09, 0.14, 0.2, 0.28, 0.38, 0.5)
#: shares of the samples that lie below what came through a limit
_THROUGH = (0.5, 0.7, 0.85, 0.95, 0.99)
#: how far the coefficient of an effect without one may come out from 1.00
SHARP = 0.05


@inlined
def clipped(p: Table, k: int, value: float) -> float:
    """The value [V or A] within the limit."""
    if abs(value) <= p[k]:
        return value
    return p[k] if value > 0.0 else -p[k]


def beyond(values: np.ndarray, limit: float) -> np.ndarray:
    """The part of `values` that exceeds a limit in magnitude."""
    return values - np.clip(values, -limit, limit)


def limit_candidates(
    joint: int,
    volts: np.ndarray,
    sharp: float,
    name: str,
    legal: Callable[[float], float],
    unit: float = 1.0,
    through: np.ndarray | None = None,
) -> list[Candidate]:
    """What exceeds a limit with coefficient 1, and its change per volt of the limit, for a grid of limits [V].

    name : of the parameter; legal : limit over unit -> its legal value; through (n,) : volts that came through the
    limit, by the motion.
    """

    def at(limit: float, reach: float) -> Candidate:
        excess = beyond(volts, limit)
        return candidate(
            on_joint(joint, excess, -np.sign(excess)),
            [1.0, 0.0],
            [sharp, reach],
            lambda c, **_: {name: legal((limit + c[1]) / unit)},
            {name: limit / unit},
            VOLTAGE_COLUMN,
            fixed=True,
        )

    return visible(at(limit, reach) for limit, reach in _limits_of(volts, through))


def _limits_of(values: np.ndarray, through: np.ndarray | None) -> list[tuple[float, float]]:
    """Limits that `values` exceeds for a while, each with the reach in which a second column moves it.

    Where hardly any of `values` comes through, the limit is below all of these; it then shows in what does.
    """
    magnitude = np.abs(values)
    levels = np.quantile(magnitude, 1.0 - np.asarray(_BEYOND))
    if through is not None:
        passed = np.quantile(np.abs(through), _THROUGH)
        levels = np.r_[passed, levels] if passed[-1] < levels.min() else levels
    # a signal that is itself clipped ends in a level that it never exceeds
    levels = np.unique(levels[levels < 0.999 * magnitude.max()])
    if levels.size == 0 or levels[-1] <= 0.0:
        return []
    edges = np.concatenate([[levels[0]], levels, [magnitude.max()]])
    return [
        (float(level), float(max(0.3 * (edges[n + 2] - edges[n]), 1e-3 * level)))
        for n, level in enumerate(levels)
        if level > 0.0
    ]
