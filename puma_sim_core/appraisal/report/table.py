# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The results of a battery as tables: trials with their scores, side by side for all controllers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Any, NamedTuple

import numpy as np

from puma_sim_core.appraisal.battery import Battery
from puma_sim_core.appraisal.measures import MEASURES
from puma_sim_core.appraisal.perturbations.drawing import AUGMENTED, NOMINAL, RANDOM, split
from puma_sim_core.appraisal.tasks.library import Task

#: families of perturbations, with what they are
FAMILIES = (NOMINAL, *RANDOM, "effects", AUGMENTED)


class Place(NamedTuple):
    """Which trial: the same arm and disturbances for all controllers."""

    task: str
    perturbation: str
    draw: int


def family(perturbation: str) -> str:
    """The family of a perturbation."""
    return "effects" if split(perturbation)[1] is not None else perturbation


def value_of(trial: Mapping[str, Any], measure: str) -> float:
    """A measure of a trial; None in the file stands for infinity."""
    value = trial["measures"][measure]
    return inf if value is None else float(value)


def trial_score(task: Task, trial: Mapping[str, Any]) -> float:
    """The worst score of a trial over the limits of its task: 1/2 or more where it passed, 0 where it failed."""
    if trial["end"] != "completed":
        return 0.0
    found = []
    for limit in task.limits:
        value = value_of(trial, limit.measure)
        if not MEASURES[limit.measure].smaller_is_better:
            value, bound = limit.value, value
        else:
            bound = limit.value
        found.append(0.0 if value == inf else 1.0 if bound == inf else bound / (bound + value))
    return min(found)


@dataclass(frozen=True)
class Table:
    """All trials of all controllers of a battery."""

    battery: Battery
    results: Mapping[int, Mapping[str, Any]]

    @cached_property
    def trials(self) -> dict[str, dict[Place, dict[str, Any]]]:
        """Trials of each controller, in the battery's order."""
        found: dict[str, dict[Place, dict[str, Any]]] = {name: {} for name in self.battery.controllers}
        for result in self._of("trial"):
            found[result["controller"]][Place(result["task"], result["perturbation"], result["draw"])] = result
        return found

    @cached_property
    def searches(self) -> dict[str, list[dict[str, Any]]]:
        """Searches of each controller."""
        found: dict[str, list[dict[str, Any]]] = {name: [] for name in self.battery.controllers}
        for result in self._of("search"):
            found[result["controller"]].append(result)
        return found

    @cached_property
    def repeats(self) -> list[dict[str, Any]]:
        """Measures over the draws of a group."""
        return self._of("repeats")

    def _of(self, kind: str) -> list[dict[str, Any]]:
        return [
            {"controller": unit["controller"], **result}
            for _, unit in sorted(self.results.items())
            if not unit["control"]
            for result in unit["results"]
            if result["kind"] == kind
        ]

    @cached_property
    def places(self) -> list[Place]:
        """The trials that all controllers have."""
        return list(next(iter(self.trials.values())))

    @cached_property
    def scores(self) -> np.ndarray:
        """(n, C) scores of the trials at `places`."""
        tasks = self.battery.setting.tasks
        return np.array(
            [[trial_score(tasks[at.task], self.trials[name][at]) for name in self.trials] for at in self.places]
        ).reshape(len(self.places), len(self.trials))

    @cached_property
    def passed(self) -> np.ndarray:
        """(n, C) whether trials were passed."""
        return np.array([[self.trials[name][at]["passed"] for name in self.trials] for at in self.places], dtype=bool)

    def rows(self, *names: str) -> np.ndarray:
        """(n,) whether a trial is of one of these families; all of them but the augmented model without any."""
        chosen = names or tuple(name for name in FAMILIES if name != AUGMENTED)
        return np.array([family(at.perturbation) in chosen for at in self.places], dtype=bool)
