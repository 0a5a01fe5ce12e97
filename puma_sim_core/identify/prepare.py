# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs made ready for the selection: sampling, retuned parameters, noise, Kalman predictor."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from puma_sim_core.effects import KINDS, Kind
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.checks.start_up import held_starts
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.predictor import Predictor, RowChoice
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.screening.search import Fit, Search
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism import Mechanism


def silent(what: str, share: float) -> None:
    """Show no progress."""


def library_of(mechanism: Mechanism) -> dict[str, Kind]:
    """name -> effect, of those that are sought on a mechanism."""
    return {name: kind for name, kind in KINDS.items() if kind.screening is not None and mechanism.possible(name)}


class Beside(NamedTuple):
    """Logs outside the analysis; cuts : starts that were left out, by the names of their logs."""

    problem: Problem
    predictor: Predictor
    cuts: Mapping[str, Fault] = MappingProxyType({})


@dataclass(frozen=True)
class Prepared:
    """What the selection starts from.

    library : name -> effect, of those that the mechanism may have; retuned : the model by filtered motion, without
    effects; theta (p,) : its parameters, or those on the way to them with which the logs can be predicted; cuts :
    starts of logs that were left out.
    """

    logs: tuple[Log, ...]
    problem: Problem
    library: dict[str, Kind]
    search: Search
    retuned: Fit
    theta: Floats
    predictor: Predictor
    cuts: tuple[Fault, ...] = ()

    def validation(self, problem: Problem) -> list[RowChoice]:
        """For each log which of its rows are of the validation set of a problem."""
        return _validation(problem, len(self.logs))

    def beside(self, logs: Sequence[Log]) -> Beside:
        """Logs outside the analysis, all of them the validation set, in the noise of the analysis."""
        problem, mechanism = Problem(sample(logs), self.problem.mechanism, None), self.problem.mechanism
        noise = self.problem.sampled.position_noise
        chosen = _validation(problem, len(logs))
        predictor = Predictor(logs, mechanism, chosen, None, noise, self.predictor.expected)
        left, cuts = _without_starts(logs, mechanism, predictor, self.theta)
        return self.beside(left)._replace(cuts=cuts) if cuts else Beside(problem, predictor)


def prepare(logs: Sequence[Log], mechanism: Mechanism, progress: Callable[[str, float], None] = silent) -> Prepared:
    """Sample logs, retune the parameters, and make the predictor; blocks of the logs are the validation set.

    Starts of logs that no input explains are left out.
    """
    found = _prepared(logs, mechanism, progress)
    left, cuts = _without_starts(logs, mechanism, found.predictor, found.theta)
    return replace(_prepared(left, mechanism, progress), cuts=tuple(cuts.values())) if cuts else found


def _prepared(logs: Sequence[Log], mechanism: Mechanism, progress: Callable[[str, float], None]) -> Prepared:
    """What the selection starts from, with all rows."""
    sampled = sample(logs)
    problem = Problem(sampled, mechanism)
    library = library_of(mechanism)
    search = Search(problem, library, progress)
    progress("retuning", 0.03)
    retuned = search.retune(mechanism.start)
    alike = problem.like(retuned.residual())
    if alike is not problem:
        problem, search = alike, Search(alike, library, progress)
        retuned = search.retune(retuned.theta)
    # standard deviation (J,) [V] of a row's voltage noise, without what may be an effect
    noise = np.sqrt([weights[0] for weights in search.noise_of(retuned.residual(), white_only=True)])
    scale = mechanism.drive(mechanism.start).volts_per_torque * np.asarray(mechanism.torque_scale)
    noise = np.clip(noise, FITTING.least_expected_noise * scale, FITTING.greatest_expected_noise * scale)
    predictor = Predictor(logs, mechanism, _validation(problem, len(logs)), None, sampled.position_noise, noise)
    theta = runnable(predictor, retuned.theta)
    return Prepared(tuple(logs), problem, library, search, retuned, theta, predictor)


def runnable(predictor: Predictor, theta: Floats) -> Floats:
    """Parameters (p,) on the way from `theta` to the start values with which the logs can be predicted.

    What the model lacks, such as a stop, may have driven them to where no machine stays finite.
    """
    mechanism = predictor.mechanism
    for share in FITTING.runnable_shares:
        at = mechanism.start + share * (theta - mechanism.start)
        with suppress(NonFiniteStateError, ParameterError):
            predictor.errors(Point(at, ()).plant(mechanism))
            return at
    return mechanism.start


def _without_starts(
    logs: Sequence[Log], mechanism: Mechanism, predictor: Predictor, theta: Floats
) -> tuple[list[Log], dict[str, Fault]]:
    """Logs without starts that no input explains, and the faults of these by the names of their logs. theta (p,) :
    retuned parameters."""
    point = Point(runnable(predictor, theta), ())
    held = held_starts(logs, predictor, predictor.errors(point.plant(mechanism)))
    left = [log if fault is None else log.part(slice(fault.rows, None)) for log, fault in zip(logs, held)]
    return left, {log.name: fault for log, fault in zip(logs, held) if fault is not None}


def _validation(problem: Problem, logs: int) -> list[RowChoice]:
    def choice(number: int) -> RowChoice:
        rows = problem.segment == number
        time, inside = problem.sampled.time[problem.kept[rows]], problem.validation[rows].astype(float)
        return lambda t: np.interp(t, time, inside) > 0.5

    return [choice(number) for number in range(logs)]
