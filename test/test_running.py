# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Models run along logs: which go side by side, and that each has the innovations that it has alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.fitting import predictor as predictor_module
from puma_sim_core.identify.fitting import running, together
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.running import Running
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.side_by_side import LEAST_TOGETHER
from puma_sim_core.simulation.simulator import Simulator

ARM = load_mechanism()
TIME = np.arange(0.0, 0.3, 2e-3)
VOLTS = 6.0 * np.sin(TIME[:, None] * [4.0, 5.0, 7.0] + [0.3, 2.0, 0.1])


def predictor(enable: np.ndarray | None = None) -> Predictor:
    """Of two logs of an arm that none of the models is."""
    simulator = Simulator(ARM.plant(ARM.start * 1.02))
    simulator.reset((0.1, -0.9, 1.1))
    position = simulator.run(TIME, VOLTS).position
    logs = [Log(f"log {n}", TIME + n, VOLTS, position, enable=enable) for n in range(2)]
    return Predictor(logs, ARM, [lambda t: t > 1e9] * 2, np.full(3, 0.05), np.full(3, 3e-5))


def points(count: int, *texts: str) -> list[Point]:
    """Models with these effects and as many different parameters."""
    effects = tuple(parse_effect(text) for text in texts)
    return [Point(ARM.start * (1.0 + 0.003 * n), effects) for n in range(count)]


#: a model of two masses that is too fast to be run with the setting below
IMPOSSIBLE = points(1, "joint_elasticity:joint=2,stiffness=1e7")[0]


@pytest.fixture(autouse=True)
def slow_models(monkeypatch):
    """No model that needs more than ten thousand steps in a second is run."""
    monkeypatch.setattr(running, "FITTING", replace(FITTING, greatest_rate=1e4))


def test_models_of_enough_others_with_the_same_stages_go_side_by_side():
    along = predictor()
    runs = Running(along)
    friction, limited = points(LEAST_TOGETHER + 1, "coulomb_friction:joint=2,torque=6"), points(LEAST_TOGETHER)
    few = points(LEAST_TOGETHER - 1, "current_limit:joint=2,current=3")
    soft = points(2, "joint_elasticity:joint=2,stiffness=20000")
    mixed = [*friction, IMPOSSIBLE, *few, *soft, *limited][::-1]
    found = runs.many(mixed)
    beside = {id(point) for point, ran in zip(mixed, found) if ran.beside and point is not IMPOSSIBLE}
    assert beside == {id(point) for point in [*friction, *limited]}
    for point, ran in zip(mixed, found):
        if point is IMPOSSIBLE:
            assert ran.errors is None and runs.one(point) is None
        else:
            np.testing.assert_allclose(ran.errors, along.errors(point.plant(ARM)), rtol=0.0, atol=1e-14)


def test_one_that_has_no_state_to_start_from_leaves_the_others_as_they_are(monkeypatch):
    along, given = predictor(), points(LEAST_TOGETHER + 1, "coulomb_friction:joint=2,torque=6")
    usual = Running(along).many(given)

    def started(plant, stretch, step):
        if plant.arm == given[1].plant(ARM).arm:
            raise ParameterError("no state", expected="one")
        return predictor_module.started(plant, stretch, step)

    monkeypatch.setattr(together, "started", started)
    found = Running(along).many(given)
    assert found[1].errors is None
    for n in (0, *range(2, len(given))):
        np.testing.assert_array_equal(found[n].errors, usual[n].errors)


def test_models_of_logs_with_a_drive_that_is_off_run_one_by_one():
    enable = np.ones((len(TIME), 3))
    enable[40:60] = 0.0
    assert not any(ran.beside for ran in Running(predictor(enable)).many(points(LEAST_TOGETHER + 4)))


def test_a_model_that_cannot_be_run_has_no_derivatives():
    with pytest.raises(ParameterError, match="a model that cannot be run"):
        Running(predictor()).derivatives(IMPOSSIBLE, ())
