# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A gear that is not round."""

import numpy as np

from puma_sim_core.effects.base import PLACE, SIZE, TRANSMISSION, Kind, Parameter, Train
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, ByJoint, Candidate, Illegal, Screening, Signals, Values
from puma_sim_core.effects.shared.columns import candidate, of_travel, polar, torque_volts, visible, when_moving
from puma_sim_core.effects.shared.motion import Motion, change_of_voltage, wave_motion, wave_motions, wave_numbers

#: orders of a gear's error in a turn of the joint, and their usual amplitude [rad]
_ORDERS, _ERROR = (1.0, 40.0), 4e-4


@when_moving
def transmission_error(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the voltage by a link at q + sin(n q) and at q + cos(n q), for a grid of n."""
    unit, q = _ERROR * of_travel(signals, joint), signals.position[:, joint]

    def values(c: np.ndarray, order: float) -> dict[str, float]:
        amplitude, phase = polar(c[0], c[1])
        if amplitude > 25.0 * unit or amplitude * order >= 0.5:
            raise Illegal(f"error {amplitude:.3g} rad of a gear of order {order:.3g}")
        return {"amplitude": amplitude, "order": order, "phase": phase}

    def at(n: float) -> Candidate:
        slopes = n * np.cos(n * q), n * -np.sin(n * q)
        columns = [_cost(signals, joint, *wave) for wave in zip(wave_motions(signals, joint, n), slopes)]
        return candidate(columns, [0.0, 0.0], [unit, unit], values, {"order": n}, VOLTAGE_COLUMN)

    return visible(map(at, wave_numbers(signals, joint, *_ORDERS)))


def known_voltage(signals: Signals, joint: int, values: Values, torque: np.ndarray) -> ByJoint:
    """Voltage [V] that the gear's error makes along a measured motion."""
    error = e, n, f = values["amplitude"], values["order"], values["phase"]
    slope = e * n * np.cos(n * signals.position[:, joint] + f)
    return _cost(signals, joint, wave_motion(signals, joint, *error), slope)


def _cost(signals: Signals, joint: int, error: Motion, slope: np.ndarray) -> ByJoint:
    """Voltages of a link that leads its motor by an error, and of its torque, which the slope of the error reflects."""
    found = change_of_voltage(signals, joint, error, motor=False)
    found[joint] = found[joint] + torque_volts(signals, joint, slope * signals.link_torque[:, joint])
    return found


EFFECT = Kind(
    name="transmission_error",
    order=200,
    acts=TRANSMISSION,
    equation="ql = qm + e sin(n qm + f)",
    sentence="A gear that is not round: the link leads and trails the motor as it turns, and the "
    "arm's inertia and weight push back through it.",
    parameters=(
        Parameter("amplitude", "rad", 0.0, 0.05, "e", SIZE, (5e-5, 3e-3), steps=0.5),
        Parameter(
            "order", "1", 0.0, 1000.0, "n, periods in a turn of the joint", PLACE, (1.0, 40.0), default=1.0, step=1.0
        ),
        Parameter("phase", "rad", -10.0, 10.0, "f", PLACE, default=0.0),
    ),
    train=lambda values: Train(wave=(values["amplitude"], values["order"], values["phase"])),
    vanishes=lambda values: values["amplitude"] == 0.0,
    known_voltage=known_voltage,
    screening=Screening(transmission_error, "The same range at two speeds, with load.", fast=True),
    drawn_against=("position",),
    example="transmission_error:joint=1,amplitude=4e-4,order=8",
)
