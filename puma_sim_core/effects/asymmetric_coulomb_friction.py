# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Dry friction with a level of its own in each direction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, moves, on_joint, positive
from puma_sim_core.effects.shared.dry_friction import MOST, direction_of, level_prior, shape_prior
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass


#: difference by direction as a share of the level on machines, middle and one deviation
_DIFFERENCE = (0.0, 0.3)


@inlined
def asymmetric_level(p, k, direction):
    """Level [N.m] of Coulomb friction against sliding in `direction` (+1 or -1)."""
    return p[k] if direction > 0.0 else p[k + 1]


def asymmetric_coulomb(signals: Signals, joint: int) -> list[Candidate]:
    """The positive and the negative part of sgn(qd); the coefficients are the two levels."""
    direction = direction_of(signals, joint)
    forth, back = np.maximum(direction, 0.0), np.minimum(direction, 0.0)
    least = 0.02 * direction.size
    if not moves(signals, joint) or min(np.count_nonzero(forth > 0.5), np.count_nonzero(back < -0.5)) < least:
        return []
    scale = float(signals.torque_scale[joint])

    def values(c):
        return {
            "positive": positive(c[0], "level for qd > 0", "N.m", MOST * scale),
            "negative": positive(c[1], "level for qd < 0", "N.m", MOST * scale),
        }

    return [candidate(on_joint(joint, forth, back), [0.5 * scale] * 2, [scale] * 2, values)]


def coordinates(values: Mapping[str, float], scale: float) -> np.ndarray:
    """Mean level, and half the difference by direction."""
    mean = 0.5 * (values["positive"] + values["negative"])
    half = 0.5 * (values["positive"] - values["negative"])
    return np.array([level_prior(mean, scale), shape_prior(half, mean, _DIFFERENCE)])


EFFECT = Kind(
    name="asymmetric_coulomb_friction",
    order=30,
    acts=TORQUE,
    equation="tau = Fp for qd > 0, -Fn for qd < 0; at rest any torque from -Fn to Fp is held",
    sentence="Dry friction with a level of its own in each direction, as real PUMA drives have.",
    parameters=(
        Parameter("positive", "N.m", 0.0, 500.0, "Fp, level for qd > 0", plausible=(0.4, 40.0)),
        Parameter("negative", "N.m", 0.0, 500.0, "Fn, level for qd < 0, as a magnitude", plausible=(0.4, 40.0)),
    ),
    laws=(Law(Point.LEVEL, asymmetric_level),),
    screening=Screening(
        asymmetric_coulomb,
        excitation="Motion in both directions for about equal times, with many reversals.",
        coordinates=coordinates,
    ),
    drawn_against=("velocity",),
    example="asymmetric_coulomb_friction:joint=2,positive=12.6,negative=7.1",
)
