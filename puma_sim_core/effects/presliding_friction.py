# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Dry friction that acts through an elastic bristle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, Parameter, Point, Role
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, is_arm, moves, on_joint, positive, recursion, stretches
from puma_sim_core.effects.shared.dry_friction import MOST, level_prior, rate_prior
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass

#: yield deflections of the bristles of a revolute joint [rad]
_YIELD_DEFLECTIONS = np.geomspace(1e-4, 3e-3, 9)


#: stiffness of bristles on machines [N.m/rad]: median, factor of one deviation; it stands in the objective of a fit.
#: The default of a simulated effect is 2e4 N.m/rad
STIFFNESS = (1e4, 3.8)


@inlined
def presliding_level(p, k, direction):
    """Own sliding level [N.m] of the bristle."""
    return p[k + 1]


@inlined
def bristle_stiffness(p, k):
    """Stiffness [N.m/rad] of the bristle; 0.0 where there is none."""
    return p[k]


def presliding(signals: Signals, joint: int) -> list[Candidate]:
    """Deflection of a bristle under the measured motion over its yield deflection zs, for a grid
    of zs; the coefficient is the sliding level Fc, the stiffness Fc / zs (Dahl 1968)."""
    if not moves(signals, joint):
        return []
    scale = float(signals.torque_scale[joint])
    grid = _YIELD_DEFLECTIONS
    if not is_arm(signals):
        # what the deflection is to the travelled range on the arm
        grid = grid * min(1.0, float(np.ptp(signals.position[:, joint])))
    found = []
    for zs in grid:

        def values(c, zs=float(zs)):
            level = positive(c[0], "sliding level", "N.m", MOST * scale)
            return {"stiffness": level / zs, "torque": level}

        column = bristle(signals, joint, float(zs))
        found.append(
            candidate(on_joint(joint, column), [0.5 * scale], [scale], values, {"yield_deflection": float(zs)})
        )
    return found


def bristle(signals: Signals, joint: int, yield_deflection: float) -> np.ndarray:
    """Deflection (n,) of a bristle over its yield deflection, from -1 to 1.

    The exact solution of z' = qd - |qd| z / zs between samples with a constant velocity: what the
    model itself steps with. A stretch that begins in motion begins with a bent bristle.
    """
    q, qd = signals.position[:, joint], signals.velocity[:, joint]
    out = np.zeros(len(q))
    for part in stretches(signals):
        travel = np.diff(q[part], prepend=q[part.start])
        grown = -np.expm1(-np.abs(travel) / yield_deflection)
        begins = float(qd[part.start])
        start = np.sign(begins) if abs(begins) > 3.0 * signals.velocity_noise[joint] else 0.0
        out[part] = recursion(1.0 - grown, np.sign(travel) * grown, float(start))
    return out


def coordinates(values: Mapping[str, float], scale: float) -> np.ndarray:
    """Level, and stiffness of the bristles."""
    return np.array([level_prior(values["torque"], scale), rate_prior(values["stiffness"], STIFFNESS)])


EFFECT = Kind(
    name="presliding_friction",
    order=50,
    acts=TORQUE,
    equation="tau = sigma0 z, zdot = qd - |qd| z sigma0 / level(qd)  (Dahl 1968)",
    sentence="A joint's dry friction acting through an elastic bristle: like a spring before it "
    "slides, with a hysteresis loop at each reversal.",
    parameters=(
        Parameter(
            "stiffness",
            "N.m/rad",
            1.0,
            1e6,
            "sigma0",
            default=2e4,
            role=Role.RATE,
            plausible=(1e3, 1e6),
            prior=STIFFNESS,
            logarithmic=True,
            inverse=True,
        ),
        Parameter(
            "torque",
            "N.m",
            0.0,
            500.0,
            "sliding level, added to the joint's other dry friction",
            default=0.0,
            plausible=(0.4, 40.0),
        ),
    ),
    laws=(Law(Point.LEVEL, presliding_level), Law(Point.BRISTLE_STIFFNESS, bristle_stiffness)),
    stiffening=lambda values: (values["stiffness"], 0.0),
    screening=Screening(
        presliding,
        excitation="Reversals with slow travel of 0.1 to 1 mrad about them.",
        coordinates=coordinates,
        size="torque",
    ),
    drawn_against=("velocity",),
    example="presliding_friction:joint=1,torque=8",
)
