# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Measures of what a control costs."""

import numpy as np

from puma_sim_core.appraisal.measure import Measure
from puma_sim_core.appraisal.trials.response import Response
from puma_sim_core.control.metrics import effort
from puma_sim_core.recording.recording import Recording

MEASURES = (
    Measure(
        "voltage_rms", "V", "root mean square over time and joints of the voltage at the motors", "definition", "effort"
    ),
    Measure(
        "voltage_variation",
        "V",
        "total variation: sum over the rows of |V(k+1) - V(k)| at the motors, summed over the joints",
        "Skogestad, J. Process Control 13 (2003): 291-309, section 2.3",
        "effort",
    ),
    Measure(
        "energy",
        "J",
        "integral of V i over the rows in which it is positive, summed over the joints: a drive takes nothing back",
        "equation 5.1",
        "effort",
    ),
    Measure(
        "current_rms",
        "A",
        "root mean square over time and joints of the motor current, straight lines between rows",
        "definition",
        "effort",
    ),
    Measure(
        "saturated_share",
        "1",
        "share of the time in which the voltage asked for is at the limit or beyond, of the joint with the most",
        "definition",
        "effort",
    ),
)


def measure_effort(response: Response) -> dict[str, float]:
    """Of the rows of a response, two at least; a row's voltages are held to the next."""
    held, volts, i = np.diff(response.time)[:, None], response.applied[:-1], response.current
    before, after = i[:-1], i[1:]
    total = 3.0 * float(held.sum())
    rms = effort(Recording(response.time, response.applied), response.voltage_limit).rms
    asked = effort(Recording(response.time, response.voltage), response.voltage_limit)
    return {
        "voltage_rms": float(np.sqrt((rms**2).mean())),
        "voltage_variation": float(np.abs(np.diff(volts, axis=0)).sum()),
        "energy": float((held * np.maximum(volts * 0.5 * (before + after), 0.0)).sum()),
        "current_rms": float(np.sqrt((held * (before**2 + before * after + after**2)).sum() / 3.0 / total)),
        "saturated_share": float(asked.saturated.max()),
    }
