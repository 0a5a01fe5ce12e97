# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Errors of models at rows that their parameters were not fitted to (step 7).

A quarter of a log holds a few windows, and the luck of a few windows can be worse with the true
structure than without it. So a log is cut into four folds, and each is predicted by the model with
its parameters fitted to the other three (Stone 1974, J. R. Statist. Soc. B 36:111). One of them is
the quarter that was kept back from the choice of the effects as well. Logs that are kept back as a
whole are predicted as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .parallel import each
from .prediction import Fitted, Point, PredictionFit
from .predictor import Predictor
from .problem import HELD_SHARE, Problem
from .result import Errors, StageErrors
from .validate import Validation, position_floor, rms
from .weighting import Weighting

#: folds of a log
FOLDS = round(1.0 / HELD_SHARE)
#: an effect of which a fold leaves less than this share of the information on each parameter to the
#: others cannot be fitted without it: such a fold says nothing
_LEFT_TO_FIT = 0.3
#: rounds of each fit
_ROUNDS = 2


@dataclass(frozen=True)
class Model:
    """A model as it was fitted, and the weighting by which it was."""

    fitted: Fitted
    weighting: Weighting

    @property
    def key(self) -> tuple:
        """What tells it from any other, to the bit."""
        w = self.weighting
        return self.fitted.point.key, w.filters.tobytes(), w.scale.tobytes()


@dataclass(frozen=True)
class Fold:
    """Rows that are kept back; known: whether the models were fitted without them already."""

    predictor: Predictor
    validation: Validation
    known: bool


class HeldOut:
    """The rows of some logs that models are measured at.

    folds : `Fold` each; the rows that one keeps back no other does.
    """

    def __init__(self, folds: Sequence[Fold]):
        self.folds = list(folds)
        self._fitted: dict = {}

    @classmethod
    def of(cls, problem: Problem, predictor: Predictor, kept_back: Callable) -> HeldOut:
        """The folds of a problem whose blocks can be moved, else its one.

        kept_back : function of a `Problem` -> what `Predictor.keeping` asks for.
        """
        folds = [Fold(predictor, Validation(problem, predictor), True)]
        for k in range(1, FOLDS if problem.hold_back else 1):
            place = (problem.place + k / FOLDS) % 1.0
            moved = Problem(problem.sampled, problem.mechanism, (), True, place)
            other = predictor.keeping(kept_back(moved))
            folds.append(Fold(other, Validation(moved, other), False))
        return cls(folds)

    def told(self, model: Model) -> tuple[bool, ...]:
        """Of each fold, whether the others tell the parameters of the model's effects."""
        names = model.fitted.names
        if not names or all(fold.known for fold in self.folds):
            return (True,) * len(self.folds)
        raw = self._derivatives(model)
        own = model.weighting(raw[:, :, raw.shape[2] - len(names):]) ** 2
        return tuple(fold.known or self._enough(own, fold.predictor) for fold in self.folds)

    @staticmethod
    def _enough(own: np.ndarray, predictor: Predictor) -> bool:
        left = own[predictor.fit_rows].sum(axis=0)
        whole = left + own[predictor.held_rows].sum(axis=0)
        return bool(np.all(left >= _LEFT_TO_FIT * whole))

    def position_rms(self, model: Model, told) -> np.ndarray:
        """(J,) errors [rad or m] of the open-loop windows of the folds that are `told`, each with
        the model fitted to the other folds; NaN without windows."""
        return self._windows(self._points(model), told)

    def lower(self, model: Model, than: Model) -> bool:
        """Whether a model leaves less of the windows than another, over the folds that tell its
        effects; without any window, nothing is said against it."""
        told = self.told(model)
        one, other = (float((self.position_rms(m, told) ** 2).mean()) for m in (model, than))
        return not one >= other

    def errors(self, models: Mapping[str, Model | Point], floor: np.ndarray, noise
               ) -> dict[str, Errors]:
        """The tables: "held_out" of all folds that tell the effects, and where there are several
        "unseen", of the one alone that the choice of the effects has not seen either.

        models : "nominal", "retuned", "augmented" -> the model, or a point that nothing was fitted
        to; floor (J,) : noise of the residual [V]; noise : ((J,), (J,)), that of a row's voltage
        [V] and of a position [rad or m].
        """
        several = len(self.folds) > 1
        tables = {"held_out": self._table(models, self.told(models["augmented"]), floor, noise)}
        return tables | ({"unseen": self._table(models, (True,), floor, noise)} if several else {})

    def unseen(self, point: Point) -> np.ndarray:
        """(J,) errors [rad or m] of a model, as it is, in the windows that the choice of the
        effects has not seen."""
        return self._windows([point], (True,))

    def _table(self, models, told, floor, noise) -> Errors:
        points = {name: [m] * len(self.folds) if isinstance(m, Point) else self._points(m)
                  for name, m in models.items()}
        lengths = np.concatenate([fold.validation.lengths("held_out")
                                  for fold, counts in zip(self.folds, told) if counts])
        return Errors(
            StageErrors(**{name: self._volts(p, told) for name, p in points.items()}, floor=floor),
            StageErrors(**{name: self._windows(p, told) for name, p in points.items()},
                        floor=position_floor(self.folds[0].predictor, lengths, *noise)))

    def _derivatives(self, model: Model) -> np.ndarray:
        fit = PredictionFit(self.folds[0].predictor, model.weighting)
        return fit.derivatives(model.fitted.point, model.fitted.names)

    def _points(self, model: Model) -> list[Point]:
        """The model as fitted without each of the folds."""
        point, names = model.fitted.point, model.fitted.names
        if all(fold.known for fold in self.folds):
            return [point] * len(self.folds)
        if model.key in self._fitted:
            return self._fitted[model.key]
        raw = self._derivatives(model)

        def without(fold: Fold) -> Point:
            if fold.known:
                return point
            fit = PredictionFit(fold.predictor, model.weighting)
            found = fit.run(point, (), known=fit.white(raw), known_free=names, rounds=_ROUNDS)
            return point if found is None else found.point

        found = self._fitted[model.key] = each(without, self.folds)
        return found

    def _plant(self, point: Point):
        return self.folds[0].predictor.mechanism.plant(point.theta, point.effects)

    def _windows(self, points: Sequence[Point], told) -> np.ndarray:
        def of(k: int) -> np.ndarray:
            return self.folds[k].validation.window_errors(self._plant(points[k]), "held_out")

        return rms(np.concatenate(each(of, [k for k, counts in enumerate(told) if counts])))

    def _volts(self, points: Sequence[Point], told) -> np.ndarray:
        """(J,) residual [V] at the rows that the folds keep back."""
        def of(k: int) -> np.ndarray:
            return self.folds[k].validation.volts(self._plant(points[k]))

        counting = [k for k, counts in enumerate(told) if counts]
        rows = [self.folds[k].predictor.held_rows for k in counting]
        return rms(np.concatenate(each(of, counting)), np.concatenate(rows))
