# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Dry friction that rises as the joint slows down."""

from __future__ import annotations

from collections.abc import Mapping
from math import exp
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, Parameter, Point, Role
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, fastest, is_arm, moves, on_joint, positive
from puma_sim_core.effects.shared.dry_friction import MOST, direction_of, level_prior, rate_prior, shape_prior
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass

#: share of a bump by which the sliding level below it may come out negative
_SLACK = 0.2

#: Stribeck velocities of a revolute joint [rad/s]
_STRIBECK_VELOCITIES = np.geomspace(0.008, 0.15, 8)

#: past this exponent the Stribeck bump is below the last bit of any level it is added to
_NEGLIGIBLE_EXPONENT = 40.0


#: excess as a share of the sliding level on machines, middle and one deviation
_EXCESS = (0.65, 0.3)
#: Stribeck velocity on machines [rad/s]: median, factor of one deviation; it stands in the objective of a fit. The
#: default of a simulated effect is 0.05 rad/s
VELOCITY = (0.045, 1.8)


@inlined
def stribeck_level(p, k, speed):
    """Excess [N.m] over the sliding level at `speed` [rad/s]."""
    if p[k] == 0.0 or speed == 0.0:
        return p[k]
    ratio = speed / p[k + 1]
    ratio *= ratio
    return p[k] * exp(-ratio) if ratio < _NEGLIGIBLE_EXPONENT else 0.0


@inlined
def stribeck_sliding_level(p, k, direction):
    """Coulomb level [N.m] under the Stribeck bump."""
    return p[k + 2]


def stribeck(signals: Signals, joint: int) -> list[Candidate]:
    """sgn(qd) and exp(-(qd/vs)^2) sgn(qd), for a grid of vs."""
    if not moves(signals, joint):
        return []
    scale = float(signals.torque_scale[joint])
    velocity, direction = signals.velocity[:, joint], direction_of(signals, joint)
    top = fastest(signals, joint)
    found = []
    grid = _STRIBECK_VELOCITIES
    if not is_arm(signals):
        grid = grid * min(1.0, top)
    for vs in grid:
        # below the noise the bump is the blur of the estimate; near the top speed it is a level
        if vs < signals.velocity_noise[joint] or vs > 0.7 * top:
            continue

        def values(c, vs=float(vs)):
            # a bump may leave so little level that viscous friction takes it, or a name before it
            # has
            level = max(c[0], 0.0) if c[0] > -_SLACK * c[1] else c[0]
            return {
                "torque": positive(c[1], "excess over the sliding level", "N.m", MOST * scale),
                "velocity": vs,
                "sliding": positive(level, "sliding level", "N.m", MOST * scale),
            }

        bump = np.exp(-((velocity / vs) ** 2)) * direction
        found.append(
            candidate(
                on_joint(joint, direction, bump),
                [0.5 * scale, 0.4 * scale],
                [scale, 0.6 * scale],
                values,
                {"velocity": float(vs)},
            )
        )
    return found


def coordinates(values: Mapping[str, float], scale: float) -> np.ndarray:
    """Sliding level, excess over it, and velocity."""
    return np.array(
        [
            level_prior(values["sliding"], scale),
            shape_prior(values["torque"], values["sliding"], _EXCESS),
            rate_prior(values["velocity"], VELOCITY),
        ]
    )


def usual(level: float) -> dict[str, float]:
    """Values of a bump of the middle shape whose friction is about a level [N.m]."""
    sliding = level / (1.0 + 0.5 * _EXCESS[0])
    return {"torque": _EXCESS[0] * sliding, "sliding": sliding, "velocity": VELOCITY[0]}


EFFECT = Kind(
    name="stribeck_friction",
    order=40,
    acts=TORQUE,
    equation="tau = (Fc + Fs exp(-(qd/vs)^2)) sgn(qd), on top of other dry friction",
    sentence="The extra dry friction at very low speed that makes an arm jerk when it crawls.",
    parameters=(
        Parameter("torque", "N.m", 0.0, 500.0, "Fs, excess over the sliding level", plausible=(0.4, 30.0)),
        Parameter(
            "velocity",
            "rad/s",
            1e-4,
            5.0,
            "vs, Stribeck velocity",
            neutral=1.0,
            default=0.05,
            role=Role.RATE,
            plausible=(0.008, 0.15),
            prior=VELOCITY,
            logarithmic=True,
        ),
        Parameter("sliding", "N.m", 0.0, 500.0, "Fc, Coulomb level under the bump", default=0.0, plausible=(0.0, 40.0)),
    ),
    laws=(Law(Point.LEVEL, stribeck_sliding_level, 1), Law(Point.SPEED_LEVEL, stribeck_level)),
    screening=Screening(
        stribeck,
        excitation="Crawling at 0.01 to 0.2 rad/s, for example slow triangles of the position.",
        coordinates=coordinates,
        usual=usual,
    ),
    drawn_against=("velocity",),
    example="stribeck_friction:joint=3,torque=3,sliding=4",
)
