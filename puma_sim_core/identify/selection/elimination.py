# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Backward elimination: chosen effects, fitted again with the later ones in the model."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import reduce
from typing import NamedTuple, TypeVar

import numpy as np

from puma_sim_core.effects import Effect, Kind
from puma_sim_core.effects.base import Parameter, Role
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.fitting.dispersion import clearly_better, dispersion, errors_between
from puma_sim_core.identify.fitting.point import Point, bounded
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit, Slopes
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.evidence import Key
from puma_sim_core.identify.selection.state import Chosen, SelectionState, Stage, accepting
from puma_sim_core.identify.settings import SELECTION

Item = TypeVar("Item")


class _Compared(NamedTuple):
    """The model with an effect and without it; others : derivatives about the model by all else; dispersion : what a
    nat of the fit must be divided by (`fitting.dispersion`)."""

    full: Fitted
    bare: Fitted
    others: Slopes
    dispersion: float

    @property
    def gain(self) -> float:
        """Gain of log likelihood by the effect [nat]."""
        return self.bare.objective - self.full.objective


class Elimination:
    """Removes and replaces chosen effects of one problem. library : name -> effect."""

    def __init__(self, trials: Trials, library: Mapping[str, Kind]):
        self.predictor = trials.predictor
        self.trials = trials
        self.library = library

    def eliminate(self, state: SelectionState) -> SelectionState:
        """Remove effects that the later ones made needless, or replace one by a rival. A pass."""
        for number in range(len(state.chosen) - 1):
            changed = self._without_or_replaced(state, number)
            if changed is not None:
                return changed
        return state

    def simplify(self, state: SelectionState) -> SelectionState:
        """Replace effects that come out as one that they contain, whose fit may not have ended when tried. A pass."""
        return reduce(self._simplified, range(len(state.chosen)), state)

    def exchange(self, state: SelectionState) -> SelectionState:
        """Put rivals in the place of effects that they are clearly better than beside the others: where these are not
        those that the effect was chosen beside, it may have been right beside them alone. A pass."""
        for number in range(len(state.chosen)):
            changed = self._exchanged(state, number)
            if changed is not None:
                return self.exchange(changed)
        return state

    def withdraw(self, state: SelectionState) -> SelectionState:
        """Take out effects of which no machine has the values that the model has come to: a trial's fit need not have
        ended. What the log asks for and no machine has refutes that nothing is missing. A pass."""
        fit = PredictionFit(self.predictor, state.noise)
        for number in range(len(state.chosen)):
            problem = self.trials.problem_of(fit, state.model, number)
            if problem is not None:
                gone = replace(state.chosen[number].trial, problem=problem)
                history = tuple(stage.less(gone) for stage in state.history)
                # nor may it be tied with one that stays
                chosen = tuple(replace(c, stage=c.stage.less(gone)) for c in state.chosen)
                return self.withdraw(self._withdrawn(replace(state, history=history, chosen=chosen), number, problem))
        return state

    def _withdrawn(self, state: SelectionState, number: int, problem: str) -> SelectionState:
        """The state with another effect in the place of one, the best that the log asks for of those that it contains
        and of those that it may have made needless; else without it, and with it barred for the problem."""
        fit, chosen, point = PredictionFit(self.predictor, state.noise), state.chosen[number], state.model.point
        at = Point(point.theta, _less(point.effects, number))
        model, _ = fit.to_end(at, self.trials.free(at))
        tried = [*self._simpler(state, number, point.effects[number]), *self._removed(state, number)]
        found = [self._ended(state, point, number, trial, effect) for trial, effect in tried]
        for fitted, trial in sorted(found, key=_cost):
            gain = model.objective - fitted.objective - trial.occam
            own = Chosen.of(trial, state.history, chosen.stage, gain)
            simple = replace(state, model=fitted, jacobian=None, chosen=_placed(state.chosen, number, own))
            compared = self._compared(simple, number)
            if compared is not None and self._asked_for(simple, own, compared):
                return simple
        barred = (*state.barred, (chosen.key, problem))
        return replace(state, model=model, jacobian=None, chosen=_less(state.chosen, number), barred=barred)

    def confirm(self, state: SelectionState) -> SelectionState:
        """Remove effects that were accepted beside a noise that was refused and that the present noise does not ask
        for; the others have no more than their gain in it. A pass."""
        kept = list(state.chosen)
        for number, chosen in enumerate(state.chosen):
            found = self._compared(state, number) if chosen.stage.doubted else None
            if found is None:
                continue
            gain = found.gain - chosen.occam
            if not self._asked_for(state, chosen, found):
                rest = _less(state.chosen, number)
                return self.confirm(replace(state, model=found.bare, jacobian=None, chosen=rest))
            kept[number] = replace(chosen, gain=min(chosen.gain, gain))
        return replace(state, chosen=tuple(kept))

    def gain_beside(self, state: SelectionState, key: Key) -> float | None:
        """Gain of log evidence [nat] by an effect of the model beside the others, None where the log does not ask for
        it."""
        number = state.keys.index(key)
        found = self._compared(state, number)
        if found is None or not self._asked_for(state, state.chosen[number], found):
            return None
        return found.gain - state.chosen[number].occam

    def _compared(self, state: SelectionState, number: int) -> _Compared | None:
        """The model of a state with and without one of its effects; None where either cannot be fitted."""
        fit, point = PredictionFit(self.predictor, state.noise), state.model.point
        pairs = self.trials.free(point)
        jacobian = fit.whitened(fit.derivatives(point, pairs))
        full = fit.run(point, (), jacobian=Slopes.of(jacobian), frozen=pairs)
        without = Point(point.theta, _less(point.effects, number))
        first = len(point.theta)
        own = [first + k for k, (n, _) in enumerate(pairs) if n == number]
        others = Slopes.of(np.delete(jacobian, own, axis=1))
        # what contains it may be a small part beside it, from which no few steps lead to the whole
        taken_up = _taken_up(point.effects[number], without.effects)
        start = fit.best_of([without, *(Point(point.theta, effects) for effects in taken_up)])
        bare = None if start is None else fit.run(start, (), jacobian=others, frozen=self.trials.free(start))
        if bare is None or full is None:
            return None
        scatter = dispersion(self.predictor, jacobian, full.errors, len(point.theta))
        return _Compared(full, bare, others, scatter)

    def _without_or_replaced(self, state: SelectionState, number: int) -> SelectionState | None:
        """The state without one of its effects, or with a rival in its place; None where it stays."""
        fit, chosen, rest = (
            PredictionFit(self.predictor, state.noise),
            state.chosen[number],
            _less(state.chosen, number),
        )
        found = self._compared(state, number)
        if found is None:
            return None
        full, bare, others, scatter = found
        # a stop that the fit moved beyond the motion keeps its column
        frozen = bare.names
        if not self._asked_for(state, chosen, found):
            return self.eliminate(replace(state, model=bare, jacobian=None, chosen=rest))
        best: tuple[float, Trial, Fitted] | None = None
        rivals = self._rivals(state, chosen.key)
        causal = CausalScreen(fit, bare.point, bare.errors, others.jacobian, self.trials.problem) if rivals else None
        for rival in rivals:
            # beside what was found later, another of its forms may be the right one
            effects = [rival.effect, *self._screened_again(causal, rival)]
            moved = fit.best_of(Point(bare.point.theta, (*bare.point.effects, effect)) for effect in effects)
            if moved is None:
                continue
            effect = moved.effects[-1]
            free = [(len(rest), name) for name in self.trials.names(effect, effect.values)]
            tried = fit.run(moved, free, jacobian=others, frozen=frozen)
            if tried is None or self.trials.problem_of(fit, tried, len(rest)):
                continue
            gain = full.objective - tried.objective - rival.occam + chosen.occam
            if gain <= SELECTION.replacement_gain * scatter or (best is not None and gain <= best[0]):
                continue
            alike = self._contains(rival, chosen.key[0]) or self._rarer(rival, chosen.key[0])
            if not alike or clearly_better(self.predictor, tried, full):
                best = gain, rival, tried
        if best is None:
            return None
        _, rival, tried = best
        # derivatives about the model with the effect may not lead to the end of the one without it
        ended, _ = fit.to_end(bare.point, frozen)
        gain = min(bare.objective, ended.objective) - tried.objective - rival.occam
        new = Chosen.of(rival, state.history, accepting(state.history, chosen.key), gain)
        return replace(state, model=tried, jacobian=None, chosen=(*rest, new))

    def _screened_again(self, causal: CausalScreen | None, rival: Trial) -> list[Effect]:
        """The effect of a rival by a screening about another model, where that has one."""
        kind = self.library[rival.name]
        scored = None if causal is None or kind.two_masses else causal.score(kind, rival.joint)
        if scored is None or scored.values is None:
            return []
        try:
            return [self.trials.effect(scored)]
        except ParameterError:
            return []

    def _simplified(self, state: SelectionState, number: int) -> SelectionState:
        """The state with the simpler of an effect and those that it contains."""
        contained = self._contained(state, number)
        if not contained:
            return state
        chosen, start, stage = state.chosen[number], state.model.point, state.chosen[number].stage
        own = chosen.tried
        first = best = self._ended(state, start, number, own, start.effects[number])
        full = first[0].point
        starts = self._simpler(state, number, full.effects[number])
        simpler = min((self._ended(state, full, number, *pair) for pair in starts), key=lambda pair: pair[0].objective)
        promised = own.gain + own.occam - simpler[1].gain - simpler[1].occam
        if abs(simpler[0].objective - first[0].objective - promised) > SELECTION.unfinished:
            alike = (t for t in _open(stage, state) if t.joint == simpler[1].joint)
            richer = (t for t in alike if self._contains(t, simpler[1].name))
            others = [self._ended(state, full, number, t, t.effect) for t in richer]
            fit = PredictionFit(self.predictor, state.noise)
            possible = (pair for pair in others if not self.trials.problem_of(fit, pair[0], number))
            rival = min(possible, key=_cost, default=first)
            # as of any rival: a coin would not turn out the same in another log
            best = rival if _cost(rival) < _cost(first) - SELECTION.replacement_gain else first
        lost = simpler[0].objective - best[0].objective
        hardly = lost < best[1].occam - simpler[1].occam + SELECTION.exact * chosen.gain
        fitted, trial = simpler if hardly or not clearly_better(self.predictor, best[0], simpler[0]) else best
        if trial is own:
            return state
        gain = chosen.gain + first[0].objective - fitted.objective + own.occam - trial.occam
        new = Chosen.of(trial, state.history, stage, gain)
        return replace(state, model=fitted, jacobian=None, chosen=_placed(state.chosen, number, new))

    def _exchanged(self, state: SelectionState, number: int) -> SelectionState | None:
        """The state with the best rival of one of its effects in the place of that, if it is clearly better."""
        fit, chosen, point = PredictionFit(self.predictor, state.noise), state.chosen[number], state.model.point
        rivals = self._rivals(state, chosen.key)
        if {(e.kind.name, e.joint) for e in chosen.stage.base.point.effects} == {*_less(state.keys, number)}:
            # they were compared there, but the fit of what contains it need not have ended
            rivals = self._seen_beside(state, [t for t in rivals if self._contains(t, chosen.key[0])])
        if not rivals:
            return None
        own = self._ended(state, point, number, chosen.tried, point.effects[number])
        near = fit.derivatives(point, self.trials.free(point))
        found = list[tuple[Fitted, Trial]]()
        for rival in rivals:
            at = fit.best_of([Point(point.theta, _placed(point.effects, number, rival.effect))])
            if at is not None:
                fitted, _ = fit.to_end(at, self.trials.free(at), near=near, patient=not at.two_mass)
                found.append((fitted, rival))
        possible = [pair for pair in found if not self.trials.problem_of(fit, pair[0], number)]
        fitted, trial = best = min(possible, key=_cost, default=own)
        gain = _cost(own) - _cost(best)
        # one that contains it is it and something more, which needs what a name does
        least = SELECTION.least_gain if self._contains(trial, chosen.key[0]) else SELECTION.replacement_gain
        least *= dispersion(self.predictor, own[0].slopes, own[0].errors, len(point.theta))
        if gain <= least or not clearly_better(self.predictor, fitted, own[0]):
            return None
        # the page says how far each of them is from the one that it names
        ended = {t.key: (_cost(own) - _cost((f, t)), f.with_last(number)) for f, t in [own, *possible]}
        stage = chosen.stage.ended(chosen.gain, chosen.key, ended, trial.key)
        new = Chosen.of(trial, state.history, stage, chosen.gain + gain)
        return replace(state, model=fitted, jacobian=None, chosen=_placed(state.chosen, number, new))

    def _seen_beside(self, state: SelectionState, trials: list[Trial]) -> list[Trial]:
        """Those that a screening about the model sees as much of as a name needs."""
        own = [t for t in trials if not self.library[t.name].two_masses]
        if not own:
            return []
        fit, model = PredictionFit(self.predictor, state.noise), state.model
        columns = fit.whitened(fit.derivatives(model.point, self.trials.free(model.point), state.nearby))
        causal = CausalScreen(fit, model.point, model.errors, columns, self.trials.problem)
        scored = [(t, causal.score(self.library[t.name], t.joint)) for t in own]
        return [t for t, seen in scored if seen is not None and seen.gain > SELECTION.least_gain]

    def _ended(
        self, state: SelectionState, about: Point, number: int, trial: Trial, effect: Effect
    ) -> tuple[Fitted, Trial]:
        """A trial, and the model about a point with the effect in the place of one of its own, fitted to its end."""
        at = Point(about.theta, _placed(about.effects, number, effect))
        return PredictionFit(self.predictor, state.noise).to_end(at, self.trials.free(at))[0], trial

    def _simpler(self, state: SelectionState, number: int, effect: Effect) -> Iterator[tuple[Trial, Effect]]:
        """Trials of what an effect of the model contains, with where to begin: what was tried, and what the two have in
        common as it is now."""
        for trial in self._contained(state, number):
            yield trial, trial.effect
            yield trial, _alike(trial.effect, effect)

    def _removed(self, state: SelectionState, number: int) -> Iterator[tuple[Trial, Effect]]:
        """Trials, on the joint of an effect of the model, that were accepted and that later ones made needless."""
        gone = (*state.keys, *state.retracted)
        for stage in state.history:
            trial = stage.accepted
            if trial is not None and trial.joint == state.keys[number][1] and trial.key not in gone:
                yield trial, trial.effect

    def _contained(self, state: SelectionState, number: int) -> list[Trial]:
        """Trials, beside the one of an effect, of the effects that it contains."""
        (name, joint), stage = state.keys[number], state.chosen[number].stage
        kind = self.library[name]
        if kind.screening is None or kind.screening.generous:
            return []
        return [t for t in _open(stage, state) if t.joint == joint and t.name in kind.contains]

    def _rivals(self, state: SelectionState, key: Key) -> list[Trial]:
        """Trials that may take the place of an accepted effect: the best, and those that contain it."""
        stage = accepting(state.history, key)
        if stage is None or stage.accepted is None:
            return []
        near = [t for t in _open(stage, state) if t.gain > SELECTION.least_gain]
        return [
            t for n, t in enumerate(near) if n < SELECTION.rivals or (t.joint == key[1] and self._contains(t, key[0]))
        ]

    def _asked_for(self, state: SelectionState, chosen: Chosen, found: _Compared) -> bool:
        """Whether the log asks for an effect beside the others: by what all of them misfit, and by what they misfit in
        the direction of the model without it; for the only dry friction of a joint, which all but every drive has, by
        the latter."""
        rubbing = [key for key in state.keys if self.library[key[0]].dry and key[1] == chosen.key[1]]
        only = rubbing == [chosen.key]
        least, errors = SELECTION.least_gain, SELECTION.dry_errors if only else SELECTION.name_errors
        if not only:
            least *= found.dispersion
        elif chosen.gain < least:
            least = chosen.stage.threshold.of(chosen.key)
        if found.gain - chosen.occam < least:
            return False
        return errors_between(self.predictor, found.full, found.bare) > errors

    def _contains(self, trial: Trial, name: str) -> bool:
        """Whether the effect of a trial contains another one."""
        return name in self.library[trial.name].contains

    def _rarer(self, trial: Trial, name: str) -> bool:
        """Whether another effect is dry friction, which all but every drive has, and that of a trial is not."""
        return self.library[name].dry and not self.library[trial.name].dry


