# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Prediction-error fits: parameters fitted to the innovations of a Kalman predictor (Gauss and Newton).

The screening of filtered motion is quick and linear, and not exact: friction about a reversal is blurred, and
accelerations carry noise that feedback has sent through the voltage. Here the model itself, with all its effects,
predicts the log row by row (`predictor`). The innovations of a true model are white and independent of the past, with
feedback and without, so that fits are unbiased (Ljung, System Identification, chapter 13). They are weighted by a
causal filter, which keeps that.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from puma_sim_core.effects import Effect
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.parallel import parallel_map
from puma_sim_core.identify.settings import FITTING

#: (number of an effect in a model, one of its parameters), one by one
Pairs = tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class Point:
    """A model: parameters theta (p,) and effects."""

    theta: np.ndarray
    effects: tuple[Effect, ...]

    @property
    def two_mass(self) -> bool:
        """Whether a joint has two masses."""
        return any(effect.kind.two_masses for effect in self.effects)

    @property
    def key(self) -> Hashable:
        """Equal for models that are equal to the bit."""
        return self.theta.tobytes(), tuple(
            (effect.kind.name, effect.joint, *sorted(effect.values.items())) for effect in self.effects
        )


@dataclass(frozen=True)
class Fitted:
    """A model fitted to innovations.

    errors (N, J) : innovations after whitening; objective [nat] : half the sum of squares of those at the rows to fit
    and of the prior; names : the free parameters of its effects; jacobian (N', p + c) : derivatives of the errors at
    the rows to fit about the last step, by the parameters of the mechanism and by `names`, None where none was made.
    """

    point: Point
    errors: np.ndarray
    objective: float
    names: Pairs
    jacobian: np.ndarray | None = None

    @property
    def slopes(self) -> np.ndarray:
        """`jacobian` of a model that has one."""
        assert self.jacobian is not None
        return self.jacobian


