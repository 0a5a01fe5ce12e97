# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Measures of trials: `measure` of one, `measure_repeats` of those that repeat one another, `MEASURES` their table."""

from collections.abc import Sequence

from puma_sim_core.appraisal.margins import margins
from puma_sim_core.appraisal.measure import Measure
from puma_sim_core.appraisal.measures import effort, paths, poses, steps, tracking
from puma_sim_core.appraisal.measures.wrist import Wrist
from puma_sim_core.appraisal.trials.response import Aims, Response
from puma_sim_core.errors import ParameterError

__all__ = ["MEASURES", "Measure", "expected_measures", "measure", "measure_repeats"]

#: all measures by name; those of margins come from `appraisal.margins`
MEASURES = {one.name: one for group in (steps, tracking, poses, paths, effort, margins) for one in group.MEASURES}


def measure(response: Response, aims: Aims) -> dict[str, float]:
    """Measures of one trial by name, in the units of `MEASURES`; never NaN.

    There are those that the aims say something about, and tracking and effort always; of ISO 9283 those that need
    repetitions only where the trial has them in itself. A trial that failed has the worst value of each.

    Raises ParameterError: aims at times or joints that the response does not have, or a wrist where there is no arm.
    """
    if response.failed:
        return {name: MEASURES[name].worst for name in expected_measures(aims)}
    if len(response.time) < 2:
        raise ParameterError("one row", where="measures", expected="two at least of a trial that was completed")
    found = steps.measure_steps(response, aims.steps)
    found |= tracking.measure_tracking(response, aims.steps)
    found |= _at_the_wrist([response], aims) | effort.measure_effort(response)
    return {name: found[name] for name in expected_measures(aims)}


def measure_repeats(responses: Sequence[Response], aims: Aims) -> dict[str, float]:
    """Measures of ISO 9283 over trials that repeat one another: of one task, with the same aims.

    Where any of them failed each has its worst value. Raises as `measure`, and ParameterError without a response.
    """
    if not responses:
        raise ParameterError("no response", where="measures of repeated trials", expected="one at least")
    if any(response.failed for response in responses):
        return {name: MEASURES[name].worst for name in _wrist_names(aims, len(responses))}
    found = _at_the_wrist(responses, aims)
    return {name: found[name] for name in _wrist_names(aims, len(responses))}


def expected_measures(aims: Aims, trials: int = 1) -> list[str]:
    """Names of the measures that aims have something for: of one trial, or of so many that repeat it."""
    own = [one.name for one in steps.MEASURES] * bool(aims.steps) + [one.name for one in tracking.MEASURES]
    return [*own, *_wrist_names(aims, trials), *(one.name for one in effort.MEASURES)]


def _wrist_names(aims: Aims, trials: int) -> list[str]:
    return poses.pose_names(aims.stops, trials) + paths.path_names(aims.paths, trials)


def _at_the_wrist(responses: Sequence[Response], aims: Aims) -> dict[str, float]:
    if not (aims.stops or aims.paths):
        return {}
    wrists = [Wrist(response) for response in responses]
    return poses.measure_poses(wrists, aims.stops) | paths.measure_paths(wrists, aims.paths)