def _cost(pair: tuple[Fitted, Trial]) -> float:
    """Objective and Occam factor [nat] of a fit and the trial that it is of."""
    return pair[0].objective + pair[1].occam


def _open(stage: Stage, state: SelectionState) -> list[Trial]:
    """Trials of a stage that may be named and are not in the model."""
    return [t for t in state.others(stage) if t.possible]


def _less(items: tuple[Item, ...], number: int) -> tuple[Item, ...]:
    """All items but one."""
    return (*items[:number], *items[number + 1 :])


def _placed(items: tuple[Item, ...], number: int, item: Item) -> tuple[Item, ...]:
    """All items, one of them replaced."""
    return (*items[:number], item, *items[number + 1 :])


def _taken_up(gone: Effect, effects: tuple[Effect, ...]) -> Iterator[tuple[Effect, ...]]:
    """The effects, where one contains another of its joint: that one's size is added to one of its own, or to all."""
    for number, effect in enumerate(effects):
        if effect.joint != gone.joint or gone.kind.name not in effect.kind.contains:
            continue
        for size in _sizes(gone):
            alike = [p.name for p in _sizes(effect) if p.unit == size.unit]
            for names in [*([name] for name in alike), alike]:
                more = {name: effect.values[name] + gone.values[size.name] for name in names}
                whole = bounded(effect.kind, effect.joint, {**effect.values, **more})
                yield _placed(effects, number, whole)


def _sizes(effect: Effect) -> list[Parameter]:
    return [p for p in effect.kind.parameters if p.role is Role.SIZE]


def _alike(effect: Effect, other: Effect) -> Effect:
    """An effect with the values of those parameters that it shares with another."""
    shared = {name: value for name, value in other.values.items() if name in effect.values}
    return bounded(effect.kind, effect.joint, {**effect.values, **shared})
