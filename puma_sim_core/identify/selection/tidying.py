# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Effects that were chosen, seen again with the later ones in the model: backward elimination,
rivals, and kinds that contain one another (steps 5 and 6)."""

from __future__ import annotations

from puma_sim_core.effects import Effect
from puma_sim_core.identify.fitting.prediction import Fitted, Point, PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.fitting.trials import Trial, Trials
from puma_sim_core.identify.selection.selected import LEAST_GAIN, Stage, entered

#: gain [nat] that a kind must be better by than one that it contains, the difference of their
#: prices included, and than one it replaces
PARSIMONY, SWAP = 1.5, 3.0
#: share of a gain to which fits are exact at best: it counts in a log without noise
EXACT = 1e-4
#: share of its gain from which on a rival is tried in the place of an effect, and how many
_RIVAL, _RIVALS = 0.5, 3
#: difference [nat] between what two trials promised and what their fits come to, from which on they
#: count as unfinished
_UNFINISHED = 3.0


class Tidying:
    """Sees to the chosen effects of one problem.

    library : name -> kind. In the methods: keys are the (name, joint) of the effects of a point,
    stages the `Stage` of all so far; prices and swapped, those of `Selected`, are kept up.
    """

    def __init__(self, predictor: Predictor, trials: Trials, library):
        self.predictor = predictor
        self.trials = trials
        self.library = library

    def tidied(self, point, keys, weighting, stages, prices, swapped):
        """Effects that the later ones made needless are taken out, or replaced by a rival; prices
        and `Selected.swapped` are kept up."""
        fit = PredictionFit(self.predictor, weighting)
        for number in range(len(keys) - 1):
            rest = tuple(k for n, k in enumerate(keys) if n != number)
            without = Point(point.theta, tuple(e for n, e in enumerate(point.effects) if n != number))
            pairs = self.trials.free(point, keys)
            known = fit.white(fit.derivatives(point, pairs))
            full = fit.run(point, (), known=known, known_free=pairs)
            p = known.shape[1]
            own = [k for k, (n, _) in enumerate(self.trials.free(point, keys)) if n == number]
            first = len(point.theta)
            columns = [c for c in range(p) if c - first not in own]
            free = self.trials.free(without, rest)
            bare = fit.run(without, (), known=known[:, columns], known_free=free, rounds=4)
            if bare is None:
                continue
            if bare.objective - full.objective - prices.get(keys[number], 0.0) < LEAST_GAIN:
                return self.tidied(bare.point, rest, weighting, stages, prices, swapped)
            best = None
            for rival in self._rivals(stages, keys[number], keys):
                effect = rival.fitted.point.effects[-1]
                moved = Point(bare.point.theta, (*bare.point.effects, effect))
                names = [(len(rest), name) for name in self.trials.names(effect, effect.values)]
                tried = fit.run(moved, names, known=known[:, columns], known_free=free, rounds=4)
                if tried is None or self.trials.implausible(tried.point.effects[-1]):
                    continue
                gain = full.objective - tried.objective - rival.price + prices.get(keys[number], 0.0)
                if gain > SWAP and (best is None or gain > best[0]):
                    best = gain, rival, tried
            if best is not None:
                _, rival, tried = best
                prices[rival.key] = rival.price
                swapped[rival.key] = (entered(stages, keys[number]), bare.objective - tried.objective - rival.price)
                return tried.point, (*rest, rival.key)
        return point, keys

    def simplified(self, point, keys, weighting, stages, prices, swapped):
        """Effects that come out as a kind that they contain, with all others in the model, are
        replaced by it: when they were tried, its fit may not have come to its end. Where that
        shows, the other kinds that contain it are fitted to their end, too."""
        fit = PredictionFit(self.predictor, weighting)
        for number, key in enumerate(keys):
            contained = self._contained(stages, key, keys)
            if not contained:
                continue

            def exact(about: Point, trial: Trial, effect: Effect) -> tuple[Fitted, Trial]:
                others = (*keys[:number], trial.key, *keys[number + 1 :])
                at = Point(about.theta, (*about.effects[:number], effect, *about.effects[number + 1 :]))
                return fit.to_end(at, self.trials.free(at, others))[0], trial

            stage = entered(stages, key)
            own = next(t for t in stage.trials if t.key == key)
            first = best = exact(point, own, point.effects[number])
            full = first[0].point
            # from what was tried, and with what the two have in common as it is now
            simpler = min(
                (
                    exact(full, t, effect)
                    for t in contained
                    for effect in (t.fitted.point.effects[-1], _alike(t.fitted.point.effects[-1], full.effects[number]))
                ),
                key=lambda pair: pair[0].objective,
            )
            promised = own.gain + own.price - simpler[1].gain - simpler[1].price
            if abs(simpler[0].objective - first[0].objective - promised) > _UNFINISHED:
                others = (exact(full, t, t.fitted.point.effects[-1]) for t in self._containing(stage, simpler[1], keys))
                best = min(
                    (first, *(pair for pair in others if not self.trials.implausible(pair[0].point.effects[number]))),
                    key=lambda pair: pair[0].objective + pair[1].price,
                )
            gain = stage.accepted.gain
            lost = simpler[0].objective - best[0].objective
            less = best[1].price - simpler[1].price
            chosen = simpler if lost < max(PARSIMONY, less + EXACT * gain) else best
            if chosen is first:
                continue
            fitted, trial = chosen
            prices[trial.key] = trial.price
            swapped[trial.key] = stage, (gain + first[0].objective - fitted.objective + own.price - trial.price)
            point, keys = fitted.point, (*keys[:number], trial.key, *keys[number + 1 :])
        return point, keys

    def _contained(self, stages, key, keys) -> list[Trial]:
        """Trials, beside the one by which an effect entered, of the kinds that it contains."""
        stage, kind = entered(stages, key), self.library[key[0]]
        if stage is None or kind.screening.generous:
            return []
        return [
            t
            for t in stage.trials
            if t.joint == key[1]
            and t.name in kind.contains
            and t.key not in keys
            and t.fitted is not None
            and t.problem is None
        ]

    def _containing(self, stage: Stage, simpler: Trial, keys) -> list[Trial]:
        """Trials of a stage, on the joint of a simpler one, of the kinds that contain it."""
        return [
            t
            for t in stage.trials
            if t.joint == simpler.joint
            and t.key not in keys
            and simpler.name in self.library[t.name].contains
            and t.fitted is not None
            and t.problem is None
        ]

    def _rivals(self, stages, key, keys) -> list[Trial]:
        """Trials beside the one by which an effect entered that may take its place: the best, and
        those that contain it."""
        stage = entered(stages, key)
        if stage is None:
            return []
        near = [
            t
            for t in stage.trials
            if t.key != key
            and t.key not in keys
            and t.fitted is not None
            and t.problem is None
            and t.gain > _RIVAL * stage.accepted.gain
        ]
        return [
            t
            for n, t in enumerate(near)
            if n < _RIVALS or (t.joint == key[1] and key[0] in self.library[t.name].contains)
        ]


def _alike(effect: Effect, other: Effect) -> Effect:
    """An effect with the values of those parameters that it shares with another."""
    own = {p.name: p for p in effect.kind.parameters}
    shared = {
        name: min(max(value, own[name].low), own[name].high)
        for name, value in other.values.items()
        if name in effect.values
    }
    return Effect(effect.kind, effect.joint, {**effect.values, **shared})
