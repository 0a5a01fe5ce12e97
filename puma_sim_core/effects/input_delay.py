# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Voltages reach the motors late."""

import numpy as np

from puma_sim_core.effects.base import SIZE, VOLTAGE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, positive, sized, stretches
from puma_sim_core.effects.shared.laws import first

#: input delays [s]
_DELAYS = (0.0005, 0.001, 0.002, 0.003, 0.0045)


def delay(signals: Signals, joint: int | None) -> list[Candidate]:
    """(V(t) - V(t - T)) / T on every joint for a grid of T; the coefficient is the delay.

    The exact difference holds at the frequencies where T dV/dt no longer does.
    """

    def at(T: float) -> Candidate:
        column = dict(enumerate((signals.voltage - _late(signals, T)).T / T))
        values = sized("time", positive, "delay", "s", 0.03)
        return candidate([column], [T], [0.5 * T], values, {"time": T}, VOLTAGE_COLUMN)

    return [at(T) for T in _DELAYS]


def _late(signals: Signals, by: float) -> np.ndarray:
    """Voltages (n, J) of some time before."""
    out = np.empty_like(signals.voltage)
    for part in stretches(signals):
        t = signals.time[part]
        out[part] = np.transpose([np.interp(t - by, t, volts) for volts in signals.voltage[part].T])
    return out


EFFECT = Kind(
    name="input_delay",
    order=150,
    acts=VOLTAGE,
    equation="V(t) = V asked for at t - T",
    sentence="Every voltage reaches its motor later than the log says.",
    parameters=(Parameter("time", "s", 0.0, 1.0, "T", SIZE, (0.0003, 0.01), periods=1.0),),
    laws=(Law(Point.DELAY, first),),
    per_joint=False,
    feigned=True,
    fine=True,
    screening=Screening(delay, "A dither of 5 to 20 Hz on the voltage, best without feedback.", fast=True),
    drawn_against=("voltage_rate", "acceleration"),
    example="input_delay:time=0.004",
)
