# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Which effects the log asks for: a short list by screening, the choice by prediction errors.

Forward with swaps and backward elimination (steps 4 to 7). Each stage screens the library twice:
on filtered motion, which is quick, and on innovations, which feedback cannot deceive. The few that
are left are tried in the model one by one (`trials`), in the noise that the best of them leaves;
the gain of log likelihood less the price of their free coefficients ranks them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from puma_sim_core.identify.fitting.prediction import Fitted, Point, PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.refits import Refits
from puma_sim_core.identify.fitting.trials import Trial, Trials, nearest
from puma_sim_core.identify.noise import colour
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.parallel import each
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.search import Search
from puma_sim_core.identify.screening.short_list import ShortList
from puma_sim_core.identify.selection.selected import LEAST_GAIN, Selected, Stage
from puma_sim_core.identify.selection.tidying import EXACT, PARSIMONY, Tidying

#: most effects that are added
MOST_EFFECTS = 4
#: what a gain must exceed the placebos' greatest by: a factor and an addend
PLACEBO_FACTOR, PLACEBO_MARGIN, PLACEBOS = 1.2, 2.0, 24
#: least share of the first effect's gain that counts at a joint: what is not exact there shows
#: elsewhere, too
ELSEWHERE = 0.2
#: least gain [nat] of a name that gives a joint two masses: no placebo goes through the model, and
#: of 510 names of earlier scores the wrong ones of these had 17 to 35 nat, the right ones 165 and
#: more but for one of size 0.55
LEAST_TWO_MASSES = 40.0
#: for how many of the best in the screening, and from which share of the best gain there on, all
#: derivatives are taken anew where a fit does not keep what was promised
_AGAIN, _WORTH_MORE = 4, 0.03
#: most times that derivatives are taken anew at the end
_REFITS = 4
#: share of the squared voltages held out that a model by the noise before may leave of those by the
#: noise after it, in the mean of the joints, to be preferred
_BETTER = 0.97
#: least share of the best gain of what is named in place of the best
_GIVING_WAY = 0.4


