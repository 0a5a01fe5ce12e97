# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a process does: the trials and searches of one unit, as plain values that stand in a file."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import isfinite
from typing import Any, NamedTuple

from puma_sim_core.appraisal import controllers
from puma_sim_core.appraisal.battery import Battery, Group, Search, Unit
from puma_sim_core.appraisal.controllers import Made
from puma_sim_core.appraisal.margins.loop import loop_margins
from puma_sim_core.appraisal.margins.margins import NO_MARGINS, margin_measures
from puma_sim_core.appraisal.measures import MEASURES, measure, measure_repeats
from puma_sim_core.appraisal.perturbations.drawing import Conditions
from puma_sim_core.appraisal.perturbations.sizes import SEARCHED, main_parameter, value_at
from puma_sim_core.appraisal.settings import Patience
from puma_sim_core.appraisal.tasks.library import Task
from puma_sim_core.appraisal.trials.guard import Ended, Watched, in_child
from puma_sim_core.appraisal.trials.response import Response
from puma_sim_core.appraisal.trials.trial import Ending, Trial, run_trial
from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.effects import KINDS
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.feedback import Controller

#: the task whose limits a critical size is sought for
SEARCH_TASK = "effects"


class Job(NamedTuple):
    """A unit of a battery, as it goes to a process."""

    battery: Battery
    unit: Unit


class Outcome(NamedTuple):
    """The response of a trial, and measures that are not taken from it: the loop's margins."""

    response: Response
    margins: dict[str, float]


#: what a task under conditions gives with one controller; its last argument numbers the trials of an item
Attempt = Callable[[Task, Conditions, int], Outcome]
#: measures of a trial of the task `margins` that failed
NO_MARGIN = margin_measures([NO_MARGINS])


def run_unit(job: Job) -> dict[str, Any]:
    """Results of a unit, plain values: ``{"unit": index, "controller": ..., "control": ..., "results": [...]}``."""
    battery, unit = job
    if controllers.is_foreign(unit.controller):
        found = foreign_results(battery, unit)
    else:
        made, arm = _made(battery.setting.models, unit.controller), battery.setting.nominal.arm

        def attempt(task: Task, conditions: Conditions, _: int) -> Outcome:
            response = run_trial(Trial(task, conditions, arm, made.period), made)
            return _with_margins(response, task, conditions, arm, made.controller)

        found = [result for item in unit.items for result in item_results(battery, item, attempt)]
    return {"unit": unit.number, "controller": unit.controller, "control": unit.control, "results": found}


@lru_cache(maxsize=32)
def _made(models: controllers.Models, name: str) -> Made:
    return controllers.make(name, models)


def item_results(battery: Battery, item: Group | Search, attempt: Attempt) -> list[dict[str, Any]]:
    """The results of an item of a unit."""
    return [search(battery, item, attempt)] if isinstance(item, Search) else group_results(battery, item, attempt)


def foreign_results(battery: Battery, unit: Unit, patience: Patience = Patience()) -> list[dict[str, Any]]:
    """Results of a unit of a controller of the user's, in processes that are forked for it.

    A trial in which the process dies or says nothing has failed, and another process goes on from its item. After
    `patience.times` of these, or of late answers, the other trials of the unit fail without being tried.
    """
    known: dict[tuple[int, int], Ended] = {}
    found: list[list[dict[str, Any]]] = []
    ended = Ended("died", "its process ended before its first trial")
    while len(found) < len(unit.items) and len(known) < patience.times:
        begin = len(found)

        def work(send: Callable[[Any], None], begin: int = begin) -> None:
            _work(battery, unit, begin, known, patience, send)

        sent, ended = in_child(work, patience.start + patience.trial)
        found += [value for kind, value in sent if kind == "results"]
        if ended.end == "completed":
            break
        at = [value for kind, value in sent if kind == "at"]
        if not at:
            break
        known[at[-1]] = ended

    def attempt(task: Task, conditions: Conditions, number: int) -> Outcome:
        why = f"not tried: in {len(known)} trials of this unit {ended.why}" if known else ended.why
        return failed_outcome(task, conditions, battery, known.get((len(found), number), Ended(ended.end, why)))

    while len(found) < len(unit.items):
        found.append(item_results(battery, unit.items[len(found)], attempt))
    return [result for results in found for result in results]


def _work(
    battery: Battery,
    unit: Unit,
    begin: int,
    known: dict[tuple[int, int], Ended],
    patience: Patience,
    send: Callable[[Any], None],
) -> None:
    """What the process of a controller of the user's does, from an item on."""
    made = controllers.make(unit.controller, battery.setting.models)
    watched, arm = Watched(made.controller, patience), battery.setting.nominal.arm
    late: list[str] = []
    for place in range(begin, len(unit.items)):

        def attempt(task: Task, conditions: Conditions, number: int, place: int = place) -> Outcome:
            if (place, number) in known:
                return failed_outcome(task, conditions, battery, known[place, number])
            if len(late) >= patience.times:
                return failed_outcome(
                    task, conditions, battery, Ended("late", f"not tried: {late[-1]} in {len(late)} trials")
                )
            send(("at", (place, number)))
            response = Trial(task, conditions, arm, watched.period).run(watched)
            if response.end == "late":
                late.append(response.why)
            return _with_margins(response, task, conditions, arm, watched)

        send(("results", item_results(battery, unit.items[place], attempt)))


