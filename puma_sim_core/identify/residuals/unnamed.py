# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What is left of a log after a model, as free curves; whether a curve is preferred to the named effects.

What is missing may have stretched parameters, and it shows at the joints that the inertia couples to its own: so curves
are fitted about the parameters as they are when the best curve takes its part.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from puma_sim_core.identify.fitting.prediction import Fitted, Pairs, Point, PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.residuals import shape
from puma_sim_core.identify.residuals.shape import Curve
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.selection.state import SelectionState
from puma_sim_core.identify.settings import RESIDUALS, SELECTION


def remainder(state: SelectionState, curves: Sequence[Curve], chance: float, left: np.ndarray) -> Curve | None:
    """The best free curve about what was chosen, where it is more than chance and than model discrepancy; else None.

    curves : best first; chance [nat] : greatest gain of a placebo; left (J,) : residual over its floor.
    """
    if not curves:
        return None
    best = curves[0]
    first = max((chosen.gain for chosen in state.chosen), default=0.0)
    inexact = left[best.joint - 1] < RESIDUALS.above_floor
    by_chance = RESIDUALS.placebo_factor * chance + RESIDUALS.placebo_margin
    need = max(RESIDUALS.least_remainder, by_chance, RESIDUALS.remainder_share * first * inexact)
    return best if best.scored.gain > need else None


def curve_preferred(curve: float, names: float, occam: float, remains: bool) -> bool:
    """Whether a free curve about the model without effects is preferred to the named effects.

    curve, names : sums of squares of the innovations after whitening of its joint that they leave; occam [nat] : Occam
    factor of the curve's heights; remains : whether something remains after the named effects.
    """
    if remains:
        return curve < RESIDUALS.clearly_less * names
    # names that explain all leave but noise, of which no curve leaves less
    return curve < RESIDUALS.less_than_all * names and 0.5 * (names - curve) - occam > SELECTION.least_gain


class Unnamed:
    """Free curves about the models of one problem. seed : of the placebos."""

    def __init__(self, predictor: Predictor, problem: Problem, seed: int):
        self.predictor = predictor
        self.problem = problem
        self.mechanism = problem.mechanism
        self.seed = seed

    def shapes(self, final: Fitted) -> tuple[list[Curve], float]:
        """Free curves against what a model leaves, in the noise that the best of them leaves; the
        greatest gain that chance gives any of them."""
        unit = self.mechanism.position_unit
        causal, found = self._about(final)
        point, volts, _ = self._relaxed(causal, found, final)
        if volts is not None:
            causal = self._causal(point, final.names, causal.fit.weighting, volts)
            found = shape.curves(causal, unit)
        noise = shape.noise(causal, found)
        causal = self._causal(point, final.names, noise, volts)
        found = shape.simplest_first(shape.curves(causal, unit))
        rng = np.random.default_rng(self.seed + 1)
        shifts = np.sort(rng.uniform(*RESIDUALS.placebo_shifts, RESIDUALS.placebos))
        return found, shape.chance(causal, found, shifts)

    def preferred(self, bare: Fitted, named: Fitted, joints: Collection[int] | None, remains: bool) -> bool:
        """Whether a free curve about a model without effects leaves clearly less of its joint's innovations than a
        model with named effects does, in the noise that the curve leaves.

        joints : where the effects act (1-based; None: on all); remains : whether something remains after them.
        """
        causal, found = self._about(bare, joints)
        if not found:
            return False
        point, volts, curve = self._relaxed(causal, found, bare, joints)
        assert curve is not None
        if volts is not None:
            causal = self._causal(point, bare.names, causal.fit.weighting, volts)
        noise = shape.noise(causal, [shape.again(causal, curve)])
        causal = self._causal(point, bare.names, noise, volts)
        best = shape.again(causal, curve)
        j = best.joint - 1
        rows = self.predictor.fit_rows[:, j]
        left = causal.left(best.candidate, best.heights)[rows, j]
        names = noise(self._raw(named.point))[rows, j]
        return curve_preferred(float(left @ left), float(names @ names), best.scored.price, remains)

    def _about(self, final: Fitted, joints: Collection[int] | None = None) -> tuple[CausalScreen, list[Curve]]:
        """The screen about a model, and its curves, best first."""
        # the first noise is the least that the innovations allow: one fitted to all that is left
        # would take what is missing for noise
        plain = self.predictor.white_weighting(self._raw(final.point))
        causal = self._causal(final.point, final.names, plain)
        return causal, shape.curves(causal, self.mechanism.position_unit, joints)

    def _raw(self, point: Point) -> np.ndarray:
        return self.predictor.errors(self.mechanism.plant(point.theta, point.effects))

    def _causal(
        self, point: Point, names: Pairs, weighting: Weighting, volts: np.ndarray | None = None
    ) -> CausalScreen:
        """The screen about a point whose effects have these free parameters. volts (N, J) [V] : what a curve takes of
        the voltage; the plant gets the rest, and the innovations show the curve at its own joint alone."""
        fit = PredictionFit(self.predictor, weighting)
        if volts is None:
            raw = self._raw(point)
        else:
            plant = self.mechanism.plant(point.theta, point.effects)
            raw = self.predictor.less(volts).errors(plant) + self.predictor.shown(volts)
        return CausalScreen(fit, point, weighting(raw), fit.white(fit.derivatives(point, names)), self.problem)

    def _stretched(self, point: Point) -> bool:
        """Whether parameters are farther from their start than their priors allow."""
        m = self.mechanism
        return bool(np.any(np.abs(point.theta - m.start) > RESIDUALS.stretched * m.deviations))

    def _relaxed(
        self, causal: CausalScreen, found: list[Curve], final: Fitted, joints: Collection[int] | None = None
    ) -> tuple[Point, np.ndarray | None, Curve | None]:
        """The parameters as they are when the curve that explains the log best takes its part (N, J) [V] of the
        voltage, that part, None where it is too little to matter, and the curve.

        What is missing may have stretched parameters so far that no curve fits about them, and it shows at the joints
        that the inertia couples to its own: so the best curve of each of the joints (1-based; None: of all) is tried.
        causal, found : screen about the model, and its curves.
        """
        stretched, first = self._stretched(final.point), next(iter(found), None)
        if not stretched and (first is None or first.scored.gain < RESIDUALS.much):
            return final.point, None, first
        about = [(causal, found)]
        if stretched:
            nominal = Point(self.mechanism.start, final.point.effects)
            causal = self._causal(nominal, final.names, causal.fit.weighting)
            about.append((causal, shape.curves(causal, self.mechanism.position_unit, joints)))
        tried: list[tuple[float, int, Point, np.ndarray, Curve]] = []
        for causal, found in about:
            # where parameters stay near, so do derivatives by them; those of two masses take long
            anew = stretched and not causal.point.two_mass
            jacobian = None if anew else causal.jacobian[causal.fit.rows]
            free, frozen = (final.names, ()) if anew else ((), final.names)
            for curve in shape.best_of_joints(found, RESIDUALS.rival_share):
                volts = curve.volts(causal)
                fit = PredictionFit(self.predictor.less(volts), causal.fit.weighting)
                fitted = fit.run(causal.point, free, jacobian=jacobian, frozen=frozen)
                if fitted is not None:
                    tried.append((fitted.objective + curve.scored.price, len(tried), fitted.point, volts, curve))
        return min(tried)[2:] if tried else (final.point, None, first)
