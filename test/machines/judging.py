# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What an answer says against what was there, and whether the log could have told."""

from __future__ import annotations

from pathlib import Path

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.errors import PumaSimError
from puma_sim_core.identify.data.machine_log import read_for, with_volts
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.identify.noise import innovations
from puma_sim_core.identify.prepare import prepare
from puma_sim_core.identify.result import Explanation
from puma_sim_core.identify.settings import SELECTION
from puma_sim_core.plant.mechanism import Mechanism

RIGHT, ALIKE, HIDDEN, MISSED, NEEDLESS, ALARM, FAULT = (
    *("right", "the same in this log", "not shown", "missed", "needless", "alarm", "data fault"),
)
Key = tuple[str, int | None]


def judged(said: list[Key], verdict: str, true: list[Key], behind: float | None) -> str:
    """The mark of an answer.

    said, true : effects, as (name, joint); behind [nat] : by how much the model with the true effects fits better than
    the one that was found, None where that cannot be run.
    """
    if verdict == "DATA_FAULT":
        return FAULT
    if not true:
        return ALARM if said or verdict == "UNNAMED" else RIGHT
    if set(said) == set(true):
        return RIGHT
    if set(_merged(said)) == set(_merged(true)):
        return ALIKE
    if set(_merged(true)) < set(_merged(said)):
        return NEEDLESS
    return MISSED if behind is None or behind > SELECTION.least_gain else HIDDEN


def _merged(keys: list[Key]) -> list[Key]:
    """Effects, with an offset and dry friction of one joint as friction that differs by direction: the same while the
    joint moves."""
    rub = {joint for name, joint in keys if name == "coulomb_friction"}
    pull = {joint for name, joint in keys if name == "voltage_offset"}
    two = [("asymmetric_coulomb_friction", joint) for joint in rub & pull]
    taken = {(name, joint) for joint in rub & pull for name in ("coulomb_friction", "voltage_offset")}
    return [*(key for key in keys if key not in taken), *two]


def behind(path: Path, mechanism: Mechanism, theta, effects: tuple[Effect, ...], found: Explanation) -> float | None:
    """By how much [nat] a model with the effects that are there fits better than that with the effects found, both
    fitted to their end in the noise of the first; None where one of them cannot be run."""
    log = with_volts(read_for(mechanism, str(path)), mechanism)
    try:
        prepared = prepare([log], mechanism)
        predictor, trials = prepared.predictor, Trials(prepared.predictor, prepared.problem)
        point = Point(mechanism.clip(theta), effects)
        weighting = predictor.unfiltered_weighting(predictor.errors(point.plant(mechanism)))
        for _ in range(2):
            true, _ = PredictionFit(predictor, weighting).to_end(point, trials.free(point), patient=True)
            point = true.point
            weighting = innovations.weighting(predictor, predictor.errors(point.plant(mechanism)))
        fit = PredictionFit(predictor, weighting)
        true, _ = fit.to_end(point, trials.free(point))
        start = Point(mechanism.clip(_parameters(mechanism, found)), _effects(found))
        other, _ = fit.to_end(start, trials.free(start), patient=True)
    except PumaSimError:
        return None
    return other.objective - true.objective


def _parameters(mechanism: Mechanism, found: Explanation):
    return [found.parameters[p.name][1] for p in mechanism.free]


def _effects(found: Explanation) -> tuple[Effect, ...]:
    """The effects of the augmented model, which stand at its end."""
    count = len(found.effects)
    effects = found.model.effects[len(found.model.effects) - count :]
    assert sorted((e.kind.name, e.joint or 0) for e in effects) == sorted((e.name, e.joint or 0) for e in found.effects)
    return tuple(Effect(KINDS[e.kind.name], e.joint, dict(e.values)) for e in effects)
