# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Columns of the screening of the innovations beside runs of the model, on arms whose joints move each other."""

from __future__ import annotations

import numpy as np
import pytest
from loop_fits import of_machine, screen_of
from loop_logs import pieces, record
from machines.records import Record

from puma_sim_core.effects import KINDS, Effect, parse_effect
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.plant.mechanism_file import load_mechanism

pytestmark = pytest.mark.long


def model_of(fit, point):
    """A model as if it had been fitted."""
    errors = fit.errors(point)
    return Fitted(point, errors, fit.objective(errors, point), ())


@pytest.fixture(scope="module", params=["puma560", "dfki_double_a0", "so101_pitch", "qube_pendulum"])
def coupled(request, tmp_path_factory):
    """The fit of a log of a machine that lacks nothing, the true model, and its screening."""
    if request.param == "puma560":
        arm = load_mechanism()
        problem, _, predictor = pieces(arm, record(arm, arm.plant(), volts=0.02, noise=1e-5, seconds=6.0), 0.02, 1e-5)
        fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(arm.plant())))
        model = model_of(fit, Point(arm.start, ()))
        return fit, model, screen_of(fit, Trials(predictor, problem), model)
    made = Record(3, request.param)
    made.effects = ()
    fit, trials, true = of_machine(made, tmp_path_factory.mktemp("log"))
    model = model_of(fit, true)
    return fit, model, screen_of(fit, trials, model)


@pytest.mark.parametrize("joint", [1, 2, 3])
@pytest.mark.parametrize("name, size", [("voltage_offset", 1e-3), ("quadratic_friction", 1e-3)])
def test_a_column_is_what_a_small_effect_takes_from_the_innovations_of_all_joints(coupled, name, size, joint):
    fit, model, screen = coupled
    if joint > fit.mechanism.joints or not fit.mechanism.possible(name, joint):
        pytest.skip("no such joint, or one without a motor")
    kind = KINDS[name]
    ((candidate, columns),) = screen.pairs(kind, joint)[:1]
    little = size * fit.mechanism.torque_scale[joint - 1]
    errors = fit.errors(Point(model.point.theta, (Effect(kind, joint, {kind.parameters[0].name: little}),)))
    taken = [screen._blocks((model.errors - errors)[:, j : j + 1], j)[:, 0] for j in range(screen.J)]
    made = [columns[j][:, 0] if j in columns else np.zeros_like(own) for j, own in enumerate(taken)]
    assert candidate.values(np.array([little])) == {kind.parameters[0].name: pytest.approx(little)}
    # behind the start, where a run begins with the current of its own model
    both, found = (np.concatenate([own[100:] for own in each]) for each in (taken, [little * own for own in made]))
    # the columns go by a linear model, at the usual inertia
    assert both @ found > 0.98 * np.linalg.norm(both) * np.linalg.norm(found)
    assert 0.85 < np.linalg.norm(found) / np.linalg.norm(both) < 1.15


def test_the_elasticity_of_a_joint_whose_rotor_is_light_beside_its_link_is_seen(tmp_path):
    """The column by the motion of the rotor sees nothing of it: the rotor swings against the link, at 22 Hz here."""
    made = Record(47, "qube_pendulum")
    made.effects = (parse_effect("joint_elasticity:joint=1,stiffness=1.9,damping=0.003"),)
    fit, trials, true = of_machine(made, tmp_path)
    model, _ = fit.to_end(Point(true.theta, ()), ())
    found = screen_of(fit, trials, model).score(KINDS["joint_elasticity"], 1)
    assert found.gain > 40.0 and 0.5 < found.values["stiffness"] / 1.9 < 2.0
    base = trials.base(model, fit.weighting, fit.derivatives(model.point, ()))
    trial = trials.run(base, found)
    assert trial.gain > found.gain and trial.effect.values["stiffness"] == pytest.approx(1.9, rel=0.2)


def test_a_ripple_of_few_waves_a_turn_of_the_joint_is_sought_where_the_joint_travels_one(tmp_path):
    """A pendulum whose drive has no gear that is known: its motor turns as its joint does."""
    made = Record(1325)
    made.effects = (parse_effect("torque_ripple:joint=1,amplitude=0.12,order=3,phase=2.3,ratio=1"),)
    fit, trials, true = of_machine(made, tmp_path)
    model, _ = fit.to_end(Point(true.theta, ()), ())
    screen = screen_of(fit, trials, model)
    found = screen.score(KINDS["torque_ripple"], 1)
    assert found.gain > 100.0 and found.values["order"] == 3.0
    assert found.values["amplitude"] == pytest.approx(0.12, rel=0.1)
    # one wave a turn is what gravity is
    orders = {candidate.grid["order"] for candidate, _ in screen.pairs(KINDS["torque_ripple"], 1)}
    assert min(orders) > 1.0
