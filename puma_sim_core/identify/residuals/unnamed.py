# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What is left of a log after a model, as free curves; whether one lets no name stand (step 10).

What is missing may have stretched parameters, and it shows at the joints that the inertia couples
to its own: so curves are drawn about the parameters as they are when the best curve takes its part.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.identify import outcome
from puma_sim_core.identify.fitting.prediction import Fitted, Point, PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.residuals import shape
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.problem import Problem

#: gain of a curve [nat] above which it may have stretched the parameters
_MUCH = 150.0
#: deviations of its prior from which on a parameter counts as stretched
_STRETCHED = 4.0
#: share of the best curve's gain from which on another joint's may be the one that is missing
_RIVAL = 0.2
#: placebos of the shapes
_SHIFTS = 24


class Unnamed:
    """Free curves about the models of one problem.

    seed : of the placebos.
    """

    def __init__(self, predictor: Predictor, problem: Problem, seed: int):
        self.predictor = predictor
        self.problem = problem
        self.mechanism = problem.mechanism
        self.seed = seed

    def shapes(self, final: Fitted) -> tuple[list, float]:
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
        shifts = np.sort(rng.uniform(0.06, 0.94, _SHIFTS))
        return found, shape.chance(causal, found, shifts)

    def stands(self, bare: Fitted, named: Fitted, joints, remains: bool) -> bool:
        """Whether a free curve about a model without names leaves clearly less of its joint's
        innovations than a model with names does, in the noise that the curve leaves.

        joints : where the names act (1-based; None: on all); remains : whether something remains
        after them.
        """
        causal, found = self._about(bare, joints)
        if not found:
            return False
        point, volts, curve = self._relaxed(causal, found, bare, joints)
        if volts is not None:
            causal = self._causal(point, bare.names, causal.fit.weighting, volts)
        noise = shape.noise(causal, [shape.again(causal, curve)])
        causal = self._causal(point, bare.names, noise, volts)
        best = shape.again(causal, curve).scored
        rows = self.predictor.fit_rows[:, best.joint - 1]
        left = causal.left(best.entry.candidate, best.coefficients)[rows, best.joint - 1]
        names = noise(self._raw(named.point))[rows, best.joint - 1]
        return outcome.no_name_stands(float(left @ left), float(names @ names), best.price, remains)

    def _about(self, final: Fitted, joints=None) -> tuple[CausalScreen, list]:
        """The screen about a model, and its curves, best first."""
        # the first noise is the least that the innovations allow: one fitted to all that is left
        # would take what is missing for noise
        plain = self.predictor.white_weighting(self._raw(final.point))
        causal = self._causal(final.point, final.names, plain)
        return causal, shape.curves(causal, self.mechanism.position_unit, joints)

    def _raw(self, point) -> np.ndarray:
        return self.predictor.errors(self.mechanism.plant(point.theta, point.effects))

    def _causal(self, point, names, weighting, volts=None) -> CausalScreen:
        """The screen about a point whose effects have these free parameters. volts (N, J): what a
        curve takes of the voltage; the plant gets the rest, and the innovations show the curve at
        its own joint alone."""
        fit = PredictionFit(self.predictor, weighting)
        if volts is None:
            raw = self._raw(point)
        else:
            plant = self.mechanism.plant(point.theta, point.effects)
            raw = self.predictor.less(volts).errors(plant) + self.predictor.shown(volts)
        return CausalScreen(fit, point, weighting(raw), fit.white(fit.derivatives(point, names)), self.problem)

    def _stretched(self, point) -> bool:
        """Whether parameters went farther than their priors allow."""
        m = self.mechanism
        return bool(np.any(np.abs(point.theta - m.start) > _STRETCHED * m.deviations))

    def _relaxed(self, causal, found, final, joints=None):
        """The parameters as they are when the curve that explains the log best takes its part
        (N, J) of the voltage, that part, None where it is too little to matter, and the curve. What
        is missing may have stretched parameters so far that no curve fits about them, and it shows
        at the joints that the inertia couples to its own: so the best curve of each of the joints
        (1-based; None: of all) is tried. causal, found : screen about the model, and its curves."""
        stretched, first = self._stretched(final.point), next(iter(found), None)
        if not stretched and (first is None or first.scored.gain < _MUCH):
            return final.point, None, first
        about = [(causal, found)]
        if stretched:
            nominal = Point(self.mechanism.start, final.point.effects)
            causal = self._causal(nominal, final.names, causal.fit.weighting)
            about.append((causal, shape.curves(causal, self.mechanism.position_unit, joints)))
        tried = []
        for causal, found in about:
            # where parameters stay near, so do derivatives by them; those of two masses take long
            anew = stretched and not causal.point.heavy
            known = None if anew else causal.jacobian[causal.fit.rows]
            free, as_known = (final.names, ()) if anew else ((), final.names)
            for curve in shape.best_of_joints(found, _RIVAL):
                volts = curve.volts(causal)
                fit = PredictionFit(self.predictor.less(volts), causal.fit.weighting)
                fitted = fit.run(causal.point, free, known=known, known_free=as_known)
                if fitted is not None:
                    tried.append((fitted.objective + curve.scored.price, len(tried), fitted.point, volts, curve))
        return min(tried)[2:] if tried else (final.point, None, first)
