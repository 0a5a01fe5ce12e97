# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Which effects the log asks for: forward selection with replacements and backward elimination.

A stage is a list of passes, `Selection.stage`; each takes a `SelectionState` and gives another one. It screens the
library on filtered motion, which is quick, and on innovations, which feedback cannot deceive. The few that are left are
fitted in the model (`fitting.trials`), and ranked by their gain of log likelihood less the Occam factor.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from puma_sim_core.effects import Kind
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting.dispersion import blocks, clearly_better, dispersion, errors_between
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.fitting.trials import Trials, unseen
from puma_sim_core.identify.memory import release
from puma_sim_core.identify.noise import innovations
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.parallel import parallel_map
from puma_sim_core.identify.screening.causal import CausalScreen, placebo_shifts
from puma_sim_core.identify.screening.elsewhere import level_elsewhere
from puma_sim_core.identify.screening.evidence import Key
from puma_sim_core.identify.screening.hypotheses import hypotheses, open_to
from puma_sim_core.identify.screening.short_list import ShortList
from puma_sim_core.identify.screening.surrogates import level
from puma_sim_core.identify.selection.asked import asked_for, in_both, passes
from puma_sim_core.identify.selection.elimination import Elimination
from puma_sim_core.identify.selection.noise_choice import (
    least_of_joints,
    least_variances,
    noise_refused,
    squares_of_pieces,
)
from puma_sim_core.identify.selection.refits import Refits
from puma_sim_core.identify.selection.state import Chosen, SelectionState, Stage, Threshold
from puma_sim_core.identify.settings import SELECTION

#: one step of the selection
Pass = Callable[[SelectionState], SelectionState]


