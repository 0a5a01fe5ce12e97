# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A base that leans."""

from __future__ import annotations

from math import cos, hypot, sin
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import SEVERAL_JOINTS, SIZE, TORQUE, Kind, Law, Needs, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import bounded, candidate
from puma_sim_core.jit import Table, Vec, inlined

if TYPE_CHECKING:
    from puma_sim_core.arm.arm import ArmParameters


def tilt_constants(arm: ArmParameters, x: float, y: float) -> tuple[float, ...]:
    """What `tilted` needs of the arm, with its loads, and of the lean (x, y) [rad]: components of gravity's direction
    along x0 and y0 and, less -1, along z0; moments of weight [N.m] of link 1 along the arm and of all links along z1.
    """
    lean = hypot(x, y)
    share = sin(lean) / lean if lean > 0.0 else 1.0
    link1, link2, link3 = arm.links
    beside = link1.mass * link1.centre[2] + link2.mass * link2.centre[2] + link3.mass * (arm.d3 + link3.centre[1])
    along = arm.gravity * link1.mass * link1.centre[0]
    return x * share, y * share, 2.0 * sin(0.5 * lean) ** 2, along, arm.gravity * beside


@inlined
def tilted(p: Table, k: int, width: int, q1: float, trig: Vec, body: Table) -> Vec:
    """Torques [N.m] by which gravity on a leaning base exceeds that on a level one.

    The `tilt_constants` stand joint by joint, `width` numbers apart. Gravity has the components u along the arm and n
    beside it; the moments of weight along the arm and upward are those of the closed form of G.
    """
    x, y, lift, along1, beside = p[k], p[k + 1], p[k + width], p[k + width + 1], p[k + 2 * width]
    s1, c1 = sin(q1), cos(q1)
    s2, c2, su, cu = trig
    g1, g2, g3, g4 = body[16], body[17], body[18], body[19]
    along3 = g1 * su - g2 * cu
    along2 = g3 * s2 - g4 * c2 + along3
    G3 = g1 * cu + g2 * su
    G2 = g3 * c2 + g4 * s2 + G3
    u = x * c1 + y * s1
    n = y * c1 - x * s1
    return u * beside - n * (along1 - G2), -u * along2 - lift * G2, -u * along3 - lift * G3


def base_tilt(signals: Signals, joint: int | None) -> list[Candidate]:
    """Change of gravity's torques on all joints per radian of lean in x and in y."""
    if signals.gravity_tilt is None:
        return []
    columns = [dict(enumerate(axis.T)) for axis in np.moveaxis(signals.gravity_tilt, 2, 0)]

    def values(c: np.ndarray) -> dict[str, float]:
        return {axis: bounded(c[n], f"lean towards {axis}", "rad", 0.35) for n, axis in enumerate("xy")}

    return [candidate(columns, [0.0, 0.0], [0.05, 0.05], values)]


EFFECT = Kind(
    name="base_tilt",
    order=240,
    acts=TORQUE,
    equation="gravity g (x sin(t)/t, y sin(t)/t, -cos(t)) in the base frame, t^2 = x^2 + y^2",
    sentence="The base does not stand upright, so that the weight of the arm turns joint 1 too.",
    parameters=(
        Parameter("x", "rad", -1.5, 1.5, "lean of the base towards its x axis", SIZE, (0.005, 0.15), default=0.0),
        Parameter("y", "rad", -1.5, 1.5, "lean of the base towards its y axis", SIZE, (0.005, 0.15), default=0.0),
    ),
    laws=(Law(Point.ARM_TORQUE, tilted),),
    per_joint=False,
    constants=lambda arm, values: tilt_constants(arm, **values),
    needs=Needs(SEVERAL_JOINTS, "an arm; for one joint it is an offset of the encoder"),
    screening=Screening(base_tilt, "Joint 1 over more than 120 degrees, with the arm stretched out and folded."),
    drawn_against=("position",),
    example="base_tilt:x=0.05,y=0.02",
)
