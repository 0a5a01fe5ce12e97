# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Trials whose fit ended in a local minimum, fitted again from where a better one is (multi-start).

Each method is a pass: it takes a state of the selection and gives one with other trials.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from puma_sim_core.effects import Effect, Kind
from puma_sim_core.effects.base import Parameter, Role
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.fitting.point import Point, bounded
from puma_sim_core.identify.fitting.prediction import Fitted, PredictionFit
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.fitting.trials import Trials, fixed
from puma_sim_core.identify.parallel import parallel_map
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.selection.state import SelectionState
from puma_sim_core.identify.settings import FITTING, SELECTION


class Refits:
    """Fits trials of one problem again. library : name -> effect."""

    def __init__(self, trials: Trials, library: Mapping[str, Kind]):
        self.trials = trials
        self.predictor = trials.predictor
        self.library = library

    def from_innovations(self, state: SelectionState) -> SelectionState:
        """Where a missing effect has stretched the parameters, the trial of which the innovations show most starts from
        their values as well: about such parameters the residual of the filtered motion says little, and what it gives
        may be far from where the effect is. With two masses it would take too long."""
        if state.model.point.two_mass or not state.model.point.stretched(self.predictor.mechanism):
            return state
        base = self.trials.base(state.model, state.noise, state.derivatives)
        causal = CausalScreen(base.fit, base.model.point, base.model.errors, base.jacobian, self.trials.problem)
        kinds = {t.key: self.library[t.name] for t in state.trials}
        scored = (causal.score(kind, key[1]) for key, kind in kinds.items() if not kind.two_masses)
        most = max((s for s in scored if s is not None and s.values is not None), key=lambda s: s.gain, default=None)

        def again(trial: Trial) -> Trial:
            if most is None or trial.key != most.key or most.values == trial.scored.values:
                return trial
            return max(trial, self.trials.run(base, most, again=True), key=lambda t: t.gain)

        return _with_trials(state, again)

    def related(self, state: SelectionState) -> SelectionState:
        """Trials of effects that contain one another start from each other (`from_nested`, `from_containing`), until
        none gains by that: one that was fitted on from a richer one may be ahead of that, or of a third."""
        for _ in range(SELECTION.related_rounds):
            found = self.from_containing(self.from_nested(state))
            gained = (a.gain - b.gain for a, b in zip(found.trials, state.trials))
            state = found
            if not any(gain > SELECTION.polished for gain in gained):
                break
        return state

    def from_nested(self, state: SelectionState) -> SelectionState:
        """Trials that fit worse than an effect that they contain start from the parameters of that one, with their own
        size or about its size, whichever fits best there."""
        fit = PredictionFit(self.predictor, state.noise)

        def again(trial: Trial) -> Trial:
            simpler = self._simpler(trial, state.trials)
            if trial.fitted is None or simpler is None or trial.fitted.objective <= simpler.objective:
                return trial
            *others, last = trial.fitted.point.effects
            own, inner = _sizes(last), _sizes(simpler.point.effects[-1])
            ratios = [inner[unit] / own[unit] for unit in own if unit in inner and own[unit] > 0.0]
            shares = [share * ratios[0] for share in SELECTION.size_shares] if ratios else []
            points = [Point(simpler.point.theta, (*others, _of_size(last, share))) for share in (1.0, *shares)]
            start = fit.best_of(points)
            return trial if start is None else self._better(state, trial, simpler.point, start)

        return _with_trials(state, again)

    def from_containing(self, state: SelectionState) -> SelectionState:
        """A trial of an effect starts from one that contains it, with the values of that, where it is better there."""
        fit = PredictionFit(self.predictor, state.noise)

        def again(trial: Trial) -> Trial:
            own = [t for t in state.trials if t.fitted is not None and t.joint == trial.joint]
            richer = [t for t in own if trial.name in self.library[t.name].contains]
            if trial.fitted is None or not richer:
                return trial
            rich = min(richer, key=lambda t: t.model.objective).model
            if rich.objective >= trial.fitted.objective:
                return trial
            *others, last = rich.point.effects
            sizes = (bounded(trial.effect.kind, trial.joint, values) for values in _levels(trial.effect, last))
            start = fit.best_of(Point(rich.point.theta, (*others, effect)) for effect in sizes)
            if start is None or (errors := fit.errors(start)) is None:
                return trial
            if fit.objective(errors, start) >= trial.fitted.objective:
                return trial
            return self._better(state, trial, Point(start.theta, tuple(others)), start)

        return _with_trials(state, again)

    def from_nominal(self, state: SelectionState) -> SelectionState:
        """The best trials start from the nominal parameters as well, where a missing effect has
        stretched those of the model: what it took up keeps a trial of that effect in a local minimum.

        So do those of which the screening saw most, of the trials that gain less than it saw: the best by their gain
        may all be the model without their effect at other parameters, and no fit about stretched ones keeps what is
        seen of an effect that these took up. And so do those whose values no slope leads to, such as limits, that fit
        better than none at the nominal parameters, and those that would be the best but for values that no machine has:
        about stretched parameters a fit may run away.
        """
        if not state.model.point.stretched(self.predictor.mechanism):
            return state
        possible = [t for t in state.trials if t.explains]
        best = sorted(possible, key=lambda t: -t.gain)[: SELECTION.most_polished] + _run_away(state.trials)
        share = SELECTION.relinearised_share * max((t.scored.gain for t in possible), default=0.0)
        seen = max(SELECTION.least_gain, share)
        behind = (t for t in possible if t not in best and t.gain < t.scored.gain > seen)
        best += sorted(behind, key=lambda t: -t.scored.gain)[: SELECTION.most_polished]
        fit, start = PredictionFit(self.predictor, state.noise), self.predictor.mechanism.start
        best += self._seen_at_nominal(fit, [t for t in state.trials if t.fitted is not None and t not in best])

        def again(trial: Trial) -> Trial:
            # derivatives of two masses take long
            if trial not in best or trial.model.point.two_mass:
                return trial
            # a limit of the current and the torque constant scale each other: the level is that of other parameters
            sized = self.trials.sized(Point(start, trial.model.point.effects), trial.scored)
            at = fit.best_of(sized)
            if at is None:
                return trial
            try:
                found, _ = fit.to_end(at, trial.model.names, patient=True)
            except ParameterError:
                return trial
            return max(trial, self.trials.judged(fit, state.model, trial.scored, found), key=lambda t: t.gain)

        return _with_trials(state, again)

    def _seen_at_nominal(self, fit: PredictionFit, trials: list[Trial]) -> list[Trial]:
        """Of trials that no screening saw, or whose values no slope leads to, such as limits that ran away, the best of
        those that fit better than none at the nominal parameters."""
        start, found = self.predictor.mechanism.start, list[tuple[float, Trial]]()
        # derivatives of two masses take long
        tried = [t for t in trials if fixed(t.scored) and not t.model.point.two_mass]
        none = fit.lowest_of(Point(start, t.model.point.effects[:-1]) for t in tried[:1])
        for trial in tried:
            best = fit.lowest_of(self.trials.sized(Point(start, trial.model.point.effects), trial.scored))
            if best is not None and (none is None or best[1] < none[1] - SELECTION.least_gain):
                found.append((best[1], trial))
        return [trial for _, trial in sorted(found, key=lambda each: each[0])[: SELECTION.most_polished]]

    def from_levels(self, state: SelectionState) -> SelectionState:
        """Trials of what all but every drive has that gain less than a name needs start from the levels that machines
        have as well.

        The model may have taken dry friction up, so that the screening sees next to nothing of it; or the screened
        level holds the joint, and nothing moves for any slope to see. With two masses it would take too long.
        """
        if state.model.point.two_mass:
            return state
        base = self.trials.base(state.model, state.noise, state.derivatives)

        def again(trial: Trial) -> Trial:
            screening = self.library[trial.name].screening
            common = None if screening is None else screening.common
            if common is None or trial.joint is None or trial.gain >= SELECTION.least_gain:
                return trial
            values = common(float(self.predictor.mechanism.torque_scale[trial.joint - 1]))
            start = self.trials.best_level(base, trial.scored, values)
            if start is None:
                return trial
            number = len(start.effects) - 1
            free = ((number, name) for name in self.trials.names(start.effects[number], values))
            found = base.fit.run(start, (*state.model.names, *free), rounds=FITTING.relinearised_rounds)
            if found is None:
                return trial
            return max(trial, self.trials.judged(base.fit, base.model, trial.scored, found), key=lambda t: t.gain)

        return _with_trials(state, again)

    def from_previous(self, state: SelectionState) -> SelectionState:
        """Trials that gain less than in the stage before, on another joint than what was accepted there, start from
        where they were then: a limit acts where its value is, and the screening may have it where nothing shows."""
        accepted = state.history[-1].accepted if state.history else None
        if accepted is None:
            return state
        base, others = state.model.point, (t for t in state.history[-1].trials if t.joint != accepted.joint)
        before = {t.key: t for t in others if t.problem is None and t.gain > SELECTION.least_gain}

        def again(trial: Trial) -> Trial:
            then = before.get(trial.key)
            if then is None or trial.gain >= then.gain:
                return trial
            theta = then.model.point.theta
            start = Point(theta, (*base.effects, then.effect))
            return self._better(state, trial, Point(theta, base.effects), start)

        return _with_trials(state, again)

    def from_usual(self, state: SelectionState) -> SelectionState:
        """Trials that came out as no more than an effect that they contain start from that one, with a shape as
        machines have it, the best of several."""
        fit = PredictionFit(self.predictor, state.noise)

        def again(trial: Trial) -> Trial:
            screening = self.library[trial.name].screening
            usual = None if screening is None else screening.usual
            simpler = self._simpler(trial, state.trials)
            if usual is None or trial.fitted is None or simpler is None:
                return trial
            if trial.fitted.objective < simpler.objective - SELECTION.no_more:
                return trial
            *others, inner = simpler.point.effects
            last, theta = trial.effect, simpler.point.theta
            shapes = usual(inner.values["torque"])
            shaped = (Effect(last.kind, last.joint, {**last.values, **shape}) for shape in shapes)
            start = fit.best_of(Point(theta, (*others, effect)) for effect in shaped)
            return trial if start is None else self._better(state, trial, Point(theta, tuple(others)), start)

        return _with_trials(state, again)

    def polished(self, state: SelectionState) -> SelectionState:
        """The best trial and those near it are fitted to their end, with all derivatives about themselves.

        Which of them is the best is known then alone. A fit that has not ended misfits in its own direction, and lacks
        the standard errors of a name for it.
        """
        possible = [t for t in state.trials if t.explains]
        top = max((t.gain for t in possible), default=0.0)
        if top < SELECTION.worth_polishing:
            return state
        near = sorted((t for t in possible if t.gain > SELECTION.near_best * top), key=lambda t: -t.gain)
        near = near[: SELECTION.most_polished]
        fit = PredictionFit(self.predictor, state.noise)
        first = len(state.model.names)

        def polish(trial: Trial) -> Trial:
            if trial not in near:
                return trial
            fitted, before = trial.model, trial.model.objective
            pairs = (*state.model.names, *fitted.names[first:])
            for _ in range(1 if fitted.point.two_mass else SELECTION.polishings):
                raw = fit.derivatives(fitted.point, pairs, state.nearby)
                fitted = fit.linear(fitted.point, pairs, raw, rounds=SELECTION.polishing_rounds)
                if before - fitted.objective < SELECTION.polished:
                    break
                before = fitted.objective
            return self.trials.judged(fit, state.model, trial.scored, fitted)

        return _with_trials(state, polish)

    def rebased(self, state: SelectionState) -> SelectionState:
        """The model is fitted on from where the trials' parameters lead to, where that is better: what they gain
        without the effects that were tried is no gain of those."""
        fit = PredictionFit(self.predictor, state.noise)
        found: list[tuple[float, int, Point]] = []
        for t in state.trials:
            if t.fitted is not None:
                point = Point(t.fitted.point.theta, t.fitted.point.effects[:-1])
                errors = fit.errors(point)
                if errors is not None:
                    found.append((fit.objective(errors, point), len(found), point))
        if not found or min(found)[0] >= state.model.objective:
            return state
        model, jacobian = fit.to_end(min(found)[2], state.model.names, near=state.jacobian)
        less = state.model.objective - model.objective

        def over(trial: Trial) -> Trial:
            if trial.fitted is None:
                return trial
            validation_gain = self.trials.validation_gain(fit, model, trial.fitted, trial.gain)
            eased = self.trials.eased(model, trial.fitted)
            return replace(trial, gain=trial.gain - less, validation_gain=validation_gain, eased=eased)

        return replace(state, model=model, jacobian=jacobian, trials=tuple(map(over, state.trials)))

    def from_base(self, state: SelectionState) -> SelectionState:
        """Trials that fit worse than the model without their effect start from that model, where it was fitted on since
        they were made (`rebased`): theirs are the parameters of a worse one. With two masses it would take too long."""
        fitted = (t for t in state.trials if t.fitted is not None and not t.model.point.two_mass)
        worse = {t.key for t in fitted if t.model.objective > state.model.objective}
        if state.model.point.two_mass or not worse:
            return state
        base = self.trials.base(state.model, state.noise, state.derivatives)

        def again(trial: Trial) -> Trial:
            if trial.key not in worse:
                return trial
            return max(trial, self.trials.run(base, trial.scored), key=lambda t: t.gain)

        return _with_trials(state, again)

    def _simpler(self, trial: Trial, trials: tuple[Trial, ...]) -> Fitted | None:
        """The best fit of an effect that a trial contains, on its joint."""
        contains = self.library[trial.name].contains
        fits = (t.fitted for t in trials if t.fitted is not None and t.joint == trial.joint and t.name in contains)
        return min(fits, key=lambda f: f.objective, default=None)

    def _better(self, state: SelectionState, trial: Trial, about: Point, start: Point) -> Trial:
        """A trial, or that from another start with derivatives about a point, by their gains; the trial where the model
        cannot be run there: an elasticity beside other parameters may not stay finite."""
        fit = PredictionFit(self.predictor, state.noise)
        if fit.errors(about) is None:
            return trial
        jacobian = fit.derivatives(about, state.model.names, state.nearby)
        found = self.trials.run(self.trials.base(state.model, state.noise, jacobian), trial.scored, start)
        return max(trial, found, key=lambda t: t.gain)


