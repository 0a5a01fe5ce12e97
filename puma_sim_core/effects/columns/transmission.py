# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Columns of what stands between motor and link: a shaft that twists, play, a gear not round.

Torque that the model of a rigid joint passes on to the link (with the part of Ia that turns with
it) against what the simulated part passes on under the measured motion of the motor.
"""

from __future__ import annotations

from math import ceil

import numpy as np

from puma_sim_core.effects.columns.common import (
    candidate,
    change_of_voltage,
    is_arm,
    moves,
    slow_enough,
    stretches,
    torque_volts,
    visible,
    wave_numbers,
)
from puma_sim_core.effects.columns.sensing import wave_motion
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Illegal, Screening, Signals
from puma_sim_core.jit import compiled

#: part of Ia that turns with the rotor (the kinds' default)
_MOTOR_SHARE = 0.7
#: frequencies [Hz] of the link against a locked rotor, with the shares of critical damping. Real
#: drives are damped less, but then noise of the motion rings in the simulated link, and its phase
#: is lost unless the frequency is known to a percent.
_RESONANCES = ((0.05, np.geomspace(3.0, 45.0, 28)), (0.15, np.geomspace(3.0, 45.0, 16)))
#: stiffnesses of the arm's drives [N.m/rad], beyond the library's on both sides
_STIFFNESSES = (2e3, 1.2e5)
#: plays [rad], and stiffness and damping of teeth in contact on the arm (the kind's defaults)
_GAPS = np.geomspace(1.5e-4, 4e-3, 13)
_CONTACT_STIFFNESS, _CONTACT_DAMPING = 2e5, 100.0
#: least share of critical damping of the contact. The rotor recoils from a knock, and back-EMF
#: damps it, faster than the filtered motion shows: with the damping of the teeth alone the
#: simulated link would bounce where the real one does not.
_LEAST_DAMPING = 0.8
#: time [s] over which the torque that a stretch begins with is averaged
_BEGINNING = 0.02
#: orders of a gear's error in a turn of the joint, and their usual amplitude [rad]
_ORDERS, _ERROR = (1.0, 40.0), 4e-4


def elasticity(signals: Signals, joint: int) -> list[Candidate]:
    """Torque through an elastic shaft less that through a rigid one, with coefficient 1, for a
    grid of the link's frequency and of the damping."""
    if not moves(signals, joint):
        return []
    inertia, torque = link_side(signals, joint)
    mean = float(inertia.mean())
    found = []
    for damping_ratio, frequencies in _RESONANCES:
        for frequency in frequencies:
            stiffness = float(mean * (2.0 * np.pi * frequency) ** 2)
            if is_arm(signals) and not _STIFFNESSES[0] <= stiffness <= _STIFFNESSES[1]:
                continue
            damping = float(2.0 * damping_ratio * np.sqrt(stiffness * mean))

            def values(c, stiffness=stiffness, damping=damping):
                return {"stiffness": stiffness, "damping": damping}

            passed = shaft_torque(signals, torque, inertia, stiffness, damping)
            found.append(
                candidate(
                    [on_links(signals, joint, passed - torque, inertia)],
                    [1.0],
                    [0.12],
                    values,
                    {"stiffness": stiffness, "damping": damping},
                    VOLTAGE_COLUMN,
                    fixed=True,
                )
            )
    return found


def backlash(signals: Signals, joint: int) -> list[Candidate]:
    """Torque through teeth with play less that through a rigid joint, with coefficient 1, for a
    grid of the gap."""
    if not moves(signals, joint):
        return []
    inertia, torque = link_side(signals, joint)
    stiffness, damping, gaps = _CONTACT_STIFFNESS, _CONTACT_DAMPING, _GAPS
    if not is_arm(signals):
        mean = float(inertia.mean())
        stiffness = mean * (2.0 * np.pi * 60.0) ** 2
        damping = 0.3 * float(np.sqrt(stiffness * mean))
        gaps = gaps * min(1.0, float(np.ptp(signals.position[:, joint])))
    contact = {"stiffness": float(stiffness), "damping": float(damping)}
    found = []
    for gap in gaps:

        def values(c, gap=float(gap)):
            return {"gap": gap, **contact}

        passed = tooth_torque(signals, torque, inertia, float(gap), stiffness, damping)
        column = on_links(signals, joint, passed - torque, inertia)
        if visible((column,)):
            found.append(candidate([column], [1.0], [0.15], values, {"gap": float(gap)}, VOLTAGE_COLUMN, fixed=True))
    return found


