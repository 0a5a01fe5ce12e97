# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Dry friction of one level."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, moves, on_joint, positive
from puma_sim_core.effects.shared.dry_friction import MOST, direction_of, level_prior
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass


@inlined
def coulomb_level(p, k, direction):
    """Level [N.m] of symmetric Coulomb friction."""
    return p[k]


def coulomb(signals: Signals, joint: int) -> list[Candidate]:
    """sgn(qd); its coefficient is the level."""
    if not moves(signals, joint):
        return []
    scale = float(signals.torque_scale[joint])

    def values(c):
        return {"torque": positive(c[0], "level", "N.m", MOST * scale)}

    return [candidate(on_joint(joint, direction_of(signals, joint)), [0.5 * scale], [scale], values)]


def coordinates(values: Mapping[str, float], scale: float) -> np.ndarray:
    """The level."""
    return np.array([level_prior(values["torque"], scale)])


EFFECT = Kind(
    name="coulomb_friction",
    order=20,
    acts=TORQUE,
    equation="tau = Fc sgn(qd); at rest any torque up to Fc is held",
    sentence="Dry friction of one level: a step at each reversal, and stick at rest.",
    parameters=(Parameter("torque", "N.m", 0.0, 500.0, "Fc, at the joint", plausible=(0.4, 40.0)),),
    laws=(Law(Point.LEVEL, coulomb_level),),
    screening=Screening(
        coulomb,
        excitation="At least six reversals of the joint, with motion at several speeds.",
        coordinates=coordinates,
    ),
    drawn_against=("velocity",),
    example="coulomb_friction:joint=2,torque=12",
)
