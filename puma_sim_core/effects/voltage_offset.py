# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The amplifier loses a constant voltage."""

import numpy as np

from puma_sim_core.effects.base import SIZE, VOLTAGE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import bounded, candidate, on_joint, sized, volt_scale
from puma_sim_core.jit import Table, inlined


@inlined
def past_offset(p: Table, k: int, voltage: float) -> float:
    """Voltage [V] less the constant part that is lost."""
    return voltage - p[k]


def offset(signals: Signals, joint: int) -> list[Candidate]:
    """A constant; its coefficient is the offset."""
    unit, columns = volt_scale(signals, joint), on_joint(joint, np.ones(len(signals.time)))
    values = sized("voltage", bounded, "offset", "V", 6.0 * unit)
    return [candidate(columns, [0.0], [0.5 * unit], values, unit=VOLTAGE_COLUMN)]


EFFECT = Kind(
    name="voltage_offset",
    order=130,
    acts=VOLTAGE,
    equation="V = V - c",
    sentence="The amplifier gives a constant voltage too little, or too much.",
    parameters=(Parameter("voltage", "V", -1e6, 1e6, "c, what is missing at the motor", SIZE, (0.02, 1.0)),),
    laws=(Law(Point.TERMINAL, past_offset),),
    screening=Screening(offset, "Any motion; both directions and many poses tell it from gravity."),
    drawn_against=("time",),
    example="voltage_offset:joint=2,voltage=0.3",
)
