# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Hypotheses put into the model one by one, and fitted with all its parameters (step 6).

The gain of log likelihood less the price of the free coefficients is what a trial is worth; the
same on rows that were kept back, and whether its parameters are those of a machine, are the other
things said of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.effects.base import Parameter, Role
from puma_sim_core.effects.screening import Illegal
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.fitting import prices
from puma_sim_core.identify.fitting.prediction import Fitted, Point
from puma_sim_core.identify.parallel import each
from puma_sim_core.identify.screening.evidence import Scored

#: a tie: gains closer than this [nat], or than this share of the better one
TIE_NATS, TIE_SHARE = 8.0, 0.003
#: share of its screened gain that a fit must reach, else all derivatives are taken anew
_PROMISED = 0.7
#: share of the best gain above which a trial is fitted again with its own derivatives, for how
#: many, and from which gain [nat] on
_NEAR, _POLISHED, _WORTH = 0.6, 4, 8.0
#: most times that its derivatives are taken, and the gain [nat] below which that is enough
_POLISHINGS, _SMOOTH = 3, 2.0
#: share of screened coefficients that slopes are taken over
_LITTLE = 1e-3
#: shares of a screened threshold that a fit may start from
_STARTS = (0.7, 0.8, 0.87, 0.94, 1.0, 1.07, 1.15, 1.3)
#: change [nat] of the rows kept back, and share of the gain, below which an effect does not act
#: on them
_UNTOUCHED, _UNTOUCHED_SHARE = 1.5, 0.03
_IMPOSSIBLE = "it would need an impossible value"
#: how far outside its plausible sizes a parameter may come out, above and below
_BEYOND, _BELOW = 2.0, 4.0


@dataclass(frozen=True)
class Trial:
    """A hypothesis in the model: its gain [nat], its gain on the rows kept back, what was fitted;
    why it is no name, None where it may be one."""

    name: str
    joint: int | None
    gain: float
    held_gain: float
    fitted: Fitted | None
    price: float
    problem: str | None = None

    @property
    def key(self) -> tuple:
        """(name, joint)."""
        return self.name, self.joint

    @property
    def vanishing(self) -> bool:
        """Whether it is as stiff as it may be, and nothing of it left but what it contains."""
        effects = () if self.fitted is None else self.fitted.point.effects[-1:]
        return any(p.inverse and effect.values[p.name] >= p.high for effect in effects for p in effect.kind.parameters)

    @property
    def untried(self) -> bool:
        """Whether next to nothing of it acts on the rows kept back."""
        return self.held_gain == _UNTOUCHED


