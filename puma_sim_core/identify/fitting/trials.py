# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Trials of hypotheses: each put into the model, and fitted with all its parameters.

A trial counts by its gain of log likelihood less the Occam factor, its gain on the validation set, and its sizes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from puma_sim_core.effects import KINDS, Effect, Kind
from puma_sim_core.effects.base import Parameter, Role
from puma_sim_core.effects.screening import Illegal, Values, reached
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting import occam
from puma_sim_core.identify.fitting.pieces import clearly_above_zero
from puma_sim_core.identify.fitting.point import Pairs, Point, bounded, with_value
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit, Slopes
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.resolution import unresolved
from puma_sim_core.identify.fitting.trial import IMPOSSIBLE, Trial
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.settings import FITTING, SELECTION
from puma_sim_core.pages.text import plain_quantity

_NOT_FINITE = "the model with it does not stay finite along the log"


@dataclass(frozen=True)
class Base:
    """A fitted model that hypotheses are added to. jacobian (N', p + c) : derivatives after whitening, at the rows to
    fit, by the parameters of the mechanism and by `model.names`."""

    fit: PredictionFit
    model: Fitted
    jacobian: Floats

    @cached_property
    def slopes(self) -> Slopes:
        """`jacobian` with its normal matrix."""
        return Slopes.of(self.jacobian)

    def with_effect(self, effect: Effect, theta: Floats | None = None) -> Point:
        """The model with one effect more, and with other parameters if there are any."""
        point = self.model.point
        return Point(point.theta if theta is None else theta, (*point.effects, effect))


