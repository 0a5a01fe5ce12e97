# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Errors of models at rows that their parameters were not fitted to (step 7).

A quarter of a log holds a few windows, and the luck of a few windows can be worse with the true
structure than without it. So a log is cut into four folds, and each is predicted by the model with
its parameters fitted to the other three (Stone 1974, J. R. Statist. Soc. B 36:111). One of them is
the quarter that was kept back from the choice of the effects as well. What happens in one fold
only, such as a blow, can be fitted nowhere else: a parameter that the other folds tell next to
nothing of is what the whole log says beside the parameters that they do tell. Logs that are kept
back as a whole are predicted as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from puma_sim_core.identify.fitting.prediction import Fitted, Point, PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.parallel import each
from puma_sim_core.identify.result import Errors, StageErrors
from puma_sim_core.identify.screening.problem import HELD_SHARE, Problem
from puma_sim_core.identify.selection.validate import Validation, position_floor, rms

#: folds of a log
FOLDS = round(1.0 / HELD_SHARE)
#: a parameter of an effect of which a fold leaves less than this share of the information to the
#: others cannot be fitted without it
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

    def position_rms(self, model: Model) -> np.ndarray:
        """(J,) errors [rad or m] of the open-loop windows of all folds, each with the model fitted
        to the other folds; NaN without windows."""
        return self._windows(self._points(model))

    def lower(self, model: Model, than: Model) -> bool:
        """Whether a model leaves less of the windows than another; without any window, nothing is
        said against it."""
        one, other = (float((self.position_rms(m) ** 2).mean()) for m in (model, than))
        return not one >= other

    def errors(self, models: Mapping[str, Model | Point], floor: np.ndarray, noise) -> dict[str, Errors]:
        """The tables: "held_out" of all folds, and where there are several "unseen", of the one
        alone that the choice of the effects has not seen either.

        models : "nominal", "retuned", "augmented" -> the model, or a point that nothing was fitted
        to; floor (J,) : noise of the residual [V]; noise : ((J,), (J,)), that of a row's voltage
        [V] and of a position [rad or m].
        """
        points = {
            name: [m] * len(self.folds) if isinstance(m, Point) else self._points(m) for name, m in models.items()
        }
        tables = {"held_out": self._table(points, floor, noise)}
        if len(self.folds) > 1:
            first = {name: p[:1] for name, p in points.items()}
            tables["unseen"] = self._table(first, floor, noise)
        return tables

    def unseen(self, point: Point) -> np.ndarray:
        """(J,) errors [rad or m] of a model, as it is, in the windows that the choice of the
        effects has not seen."""
        return self._windows([point])

    def _table(self, points, floor, noise) -> Errors:
        """Errors of models, by their points of the first of the folds."""
        lengths = np.concatenate(
            [fold.validation.lengths("held_out") for fold, _ in zip(self.folds, points["augmented"])]
        )
        return Errors(
            StageErrors(**{name: self._volts(p) for name, p in points.items()}, floor=floor),
            StageErrors(
                **{name: self._windows(p) for name, p in points.items()},
                floor=position_floor(self.folds[0].predictor, lengths, *noise),
            ),
        )

    def _points(self, model: Model) -> list[Point]:
        """The model as fitted without each of the folds."""
        point, names = model.fitted.point, model.fitted.names
        if all(fold.known for fold in self.folds):
            return [point] * len(self.folds)
        if model.key in self._fitted:
            return self._fitted[model.key]
        whole = PredictionFit(self.folds[0].predictor, model.weighting)
        white = model.weighting(whole.derivatives(point, names))
        told = white.shape[2] - len(names)

        def without(fold: Fold) -> Point:
            if fold.known:
                return point
            own = white[:, :, told:] ** 2
            left = own[fold.predictor.fit_rows].sum(axis=0)
            free = left >= _LEFT_TO_FIT * (left + own[fold.predictor.held_rows].sum(axis=0))
            columns = np.r_[np.ones(told, dtype=bool), free]
            found = PredictionFit(fold.predictor, model.weighting).run(
                point,
                (),
                known=white[fold.predictor.fit_rows][:, columns],
                known_free=tuple(pair for pair, is_free in zip(names, free) if is_free),
                rounds=_ROUNDS,
            )
            if found is None:
                return point
            return (
                found.point if free.all() else _followed(whole, model.fitted, white[whole.rows], columns, found.point)
            )

        found = self._fitted[model.key] = each(without, self.folds)
        return found

    def _plant(self, point: Point):
        return self.folds[0].predictor.mechanism.plant(point.theta, point.effects)

    def _windows(self, points: Sequence[Point]) -> np.ndarray:
        """(J,) errors [rad or m] of the windows of the first of the folds."""
        return rms(
            np.concatenate(
                [
                    fold.validation.window_errors(self._plant(point), "held_out")
                    for fold, point in zip(self.folds, points)
                ]
            )
        )

    def _volts(self, points: Sequence[Point]) -> np.ndarray:
        """(J,) residual [V] at the rows that the first of the folds keep back."""

        def of(k: int) -> np.ndarray:
            return self.folds[k].validation.volts(self._plant(points[k]))

        rows = [fold.predictor.held_rows for fold, _ in zip(self.folds, points)]
        return rms(np.concatenate(each(of, range(len(points)))), np.concatenate(rows))


def _followed(fit: PredictionFit, whole: Fitted, jacobian: np.ndarray, free: np.ndarray, point: Point) -> Point:
    """A model without one fold, its other parameters where the whole log has them beside those that
    are free in it: a limit of the current follows the drive's constants.

    fit, whole : the fit to the whole log, and what came of it; jacobian (N', p + c) its
    derivatives; free (p + c,); point : the model whose free parameters were fitted.
    """
    names = whole.names
    sizes = fit.sizes(whole.point, names)
    told = fit.prior(whole.point, names)[1]
    normal = jacobian.T @ jacobian + np.diag(np.r_[np.ones(len(free) - len(names)), told])
    moved = fit.step_to(whole.point, point, names, sizes)
    step = np.zeros(len(free))
    step[~free] = -np.linalg.solve(normal[np.ix_(~free, ~free)], normal[np.ix_(~free, free)] @ moved[free])
    found = fit.stepped(point, step, names, sizes)
    return point if found is None else found
