# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Occam factors: against integrals over priors, and what they do to a richer effect."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from puma_sim_core.effects import KINDS, Effect, parse_effect
from puma_sim_core.identify.fitting import occam
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted
from puma_sim_core.identify.screening.evidence import Scored

SCALE = 10.0
WITH_COORDINATES = [
    name for name, kind in KINDS.items() if kind.screening is not None and kind.screening.coordinates is not None
]


class Fit:
    """Sizes of parameters and their priors as `PredictionFit` has them, without a log."""

    mechanism = SimpleNamespace(torque_scale=np.full(3, SCALE))

    def sizes(self, point, pairs):
        return [max(abs(point.effects[number].values[name]), 0.01) for number, name in pairs]

    def prior(self, point, pairs):
        return np.zeros(len(pairs)), np.full(len(pairs), 1e-9)


def factor_of(text: str, spread: dict[str, float], others: int = 2) -> float:
    """Occam factor of an effect of which a log leaves these deviations, in units of its parameters."""
    effect = parse_effect(text)
    point, names = Point(np.zeros(others), (effect,)), tuple((0, name) for name in spread)
    sizes = Fit().sizes(point, names)
    jacobian = np.diag(np.r_[np.ones(others), np.array(sizes) / np.array([*spread.values()])])
    scored = Scored(effect.kind.name, effect.joint, 0.0, values=dict(effect.values))
    return occam.factor(scored, Fit(), Fitted(point, np.zeros((1, 3)), 0.0, names, jacobian))


@pytest.mark.parametrize(
    "distance, deviation, left", [(0.0, 1.0, 0.01), (0.7, 1.0, 0.3), (-2.0, 0.5, 0.4), (1.0, 0.2, 5.0)]
)
def test_an_occam_factor_is_the_likelihood_at_its_best_over_its_mean_in_the_prior(distance, deviation, left):
    def integrand(x):
        return np.exp(-0.5 * ((x - distance) / left) ** 2) * norm.pdf(x, 0.0, deviation)

    mean, _ = quad(integrand, -12.0, 12.0, points=[0.0, distance], limit=400)
    found = occam.gaussian(np.array([distance]), np.array([deviation]), np.array([[left**2]]))
    assert found == pytest.approx(-np.log(mean), rel=1e-6)


def test_an_occam_factor_of_several_coefficients_is_that_of_all_together():
    rng = np.random.default_rng(5)
    for _ in range(20):
        root = rng.normal(size=(3, 3))
        covariance = root @ root.T + 0.01 * np.eye(3)
        deviation, distance = rng.uniform(0.1, 3.0, 3), rng.normal(size=3)
        mean = multivariate_normal.logpdf(distance, np.zeros(3), covariance + np.diag(deviation**2))
        best = multivariate_normal.logpdf(np.zeros(3), np.zeros(3), covariance)
        assert occam.gaussian(distance, deviation, covariance) == pytest.approx(best - mean)


def test_what_a_log_says_nothing_of_has_no_occam_factor():
    covariance = np.diag([0.01, 1e14])
    both = occam.gaussian(np.array([0.5, 3.0]), np.ones(2), covariance)
    assert both == pytest.approx(occam.gaussian(np.array([0.5]), np.ones(1), covariance[:1, :1]))


def test_a_shape_of_friction_costs_as_much_at_any_level():
    def more(level):
        one = factor_of(f"coulomb_friction:joint=1,torque={level}", {"torque": 0.05 * level})
        two = factor_of(
            f"asymmetric_coulomb_friction:joint=1,positive={1.2 * level},negative={0.8 * level}",
            {"positive": 0.05 * 2**0.5 * level, "negative": 0.05 * 2**0.5 * level},
        )
        return two - one

    # a difference of levels of 0.2 of their mean, known to 0.05 of it, about 0 with 0.3
    wanted = 0.5 * np.log1p((0.3 / 0.05) ** 2) + 0.5 * 0.2**2 / (0.3**2 + 0.05**2)
    for level in (0.1, 1.0, 10.0):
        assert more(level) == pytest.approx(wanted, rel=1e-6)


def test_a_bump_that_no_machine_has_costs_more_than_one_of_the_usual_size():
    def of(torque, velocity):
        return factor_of(
            f"stribeck_friction:joint=2,torque={torque},velocity={velocity},sliding=1",
            {"torque": 0.1, "velocity": 0.3 * velocity, "sliding": 0.1},
        )

    usual = of(0.65, 0.045)
    assert of(0.0, 0.045) > usual + 1.5 and of(4.0, 0.045) > usual + 1.5
    # how fast it is, the objective of the fit says
    assert of(0.65, 0.004) == pytest.approx(usual, rel=1e-6)
    # machines are not Gaussian: the farthest is no farther than some deviations
    assert of(40.0, 0.045) < usual + 9.0


def test_a_variation_over_the_position_costs_the_same_wherever_it_is_greatest():
    found = [
        factor_of(
            f"position_dependent_friction:joint=3,torque=2,amplitude=0.8,angle={angle}",
            {"torque": 0.1, "amplitude": 0.2, "angle": 0.25},
        )
        for angle in (-2.5, 0.0, 0.4, 3.0)
    ]
    assert found == pytest.approx([found[0]] * 4, rel=1e-5)


@pytest.mark.parametrize("name", WITH_COORDINATES)
def test_coordinates_are_finite_wherever_the_parameters_are_legal(name):
    kind = KINDS[name]
    for share in (0.0, 1e-6, 0.01, 1.0):
        values = {p.name: p.low + share * (p.high - p.low) for p in kind.parameters}
        table = kind.screening.coordinates(Effect(kind, 1, values).values, SCALE)
        assert table.shape == (len(kind.parameters), 3) and np.isfinite(table).all()
        assert (table[:, 2] > 0.0).all()


@pytest.mark.parametrize("screened, count, wanted", [(-2.0, 2, 3.0), (4.0, 1, 4.0), (80.0, 1, 6.0), (80.0, 3, 18.0)])
def test_an_occam_factor_of_the_screening_is_bounded_by_those_of_its_coefficients(screened, count, wanted):
    scored = Scored("payload", None, 10.0, values={str(n): 1.0 for n in range(count)}, occam=screened)
    assert occam.screened(scored) == wanted


def test_a_direction_that_the_log_says_nothing_of_has_no_factor_however_little_it_says():
    """The same limit from covariances that the prior still shows beside, and from one that rounds it away."""
    distance, deviation = np.array([0.3, -0.7]), np.array([0.5, 2.0])
    flat = np.outer(deviation, deviation)  # the sum of both coordinates, per deviation, is all but free

    def of(size):
        return occam.gaussian(distance, deviation, size * flat)

    # only the difference of the two is held, to nothing but the prior
    far = distance / deviation
    expected = (
        of(1e9) + 0.25 * (far[0] - far[1]) ** 2 - 0.5 * far @ np.linalg.solve(1e9 * np.ones((2, 2)) + np.eye(2), far)
    )
    for size in (1e13, 1e16, 1e20, 1e30):
        assert of(size) == pytest.approx(expected, abs=1e-4)