class Trials:
    """Makes the trials of one problem.

    predictor : `Predictor`; problem : `Problem`, whose mechanism the effects are put into.
    """

    def __init__(self, predictor, problem):
        self.predictor = predictor
        self.problem = problem
        self.mechanism = problem.mechanism

    def run(
        self, fit, base: Fitted, known, known_free, scored: Scored, start: Point | None = None, again: bool = False
    ) -> Trial:
        """A hypothesis in the model, fitted with all that is free.

        start : to go on from, in place of the screened values; again : whether to take all
        derivatives anew where the fit does not keep what the screening promised.
        """
        number = len(base.point.effects)
        try:
            effect = self.effect(scored) if start is None else start.effects[-1]
        except ParameterError as problem:
            return Trial(scored.name, scored.joint, 0.0, 0.0, None, scored.price, f"{_IMPOSSIBLE}: {problem}")
        free = [(number, name) for name in self.names(effect, scored.values)]
        screened = Point(base.point.theta, (*base.point.effects, effect))
        if start is None:
            start = self._best_start(fit, screened, scored)
        fitted = fit.run(start, free, known=known, known_free=known_free, rounds=5)
        answered = None
        if fitted is None or fitted.objective > base.objective:
            answered = self._answered(fit, base, known, scored)
        if answered is not None:
            fitted = _lowest(fitted, fit.run(answered, free, known=known, known_free=known_free, rounds=5))
        if again and (fitted is None or base.objective - fitted.objective < _PROMISED * scored.gain):
            # a model without the effect may have stretched its parameters so far that they, or
            # derivatives about them, are of no use to the model with it
            starts = [Point(self.mechanism.start, start.effects)]
            if answered is not None:
                starts.append(answered if fitted is None else fitted.point)
            if fitted is not None and _fixed(scored):
                # a limit that fits best with the parameters as they are may not be where it is
                starts += [fitted.point, Point(self.mechanism.start, screened.effects)]
            fitted = _lowest(fitted, *self._anew(fit, base, known, known_free, free, starts, not _fixed(scored)))
        if fitted is None:
            return Trial(
                scored.name,
                scored.joint,
                0.0,
                0.0,
                None,
                prices.screened(scored),
                "the model with it does not stay finite along the log",
            )
        return self._judged(fit, base, scored, fitted)

    def _anew(self, fit, base: Fitted, known, known_free, free, starts, patient) -> list[Fitted | None]:
        """Fits from several starts with derivatives about each. patient : whether to go on from one
        that is worse than the base."""
        if not starts[0].heavy:
            pairs = (*known_free, *free)
            found = [fit.run(at, pairs, rounds=3) for at in starts]
            best = _lowest(*found)
            if patient and best is not None and best.objective > base.objective:
                # none need be worse than without the effect: the fit is still on its way
                found.append(fit.run(best.point, pairs, rounds=3))
            return found
        if not base.point.heavy:
            # a model of two masses answers to the arm's parameters much as the rigid one does
            known = fit.white(fit.derivatives(Point(self.mechanism.start, base.point.effects), known_free))
        return [fit.run(at, free, known=known, known_free=known_free, rounds=6) for at in starts]

    def _answered(self, fit, base: Fitted, known, scored: Scored) -> Point | None:
        """The model with an effect as screened and the parameters as they answer to it, both by
        slopes about nothing of it: one that looks like parameters, such as a load, is far from the
        log as long as they have taken its place."""
        if scored.entry is None or _fixed(scored) or KINDS[scored.name].two_masses:
            return None
        values = scored.entry.candidate.values
        try:
            little, whole = (
                self.effect(replace(scored, values=values(part * scored.coefficients))) for part in (_LITTLE, 1.0)
            )
        except (Illegal, ParameterError):
            return None
        errors = fit.errors(Point(base.point.theta, (*base.point.effects, little)))
        if errors is None:
            return None
        slope = (errors - base.errors)[fit.rows] / _LITTLE
        p = len(base.point.theta)
        prior = np.r_[np.ones(p), np.full(known.shape[1] - p, 1e-4)]
        answer = -np.linalg.solve(known.T @ known + np.diag(prior), known.T @ slope)
        theta = self.mechanism.clip(base.point.theta + answer[:p] * self.mechanism.deviations)
        return Point(theta, (*base.point.effects, whole))

    def _judged(self, fit, base: Fitted, scored: Scored, fitted: Fitted) -> Trial:
        price = prices.price(scored, fit, fitted)
        gain = base.objective - fitted.objective - price
        return Trial(
            scored.name,
            scored.joint,
            gain,
            self.held_gain(fit, base, fitted, gain),
            fitted,
            price,
            self.implausible(fitted.point.effects[-1]),
        )

    @staticmethod
    def held_gain(fit, base: Fitted, fitted: Fitted, gain: float) -> float:
        """Gain [nat] on the rows kept back; `_UNTOUCHED` of an effect that does not act there."""
        held = fit.held_sum(base.errors) - fit.held_sum(fitted.errors)
        if fit.held_sum(base.errors - fitted.errors) < max(_UNTOUCHED, _UNTOUCHED_SHARE * gain):
            # a limit that was met, or a blow that fell, elsewhere: nothing is said against it here
            held = _UNTOUCHED
        return held

    @staticmethod
    def _best_start(fit, screened: Point, scored: Scored) -> Point:
        """The screened model, its threshold or stiffness the one that fits best of a few: an effect
        that has one acts where that value is, which no slope tells."""
        if not _fixed(scored):
            return screened
        effect, name = screened.effects[-1], next(iter(scored.values))
        spec = next(p for p in effect.kind.parameters if p.name == name)
        best = None
        for share in _STARTS:
            value = min(max(share * effect.values[name], spec.low), spec.high)
            moved = Effect(effect.kind, effect.joint, {**effect.values, name: value})
            point = Point(screened.theta, (*screened.effects[:-1], moved))
            errors = fit.errors(point)
            if errors is not None:
                objective = fit.objective(errors, point)
                if best is None or objective < best[0]:
                    best = objective, point
        return screened if best is None else best[1]

    def polished(self, fit, base: Fitted, raw, known_free, short, trials) -> list[Trial]:
        """Those that are near the best fitted again, with all derivatives about themselves; the
        best by itself only where the rows kept back speak against it as it is.

        raw : derivatives about the base.
        """
        top = max((t.gain for t in trials if t.problem is None), default=0.0)
        if top < _WORTH:
            return trials
        near = sorted((t for t in trials if t.problem is None and t.gain > _NEAR * top), key=lambda t: -t.gain)[
            :_POLISHED
        ]
        if len(near) < 2 and near[0].held_gain > 0.0:
            return trials

        def smooth(scored: Scored, trial: Trial) -> Trial:
            fitted, before = trial.fitted, trial.fitted.objective
            pairs = (*known_free, *fitted.names[len(known_free) :])
            for _ in range(1 if fitted.point.heavy else _POLISHINGS):
                known = fit.white(fit.derivatives(fitted.point, pairs, nearest(base, raw)))
                fitted = fit.from_start(fit.run(fitted.point, (), known=known, known_free=pairs, rounds=3), known)
                if before - fitted.objective < _SMOOTH:
                    break
                before = fitted.objective
            return self._judged(fit, base, scored, fitted)

        return each(lambda pair: smooth(*pair) if pair[1] in near else pair[1], list(zip(short, trials)))

    def free(self, point: Point, keys) -> tuple:
        """All free parameters of the effects of a model."""
        return tuple(
            (number, name) for number, effect in enumerate(point.effects) for name in self.names(effect, effect.values)
        )

    def names(self, effect: Effect, values) -> list[str]:
        """Parameters that are fitted: those of the screening, without structure and without
        what the effect takes from its machine."""
        kind = effect.kind
        names = [name for name in values if _is_fitted(kind.parameter(name))]
        if kind.screening is not None and kind.screening.fitted is not None:
            q = self.problem.sampled.position[:, effect.joint - 1]
            names = kind.screening.fitted(names, effect.values, q.min(), q.max())
        return names

    def effect(self, scored: Scored) -> Effect:
        kind = KINDS[scored.name]
        values = dict(scored.values)
        for p in kind.parameters:
            if p.name in values:
                values[p.name] = min(max(values[p.name], p.low), p.high)
        plant = self.mechanism.plant(self.mechanism.start, (Effect(kind, scored.joint, values),))
        return plant.effects[-1]

    def implausible(self, effect: Effect) -> str | None:
        """Why an effect can be none of this machine, None where it may be one; of other mechanisms
        than the arm no sizes are known, but that a wave has a length within its joint's range."""
        if not self._on_arm():
            return self._no_wave(effect)
        for name, low, high in effect.kind.plausible:
            value = effect.values.get(name)
            if value is None:
                continue
            if value > _BEYOND * high and not effect.kind.parameter(name).inverse:
                return f"{_IMPOSSIBLE}: {name} {value:.3g}, more than any machine has ({high:.3g})"
            if effect.kind.parameter(name).role is Role.RATE and value < low / _BELOW:
                return f"{_IMPOSSIBLE}: {name} {value:.3g}, less than any machine has ({low:.3g})"
        return self._too_small(effect)

    def _no_wave(self, effect: Effect) -> str | None:
        """Why waves over the position are none: they are longer than the joint can go twice."""
        period = effect.values.get("period")
        if period is None:
            return None
        low, high = self.mechanism.ranges[effect.joint - 1]
        far = _BEYOND * (high - low)
        return f"{_IMPOSSIBLE}: period {period:.3g}, more than the joint can go ({far:.3g})" if period > far else None

    @staticmethod
    def _too_small(effect: Effect) -> str | None:
        """Why an effect is less than any machine has, if all of its sizes are."""
        found = None
        for name, low, high in effect.kind.plausible:
            if effect.kind.parameter(name).role is not Role.SIZE:
                continue
            value = abs(effect.values.get(name, np.inf))
            if value >= low / _BELOW:
                return None
            found = f"{_IMPOSSIBLE}: {name} {value:.3g}, less than any machine has ({low:.3g})"
        return found

    def _on_arm(self) -> bool:
        return self.problem.sampled.joints == 3


def _is_fitted(parameter: Parameter) -> bool:
    """Whether a fit moves it: not what the construction gives, nor what the effect takes from its machine."""
    return parameter.role is Role.PLACE or (parameter.role is not Role.STRUCTURE and parameter.from_arm is None)


def nearest(base: Fitted, raw: np.ndarray) -> np.ndarray | None:
    """Derivatives by parameters, about the base of a trial, that may stand for those about the
    trial: from one model of two masses to another they change little."""
    return raw if base.point.heavy else None


def _fixed(scored: Scored) -> bool:
    """Whether a hypothesis has no coefficients: its values are those of a grid."""
    return scored.entry is not None and scored.entry.candidate.fixed


def _lowest(*fits: Fitted | None) -> Fitted | None:
    """The fit with the lowest objective of those that there are."""
    return min((f for f in fits if f is not None), key=lambda f: f.objective, default=None)


def tied(best: Trial, other: Trial) -> bool:
    """Whether the log cannot tell the two apart by evidence."""
    return best.gain - other.gain < max(TIE_NATS, TIE_SHARE * best.gain)
