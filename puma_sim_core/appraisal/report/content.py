# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The content of report.json: plain values, from which page, table and CSV are made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np

from puma_sim_core import __version__
from puma_sim_core.appraisal.battery import Battery
from puma_sim_core.appraisal.controllers import BASELINES
from puma_sim_core.appraisal.measures import MEASURES
from puma_sim_core.appraisal.perturbations.drawing import AUGMENTED, NOMINAL, split
from puma_sim_core.appraisal.perturbations.sizes import SIZES, main_parameter, value_at
from puma_sim_core.appraisal.report.table import FAMILIES, Place, Table, family, value_of
from puma_sim_core.appraisal.statistics import (
    compare,
    failure_share,
    paired_change,
    sensitivity,
    summaries,
    trials_needed,
)
from puma_sim_core.effects import KINDS
from puma_sim_core.errors import ParameterError

REPORT_FORMAT = "puma-sim appraisal 1"


def content(table: Table) -> dict[str, Any]:
    """Everything that a battery found."""
    battery = table.battery
    described = battery.to_mapping() | {"model": battery.model is not None}
    used = {place.task for place in table.places}
    return {
        "format": REPORT_FORMAT,
        "version": __version__,
        "battery": {key: value for key, value in described.items() if key not in ("format", "version")},
        "tasks": [_task(task) for task in battery.setting.tasks.values() if task.name in used],
        "scoreboard": _scoreboard(table),
        "comparisons": _comparisons(table),
        "nominal": _nominal(table),
        "repeats": _repeats(table),
        "sensitivities": _sensitivities(table),
        "critical_sizes": _critical(table),
        "growth": _growth(table),
        "models": _models(table),
        "failures": _failures(table),
    }


def _task(task: Any) -> dict[str, Any]:
    limits = [{**each._asdict(), "unit": MEASURES[each.measure].unit} for each in task.limits]
    return {"name": task.name, "sentence": task.sentence, "duration": task.duration, "limits": limits}


def _interval(value: float, low: float, high: float) -> dict[str, float]:
    return {"value": float(value), "low": float(low), "high": float(high)}


def _strata(table: Table, rows: np.ndarray) -> list[str]:
    """Families of the trials: within one they are resampled as draws of what may befall a controller."""
    return [family(place.perturbation) for place, chosen in zip(table.places, rows) if chosen]


def _statistics(table: Table) -> dict[str, Any]:
    return {"seed": table.battery.seed, "resamples": table.battery.settings.resamples}


def _scoreboard(table: Table) -> list[dict[str, Any]]:
    battery = table.battery
    rows, names = table.rows(), battery.controllers
    scores, strata = table.scores[rows], _strata(table, rows)
    overall = summaries(scores, strata, **_statistics(table))
    rank = compare(scores, strata, **_statistics(table)).rank
    found = []
    for number, name in enumerate(names):
        passed = table.passed[:, number]
        count, failed = int(rows.sum()), int((~passed[rows]).sum())
        found.append(
            {
                "controller": name,
                "sentence": _sentence(battery, name),
                "rank": int(rank[number]),
                "score": _interval(*np.clip(overall[number], 0.0, 1.0)),
                "trials": count,
                "passed": count - failed,
                "failure_share": _interval(*failure_share(failed, count)),
                "ends": dict(sorted(Counter(trial["end"] for trial in table.trials[name].values()).items())),
                "families": [_family(table, number, each) for each in FAMILIES if table.rows(each).any()],
                "breaks_first": _breaks_first(table, name),
            }
        )
    return found


def _sentence(battery: Battery, name: str) -> str:
    """What a controller is."""
    if name in BASELINES:
        return BASELINES[name].sentence
    for process in battery.processes:
        if process.name == name:
            return f"a process over topics, interface {process.interface}, a command each {1e3 * process.period:.4g} ms"
    return "a class of the user's"


def _family(table: Table, number: int, name: str) -> dict[str, Any]:
    rows = table.rows(name)
    passed, scores = table.passed[rows, number], table.scores[rows, number]
    return {
        "family": name,
        "trials": len(scores),
        "passed": int(passed.sum()),
        "score": float(np.mean(scores)),
        "lowest": float(scores.min()),
    }


def _breaks_first(table: Table, name: str) -> dict[str, Any] | None:
    """The effect with the smallest critical size, on the scale of what machines have."""
    found = [each for each in _of_searches(table, name) if each["size"] is not None]
    return min(found, key=lambda each: each["size"]) if found else None


