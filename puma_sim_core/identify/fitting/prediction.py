# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Prediction-error fits: parameters fitted to the innovations of a Kalman predictor (Gauss and Newton).

The innovations of a true model are white and independent of the past, with feedback and without: fits are unbiased
(Ljung, System Identification, chapter 13), and the causal filter that weights the innovations keeps that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from puma_sim_core.effects import Effect
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting.pieces import pieces
from puma_sim_core.identify.fitting.point import Pairs, Point, size_of, with_value
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.running import Ran, Running, cannot_be_run
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.parallel import parallel_map
from puma_sim_core.identify.settings import FITTING


class Slopes(NamedTuple):
    """Derivatives of whitened errors at the rows to fit, in parts (N', p) side by side, and their normal matrix: many
    steps are made with the same ones."""

    parts: tuple[Floats, ...]
    normal: Floats

    @classmethod
    def of(cls, jacobian: Floats) -> Slopes:
        """Those of one part."""
        return cls((jacobian,), jacobian.T @ jacobian)

    def beside(self, columns: Floats) -> Slopes:
        """These, and further columns (N', c)."""
        across = np.vstack([part.T @ columns for part in self.parts])
        return Slopes((*self.parts, columns), np.block([[self.normal, across], [across.T, columns.T @ columns]]))

    def gradient(self, errors: Floats) -> Floats:
        """(p + c,) sums of derivatives and errors (N',)."""
        return np.concatenate([part.T @ errors for part in self.parts])

    @property
    def jacobian(self) -> Floats:
        """(N', p + c) all parts."""
        return self.parts[0] if len(self.parts) == 1 else np.hstack(self.parts)


@dataclass(frozen=True)
class Fitted:
    """A model fitted to innovations.

    errors (N, J) : innovations after whitening; objective [nat] : half the sum of squares of those at the rows to fit
    and of the prior; names : the free parameters of its effects; jacobian (N', p + c) : derivatives of the errors at
    the rows to fit about the last step, by the parameters of the mechanism and by `names`, None where none was made.
    """

    point: Point
    errors: Floats
    objective: float
    names: Pairs
    jacobian: Floats | None = None

    @property
    def slopes(self) -> Floats:
        """`jacobian` of a model that has one."""
        assert self.jacobian is not None
        return self.jacobian

    def with_last(self, number: int) -> Fitted:
        """The same model with one of its effects, by its number, after the others."""
        effects = self.point.effects
        order = [*(n for n in range(len(effects)) if n != number), number]
        point = replace(self.point, effects=tuple(effects[n] for n in order))
        return replace(self, point=point, names=tuple((order.index(n), name) for n, name in self.names))


