# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A sensor with a lag of first order."""

from puma_sim_core.effects.base import RATE, SENSING, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, ByJoint, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, derivative, positive, sized, when_moving
from puma_sim_core.effects.shared.laws import first
from puma_sim_core.effects.shared.motion import change_of_voltage


@when_moving
def lag(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the voltage per second of lag: q = m + T dm/dt, exact for every T but for the small change of the rigid
    body's torques."""
    values = sized("time_constant", positive, "lag", "s", 0.1)
    return [candidate([_ahead(signals, joint, 1.0)], [0.006], [0.008], values, unit=VOLTAGE_COLUMN)]


def _ahead(signals: Signals, joint: int, T: float) -> ByJoint:
    """Change of the voltage by a motion that is T [s] times its rate ahead of the measured one."""
    qd, qdd = signals.velocity[:, joint], signals.acceleration[:, joint]
    return change_of_voltage(signals, joint, (T * qd, T * qdd, T * derivative(qdd, signals)))


EFFECT = Kind(
    name="sensor_lag",
    order=260,
    acts=SENSING,
    equation="T dm/dt = q - m, m the measured position",
    sentence="The measured position follows the true one with a lag of first order.",
    parameters=(Parameter("time_constant", "s", 0.0, 10.0, "T", RATE, (0.001, 0.035)),),
    laws=(Law(Point.SENSOR_LAG, first),),
    feigned=True,
    fine=True,
    known_voltage=lambda signals, joint, values, _: _ahead(signals, joint, values["time_constant"]),
    screening=Screening(lag, "A dither above a third of the cut-off frequency.", fast=True),
    drawn_against=("voltage_rate", "acceleration"),
    example="sensor_lag:joint=1,time_constant=0.01",
)