def transmission_error(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the voltage by a link at q + sin(n q) and at q + cos(n q), for a grid of n."""
    if not moves(signals, joint):
        return []
    unit = _ERROR if is_arm(signals) else _ERROR * min(1.0, float(np.ptp(signals.position[:, joint])))
    q, qd = signals.position[:, joint], signals.velocity[:, joint]
    link = signals.link_torque[:, joint]
    found = []
    for order in wave_numbers(signals, joint, *_ORDERS):
        if not slow_enough(signals, joint, order):
            continue
        columns = []
        for n, motion in enumerate(wave_motion(q, qd, signals.acceleration[:, joint], order)):
            column = change_of_voltage(signals, joint, *motion, motor=False)
            slope = order * (np.cos(order * q) if n == 0 else -np.sin(order * q))
            column[joint] = column[joint] + torque_volts(signals, joint, slope * link)
            columns.append(column)

        def values(c, order=float(order)):
            amplitude = float(np.hypot(c[0], c[1]))
            if amplitude > 25.0 * unit or amplitude * order >= 0.5:
                raise Illegal(f"error {amplitude:.3g} rad of a gear of order {order:.3g}")
            return {"amplitude": amplitude, "order": order, "phase": float(np.arctan2(c[1], c[0]))}

        if visible(tuple(columns)):
            found.append(candidate(columns, [0.0, 0.0], [unit, unit], values, {"order": float(order)}, VOLTAGE_COLUMN))
    return found


def link_side(signals: Signals, joint: int) -> tuple[np.ndarray, np.ndarray]:
    """Inertia (n,) [kg.m^2] on the link's side, and the torque (n,) [N.m] that moves it rigidly."""
    beside = (1.0 - _MOTOR_SHARE) * float(signals.motor_inertia[joint])
    inertia = signals.link_inertia[:, joint] + beside
    least = 0.05 * float(np.abs(inertia).max())
    torque = signals.link_torque[:, joint] + beside * signals.acceleration[:, joint]
    return np.maximum(inertia, least), torque


def on_links(signals: Signals, joint: int, torque: np.ndarray, inertia: np.ndarray) -> dict[int, np.ndarray]:
    """Voltages of a torque that the joint's link gets besides the rigid one; its acceleration,
    torque / inertia, shakes the other joints."""
    found = {joint: torque_volts(signals, joint, torque)}
    if signals.inertia is not None:
        for i in range(signals.joints):
            if i != joint:
                shaken = signals.inertia[:, i, joint] / inertia * torque
                found[i] = torque_volts(signals, i, shaken)
    return found


def shaft_torque(signals: Signals, torque, inertia, stiffness: float, damping: float):
    """Torque (n,) [N.m] through a shaft K, B under the measured motion of its rotor.

    The twist d obeys M d'' + B d' + K d = torque, the one of a rigid shaft: solved exactly
    between samples for a torque that changes linearly and an inertia that stays.
    """
    step = signals.step
    decay = damping / (2.0 * inertia)
    turn = np.sqrt(np.maximum(stiffness / inertia - decay**2, 1e-12))
    shrunk = np.exp(-decay * step)
    s, c = shrunk * np.sin(turn * step) / turn, shrunk * np.cos(turn * step)
    flow = np.stack([c + decay * s, s, -(stiffness / inertia) * s, c - decay * s], axis=1)
    out = np.empty_like(torque)
    for part in stretches(signals):
        static = np.ascontiguousarray(torque[part]) / stiffness
        twist, rate = _swing(
            np.ascontiguousarray(flow[part]), static, step, damping / stiffness, _beginning(signals, static)
        )
        out[part] = stiffness * twist + damping * rate
    return out


@compiled
def _swing(flow, static, step, lag, begins):
    """Twist and its rate (n,), from rest at a twist on; flow (n, 4) steps the free motion."""
    twist, rate = static.copy(), static.copy()
    d = begins
    v = 0.0
    twist[0] = d
    rate[0] = 0.0
    for i in range(static.size - 1):
        slope = (static[i + 1] - static[i]) / step
        # beside the motion that the ramp of the torque forces, the shaft swings freely
        y = d - static[i] + lag * slope
        w = v - slope
        d = flow[i, 0] * y + flow[i, 1] * w + static[i + 1] - lag * slope
        v = flow[i, 2] * y + flow[i, 3] * w + slope
        twist[i + 1] = d
        rate[i + 1] = v
    return twist, rate


def tooth_torque(signals: Signals, torque, inertia, gap: float, stiffness: float, damping: float):
    """Torque (n,) [N.m] through teeth with a play of `gap` under the measured motion of the rotor,
    averaged over a sample: a knock is shorter than one.

    The damping is at least 0.8 of the critical one of the link: filtered, the rotor's motion has
    lost what keeps the real link from bouncing.
    """
    damping = max(damping, float(2.0 * _LEAST_DAMPING * np.sqrt(stiffness * inertia.mean())))
    fastest = float(np.sqrt(stiffness / inertia.min()))
    parts = max(int(ceil(signals.step * fastest / 0.12)), 1)
    out = np.empty_like(torque)
    for part in stretches(signals):
        out[part] = _knock(
            np.ascontiguousarray(torque[part]),
            np.ascontiguousarray(inertia[part]),
            signals.step / parts,
            parts,
            0.5 * gap,
            stiffness,
            damping,
            _beginning(signals, torque[part]),
        )
    return out


def _beginning(signals: Signals, values: np.ndarray) -> float:
    """Value that a stretch begins with: where filters end, the first sample alone is a poor one."""
    return float(values[: max(int(round(_BEGINNING / signals.step)), 1)].mean())


@compiled
def _knock(torque, inertia, step, parts, half, stiffness, damping, begins):
    """Torque (n,) of the teeth, each value the mean over the two half intervals about it."""
    out = torque.copy()
    twist = begins / stiffness + (half if begins > 0.0 else -half)
    rate = 0.0
    before = begins
    for i in range(torque.size - 1):
        total = 0.0
        for n in range(parts):
            passed = 0.0
            if twist > half:
                passed = max(stiffness * (twist - half) + damping * rate, 0.0)
            elif twist < -half:
                passed = min(stiffness * (twist + half) + damping * rate, 0.0)
            total += passed
            asked = torque[i] + (torque[i + 1] - torque[i]) * ((n + 0.5) / parts)
            rate += step * (asked - passed) / inertia[i]
            twist += step * rate
        mean = total / parts
        out[i] = 0.5 * (before + mean)
        before = mean
    out[torque.size - 1] = before
    return out


SCREENINGS = {
    "transmission_error": Screening(
        transmission_error,
        look_alikes=(
            ("torque_ripple", "the torque grows with load, speed and acceleration"),
            (
                "sensor_nonlinearity",
                "the motor's back-EMF has no part in it: the error is in the link's position, not in the measured one",
            ),
        ),
        excitation="The same range at two speeds, with load.",
        plausible=(("amplitude", 5e-5, 3e-3), ("order", 1.0, 40.0)),
        fast=True,
    ),
    "joint_elasticity": Screening(
        elasticity,
        look_alikes=(
            ("input_delay", "the link swings at a frequency of its own, on this joint"),
            ("sensor_lag", "the link swings at a frequency of its own"),
            ("backlash", "the shaft twists in proportion to the torque, also without a change of its sign"),
            ("presliding_friction", "the twist follows the transmitted torque, not the travel after a reversal"),
        ),
        excitation="A dither or chirp up to 15 Hz, best without feedback.",
        plausible=(("stiffness", 2e3, 1e5),),
        fast=True,
    ),
    "backlash": Screening(
        backlash,
        look_alikes=(
            ("impulse", "the knocks come at each change of sign of the transmitted torque"),
            ("joint_elasticity", "the link swings only where the transmitted torque changes its sign"),
            ("presliding_friction", "the knocks come where the transmitted torque changes its sign, not the velocity"),
            ("coulomb_friction", "nothing is lost between the knocks"),
            ("stribeck_friction", "the knocks come at changes of sign of the transmitted torque, not at low speed"),
        ),
        excitation="Changes of sign of the torque at the link: bang-bang on joint 1, upright or "
        "hanging links on joints 2 and 3.",
        plausible=(("gap", 5e-5, 5e-3),),
        fast=True,
        unseen=(("gap", 2e-4), ("stiffness", 5e5), ("damping", 150.0)),
        # a knock is over long before the next row: what is left of it tells the energy that it
        # took, which many a pair of stiffness and damping takes
        prior=(("stiffness", 5e5, 2.5), ("damping", 150.0, 2.5)),
    ),
}
