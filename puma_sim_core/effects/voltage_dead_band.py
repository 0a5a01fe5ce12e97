# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The amplifier has a threshold."""

import numpy as np

from puma_sim_core.effects.base import SIZE, VOLTAGE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, positive, visible, volt_scale
from puma_sim_core.effects.shared.limits import SHARP, beyond
from puma_sim_core.jit import Table, inlined

#: half widths of a dead-band, in voltages of the nominal friction torque
_DEAD_BANDS = np.geomspace(0.1, 2.4, 11)


@inlined
def past_dead_band(p: Table, k: int, voltage: float) -> float:
    """Voltage [V] that is left of one that has to exceed a threshold."""
    return voltage - min(max(voltage, -p[k]), p[k])


def dead_band(signals: Signals, joint: int) -> list[Candidate]:
    """clip(V, +-d) with coefficient 1, and its change per volt of d, for a grid of d."""
    volts, unit = signals.voltage[:, joint], volt_scale(signals, joint)

    def values(c: np.ndarray, voltage: float) -> dict[str, float]:
        return {"voltage": positive(voltage + c[1], "half width of the dead-band", "V", 4.0 * unit)}

    def at(d: float) -> Candidate:
        columns = on_joint(joint, np.clip(volts, -d, d), np.sign(beyond(volts, d)))
        return candidate(columns, [1.0, 0.0], [SHARP, 0.2 * d], values, {"voltage": d}, VOLTAGE_COLUMN, fixed=True)

    most = 0.5 * float(np.abs(volts).max())
    return visible(at(d) for d in unit * _DEAD_BANDS if not d > most)


EFFECT = Kind(
    name="voltage_dead_band",
    order=120,
    acts=VOLTAGE,
    equation="V = V - min(max(V, -d), d)",
    sentence="The amplifier lets nothing through until the voltage asked for exceeds a threshold.",
    parameters=(Parameter("voltage", "V", 0.0, 1e6, "d, half width of the band", SIZE, (0.05, 1.5)),),
    laws=(Law(Point.TERMINAL, past_dead_band),),
    screening=Screening(dead_band, "Motion that gravity helps, with small voltages of both signs."),
    drawn_against=("voltage",),
    example="voltage_dead_band:joint=3,voltage=0.5",
)