class Selection:
    """The selection on one problem. library : name -> effect; seed : of the placebos; progress : as for `explain`."""

    def __init__(
        self,
        short_list: ShortList,
        trials: Trials,
        library: Mapping[str, Kind],
        seed: int,
        progress: Callable[[str, float], None],
    ):
        self.short_list = short_list
        self.trials = trials
        self.problem = trials.problem
        self.predictor = trials.predictor
        self.mechanism = trials.mechanism
        self.library = library
        self.progress = progress
        self.shifts = placebo_shifts(seed)
        refits, self.elimination = Refits(trials, library), Elimination(trials, library)
        #: one stage: what the log asks for beside the effects that are chosen already
        self.stage: tuple[Pass, ...] = (
            self.fit_model,
            self.try_short_list,
            refits.from_innovations,
            refits.from_levels,
            self.try_richer,
            refits.related,
            refits.from_previous,
            refits.rebased,
            refits.from_base,
            refits.from_nominal,
            refits.rebased,
            self.estimate_noise,
            refits.from_usual,
            refits.polished,
            refits.related,
            refits.rebased,
            self.compare_elsewhere,
            self.decide,
        )
        #: after a stage that accepted an effect
        self.addition: tuple[Pass, ...] = (self.add, self.elimination.eliminate)
        #: after the last stage
        self.conclusion: tuple[Pass, ...] = (
            self.elimination.simplify,
            self.elimination.exchange,
            self.elimination.confirm,
            self.finish,
            self.withdraw,
        )

    def run(self, theta: Floats) -> SelectionState:
        """Add effects until none is asked for. theta : parameters by the screening of filtered motion.

        Where an accepted effect came to values that no machine has, and nothing took its place, the stage that accepted
        it is made again without it: what stood behind it there may be what the log asks for.
        """
        state, before = self._start(theta), list[SelectionState]()
        while True:
            self.progress("fitting", 0.25 + 0.6 * len(state.chosen) / (SELECTION.most_effects + 1))
            stages, start = len(state.history), state
            state = _through(self.stage, state)
            more = self._added(state)
            before += [start] * (len((more or state).history) - stages)
            if more is not None:
                state = more
                continue
            ended = _through(self.conclusion, state)
            wrong = dict(ended.barred[len(state.barred) :])
            choices = [stage.accepted is not None and stage.accepted.key in wrong for stage in state.history]
            if not any(choices):
                return ended
            state = replace(before[choices.index(True)], barred=ended.barred)
            del before[len(state.history) :]

    def _added(self, state: SelectionState) -> SelectionState | None:
        """The state with what its last stage accepted, else with a pair; None without either."""
        if len(state.chosen) == SELECTION.most_effects:
            return None
        return self._paired(state) if state.history[-1].accepted is None else _through(self.addition, state)

    def _paired(self, state: SelectionState) -> SelectionState | None:
        """The state with two more effects, of which its last stage accepted none: each is asked for beside the other.

        The best trial of the stage is put into the model, and a stage is made beside it. What that accepts may show
        that the first one is asked for as well.
        """
        last = state.history[-1]
        first = next((t for t in last.trials if t.possible and t.gain > SELECTION.worth_pairing), None)
        if first is None or len(state.chosen) > SELECTION.most_effects - 2:
            return None
        accepting = replace(last, accepted=first, unclear=last.unclear - {first.key})
        ahead = self.add(replace(state, history=(*state.history[:-1], accepting)))
        ahead = _through(self.stage, ahead)
        second = ahead.history[-1].accepted
        if second is None:
            return None
        both = _through(self.addition, ahead)
        if first.key in both.keys and len(both.chosen) >= len(state.chosen) + 2:
            gain = self.elimination.gain_beside(both, first.key)
            # the second without the first may have ended in a local minimum, with less than it had by itself
            alone = max((t.gain for t in last.trials if t.key == second.key and not t.impossible), default=-np.inf)
            if gain is not None and (gain := min(gain, first.gain + second.gain - alone)) > last.needed(first):
                chosen = tuple(replace(c, gain=gain) if c.key == first.key else c for c in both.chosen)
                return replace(both, chosen=chosen)
        return self._rubbing(state, ahead.history[-1])

    def _rubbing(self, state: SelectionState, beside: Stage) -> SelectionState | None:
        """The state with the first dry friction of a joint, which a stage asked for beside what may not be named.

        All but every drive has that friction. The other effect may be what is missing, or stand for what is: friction
        is there with either, if it is better than none by itself as well. Its evidence is that beside the other, which
        has nearly all the weight in an average over the models with and without that.
        """
        last, found = state.history[-1], beside.accepted
        if found is None or not last.threshold.rubs(found.key):
            return None
        alone = next((t for t in last.trials if t.key == found.key and t.possible and t.gain > 0.0), None)
        if alone is None:
            return None
        accepting = replace(last, accepted=replace(alone, gain=found.gain))
        return self.add(replace(state, history=(*state.history[:-1], accepting)))

    def without(self, state: SelectionState, *keys: Key) -> SelectionState:
        """The selection less some effects, fitted again."""
        left = [n for n, key in enumerate(state.keys) if key not in keys]
        model = state.model if left or state.retuned is None else state.retuned
        point = Point(model.point.theta, tuple(model.point.effects[n] for n in left))
        less = replace(
            state,
            model=replace(model, point=point),
            chosen=tuple(state.chosen[n] for n in left),
            retracted=(*state.retracted, *keys),
        )
        return _through((self.finish, self.withdraw), less)

    # passes

    def fit_model(self, state: SelectionState) -> SelectionState:
        """Fit the model in the present noise."""
        point = state.model.point
        model, jacobian = PredictionFit(self.predictor, state.noise).to_end(point, self.trials.free(point))
        return replace(state, model=model, jacobian=jacobian)

    def try_short_list(self, state: SelectionState) -> SelectionState:
        """Screen the library, and fit what is worth it in the model."""
        base = self.trials.base(state.model, state.noise, state.derivatives)
        causal = CausalScreen(base.fit, base.model.point, base.model.errors, base.jacobian, self.problem)
        short = self.short_list.of(state.keys, base.model.point, causal)
        least = max(SELECTION.least_gain, SELECTION.relinearised_share * max((s.gain for s in short), default=0.0))
        most = SELECTION.relinearised_two_mass if base.model.point.two_mass else SELECTION.relinearised
        best = {id(s) for s in sorted(short, key=lambda s: -s.gain)[:most] if s.gain > least}
        # what was not screened has no gain to be sorted by
        best |= {id(s) for s in short if unseen(s)}
        trials = parallel_map(lambda s: self.trials.run(base, s, again=id(s) in best), short)
        return replace(state, trials=tuple(trials))

    def try_richer(self, state: SelectionState) -> SelectionState:
        """Try what contains the best trials, where the screening of these had no part of what they gain."""
        taken = {*state.keys, *(t.key for t in state.trials)}
        asked = self.short_list.richer({t.key: t.gain for t in state.trials if t.possible}, taken)
        if not asked:
            return state
        base = self.trials.base(state.model, state.noise, state.derivatives)
        causal = CausalScreen(base.fit, base.model.point, base.model.errors, base.jacobian, self.problem)
        scored = [found for kind, joint in asked if (found := causal.score(kind, joint)) and found.values is not None]
        return replace(state, trials=(*state.trials, *parallel_map(lambda s: self.trials.run(base, s), scored)))

    def estimate_noise(self, state: SelectionState) -> SelectionState:
        """Fit all again in the noise that the best explanation of each joint leaves, unless the validation refuses."""
        after = self._in_noise(state, self._noise(state))
        if not noise_refused(self._validation_volts(state), self._validation_volts(after)):
            return replace(after, doubted=None)
        # its spectrum is refused; the noise that stays is no smaller than what the best explanations leave in it
        left = [state.model.errors, *(t.model.errors for t in state.trials if t.explains)]
        larger = least_variances(left, self.predictor.noisy_rows, blocks(self.predictor))
        if (larger <= 1.0).all():
            return replace(state, doubted=after)
        scale = state.noise.scale * np.sqrt(np.maximum(larger, 1.0))
        return replace(self._in_noise(state, replace(state.noise, scale=scale)), doubted=after)

    def compare_elsewhere(self, state: SelectionState) -> SelectionState:
        """Say of effects that are placed where most is left, such as a push, whether they stand out in the log."""
        return replace(state, trials=tuple(self._beside_elsewhere(state, t) for t in state.trials))

    def decide(self, state: SelectionState) -> SelectionState:
        """End the stage with the effect that the log asks for, if there is one."""
        threshold, trials = self._threshold(state), state.trials
        if state.doubted is not None:
            # a row noise that is no more than the changes from row to row makes much of what repeats, such as the
            # steps of an encoder: where the other noise is refused, a gain must hold in both
            trials, threshold = in_both(trials, threshold, state.doubted.trials, self._threshold(state.doubted))
        barred = dict(state.barred)
        trials = tuple(replace(t, problem=t.problem or barred.get(t.key)) for t in trials)
        trials = tuple(sorted(trials, key=lambda t: -t.gain))
        doubted = state.doubted is not None
        state = replace(state, trials=trials, retuned=state.retuned or state.model, doubted=None)
        best, accepted = state.best, None
        if best is not None and best.gain > SELECTION.least_gain:
            accepted = self._parsimonious(best, trials)
        unclear = frozenset(t.key for t in trials if t.possible and not self._beside(state, t))
        stage = Stage(trials, threshold, state.model, None, doubted, unclear)
        if accepted is not None and best is not None:
            # one that does not lower the error on the validation set is replaced by the next that does
            passing = [t for t in trials if passes(t, stage) and self._in_place(t, best)]
            if accepted not in passing:
                accepted = self._parsimonious(passing[0], passing) if passing else None
            if accepted is not None:
                accepted = self._common(accepted, passing)
        if accepted is None:
            accepted = self._first_friction(stage)
        wrong = (t for t in trials if t.impossible and t.gain > SELECTION.least_gain)
        refuting = next((t for t in wrong if asked_for(t, stage) and self._beside(state, t)), None)
        return replace(state, history=(*state.history, replace(stage, accepted=accepted, refuting=refuting)))

    def add(self, state: SelectionState) -> SelectionState:
        """Put the accepted effect into the model."""
        accepted = state.history[-1].accepted
        assert accepted is not None
        chosen = Chosen.of(accepted, state.history)
        return replace(state, model=accepted.model, jacobian=None, chosen=(*state.chosen, chosen))

    def finish(self, state: SelectionState) -> SelectionState:
        """Fit what was chosen to its end with derivatives about itself; the model without effects in the same noise."""
        state = state.numbered
        fit, point = PredictionFit(self.predictor, state.noise), state.model.point
        pairs = self.trials.free(point)
        model, jacobian = fit.to_last(point, pairs)
        model, retuned = replace(model, jacobian=fit.whitened(jacobian)), model
        if state.chosen and state.retuned is not None:
            retuned, _ = fit.to_last(state.retuned.point, ())
        return replace(state, model=model, jacobian=jacobian, retuned=retuned, trials=())

    def withdraw(self, state: SelectionState) -> SelectionState:
        """Take out effects that the last fit brought to values of no machine, and fit the others again. A pass."""
        kept = self.elimination.withdraw(state)
        return state if kept is state else self.withdraw(self.finish(kept))

    # what the passes are made of

    def _start(self, theta: Floats) -> SelectionState:
        """The model without effects, weighted by its changes from row to row alone."""
        point = Point(theta, ())
        raw = self._raw(point)
        noise = self.predictor.unfiltered_weighting(raw)
        errors = noise(raw)
        objective = PredictionFit(self.predictor, noise).objective(errors, point)
        return SelectionState(Fitted(point, errors, objective, ()), None, noise)

    def _raw(self, point: Point) -> Floats:
        return self.predictor.errors(point.plant(self.mechanism))

    def _validation_volts(self, state: SelectionState) -> Floats:
        """(k, J) mean squares [V^2] of the voltages that a state lacks on pieces of the validation set: those of its
        model, or of its best trial where that lacks less of a joint.

        A trial may gain most in a noise that is too small, and predict worse than the model that the stage may keep.
        """
        best, p = state.best, self.predictor
        points = [state.model.point] + ([] if best is None or best.gain < 0.0 else [best.model.point])
        rows, cutoff = np.asarray(p.validation_rows.all(axis=1)), self.problem.sampled.cutoffs[1]
        return least_of_joints(
            [squares_of_pieces(p.in_volts(self._raw(point), cutoff), rows, p.step) for point in points]
        )

    def _noise(self, state: SelectionState) -> Weighting:
        """The weighting by what is left of each joint after the model that explains that joint best."""
        rows = self.predictor.fit_rows
        fitted = [state.model, *(t.model for t in state.trials if t.explains)]
        left = np.array([[(f.errors[rows[:, j], j] ** 2).sum() for j in range(rows.shape[1])] for f in fitted])
        numbers = left.argmin(axis=0)
        found = {number: self._raw(fitted[number].point) for number in dict.fromkeys(numbers.tolist())}
        errors = np.column_stack([found[number][:, j] for j, number in enumerate(numbers.tolist())])
        return innovations.weighting(self.predictor, errors)

    def _in_noise(self, state: SelectionState, noise: Weighting) -> SelectionState:
        """The model and the trials of a stage, fitted on in another noise."""
        before = state.model
        model, jacobian = PredictionFit(self.predictor, noise).to_end(before.point, before.names, state.jacobian)
        base = self.trials.base(model, noise, jacobian)
        trials = parallel_map(
            lambda t: t if t.fitted is None else self.trials.run(base, t.scored, t.fitted.point), state.trials
        )
        return replace(state, model=model, jacobian=jacobian, noise=noise, trials=tuple(trials))

    def _threshold(self, state: SelectionState) -> Threshold:
        """What a name needs in the noise of a state, by what chance gives."""
        best = state.best
        if best is None or not (best.gain > SELECTION.least_gain or self._may_rub(state)):
            return Threshold.alike(SELECTION.least_gain)
        screen, least = self._screen(state, best.model), SELECTION.least_gain
        if state.chosen:
            # beside an effect, what that one misfits counts as well; the first one takes up misfit itself
            least *= dispersion(self.predictor, screen.jacobian, screen.errors, len(screen.point.theta))
        chance = self._chance(state, screen)
        # the first dry friction of a joint, beside other effects, is compared in the direction of its own (`_beside`)
        return Threshold(
            dry=max(SELECTION.least_dry, chance.dry),
            varying=max(SELECTION.least_gain, chance.varying),
            other=max(least, chance.other),
            rubbing=state.rubbing,
            placed=least,
        )

    def _may_rub(self, state: SelectionState) -> bool:
        """Whether a trial may be the first dry friction of its joint, in a form that contains no other."""
        plain = (t for t in state.trials if self.library[t.name].dry and not self.library[t.name].contains)
        return any(t.possible and t.gain > SELECTION.least_dry and t.joint not in state.rubbing for t in plain)

    def _beside_elsewhere(self, state: SelectionState, trial: Trial) -> Trial:
        kind, joint = self.library[trial.name], trial.joint
        placed = kind.screening is not None and kind.screening.placed and joint is not None
        if not placed or not trial.possible or trial.gain <= SELECTION.least_gain:
            return trial
        assert joint is not None
        pieces = blocks(self.predictor, SELECTION.elsewhere_piece)
        needed = level_elsewhere(self._screen(state, trial.model), kind, joint, pieces)
        if trial.gain > needed:
            return trial
        return replace(trial, problem=f"in some other part of the log one would have as much ({needed:.3g} nat)")

    def _screen(self, state: SelectionState, model: Fitted) -> CausalScreen:
        """The screening about a model of a stage."""
        fit = PredictionFit(self.predictor, state.noise)
        jacobian = fit.whitened(fit.derivatives(model.point, self.trials.free(model.point), state.nearby))
        return CausalScreen(fit, model.point, model.errors, jacobian, self.problem)

    def _chance(self, state: SelectionState, causal: CausalScreen) -> Threshold:
        """What the shifted innovations of a screen exceed by chance, over all that the short list is taken of: each of
        the two kinds of effects has half of the probability. Dry friction that is common is a false alarm only on a
        joint without any, and has its half on such joints. Shifted innovations have the bumps of those that are not, so
        that they say nothing of what is placed by these."""
        placebos = causal.placebos(self.shifts)
        gains: dict[bool, list[Floats]] = {True: [], False: []}
        for kind, joint in hypotheses(self.library.values(), self.mechanism):
            assert kind.screening is not None
            if open_to(kind, joint, state.keys) and not kind.screening.placed:
                gains[kind.dry].append(placebos.gains(causal.pairs(kind, joint)))

        def reached(dry: bool, odds: float = 0.0) -> float:
            probability = 0.5 * SELECTION.surrogate_level * (1.0 + odds)
            return level(np.max(gains[dry], axis=0), probability) if gains[dry] else 0.0

        return Threshold(reached(True, SELECTION.dry_odds), reached(False), varying=reached(True))

    def _beside(self, state: SelectionState, trial: Trial) -> bool:
        """Whether a trial is better than the model without it by what a name needs of standard errors."""
        rubs = self.library[trial.name].dry and trial.joint not in state.rubbing
        if rubs and not state.chosen and trial.gain > SELECTION.least_gain:
            return True
        least = SELECTION.dry_errors if rubs else SELECTION.name_errors
        return errors_between(self.predictor, trial.model, state.model) > least

    def _common(self, accepted: Trial, passing: Sequence[Trial]) -> Trial:
        """Dry friction of the same joint, if what was accepted is not clearly better: all but every drive has it.
        A push is no rival: it stands out beside friction as well."""
        screening = self.library[accepted.name].screening
        if self.library[accepted.name].dry or (screening is not None and screening.placed):
            return accepted
        dry = [t for t in passing if self.library[t.name].dry and t.joint == accepted.joint]
        alike = [t for t in dry if not clearly_better(self.predictor, accepted.model, t.model)]
        return self._parsimonious(max(alike, key=lambda t: t.gain), alike) if alike else accepted

    def _first_friction(self, stage: Stage) -> Trial | None:
        """The first dry friction of a joint that a stage asks for, whatever else gains more and may not be named."""
        passing = [t for t in stage.trials if stage.threshold.rubs(t.key) and passes(t, stage)]
        return self._parsimonious(passing[0], passing) if passing else None

    def _in_place(self, trial: Trial, best: Trial) -> bool:
        """Whether a trial may take the place of the best of a stage: what that contains, or gains nearly as much."""
        part = trial.joint == best.joint and trial.name in self.library[best.name].contains
        return part or trial.gain > SELECTION.replacement_share * best.gain

    def _parsimonious(self, best: Trial, trials: Iterable[Trial]) -> Trial:
        """The best trial, or the next on its joint that contains the same, if it is clearly better than all that it
        contains; else the best of these."""
        own = [t for t in trials if t.possible and t.joint == best.joint]
        contained = set(self.library[best.name].contains)
        alike = (t for t in own if t.name in contained or contained & set(self.library[t.name].contains))
        asked = (t for t in (best, *alike) if t.gain <= best.gain and not any(self._enough(c, t) for c in own))
        return max(asked, key=lambda t: t.gain, default=best)

    def _enough(self, simple: Trial, rich: Trial) -> bool:
        """Whether one trial is among those that another contains, and not clearly worse."""
        kind = self.library[rich.name]
        if simple.name not in kind.contains:
            return False
        assert kind.screening is not None
        least = max(SELECTION.exact, kind.screening.generous) * rich.gain
        hardly = simple.gain > rich.gain - least or rich.vanishing
        return hardly or not clearly_better(self.predictor, rich.model, simple.model)


def _through(steps: Iterable[Pass], state: SelectionState) -> SelectionState:
    """A state after passes, one by one."""
    for step in steps:
        state = step(state)
        release()
    return state
