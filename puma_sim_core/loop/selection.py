# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Which effects the log asks for: a short list by screening, the choice by prediction errors.

Forward with swaps and backward elimination (steps 4 to 7). Each stage screens the library twice:
on filtered motion, which is quick and sees everything, and, for what is made of accelerations, on
innovations, which feedback cannot deceive. The few that are left are put into the model one by one
and fitted with all its parameters to the innovations of the log. The gain of log likelihood less
the price of their free coefficients ranks them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects import KINDS, Effect
from ..errors import ParameterError
from .causal import CausalScreen
from .evidence import Scored
from .prediction import Fitted, Point, PredictionFit, Predictor, Weighting
from .search import Search

#: most effects that are added
MOST_EFFECTS = 4
#: least gain [nat] of a name, whatever the placebos say
LEAST_GAIN = 8.0
#: what a gain must exceed the placebos' greatest by: a factor and an addend
PLACEBO_FACTOR, PLACEBO_MARGIN, PLACEBOS = 1.2, 2.0, 24
#: share of the first effect's gain that a further one must reach: below it stands what the
#: model of the first one is not exact in
LEAST_SHARE = 0.015
#: hypotheses of a short list, slow and fast, and their least gain in the screening
_SLOW, _FAST, _LEAST_SCREENED = 8, 4, 2.0
#: gain [nat] that a kind must be better by than one that it contains, and than one it replaces
PARSIMONY, SWAP = 5.0, 3.0
#: a tie: gains closer than this [nat], or than this share of the better one
TIE_NATS, TIE_SHARE = 8.0, 0.003
#: most times that the final model's derivatives are taken anew
_REFITS = 4
#: share of its screened gain that a threshold's fit must reach, else all derivatives are taken anew
_PROMISED = 0.7
#: least share of the best gain of what is named in place of the best
_GIVING_WAY = 0.4
#: shares of a screened threshold that a fit may start from
_STARTS = (0.7, 0.8, 0.87, 0.94, 1.0, 1.07, 1.15, 1.3)
#: change [nat] of the rows kept back below which an effect does not act on them
_UNTOUCHED = 1.5
#: parameters that a screening gives and a fit leaves alone
STRUCTURAL = frozenset({"motor_share", "order", "ratio"})
_STRUCTURAL_OF = {"payload": {"x", "y"}, "backlash": {"stiffness", "damping"}}
#: how far outside its plausible sizes a parameter may come out
_BEYOND = 4.0


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


@dataclass
class Stage:
    """One stage: trials best first, the threshold of a name, the base that gains are over, and what
    the screenings said."""

    trials: list[Trial]
    threshold: float
    base: Fitted
    screened: list[Scored]
    weighting: Weighting
    accepted: Trial | None = None
    placebo: float = 0.0


@dataclass
class Selected:
    """The outcome: retuned model, final model with its free parameters, all stages."""

    retuned: Fitted
    final: Fitted
    keys: tuple
    stages: list[Stage]
    weighting: Weighting
    prices: dict = field(default_factory=dict)


