# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Voltages reach the motors late."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import VOLTAGE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, positive, stretches
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass

#: input delays [s]
_DELAYS = (0.0005, 0.001, 0.002, 0.003, 0.0045)


@inlined
def late_by(p, k):
    """Delay [s]."""
    return p[k]


def delay(signals: Signals, joint: int | None) -> list[Candidate]:
    """(V(t) - V(t - T)) / T on every joint for a grid of T; the coefficient is the delay.

    The exact difference holds at the frequencies where T dV/dt no longer does.
    """
    found = []
    for time in _DELAYS:
        column = {j: (signals.voltage[:, j] - _late(signals, j, time)) / time for j in range(signals.joints)}

        def values(c):
            return {"time": positive(c[0], "delay", "s", 0.03)}

        found.append(candidate([column], [time], [0.5 * time], values, {"time": time}, VOLTAGE_COLUMN))
    return found


def _late(signals: Signals, joint: int, time: float) -> np.ndarray:
    voltage = signals.voltage[:, joint]
    out = np.empty_like(voltage)
    for part in stretches(signals):
        t = signals.time[part]
        out[part] = np.interp(t - time, t, voltage[part])
    return out


EFFECT = Kind(
    name="input_delay",
    order=150,
    acts=VOLTAGE,
    equation="V(t) = V asked for at t - T",
    sentence="Every voltage reaches its motor later than the log says.",
    parameters=(Parameter("time", "s", 0.0, 1.0, "T", plausible=(0.0003, 0.01)),),
    laws=(Law(Point.DELAY, late_by),),
    per_joint=False,
    feigned=True,
    fine=True,
    screening=Screening(delay, excitation="A dither of 5 to 20 Hz on the voltage, best without feedback.", fast=True),
    drawn_against=("voltage_rate", "acceleration"),
    example="input_delay:time=0.004",
)
