# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A sensor whose error is periodic in the position."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, pi, sin
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import SENSING, Kind, Law, Parameter, Point, Role
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Illegal, Screening, Signals
from puma_sim_core.effects.shared.columns import (
    candidate,
    change_of_voltage,
    moves,
    slow_enough,
    visible,
    wave_motion,
    wave_numbers,
    whole_range,
)
from puma_sim_core.jit import inlined

if TYPE_CHECKING:
    pass

#: greatest and least period of a sensor's error, in ranges of the joint: 6 and 0.3 rad on the arm
_LONGEST, _SHORTEST = 1.1, 0.055

#: a sensor's error in ranges of the joint: 0.1 % of it
_ERROR = 1e-3


@inlined
def wave_error(p, k, q):
    """Measured less true position [rad] at q [rad]."""
    if p[k] == 0.0:
        return 0.0
    return p[k] * sin(2.0 * pi * q / p[k + 1] + p[k + 2])


@inlined
def wave_slope(p, k, q):
    """Derivative of `wave_error` by q."""
    if p[k] == 0.0:
        return 0.0
    turn = 2.0 * pi / p[k + 1]
    return p[k] * turn * cos(turn * q + p[k + 2])


def nonlinearity(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the voltage by sin(2 pi q / P) and cos(2 pi q / P) too much, for a grid of P."""
    if not moves(signals, joint):
        return []
    low, high = whole_range(signals, joint)
    unit = _ERROR * (high - low)
    q, qd = signals.position[:, joint], signals.velocity[:, joint]
    found = []
    for number in wave_numbers(
        signals, joint, 2.0 * np.pi / (_LONGEST * (high - low)), 2.0 * np.pi / (_SHORTEST * (high - low)), drift=0.65
    ):
        if not slow_enough(signals, joint, number):
            continue
        period = float(2.0 * np.pi / number)

        def values(c, period=period):
            amplitude = float(np.hypot(c[0], c[1]))
            if amplitude > 20.0 * unit or 2.0 * np.pi * amplitude >= period:
                raise Illegal(f"error {amplitude:.3g} rad of a sensor with period {period:.3g} rad")
            return {"amplitude": amplitude, "period": period, "phase": float(np.arctan2(c[1], c[0]))}

        columns = [
            change_of_voltage(signals, joint, *(-part for part in motion))
            for motion in wave_motion(q, qd, signals.acceleration[:, joint], number)
        ]
        if visible(tuple(columns)):
            found.append(candidate(columns, [0.0, 0.0], [unit, unit], values, {"period": period}, VOLTAGE_COLUMN))
    return found


def known_voltage(
    signals: Signals, joint: int, values: Mapping[str, float], torque: np.ndarray
) -> dict[int, np.ndarray]:
    """Change of the model's voltage [V] by what the sensor makes of the position."""
    q, qd, qdd = (each[:, joint] for each in (signals.position, signals.velocity, signals.acceleration))
    n, a = 2.0 * np.pi / values["period"], values["amplitude"]
    angle = n * q + values["phase"]
    rate = -a * n * np.cos(angle) * qd
    return change_of_voltage(
        signals, joint, -a * np.sin(angle), rate, a * n * (n * np.sin(angle) * qd**2 - np.cos(angle) * qdd)
    )


EFFECT = Kind(
    name="sensor_nonlinearity",
    order=280,
    acts=SENSING,
    equation="m = q + a sin(2 pi q / period + phase)",
    sentence="The sensor is not straight: the same place is always measured wrong by the same.",
    parameters=(
        Parameter("amplitude", "rad", 0.0, 1.0, "a", plausible=(0.0002, 0.02)),
        Parameter(
            "period", "rad", 1e-4, 100.0, "of the error in q", neutral=1.0, role=Role.PLACE, plausible=(0.3, 7.0)
        ),
        Parameter("phase", "rad", -10.0, 10.0, "at q = 0", default=0.0, role=Role.PLACE),
    ),
    laws=(Law(Point.SENSOR_ERROR, wave_error), Law(Point.SENSOR_SLOPE, wave_slope)),
    check=lambda values: (
        None
        if values["amplitude"] * 2.0 * pi < values["period"]
        else "amplitude below period / (2 pi): a sensor that grows with the position"
    ),
    known_voltage=known_voltage,
    screening=Screening(nonlinearity, excitation="The same places at different speeds."),
    drawn_against=("position",),
    example="sensor_nonlinearity:joint=2,amplitude=0.002,period=3",
)
