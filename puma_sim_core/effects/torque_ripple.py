# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Torque that is periodic in the angle of the motor."""

from math import sin

import numpy as np

from puma_sim_core.effects.base import PLACE, SIZE, STRUCTURE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Illegal, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, polar, waves
from puma_sim_core.jit import Table, inlined

#: periods a turn of the motor
_ORDERS = (1, 2, 3, 4, 6, 7, 8, 12)


@inlined
def ripple_torque(p: Table, k: int, q: float, qd: float) -> float:
    """Torque [N.m] at the joint's position q [rad], positive against positive motion."""
    if p[k] == 0.0:
        return 0.0
    return p[k] * sin(p[k + 1] * p[k + 3] * q + p[k + 2])


def ripple(signals: Signals, joint: int) -> list[Candidate]:
    """sin(n N q) and cos(n N q) for the orders n that the log can show.

    The counts of an encoder blur the phase by at most n N times half a count, below 0.1 rad for the arm; orders whose
    waves pass faster than the filters of the screening let through, or of which the joint travels less than one, are
    left out, and so is one wave a turn of the joint: gravity is that.
    """
    scale, gear = float(signals.torque_scale[joint]), float(signals.gear[joint])

    def values(c: np.ndarray, order: float) -> dict[str, float]:
        amplitude, phase = polar(c[0], c[1])
        if amplitude > 3.0 * scale:
            raise Illegal(f"amplitude {amplitude:.3g} N.m, more than {3.0 * scale:.3g} N.m")
        return {"amplitude": amplitude, "order": order, "phase": phase}

    def at(order: int) -> Candidate:
        # the sign of the ratio is the sign of the motor's angle
        angle = np.remainder(order * gear * signals.position[:, joint], 2.0 * np.pi)
        columns = on_joint(joint, np.sin(angle), np.cos(angle))
        return candidate(columns, [0.0, 0.0], [0.3 * scale] * 2, values, {"order": order})

    def shown(number: float) -> bool:
        return number > 1.0 and number * signals.quantum[joint] <= 1.5 and waves(signals, joint, number)

    return [at(order) for order in _ORDERS if shown(order * abs(gear))]


EFFECT = Kind(
    name="torque_ripple",
    order=210,
    acts=TORQUE,
    equation="tau = A sin(n N q + f)",
    sentence="Torque that comes back with each turn of the motor: cogging, or ripple of its poles.",
    parameters=(
        Parameter("amplitude", "N.m", 0.0, 500.0, "A, at the joint", SIZE, (0.3, 10.0)),
        Parameter("order", "1", 0.01, 1000.0, "n, periods a turn of the motor", STRUCTURE, neutral=1.0),
        Parameter("phase", "rad", -10.0, 10.0, "f", PLACE, default=0.0),
        Parameter(
            "ratio",
            "1",
            -1000.0,
            1000.0,
            "N, motor turns a joint turn",
            STRUCTURE,
            neutral=1.0,
            from_arm=lambda arm, joint: float(arm.motors[joint - 1].gear_ratio),
        ),
    ),
    laws=(Law(Point.MOTOR_TORQUE, ripple_torque),),
    fine=True,
    screening=Screening(ripple, "Slow constant speeds, so that the waves pass at less than 12 Hz."),
    drawn_against=("motor_angle", "position"),
    example="torque_ripple:joint=1,amplitude=2,order=2",
)
