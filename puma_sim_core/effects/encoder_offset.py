# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A sensor whose zero is not the model's."""

import numpy as np

from puma_sim_core.effects.base import SENSING, SIZE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import ByJoint, Candidate, Screening, Signals, Values
from puma_sim_core.effects.shared.columns import bounded, candidate, sized
from puma_sim_core.effects.shared.laws import first
from puma_sim_core.effects.shared.motion import change_of_voltage


def offset(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the torques of all joints per radian that the position is measured too great."""
    if signals.position_gradient is None:
        return []
    slope = signals.position_gradient[:, :, joint]
    seen = {i: -slope[:, i] for i in range(signals.joints) if np.abs(slope[:, i]).max() > 0.0}
    # a torque that does not know the joint's position, or hardly, shows no offset of it
    if not seen or max(0.3 * np.abs(slope[:, i]).max() / signals.torque_scale[i] for i in seen) < 0.02:
        return []
    return [candidate([seen], [0.0], [0.015], sized("angle", bounded, "offset", "rad", 0.3))]


def known_voltage(signals: Signals, joint: int, values: Values, torque: np.ndarray) -> ByJoint:
    """Change of the model's voltage [V] by what the sensor makes of the position."""
    still = 0.0 * signals.position[:, joint]
    return change_of_voltage(signals, joint, (still - values["angle"], still, still))


EFFECT = Kind(
    name="encoder_offset",
    order=270,
    acts=SENSING,
    equation="m = q + angle",
    sentence="The sensor's zero is not the model's: gravity is felt at other angles than it says.",
    parameters=(Parameter("angle", "rad", -10.0, 10.0, "measured less true position", SIZE, (0.001, 0.05)),),
    laws=(Law(Point.SENSOR_OFFSET, first),),
    shifts_zero=True,
    known_voltage=known_voltage,
    screening=Screening(offset, "Many poses with different torques of gravity."),
    drawn_against=("position",),
    example="encoder_offset:joint=2,angle=0.02",
)
