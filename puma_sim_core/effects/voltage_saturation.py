# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The supply's voltage limits the amplifier."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import VOLTAGE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, positive, visible
from puma_sim_core.effects.shared.limits import SHARP, beyond, limits_of
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass


@inlined
def saturated(p, k, voltage):
    """Voltage [V] within the supply."""
    if abs(voltage) <= p[k]:
        return voltage
    return p[k] if voltage > 0.0 else -p[k]


def saturation(signals: Signals, joint: int) -> list[Candidate]:
    """V - clip(V, +-Vs) with coefficient 1, and its change per volt of Vs, for a grid of Vs."""
    voltage = signals.voltage[:, joint]
    most = float(np.abs(voltage).max())
    found = []
    for limit, reach in limits_of(voltage):
        excess = beyond(voltage, limit)

        def values(c, limit=limit):
            return {"voltage": positive(limit + c[1], "supply voltage", "V", most)}

        columns = on_joint(joint, excess, -np.sign(excess))
        if visible(columns):
            found.append(
                candidate(columns, [1.0, 0.0], [SHARP, reach], values, {"voltage": limit}, VOLTAGE_COLUMN, fixed=True)
            )
    return found


EFFECT = Kind(
    name="voltage_saturation",
    order=100,
    acts=VOLTAGE,
    equation="V = min(max(V, -Vs), Vs)",
    sentence="The amplifier gives no more than its supply.",
    parameters=(
        Parameter("voltage", "V", 0.1, 1000.0, "Vs", neutral=inf, default=40.0, plausible=(1.0, 60.0), step=1.0),
    ),
    laws=(Law(Point.SUPPLY, saturated),),
    screening=Screening(saturation, excitation="Voltages that reach the supply, as in fast motion of the joint."),
    drawn_against=("voltage",),
    example="voltage_saturation:joint=1,voltage=24",
)
