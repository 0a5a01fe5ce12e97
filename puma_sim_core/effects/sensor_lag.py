# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A sensor with a lag of first order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import SENSING, Kind, Law, Parameter, Point, Role
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, change_of_voltage, derivative, moves, positive
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass


@inlined
def time_constant(p, k):
    """Time constant [s]."""
    return p[k]


def lag(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the voltage per second of lag: q = m + T dm/dt, exact for every T but for the
    small change of the rigid body's torques."""
    if not moves(signals, joint):
        return []
    velocity, acceleration = signals.velocity[:, joint], signals.acceleration[:, joint]
    column = change_of_voltage(signals, joint, velocity, acceleration, derivative(acceleration, signals))

    def values(c):
        return {"time_constant": positive(c[0], "lag", "s", 0.1)}

    return [candidate([column], [0.006], [0.008], values, unit=VOLTAGE_COLUMN)]


def known_voltage(
    signals: Signals, joint: int, values: Mapping[str, float], torque: np.ndarray
) -> dict[int, np.ndarray]:
    """Change of the model's voltage [V] by what the sensor makes of the position."""
    qd, qdd, T = signals.velocity[:, joint], signals.acceleration[:, joint], values["time_constant"]
    return change_of_voltage(signals, joint, T * qd, T * qdd, T * derivative(qdd, signals))


EFFECT = Kind(
    name="sensor_lag",
    order=260,
    acts=SENSING,
    equation="T dm/dt = q - m, m the measured position",
    sentence="The measured position follows the true one with a lag of first order.",
    parameters=(Parameter("time_constant", "s", 0.0, 10.0, "T", role=Role.RATE, plausible=(0.001, 0.035)),),
    laws=(Law(Point.SENSOR_LAG, time_constant),),
    feigned=True,
    fine=True,
    known_voltage=known_voltage,
    screening=Screening(lag, excitation="A dither above a third of the cut-off frequency.", fast=True),
    drawn_against=("voltage_rate", "acceleration"),
    example="sensor_lag:joint=1,time_constant=0.01",
)
