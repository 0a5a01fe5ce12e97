# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Cross-validation: errors of models at rows that their parameters were not fitted to.

A log is cut into four folds, each predicted by the model fitted to the other three (Stone 1974, J. R. Statist. Soc. B
36:111); one is the validation set of the selection as well. A parameter of which the other folds hold next to no
information, as of an impact, takes the value that the whole log gives it. Logs for validation are predicted as they
are.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from puma_sim_core.identify.arrays import Bools, Floats
from puma_sim_core.identify.fitting.pieces import clearly_above_zero
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit, Slopes
from puma_sim_core.identify.fitting.predictor import Predictor, RowChoice
from puma_sim_core.identify.noise.open_loop import NoiseFloor, RowNoise, Spread, position_floor, variance_of_rows
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.parallel import parallel_map
from puma_sim_core.identify.result import Errors, StageErrors
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.selection.validate import Validation, rms
from puma_sim_core.identify.settings import SCREENING, SELECTION
from puma_sim_core.plant.plant import Plant

#: folds of a log
FOLDS = round(1.0 / SCREENING.residual_validation_share)
#: for each log of a problem which of its rows are of the validation set
RowChoices = Callable[[Problem], Sequence[RowChoice]]


@dataclass(frozen=True)
class WeightedModel:
    """A fitted model, and the weighting that it was fitted in."""

    fitted: Fitted
    weighting: Weighting

    @property
    def key(self) -> Hashable:
        """Equal for models that are equal to the bit."""
        w = self.weighting
        return self.fitted.point.key, w.filters.tobytes(), w.scale.tobytes()


@dataclass(frozen=True)
class Fold:
    """One fold. unseen : whether models come fitted without its rows."""

    predictor: Predictor
    validation: Validation
    unseen: bool


