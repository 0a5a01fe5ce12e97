# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Columns of the motor: torque that comes back with its turns, a winding that gets warm."""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects.columns.common import candidate, on_joint, positive, warming, waves
from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Illegal, Screening, Signals

#: periods a turn of the motor
_ORDERS = (1, 2, 3, 4, 6, 7, 8, 12)


def ripple(signals: Signals, joint: int) -> list[Candidate]:
    """sin(n N q) and cos(n N q) for the orders n that the log can show.

    The counts of an encoder blur the phase by at most n N times half a count, below 0.1 rad for
    the arm; orders whose waves pass faster than the filters of the screening let through, or of
    which the joint travels less than one, are left out.
    """
    scale, q = float(signals.torque_scale[joint]), signals.position[:, joint]
    found = []
    for order in _ORDERS:
        number = float(order * abs(signals.gear[joint]))
        if number < 6.0 or number * signals.quantum[joint] > 1.5 or not waves(signals, joint, number):
            continue
        # the sign of the ratio is the sign of the motor's angle
        angle = np.remainder(order * float(signals.gear[joint]) * q, 2.0 * np.pi)

        def values(c, order=order):
            amplitude = float(np.hypot(c[0], c[1]))
            if amplitude > 3.0 * scale:
                raise Illegal(f"amplitude {amplitude:.3g} N.m, more than {3.0 * scale:.3g} N.m")
            return {"amplitude": amplitude, "order": float(order), "phase": float(np.arctan2(c[1], c[0]))}

        found.append(
            candidate(
                on_joint(joint, np.sin(angle), np.cos(angle)),
                [0.0, 0.0],
                [0.3 * scale] * 2,
                values,
                {"order": float(order)},
            )
        )
    return found


def drift(signals: Signals, joint: int) -> list[Candidate]:
    """k tau (1 - exp(-t/T)) for a grid of T; the coefficient is the share by which R grows."""
    volts = signals.volts_per_torque[joint] * signals.torque[:, joint]

    def values(c, T):
        return {"share": positive(c[0], "growth of the resistance", "", 3.0), "time_constant": T}

    return warming(signals, joint, volts, values, [0.2], [0.2], VOLTAGE_COLUMN)


SCREENINGS = {
    "torque_ripple": Screening(
        ripple,
        look_alikes=(
            (
                "transmission_error",
                "the waves are tied to the motor's turns, and their torque does not grow with speed or load",
            ),
            ("sensor_nonlinearity", "the waves do not grow with the speed"),
            ("position_dependent_friction", "the waves do not change sign with the velocity"),
        ),
        excitation="Slow constant speeds, so that the waves pass at less than 12 Hz.",
        plausible=(("amplitude", 0.3, 10.0),),
    ),
    "resistance_drift": Screening(
        drift,
        look_alikes=(
            ("friction_warm_up", "the growth follows the torque, also at rest against gravity, not the speed"),
            ("supply_droop", "the loss grows with time and follows the joint's own torque"),
            ("payload", "the torque seems to grow with time"),
        ),
        excitation="Long holds against gravity, and the same motion at the beginning and the end.",
        plausible=(("share", 0.05, 0.5), ("time_constant", 1.0, 600.0)),
    ),
}
