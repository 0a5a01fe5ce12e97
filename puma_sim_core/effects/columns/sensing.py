# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Columns of what the position sensor makes of the position.

With the true motion q = measured + dq, the voltage of the true motion less that of the measured
one is the model's change by dq, on its own joint mostly through back-EMF.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects.columns.common import (
    bounded,
    candidate,
    change_of_voltage,
    derivative,
    moves,
    positive,
    slow_enough,
    visible,
    wave_numbers,
    whole_range,
)
from puma_sim_core.effects.screening import TORQUE_COLUMN, VOLTAGE_COLUMN, Candidate, Illegal, Screening, Signals

#: greatest and least period of a sensor's error, in ranges of the joint: 6 and 0.3 rad on the arm
_LONGEST, _SHORTEST = 1.1, 0.055
#: a sensor's error in ranges of the joint: 0.1 % of it
_ERROR = 1e-3


def lag(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the voltage per second of lag: q = m + T dm/dt, exact for every T but for the
    small change of the rigid body's torques."""
    if not moves(signals, joint):
        return []
    velocity, acceleration = signals.velocity[:, joint], signals.acceleration[:, joint]
    column = change_of_voltage(signals, joint, velocity, acceleration, derivative(acceleration, signals))

    def values(c):
        return {"time_constant": positive(c[0], "lag", "s", 0.1)}

    return [candidate([column], [0.006], [0.008], values, unit=VOLTAGE_COLUMN)]


def offset(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the torques of all joints per radian that the position is measured too great."""
    if signals.position_gradient is None:
        return []
    slope = signals.position_gradient[:, :, joint]
    seen = {i: -slope[:, i] for i in range(signals.joints) if np.abs(slope[:, i]).max() > 0.0}
    # a torque that does not know the joint's position, or hardly, shows no offset of it
    if not seen or max(0.3 * np.abs(slope[:, i]).max() / signals.torque_scale[i] for i in seen) < 0.02:
        return []

    def values(c):
        return {"angle": bounded(c[0], "offset", "rad", 0.3)}

    return [candidate([seen], [0.0], [0.015], values, unit=TORQUE_COLUMN)]


def nonlinearity(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the voltage by sin(2 pi q / P) and cos(2 pi q / P) too much, for a grid of P."""
    if not moves(signals, joint):
        return []
    low, high = whole_range(signals, joint)
    unit = _ERROR * (high - low)
    q, qd = signals.position[:, joint], signals.velocity[:, joint]
    found = []
    for number in wave_numbers(
        signals, joint, 2.0 * np.pi / (_LONGEST * (high - low)), 2.0 * np.pi / (_SHORTEST * (high - low)), drift=0.65
    ):
        if not slow_enough(signals, joint, number):
            continue
        period = float(2.0 * np.pi / number)

        def values(c, period=period):
            amplitude = float(np.hypot(c[0], c[1]))
            if amplitude > 20.0 * unit or 2.0 * np.pi * amplitude >= period:
                raise Illegal(f"error {amplitude:.3g} rad of a sensor with period {period:.3g} rad")
            return {"amplitude": amplitude, "period": period, "phase": float(np.arctan2(c[1], c[0]))}

        columns = [
            change_of_voltage(signals, joint, *(-part for part in motion))
            for motion in wave_motion(q, qd, signals.acceleration[:, joint], number)
        ]
        if visible(tuple(columns)):
            found.append(candidate(columns, [0.0, 0.0], [unit, unit], values, {"period": period}, VOLTAGE_COLUMN))
    return found


def wave_motion(q, qd, qdd, number):
    """(value, rate, acceleration) of sin(number q), and of cos(number q)."""
    s, c = np.sin(number * q), np.cos(number * q)
    first, second = number * qd, number**2 * qd**2
    return ((s, c * first, number * c * qdd - s * second), (c, -s * first, -number * s * qdd - c * second))


SCREENINGS = {
    "sensor_lag": Screening(
        lag,
        look_alikes=(
            (
                "input_delay",
                "the shift is the joint's own and its phase bends with the frequency; "
                "below a third of the cut-off a lag and a delay are the same",
            ),
            ("joint_elasticity", "the shift has no resonance"),
            ("sensor_nonlinearity", "the error follows the speed, not the place"),
        ),
        excitation="A dither above a third of the cut-off frequency.",
        plausible=(("time_constant", 0.001, 0.035),),
        fast=True,
    ),
    "encoder_offset": Screening(
        offset,
        look_alikes=(
            ("payload", "the torque is the slope of gravity's: in quadrature with a weight's"),
            ("base_tilt", "the error turns with the joint, and joint 1 feels no gravity"),
            ("joint_spring", "the torque follows the slope of gravity's torque, not the position"),
            ("voltage_offset", "the torque follows the slope of gravity's torque"),
        ),
        excitation="Many poses with different torques of gravity.",
        plausible=(("angle", 0.001, 0.05),),
    ),
    "sensor_nonlinearity": Screening(
        nonlinearity,
        look_alikes=(
            ("position_dependent_friction", "the error grows with the speed, without a step at reversals"),
            ("transmission_error", "the error goes with back-EMF, so with the speed, more than with load and inertia"),
            ("torque_ripple", "the waves vanish at rest"),
            ("sensor_lag", "the error follows the place, not the speed alone"),
        ),
        excitation="The same places at different speeds.",
        plausible=(("amplitude", 0.0002, 0.02), ("period", 0.3, 7.0)),
    ),
}