def _run_away(trials: Iterable[Trial]) -> list[Trial]:
    """Trials of more gain than all that explain, with values that no machine has."""
    trials = list(trials)
    top = max((t.gain for t in trials if t.explains), default=0.0)
    wrong = (t for t in trials if t.impossible and not t.explains and t.gain > max(top, SELECTION.least_gain))
    return sorted(wrong, key=lambda t: -t.gain)[: SELECTION.most_polished]


def _sizes(effect: Effect) -> dict[str, float]:
    """Unit -> the greatest of an effect's sizes in it."""
    found: dict[str, float] = {}
    for p in effect.kind.parameters:
        if p.role is Role.SIZE:
            found[p.unit] = max(found.get(p.unit, 0.0), effect.values[p.name])
    return found


def _levels(effect: Effect, rich: Effect) -> Iterator[dict[str, float]]:
    """Values of an effect with those of one that contains it: one size, or all that says how stiff and where it is."""
    same = {p.name: _of_role(rich, p) for p in effect.kind.parameters}
    for p in effect.kind.parameters:
        sizes = same[p.name]
        if p.role is Role.SIZE:
            for size in (*sizes, float(np.mean(sizes)) if sizes else 0.0):
                yield {**effect.values, p.name: size}
    others = [p.name for p in effect.kind.parameters if p.role is not Role.SIZE and same[p.name]]
    if others:
        for values in product(*(same[name] for name in others)):
            yield {**effect.values, **dict(zip(others, values))}


def _of_role(effect: Effect, parameter: Parameter) -> list[float]:
    """Values of an effect's parameters of the role and unit of another one's."""
    own = [p for p in effect.kind.parameters if p.role is parameter.role and p.unit == parameter.unit]
    return [effect.values[p.name] for p in own]


def _of_size(effect: Effect, share: float) -> Effect:
    """An effect with a share of its sizes, within their bounds."""
    sizes = {p.name: share * effect.values[p.name] for p in effect.kind.parameters if p.role is Role.SIZE}
    return bounded(effect.kind, effect.joint, {**effect.values, **sizes})


def _with_trials(state: SelectionState, again: Callable[[Trial], Trial]) -> SelectionState:
    """A state with each of its trials made anew."""
    return replace(state, trials=tuple(parallel_map(again, state.trials)))
