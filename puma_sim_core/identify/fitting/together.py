# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Models that run along the logs of a predictor side by side, where the kernel has lanes for them."""

from collections.abc import Sequence

import numpy as np

from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting.predictor import Predictor, Stretch, started
from puma_sim_core.identify.fitting.steps import parts_of_steps, stable_step
from puma_sim_core.identify.parallel import parallel_map
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.side_by_side import LEAST_TOGETHER, TOGETHER, goes_side_by_side, innovations_side_by_side
from puma_sim_core.simulation.simulator import Simulator


def errors_side_by_side(predictor: Predictor, plants: Sequence[Plant | None]) -> dict[int, Floats | None]:
    """`Predictor.errors` but for the last bits, None where a state is not finite, by the number of each plant that goes
    side by side with enough others."""
    if any(s.enable is not None for s in predictor.stretches):
        return {}
    groups = list[dict[int, Plant]]()
    for n, plant in enumerate(plants):
        if plant is None or not goes_side_by_side(plant, plant):
            continue
        own = next((own for own in groups if _goes_beside(predictor, plant, next(iter(own.values())))), None)
        if own is None:
            groups.append({n: plant})
        else:
            own[n] = plant
    out = dict[int, Floats | None]()
    for group in groups:
        if len(group) >= LEAST_TOGETHER:
            out |= zip(group, _errors(predictor, list(group.values())))
    return out


def _goes_beside(predictor: Predictor, plant: Plant, first: Plant) -> bool:
    step = predictor.greatest_step
    return goes_side_by_side(plant, first) and stable_step(plant, step) == stable_step(first, step)


def _errors(predictor: Predictor, plants: Sequence[Plant]) -> list[Floats | None]:
    """(N, J) innovations of each of a group of plants."""
    starts = [_starts(predictor, plant) for plant in plants]
    able = [own for own in starts if own is not None]
    logs = [_of_log(predictor, s, [own[k] for own in able]) for k, s in enumerate(predictor.stretches)]
    ran = iter([np.concatenate(parts) for parts in zip(*logs)])
    found = [None if own is None else next(ran) for own in starts]
    return [None if errors is None or not np.isfinite(errors).all() else errors for errors in found]


def _starts(predictor: Predictor, plant: Plant) -> list[Simulator] | None:
    """Simulators at the first row of each log; None where a plant has no state there."""
    try:
        return [started(plant, s, predictor.greatest_step) for s in predictor.stretches]
    except ParameterError:
        return None


def _of_log(predictor: Predictor, s: Stretch, simulators: Sequence[Simulator]) -> list[Floats]:
    """Innovations (n - 1, J) of one log by several simulators."""
    groups = [simulators[n : n + TOGETHER] for n in range(0, len(simulators), TOGETHER)]

    def run(group: Sequence[Simulator]) -> list[Floats]:
        parts = [parts_of_steps(simulator.plant, predictor.greatest_step) for simulator in group]
        return innovations_side_by_side(group, s.time, s.voltage, s.position, predictor.gain, parts)

    return [errors for own in parallel_map(run, groups) for errors in own]
