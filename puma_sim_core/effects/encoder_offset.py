# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A sensor whose zero is not the model's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import SENSING, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import TORQUE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import bounded, candidate, change_of_voltage
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass


@inlined
def offset_error(p, k):
    """Measured less true position [rad]."""
    return p[k]


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


def known_voltage(
    signals: Signals, joint: int, values: Mapping[str, float], torque: np.ndarray
) -> dict[int, np.ndarray]:
    """Change of the model's voltage [V] by what the sensor makes of the position."""
    q = signals.position[:, joint]
    return change_of_voltage(signals, joint, np.full_like(q, -values["angle"]), 0.0 * q, 0.0 * q)


EFFECT = Kind(
    name="encoder_offset",
    order=270,
    acts=SENSING,
    equation="m = q + angle",
    sentence="The sensor's zero is not the model's: gravity is felt at other angles than it says.",
    parameters=(Parameter("angle", "rad", -10.0, 10.0, "measured less true position", plausible=(0.001, 0.05)),),
    laws=(Law(Point.SENSOR_OFFSET, offset_error),),
    shifts_zero=True,
    known_voltage=known_voltage,
    screening=Screening(offset, excitation="Many poses with different torques of gravity."),
    drawn_against=("position",),
    example="encoder_offset:joint=2,angle=0.02",
)
