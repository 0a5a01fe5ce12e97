# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A gear that is not round."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import TRANSMISSION, Kind, Parameter, Role, Train
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Illegal, Screening, Signals
from puma_sim_core.effects.shared.columns import (
    candidate,
    change_of_voltage,
    is_arm,
    moves,
    slow_enough,
    torque_volts,
    visible,
    wave_motion,
    wave_numbers,
)

if TYPE_CHECKING:
    pass

#: orders of a gear's error in a turn of the joint, and their usual amplitude [rad]
_ORDERS, _ERROR = (1.0, 40.0), 4e-4


def transmission_error(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the voltage by a link at q + sin(n q) and at q + cos(n q), for a grid of n."""
    if not moves(signals, joint):
        return []
    unit = _ERROR if is_arm(signals) else _ERROR * min(1.0, float(np.ptp(signals.position[:, joint])))
    q, qd = signals.position[:, joint], signals.velocity[:, joint]
    link = signals.link_torque[:, joint]
    found = []
    for order in wave_numbers(signals, joint, *_ORDERS):
        if not slow_enough(signals, joint, order):
            continue
        columns = []
        for n, (dq, dqd, dqdd) in enumerate(wave_motion(q, qd, signals.acceleration[:, joint], order)):
            column = change_of_voltage(signals, joint, dq, dqd, dqdd, motor=False)
            slope = order * (np.cos(order * q) if n == 0 else -np.sin(order * q))
            column[joint] = column[joint] + torque_volts(signals, joint, slope * link)
            columns.append(column)

        def values(c, order=float(order)):
            amplitude = float(np.hypot(c[0], c[1]))
            if amplitude > 25.0 * unit or amplitude * order >= 0.5:
                raise Illegal(f"error {amplitude:.3g} rad of a gear of order {order:.3g}")
            return {"amplitude": amplitude, "order": order, "phase": float(np.arctan2(c[1], c[0]))}

        if visible(tuple(columns)):
            found.append(candidate(columns, [0.0, 0.0], [unit, unit], values, {"order": float(order)}, VOLTAGE_COLUMN))
    return found


def known_voltage(
    signals: Signals, joint: int, values: Mapping[str, float], torque: np.ndarray
) -> dict[int, np.ndarray]:
    """Voltage [V] that the gear's error makes along a measured motion."""
    q, qd, qdd = (each[:, joint] for each in (signals.position, signals.velocity, signals.acceleration))
    n, e, angle = values["order"], values["amplitude"], values["order"] * q + values["phase"]
    dq, dqd = e * np.sin(angle), e * n * np.cos(angle) * qd
    dqdd = e * n * (np.cos(angle) * qdd - n * np.sin(angle) * qd**2)
    found = change_of_voltage(signals, joint, dq, dqd, dqdd, motor=False)
    found[joint] = found[joint] + torque_volts(signals, joint, e * n * np.cos(angle) * signals.link_torque[:, joint])
    return found


def train(values: Mapping[str, float]) -> Train:
    """A gear whose output is at q + e sin(n q + f)."""
    return Train(wave=(values["amplitude"], values["order"], values["phase"]))


EFFECT = Kind(
    name="transmission_error",
    order=200,
    acts=TRANSMISSION,
    equation="ql = qm + e sin(n qm + f)",
    sentence="A gear that is not round: the link leads and trails the motor as it turns, and the "
    "arm's inertia and weight push back through it.",
    parameters=(
        Parameter("amplitude", "rad", 0.0, 0.05, "e", plausible=(5e-5, 3e-3)),
        Parameter(
            "order",
            "1",
            0.0,
            1000.0,
            "n, periods in a turn of the joint",
            default=1.0,
            role=Role.PLACE,
            plausible=(1.0, 40.0),
            step=1.0,
        ),
        Parameter("phase", "rad", -10.0, 10.0, "f", default=0.0, role=Role.PLACE),
    ),
    train=train,
    vanishes=lambda values: values["amplitude"] == 0.0,
    known_voltage=known_voltage,
    screening=Screening(transmission_error, excitation="The same range at two speeds, with load.", fast=True),
    drawn_against=("position",),
    example="transmission_error:joint=1,amplitude=4e-4,order=8",
)