class PredictionFit:
    """Least squares of innovations over parameters and effects, by Gauss and Newton.

    The objective is -log p(innovations, parameters) [nat] but for a constant: half the sum of squares of the whitened
    innovations and of the parameters' distances from their priors, in standard deviations.
    """

    def __init__(self, predictor: Predictor, weighting: Weighting):
        self.predictor = predictor
        self.weighting = weighting
        self.rows = predictor.fit_rows
        self.mechanism = predictor.mechanism

    def errors(self, point: Point) -> np.ndarray | None:
        """(N, J) innovations after whitening, None where the model cannot be run."""
        raw = self._raw(point)
        return None if raw is None else self.weighting(raw)

    def objective(self, errors: np.ndarray, point: Point) -> float:
        """Half the sum of squares, of the rows to fit and of the parameters' priors."""
        m = self.mechanism
        step = (point.theta - m.start) / m.deviations
        far = [self._prior(effect, name)[0] for effect in point.effects for name in effect.values]
        return 0.5 * float((errors[self.rows] ** 2).sum() + step @ step + np.dot(far, far))

    def prior(self, point: Point, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
        """(c,) slopes of the objective's priors by parameters of effects, per size, and (c,) prior precisions."""
        found = np.array([self._prior(point.effects[number], name) for number, name in pairs])
        far, one = found.reshape(-1, 2).T
        return far * one, FITTING.least_precision + one**2

    def _prior(self, effect: Effect, name: str) -> tuple[float, float]:
        """How many standard deviations the logarithm of a parameter is off, and one over its standard deviation; zeros
        without a prior, as of other mechanisms than the arm."""
        prior = effect.kind.parameter(name).prior if self.mechanism.joints == 3 else None
        if prior is not None:
            median, factor = prior
            one = 1.0 / float(np.log(factor))
            return one * float(np.log(max(effect.values[name], FITTING.prior_floor * median) / median)), one
        return 0.0, 0.0

    def derivatives(self, point: Point, pairs: Pairs, near: np.ndarray | None = None) -> np.ndarray:
        """(N, J, p + c) derivatives of the innovations before whitening, by the mechanism's parameters per standard
        deviation, and by parameters of effects per size (`sizes`). Read-only: they are cached.

        near : those about a model near by; a two-mass model takes its derivatives by the mechanism's parameters over.
        """
        if near is not None and point.two_mass:
            return self._derived(point, pairs, near[:, :, : len(point.theta)])
        return self.predictor.derived((point.key, tuple(pairs)), lambda: self._derived(point, pairs))

    def _derived(self, point: Point, pairs: Pairs, by_parameters: np.ndarray | None = None) -> np.ndarray:
        raw = self._raw(point)
        if raw is None:
            raise _cannot_be_run()
        if by_parameters is None:
            columns = parallel_map(lambda k: self._by_parameter(point, raw, k), range(len(point.theta)))
        else:
            columns = list(np.moveaxis(by_parameters, 2, 0))
        columns += parallel_map(lambda pair: self._by_effect(point, raw, *pair), pairs)
        return np.stack(columns, axis=2) if columns else np.zeros((*raw.shape, 0))

    def white(self, derivatives: np.ndarray) -> np.ndarray:
        """(N', p) derivatives after whitening, at the rows to fit, of those before it (N, J, p)."""
        whitened: np.ndarray = self.weighting(derivatives)[self.rows]
        return whitened

    def _raw(self, point: Point) -> np.ndarray | None:
        try:
            return self.predictor.errors(self.mechanism.plant(point.theta, point.effects))
        except (NonFiniteStateError, ParameterError):
            return None

    def _by_parameter(self, point: Point, raw: np.ndarray, number: int) -> np.ndarray:
        theta = point.theta.copy()
        theta[number] += FITTING.difference * self.mechanism.deviations[number]
        moved = self._raw(Point(theta, point.effects))
        return np.zeros_like(raw) if moved is None else (moved - raw) / FITTING.difference

    def _by_effect(self, point: Point, raw: np.ndarray, number: int, name: str) -> np.ndarray:
        effect = point.effects[number]
        size = _size(effect, name)
        for share in (FITTING.effect_difference, -FITTING.effect_difference):
            effects = _with_value(point.effects, number, name, effect.values[name] + share * size)
            moved = None if effects is None else self._raw(Point(point.theta, effects))
            if moved is not None:
                derivative: np.ndarray = (moved - raw) / share
                return derivative
        return np.zeros_like(raw)

    def run(
        self,
        point: Point,
        free: Iterable[tuple[int, str]],
        *,
        jacobian: np.ndarray | None = None,
        frozen: Pairs = (),
        rounds: int = FITTING.rounds,
    ) -> Fitted | None:
        """Fit from a start.

        Parameters
        ----------
        free : (number of the effect, its parameter) pairs whose derivatives are taken in each round.
        jacobian : (N', p + c) derivatives after whitening by the mechanism's parameters and by `frozen`, which stay as
            they are in all rounds; None: all derivatives are taken in each round.
        frozen : pairs of effects that stand first.

        Returns
        -------
        The fitted model, None where the start cannot be run.
        """
        errors = self.errors(point)
        if errors is None:
            return None
        best = self.objective(errors, point)
        pairs = (*frozen, *free)
        own = pairs[len(frozen) :]
        full = None
        for _ in range(rounds):
            if jacobian is None:
                full = self.white(self.derivatives(point, pairs))
            else:
                raw = self._raw(point) if own else None
                columns = [] if raw is None else [self._by_effect(point, raw, *pair)[:, :, None] for pair in own]
                full = np.hstack([jacobian, *(self.white(column) for column in columns)])
            step = self._newton(full, point, errors, pairs)
            gained = 0.0
            for moved, trial in self._tried(full, point, step, pairs):
                objective = self.objective(trial, moved)
                if objective < best:
                    gained = best - objective
                    point, errors, best = moved, trial, objective
                    break
            if gained < FITTING.least_round_gain:
                break
        return Fitted(point, errors, best, pairs, full)

    def from_start(self, fitted: Fitted, jacobian: np.ndarray) -> Fitted:
        """A fit, or one from the start values of the parameters with its effects, if that comes out lower: past
        parameters that had taken the place of an effect, a fit may have stopped in a local minimum. jacobian
        (N', p + c) : as for `run`."""
        start = Point(self.mechanism.start, fitted.point.effects)
        found = self.run(start, (), jacobian=jacobian, frozen=fitted.names, rounds=FITTING.rounds_from_start)
        return fitted if found is None or found.objective >= fitted.objective else found

    def to_end(
        self,
        point: Point,
        pairs: Pairs,
        raw: np.ndarray | None = None,
        *,
        gain: float = FITTING.finished,
        times: int = FITTING.relinearisations,
        near: np.ndarray | None = None,
    ) -> tuple[Fitted, np.ndarray]:
        """Fit until new derivatives gain no more than so much [nat].

        raw : derivatives before whitening to begin with; near : about a model near by; times : that they are taken.

        Returns
        -------
        The fitted model, and (N, J, p + c) the derivatives before whitening about it, or near it.

        Raises
        ------
        ParameterError : a start that cannot be run along the log.
        """
        if raw is None:
            raw = self.derivatives(point, pairs, near)
        fitted = self.linear(point, pairs, raw)
        for _ in range(times):
            before = fitted.objective
            raw = self.derivatives(fitted.point, pairs, raw)
            fitted = self.linear(fitted.point, pairs, raw)
            if before - fitted.objective < gain:
                break
        return fitted, raw

    def linear(self, point: Point, pairs: Pairs, raw: np.ndarray, *, rounds: int = FITTING.rounds) -> Fitted:
        """Fit with derivatives that stay as they are, from a model or from the start values.

        raw (N, J, p + c) : the derivatives before whitening.

        Raises
        ------
        ParameterError : a start that cannot be run along the log.
        """
        jacobian = self.white(raw)
        fitted = self.run(point, (), jacobian=jacobian, frozen=pairs, rounds=rounds)
        if fitted is None:
            raise _cannot_be_run()
        return self.from_start(fitted, jacobian)

    def _newton(self, full: np.ndarray, point: Point, errors: np.ndarray, pairs: Pairs) -> np.ndarray:
        """(p + c,) the step of Gauss and Newton from a model, with derivatives (N', p + c)."""
        m = self.mechanism
        slope, precision = self.prior(point, pairs)
        p = len(m.deviations)
        normal = full.T @ full + np.diag(np.concatenate([np.ones(p), precision]))
        position = (point.theta - m.start) / m.deviations
        gradient = full.T @ errors[self.rows] + np.concatenate([position, slope])
        return _bounded_step(normal, gradient, p)

    def _tried(
        self, full: np.ndarray, point: Point, step: np.ndarray, pairs: Pairs
    ) -> Iterator[tuple[Point, np.ndarray]]:
        """(model, its errors) one by one, those that can be run: a whole step; one more from there with the same
        derivatives, which brings back to the bottom of a valley that is bent, such as that of a drive's constant and
        all torques; parts of the step."""
        sizes = self.sizes(point, pairs)
        for share in FITTING.step_shares:
            moved = self._moved(point, share * step, pairs, sizes)
            if moved is not None:
                yield moved
            if moved is not None and share == 1.0:
                back = self._newton(full, *moved, pairs)
                moved = self._moved(moved[0], back, pairs, self.sizes(moved[0], pairs))
                if moved is not None:
                    yield moved

    def _moved(
        self, point: Point, step: np.ndarray, pairs: Pairs, sizes: list[float]
    ) -> tuple[Point, np.ndarray] | None:
        """The model a step away and its errors, None where it cannot be run."""
        moved = self.stepped(point, step, pairs, sizes)
        errors = None if moved is None else self.errors(moved)
        return None if moved is None or errors is None else (moved, errors)

    def sizes(self, point: Point, pairs: Pairs) -> list[float]:
        """What the columns of effects are derivatives per: the size of each parameter."""
        return [_size(point.effects[number], name) for number, name in pairs]

    def stepped(self, point: Point, step: np.ndarray, pairs: Pairs, sizes: list[float]) -> Point | None:
        """The model a step (p + c,) away, in the units of the derivatives, within all bounds; None
        where there is none such."""
        m = self.mechanism
        p = len(point.theta)
        theta = m.clip(point.theta + step[:p] * m.deviations)
        if not self.predictor.feasible(theta):
            return None
        effects: tuple[Effect, ...] | None = point.effects
        for (number, name), change, size in zip(pairs, step[p:], sizes):
            if effects is None:
                return None
            value = effects[number].values[name]
            if effects[number].kind.parameter(name).logarithmic:
                value *= float(np.exp(change))
            else:
                value += change * size
            effects = _with_value(effects, number, name, value, clip=True)
        return None if effects is None else Point(theta, effects)

    def step_to(self, point: Point, other: Point, pairs: Pairs, sizes: list[float]) -> np.ndarray:
        """(p + c,) the step from a model to another one of the same effects."""
        step = list((other.theta - point.theta) / self.mechanism.deviations)
        for (number, name), size in zip(pairs, sizes):
            before, after = (at.effects[number].values[name] for at in (point, other))
            scales = point.effects[number].kind.parameter(name).logarithmic
            step.append(np.log(after / before) if scales else (after - before) / size)
        return np.array(step)

    def validation_sum(self, errors: np.ndarray) -> float:
        """Half the sum of squares [nat] of the errors after whitening (N, J) on the validation set."""
        return 0.5 * float((errors[self.predictor.validation_rows] ** 2).sum())


def _cannot_be_run() -> ParameterError:
    what, expected = "a model that cannot be run along the log", "the parameters of a fit"
    return ParameterError(what, where="prediction", expected=expected)


def _bounded_step(normal: np.ndarray, gradient: np.ndarray, first: int) -> np.ndarray:
    """The step of Gauss and Newton with those from the `first` one on, in their sizes, no greater than
    `FITTING.greatest_step`: the others answer to what these are held at, else they would make room for a change that
    does not come."""
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


def _size(effect: Effect, name: str) -> float:
    """What derivatives by a parameter are per: its size, or, of a place that has no zero, how far
    it must move to matter. A hundredth of the angle at which a stop begins, of the time of a blow,
    or of a limit that is met by little, may jump over all of it."""
    size = effect.kind.parameter(name).step
    if size is not None:
        return effect.values[size] if isinstance(size, str) else size
    unit = next(p.unit for p in effect.kind.parameters if p.name == name)
    small = FITTING.typical_size.get(unit, FITTING.typical_other)
    return max(abs(effect.values[name]), FITTING.least_share_of_typical * small)


def _with_value(
    effects: tuple[Effect, ...], number: int, name: str, value: float, clip: bool = False
) -> tuple[Effect, ...] | None:
    """The effects with one value replaced; None where it is out of bounds."""
    effect = effects[number]
    spec = next(p for p in effect.kind.parameters if p.name == name)
    if clip:
        value = min(max(value, spec.low), spec.high)
    try:
        changed = Effect(effect.kind, effect.joint, {**effect.values, name: float(value)})
    except ParameterError:
        return None
    return (*effects[:number], changed, *effects[number + 1 :])
