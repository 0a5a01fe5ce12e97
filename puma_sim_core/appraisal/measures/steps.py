# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Measures of steps of a joint's reference."""

from collections.abc import Sequence

from puma_sim_core.appraisal.measure import Measure
from puma_sim_core.appraisal.trials.response import Response, Step
from puma_sim_core.control.metrics import StepQuality, step_quality
from puma_sim_core.errors import ParameterError

_SOURCE = "Franklin, Powell and Emami-Naeini, Feedback Control of Dynamic Systems, section 3.4"
MEASURES = (
    Measure(
        "rise_time", "s", "time from the first 10 % of the step to the first 90 %; inf: not reached", _SOURCE, "step"
    ),
    Measure(
        "settling_time",
        "s",
        "time from the step to where the response stays within the band (2 % of the step) to the end; inf: it does not",
        _SOURCE,
        "step",
    ),
    Measure("overshoot", "1", "greatest excess over the end, as a share of the step", _SOURCE, "step"),
    Measure(
        "undershoot", "1", "greatest excursion to the other side of the start, as a share of the step", _SOURCE, "step"
    ),
    Measure(
        "steady_error",
        "1",
        "distance from the end of the mean over the last tenth of the step's time, as a share of the step",
        _SOURCE,
        "step",
    ),
)


def measure_steps(response: Response, steps: Sequence[Step]) -> dict[str, float]:
    """The worst of each measure over the steps. Raises ParameterError: no such joint, no rows in a step's time."""
    found = []
    for step in steps:
        if step.joint not in (1, 2, 3):
            raise ParameterError(f"joint {step.joint!r}", where="step", expected="1, 2 or 3")
        rows = slice(None) if step.until is None else response.time <= step.until + 1e-9
        found.append(
            step_quality(
                response.time[rows],
                response.position[rows, step.joint - 1],
                step.start,
                step.end,
                at=step.at,
                band=step.band,
                velocity=response.velocity[rows, step.joint - 1],
            )
        )
    return {name: max(getattr(quality, name) for quality in found) for name in StepQuality._fields if found}
