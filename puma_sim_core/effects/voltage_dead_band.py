# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The amplifier has a threshold."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import VOLTAGE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, positive, visible, volt_scale
from puma_sim_core.effects.shared.limits import SHARP, beyond
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass

#: half widths of a dead-band, in voltages of the nominal friction torque
_DEAD_BANDS = np.geomspace(0.1, 2.4, 11)


@inlined
def past_dead_band(p, k, voltage):
    """Voltage [V] that is left of one that has to exceed a threshold."""
    return voltage - min(max(voltage, -p[k]), p[k])


def dead_band(signals: Signals, joint: int) -> list[Candidate]:
    """clip(V, +-d) with coefficient 1, and its change per volt of d, for a grid of d."""
    voltage = signals.voltage[:, joint]
    unit, most = volt_scale(signals, joint), float(np.abs(voltage).max())
    found = []
    for width in unit * _DEAD_BANDS:
        if width > 0.5 * most:
            break

        def values(c, width=float(width)):
            return {"voltage": positive(width + c[1], "half width of the dead-band", "V", 4.0 * unit)}

        columns = on_joint(joint, np.clip(voltage, -width, width), np.sign(beyond(voltage, width)))
        if visible(columns):
            found.append(
                candidate(
                    columns,
                    [1.0, 0.0],
                    [SHARP, 0.2 * width],
                    values,
                    {"voltage": float(width)},
                    VOLTAGE_COLUMN,
                    fixed=True,
                )
            )
    return found


EFFECT = Kind(
    name="voltage_dead_band",
    order=120,
    acts=VOLTAGE,
    equation="V = V - min(max(V, -d), d)",
    sentence="The amplifier lets nothing through until the voltage asked for exceeds a threshold.",
    parameters=(Parameter("voltage", "V", 0.0, 100.0, "d, half width of the band", plausible=(0.05, 1.5)),),
    laws=(Law(Point.TERMINAL, past_dead_band),),
    screening=Screening(dead_band, excitation="Motion that gravity helps, with small voltages of both signs."),
    drawn_against=("voltage",),
    example="voltage_dead_band:joint=3,voltage=0.5",
)