class Trials:
    """Makes the trials of one problem, whose mechanism the effects are put into."""

    def __init__(self, predictor: Predictor, problem: Problem):
        self.predictor = predictor
        self.problem = problem
        self.mechanism = problem.mechanism

    def base(self, model: Fitted, noise: Weighting, jacobian: Floats) -> Base:
        """A fitted model to add to. jacobian (N, J, p + c) : its derivatives before whitening."""
        fit = PredictionFit(self.predictor, noise)
        return Base(fit, model, fit.whitened(jacobian))

    def run(self, base: Base, scored: Scored, start: Point | None = None, again: bool = False) -> Trial:
        """A hypothesis in the model, fitted with all that is free.

        start : to go on from, in place of the screened values; again : whether to take all derivatives anew where the
        fit does not keep what the screening promised.
        """
        try:
            effect = self.effect(scored) if start is None else start.effects[-1]
        except ParameterError as problem:
            return Trial(scored, 0.0, 0.0, None, scored.occam, f"{IMPOSSIBLE}: {problem}")
        number = len(base.model.point.effects)
        free = tuple((number, name) for name in self.names(effect, scored.values))
        screened = base.with_effect(effect)
        if start is None:
            start = self._best_start(base.fit, screened, scored)

        run = partial(base.fit.run, jacobian=base.slopes, frozen=base.model.names, rounds=FITTING.trial_rounds)
        fitted, compensated = run(start, free), None
        if fitted is None or fitted.objective > base.model.objective:
            compensated = self._compensated(base, scored)
        if compensated is not None:
            fitted = _lowest(fitted, run(compensated, free))
        promised = FITTING.promised * scored.gain if scored.best is not None else np.inf
        if again and (fitted is None or base.model.objective - fitted.objective < promised):
            # without the effect, parameters may be stretched so far that they and their derivatives are of no use
            starts = [Point(self.mechanism.start, start.effects)]
            if compensated is not None:
                starts.append(compensated if fitted is None else fitted.point)
            if fitted is not None and fixed(scored):
                # a limit that fits best with the parameters as they are may not be where it is
                starts += [fitted.point, Point(self.mechanism.start, screened.effects)]
            fitted = _lowest(fitted, *self._relinearised(base, free, starts, not fixed(scored)))
        if fitted is None:
            return Trial(scored, 0.0, 0.0, None, occam.screened(scored), _NOT_FINITE)
        return self.judged(base.fit, base.model, scored, fitted)

    def _relinearised(self, base: Base, free: Pairs, starts: list[Point], patient: bool) -> list[Fitted | None]:
        """Fits from several starts with derivatives about each. patient : go on from one worse than the base."""
        fit, frozen = base.fit, base.model.names
        if not starts[0].two_mass:
            pairs = (*frozen, *free)
            # one round from each; what is best then has the others: the derivatives take nearly all of the time
            firsts = [fit.run(at, pairs, rounds=1) for at in starts]
            best = first = _lowest(*firsts)
            if first is not None:
                best = fit.run(first.point, pairs, rounds=FITTING.relinearised_rounds - 1)
            for at in (best, *(f for f in firsts if f is not first)) if patient else ():
                # none need be worse than without the effect: a fit that is has not ended, and the best of them may be
                # on its way to nothing
                if at is not None and best is not None and best.objective > base.model.objective:
                    best = _lowest(best, fit.run(at.point, pairs, rounds=FITTING.patient_rounds))
            return [best]
        slopes = base.slopes
        if not base.model.point.two_mass:
            # a two-mass model answers to the arm's parameters much as the rigid one does
            nominal = Point(self.mechanism.start, base.model.point.effects)
            slopes = Slopes.of(fit.whitened(fit.derivatives(nominal, frozen)))
        return [fit.run(at, free, jacobian=slopes, frozen=frozen, rounds=FITTING.two_mass_rounds) for at in starts]

    def _compensated(self, base: Base, scored: Scored) -> Point | None:
        """The model with an effect as screened, and parameters that answer to it by slopes: they may look alike."""
        if scored.best is None or fixed(scored) or KINDS[scored.name].two_masses:
            return None
        coefficients, values = scored.best.coefficients, scored.best.entry.candidate.values
        try:
            little, whole = (
                self.effect(replace(scored, values=values(part * coefficients)))
                for part in (FITTING.small_coefficients, 1.0)
            )
        except (Illegal, ParameterError):
            return None
        answer = self._answer(base, little)
        return None if answer is None else base.with_effect(whole, self._answered(base, answer))

    def best_level(self, base: Base, scored: Scored, values: Values) -> Point | None:
        """The model with an effect whose first value is its level, the one that fits best of the levels that machines
        have, with parameters as they are or as they answer to it.

        None where that is the least one, or where each fits worse than none by more than a name needs.
        """
        name, unit = next(iter(values)), self.effect(replace(scored, values=dict(values)))
        little = with_value((unit,), 0, name, FITTING.small_coefficients * values[name])
        answer = None if little is None else self._answer(base, little[0])
        best, least = None, base.model.objective + SELECTION.least_gain
        for number, level in enumerate(self._sizes(unit, name)):
            effects = with_value((unit,), 0, name, level)
            if effects is None:
                continue
            thetas = [None] if answer is None else [None, self._answered(base, answer, level / values[name])]
            for point in (base.with_effect(effects[0], theta) for theta in thetas):
                errors = base.fit.errors(point)
                if errors is not None and (objective := base.fit.objective(errors, point)) < least:
                    best, least = None if number == 0 else point, objective
        return best

    def _answer(self, base: Base, little: Effect) -> Floats | None:
        """(p,) deviations by which the parameters answer to an effect by slopes. little : it, in a small share."""
        fit, model = base.fit, base.model
        errors = fit.errors(base.with_effect(little))
        if errors is None:
            return None
        slope = (errors - model.errors)[fit.rows] / FITTING.small_coefficients
        p = len(model.point.theta)
        precision = np.r_[np.ones(p), np.full(base.jacobian.shape[1] - p, FITTING.least_precision)]
        return -np.linalg.solve(base.slopes.normal + np.diag(precision), base.jacobian.T @ slope)[:p]

    def _answered(self, base: Base, answer: Floats, share: float = 1.0) -> Floats:
        """(p,) the parameters of a model with a share of their answer, within their bounds."""
        return self.mechanism.clip(base.model.point.theta + share * answer * self.mechanism.deviations)

    def judged(self, fit: PredictionFit, base: Fitted, scored: Scored, fitted: Fitted) -> Trial:
        """The trial of a fitted hypothesis, by its gains over the base."""
        factor = occam.factor(scored, fit, fitted)
        gain = base.objective - fitted.objective - factor
        problem = self.problem_of(fit, fitted, len(fitted.point.effects) - 1)
        # the derivatives are the greatest part of it, and what is named is fitted again
        kept = replace(fitted, jacobian=None)
        validation_gain = self.validation_gain(fit, base, fitted, gain)
        return Trial(scored, gain, validation_gain, kept, factor, problem, self.eased(base, fitted))

    def eased(self, base: Fitted, fitted: Fitted) -> float:
        """By how much [nat] the parameters of a model are strained less than those of another."""
        return base.point.strain(self.mechanism) - fitted.point.strain(self.mechanism)

    @staticmethod
    def validation_gain(fit: PredictionFit, base: Fitted, fitted: Fitted, gain: float) -> float:
        """Gain [nat] on the validation set; `FITTING.untried` where that says nothing of the effect: one that does not
        act there, or whose loss there is within chance."""
        if fit.validation_sum(base.errors - fitted.errors) < max(FITTING.untried, FITTING.untried_share * gain):
            # a limit that was met, or an impact, elsewhere
            return FITTING.untried
        found = fit.validation_pieces(base.errors) - fit.validation_pieces(fitted.errors)
        return FITTING.untried if found.sum() <= 0.0 and not clearly_above_zero(-found) else float(found.sum())

    def _best_start(self, fit: PredictionFit, screened: Point, scored: Scored) -> Point:
        """The screened model, its threshold or stiffness the one that fits best of a few: no slope shows it.

        A missing effect may have stretched the parameters that the screening took it by. One mass is quick enough to
        try the sizes that machines have, at these parameters and at the nominal ones. Of two masses it is the one that
        was run in the screening, where the parameters answered to it.
        """
        if not fixed(scored):
            return screened
        number, name = len(screened.effects) - 1, next(iter(scored.values or ()))
        value = screened.effects[-1].values[name]
        shares = (1.0,) if KINDS[scored.name].two_masses else FITTING.threshold_starts
        starts = [(screened.theta, share * value) for share in shares]
        sizes = self._sizes(screened.effects[-1], name)
        if not screened.two_mass:
            starts += [(theta, size) for theta in (screened.theta, self.mechanism.start) for size in sizes]
        found = fit.lowest_of(_of_value(screened, number, name, starts))
        if found is None:
            return screened
        size = found[0].effects[number].values[name]
        most = max(size for _, size in starts)
        # the best of them may be the greatest: then it lies beyond, as far as a machine may have it
        ratio = FITTING.threshold_starts[-1] / FITTING.threshold_starts[-2]
        farthest = FITTING.above_plausible * max(sizes, default=0.0)
        while size >= most and (most := ratio * most) <= farthest:
            further = fit.lowest_of(_of_value(screened, number, name, [(found[0].theta, most)]))
            if further is None or further[1] >= found[1]:
                break
            found, size = further, most
        return found[0]

    def sized(self, point: Point, scored: Scored) -> list[Point]:
        """A model, and it with the last effect in all sizes that machines have, where no slope shows them."""
        found, number = [point], len(point.effects) - 1
        if fixed(scored):
            name = next(iter(scored.values or ()))
            changed = (with_value(point.effects, number, name, v) for v in self._sizes(point.effects[number], name))
            found += [Point(point.theta, effects) for effects in changed if effects is not None]
        return found

    def _sizes(self, effect: Effect, name: str) -> list[float]:
        """Sizes of a parameter from the least to the greatest that a machine has, evenly in their logarithm."""
        joint = None if effect.joint is None else effect.joint - 1
        plausible = self.mechanism.plausible(effect.kind.parameter(name), joint)
        return [] if plausible is None else [float(size) for size in np.geomspace(*plausible, FITTING.threshold_sizes)]

    def free(self, point: Point) -> Pairs:
        """All free parameters of the effects of a model."""
        return tuple(
            (number, name) for number, effect in enumerate(point.effects) for name in self.names(effect, effect.values)
        )

    def names(self, effect: Effect, values: Iterable[str] | None) -> list[str]:
        """Parameters that are fitted: those of the screening that are not given by the construction or the machine."""
        kind, joint = effect.kind, effect.joint
        names = [name for name in values or () if _is_fitted(kind.parameter(name))]
        if kind.screening is None or kind.screening.fitted is None or joint is None:
            return names
        return kind.screening.fitted(names, effect.values, *self._range(joint))

    def effect(self, scored: Scored) -> Effect:
        """The effect of a hypothesis with its screened values, within their bounds."""
        effect = bounded(KINDS[scored.name], scored.joint, scored.values or {})
        return self.mechanism.plant(self.mechanism.start, (effect,)).effects[-1]

    def problem_of(self, fit: PredictionFit, fitted: Fitted, number: int) -> str | None:
        """Why an effect of a fitted model, by its number, may not be named, None where it may."""
        return unresolved(self.problem, fit, fitted, number) or self.implausible(fitted.point.effects[number])

    def implausible(self, effect: Effect) -> str | None:
        """Why an effect can be none of this machine, None where it may be one."""
        without_size = self._on_bound(effect) or self._illegal(effect)
        if without_size is not None:
            return without_size
        joint = None if effect.joint is None else effect.joint - 1
        small: list[str | None] = []
        for name, _, _ in effect.kind.plausible:
            value, parameter = effect.values.get(name), effect.kind.parameter(name)
            period = self.predictor.step if parameter.periods else 0.0
            plausible = self.mechanism.plausible(parameter, joint, period)
            if value is None or plausible is None:
                continue
            least, most = plausible
            unit = self.mechanism.unit(parameter.unit)
            size, least_size, most_size = (plain_quantity(each, unit) for each in (value, least, most))
            less = f"{IMPOSSIBLE}: {name} {size}, less than any machine has ({least_size})"
            if abs(value) > FITTING.above_plausible * most and not (parameter.inverse or _from_outside(effect)):
                return f"{IMPOSSIBLE}: {name} {size}, more than any machine has ({most_size})"
            if parameter.role is Role.RATE and value < least / FITTING.below_plausible:
                return less
            if parameter.role is Role.SIZE:
                enough = abs(value) >= least / FITTING.below_plausible or self._leaves_motion(effect, parameter)
                small.append(None if enough else less)
        # too small only if all of its sizes are
        return small[-1] if small and all(small) else None

    def _leaves_motion(self, effect: Effect, parameter: Parameter) -> bool:
        """Whether a limit leaves what the motion takes: a drive may be set to any such limit, however small."""
        if parameter.neutral != np.inf or effect.joint is None:
            return False
        taken = self._taken[parameter.unit][effect.joint - 1]
        return bool(effect.values[parameter.name] >= FITTING.limit_of_motion * taken)

    @cached_property
    def _taken(self) -> dict[str, Floats]:
        """Unit -> (J,) root mean squares of current [A] and voltage [V] that the motion takes by the start parameters
        without dry friction."""
        signals = self.problem.signals(self.mechanism.start)
        volts = signals.volts_per_torque * signals.torque + signals.emf * signals.velocity
        taken = {"A": signals.current, "V": volts}
        return {unit: np.sqrt(np.mean(values**2, axis=0)) for unit, values in taken.items()}

    def _on_bound(self, effect: Effect) -> str | None:
        """Why a parameter that was fitted has no value: it stands on a bound of its law, zero apart, which is none."""
        for name in self.names(effect, effect.values):
            parameter, value = effect.kind.parameter(name), effect.values[name]
            for bound in (parameter.low, parameter.high):
                if bound != 0.0 and abs(value - bound) <= FITTING.at_bound * abs(bound):
                    return f"{IMPOSSIBLE}: {name} on the bound {bound:.3g} of what its law allows"
        return None

    def _illegal(self, effect: Effect) -> str | None:
        """Why no machine has the effect along this log, as its screening says it."""
        screening = effect.kind.screening
        if screening is None or screening.illegal is None or effect.joint is None:
            return None
        motion = self._range(effect.joint)
        reason = screening.illegal(effect.values, motion, reached(self.mechanism.ranges[effect.joint - 1], motion))
        return None if reason is None else f"{IMPOSSIBLE}: {reason}"

    def _range(self, joint: int) -> tuple[float, float]:
        """Lowest and highest position of a joint (1-based) in the logs."""
        q = self.problem.sampled.position[:, joint - 1]
        return float(q.min()), float(q.max())