class Selection:
    """The choice on one problem."""

    def __init__(self, search: Search, predictor: Predictor, library, seed: int,
                 progress: Callable[[str, float], None]):
        self.search = search
        self.problem = search.problem
        self.predictor = predictor
        self.library = library
        self.progress = progress
        self.mechanism = search.problem.mechanism
        rng = np.random.default_rng(seed)
        self.shifts = np.sort(rng.uniform(0.06, 0.94, PLACEBOS))

    def run(self, theta: np.ndarray, bank) -> Selected:
        """Add effects until none is asked for; theta, bank: from the screening on filtered
        motion."""
        self.bank = bank
        point = Point(theta, ())
        weighting = self.predictor.white_weighting(self._raw(point))
        keys: tuple = ()
        stages: list[Stage] = []
        retuned = None
        prices: dict = {}
        while len(keys) <= MOST_EFFECTS:
            self.progress("fitting", 0.25 + 0.6 * len(keys) / (MOST_EFFECTS + 1))
            stage = self.stage(point, keys, weighting, stages)
            stages.append(stage)
            if retuned is None:
                retuned = stage.base
            if stage.accepted is None or len(keys) == MOST_EFFECTS:
                point = stage.base.point
                weighting = stage.weighting
                break
            keys = (*keys, stage.accepted.key)
            prices[stage.accepted.key] = stage.accepted.price
            point = stage.accepted.fitted.point
            weighting = stage.weighting
            point, keys = self.tidied(point, keys, weighting, stages, prices)
        fit = PredictionFit(self.predictor, weighting)
        pairs = self.free(point, keys)
        known = fit.white(fit.derivatives(point, pairs))
        # without any effect the retuned model is the final one
        final = fit.run(point, (), known=known, known_free=pairs, rounds=4 if keys else 0)
        for _ in range(_REFITS if keys else 0):
            before = final.objective
            known = fit.white(fit.derivatives(final.point, pairs))
            final = fit.run(final.point, (), known=known, known_free=pairs, rounds=4)
            if before - final.objective < 0.5:
                break
        final = replace(final, jacobian=fit.white(fit.derivatives(final.point, pairs)))
        return Selected(retuned, final, keys, stages, weighting, prices)

    # one stage

    def stage(self, point, keys, weighting, stages) -> Stage:
        """Screen, and try the short list."""
        fit = PredictionFit(self.predictor, weighting)
        known_free = self.free(point, keys)
        raw = fit.derivatives(point, known_free)
        known = fit.white(raw)
        base = fit.run(point, (), known=known, known_free=known_free)
        causal = CausalScreen(fit, base.point, base.errors, known, self.problem)
        slow = self._slow(keys, base)
        fast = self._fast(causal, keys)
        short = slow[:_SLOW] + fast[:_FAST]
        trials = [self.trial(fit, base, known, known_free, s) for s in short]
        trials = [t for t in trials if t is not None]
        best = max((t for t in trials if t.problem is None), key=lambda t: t.gain, default=None)
        if best is not None and best.gain > 2.0:
            # gains are those in the noise that the best explanation leaves
            weighting = self.predictor.weighting(self._raw(best.fitted.point))
            fit = PredictionFit(self.predictor, weighting)
            known = fit.white(raw)
            base = fit.run(base.point, (), known=known, known_free=known_free)
            starts = {t.key: t.fitted.point.effects[-1] for t in trials if t.fitted is not None}
            kept = [s for s in short if (s.name, s.joint) in starts]
            trials = [self.trial(fit, base, known, known_free, s, starts[s.name, s.joint])
                      for s in kept]
            trials = [t for t in trials if t is not None]
            best = max((t for t in trials if t.problem is None), key=lambda t: t.gain,
                       default=None)
        else:
            weighting = self.predictor.weighting(self._raw(base.point))
            fit = PredictionFit(self.predictor, weighting)
        trials.sort(key=lambda t: -t.gain)
        chance = 0.0
        accepted = None
        if best is not None and best.gain > LEAST_GAIN:
            chance = self._placebo(fit, best, short)
            accepted = self._parsimonious(best, trials)
        threshold = max(LEAST_GAIN, PLACEBO_FACTOR * chance + PLACEBO_MARGIN)
        if stages and stages[0].accepted is not None:
            threshold = max(threshold, LEAST_SHARE * stages[0].accepted.gain)
        # one that does not lower the error on rows kept back gives way to the next that does
        passing = [t for t in trials if t.problem is None and t.held_gain > 0.0
                   and t.gain > max(threshold, _GIVING_WAY * best.gain)] if best else []
        if accepted is not None and accepted not in passing:
            accepted = self._parsimonious(passing[0], passing) if passing else None
        screened = sorted(slow + fast, key=lambda s: -s.gain)
        return Stage(trials, threshold, base, screened, weighting, accepted, chance)

    def trial(self, fit, base: Fitted, known, known_free, scored: Scored, start=None
              ) -> Trial | None:
        """A hypothesis in the model, fitted with all that is free."""
        try:
            effect = start or self._effect(scored)
        except ParameterError as problem:
            return Trial(scored.name, scored.joint, 0.0, 0.0, None, scored.price, str(problem))
        number = len(base.point.effects)
        if start is None and scored.entry is not None and scored.entry.candidate.fixed:
            effect = self._best_start(fit, base, effect, next(iter(scored.values)))
        point = Point(base.point.theta, (*base.point.effects, effect))
        free = [(number, name) for name in self._names(effect, scored.values)]
        fitted = fit.run(point, free, known=known, known_free=known_free, rounds=5)
        if fitted is None:
            return None
        if (start is None and scored.entry is not None
                and (scored.joint is None or scored.entry.candidate.fixed)
                and base.objective - fitted.objective < _PROMISED * scored.gain):
            # where a limit holds, or a load has stretched all parameters, these act otherwise
            # than the model without the effect says
            starts = [fitted.point]
            if scored.joint is None:
                starts.append(Point(self.mechanism.start, point.effects))
            again = [fit.run(at, (*known_free, *free), rounds=3) for at in starts]
            fitted = min((f for f in (fitted, *again) if f is not None),
                         key=lambda f: f.objective)
        gain = base.objective - fitted.objective - max(scored.price, 0.0)
        held = fit.held_sum(base.errors) - fit.held_sum(fitted.errors)
        if fit.held_sum(base.errors - fitted.errors) < _UNTOUCHED:
            # a limit that was met, or a blow that fell, elsewhere: nothing is said against it here
            held = max(held, _UNTOUCHED)
        return Trial(scored.name, scored.joint, gain, held, fitted, max(scored.price, 0.0),
                     self._implausible(fitted.point.effects[-1]))

    def _best_start(self, fit, base: Fitted, effect: Effect, name: str) -> Effect:
        """The effect with the value of a threshold or a stiffness that fits best of a few: it acts
        where that value is, which no slope tells."""
        spec = next(p for p in effect.kind.parameters if p.name == name)
        best = None
        for share in _STARTS:
            value = min(max(share * effect.values[name], spec.low), spec.high)
            moved = Effect(effect.kind, effect.joint, {**effect.values, name: value})
            errors = fit.errors(Point(base.point.theta, (*base.point.effects, moved)))
            if errors is not None:
                objective = fit.objective(errors, base.point.theta)
                if best is None or objective < best[0]:
                    best = objective, moved
        return effect if best is None else best[1]

    def tidied(self, point, keys, weighting, stages, prices):
        """Effects that the later ones made needless are taken out, or replaced by a rival."""
        fit = PredictionFit(self.predictor, weighting)
        for number in range(len(keys) - 1):
            rest = tuple(k for n, k in enumerate(keys) if n != number)
            without = Point(point.theta, tuple(e for n, e in enumerate(point.effects)
                                               if n != number))
            pairs = self.free(point, keys)
            known = fit.white(fit.derivatives(point, pairs))
            full = fit.run(point, (), known=known, known_free=pairs)
            p = known.shape[1]
            own = [k for k, (n, _) in enumerate(self.free(point, keys)) if n == number]
            first = len(point.theta)
            columns = [c for c in range(p) if c - first not in own]
            free = self.free(without, rest)
            bare = fit.run(without, (), known=known[:, columns], known_free=free, rounds=4)
            if bare is None:
                continue
            if bare.objective - full.objective - prices.get(keys[number], 0.0) < LEAST_GAIN:
                return self.tidied(bare.point, rest, weighting, stages, prices)
            best = None
            for rival in self._rivals(stages, keys[number], keys):
                effect = rival.fitted.point.effects[-1]
                moved = Point(bare.point.theta, (*bare.point.effects, effect))
                names = [(len(rest), name) for name in self._names(effect, effect.values)]
                tried = fit.run(moved, names, known=known[:, columns], known_free=free, rounds=4)
                if tried is None or self._implausible(tried.point.effects[-1]):
                    continue
                gain = full.objective - tried.objective - rival.price + prices.get(
                    keys[number], 0.0)
                if gain > SWAP and (best is None or gain > best[0]):
                    best = gain, rival, tried
            if best is not None:
                _, rival, tried = best
                prices[rival.key] = rival.price
                return tried.point, (*rest, rival.key)
        return point, keys

    # the pieces

    def free(self, point: Point, keys) -> tuple:
        """All free parameters of the effects of a model."""
        return tuple((number, name) for number, effect in enumerate(point.effects)
                     for name in self._names(effect, effect.values))

    def _names(self, effect: Effect, values) -> list[str]:
        """Parameters that are fitted: those of the screening, without structure and without
        what the effect takes from its machine."""
        taken = {p.name for p in effect.kind.parameters if p.from_arm is not None}
        keep = {"soft_stop": {"lower", "upper"}, "payload": set()}.get(effect.kind.name, set())
        held = STRUCTURAL | _STRUCTURAL_OF.get(effect.kind.name, set())
        names = [name for name in values if name not in held]
        names = [name for name in names if name not in taken or name in keep]
        if effect.kind.name == "soft_stop":
            names = [n for n in names if n == "stiffness" or self._stop_is_touched(effect, n)]
        return names

    def _stop_is_touched(self, effect, name) -> bool:
        q = self.problem.sampled.position[:, effect.joint - 1]
        if name == "lower":
            return effect.values["lower"] > q.min()
        return name == "upper" and effect.values["upper"] < q.max()

    def _effect(self, scored: Scored) -> Effect:
        kind = KINDS[scored.name]
        values = dict(scored.values)
        for p in kind.parameters:
            if p.name in values:
                values[p.name] = min(max(values[p.name], p.low), p.high)
        plant = self.mechanism.plant(self.mechanism.start, (Effect(kind, scored.joint, values),))
        return plant.effects[-1]

    def _implausible(self, effect: Effect) -> str | None:
        screening = effect.kind.screening
        for name, low, high in screening.plausible:
            value = effect.values.get(name)
            if value is None or not self._on_arm():
                continue
            if value > _BEYOND * high:
                return f"{name} {value:.3g}, more than any machine has ({high:.3g})"
            if name in ("velocity", "stiffness") and value < low / _BEYOND:
                return f"{name} {value:.3g}, less than any machine has ({low:.3g})"
        return None

    def _on_arm(self) -> bool:
        return self.problem.sampled.joints == 3

    def _raw(self, point: Point) -> np.ndarray:
        return self.predictor.errors(self.mechanism.plant(point.theta, point.effects))

    def _slow(self, keys, base: Fitted) -> list[Scored]:
        linear = self.problem.linear(base.point.theta, base.point.effects)
        stage = self.search.stage(linear, (), self.bank)
        return [s for s in stage.scores if s.values is not None and s.gain > _LEAST_SCREENED
                and (s.name, s.joint) not in keys]

    def _fast(self, causal: CausalScreen, keys) -> list[Scored]:
        found = []
        for name, kind in self.library.items():
            if not kind.screening.fast:
                continue
            for j in ([None] if not kind.per_joint else range(causal.J)):
                joint = None if j is None else j + 1
                if (name, joint) in keys:
                    continue
                scored = causal.score(name, joint, kind.screening.candidates(causal.signals, j))
                if scored is not None and scored.values is not None \
                        and scored.gain > _LEAST_SCREENED:
                    found.append(scored)
        return sorted(found, key=lambda s: -s.gain)

    def _placebo(self, fit, best: Trial, short) -> float:
        """Greatest gain of shifted innovations over the short list's own columns."""
        pairs = self.free(best.fitted.point, ())
        known = fit.white(fit.derivatives(best.fitted.point, pairs))
        causal = CausalScreen(fit, best.fitted.point, best.fitted.errors, known, self.problem)
        greatest = 0.0
        for s in short:
            kind = self.library[s.name]
            j = None if s.joint is None else s.joint - 1
            got = causal.score(s.name, s.joint, kind.screening.candidates(causal.signals, j),
                               self.shifts)
            if got is not None:
                greatest = max(greatest, float(np.max(got[1])))
        return greatest

    def _parsimonious(self, best: Trial, trials) -> Trial:
        contained = self.library[best.name].screening.contains
        simpler = [t for t in trials if t.problem is None and t.joint == best.joint
                   and t.name in contained and t.gain > best.gain - PARSIMONY]
        return max(simpler, key=lambda t: t.gain) if simpler else best

    def _rivals(self, stages, key, keys) -> list[Trial]:
        for stage in stages:
            if stage.accepted is not None and stage.accepted.key == key:
                return [t for t in stage.trials if t.key != key and t.key not in keys
                        and t.fitted is not None and t.problem is None
                        and t.gain > 0.5 * stage.accepted.gain][:3]
        return []


def tied(best: Trial, other: Trial) -> bool:
    """Whether the log cannot tell the two apart by evidence."""
    return best.gain - other.gain < max(TIE_NATS, TIE_SHARE * best.gain)
