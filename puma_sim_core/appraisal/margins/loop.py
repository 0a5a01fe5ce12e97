# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Margins of a controller on a plant: exactly by linearisation, or by injection where its law cannot be asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from puma_sim_core.appraisal.margins.linearisation import linear_margins, linear_part
from puma_sim_core.appraisal.margins.margins import NO_MARGINS, Margins, margin_measures
from puma_sim_core.appraisal.margins.multisine import Injected, Injection, Multisine, injection_margins
from puma_sim_core.appraisal.perturbations.drawing import Conditions
from puma_sim_core.appraisal.tasks.library import Task, whole
from puma_sim_core.appraisal.trials.trial import Trial
from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.errors import ParameterError
from puma_sim_core.simulation.feedback import Controller

#: lead [s], size [V] and lines of the injected multisine: 60 lines a decade of the servo rate's band
_LEAD, _SIZE, _LINES = 2.0, 0.3, 200
#: its least and greatest period [s]: the first has 10 lines up to 22 rad/s, where loops at the servo rate cross over,
#: the last has as many up to 1.4 rad/s
_SHORTEST, _LONGEST = 2.8, 44.8


def loop_margins(task: Task, conditions: Conditions, arm: ArmParameters, controller: Controller) -> dict[str, float]:
    """Margin measures of the loops about the task's pose, of the worst joint.

    By linearisation, which leaves out the effects that are not linear; of a controller that is not linear itself, or
    not the same at all samples, by injection.
    """
    try:
        found = linear_margins(conditions.plant, task.start, controller)
    except ParameterError:
        return injected_margins(task, conditions, arm, controller)
    return margin_measures(list(found))


def injected_margins(
    task: Task,
    conditions: Conditions,
    arm: ArmParameters,
    controller: Controller,
    run: Callable[[Trial, Controller], Any] = Trial.run,
) -> dict[str, float]:
    """Margin measures as `loop_margins` has them, by a multisine that is injected in trials about the task's pose.

    The plant is the linear part of the conditions' one, as for the linearisation, without noise or lost samples. The
    multisine's period is doubled until its lines are dense enough. Margins that cannot be trusted are `NO_MARGINS`.

    run : does a trial with a controller.
    """
    plain = Conditions(linear_part(conditions.plant))
    start, period = np.array(task.start), controller.period

    def injection(joint: int, duration: float) -> Injection | None:
        samples = 2 * round(0.5 * duration / period)
        design = Multisine(
            period,
            samples,
            rms=_SIZE,
            lines=_LINES,
            highest=0.5 / period,
            lead=round(_LEAD / period),
            realisations=2,
            seed=joint,
        )
        signal = design.signal()
        injected = Injected(controller, joint, signal)
        standing = replace(
            task,
            duration=whole(len(signal) * period),
            reference=lambda time: np.broadcast_to(start, (len(time), 3)).copy(),
        )
        run(Trial(standing, plain, arm, period), injected)
        full = len(injected.answered) >= len(signal)
        return injection_margins(design, injected.answered[: len(signal)]) if full else None

    loops: list[Margins] = []
    duration = _SHORTEST
    for joint in (1, 2, 3):
        found = injection(joint, duration)
        while found is not None and not found.trusted and duration < _LONGEST:
            duration *= 2.0
            found = injection(joint, duration)
        loops.append(NO_MARGINS if found is None or not found.trusted else found.margins)
    return margin_measures(loops)