class PredictionFit:
    """Least squares of innovations over parameters and effects: -log p(innovations, parameters) [nat] but for a
    constant."""

    def __init__(self, predictor: Predictor, weighting: Weighting):
        self.predictor = predictor
        self.weighting = weighting
        self.rows = predictor.fit_rows
        self.mechanism = predictor.mechanism
        self.running = Running(predictor)

    def errors(self, point: Point) -> Floats | None:
        """(N, J) innovations after whitening, None where the model cannot be run."""
        raw = self.running.one(point)
        return None if raw is None else self.weighting(raw)

    def errors_of(self, points: Sequence[Point]) -> list[Floats | None]:
        """`errors` of several models, but for the last bits."""
        return parallel_map(self._whitened, self.running.many(points))

    def _whitened(self, ran: Ran) -> Floats | None:
        return None if ran.errors is None else self.weighting(ran.errors)

    def objective(self, errors: Floats, point: Point) -> float:
        """Half the sum of squares, of the rows to fit and of the parameters' priors."""
        m = self.mechanism
        step = (point.theta - m.start) / m.deviations
        far = [self._prior(effect, name)[0] for effect in point.effects for name in effect.values]
        return 0.5 * float((errors[self.rows] ** 2).sum() + step @ step + np.dot(far, far))

    def best_of(self, points: Iterable[Point]) -> Point | None:
        """The point that fits best as it is, None where none can be run."""
        best = self.lowest_of(points)
        return None if best is None else best[0]

    def lowest_of(self, points: Iterable[Point]) -> tuple[Point, float] | None:
        """The point that fits best as it is, and its objective [nat]; None where none can be run."""
        points = list(points)

        def cost(pair: tuple[Point, Ran]) -> float:
            errors = self._whitened(pair[1])
            return float("inf") if errors is None else self.objective(errors, pair[0])

        costs = parallel_map(cost, list(zip(points, self.running.many(points))))
        best = min(zip(points, costs), key=itemgetter(1), default=None)
        return None if best is None or best[1] == float("inf") else best

    def prior(self, point: Point, pairs: Pairs) -> tuple[Floats, Floats]:
        """(c,) slopes of the objective's priors by parameters of effects, per size, and (c,) prior precisions."""
        found = np.array([self._prior(point.effects[number], name) for number, name in pairs])
        far, one = found.reshape(-1, 2).T
        return far * one, FITTING.least_precision + one**2

    def _prior(self, effect: Effect, name: str) -> tuple[float, float]:
        """Distance of a parameter's logarithm from its prior, and one over its deviation; zeros without a prior."""
        parameter = effect.kind.parameter(name)
        prior = parameter.prior
        # a share is the same on any machine
        if prior is None or not (self.mechanism.library_sized or parameter.unit == "1"):
            return 0.0, 0.0
        median, one = prior[0], 1.0 / float(np.log(prior[1]))
        return one * float(np.log(max(effect.values[name], FITTING.prior_floor * median) / median)), one

    def derivatives(self, point: Point, pairs: Pairs, near: Floats | None = None, central: bool = False) -> Floats:
        """(N, J, p + c) `Running.derivatives`, before whitening."""
        return self.running.derivatives(point, pairs, near, central)

    def whitened(self, derivatives: Floats) -> Floats:
        """(N', p) derivatives after whitening, at the rows to fit, of those before it (N, J, p)."""
        out = np.empty((np.count_nonzero(self.rows), derivatives.shape[2]))
        # some at a time: transforms of all take several times the memory of what they give
        for first in range(0, derivatives.shape[2], FITTING.whitened_together):
            own = slice(first, first + FITTING.whitened_together)
            out[:, own] = self.weighting(derivatives[:, :, own])[self.rows]
        return out

    def run(
        self,
        point: Point,
        free: Iterable[tuple[int, str]],
        *,
        jacobian: Slopes | None = None,
        frozen: Pairs = (),
        rounds: int = FITTING.rounds,
    ) -> Fitted | None:
        """Fit from a start; None where it cannot be run.

        free : (number of the effect, its parameter) pairs whose derivatives are taken in each round; jacobian :
        derivatives after whitening by the mechanism's parameters and by the pairs `frozen`, which stay as they are in
        all rounds, None: all derivatives are taken in each round.
        """
        errors = self.errors(point)
        if errors is None:
            return None
        best = self.objective(errors, point)
        pairs = (*frozen, *free)
        own = pairs[len(frozen) :]
        slopes, damping = jacobian, None
        for _ in range(rounds):
            if jacobian is None:
                slopes = Slopes.of(self.whitened(self.derivatives(point, pairs)))
            elif own:
                slopes = jacobian.beside(self.whitened(self.running.by_effects(point, own)))
            assert slopes is not None
            step, promised = self._step(slopes, point, errors, pairs)
            if promised < FITTING.least_promise:
                break
            gained = 0.0
            for moved, trial, damped in self._tried(slopes, step, point, errors, pairs, damping):
                objective = self.objective(trial, moved)
                if objective < best:
                    gained, damping = best - objective, damped
                    point, errors, best = moved, trial, objective
                    break
            if gained < FITTING.least_round_gain:
                break
        return Fitted(point, errors, best, pairs, None if slopes is None else slopes.jacobian)

    def from_start(self, fitted: Fitted, jacobian: Slopes) -> Fitted:
        """A fit, or one from the start values of the parameters if lower: against local minima. jacobian : as `run`."""
        start = Point(self.mechanism.start, fitted.point.effects)
        found = self.run(start, (), jacobian=jacobian, frozen=fitted.names, rounds=FITTING.rounds_from_start)
        return fitted if found is None or found.objective >= fitted.objective else found

    def to_end(
        self,
        point: Point,
        pairs: Pairs,
        raw: Floats | None = None,
        *,
        gain: float = FITTING.finished,
        times: int = FITTING.relinearisations,
        near: Floats | None = None,
        patient: bool = False,
    ) -> tuple[Fitted, Floats]:
        """Fit until new derivatives gain less than `gain` [nat]: the model, and derivatives (N, J, p + c) near it.

        raw : derivatives before whitening to begin with; near : about a model near by; times : that they are taken;
        patient : more often as long as the objective falls by a share of itself: such a fit is far from its end.
        Raises ParameterError where a start cannot be run along the log.
        """
        if raw is None:
            raw = self.derivatives(point, pairs, near)
        fitted = self.linear(point, pairs, raw)
        for number in range(1, (FITTING.relinearisations_far if patient else times) + 1):
            before = fitted.objective
            raw = self.derivatives(fitted.point, pairs, raw)
            fitted = self.linear(fitted.point, pairs, raw)
            fell = before - fitted.objective
            if fell < gain or (number >= times and fell < FITTING.falling * before):
                break
        return fitted, raw

    def to_last(self, point: Point, pairs: Pairs) -> tuple[Fitted, Floats]:
        """The last fit of a model, whose numbers are reported, and derivatives (N, J, p + c) about it.

        Coarse steps see farther where dry friction holds a joint; central ones know along what the log tells nothing.
        With two masses they would take too long. Raises ParameterError as `to_end`.
        """
        gain, times = FITTING.finished_final, FITTING.relinearisations_final
        fitted, _ = self.to_end(point, pairs, gain=gain, times=times)
        for _ in range(0 if point.two_mass else times):
            moved = self.linear(fitted.point, pairs, self.derivatives(fitted.point, pairs, central=True))
            if fitted.objective - moved.objective < gain:
                break
            fitted = moved
        return fitted, self.derivatives(fitted.point, pairs, central=not point.two_mass)

    def linear(self, point: Point, pairs: Pairs, raw: Floats, *, rounds: int = FITTING.rounds) -> Fitted:
        """Fit with derivatives before whitening (N, J, p + c) that stay as they are, from a model or from the start
        values. Raises ParameterError where a start cannot be run along the log."""
        jacobian = Slopes.of(self.whitened(raw))
        fitted = self.run(point, (), jacobian=jacobian, frozen=pairs, rounds=rounds)
        if fitted is None:
            raise cannot_be_run()
        return self.from_start(fitted, jacobian)

    def _step(
        self, slopes: Slopes, point: Point, errors: Floats, pairs: Pairs, damping: float = 0.0
    ) -> tuple[Floats, float]:
        """The step (p + c,) of Gauss and Newton from a model, with a share of the curvature's diagonal added to it
        (Marquardt 1963, J. SIAM 11:431), and what the objective falls by along it if it is quadratic [nat]."""
        m, p = self.mechanism, len(self.mechanism.deviations)
        slope, precision = self.prior(point, pairs)
        normal = slopes.normal + np.diag(np.concatenate([np.ones(p), precision]))
        position = (point.theta - m.start) / m.deviations
        gradient = slopes.gradient(errors[self.rows]) + np.concatenate([position, slope])
        step = bounded_step(normal + damping * np.diag(np.diag(normal)), gradient, p)
        return step, -float(gradient @ step + 0.5 * step @ normal @ step)

    def _tried(
        self, slopes: Slopes, step: Floats, point: Point, errors: Floats, pairs: Pairs, damping: int | None = None
    ) -> Iterator[tuple[Point, Floats, int | None]]:
        """(model, its errors, number of the damping) that can be run: a whole step, one more from there, for curved
        valleys, and parts.

        Dry friction holds a joint in some rows, where no slope tells of the next row that it does not: with it the best
        of parts and of damped steps follows, which turn to where each parameter goes alone. damping : of the step
        before; where that was damped the best of those near it comes first.
        """
        parts = [share * step for share in FITTING.step_shares]
        damped = list[tuple[Point, Floats] | None]()
        if damping is not None:
            damped = self._all_moved(point, self._damped(slopes, point, errors, pairs), pairs)
            nearest = best_damping(damping, lambda number: self._cost(damped[number]))
            if (near := damped[nearest]) is not None:
                yield *near, nearest
        whole = self._moved(point, step, pairs)
        if whole is not None:
            yield *whole, None
            back = self._moved(whole[0], self._step(slopes, *whole, pairs)[0], pairs)
            if back is not None:
                yield *back, None
        if not any(effect.kind.dry for effect in point.effects):
            moved = (self._moved(point, each, pairs) for each in parts)
            yield from ((*part, None) for part in moved if part is not None)
            return
        further = parts if damped else [*parts, *self._damped(slopes, point, errors, pairs)]
        tried = [*self._all_moved(point, further, pairs), *damped]
        numbers = [None] * len(parts) + list(range(len(FITTING.dampings)))
        best, number = min(zip(tried, numbers), key=lambda each: self._cost(each[0]))
        if best is not None:
            yield *best, number

    def _damped(self, slopes: Slopes, point: Point, errors: Floats, pairs: Pairs) -> list[Floats]:
        """The step of each damping."""
        return [self._step(slopes, point, errors, pairs, damping)[0] for damping in FITTING.dampings]

    def _all_moved(self, point: Point, steps: Sequence[Floats], pairs: Pairs) -> list[tuple[Point, Floats] | None]:
        """`_moved` of several steps, but for the last bits."""
        sizes = self.sizes(point, pairs)
        moved = [self.stepped(point, step, pairs, sizes) for step in steps]
        found = iter(self.errors_of([each for each in moved if each is not None]))
        errors = [None if each is None else next(found) for each in moved]
        return [None if one is None or own is None else (one, own) for one, own in zip(moved, errors)]

    def _cost(self, moved: tuple[Point, Floats] | None) -> float:
        """The objective of a model that can be run."""
        return float("inf") if moved is None else self.objective(moved[1], moved[0])

    def _moved(self, point: Point, step: Floats, pairs: Pairs) -> tuple[Point, Floats] | None:
        """The model a step away and its errors, None where it cannot be run."""
        moved = self.stepped(point, step, pairs, self.sizes(point, pairs))
        errors = None if moved is None else self.errors(moved)
        return None if moved is None or errors is None else (moved, errors)

    def sizes(self, point: Point, pairs: Pairs) -> list[float]:
        """What the columns of effects are derivatives per: the size of each parameter."""
        return [size_of(point.effects[number], name) for number, name in pairs]

    def stepped(self, point: Point, step: Floats, pairs: Pairs, sizes: list[float]) -> Point | None:
        """The model a step (p + c,) away, in the units of the derivatives, within all bounds; None without one."""
        p = len(point.theta)
        theta = self.mechanism.clip(point.theta + step[:p] * self.mechanism.deviations)
        if not self.predictor.feasible(theta):
            return None
        effects = point.effects
        for (number, name), change, size in zip(pairs, step[p:], sizes):
            value = effects[number].values[name]
            scales = effects[number].kind.parameter(name).logarithmic
            moved = value * float(np.exp(change)) if scales else value + change * size
            changed = with_value(effects, number, name, moved, clip=True)
            if changed is None:
                return None
            effects = changed
        return Point(theta, effects)

    def step_to(self, point: Point, other: Point, pairs: Pairs, sizes: list[float]) -> Floats:
        """(p + c,) the step from a model to another one of the same effects."""
        step = list((other.theta - point.theta) / self.mechanism.deviations)
        for (number, name), size in zip(pairs, sizes):
            before, after = (at.effects[number].values[name] for at in (point, other))
            scales = point.effects[number].kind.parameter(name).logarithmic
            step.append(np.log(after / before) if scales else (after - before) / size)
        return np.array(step)

    def validation_sum(self, errors: Floats) -> float:
        """Half the sum of squares [nat] of the errors after whitening (N, J) on the validation set."""
        return 0.5 * float((errors[self.predictor.validation_rows] ** 2).sum())

    def validation_pieces(self, errors: Floats) -> Floats:
        """(k,) parts of `validation_sum` by pieces of the validation set that are longer than noise lasts."""
        rows = self.predictor.validation_rows
        squares = 0.5 * np.where(rows, errors**2, 0.0).sum(axis=1)
        return np.array([squares[piece].sum() for piece in pieces(np.asarray(rows.any(axis=1)), self.predictor.step)])


def bounded_step(normal: Floats, gradient: Floats, first: int) -> Floats:
    """The step of Gauss and Newton whose components from the `first` on are bounded by `FITTING.greatest_step`."""
    step, bound = np.zeros(len(gradient)), np.zeros(len(gradient), dtype=bool)
    while True:
        free = ~bound
        wanted = gradient[free] + normal[np.ix_(free, bound)] @ step[bound]
        step[free] = -cho_solve(cho_factor(normal[np.ix_(free, free)], lower=True), wanted)
        far = free & (np.abs(step) > FITTING.greatest_step)
        far[:first] = False
        if not far.any():
            return step
        step[far] = np.copysign(FITTING.greatest_step, step[far])
        bound |= far


def best_damping(first: int, cost: Callable[[int], float]) -> int:
    """Number of the damping at which a cost has its minimum nearest to a first one; only some are evaluated."""
    costs: dict[int, float] = {}

    def at(number: int) -> float:
        if number not in costs:
            inside = 0 <= number < len(FITTING.dampings)
            costs[number] = cost(number) if inside else float("inf")
        return costs[number]

    best = first
    for way in (1, -1):
        while at(best + way) < at(best):
            best += way
    return best
