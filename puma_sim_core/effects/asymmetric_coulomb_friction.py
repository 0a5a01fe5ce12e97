# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Dry friction with a level of its own in each direction."""

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals, Values
from puma_sim_core.effects.shared.columns import candidate, on_joint, when_moving
from puma_sim_core.effects.shared.dry_friction import direction_of, level, level_parameter, level_prior, shape_prior
from puma_sim_core.jit import Table, inlined

#: difference by direction as a share of the level on machines, middle and one deviation
_DIFFERENCE = (0.0, 0.3)


@inlined
def asymmetric_level(p: Table, k: int, direction: float) -> float:
    """Level [N.m] of Coulomb friction against sliding in `direction` (+1 or -1)."""
    return p[k] if direction > 0.0 else p[k + 1]


@when_moving
def asymmetric_coulomb(signals: Signals, joint: int) -> list[Candidate]:
    """The positive and the negative part of sgn(qd); the coefficients are the two levels."""
    scale, direction = float(signals.torque_scale[joint]), direction_of(signals, joint)
    if min(np.count_nonzero(direction > 0.5), np.count_nonzero(direction < -0.5)) < 0.02 * direction.size:
        return []

    def values(c: np.ndarray) -> dict[str, float]:
        forth, back = level(c[0], "level for qd > 0", scale), level(c[1], "level for qd < 0", scale)
        return {"positive": forth, "negative": back}

    columns = on_joint(joint, np.maximum(direction, 0.0), np.minimum(direction, 0.0))
    return [candidate(columns, [0.5 * scale] * 2, [scale] * 2, values)]


def coordinates(values: Values, scale: float) -> np.ndarray:
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
        level_parameter("positive", "Fp, level for qd > 0"),
        level_parameter("negative", "Fn, level for qd < 0, as a magnitude"),
    ),
    laws=(Law(Point.LEVEL, asymmetric_level),),
    screening=Screening(
        asymmetric_coulomb,
        "Motion in both directions for about equal times, with many reversals.",
        coordinates=coordinates,
    ),
    drawn_against=("velocity",),
    example="asymmetric_coulomb_friction:joint=2,positive=12.6,negative=7.1",
)
