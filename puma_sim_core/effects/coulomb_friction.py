# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Dry friction of one level."""

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, sized, when_moving
from puma_sim_core.effects.shared.dry_friction import direction_of, level, level_parameter, level_prior
from puma_sim_core.jit import Table, inlined


@inlined
def coulomb_level(p: Table, k: int, direction: float) -> float:
    """Level [N.m] of symmetric Coulomb friction."""
    return p[k]


@when_moving
def coulomb(signals: Signals, joint: int) -> list[Candidate]:
    """sgn(qd); its coefficient is the level."""
    scale, columns = float(signals.torque_scale[joint]), on_joint(joint, direction_of(signals, joint))
    return [candidate(columns, [0.5 * scale], [scale], sized("torque", level, "level", scale))]


EFFECT = Kind(
    name="coulomb_friction",
    order=20,
    acts=TORQUE,
    equation="tau = Fc sgn(qd); at rest any torque up to Fc is held",
    sentence="Dry friction of one level: a step at each reversal, and stick at rest.",
    parameters=(level_parameter("torque", "Fc, at the joint"),),
    laws=(Law(Point.LEVEL, coulomb_level),),
    screening=Screening(
        coulomb,
        "At least six reversals of the joint, with motion at several speeds.",
        coordinates=lambda values, scale: np.array([level_prior(values["torque"], scale)]),
        common=lambda torque: {"torque": torque},
    ),
    drawn_against=("velocity",),
    example="coulomb_friction:joint=2,torque=12",
)
