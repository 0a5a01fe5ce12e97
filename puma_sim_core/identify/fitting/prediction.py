# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Prediction errors: the model led along the log, its parameters fitted to innovations (step 6).

What the screening reads from filtered motion is quick and linear, and not exact: friction about a
reversal is blurred, and accelerations carry noise that feedback has sent through the voltage. Here
the model itself, with all its effects, is run along the log as an observer (`tracking`). Of a
true model the innovations are white and independent of the past, with feedback and without, so that
fits are unbiased (Ljung, System Identification, chapter 13). Their weighting is a causal filter
(`colour`), which keeps that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from puma_sim_core.effects import Effect
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.parallel import each

#: step of a finite difference, as a share of the deviation of a parameter of the mechanism and of
#: the size of a parameter of an effect
_DIFFERENCE, _EFFECT_DIFFERENCE = 0.05, 0.01
#: what is told of a parameter of an effect, per its size, where nothing is
_LEAST_TOLD = 1e-4
#: what a parameter of an effect near zero counts as, by its unit
_TYPICAL = {
    "rad": 0.02,
    "s": 1e-3,
    "V": 0.1,
    "N.m": 1.0,
    "1": 0.1,
    "A": 1.0,
    "kg": 0.3,
    "m": 0.1,
    "rad/s": 0.05,
    "N.m/rad": 5.0,
    "N.m.s/rad": 1.0,
    "1/A": 1e-3,
    "N.m.s2/rad2": 1.0,
}


#: greatest step of a parameter of an effect, in its sizes
_FARTHEST = 1.5
#: gain [nat] of new derivatives below which a fit counts as finished, and most times that they are
#: taken: a base that is not finished lends its gain to whatever is tried first
_FINISHED, _REFITS = 2.0, 2
#: rounds of a fit from the start values
_FROM_START = 6


@dataclass(frozen=True)
class Point:
    """A model: parameters theta (p,) and effects."""

    theta: np.ndarray
    effects: tuple[Effect, ...]

    @property
    def heavy(self) -> bool:
        """Whether a joint of it has two masses."""
        return any(effect.kind.two_masses for effect in self.effects)

    @property
    def key(self) -> tuple:
        """What tells it from any other, to the bit."""
        return self.theta.tobytes(), tuple(
            (effect.kind.name, effect.joint, *sorted(effect.values.items())) for effect in self.effects
        )


@dataclass(frozen=True)
class Fitted:
    """A model fitted to innovations: white errors (N, J), the objective (half the sum of squares
    of the rows to fit and of the prior), and the normal matrix about the last step."""

    point: Point
    errors: np.ndarray
    objective: float
    names: tuple[tuple[int, str], ...]
    jacobian: np.ndarray | None = None


