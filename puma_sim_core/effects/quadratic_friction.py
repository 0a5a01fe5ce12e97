# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Drag that grows with the square of the speed."""

import numpy as np

from puma_sim_core.effects.base import SIZE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, fastest, is_arm, on_joint, positive, sized, when_moving
from puma_sim_core.jit import Table, inlined


@inlined
def quadratic_torque(p: Table, k: int, q: float, qd: float) -> float:
    """Drag [N.m] at velocity qd [rad/s]."""
    return p[k] * qd * abs(qd)


@when_moving
def quadratic(signals: Signals, joint: int) -> list[Candidate]:
    """qd |qd|; the coefficient is c."""
    # the arm's drag is that of the nominal friction torque at 1 to 2 rad/s, however slow the log
    speed = max(fastest(signals, joint), 1.0 if is_arm(signals) else 0.0)
    unit = float(signals.torque_scale[joint]) / speed**2
    velocity = signals.velocity[:, joint]
    values = sized("coefficient", positive, "drag coefficient", "N.m.s2/rad2", 20.0 * unit)
    return [candidate(on_joint(joint, velocity * np.abs(velocity)), [0.3 * unit], [0.6 * unit], values)]


EFFECT = Kind(
    name="quadratic_friction",
    order=60,
    acts=TORQUE,
    equation="tau = c qd |qd|",
    sentence="Drag that grows with the square of the speed, as of churned grease or a fan.",
    parameters=(Parameter("coefficient", "N.m.s2/rad2", 0.0, 1e6, "c, at the joint", SIZE, (0.5, 30.0)),),
    laws=(Law(Point.MOTOR_TORQUE, quadratic_torque),),
    screening=Screening(quadratic, "Speeds above half of the greatest, in both directions."),
    drawn_against=("velocity",),
    example="quadratic_friction:joint=1,coefficient=5",
)
