# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A battery from its first unit to its results: the controls, then everything else, on any executor."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any

from puma_sim_core.appraisal import controllers
from puma_sim_core.appraisal.battery import FAILS_ALL, PASSES_ALL, Battery, Unit
from puma_sim_core.appraisal.settings import Patience
from puma_sim_core.appraisal.store import Results, Store, open_store
from puma_sim_core.appraisal.trials.guard import Watched, in_child
from puma_sim_core.appraisal.trials.trial import Sample, driven
from puma_sim_core.appraisal.work import Job, run_unit
from puma_sim_core.errors import ParameterError, PumaSimError
from puma_sim_core.executors import Failure, Shard, run_jobs
from puma_sim_core.simulation.feedback import Controller


class BatteryError(PumaSimError):
    """A battery whose controls do not hold, or whose work ended with an error: its results would mean nothing."""


def check_controllers(battery: Battery) -> None:
    """Make each controller once, and have a class of the user's answer once, in a process of its own: what cannot be
    made, or gives something else than three numbers from the start, is refused before any work.

    Raises ParameterError: names the controller, what is wrong and what was expected.
    """
    over_topics = {process.name for process in battery.processes}
    for name in battery.controllers:
        if name not in over_topics:
            made = controllers.make(name, battery.setting.models)
            if controllers.is_foreign(name):
                _check_answer(name, made.controller, next(iter(battery.setting.tasks.values())).start)


def _check_answer(name: str, controller: Controller, start: tuple[float, ...], patience: Patience = Patience()) -> None:
    def sample() -> Generator[Sample, Sequence[float], None]:
        first, second, third = start
        u, v, w = yield 0.0, (first, second, third), (first, second, third)
        float(u), float(v), float(w)

    def work(send: Callable[[Any], None]) -> None:
        send(driven(sample(), Watched(controller, patience)))

    sent, ended = in_child(work, patience.start)
    why = ended.why if not sent else sent[0] and sent[0][1]
    if why:
        expected = "update(t, setpoint, measurement) that answers with three voltages"
        raise ParameterError(why, where=f"controller {name}", expected=expected)


def run_battery(
    battery: Battery,
    folder: str | os.PathLike[str],
    executor: Executor,
    shard: Shard = Shard(),
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Results:
    """Do what is not done yet of a battery, or of a shard of it; returns the results by the index of their unit.

    Raises
    ------
    RecordingError : see `open_store`.
    BatteryError : do-nothing passes a task, or computed torque on the true model fails one; names the tasks.
    """
    own = set(shard.of([unit.number for unit in battery.units if not unit.control]))
    store = open_store(folder, battery)
    controls = [unit for unit in battery.units if unit.control]
    others = [unit for unit in battery.units if unit.number in own]
    _run(battery, controls, store, executor, lambda done: progress("controls", 0.1 * done))
    check_controls(store.results)
    _run(battery, others, store, executor, lambda done: progress("trials", done))
    return {unit.number: store.results[unit.number] for unit in (*controls, *others)}


def _run(
    battery: Battery, units: Sequence[Unit], store: Store, executor: Executor, report: Callable[[float], None]
) -> None:
    """Do the units that do not stand yet, and store each when it is done."""
    todo = [unit for unit in units if unit.number not in store.results]
    failed: dict[int, Failure] = {}
    done = len(units) - len(todo)

    def stored(index: int, result: dict[str, Any] | Failure) -> None:
        nonlocal done
        if isinstance(result, Failure):
            failed[index] = result
        else:
            store.add(result)
        done += 1

    jobs = [Job(battery, unit) for unit in todo]
    for _ in run_jobs(run_unit, jobs, executor, stored, lambda: report(done / max(len(units), 1))):
        pass
    if failed:
        index, failure = min(failed.items())
        what = f"unit {todo[index].number} of {todo[index].controller}: {failure.reason}"
        expected = "work that ends; the same command goes on with the rest"
        raise BatteryError(what, where=f"{len(failed)} of {len(units)} units", expected=expected)


def check_controls(results: Mapping[int, Mapping[str, Any]]) -> None:
    """Raise BatteryError where a control says that tasks are vacuous or impossible."""
    for name, wanted, what in (
        (FAILS_ALL, False, "do-nothing passes"),
        (PASSES_ALL, True, "computed torque on the true model fails"),
    ):
        trials = [
            trial
            for result in results.values()
            if result["control"] and result["controller"] == name
            for trial in result["results"]
        ]
        wrong = list(dict.fromkeys(trial["task"] for trial in trials if trial["passed"] is not wanted))
        if wrong:
            expected = "limits that do-nothing fails and computed torque on the true model passes"
            raise BatteryError(f"{what} {', '.join(wrong)}", where="controls", expected=expected)
