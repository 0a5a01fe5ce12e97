# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Steps of a fit: which are tried, and what they lead to."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit, Slopes, best_damping
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism_file import load_mechanism

pytestmark = pytest.mark.long


def test_a_step_that_leaves_a_bent_valley_is_followed_by_one_back_into_it():
    class Valley(PredictionFit):
        """Errors of the product of two numbers, the first with a prior: b = 12 / a is the valley."""

        def __init__(self):
            self.rows, self.mechanism = (
                np.ones((1, 1), dtype=bool),
                SimpleNamespace(start=np.array([1.0]), deviations=np.array([0.1]), joints=1, clip=lambda x: x),
            )
            self.predictor = SimpleNamespace(feasible=lambda x: True)

        def errors(self, point):
            torque = point.effects[0].values["torque"]
            return np.array([[10.0 * (point.theta[0] * torque - 12.0)]])

        def errors_of(self, points):
            return [self.errors(point) for point in points]

    fit = Valley()
    start = Point(np.array([0.8]), (parse_effect("coulomb_friction:joint=1,torque=15"),))
    # derivatives per deviation and per size, about the start
    known, pairs = Slopes.of(10.0 * np.array([[15.0 * 0.1, 0.8 * 15.0]])), ((0, "torque"),)
    step, _ = fit._step(known, start, fit.errors(start), pairs)
    (_, away, _), (point, back, _), *_ = fit._tried(known, step, start, fit.errors(start), pairs)
    assert abs(back).max() < 0.3 * abs(away).max()
    # and it has come as far towards what is known beforehand
    assert point.theta[0] == pytest.approx(1.0, abs=0.02)
    assert fit.objective(back, point) < fit.objective(fit.errors(start), start)


def test_a_step_that_promises_nothing_is_not_tried():
    class Line(PredictionFit):
        """Errors that are linear in two numbers, the first with a prior."""

        def __init__(self):
            self.rows, self.runs = np.ones((1, 1), dtype=bool), 0
            self.mechanism = SimpleNamespace(start=np.array([1.0]), deviations=np.array([0.1]), clip=lambda x: x)
            self.predictor = SimpleNamespace(feasible=lambda x: True)

        def errors(self, point):
            self.runs += 1
            return np.array([[10.0 * (point.theta[0] + 0.2 * point.effects[0].values["torque"] - 3.0)]])

    fit, pairs = Line(), ((0, "torque"),)
    start = Point(np.array([0.8]), (parse_effect("coulomb_friction:joint=1,torque=9"),))
    # derivatives per deviation and per size
    known = Slopes.of(10.0 * np.array([[0.1, 0.2 * 9.0]]))
    before = fit.objective(fit.errors(start), start)
    step, promised = fit._step(known, start, fit.errors(start), pairs)
    moved = fit.stepped(start, step, pairs, fit.sizes(start, pairs))
    # all but for the least curvature that keeps a parameter without a prior regular
    assert promised == pytest.approx(before - fit.objective(fit.errors(moved), moved), rel=1e-4)
    first = fit.run(start, (), jacobian=known, frozen=pairs)
    fit.runs = 0
    again = fit.run(first.point, (), jacobian=known, frozen=pairs)
    assert first.objective < 1e-3 * before and again.objective == first.objective and fit.runs == 1


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("costs", [(4.0, 2.0, 1.0, 3.0), (1.0, 2.0, 3.0, 4.0), (4.0, 3.0, 2.0, 1.0), (np.inf,) * 4])
def test_the_best_damping_is_the_bottom_of_the_valley_that_the_first_one_is_in(costs, first):
    asked = []

    def cost(number):
        asked.append(number)
        return costs[number]

    best = best_damping(first, cost)
    assert best == (first if np.isinf(costs[first]) else int(np.argmin(costs)))
    assert len(asked) == len(set(asked)) and set(asked) <= set(range(len(FITTING.dampings)))


def test_a_step_after_a_damped_one_begins_with_what_damped_that():
    class Steeper(PredictionFit):
        """Errors thirty times as steep as their derivatives say: all but the most damped steps lead past zero."""

        def __init__(self):
            self.rows, self.runs = np.ones((2, 1), dtype=bool), []
            self.mechanism = SimpleNamespace(start=np.array([1.0]), deviations=np.array([10.0]), clip=lambda x: x)
            self.predictor = SimpleNamespace(feasible=lambda x: True)

        def errors(self, point):
            self.runs.append(point.theta[0])
            return 300.0 * np.array([[point.theta[0] - 3.0], [0.1 * (point.effects[0].values["torque"] - 9.0)]])

        def errors_of(self, points):
            return [self.errors(point) for point in points]

    start, pairs = Point(np.array([2.0]), (parse_effect("coulomb_friction:joint=1,torque=7"),)), ((0, "torque"),)
    known = Slopes.of(10.0 * np.diag([10.0, 0.7]))
    runs = []
    for rounds in range(1, 5):
        fit = Steeper()
        found = fit.run(start, (), jacobian=known, frozen=pairs, rounds=rounds)
        runs.append(len(fit.runs))
    # the start, a whole step, one back from it, parts and damped ones; after that the damped ones alone
    assert runs[0] == 3 + len(FITTING.step_shares) + len(FITTING.dampings)
    assert list(np.diff(runs)) == [len(FITTING.dampings)] * 3
    assert found.objective < 0.1 * Steeper().objective(Steeper().errors(start), start)


def test_a_step_to_a_model_is_the_one_that_leads_there():
    mechanism = load_mechanism("puma560")
    predictor = SimpleNamespace(fit_rows=None, mechanism=mechanism, feasible=lambda theta: True)
    fit = PredictionFit(predictor, None)
    point = Point(
        mechanism.start,
        (
            parse_effect("stribeck_friction:joint=1,torque=2,velocity=0.05,sliding=1"),
            parse_effect("current_limit:joint=3,current=2.0"),
        ),
    )
    pairs = ((0, "torque"), (0, "velocity"), (1, "current"))
    rng = np.random.default_rng(3)
    sizes = fit.sizes(point, pairs)
    step = 0.2 * rng.normal(size=len(mechanism.start) + len(pairs))
    other = fit.stepped(point, step, pairs, sizes)
    assert fit.step_to(point, other, pairs, sizes) == pytest.approx(step, rel=1e-9)
    assert other.effects[1].values["current"] != 2.0
