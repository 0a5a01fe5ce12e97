# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What stands between motor and link: a shaft that twists, teeth with play, a gear not round.

Elasticity and play divide a joint in two masses. `motor_share` of its motor's inertia Ia turns
with the rotor, the rest with the link; position, velocity and friction stay those of the rotor
(over the gear ratio), which is what an encoder on the motor measures, and the link has a position
of its own. `two_mass` integrates both. All laws here are at the joint, torques positive when the
rotor pushes the link forward.
"""

from __future__ import annotations

from math import cos, sin

from puma_sim_core.effects.base import TRANSMISSION, TWO_MASS, Kind, Parameter
from puma_sim_core.effects.columns import SCREENINGS
from puma_sim_core.jit import inlined

_MOTOR_SHARE = Parameter(
    "motor_share",
    "1",
    0.05,
    1.0,
    "part of Ia that turns with the rotor, the rest turns with the link",
    neutral=1.0,
    default=0.7,
)

ELASTICITY = Kind(
    name="joint_elasticity",
    acts=TRANSMISSION,
    stage=TWO_MASS,
    screening=SCREENINGS["joint_elasticity"],
    equation="tau = K (qm - ql) + B (qdm - qdl), motor_share Ia qddm = kT i - H qdm - tau",
    sentence="A drive that twists: the link swings against the rotor, with a resonance and, in "
    "the motor's position, an antiresonance.",
    parameters=(
        Parameter("stiffness", "N.m/rad", 10.0, 1e7, "K, at the joint"),
        Parameter("damping", "N.m.s/rad", 0.0, 1000.0, "B, at the joint", default=5.0),
        _MOTOR_SHARE,
    ),
)

BACKLASH = Kind(
    name="backlash",
    acts=TRANSMISSION,
    stage=TWO_MASS,
    screening=SCREENINGS["backlash"],
    equation="d = qm - ql; tau = max(K (d - g/2) + B dd, 0) for d > g/2, "
    "min(K (d + g/2) + B dd, 0) for d < -g/2, else 0",
    sentence="Play between the teeth: the link is free while they change flanks, and a short knock ends it.",
    parameters=(
        Parameter("gap", "rad", 0.0, 0.2, "g, the whole play at the joint"),
        Parameter("stiffness", "N.m/rad", 100.0, 1e7, "K of the teeth in contact", default=2e5),
        Parameter("damping", "N.m.s/rad", 0.0, 1000.0, "B of the teeth in contact", default=100.0),
        _MOTOR_SHARE,
    ),
)

TRANSMISSION_ERROR = Kind(
    name="transmission_error",
    acts=TRANSMISSION,
    stage=TWO_MASS,
    screening=SCREENINGS["transmission_error"],
    equation="ql = qm + e sin(n qm + f)",
    sentence="A gear that is not round: the link leads and trails the motor as it turns, and the "
    "arm's inertia and weight push back through it.",
    parameters=(
        Parameter("amplitude", "rad", 0.0, 0.05, "e"),
        Parameter("order", "1", 0.0, 1000.0, "n, periods in a turn of the joint", default=1.0),
        Parameter("phase", "rad", -10.0, 10.0, "f", default=0.0),
    ),
)

KINDS = (ELASTICITY, BACKLASH, TRANSMISSION_ERROR)

#: a joint's numbers in the drive trains' table: 1.0 if link and rotor are two masses, K, B, half
#: the gap, inertia of the rotor, e, n, f
TRAIN_WIDTH = 8
_SOFT, _K, _B, _HALF_GAP, _INERTIA, _AMPLITUDE, _ORDER, _PHASE = range(TRAIN_WIDTH)


def in_series(springs: list[tuple[float, float]]) -> tuple[float, float]:
    """(K, B) of (K, B) one behind the other: exact at rest, losses to first order in B w / K."""
    if len(springs) == 1:
        return springs[0]
    compliance = sum(1.0 / stiffness for stiffness, _ in springs)
    loss = sum(damping / stiffness**2 for stiffness, damping in springs)
    return 1.0 / compliance, loss / compliance**2


@inlined
def is_soft(p, k):
    """Whether link and rotor are two masses; k is where the joint's train starts in p."""
    return p[k + _SOFT] != 0.0


@inlined
def rotor_inertia(p, k):
    """What turns with the rotor of a soft joint, or all of Ia [kg.m^2]."""
    return p[k + _INERTIA]


@inlined
def gear_output(p, k, q):
    """(u, du/dq, d2u/dq2) of the gear's output angle u [rad] at the motor's q."""
    amplitude = p[k + _AMPLITUDE]
    if amplitude == 0.0:
        return q, 1.0, 0.0
    order = p[k + _ORDER]
    angle = order * q + p[k + _PHASE]
    s = amplitude * sin(angle)
    return q + s, 1.0 + amplitude * order * cos(angle), -order * order * s


@inlined
def transmitted(p, k, twist, rate):
    """Torque [N.m] that the rotor gives a soft joint's link: twist = u - ql [rad], its rate.

    Teeth push and never pull: where the damping would make them, they give nothing.
    """
    half, torque = p[k + _HALF_GAP], p[k + _B] * rate
    if half == 0.0:
        return p[k + _K] * twist + torque
    if twist > half:
        return max(p[k + _K] * (twist - half) + torque, 0.0)
    if twist < -half:
        return min(p[k + _K] * (twist + half) + torque, 0.0)
    return 0.0


@inlined
def twist_under(p, k, torque):
    """Twist u - ql [rad] at which a soft joint at rest bears `torque` [N.m]."""
    half = p[k + _HALF_GAP]
    if torque < 0.0:
        half = -half
    return half + torque / p[k + _K]
