# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What is left of a log after a model, as free curves; whether a curve is preferred to the named effects.

What is missing may have stretched parameters: curves are fitted about those beside the best curve.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from puma_sim_core.identify.arrays import Floats, log_rows
from puma_sim_core.identify.fitting.point import Pairs, Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit, Slopes
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.residuals import shape
from puma_sim_core.identify.residuals.shape import Curve
from puma_sim_core.identify.screening.causal import CausalScreen, placebo_shifts
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.selection.state import SelectionState
from puma_sim_core.identify.settings import RESIDUALS, SELECTION


def remainder(state: SelectionState, curves: Sequence[Curve], chance: float, left: Floats) -> Curve | None:
    """The best free curve about what was chosen, where it is more than chance and than model discrepancy; else None.

    curves : best first; chance [nat] : what they gain by chance (`shape.chance`); left (J,) : residual over its floor.
    """
    if not curves:
        return None
    best = curves[0]
    first = max((chosen.gain for chosen in state.chosen), default=0.0)
    inexact = left[best.joint - 1] < RESIDUALS.above_floor
    need = max(RESIDUALS.least_remainder, chance, RESIDUALS.remainder_share * first * inexact)
    return best if best.scored.gain > need else None


@dataclass(frozen=True)
class Explained:
    """An explanation in a given noise. cost [nat] : half the sum of squares of innovations and of the priors, and Occam
    factors; pieces (k,) [nat] : half the sums of squares of the innovations by pieces of the logs."""

    cost: float
    pieces: Floats

    def better(self, other: Explained) -> bool:
        """Whether it is better than another by more than `RESIDUALS.standard_errors` of the difference.

        The difference is a sum over pieces that are longer than noise lasts; its standard error is that of such a sum
        (Vuong 1989, Econometrica 57:307).
        """
        difference = other.pieces - self.pieces
        error = float(difference.std(ddof=1)) * np.sqrt(len(difference)) if len(difference) > 1 else 0.0
        return bool(other.cost - self.cost > RESIDUALS.standard_errors * error)


def curve_preferred(curve: Explained, names: Explained, both: Explained) -> bool:
    """Whether a free curve about the model without effects takes the place of the named effects.

    It must be better than they are, and they must add nothing to it: a curve over another quantity may leave less of
    what else is missing, and names fall only where it takes over what they explain.
    """
    gained = bool(names.cost - curve.cost > SELECTION.least_gain)
    return gained and curve.better(names) and not both.better(curve)