def _is_fitted(parameter: Parameter) -> bool:
    """Whether a fit moves it: not what the construction gives, nor what the effect takes from its machine."""
    return parameter.role is Role.PLACE or (parameter.role is not Role.STRUCTURE and parameter.from_arm is None)


def _from_outside(effect: Effect) -> bool:
    """Whether no size of the machine bounds an effect: a push that lasts as long as a hand's may be ninety times the
    friction of a joint. A shorter one of that size is a row that is wrong."""
    places = [low <= effect.values[n] <= FITTING.above_plausible * high for n, low, high in _places(effect.kind)]
    return not effect.kind.repeatable and all(places)


def _places(kind: Kind) -> list[tuple[str, float, float]]:
    """(name, low, high) of what says where or how long an effect acts, where that has plausible sizes."""
    return [each for each in kind.plausible if kind.parameter(each[0]).role is Role.PLACE]


def fixed(scored: Scored) -> bool:
    """Whether a hypothesis has no coefficients: its values are those of a grid, or it is tried without a screening."""
    return unseen(scored) if scored.best is None else scored.best.entry.candidate.fixed


def unseen(scored: Scored) -> bool:
    """Whether it is tried, with one mass, where the screening has no power."""
    kind = KINDS[scored.name]
    return scored.best is None and not kind.two_masses and bool(kind.screening and kind.screening.unseen)


def _of_value(model: Point, number: int, name: str, starts: Iterable[tuple[Floats, float]]) -> Iterator[Point]:
    """A model with several (parameters, value of one parameter of an effect)."""
    for theta, value in starts:
        effects = with_value(model.effects, number, name, value, clip=True)
        yield Point(theta, effects or model.effects)


def _lowest(*fits: Fitted | None) -> Fitted | None:
    """The fit with the lowest objective of those that there are."""
    return min((f for f in fits if f is not None), key=lambda f: f.objective, default=None)
