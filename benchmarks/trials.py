# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Rows of the appraisal: trials of one task with a compiled controller and with controllers as Python objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np

from benchmarks.task import Row
from benchmarks.task import Task as Motion
from puma_sim_core.appraisal.battery import Battery
from puma_sim_core.appraisal.controllers import PERIOD, make
from puma_sim_core.appraisal.measures import measure
from puma_sim_core.appraisal.trials.trial import Trial
from puma_sim_core.jit import BACKEND

COMPILED = "appraisal, a trial, PID in the kernel"
OBJECT = "appraisal, a trial, PID as a Python object"
EMPTY = "appraisal, a trial, an object that gives 0 V"
SCHEDULED = "appraisal, a trial, scheduled PID as an object"
TORQUE = "appraisal, a trial, computed torque as an object"
MEASURED = "appraisal, a trial and its measures, PID in the kernel"


class _Zero:
    period = PERIOD

    def reset(self) -> None:
        pass

    def update(self, *_: Any) -> tuple[float, float, float]:
        return 0.0, 0.0, 0.0


def rows(_: Motion) -> list[Row]:
    """The longest task, on the arm without effects; none where nothing is compiled. Time is that of the processor: what
    a core does in it, whatever else the machine is busy with."""
    if BACKEND != "numba":
        return []
    setting = Battery(("pid",), "quick").setting
    task, arm = setting.tasks["poses"], setting.nominal.arm
    conditions = setting.drawing.conditions("nominal", 0, 0.0)
    pid, scheduled, torque = (make(name, setting.models) for name in ("pid", "scheduled", "computed_torque"))

    def trial() -> Trial:
        return Trial(task, conditions, arm, PERIOD)

    def row(label: str, run: Callable[[], Any], calls: int, note: str = "") -> Row:
        def on_the_processor() -> tuple[float, np.ndarray]:
            start = process_time()
            position = run().position[-1]
            return process_time() - start, position

        made = Row(label, lambda: run().position[-1], task.duration, calls=calls, ours=True, compared=False, note=note)
        return replace(made, measure=on_the_processor)

    def measured() -> Any:
        response = trial().run_compiled(pid.servo)
        assert np.isfinite(list(measure(response, task.aims).values())).all()
        return response

    return [
        row(COMPILED, lambda: trial().run_compiled(pid.servo), 9, f"{task.duration:.1f} s of 'poses'; processor time"),
        row(MEASURED, measured, 5),
        row(EMPTY, lambda: trial().run(_Zero()), 2, "what the appraisal itself needs"),
        row(OBJECT, lambda: trial().run(pid.controller), 2),
        row(SCHEDULED, lambda: trial().run(scheduled.controller), 2),
        row(TORQUE, lambda: trial().run(torque.controller), 2),
    ]