def _comparisons(table: Table) -> list[dict[str, Any]]:
    """Each pair of controllers: the paired difference of their scores, and what a difference of 5 % would need."""
    rows, names = table.rows(), table.battery.controllers
    scores, strata = table.scores[rows], _strata(table, rows)
    found = compare(scores, strata, **_statistics(table))
    return [
        {
            "first": names[i],
            "second": names[j],
            "difference": _interval(found.difference[i, j], found.low[i, j], found.high[i, j]),
            "tie": bool(found.low[i, j] <= 0.0 <= found.high[i, j]),
            "trials_needed": _needed(scores[:, [i, j]], strata),
        }
        for i in range(len(names))
        for j in range(i + 1, len(names))
    ]


def _needed(scores: np.ndarray, strata: list[str]) -> int | None:
    """Trials with which a difference of 5 % would be seen; None where neither has a score."""
    try:
        return int(trials_needed(scores, strata).trials)
    except ParameterError:
        return None


def _nominal(table: Table) -> list[dict[str, Any]]:
    """Measures of the nominal trials."""
    return [
        {"controller": name, "task": at.task, "passed": trial["passed"], "measures": trial["measures"]}
        for name, trials in table.trials.items()
        for at, trial in trials.items()
        if at.perturbation == NOMINAL and at.draw == 0
    ]


def _repeats(table: Table) -> list[dict[str, Any]]:
    """Measures of ISO 9283 over the draws of a task under a perturbation, where there are several."""
    return [{key: value for key, value in each.items() if key != "kind"} for each in table.repeats]


def _sensitivities(table: Table) -> list[dict[str, Any]]:
    """Score that each effect costs from nothing to its greatest plausible size, greatest first.

    Of the slope's least squares with sizes 1/3, 2/3 and 1 for small, medium and large.
    """
    unit = {name: (number + 1) / len(SIZES) for number, name in enumerate(SIZES)}
    singles: dict[str, list[Place]] = {}
    for place in table.places:
        base, size = split(place.perturbation)
        if size is not None:
            singles.setdefault(base, []).append(place)
    number_of = {place: number for number, place in enumerate(table.places)}
    found = []
    for column, name in enumerate(table.battery.controllers):
        own: list[dict[str, Any]] = []
        for base, places in singles.items():
            here = [place for place in places if Place(place.task, NOMINAL, 0) in number_of]
            if not here:
                continue
            nominal = [number_of[Place(place.task, NOMINAL, 0)] for place in here]
            sizes = [unit[str(split(place.perturbation)[1])] for place in here]
            before = table.scores[nominal, column]
            after = table.scores[[number_of[place] for place in here], column]
            lost = sensitivity(before, after, sizes, sizes, **_statistics(table))
            own.append({"controller": name, "effect": base, "kind": base.partition(":")[0], **_interval(*lost)})
        found += sorted(own, key=lambda each: -each["value"])
    return found


def _critical(table: Table) -> list[dict[str, Any]]:
    return [each for name in table.battery.controllers for each in _of_searches(table, name)]


def _of_searches(table: Table, name: str) -> list[dict[str, Any]]:
    """Critical sizes of a controller, over the draws of the arm."""
    by_effect: dict[str, list[dict[str, Any]]] = {}
    for each in table.searches[name]:
        by_effect.setdefault(each["effect"], []).append(each)
    found = []
    for effect, draws in by_effect.items():
        verdicts = Counter(each["verdict"] for each in draws)
        own = [each for each in draws if each["verdict"] == "found"]
        values = sorted((each["passed"] * each["failed"]) ** 0.5 for each in own)
        ends = sorted(value for each in own for value in (each["passed"], each["failed"]))
        found.append(
            {
                "controller": name,
                "effect": effect,
                "parameter": draws[0]["parameter"],
                "unit": draws[0]["unit"],
                "draws": len(draws),
                **{verdict: verdicts[verdict] for verdict in ("found", "always", "never", "impossible")},
                "value": float(np.median(values)) if values else None,
                "low": ends[0] if ends else None,
                "high": ends[-1] if ends else None,
                "size": float(np.median([each["size"] for each in own])) if own else None,
            }
        )
    return found