class Selection:
    """The choice on one problem."""

    def __init__(
        self, search: Search, predictor: Predictor, library, seed: int, progress: Callable[[str, float], None]
    ):
        self.search = search
        self.problem = search.problem
        self.predictor = predictor
        self.library = library
        self.progress = progress
        self.mechanism = search.problem.mechanism
        self.trials = Trials(predictor, search.problem)
        self.refits = Refits(self.trials, library)
        self.tidying = Tidying(predictor, self.trials, library)
        rng = np.random.default_rng(seed)
        self.shifts = np.sort(rng.uniform(0.06, 0.94, PLACEBOS))

    def run(self, theta: np.ndarray, bank) -> Selected:
        """Add effects until none is asked for; theta, bank: from the screening on filtered
        motion."""
        self.short_list = ShortList(self.search, self.predictor, self.library, bank)
        point = Point(theta, ())
        weighting = self.predictor.white_weighting(self._raw(point))
        keys: tuple = ()
        stages: list[Stage] = []
        retuned = None
        prices: dict = {}
        swapped: dict = {}
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
            point, keys = self.tidying.tidied(point, keys, weighting, stages, prices, swapped)
        point, keys = self.tidying.simplified(point, keys, weighting, stages, prices, swapped)
        return self._finished(retuned, point, keys, stages, weighting, prices, swapped)

    def without(self, selected: Selected, key: tuple) -> Selected:
        """The selection less one effect, fitted again."""
        number = selected.keys.index(key)
        kept = [n for n in range(len(selected.keys)) if n != number]
        keys = tuple(selected.keys[n] for n in kept)
        point = selected.final.point if keys else selected.retuned.point
        point = Point(point.theta, tuple(point.effects[n] for n in kept) if keys else ())
        found = self._finished(
            selected.retuned, point, keys, selected.stages, selected.weighting, selected.prices, selected.swapped
        )
        return replace(found, retracted=(*selected.retracted, key))

    def bare(self, selected: Selected) -> Selected:
        """The selection without any effect."""
        found = self._finished(
            selected.retuned,
            selected.retuned.point,
            (),
            selected.stages,
            selected.weighting,
            selected.prices,
            selected.swapped,
        )
        return replace(found, retracted=(*selected.retracted, *selected.keys))

    def _finished(self, retuned, point, keys, stages, weighting, prices, swapped) -> Selected:
        """The final fit of what was chosen, with derivatives about itself."""
        fit = PredictionFit(self.predictor, weighting)
        pairs = self.trials.free(point, keys)
        final, _ = fit.to_end(point, pairs, gain=0.5, times=_REFITS)
        final = replace(final, jacobian=fit.white(fit.derivatives(final.point, pairs)))
        # the model that was retuned and no more, in the same noise: else two noises are compared
        retuned = final if not keys else fit.to_end(retuned.point, (), gain=0.5, times=_REFITS)[0]
        return Selected(retuned, final, keys, stages, weighting, prices, swapped)

    def _rebased(self, fit, base: Fitted, raw, known_free, trials):
        """Base, its raw derivatives and trials, over the base that the trials' parameters lead to:
        what they gain without the effects that were tried is no gain of those."""
        found = []
        for t in trials:
            if t.fitted is not None:
                point = Point(t.fitted.point.theta, t.fitted.point.effects[:-1])
                errors = fit.errors(point)
                if errors is not None:
                    found.append((fit.objective(errors, point), len(found), point))
        if not found or min(found)[0] >= base.objective:
            return base, raw, trials
        anew, raw = fit.to_end(min(found)[2], known_free, near=raw)
        less = base.objective - anew.objective
        return (
            anew,
            raw,
            [
                t
                if t.fitted is None
                else replace(t, gain=t.gain - less, held_gain=self.trials.held_gain(fit, anew, t.fitted, t.gain))
                for t in trials
            ],
        )

    # one stage

    def stage(self, point, keys, weighting, stages) -> Stage:
        """Screen, and try the short list."""
        fit = PredictionFit(self.predictor, weighting)
        known_free = self.trials.free(point, keys)
        base, raw = fit.to_end(point, known_free)
        known = fit.white(raw)
        causal = CausalScreen(fit, base.point, base.errors, known, self.problem)
        short, screened = self.short_list.of(keys, base.point, causal)
        top = max((s.gain for s in short), default=0.0)
        most = 1 if base.point.heavy else _AGAIN
        far = {
            id(s) for s in sorted(short, key=lambda s: -s.gain)[:most] if s.gain > max(LEAST_GAIN, _WORTH_MORE * top)
        }
        trials = each(lambda s: self.trials.run(fit, base, known, known_free, s, again=id(s) in far), short)
        trials = self.refits.nested(fit, base, raw, known_free, short, trials)
        trials = self.refits.resumed(fit, base, raw, known_free, short, trials, stages)
        base, raw, trials = self._rebased(fit, base, raw, known_free, trials)
        # gains are those in the noise that the best explanation of each joint leaves
        before = fit, base, raw, trials
        weighting = self._noise(base, trials)
        fit = PredictionFit(self.predictor, weighting)
        base, raw = fit.to_end(base.point, known_free, raw)
        known = fit.white(raw)
        trials = each(
            lambda pair: (
                pair[1]
                if pair[1].fitted is None
                else self.trials.run(fit, base, known, known_free, pair[0], pair[1].fitted.point)
            ),
            zip(short, trials),
        )
        if self._moved_away(self._held_volts(*before), self._held_volts(fit, base, raw, trials)):
            # what no effect explains was taken for noise, and the fit has moved away from it
            fit, base, raw, trials = before
            weighting = fit.weighting
        trials = self.refits.revived(fit, base, raw, known_free, short, trials)
        trials = self.trials.polished(fit, base, raw, known_free, short, trials)
        base, raw, trials = self._rebased(fit, base, raw, known_free, trials)
        best = max((t for t in trials if t.problem is None), key=lambda t: t.gain, default=None)
        trials.sort(key=lambda t: -t.gain)
        chance = 0.0
        accepted = None
        if best is not None and best.gain > LEAST_GAIN:
            chance = self._placebo(fit, best, short, nearest(base, raw))
            accepted = self._parsimonious(best, trials)
        threshold = max(LEAST_GAIN, PLACEBO_FACTOR * chance + PLACEBO_MARGIN)
        stage = Stage(
            trials, threshold, base, screened, weighting, None, chance, self._gains(stages[0]) if stages else {}
        )
        # one that does not lower the error on rows kept back gives way to the next that does
        passing = (
            [
                t
                for t in trials
                if t.problem is None
                and t.held_gain > 0.0
                and t.gain
                > max(
                    stage.needed(t.joint),
                    _GIVING_WAY * best.gain,
                    stage.needed_untried(t.joint) if t.untried else 0.0,
                    LEAST_TWO_MASSES if self.library[t.name].two_masses else 0.0,
                )
            ]
            if best
            else []
        )
        if accepted is not None and accepted not in passing:
            accepted = self._parsimonious(passing[0], passing) if passing else None
        stage.accepted = accepted
        return stage

    def _gains(self, stage: Stage) -> dict[int | None, float]:
        """By joint (None: all of them) the gain [nat] of the effect that a stage named."""
        if stage.accepted is None:
            return {}
        rows, total = self.predictor.fit_rows, stage.accepted.gain
        less = 0.5 * np.where(rows, stage.base.errors**2 - stage.accepted.fitted.errors**2, 0.0).sum(axis=0)
        return {None: total, **{j + 1: max(min(gain, total), ELSEWHERE * total) for j, gain in enumerate(less)}}

    @staticmethod
    def _moved_away(before: np.ndarray, after: np.ndarray) -> bool:
        """Whether the voltages held out (J,) [V^2] grew with the other noise: joint by joint, since
        one that neither explains must not speak for the others. Without any, they did not."""
        return bool((after > 0.0).all() and np.mean(before / after) < _BETTER)

    def _held_volts(self, fit, base: Fitted, raw, trials) -> np.ndarray:
        """(J,) sums of squares [V^2] of the voltages that the best model of a pass lacks at the
        rows kept back."""
        best = max((t for t in trials if t.problem is None), key=lambda t: t.gain, default=None)
        point = base.point if best is None or best.gain < 0.0 else best.fitted.point
        volts = self.predictor.in_volts(self._raw(point), self.problem.sampled.cutoffs[1])
        return (np.where(self.predictor.held_rows, volts, 0.0) ** 2).sum(axis=0)

    def _noise(self, base: Fitted, trials) -> Weighting:
        """The weighting by what is left of each joint after the model that explains it best. One
        noise for all from a single best model would take for noise what another joint lacks."""
        rows = self.predictor.fit_rows
        fitted = [base, *(t.fitted for t in trials if t.fitted is not None and t.problem is None)]
        left = np.array([[(f.errors[rows[:, j], j] ** 2).sum() for j in range(rows.shape[1])] for f in fitted])
        found: dict = {}
        errors = np.empty(rows.shape)
        for j, number in enumerate(left.argmin(axis=0)):
            if number not in found:
                found[number] = self._raw(fitted[number].point)
            errors[:, j] = found[number][:, j]
        return colour.weighting(self.predictor, errors)

    # the pieces

    def _raw(self, point: Point) -> np.ndarray:
        return self.predictor.errors(self.mechanism.plant(point.theta, point.effects))

    def _placebo(self, fit, best: Trial, short, near) -> float:
        """Greatest gain of shifted innovations over the short list's own columns."""
        pairs = self.trials.free(best.fitted.point, ())
        known = fit.white(fit.derivatives(best.fitted.point, pairs, near))
        causal = CausalScreen(fit, best.fitted.point, best.fitted.errors, known, self.problem)
        greatest = 0.0
        for s in short:
            kind = self.library[s.name]
            j = None if s.joint is None else s.joint - 1
            got = causal.score(s.name, s.joint, kind.screening.candidates(causal.signals, j), self.shifts)
            if got is not None:
                greatest = max(greatest, float(np.max(got[1])))
        return greatest

    def _parsimonious(self, best: Trial, trials) -> Trial:
        kind = self.library[best.name]
        least = max(EXACT, kind.screening.generous) * best.gain

        def needless(t: Trial) -> bool:
            # what a further coefficient costs is in the gains already
            room = max(PARSIMONY - (best.price - t.price), least)
            return t.gain > best.gain - room or best.vanishing

        simpler = [
            t for t in trials if t.problem is None and t.joint == best.joint and t.name in kind.contains and needless(t)
        ]
        return max(simpler, key=lambda t: t.gain) if simpler else best