class CrossValidation:
    """The rows of some logs that models are measured at. folds : without overlap."""

    def __init__(self, folds: Sequence[Fold]):
        self.folds = list(folds)
        self._fitted: dict[Hashable, list[Point]] = {}

    @classmethod
    def of(cls, problem: Problem, predictor: Predictor, rows: RowChoices) -> CrossValidation:
        """The folds of a problem; one for logs that are the validation set as a whole.

        rows : gives the validation set of a problem.
        """
        folds, place = [Fold(predictor, Validation(problem, predictor), True)], problem.place
        if place is not None:
            for moved in (problem.at((place + k / FOLDS) % 1.0) for k in range(1, FOLDS)):
                other = predictor.validated_at(rows(moved))
                folds.append(Fold(other, Validation(moved, other), False))
        return cls(folds)

    def position_rms(self, model: WeightedModel) -> Floats:
        """(J,) errors [rad or m] in the open-loop windows of all folds, each with the model fitted to the other folds;
        NaN without windows."""
        return self._windows(self._points(model))

    def better(
        self,
        model: WeightedModel,
        than: WeightedModel,
        noise_holds: Callable[[], bool] = lambda: True,
        as_good: bool = False,
    ) -> bool:
        """Whether a model predicts the folds better than another, or there is nothing to measure it at.

        By the mean over the folds of the squared errors in windows. Where it is greater by less than two of its
        standard errors, by the log predictive density of the innovations. Where it is greater by more, and the density
        is greater beyond chance nevertheless, the parameters may be at fault and not the effects: the other model with
        the effects of the first decides then, by its windows. Both models have one weighting.

        noise_holds : whether the noise may be what the density takes it for; it is asked where the density would
        decide, and where it does not hold, the density must be greater beyond chance, by pieces of the folds; as_good :
        the model need not be better, but may be worse by chance alone.
        """
        one, other = self._points(model), self._points(than)
        more = self._more_in_windows(one, other)
        if not len(more) or more.mean() < 0.0:
            return True
        error = more.std(ddof=1) / np.sqrt(len(more)) if len(more) > 1 else 0.0
        if more.mean() > SELECTION.standard_errors * error:
            lost = self._densities(than, other) - self._densities(model, one)
            if not np.isfinite(lost).all() or not clearly_above_zero(-lost):
                return False
            both = [Point(there.theta, here.effects) for here, there in zip(one, other)]
            return bool(self._more_in_windows(both, other).mean() < 0.0)
        holds = noise_holds()
        if as_good and not holds:
            return True
        lost = self._densities(than, other) - self._densities(model, one)
        if not np.isfinite(lost).all():
            return holds and float(lost.sum()) < 0.0
        if as_good:
            return not clearly_above_zero(lost)
        return float(lost.sum()) < 0.0 if holds else clearly_above_zero(-lost)

    def _more_in_windows(self, points: Sequence[Point], others: Sequence[Point]) -> Floats:
        """(k,) mean squares [rad^2 or m^2] in the windows of the folds that have any, less those of other points."""
        more = np.array([self._window_square(*pair) for pair in zip(self.folds, points)])
        more -= [self._window_square(*pair) for pair in zip(self.folds, others)]
        return more[np.isfinite(more)]

    def _window_square(self, fold: Fold, point: Point) -> float:
        """Mean square [rad^2 or m^2] of the errors in the windows of a fold, of all joints; NaN without windows."""
        errors = fold.validation.window_errors(self._plant(point), "held_out")
        return float((errors**2).mean()) if len(errors) else np.nan

    def _densities(self, model: WeightedModel, points: Sequence[Point]) -> Floats:
        """(k,) log predictive densities [nat] of the pieces of the folds by the model fitted to the others, but for a
        constant."""
        found = []
        for fold, point in zip(self.folds, points):
            fit = PredictionFit(fold.predictor, model.weighting)
            errors, never = fit.errors(point), np.full(fold.predictor.fit_rows.shape, np.inf)
            found.append(-fit.validation_pieces(never if errors is None else errors))
        return np.concatenate(found)

    def errors(self, models: Mapping[str, WeightedModel | Point], floor: NoiseFloor) -> dict[str, Errors]:
        """Tables of errors: "held_out" of all folds, and where there are several "unseen", of the one alone that the
        selection has not seen either.

        models : "nominal", "retuned", "augmented" -> the model, or a point that nothing was fitted to; floor : what
        the noise of the fit leaves.
        """
        points = {
            name: [m] * len(self.folds) if isinstance(m, Point) else self._points(m) for name, m in models.items()
        }
        tables = {"held_out": self._table(points, floor)}
        if len(self.folds) > 1:
            first = {name: p[:1] for name, p in points.items()}
            tables["unseen"] = self._table(first, floor)
        return tables

    def unseen(self, point: Point) -> Floats:
        """(J,) errors [rad or m] of a model, as it is, in the windows that the selection has not seen."""
        return self._windows([point])

    def noise_in_windows(self, noise: RowNoise) -> Floats:
        """(J,) errors [rad or m] that noise of rows alone makes in the windows of all folds."""
        return self._floor(partial(variance_of_rows, self.folds[0].predictor, noise), len(self.folds))

    def _floor(self, spread: Spread, folds: int) -> Floats:
        """(J,) errors [rad or m] that noise alone makes in the windows of the first of the folds."""
        lengths = [fold.validation.lengths("held_out") for fold in self.folds[:folds]]
        return position_floor(np.concatenate(lengths), spread)

    def _table(self, points: Mapping[str, Sequence[Point]], floor: NoiseFloor) -> Errors:
        """Errors of models, by their points of the first of the folds."""
        volts = {name: self._volts(p) for name, p in points.items()}
        windows = {name: self._windows(p) for name, p in points.items()}
        least = self._floor(floor.spread, len(points["augmented"]))
        return Errors(StageErrors(**volts, floor=floor.volts), StageErrors(**windows, floor=least))

    def _points(self, model: WeightedModel) -> list[Point]:
        """The model as fitted without each of the folds."""
        point, names = model.fitted.point, model.fitted.names
        if all(fold.unseen for fold in self.folds):
            return [point] * len(self.folds)
        if model.key in self._fitted:
            return self._fitted[model.key]
        whole = PredictionFit(self.folds[0].predictor, model.weighting)
        jacobian = model.weighting(whole.derivatives(point, names))
        p = jacobian.shape[2] - len(names)

        def without(fold: Fold) -> Point:
            if fold.unseen:
                return point
            information = jacobian[:, :, p:] ** 2
            left = information[fold.predictor.fit_rows].sum(axis=0)
            all_of_it = left + information[fold.predictor.validation_rows].sum(axis=0)
            free = left >= SELECTION.least_information * all_of_it
            columns = np.r_[np.ones(p, dtype=bool), free]
            fit = PredictionFit(fold.predictor, model.weighting)
            found = fit.run(
                point,
                (),
                jacobian=Slopes.of(jacobian[fold.predictor.fit_rows][:, columns]),
                frozen=tuple(pair for pair, is_free in zip(names, free) if is_free),
                rounds=SELECTION.fold_rounds,
            )
            if found is None:
                return point
            if free.all():
                return found.point
            completed = _completed(whole, model.fitted, jacobian[whole.rows], columns, found.point)
            # what the fold's own rows say next to nothing of must not spoil them: such a step is too long to be linear
            errors, before = fit.errors(completed), fit.errors(point)
            if errors is None or before is None or fit.objective(errors, completed) > fit.objective(before, point):
                return found.point
            return completed

        found = self._fitted[model.key] = parallel_map(without, self.folds)
        return found

    def _plant(self, point: Point) -> Plant:
        return point.plant(self.folds[0].predictor.mechanism)

    def _windows(self, points: Sequence[Point]) -> Floats:
        """(J,) errors [rad or m] in the windows of the first of the folds."""
        pairs = zip(self.folds, points)
        return rms(np.concatenate([fold.validation.window_errors(self._plant(at), "held_out") for fold, at in pairs]))

    def _volts(self, points: Sequence[Point]) -> Floats:
        """(J,) residual [V] on the validation sets of the first of the folds."""
        pairs = list(zip(self.folds, points))
        volts = parallel_map(lambda pair: pair[0].validation.volts(self._plant(pair[1])), pairs)
        return rms(np.concatenate(volts), np.concatenate([fold.predictor.validation_rows for fold, _ in pairs]))


def _completed(fit: PredictionFit, whole: Fitted, jacobian: Floats, free: Bools, point: Point) -> Point:
    """A model without one fold, its other parameters where the whole log has them beside those that are free in it.

    fit, whole : the fit to the whole log, and its model; jacobian (N', p + c) : its derivatives after whitening;
    free (p + c,); point : the model whose free parameters were fitted.
    """
    names = whole.names
    sizes = fit.sizes(whole.point, names)
    _, precision = fit.prior(whole.point, names)
    normal = jacobian.T @ jacobian + np.diag(np.r_[np.ones(len(free) - len(names)), precision])
    moved = fit.step_to(whole.point, point, names, sizes)
    step = np.zeros(len(free))
    step[~free] = -np.linalg.solve(normal[np.ix_(~free, ~free)], normal[np.ix_(~free, free)] @ moved[free])
    return fit.stepped(point, step, names, sizes) or point
