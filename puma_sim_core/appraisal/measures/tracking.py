# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Measures of the error between reference and position, over the whole trial."""

from collections.abc import Sequence

import numpy as np

from puma_sim_core.appraisal.measure import Measure
from puma_sim_core.appraisal.trials.response import Response, Step
from puma_sim_core.control.curve import Curve

_SOURCE = "Graham and Lathrop, Trans. AIEE 72 (1953): 273-288"
MEASURES = (
    Measure("iae", "rad.s", "integral of |e| over time, summed over the joints", _SOURCE, "tracking"),
    Measure("ise", "rad^2.s", "integral of e^2 over time, summed over the joints", _SOURCE, "tracking"),
    Measure("itae", "rad.s^2", "integral of t |e|, t since the start, summed over the joints", _SOURCE, "tracking"),
    Measure("greatest_error", "rad", "greatest |e| of any joint at any time", "definition", "tracking"),
)


def error_curves(response: Response, steps: Sequence[Step]) -> list[Curve]:
    """Reference less position of each joint [rad]; between rows the reference is straight, but jumps at a step."""
    time, reference = response.time, response.reference
    before = reference.copy()
    for step in steps:
        k = int(np.searchsorted(time, step.at - 1e-9))
        if 0 < k < len(time):
            # up to the row of the step its joint's reference goes on as it was
            before[k, step.joint - 1] = reference[k - 1, step.joint - 1]
    rate = (before[1:] - reference[:-1]) / np.diff(time)[:, None]
    after, ahead = np.vstack([rate, rate[-1:]]), np.vstack([rate[:1], rate])
    q, qd = response.position, response.velocity
    return [
        Curve(time, reference[:, j] - q[:, j], after[:, j] - qd[:, j], before[:, j] - q[:, j], ahead[:, j] - qd[:, j])
        for j in range(3)
    ]


def measure_tracking(response: Response, steps: Sequence[Step]) -> dict[str, float]:
    """The integrals over all joints, and the greatest error. Of a response of one row there is none."""
    curves = error_curves(response, steps)
    start = float(response.time[0])
    iae, ise, itae = np.sum([curve.integrals(start) for curve in curves], axis=0).tolist()
    greatest = max(max(-low, high) for low, high in (curve.extremes() for curve in curves))
    return {"iae": iae, "ise": ise, "itae": itae, "greatest_error": greatest}