class PredictionFit:
    """Least squares of innovations over parameters and effects, by Gauss and Newton."""

    def __init__(self, predictor: Predictor, weighting: Weighting):
        self.predictor = predictor
        self.weighting = weighting
        self.rows = predictor.fit_rows
        self.mechanism = predictor.mechanism

    def errors(self, point: Point) -> np.ndarray | None:
        """(N, J) white innovations, None where the model cannot be run."""
        raw = self._raw(point)
        return None if raw is None else self.weighting(raw)

    def objective(self, errors: np.ndarray, point: Point) -> float:
        """Half the sum of squares, of the rows to fit and of the parameters' priors."""
        m = self.mechanism
        step = (point.theta - m.start) / m.deviations
        far = [self._prior(effect, name)[0] for effect in point.effects for name in effect.values]
        return 0.5 * float((errors[self.rows] ** 2).sum() + step @ step + np.dot(far, far))

    def prior(self, point: Point, pairs) -> tuple[np.ndarray, np.ndarray]:
        """(c,) slopes of the objective's priors by parameters of effects, per size, and (c,) what
        they tell of each."""
        known = np.array([self._prior(point.effects[number], name) for number, name in pairs])
        far, told = known.reshape(-1, 2).T
        return far * told, _LEAST_TOLD + told**2

    def _prior(self, effect: Effect, name: str) -> tuple[float, float]:
        """How many deviations the logarithm of a parameter is off, and how many of them are one;
        zeros where nothing is known of it, as of other mechanisms than the arm."""
        prior = effect.kind.parameter(name).prior if self.mechanism.joints == 3 else None
        if prior is not None:
            median, factor = prior
            one = 1.0 / np.log(factor)
            return one * np.log(max(effect.values[name], 1e-3 * median) / median), one
        return 0.0, 0.0

    def derivatives(self, point: Point, pairs, near: np.ndarray | None = None) -> np.ndarray:
        """(N, J, p + c) derivatives of the raw innovations by the mechanism's parameters, per
        deviation, and by parameters of effects, per size (`sizes`). Not to be written to: they are
        remembered.

        near : those about a model near by; a model of two masses takes its derivatives by the
        mechanism's parameters over.
        """
        if near is not None and point.heavy:
            return self._derived(point, pairs, near[:, :, : len(point.theta)])
        return self.predictor.derived((point.key, tuple(pairs)), lambda: self._derived(point, pairs))

    def _derived(self, point: Point, pairs, by_parameters=None) -> np.ndarray:
        raw = self._raw(point)
        if raw is None:
            raise ParameterError(
                "a model that cannot be run along the log", where="prediction", expected="the parameters of a fit"
            )
        if by_parameters is None:
            columns = each(lambda k: self._by_parameter(point, raw, k), range(len(point.theta)))
        else:
            columns = list(np.moveaxis(by_parameters, 2, 0))
        columns += each(lambda pair: self._by_effect(point, raw, *pair), pairs)
        return np.stack(columns, axis=2) if columns else np.zeros((*raw.shape, 0))

    def white(self, derivatives: np.ndarray) -> np.ndarray:
        """(N', p) raw derivatives (N, J, p) in this weighting, at the rows to fit."""
        return self.weighting(derivatives)[self.rows]

    def _raw(self, point: Point) -> np.ndarray | None:
        try:
            return self.predictor.errors(self.mechanism.plant(point.theta, point.effects))
        except (NonFiniteStateError, ParameterError):
            return None

    def _by_parameter(self, point, raw, number) -> np.ndarray:
        theta = point.theta.copy()
        theta[number] += _DIFFERENCE * self.mechanism.deviations[number]
        moved = self._raw(Point(theta, point.effects))
        return np.zeros_like(raw) if moved is None else (moved - raw) / _DIFFERENCE

    def _by_effect(self, point, raw, number, name) -> np.ndarray:
        effect = point.effects[number]
        size = _size(effect, name)
        for sign in (1.0, -1.0):
            effects = _with_value(point.effects, number, name, effect.values[name] + sign * _EFFECT_DIFFERENCE * size)
            moved = None if effects is None else self._raw(Point(point.theta, effects))
            if moved is not None:
                return (moved - raw) / (sign * _EFFECT_DIFFERENCE)
        return np.zeros_like(raw)

    def run(self, point: Point, free, *, known=None, known_free=(), rounds: int = 4) -> Fitted | None:
        """Fit from a start.

        free : (number of the effect, its parameter) pairs. known : (N', p + c) derivatives by the
        mechanism's parameters and by `known_free`, pairs of effects that stand first, to go on
        with; None: all derivatives are taken in each round.

        Returns
        -------
        The fitted model, None where the start cannot be run.
        """
        errors = self.errors(point)
        if errors is None:
            return None
        best = self.objective(errors, point)
        pairs = (*known_free, *free)
        full = None
        for _ in range(rounds):
            if known is None:
                full = self.white(self.derivatives(point, pairs))
            else:
                raw = self._raw(point) if free else None
                full = np.hstack(
                    [
                        known,
                        *(self.white(self._by_effect(point, raw, number, name)[:, :, None]) for number, name in free),
                    ]
                )
            step = self._newton(full, point, errors, pairs)
            gained = 0.0
            for moved, trial in self._tried(full, point, step, pairs):
                objective = self.objective(trial, moved)
                if objective < best:
                    gained = best - objective
                    point, errors, best = moved, trial, objective
                    break
            if gained < 0.1:
                break
        return Fitted(point, errors, best, pairs, full)

    def from_start(self, fitted: Fitted, known: np.ndarray) -> Fitted:
        """A fit, or one from the start values of the parameters on, with the effects as they are
        there, if that comes out lower: past parameters that had taken the place of an effect, a fit
        may have stopped in a valley whose bottom is nearly level. known (N', p + c): derivatives.
        """
        start = Point(self.mechanism.start, fitted.point.effects)
        found = self.run(start, (), known=known, known_free=fitted.names, rounds=_FROM_START)
        return fitted if found is None or found.objective >= fitted.objective else found

    def to_end(
        self, point: Point, pairs, raw=None, gain: float = _FINISHED, times: int = _REFITS, near=None
    ) -> tuple[Fitted, np.ndarray]:
        """The fit from a model on, with the raw derivatives about it: taken anew until they gain no
        more than so much [nat]. raw : derivatives to begin with; near : about a model near by."""
        if raw is None:
            raw = self.derivatives(point, pairs, near)
        known = self.white(raw)
        fitted = self.from_start(self.run(point, (), known=known, known_free=pairs), known)
        for _ in range(times):
            before = fitted.objective
            raw = self.derivatives(fitted.point, pairs, raw)
            known = self.white(raw)
            fitted = self.from_start(self.run(fitted.point, (), known=known, known_free=pairs), known)
            if before - fitted.objective < gain:
                break
        return fitted, raw

    def _newton(self, full, point: Point, errors, pairs) -> np.ndarray:
        """(p + c,) the step of Gauss and Newton from a model, with derivatives (N', p + c)."""
        m = self.mechanism
        slope, told = self.prior(point, pairs)
        p = len(m.deviations)
        normal = full.T @ full + np.diag(np.concatenate([np.ones(p), told]))
        position = (point.theta - m.start) / m.deviations
        gradient = full.T @ errors[self.rows] + np.concatenate([position, slope])
        return _bounded_step(normal, gradient, p)

    def _tried(self, full, point: Point, step, pairs):
        """(model, its errors) one by one, those that can be run: a whole step; one more from there
        with the same derivatives, which brings back to the bottom of a valley that is bent, such as
        that of a drive's constant and all torques; parts of the step."""
        sizes = self.sizes(point, pairs)
        for share in (1.0, 0.5, 0.25, 0.1):
            moved = self.stepped(point, share * step, pairs, sizes)
            trial = None if moved is None else self.errors(moved)
            if trial is None:
                continue
            yield moved, trial
            if share < 1.0:
                continue
            back = self._newton(full, moved, trial, pairs)
            moved = self.stepped(moved, back, pairs, self.sizes(moved, pairs))
            trial = None if moved is None else self.errors(moved)
            if trial is not None:
                yield moved, trial

    def sizes(self, point: Point, pairs) -> list[float]:
        """What the columns of effects are derivatives per: the size of each parameter."""
        return [_size(point.effects[number], name) for number, name in pairs]

    def stepped(self, point: Point, step, pairs, sizes) -> Point | None:
        """The model a step (p + c,) away, in the units of the derivatives, within all bounds; None
        where there is none such."""
        m = self.mechanism
        p = len(point.theta)
        theta = m.clip(point.theta + step[:p] * m.deviations)
        if not self.predictor.feasible(theta):
            return None
        effects = point.effects
        for (number, name), change, size in zip(pairs, step[p:], sizes):
            value = effects[number].values[name]
            if effects[number].kind.parameter(name).logarithmic:
                value *= float(np.exp(change))
            else:
                value += change * size
            effects = _with_value(effects, number, name, value, clip=True)
            if effects is None:
                return None
        return Point(theta, effects)

    def step_to(self, point: Point, other: Point, pairs, sizes) -> np.ndarray:
        """(p + c,) the step from a model to another one of the same effects."""
        step = list((other.theta - point.theta) / self.mechanism.deviations)
        for (number, name), size in zip(pairs, sizes):
            before, after = (at.effects[number].values[name] for at in (point, other))
            scales = point.effects[number].kind.parameter(name).logarithmic
            step.append(np.log(after / before) if scales else (after - before) / size)
        return np.array(step)

    def held_sum(self, errors: np.ndarray) -> float:
        """Half the sum of squares of the white errors that are kept back."""
        return 0.5 * float((errors[self.predictor.held_rows] ** 2).sum())


