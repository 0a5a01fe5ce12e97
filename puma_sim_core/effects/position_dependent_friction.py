# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Dry friction that varies over the range of the joint."""

from math import cos, pi

import numpy as np

from puma_sim_core.effects.base import PLACE, SIZE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Illegal, Screening, Signals, Span, Values
from puma_sim_core.effects.shared.columns import candidate, on_joint, polar, when_moving, whole_range
from puma_sim_core.effects.shared.dry_friction import direction_of, level, level_parameter, level_prior, shape_prior
from puma_sim_core.jit import Table, inlined

#: variation over the position as a share of the level on machines, middle and one deviation
_VARIATION = (0.0, 0.4)
#: share of the greatest level by which the least may come out below zero, by chance
_NEGATIVE = 0.15


@inlined
def position_level(p: Table, k: int, q: float, gravity: float, torque: float) -> float:
    """Level [N.m] at position q [rad]."""
    if p[k + 1] == 0.0:
        return p[k]
    return max(p[k] + p[k + 1] * cos(q - p[k + 2]), 0.0)


@inlined
def has_position_level(p: Table, k: int) -> bool:
    """Whether there is any, somewhere."""
    return p[k] > 0.0 or p[k + 1] > 0.0


@when_moving
def position_dependent(signals: Signals, joint: int) -> list[Candidate]:
    """sgn(qd), cos q sgn(qd) and sin q sgn(qd): level F0 + F1 cos(q - f)."""
    scale = float(signals.torque_scale[joint])
    q, direction = signals.position[:, joint], direction_of(signals, joint)
    reach = whole_range(signals, joint)

    def values(c: np.ndarray) -> dict[str, float]:
        mean = level(c[0], "mean level", scale)
        amplitude, angle = polar(c[1], c[2])
        found = {"torque": mean, "amplitude": amplitude, "angle": angle}
        reason = negative(found, reach, reach)
        if reason is not None:
            raise Illegal(reason)
        return found

    columns = on_joint(joint, direction, np.cos(q) * direction, np.sin(q) * direction)
    return [candidate(columns, [0.5 * scale, 0.0, 0.0], [scale, 0.5 * scale, 0.5 * scale], values)]


def negative(values: Values, _: Span, reach: Span) -> str | None:
    """Where the level would be negative at a position that the joint can reach: friction of no machine is none over a
    part of its range, whatever part of that a log visits. None where it is not."""
    low, high = reach
    places = np.linspace(low, min(high, low + 2.0 * pi), 50)
    levels = values["torque"] + values["amplitude"] * np.cos(places - values["angle"])
    if levels.min() >= -_NEGATIVE * levels.max():
        return None
    return f"negative level {levels.min():.3g} N.m at q = {places[levels.argmin()]:.3g} rad"


def coordinates(values: Values, scale: float) -> np.ndarray:
    """Mean level, and its variation with the cosine and the sine of the position."""
    mean, amplitude, angle = values["torque"], values["amplitude"], values["angle"]
    shapes = [shape_prior(amplitude * part, mean, _VARIATION) for part in (np.cos(angle), np.sin(angle))]
    return np.array([level_prior(mean, scale), *shapes])


def usual(level: float) -> tuple[dict[str, float], ...]:
    """Values of a variation by one deviation about a level [N.m], greatest at either end or side of a turn.

    At no amplitude an angle has no slope, and an amplitude that would have to change its sign stays at zero.
    """
    amplitude = _VARIATION[1] * level
    return tuple({"torque": level, "amplitude": amplitude, "angle": angle} for angle in (0.0, 0.5 * pi, pi, -0.5 * pi))


EFFECT = Kind(
    name="position_dependent_friction",
    order=80,
    acts=TORQUE,
    equation="tau = max(F0 + F1 cos(q - f), 0) sgn(qd); at rest any torque up to it is held",
    sentence="Dry friction that is greater in one part of the joint's range than in another.",
    parameters=(
        level_parameter("torque", "F0, mean level"),
        Parameter("amplitude", "N.m", 0.0, 500.0, "F1, by which it varies", SIZE, (0.4, 30.0)),
        Parameter("angle", "rad", -10.0, 10.0, "f, where it is greatest", PLACE, default=0.0),
    ),
    laws=(Law(Point.POSE_LEVEL, position_level), Law(Point.HAS_POSE_LEVEL, has_position_level)),
    directed=True,
    screening=Screening(
        position_dependent,
        "Reversals over the full range of the joint.",
        coordinates=coordinates,
        size="amplitude",
        usual=usual,
        illegal=negative,
    ),
    drawn_against=("position",),
    example="position_dependent_friction:joint=2,torque=8,amplitude=3",
)
