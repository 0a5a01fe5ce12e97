# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Torque that is periodic in the angle of the motor."""

from __future__ import annotations

from math import sin
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, Parameter, Point, Role
from puma_sim_core.effects.screening import Candidate, Illegal, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, waves
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass

#: periods a turn of the motor
_ORDERS = (1, 2, 3, 4, 6, 7, 8, 12)


@inlined
def ripple_torque(p, k, q, qd):
    """Torque [N.m] at the joint's position q [rad], positive against positive motion."""
    if p[k] == 0.0:
        return 0.0
    return p[k] * sin(p[k + 1] * p[k + 3] * q + p[k + 2])


def ripple(signals: Signals, joint: int) -> list[Candidate]:
    """sin(n N q) and cos(n N q) for the orders n that the log can show.

    The counts of an encoder blur the phase by at most n N times half a count, below 0.1 rad for
    the arm; orders whose waves pass faster than the filters of the screening let through, or of
    which the joint travels less than one, are left out.
    """
    scale, q = float(signals.torque_scale[joint]), signals.position[:, joint]
    found = []
    for order in _ORDERS:
        number = float(order * abs(signals.gear[joint]))
        if number < 6.0 or number * signals.quantum[joint] > 1.5 or not waves(signals, joint, number):
            continue
        # the sign of the ratio is the sign of the motor's angle
        angle = np.remainder(order * float(signals.gear[joint]) * q, 2.0 * np.pi)

        def values(c, order=order):
            amplitude = float(np.hypot(c[0], c[1]))
            if amplitude > 3.0 * scale:
                raise Illegal(f"amplitude {amplitude:.3g} N.m, more than {3.0 * scale:.3g} N.m")
            return {"amplitude": amplitude, "order": float(order), "phase": float(np.arctan2(c[1], c[0]))}

        found.append(
            candidate(
                on_joint(joint, np.sin(angle), np.cos(angle)),
                [0.0, 0.0],
                [0.3 * scale] * 2,
                values,
                {"order": float(order)},
            )
        )
    return found


EFFECT = Kind(
    name="torque_ripple",
    order=210,
    acts=TORQUE,
    equation="tau = A sin(n N q + f)",
    sentence="Torque that comes back with each turn of the motor: cogging, or ripple of its poles.",
    parameters=(
        Parameter("amplitude", "N.m", 0.0, 500.0, "A, at the joint", plausible=(0.3, 10.0)),
        Parameter("order", "1", 0.01, 1000.0, "n, periods a turn of the motor", neutral=1.0, role=Role.STRUCTURE),
        Parameter("phase", "rad", -10.0, 10.0, "f", default=0.0, role=Role.PLACE),
        Parameter(
            "ratio",
            "1",
            -1000.0,
            1000.0,
            "N, motor turns a joint turn",
            neutral=1.0,
            from_arm=lambda arm, joint: float(arm.motors[joint - 1].gear_ratio),
            role=Role.STRUCTURE,
        ),
    ),
    laws=(Law(Point.MOTOR_TORQUE, ripple_torque),),
    fine=True,
    screening=Screening(ripple, excitation="Slow constant speeds, so that the waves pass at less than 12 Hz."),
    drawn_against=("motor_angle", "position"),
    example="torque_ripple:joint=1,amplitude=2,order=2",
)