class Unnamed:
    """Free curves about the models of one problem. seed : of the placebos."""

    def __init__(self, predictor: Predictor, problem: Problem, seed: int):
        self.predictor = predictor
        self.problem = problem
        self.mechanism = problem.mechanism
        self.seed = seed

    def shapes(self, final: Fitted) -> tuple[list[Curve], float]:
        """Free curves against what a model leaves, in the noise that they leave, and what chance gives them."""
        unit = self.mechanism.position_unit
        causal, found = self._about(final)
        point, volts, _ = self._relaxed(causal, found, final)
        if volts is not None:
            causal = self._causal(point, final.names, causal.fit.weighting, volts)
            found = shape.curves(causal, unit)
        noise = shape.noise(causal, found)
        causal = self._causal(point, final.names, noise, volts)
        found = shape.simplest_first(shape.curves(causal, unit))
        return found, shape.chance(causal, found, placebo_shifts(self.seed + 1))

    def preferred(self, bare: Fitted, named: Fitted, occam: float, joints: Collection[int] | None) -> bool:
        """Whether a free curve about a model without effects takes the place of the named effects.

        occam [nat] : Occam factors of the effects; joints : where they act (1-based; None: on all).
        """
        causal, found = self._about(bare, joints)
        if not found:
            return False
        point, volts, curve = self._relaxed(causal, found, bare, joints)
        assert curve is not None
        if volts is not None:
            causal = self._causal(point, bare.names, causal.fit.weighting, volts)
        # in the noise that the curve leaves, never in that of the bare model, which counts what is missing as noise
        noise = shape.noise_after(causal, shape.again(causal, curve))
        causal = self._causal(point, bare.names, noise, volts)
        # the names fitted in the same noise as the curve
        fit = PredictionFit(self.predictor, noise)
        again, raw = fit.to_end(named.point, named.names, times=1)
        beside = CausalScreen(fit, again.point, again.errors, fit.whitened(raw), self.problem)
        alone = self._explained(causal, shape.again(causal, curve), 0.0)
        both = self._explained(beside, shape.again(beside, curve), occam)
        return curve_preferred(alone, self._explained(beside, None, occam), both)

    def _explained(self, causal: CausalScreen, curve: Curve | None, occam: float) -> Explained:
        """A screen's model with a curve or without, its parameters having answered; occam [nat] : of its effects."""
        estimate = None if curve is None else curve.scored.estimate
        cost = causal.fit.objective(causal.errors, causal.point) - 0.5 * float(causal.Ny @ causal.scaled) + occam
        if curve is not None and estimate is not None:
            cost += curve.scored.occam - estimate.likelihood
        squares = 0.5 * (causal.left(estimate) ** 2).sum(axis=1)
        longest = max(1, int(SELECTION.noise_piece / self.predictor.step))
        pieces = []
        for rows in log_rows(self.predictor.lengths):
            parts = np.array_split(squares[rows], max(1, (rows.stop - rows.start) // longest))
            pieces += [float(part.sum()) for part in parts]
        return Explained(cost, np.array(pieces))

    def _about(self, final: Fitted, joints: Collection[int] | None = None) -> tuple[CausalScreen, list[Curve]]:
        """The screen about a model, in the least noise that its innovations allow, and its curves, best first."""
        plain = self.predictor.unfiltered_weighting(self._raw(final.point))
        causal = self._causal(final.point, final.names, plain)
        return causal, shape.curves(causal, self.mechanism.position_unit, joints)

    def _raw(self, point: Point) -> Floats:
        return self.predictor.errors(point.plant(self.mechanism))

    def _causal(self, point: Point, names: Pairs, weighting: Weighting, volts: Floats | None = None) -> CausalScreen:
        """The screen about a point and the free parameters of its effects. volts (N, J) [V] : a curve's part."""
        fit = PredictionFit(self.predictor, weighting)
        if volts is None:
            raw = self._raw(point)
        else:
            plant = point.plant(self.mechanism)
            raw = self.predictor.less(volts).errors(plant) + self.predictor.shown(volts)
        return CausalScreen(fit, point, weighting(raw), fit.whitened(fit.derivatives(point, names)), self.problem)

    def _relaxed(
        self, causal: CausalScreen, found: list[Curve], final: Fitted, joints: Collection[int] | None = None
    ) -> tuple[Point, Floats | None, Curve | None]:
        """The parameters beside the best curve, its volts (N, J) [V], None where they matter little, and the curve."""
        stretched, first = final.point.stretched(self.mechanism), next(iter(found), None)
        if not stretched and (first is None or first.scored.gain < RESIDUALS.much):
            return final.point, None, first
        about = [(causal, found)]
        if stretched:
            nominal = Point(self.mechanism.start, final.point.effects)
            causal = self._causal(nominal, final.names, causal.fit.weighting)
            about.append((causal, shape.curves(causal, self.mechanism.position_unit, joints)))
        tried: list[tuple[float, int, Point, Floats, Curve]] = []
        for causal, found in about:
            # where parameters stay near, so do derivatives by them; those of two masses take long
            anew = stretched and not causal.point.two_mass
            jacobian = None if anew else Slopes.of(causal.jacobian)
            free, frozen = (final.names, ()) if anew else ((), final.names)
            for curve in shape.best_of_joints(found, RESIDUALS.rival_share):
                volts = curve.volts(causal)
                fit = PredictionFit(self.predictor.less(volts), causal.fit.weighting)
                fitted = fit.run(causal.point, free, jacobian=jacobian, frozen=frozen)
                if fitted is not None:
                    tried.append((fitted.objective + curve.scored.occam, len(tried), fitted.point, volts, curve))
        return min(tried)[2:] if tried else (final.point, None, first)
