# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Fits and intervals along what a log does not tell: torques, inertias and the gain of a drive in one proportion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loop_fits import PENDULUM, of_machine
from loop_logs import pieces
from machines.records import Record

from puma_sim_core.effects import Effect, parse_effect
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.fitting.intervals import intervals
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.simulation.simulator import Simulator

pytestmark = pytest.mark.long
RECORD = Record(5, "dfki_pendulum")
MACHINE = RECORD.mechanism
NAMES = [parameter.name for parameter in MACHINE.free]
#: what a drive with another gain has in proportion to it
SCALED = [NAMES.index(n) for n in ("gain", "mass", "lever_inertia", "motor_inertia", "viscous_friction")]
TEXTS = ("coulomb_friction:joint=1,torque=0.3", "impulse:joint=1,torque=1.2,time=2.8,width=0.1")


def in_proportion(point, share):
    """The same motion under the same input, by a machine of other torques."""
    theta = point.theta.copy()
    theta[SCALED] *= share
    effects = (Effect(e.kind, e.joint, {**e.values, "torque": share * e.values["torque"]}) for e in point.effects)
    return Point(theta, tuple(effects))


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A fit to a log with dry friction and a push, the pairs that are free, and the model fitted from the truth."""
    RECORD.effects = tuple(map(parse_effect, TEXTS))
    fit, trials, true = of_machine(RECORD, tmp_path_factory.mktemp("log"))
    free = trials.free(true)
    return fit, free, fit.to_last(true, free)[0]


def test_what_a_log_does_not_tell_changes_no_innovation(fitted):
    fit, _, best = fitted
    for share in (0.5, 1.5):
        assert np.abs(fit.errors(in_proportion(best.point, share)) - best.errors).max() < 1e-6


def test_derivatives_along_it_are_next_to_none(fitted):
    fit, free, best = fitted
    jacobian = fit.whitened(fit.derivatives(best.point, free, central=True))
    along, sizes = np.zeros(jacobian.shape[1]), fit.sizes(best.point, free)
    along[SCALED] = best.point.theta[SCALED] / MACHINE.deviations[SCALED]
    for k, (number, name) in enumerate(free):
        if name == "torque":
            along[len(NAMES) + k] = best.point.effects[number].values[name] / sizes[k]
    left, parts = np.linalg.norm(jacobian @ along), np.linalg.norm(jacobian * along, axis=0)
    assert left < 0.01 * parts.max()


def test_at_the_end_of_a_range_central_derivatives_are_those_to_the_other_side(fitted):
    fit, free, best = fitted
    viscous = NAMES.index("viscous_friction")
    theta = best.point.theta.copy()
    # the least that the mechanism may have: a step below it changes nothing
    theta[viscous] = MACHINE.clip(np.where(np.arange(len(theta)) == viscous, 0.0, theta))[viscous]
    at = Point(theta, best.point.effects)
    ahead, central = (fit.derivatives(at, free, central=central)[:, :, viscous] for central in (False, True))
    assert np.linalg.norm(central - ahead) < 0.01 * np.linalg.norm(ahead) and np.linalg.norm(ahead) > 0.0


@pytest.mark.parametrize("share", [0.55, 1.7])
def test_a_fit_goes_along_it_to_where_the_priors_lead(fitted, share):
    """Seen on this log: a fit ended with half of all torques, 6 nat from its end, and gave the friction to 2 %."""
    fit, free, best = fitted
    found, jacobian = fit.to_last(in_proportion(best.point, share), free)
    found = replace(found, jacobian=fit.whitened(jacobian))
    assert found.objective < best.objective + 1.0
    value, low, high = intervals(fit, found)[0, "torque"]
    assert low < 0.3 < high and high - low > 0.2 * value


@pytest.mark.parametrize("seed", [3, 5])
def test_an_interval_goes_on_where_the_derivatives_change(seed):
    """A drive lifts a weight and holds it with less and less: friction by load has a least size, and the drive's gain
    takes up the rest. About that least size a joint that nearly slips has derivatives that it does not have beyond."""
    true, rng = (
        parse_effect("load_dependent_friction:joint=1,coefficient=0.45,transmitted=1"),
        np.random.default_rng(seed),
    )
    plant, time = PENDULUM.plant(effects=(true,)), np.arange(0.0, 6.0, 0.005)
    voltage = np.interp(time, [0.0, 0.3, 2.5, 3.0, 6.0], [0.0, 0.0, 6.5, 6.5, 3.0])[:, None]
    simulator = Simulator(plant, max_step=1e-3)
    simulator.reset([0.0])
    position = simulator.run(time, voltage + 0.1 * rng.standard_normal(voltage.shape)).position
    log = Log("own", time, voltage, position + 3e-4 * rng.standard_normal(voltage.shape))
    _, _, predictor = pieces(PENDULUM, log, 0.1, 3e-4)
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(plant)))
    model, _ = fit.to_end(Point(PENDULUM.start, (true,)), ((0, "coefficient"),))
    value, low, high = intervals(fit, model)[0, "coefficient"]
    assert low < value < high
    for end in (low, high):
        there, _ = fit.to_end(
            Point(model.point.theta, (Effect(true.kind, 1, {**true.values, "coefficient": end}),)), ()
        )
        assert there.objective - model.objective > 0.9 * 0.5 * FITTING.normal_quantile**2
