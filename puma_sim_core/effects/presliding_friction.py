# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Dry friction that acts through an elastic bristle."""

import numpy as np

from puma_sim_core.effects.base import RATE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals, Values
from puma_sim_core.effects.shared.columns import candidate, of_travel, on_joint, recursion, stretches, when_moving
from puma_sim_core.effects.shared.dry_friction import level, level_parameter, level_prior, rate_prior
from puma_sim_core.effects.shared.laws import first
from puma_sim_core.jit import Table, inlined

#: yield deflections of the bristles of a revolute joint [rad]
_YIELD_DEFLECTIONS = np.geomspace(1e-4, 3e-3, 9)

#: stiffness of bristles on machines [N.m/rad]: median, factor of one deviation; it stands in the objective of a fit
STIFFNESS = (1e4, 3.8)


@inlined
def presliding_level(p: Table, k: int, direction: float) -> float:
    """Own sliding level [N.m] of the bristle."""
    return p[k + 1]


@when_moving
def presliding(signals: Signals, joint: int) -> list[Candidate]:
    """Deflection of a bristle under the measured motion over its yield deflection zs, for a grid of zs; the coefficient
    is the sliding level Fc, the stiffness Fc / zs (Dahl 1968)."""
    scale = float(signals.torque_scale[joint])

    def values(c: np.ndarray, yield_deflection: float) -> dict[str, float]:
        torque = level(c[0], "sliding level", scale)
        return {"stiffness": torque / yield_deflection, "torque": torque}

    return [
        candidate(
            on_joint(joint, bristle(signals, joint, zs)), [0.5 * scale], [scale], values, {"yield_deflection": zs}
        )
        for zs in _YIELD_DEFLECTIONS * of_travel(signals, joint)
    ]


def bristle(signals: Signals, joint: int, yield_deflection: float) -> np.ndarray:
    """Deflection (n,) of a bristle over its yield deflection, from -1 to 1.

    The exact solution of z' = qd - |qd| z / zs between samples with a constant velocity: what the model itself steps
    with. A stretch that begins in motion begins with a bent bristle.
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


def coordinates(values: Values, scale: float) -> np.ndarray:
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
            "stiffness", "N.m/rad", 1e-4, 1e6, "sigma0", RATE, (1e3, 1e6), default=2e4, prior=STIFFNESS, inverse=True
        ),
        level_parameter("torque", "sliding level, added to the joint's other dry friction", default=0.0),
    ),
    laws=(Law(Point.LEVEL, presliding_level), Law(Point.BRISTLE_STIFFNESS, first)),
    stiffening=lambda values: (values["stiffness"], 0.0),
    screening=Screening(
        presliding, "Reversals with slow travel of 0.1 to 1 mrad about them.", coordinates=coordinates, size="torque"
    ),
    drawn_against=("velocity",),
    example="presliding_friction:joint=1,torque=8",
)
