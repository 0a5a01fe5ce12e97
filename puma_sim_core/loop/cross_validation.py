# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Errors held out over the whole of a log, by models fitted to the rest of it (step 7).

The blocks that are kept back hold a few windows, and the luck of a few windows can be worse with
the true structure than without it. Where they speak against what was chosen, all rows are asked:
the log is cut into folds, the parameters are fitted to all but one of them, and the open-loop
windows of that one are predicted (Stone 1974, J. R. Statist. Soc. B 36:111).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .prediction import Fitted, Point, PredictionFit
from .predictor import Predictor
from .problem import Problem
from .validate import Validation
from .weighting import Weighting

#: where in their period the blocks of each fold lie: side by side, they cover a log
PLACES = (0.125, 0.375, 0.625, 0.875)
#: an effect of which a fold leaves less than this share of the information on each parameter to the
#: others cannot be fitted without it: such a fold says nothing
_LEFT_TO_FIT = 0.3
#: rounds of each fit
_ROUNDS = 2


class Folds:
    """The folds of a problem whose blocks can be moved.

    with_blocks : function of a `Problem` -> the `Predictor` whose rows it has.
    """

    def __init__(self, problem: Problem, with_blocks: Callable[[Problem], Predictor]):
        self.parts = []
        for place in PLACES:
            moved = Problem(problem.sampled, problem.mechanism, (), True, place)
            predictor = with_blocks(moved)
            self.parts.append((predictor, Validation(moved, predictor)))

    def lowers(self, chosen: Fitted, without: Fitted, weighting: Weighting) -> bool:
        """Whether a model leaves less of the windows, over all folds that it can be fitted without,
        than another does."""
        models = [self._known(fitted, weighting) for fitted in (chosen, without)]
        total = np.zeros(2)
        for predictor, validation in self.parts:
            fit = PredictionFit(predictor, weighting)
            if not self._told(fit, *models[0]):
                continue
            for k, (fitted, raw) in enumerate(models):
                moved = fit.run(fitted.point, (), known=fit.white(raw), known_free=fitted.names,
                                rounds=_ROUNDS)
                point: Point = fitted.point if moved is None else moved.point
                plant = fit.mechanism.plant(point.theta, point.effects)
                total[k] += float((validation.position_rms(plant, "held_out") ** 2).mean())
        return bool(total[0] < total[1])

    def _known(self, fitted: Fitted, weighting: Weighting) -> tuple[Fitted, np.ndarray]:
        """A model with the derivatives (N, J, p + c) of its innovations."""
        fit = PredictionFit(self.parts[0][0], weighting)
        return fitted, fit.derivatives(fitted.point, fitted.names)

    @staticmethod
    def _told(fit: PredictionFit, fitted: Fitted, raw: np.ndarray) -> bool:
        """Whether the rows to fit of a fold tell the parameters of the effects."""
        if not fitted.names:
            return True
        own = fit.weighting(raw[:, :, raw.shape[2] - len(fitted.names):]) ** 2
        told = own[fit.rows].sum(axis=0)
        whole = told + own[fit.predictor.held_rows].sum(axis=0)
        return bool(np.all(told >= _LEFT_TO_FIT * whole))
