# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The supply's voltage limits the amplifier."""

from math import inf

import numpy as np

from puma_sim_core.effects.base import SIZE, VOLTAGE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import positive
from puma_sim_core.effects.shared.limits import SHARP, clipped, limit_candidates


def saturation(signals: Signals, joint: int) -> list[Candidate]:
    """V - clip(V, +-Vs) with coefficient 1, and its change per volt of Vs, for a grid of Vs."""
    voltage = signals.voltage[:, joint]
    most = float(np.abs(voltage).max())
    return limit_candidates(
        joint, voltage, SHARP, "voltage", lambda limit: positive(limit, "supply voltage", "V", most)
    )


EFFECT = Kind(
    name="voltage_saturation",
    order=100,
    acts=VOLTAGE,
    equation="V = min(max(V, -Vs), Vs)",
    sentence="The amplifier gives no more than its supply.",
    parameters=(Parameter("voltage", "V", 1e-6, 1e6, "Vs", SIZE, (1.0, 60.0), neutral=inf, default=40.0, step=1.0),),
    laws=(Law(Point.SUPPLY, clipped),),
    screening=Screening(
        saturation, "Voltages that reach the supply, as in fast motion of the joint.", unseen=(("voltage", 24.0),)
    ),
    drawn_against=("voltage",),
    example="voltage_saturation:joint=1,voltage=24",
)
