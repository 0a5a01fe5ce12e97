# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Changes of a joint's motion, waves of the position above all, and the voltages that they make."""

import numpy as np

from puma_sim_core.effects.screening import ByJoint, Signals
from puma_sim_core.effects.shared.columns import slow_enough, torque_volts, travelled

#: value, rate and acceleration of a change of motion, (n,) each
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


def change_of_voltage(signals: Signals, joint: int, motion: Motion, motor: bool = True) -> ByJoint:
    """Voltages by which the model's change when a joint's motion does, to first order.

    motor : False where the link's motion changes and the motor's does not. What the velocity does to centripetal and
    Coriolis torques is left out: it is small beside back-EMF.
    """
    dq, dqd, dqdd = motion

    def on_link(i: int, inertia: np.ndarray) -> np.ndarray:
        torque = inertia * dqdd
        return torque if signals.position_gradient is None else torque + signals.position_gradient[:, i, joint] * dq

    own = on_link(joint, signals.link_inertia[:, joint])
    if motor:
        own = own + signals.motor_inertia[joint] * dqdd + signals.viscous[joint] * dqd
    volts = torque_volts(signals, joint, own)
    found = {joint: volts + signals.emf[joint] * dqd if motor else volts}
    if signals.inertia is not None:
        for i in [*range(joint), *range(joint + 1, signals.joints)]:
            found[i] = torque_volts(signals, i, on_link(i, signals.inertia[:, i, joint]))
    return found


def wave_numbers(signals: Signals, joint: int, lowest: float, highest: float, drift: float = 1.0) -> np.ndarray:
    """Wave numbers [1/rad] that pass slowly enough, at most 40, so close that one between two of them is not missed.

    drift : phase [rad] by which two neighbours drift apart from the middle of the travelled range to an end of it.
    """
    low, high = travelled(signals, joint)
    spacing = 2.0 * drift / max(high - low, 1e-9)
    count = int(np.clip(np.ceil((highest - lowest) / spacing) + 1, 2, 40))
    return np.array([n for n in np.linspace(lowest, highest, count) if slow_enough(signals, joint, n)])


def wave_motions(signals: Signals, joint: int, number: float) -> tuple[Motion, Motion]:
    """Motion of sin(number q), and of cos(number q)."""
    q, qd, qdd = (each[:, joint] for each in (signals.position, signals.velocity, signals.acceleration))
    s, c = np.sin(number * q), np.cos(number * q)
    first, second = number * qd, number**2 * qd**2
    return ((s, c * first, number * c * qdd - s * second), (c, -s * first, -number * s * qdd - c * second))


def wave_motion(signals: Signals, joint: int, amplitude: float, number: float, phase: float) -> Motion:
    """Motion of amplitude sin(number q + phase)."""
    q, qd, qdd = (each[:, joint] for each in (signals.position, signals.velocity, signals.acceleration))
    s, c = np.sin(number * q + phase), np.cos(number * q + phase)
    slope = amplitude * number
    return amplitude * s, slope * c * qd, slope * (c * qdd - number * s * qd**2)
