# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A joint whose link does not follow its motor exactly: laws of its drive train, and what they cost in volts.

A spring divides a joint in two masses. `motor_share` of its motor's inertia Ia turns with the rotor, the rest with the
link; position, velocity and friction stay those of the rotor (over the gear ratio), and the link has a position of its
own. `dynamics.two_mass` integrates both. All laws are at the joint, torques positive when the rotor pushes the link.
"""

from math import cos, sin

import numpy as np

from puma_sim_core.effects.base import STRUCTURE, Parameter
from puma_sim_core.effects.screening import ByJoint, Signals
from puma_sim_core.effects.shared.columns import torque_volts
from puma_sim_core.jit import Table, Vec, inlined

#: part of Ia that turns with the rotor
_MOTOR_SHARE = 0.7
MOTOR_SHARE = Parameter(
    "motor_share",
    "1",
    0.05,
    1.0,
    "part of Ia that turns with the rotor, the rest turns with the link",
    STRUCTURE,
    neutral=1.0,
    default=_MOTOR_SHARE,
)
#: time [s] over which the torque that a stretch begins with is averaged
_BEGINNING = 0.02
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
def is_soft(p: Table, k: int) -> bool:
    """Whether link and rotor are two masses; k is where the joint's train starts in p."""
    return p[k + _SOFT] != 0.0


@inlined
def rotor_inertia(p: Table, k: int) -> float:
    """What turns with the rotor of a soft joint, or all of Ia [kg.m^2]."""
    return p[k + _INERTIA]


@inlined
def gear_output(p: Table, k: int, q: float) -> Vec:
    """(u, du/dq, d2u/dq2) of the gear's output angle u [rad] at the motor's q."""
    amplitude = p[k + _AMPLITUDE]
    if amplitude == 0.0:
        return q, 1.0, 0.0
    order = p[k + _ORDER]
    angle = order * q + p[k + _PHASE]
    s = amplitude * sin(angle)
    return q + s, 1.0 + amplitude * order * cos(angle), -order * order * s


@inlined
def transmitted(p: Table, k: int, twist: float, rate: float) -> float:
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
def twist_under(p: Table, k: int, torque: float) -> float:
    """Twist u - ql [rad] at which a soft joint at rest bears `torque` [N.m]."""
    half = p[k + _HALF_GAP]
    if torque < 0.0:
        half = -half
    return half + torque / p[k + _K]


def link_side(signals: Signals, joint: int) -> tuple[np.ndarray, np.ndarray]:
    """Inertia (n,) [kg.m^2] on the link's side, and the torque (n,) [N.m] that moves it rigidly."""
    beside = (1.0 - _MOTOR_SHARE) * float(signals.motor_inertia[joint])
    inertia = signals.link_inertia[:, joint] + beside
    torque = signals.link_torque[:, joint] + beside * signals.acceleration[:, joint]
    return np.maximum(inertia, 0.05 * float(np.abs(inertia).max())), torque


def on_links(signals: Signals, joint: int, torque: np.ndarray, inertia: np.ndarray) -> ByJoint:
    """Voltages of a torque that the joint's link gets besides the rigid one; its acceleration, torque / inertia, shakes
    the other joints."""
    found = {joint: torque_volts(signals, joint, torque)}
    if signals.inertia is not None:
        for i in [*range(joint), *range(joint + 1, signals.joints)]:
            found[i] = torque_volts(signals, i, signals.inertia[:, i, joint] / inertia * torque)
    return found


def beginning(signals: Signals, values: np.ndarray) -> float:
    """Value that a stretch begins with: where filters end, the first sample alone is a poor one."""
    return float(values[: max(int(round(_BEGINNING / signals.step)), 1)].mean())