def _growth(table: Table) -> list[dict[str, Any]]:
    """How many times greater each measure is with an effect at its large size than without, of the worst joint."""
    found: dict[tuple[str, str], dict[str, float | None]] = {}
    for name, trials in table.trials.items():
        for at, trial in trials.items():
            base, size = split(at.perturbation)
            nominal = trials.get(Place(at.task, NOMINAL, 0))
            if size != "large" or nominal is None:
                continue
            growth = found.setdefault((name, base.partition(":")[0]), {})
            for measure, value in trial["measures"].items():
                before = nominal["measures"][measure]
                if not MEASURES[measure].smaller_is_better or before in (None, 0.0):
                    continue
                ratio = float("inf") if value is None else value / before
                known = growth.get(measure, 0.0)
                growth[measure] = None if known is None or not isfinite(ratio) else max(known, ratio)
    return [
        {
            "controller": name,
            "effect": effect,
            "size": value_at(KINDS[effect], 1.0),
            "unit": _main_unit(effect),
            "measures": of,
        }
        for (name, effect), of in found.items()
    ]


def _main_unit(effect: str) -> str:
    return main_parameter(KINDS[effect])[0].unit


def _models(table: Table) -> dict[str, Any] | None:
    """What an appraisal on the nominal model hides: ranks and scores on it and on the augmented one, paired."""
    if table.battery.model is None or not table.rows(AUGMENTED).any():
        return None
    here = [place for place in table.places if place.perturbation == NOMINAL]
    number_of = {place: number for number, place in enumerate(table.places)}
    pairs = [(number_of[at], number_of.get(at._replace(perturbation=AUGMENTED))) for at in here]
    both = np.array([pair for pair in pairs if pair[1] is not None], dtype=int)
    places = [table.places[n] for n in both[:, 0]]
    strata = [NOMINAL] * len(places)
    nominal, augmented = table.scores[both[:, 0]], table.scores[both[:, 1]]
    ranks = [compare(scores, strata, **_statistics(table)).rank for scores in (nominal, augmented)]
    rows = []
    for k, name in enumerate(table.battery.controllers):
        paired = compare(np.stack([nominal[:, k], augmented[:, k]], axis=1), strata, **_statistics(table))
        rows.append(
            {
                "controller": name,
                "rank_nominal": int(ranks[0][k]),
                "rank_augmented": int(ranks[1][k]),
                "passed_nominal": int(table.passed[both[:, 0], k].sum()),
                "passed_augmented": int(table.passed[both[:, 1], k].sum()),
                "score_lost": _interval(paired.difference[0, 1], paired.low[0, 1], paired.high[0, 1]),
                "measures": _changed(table, name, places),
            }
        )
    return {"trials": len(places), "controllers": rows}


def _changed(table: Table, name: str, places: list[Place]) -> list[dict[str, Any]]:
    """The measures of each task's limits on both models, and by how much they change over the draws of both; no
    interval where a trial of either has an infinite one."""
    found = []
    for task in dict.fromkeys(at.task for at in places):
        draws = [at for at in places if at.task == task]
        for limit in table.battery.setting.tasks[task].limits:
            values = {
                model: [value_of(table.trials[name][at._replace(perturbation=model)], limit.measure) for at in draws]
                for model in (NOMINAL, AUGMENTED)
            }
            finite = all(map(isfinite, values[NOMINAL] + values[AUGMENTED]))
            itself = {model: own[0] if isfinite(own[0]) else None for model, own in values.items()}
            change = _interval(*paired_change(values[NOMINAL], values[AUGMENTED])) if finite else None
            unit = MEASURES[limit.measure].unit
            found.append({"task": task, "measure": limit.measure, "unit": unit, **itself, "change": change})
    return found


def failed_limits(table: Table, trial: Mapping[str, Any]) -> str:
    """Why a trial did not pass, as text."""
    if trial["end"] != "completed":
        return f"{trial['end']}: {trial['why']}"
    found = []
    for limit in table.battery.setting.tasks[trial["task"]].limits:
        value, one = trial["measures"][limit.measure], MEASURES[limit.measure]
        number = float("inf") if value is None else value
        if (number > limit.value) if one.smaller_is_better else (number < limit.value):
            unit = "" if one.unit == "1" else f" {one.unit}"
            found.append(f"{limit.measure} {number:.4g}{unit}, limit {limit.value:.4g}")
    return "; ".join(found)


def _failures(table: Table) -> list[dict[str, Any]]:
    return [
        {"controller": name, **at._asdict(), "end": trial["end"], "why": failed_limits(table, trial), "bag": None}
        for name, trials in table.trials.items()
        for at, trial in trials.items()
        if not trial["passed"]
    ]
