# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A sensor whose error is periodic in the position."""

from math import cos, pi, sin

import numpy as np

from puma_sim_core.effects.base import PLACE, SENSING, SIZE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, ByJoint, Candidate, Illegal, Screening, Signals, Values
from puma_sim_core.effects.shared.columns import candidate, polar, visible, when_moving, whole_range
from puma_sim_core.effects.shared.motion import Motion, change_of_voltage, wave_motion, wave_motions, wave_numbers
from puma_sim_core.jit import Table, inlined

#: greatest and least period of a sensor's error, in ranges of the joint: 6 and 0.3 rad on the arm
_LONGEST, _SHORTEST = 1.1, 0.055
#: a sensor's error in ranges of the joint: 0.1 % of it
_ERROR = 1e-3


@inlined
def wave_error(p: Table, k: int, q: float) -> float:
    """Measured less true position [rad] at q [rad]."""
    if p[k] == 0.0:
        return 0.0
    return p[k] * sin(2.0 * pi * q / p[k + 1] + p[k + 2])


@inlined
def wave_slope(p: Table, k: int, q: float) -> float:
    """Derivative of `wave_error` by q."""
    if p[k] == 0.0:
        return 0.0
    turn = 2.0 * pi / p[k + 1]
    return p[k] * turn * cos(turn * q + p[k + 2])


@when_moving
def nonlinearity(signals: Signals, joint: int) -> list[Candidate]:
    """Change of the voltage by sin(2 pi q / P) and cos(2 pi q / P) too much, for a grid of P."""
    low, high = whole_range(signals, joint)
    unit = _ERROR * (high - low)
    lowest, highest = (2.0 * np.pi / (share * (high - low)) for share in (_LONGEST, _SHORTEST))

    def values(c: np.ndarray, period: float) -> dict[str, float]:
        amplitude, phase = polar(c[0], c[1])
        if amplitude > 20.0 * unit or 2.0 * np.pi * amplitude >= period:
            raise Illegal(f"error {amplitude:.3g} rad of a sensor with period {period:.3g} rad")
        return {"amplitude": amplitude, "period": period, "phase": phase}

    def at(number: float) -> Candidate:
        columns = [_less(signals, joint, motion) for motion in wave_motions(signals, joint, number)]
        return candidate(columns, [0.0, 0.0], [unit, unit], values, {"period": 2.0 * np.pi / number}, VOLTAGE_COLUMN)

    return visible(at(number) for number in wave_numbers(signals, joint, lowest, highest, drift=0.65))


def known_voltage(signals: Signals, joint: int, values: Values, torque: np.ndarray) -> ByJoint:
    """Change of the model's voltage [V] by what the sensor makes of the position."""
    number = 2.0 * np.pi / values["period"]
    return _less(signals, joint, wave_motion(signals, joint, values["amplitude"], number, values["phase"]))


def _less(signals: Signals, joint: int, motion: Motion) -> ByJoint:
    """Change of the voltage by a motion less than the measured one."""
    dq, dqd, dqdd = motion
    return change_of_voltage(signals, joint, (-dq, -dqd, -dqdd))


EFFECT = Kind(
    name="sensor_nonlinearity",
    order=280,
    acts=SENSING,
    equation="m = q + a sin(2 pi q / period + phase)",
    sentence="The sensor is not straight: the same place is always measured wrong by the same.",
    parameters=(
        Parameter("amplitude", "rad", 0.0, 1.0, "a", SIZE, (0.0002, 0.02), steps=0.5),
        Parameter("period", "rad", 1e-4, 100.0, "of the error in q", PLACE, (0.3, 7.0), neutral=1.0),
        Parameter("phase", "rad", -10.0, 10.0, "at q = 0", PLACE, default=0.0),
    ),
    laws=(Law(Point.SENSOR_ERROR, wave_error), Law(Point.SENSOR_SLOPE, wave_slope)),
    check=lambda values: (
        None
        if values["amplitude"] * 2.0 * pi < values["period"]
        else "amplitude below period / (2 pi): a sensor that grows with the position"
    ),
    known_voltage=known_voltage,
    screening=Screening(nonlinearity, "The same places at different speeds."),
    drawn_against=("position",),
    example="sensor_nonlinearity:joint=2,amplitude=0.002,period=3",
)
