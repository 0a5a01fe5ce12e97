# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What acts on the arm from outside: a spring, a base that leans, a blow."""

from __future__ import annotations

from math import hypot, pi, sin
from typing import TYPE_CHECKING

from puma_sim_core.effects.base import SMOOTH, TILT, TIMED, TORQUE, Kind, Parameter
from puma_sim_core.effects.columns import SCREENINGS
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    from puma_sim_core.arm.parameters import ArmParameters

SPRING = Kind(
    name="joint_spring",
    acts=TORQUE,
    stage=SMOOTH,
    screening=SCREENINGS["joint_spring"],
    equation="tau = Ks (q - q0)",
    sentence="A spring across the joint: a balance spring, or a cable that is bent.",
    parameters=(
        Parameter("stiffness", "N.m/rad", 0.0, 1e5, "Ks"),
        Parameter("angle", "rad", -10.0, 10.0, "q0, where it is slack", default=0.0),
    ),
)

BASE_TILT = Kind(
    name="base_tilt",
    acts=TORQUE,
    stage=TILT,
    per_joint=False,
    screening=SCREENINGS["base_tilt"],
    equation="gravity g (x sin(t)/t, y sin(t)/t, -cos(t)) in the base frame, t^2 = x^2 + y^2",
    sentence="The base does not stand upright, so that the weight of the arm turns joint 1 too.",
    parameters=(
        Parameter("x", "rad", -1.5, 1.5, "lean of the base towards its x axis", default=0.0),
        Parameter("y", "rad", -1.5, 1.5, "lean of the base towards its y axis", default=0.0),
    ),
)

IMPULSE = Kind(
    name="impulse",
    acts=TORQUE,
    stage=TIMED,
    screening=SCREENINGS["impulse"],
    equation="tau = -p sin(pi (t - t0 + w/2) / w)^2 while |t - t0| < w/2",
    sentence="A blow or a push of short duration that nothing in the log asks for.",
    parameters=(
        Parameter("torque", "N.m", -1e4, 1e4, "p, peak, positive in +q"),
        Parameter("time", "s", -1e6, 1e9, "t0, middle of the pulse"),
        Parameter("width", "s", 1e-4, 100.0, "w, whole width", neutral=1.0),
    ),
)

KINDS = (SPRING, BASE_TILT, IMPULSE)


@inlined
def spring_torque(p, k, q):
    """Torque [N.m] of the spring at position q [rad], positive against positive motion."""
    return p[k] * (q - p[k + 1])


def tilt_constants(arm: ArmParameters, x: float, y: float) -> tuple[float, ...]:
    """What `tilt_torques` needs of the arm, with its loads, and of the lean (x, y) [rad].

    Components of gravity's direction along x0 and y0 and, less -1, along z0; moments of weight
    [N.m] of link 1 along the arm and of all links beside its plane, that is along z1.
    """
    lean = hypot(x, y)
    share = sin(lean) / lean if lean > 0.0 else 1.0
    link1, link2, link3 = arm.links
    beside = link1.mass * link1.centre[2] + link2.mass * link2.centre[2] + link3.mass * (arm.d3 + link3.centre[1])
    return (
        x * share,
        y * share,
        2.0 * sin(0.5 * lean) ** 2,
        arm.gravity * link1.mass * link1.centre[0],
        arm.gravity * beside,
    )


@inlined
def tilt_torques(x, y, lift, along1, beside, s1, c1, trig, body):
    """Torques [N.m] by which gravity on a leaning base exceeds that on a level one.

    x to beside : `tilt_constants`; s1, c1 : sine and cosine of q1; trig, body as in `kernel`. With
    the arm's plane turned by q1, gravity has the components u along the arm and n beside it; the
    moments of weight along the arm and upward are those of the closed form of G.
    """
    s2, c2, su, cu = trig
    g1, g2, g3, g4 = body[16], body[17], body[18], body[19]
    along3 = g1 * su - g2 * cu
    along2 = g3 * s2 - g4 * c2 + along3
    G3 = g1 * cu + g2 * su
    G2 = g3 * c2 + g4 * s2 + G3
    u = x * c1 + y * s1
    n = y * c1 - x * s1
    return u * beside - n * (along1 - G2), -u * along2 - lift * G2, -u * along3 - lift * G3


@inlined
def pulse_part(share):
    """Share of a pulse's momentum that has come after a share of its width, 0 to 1."""
    if share <= 0.0:
        return 0.0
    if share >= 1.0:
        return 1.0
    return share - sin(2.0 * pi * share) / (2.0 * pi)


@inlined
def pulse_torque(p, k, time, step):
    """Mean torque [N.m] of the pulse from `time` to `time` + `step` [s], positive in +q.

    The mean keeps the momentum of the blow to rounding, however long the steps are. The value at
    an instant comes with step 0.
    """
    if p[k] == 0.0:
        return 0.0
    begin = (time - p[k + 1]) / p[k + 2] + 0.5
    if step > 0.0:
        end = (time + step - p[k + 1]) / p[k + 2] + 0.5
        if end <= 0.0 or begin >= 1.0:
            return 0.0
        return 0.5 * p[k] * (pulse_part(end) - pulse_part(begin)) * p[k + 2] / step
    if begin <= 0.0 or begin >= 1.0:
        return 0.0
    return p[k] * sin(pi * begin) ** 2