def _with_margins(
    response: Response, task: Task, conditions: Conditions, arm: ArmParameters, controller: Controller
) -> Outcome:
    if not task.margins or response.failed:
        return Outcome(response, NO_MARGIN if task.margins else {})
    try:
        return Outcome(response, loop_margins(task, conditions, arm, controller))
    except Ending:
        return Outcome(response, NO_MARGIN)


def failed_outcome(task: Task, conditions: Conditions, battery: Battery, ended: Ended) -> Outcome:
    """What there is of a controller that gave nothing."""
    trial = Trial(task, conditions, battery.setting.nominal.arm, controllers.PERIOD)
    trial.fail(*ended)
    return Outcome(trial.response(), NO_MARGIN if task.margins else {})


def conditions_of(battery: Battery, group: Group, draw: int) -> Conditions:
    """Conditions of a draw of a group."""
    task = battery.setting.tasks[group.task]
    return battery.setting.drawing.conditions(group.perturbation, draw, 0.5 * task.duration)


def group_results(battery: Battery, group: Group, attempt: Attempt) -> list[dict[str, Any]]:
    """Results of all draws of a group, and of what is measured over them together."""
    task = battery.setting.tasks[group.task]
    outcomes = [attempt(task, conditions_of(battery, group, draw), draw) for draw in range(group.draws)]
    found = [trial_result(task, group, draw, outcome) for draw, outcome in enumerate(outcomes)]
    if group.draws > 1 and (task.aims.stops or task.aims.paths):
        repeats = _plain(measure_repeats([one.response for one in outcomes], task.aims))
        found.append({"kind": "repeats", "task": group.task, "perturbation": group.perturbation, "measures": repeats})
    return found


def trial_result(task: Task, group: Group, draw: int, outcome: Outcome) -> dict[str, Any]:
    """What stands of a trial."""
    response = outcome.response
    measures = measure(response, task.aims) | outcome.margins
    return {
        "kind": "trial",
        "task": group.task,
        "perturbation": group.perturbation,
        "draw": draw,
        "end": response.end,
        "why": response.why,
        "passed": passes(task, response, measures),
        "measures": _plain(measures),
    }


def passes(task: Task, response: Response, measures: dict[str, float]) -> bool:
    """Whether a trial was completed within all limits of its task."""
    return not response.failed and all(
        within(limit.measure, measures[limit.measure], limit.value) for limit in task.limits
    )


def within(name: str, value: float, limit: float) -> bool:
    """Whether a value of a measure keeps a limit."""
    return value <= limit if MEASURES[name].smaller_is_better else value >= limit


def _plain(measures: dict[str, float]) -> dict[str, float | None]:
    """Measures for a file: None for infinite ones."""
    return {name: float(value) if isfinite(value) else None for name, value in measures.items()}


def search(battery: Battery, item: Search, attempt: Attempt) -> dict[str, Any]:
    """The smallest size of an effect at which a controller fails the search task, by bisection of its logarithm.

    It begins at the least size that machines have: what is far below that, such as a spring of 5e6 N.m/rad, is tried
    only where a controller fails there already. The result's ``verdict`` is "found", with the greatest size that
    passed and the smallest that failed; "always": fails at the least size or without the effect; "never": passes at
    the greatest; "impossible": this draw of the arm cannot have the effect.
    """
    setting, settings = battery.setting, battery.settings
    task = setting.tasks[SEARCH_TASK]
    kind = KINDS[item.effect.partition(":")[0]]
    middle = 0.5 * task.duration
    tried: list[float] = []

    def plant_at(size: float) -> Plant | None:
        try:
            return setting.drawing.with_effect(item.effect, size, middle, item.draw)
        except ParameterError:
            return None

    def failed(size: float) -> bool:
        plant = plant_at(size)
        if plant is None:
            return False  # no plant can have it: not a size that the controller fails at
        tried.append(size)
        response = attempt(task, Conditions(plant), len(tried) - 1).response
        return not passes(task, response, measure(response, task.aims))

    low, high = SEARCHED
    verdict, passed, failing = "found", 0.0, high
    if plant_at(0.0) is None:
        verdict = "impossible"
    elif failed(0.0):
        passed, failing = low, 0.0
        if failed(low):
            verdict, failing = "always", low
    elif not failed(high):
        verdict, passed = "never", high
    if verdict == "found":
        for _ in range(settings.bisections + 2):
            size = 0.5 * (passed + failing)
            if failed(size):
                failing = size
            else:
                passed = size
    parameter, *_ = main_parameter(kind)
    return {
        "kind": "search",
        "effect": item.effect,
        "draw": item.draw,
        "verdict": verdict,
        "parameter": parameter.name,
        "unit": parameter.unit,
        "passed": value_at(kind, passed) if verdict in ("found", "never") else None,
        "failed": value_at(kind, failing) if verdict in ("found", "always") else None,
        "size": 0.5 * (passed + failing) if verdict == "found" else None,
    }