def _bounded_step(normal, gradient, first: int) -> np.ndarray:
    """The step of Gauss and Newton with those from the `first` one on, in their sizes, no greater
    than `_FARTHEST`: the others answer to what these are held at, else they would make room for a
    change that does not come."""
    step, held = np.zeros(len(gradient)), np.zeros(len(gradient), dtype=bool)
    while True:
        free = ~held
        wanted = gradient[free] + normal[np.ix_(free, held)] @ step[held]
        step[free] = -cho_solve(cho_factor(normal[np.ix_(free, free)], lower=True), wanted)
        far = free & (np.abs(step) > _FARTHEST)
        far[:first] = False
        if not far.any():
            return step
        step[far] = np.copysign(_FARTHEST, step[far])
        held |= far


def _size(effect: Effect, name: str) -> float:
    """What derivatives by a parameter are per: its size, or, of a place that has no zero, how far
    it must move to matter. A hundredth of the angle at which a stop begins, of the time of a blow,
    or of a limit that is met by little, may jump over all of it."""
    size = effect.kind.parameter(name).step
    if size is not None:
        return effect.values[size] if isinstance(size, str) else size
    return max(abs(effect.values[name]), 0.3 * typical(effect, name))


def typical(effect: Effect, name: str) -> float:
    """What counts as a small size of a parameter of an effect."""
    unit = next(p.unit for p in effect.kind.parameters if p.name == name)
    return _TYPICAL.get(unit, 0.1)


def _with_value(effects, number, name, value, clip: bool = False):
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
