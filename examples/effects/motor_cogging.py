# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Cogging of a motor whose waves are not sines: an example of an effect of your own."""

from math import pi, sin

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, Law, LookAlike, Parameter, Point, Role
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, positive, waves
from puma_sim_core.jit import inlined

#: periods a turn of the motor, and places of a wave, that are tried
_ORDERS, _PHASES = (4, 6, 12), 12


@inlined
def cogging_torque(p, k, q, qd):
    """Torque [N.m] at the joint's position q [rad], positive against positive motion."""
    x = p[k + 1] * p[k + 3] * q + p[k + 2]
    return p[k] * (sin(x) + 0.5 * sin(2.0 * x))


def candidates(signals: Signals, joint: int) -> list[Candidate]:
    """One regressor for each order and place of the wave; its coefficient is the amplitude."""
    gear, scale, found = float(signals.gear[joint]), float(signals.torque_scale[joint]), []

    def values(c, order, phase):
        return {"amplitude": positive(c[0], "amplitude", "N.m", 3.0 * scale), "order": order, "phase": phase}

    for order in _ORDERS:
        if not waves(signals, joint, 2.0 * order * abs(gear)):
            continue
        for phase in 2.0 * np.pi * np.arange(_PHASES) / _PHASES:
            x = order * gear * signals.position[:, joint] + phase
            column = np.sin(x) + 0.5 * np.sin(2.0 * x)
            grid = {"order": order, "phase": phase}
            found.append(candidate(on_joint(joint, column), [0.3 * scale], [0.3 * scale], values, grid))
    return found


EFFECT = Kind(
    name="motor_cogging",
    acts=TORQUE,
    equation="tau = A (sin(n N q + f) + sin(2 (n N q + f)) / 2)",
    sentence="Torque by which the magnets of the motor prefer some angles: steep on one side of each.",
    parameters=(
        Parameter("amplitude", "N.m", 0.0, 500.0, "A, at the joint", plausible=(0.3, 10.0)),
        Parameter("order", "1", 1.0, 100.0, "n, periods a turn of the motor", neutral=1.0, role=Role.STRUCTURE),
        Parameter("phase", "rad", -10.0, 10.0, "f", default=0.0, role=Role.PLACE, step=pi / 8),
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
    laws=(Law(Point.MOTOR_TORQUE, cogging_torque),),
    screening=Screening(candidates, excitation="Slow constant speeds, so that the waves pass at less than 12 Hz."),
    look_alikes=(
        LookAlike("torque_ripple", "the waves are steep on one side", "the waves are sines, without a second harmonic"),
    ),
    drawn_against=("motor_angle", "position"),
    fine=True,
    example="motor_cogging:joint=3,amplitude=1.5,order=4",
)
