# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Dry friction that rises as the joint slows down."""

from math import exp

import numpy as np

from puma_sim_core.effects.base import RATE, SIZE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals, Values
from puma_sim_core.effects.shared.columns import candidate, fastest, is_arm, on_joint, when_moving
from puma_sim_core.effects.shared.dry_friction import (
    direction_of,
    level,
    level_parameter,
    level_prior,
    rate_prior,
    shape_prior,
)
from puma_sim_core.jit import Table, inlined

#: share of a bump by which the sliding level below it may come out negative
_SLACK = 0.2
#: Stribeck velocities of a revolute joint [rad/s]
_STRIBECK_VELOCITIES = np.geomspace(0.008, 0.15, 8)
#: past this exponent the Stribeck bump is below the last bit of any level it is added to
_NEGLIGIBLE_EXPONENT = 40.0
#: excess as a share of the sliding level on machines, middle and one deviation
_EXCESS = (0.65, 0.3)
#: Stribeck velocity on machines [rad/s]: median, factor of one deviation; it stands in the objective of a fit
_VS = (0.045, 1.8)


@inlined
def stribeck_level(p: Table, k: int, speed: float) -> float:
    """Excess [N.m] over the sliding level at `speed` [rad/s]."""
    if p[k] == 0.0 or speed == 0.0:
        return p[k]
    ratio = speed / p[k + 1]
    ratio *= ratio
    return p[k] * exp(-ratio) if ratio < _NEGLIGIBLE_EXPONENT else 0.0


@inlined
def stribeck_sliding_level(p: Table, k: int, direction: float) -> float:
    """Coulomb level [N.m] under the Stribeck bump."""
    return p[k + 2]


@when_moving
def stribeck(signals: Signals, joint: int) -> list[Candidate]:
    """sgn(qd) and exp(-(qd/vs)^2) sgn(qd), for a grid of vs."""
    scale, top = float(signals.torque_scale[joint]), fastest(signals, joint)
    qd, direction = signals.velocity[:, joint], direction_of(signals, joint)
    velocities = _STRIBECK_VELOCITIES * (1.0 if is_arm(signals) else min(1.0, top))

    def values(c: np.ndarray, velocity: float) -> dict[str, float]:
        # a bump may leave so little level that viscous friction takes it, or a name before it has
        sliding = max(c[0], 0.0) if c[0] > -_SLACK * c[1] else c[0]
        return {
            "torque": level(c[1], "excess over the sliding level", scale),
            "velocity": velocity,
            "sliding": level(sliding, "sliding level", scale),
        }

    def at(vs: float) -> Candidate:
        columns = on_joint(joint, direction, np.exp(-((qd / vs) ** 2)) * direction)
        return candidate(columns, [0.5 * scale, 0.4 * scale], [scale, 0.6 * scale], values, {"velocity": vs})

    # below the noise the bump is the blur of the estimate; near the top speed it is a level
    return [at(vs) for vs in velocities if not (vs < signals.velocity_noise[joint] or vs > 0.7 * top)]


def coordinates(values: Values, scale: float) -> np.ndarray:
    """Sliding level, excess over it, and velocity."""
    sliding, excess = values["sliding"], values["torque"]
    shape = shape_prior(excess, sliding, _EXCESS)
    return np.array([level_prior(sliding, scale), shape, rate_prior(values["velocity"], _VS)])


def usual(level: float) -> tuple[dict[str, float], ...]:
    """Values of a bump of the middle shape whose friction is about a level [N.m]."""
    sliding = level / (1.0 + 0.5 * _EXCESS[0])
    return ({"torque": _EXCESS[0] * sliding, "sliding": sliding, "velocity": _VS[0]},)


EFFECT = Kind(
    name="stribeck_friction",
    order=40,
    acts=TORQUE,
    equation="tau = (Fc + Fs exp(-(qd/vs)^2)) sgn(qd), on top of other dry friction",
    sentence="The extra dry friction at very low speed that makes an arm jerk when it crawls.",
    parameters=(
        Parameter("torque", "N.m", 0.0, 500.0, "Fs, excess over the sliding level", SIZE, (0.4, 30.0)),
        Parameter(
            "velocity",
            "rad/s",
            1e-4,
            5.0,
            "vs, Stribeck velocity",
            RATE,
            (0.008, 0.15),
            neutral=1.0,
            default=0.05,
            prior=_VS,
        ),
        level_parameter("sliding", "Fc, Coulomb level under the bump", default=0.0, least=0.0),
    ),
    laws=(Law(Point.LEVEL, stribeck_sliding_level, 1), Law(Point.SPEED_LEVEL, stribeck_level)),
    screening=Screening(
        stribeck,
        "Crawling at 0.01 to 0.2 rad/s, for example slow triangles of the position.",
        coordinates=coordinates,
        usual=usual,
    ),
    drawn_against=("velocity",),
    example="stribeck_friction:joint=3,torque=3,sliding=4",
)
