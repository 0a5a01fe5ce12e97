# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The common supply sags under the currents of all motors."""

import numpy as np

from puma_sim_core.effects.base import SIZE, VOLTAGE, VOLTAGE_DRIVE, Kind, Law, Needs, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, positive, sized
from puma_sim_core.jit import Table, inlined


@inlined
def supply_share(p: Table, k: int, i1: float, i2: float, i3: float) -> float:
    """Share of the supply that is left under the currents [A] of all motors."""
    return max(1.0 - p[k] * (abs(i1) + abs(i2) + abs(i3)), 0.0)


def droop(signals: Signals, joint: int | None) -> list[Candidate]:
    """V sum |i| of all joints; the coefficient is the share lost per ampere."""
    total = np.abs(signals.current).sum(axis=1)
    column = {j: signals.voltage[:, j] * total for j in range(signals.joints)}
    values = sized("coefficient", positive, "sag", "1/A", 0.05)
    return [candidate([column], [0.004], [0.005], values, unit=VOLTAGE_COLUMN)]


EFFECT = Kind(
    name="supply_droop",
    order=140,
    acts=VOLTAGE,
    equation="V = V max(1 - c sum |i|, 0), of all joints",
    sentence="The voltage of the common supply sags under the currents of all motors.",
    parameters=(Parameter("coefficient", "1/A", 0.0, 1e3, "c, share of the voltage lost", SIZE, (0.001, 0.03)),),
    laws=(Law(Point.SUPPLY_SHARE, supply_share),),
    per_joint=False,
    needs=Needs(VOLTAGE_DRIVE, "a motor on voltage"),
    screening=Screening(droop, "Joints that move alone, and then together."),
    drawn_against=("supply_current", "current", "voltage"),
    example="supply_droop:coefficient=0.01",
)
