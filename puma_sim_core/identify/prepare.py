# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs made ready for the selection: sampling, retuned parameters, noise, Kalman predictor."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from puma_sim_core.effects import KINDS, Kind
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.fitting.predictor import Predictor, RowChoice
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.screening.search import Fit, Search
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism import Mechanism


def silent(what: str, share: float) -> None:
    """Show no progress."""


def library_of(mechanism: Mechanism) -> dict[str, Kind]:
    """name -> effect, of those that are sought on a mechanism."""
    return {name: kind for name, kind in KINDS.items() if kind.screening is not None and mechanism.possible(name)}


@dataclass(frozen=True)
class Prepared:
    """What the selection starts from.

    library : name -> effect, of those that the mechanism may have; retuned : parameters by filtered motion, without
    effects.
    """

    logs: tuple[Log, ...]
    problem: Problem
    library: dict[str, Kind]
    search: Search
    retuned: Fit
    predictor: Predictor

    def validation(self, problem: Problem) -> list[RowChoice]:
        """For each log which of its rows are of the validation set of a problem."""
        return _validation(problem, len(self.logs))

    def beside(self, logs: Sequence[Log]) -> tuple[Problem, Predictor]:
        """Logs outside the analysis, all of them the validation set, in the noise of the analysis."""
        sampled = sample(logs)
        problem, mechanism = Problem(sampled, self.problem.mechanism, None), self.problem.mechanism
        noise = self.problem.sampled.position_noise
        chosen = _validation(problem, len(logs))
        return problem, Predictor(logs, mechanism, chosen, None, noise, self.predictor.expected)


def prepare(logs: Sequence[Log], mechanism: Mechanism, progress: Callable[[str, float], None] = silent) -> Prepared:
    """Sample logs, retune the parameters, and make the predictor; blocks of the logs are the validation set."""
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
    return Prepared(tuple(logs), problem, library, search, retuned, predictor)


def _validation(problem: Problem, logs: int) -> list[RowChoice]:
    def choice(number: int) -> RowChoice:
        rows = problem.segment == number
        time, inside = problem.sampled.time[problem.kept[rows]], problem.validation[rows].astype(float)
        return lambda t: np.interp(t, time, inside) > 0.5

    return [choice(number) for number in range(logs)]
