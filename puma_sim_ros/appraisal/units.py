# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The units of a battery whose controllers are processes over topics, one after the other; others go to an executor."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from puma_sim_core.appraisal import controllers
from puma_sim_core.appraisal.battery import Battery, Group
from puma_sim_core.appraisal.margins.loop import injected_margins
from puma_sim_core.appraisal.perturbations.drawing import NOMINAL, Conditions
from puma_sim_core.appraisal.report.output import record_trial
from puma_sim_core.appraisal.settings import Patience
from puma_sim_core.appraisal.tasks.library import Task
from puma_sim_core.appraisal.trials import replays
from puma_sim_core.appraisal.trials.guard import Ended
from puma_sim_core.appraisal.trials.replays import Again
from puma_sim_core.appraisal.trials.trial import Ending, Trial
from puma_sim_core.appraisal.work import (
    NO_MARGIN,
    Job,
    Outcome,
    conditions_of,
    failed_outcome,
    item_results,
    trial_result,
)
from puma_sim_core.errors import ParameterError
from puma_sim_ros.appraisal.foreign import Foreign
from puma_sim_ros.appraisal.topics import Topics


class Units(Executor):
    """Does units of processes itself, in one thread, and leaves the others to `elsewhere`.

    folder : where bags of failed trials go as they happen, `recorded` of each process (None: all).
    """

    def __init__(self, battery: Battery, topics: Topics, patience: Patience, elsewhere: Executor) -> None:
        self._battery, self._patience, self._elsewhere = battery, patience, elsewhere
        make = lambda: controllers.make("pid", battery.setting.models).controller  # noqa: E731
        self._foreign = {process.name: Foreign(process, topics, make) for process in battery.processes}
        self._topics = topics
        self._own = ThreadPoolExecutor(1, thread_name_prefix="puma-sim-topics")
        #: nominal trials, for the figures
        self._seen: dict[tuple[str, str], Again] = {}
        self._folder: Path | None = None
        self._left: dict[str, float] = {}

    def record(self, folder: Path, most: int | None, results: Mapping[int, Mapping[str, Any]]) -> None:
        """Record failed trials in a folder from now on, up to `most` of each process with those of `results`."""
        self._folder = folder
        for name in self._foreign:
            before = sum(
                each["kind"] == "trial" and not each["passed"]
                for unit in results.values()
                if unit["controller"] == name and not unit["control"]
                for each in unit["results"]
            )
            self._left[name] = float("inf") if most is None else most - before

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As `concurrent.futures.Executor.submit`, of what does a `Job`, the last argument."""
        job: Job = args[-1]
        if job.unit.controller not in self._foreign:
            return self._elsewhere.submit(function, *args, **kwargs)
        return self._own.submit(function, self._do, job)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: with `wait` when the units are done, else at once."""
        self._topics.stopped = not wait
        self._own.shutdown(cancel_futures=cancel_futures)
        for foreign in self._foreign.values():
            foreign.stop(polite=wait)

    def check(self) -> None:
        """Start each process once, the first one last; raises ParameterError where one does not answer."""
        for name in reversed(self._foreign):
            try:
                self._only(name).start()
            except Ending as ending:
                expected = "a process that answers each state with a command"
                raise ParameterError(str(ending), where=f"parameter '{name}.command'", expected=expected) from None

    def _only(self, name: str) -> Foreign:
        """A process, with none of the others running."""
        for other in self._foreign.values():
            if other.process.name != name:
                other.stop()
        return self._foreign[name]

    def _do(self, job: Job) -> dict[str, Any]:
        """Results of a unit, as `work.run_unit` gives them."""
        battery, unit = job
        foreign, arm = self._only(unit.controller), battery.setting.nominal.arm
        gone: list[Ended] = []
        found = []
        for item in unit.items:

            def attempt(task: Task, conditions: Conditions, draw: int, item: Any = item) -> Outcome:
                if len(gone) >= self._patience.times:
                    why = f"not tried: in {len(gone)} trials of this unit {gone[-1].why}"
                    return failed_outcome(task, conditions, battery, Ended(gone[-1].end, why))
                trial = Trial(task, conditions, arm, foreign.controller.period)
                response = foreign.run(trial)
                if response.end in ("late", "died"):
                    gone.append(Ended(response.end, response.why.partition(", at ")[0]))
                margins = NO_MARGIN if task.margins else {}
                if task.margins and not response.failed:
                    margins = injected_margins(task, conditions, arm, foreign.controller, foreign.run)
                outcome = Outcome(response, margins)
                if isinstance(item, Group):
                    self._record(unit.controller, item, draw, trial, outcome)
                return outcome

            found += item_results(battery, item, attempt)
        return {"unit": unit.number, "controller": unit.controller, "control": unit.control, "results": found}

    def _record(self, name: str, group: Group, draw: int, trial: Trial, outcome: Outcome) -> None:
        shown = Again(outcome.response, trial.commands(), trial.step)
        if group.perturbation == NOMINAL and draw == 0:
            self._seen[name, group.task] = shown
        if self._folder is None or self._left[name] <= 0 or not len(shown.commands):
            return
        if not trial_result(trial.task, group, draw, outcome)["passed"]:
            self._left[name] -= 1
            record_trial(self._folder, self._battery, name, group, draw, shown)

    def again(self, battery: Battery, name: str, group: Group, draw: int) -> Again:
        """A trial of any controller once more, as `replays.again`."""
        if name not in self._foreign:
            return replays.again(battery, name, group, draw)
        if group.perturbation == NOMINAL and draw == 0 and (name, group.task) in self._seen:
            return self._seen[name, group.task]
        conditions, task = conditions_of(battery, group, draw), battery.setting.tasks[group.task]
        foreign = self._only(name)
        trial = Trial(task, conditions, battery.setting.nominal.arm, foreign.controller.period)
        response = foreign.run(trial)
        return Again(response, trial.commands(), trial.step)
