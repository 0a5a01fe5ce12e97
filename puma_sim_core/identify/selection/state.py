# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The state of the selection: a value that each pass takes and gives back changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting.prediction import Fitted
from puma_sim_core.identify.fitting.trial import Trial
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.screening.evidence import Key
from puma_sim_core.identify.selection.cross_validation import WeightedModel
from puma_sim_core.identify.settings import SELECTION


@dataclass(frozen=True)
class Threshold:
    """Gain [nat] that a name needs, by chance and by what the effects before it misfit: of the first dry friction of a
    joint, which all but every drive has, and of that where it varies; of what is placed where most is left, such as a
    push, which is compared with the rest of the log and not with chance, and of any other effect.
    rubbing : joints (1-based) that have dry friction.
    """

    dry: float
    other: float
    rubbing: frozenset[int | None] = frozenset()
    placed: float = SELECTION.least_gain
    varying: float = SELECTION.least_gain

    @classmethod
    def alike(cls, gain: float) -> Threshold:
        """The same for all."""
        return cls(gain, gain, placed=gain, varying=gain)

    def rubs(self, key: Key) -> bool:
        """Whether an effect is the first dry friction of its joint."""
        return KINDS[key[0]].dry and key[1] not in self.rubbing

    def of(self, key: Key) -> float:
        """That of an effect. What is common is dry friction of one level, or in proportion to the load."""
        if self.rubs(key):
            return max(self.dry, self.varying) if KINDS[key[0]].contains else self.dry
        screening = KINDS[key[0]].screening
        return self.placed if screening is not None and screening.placed else self.other

    def least(self, other: Threshold) -> Threshold:
        """The lesser of two."""
        names = ("dry", "varying", "other", "placed")
        return replace(self, **{name: min(getattr(self, name), getattr(other, name)) for name in names})


@dataclass(frozen=True)
class Stage:
    """A completed stage of the selection.

    trials : best first; threshold : of a name; base : the model that gains are over; accepted : the trial that the log
    asks for; doubted : the validation refused the noise that the model leaves; unclear : effects that are not
    better than the model that they would be added to by what a name needs of standard errors; refuting : the best trial
    that the log would ask for, if a machine could have its values, None without any.
    """

    trials: tuple[Trial, ...]
    threshold: Threshold
    base: Fitted
    accepted: Trial | None = None
    doubted: bool = False
    unclear: frozenset[Key] = frozenset()
    refuting: Trial | None = None

    def less(self, gone: Trial) -> Stage:
        """The stage with a trial that may not be named after all, which refutes that nothing is missing."""
        if all(t.key != gone.key for t in self.trials):
            return replace(self, refuting=self.refuting or gone)
        accepted = None if self.accepted is not None and self.accepted.key == gone.key else self.accepted
        trials = tuple(gone if t.key == gone.key else t for t in self.trials)
        return replace(self, trials=trials, accepted=accepted, refuting=self.refuting or gone)

    def naming(self, trial: Trial) -> Stage:
        """The stage with a trial of it under the name that it has among the chosen effects."""
        if any(t is trial for t in self.trials):
            return self

        def same(other: Trial | None) -> bool:
            return other is not None and other.joint == trial.joint and other.name in KINDS[trial.name].names

        accepted = trial if same(self.accepted) else self.accepted
        return replace(self, trials=tuple(trial if same(t) else t for t in self.trials), accepted=accepted)

    def ended(self, gain: float, key: Key, fits: Mapping[Key, tuple[float, Fitted]], accepted: Key) -> Stage:
        """The stage with fits that came to their end in its trials' place, and another trial accepted.

        gain [nat] : what the effect of `key` has by now; fits : the nat that each has more than that, and the model
        with it, its effect last.
        """
        moved = gain - next(t.gain for t in self.trials if t.key == key)

        def now(trial: Trial) -> Trial:
            if trial.key not in fits:
                return replace(trial, gain=trial.gain + moved)
            more, fitted = fits[trial.key]
            return replace(trial, gain=gain + more, fitted=replace(fitted, jacobian=None))

        trials = tuple(sorted(map(now, self.trials), key=lambda t: -t.gain))
        return replace(self, trials=trials, accepted=next(t for t in trials if t.key == accepted))

    def needed(self, trial: Trial) -> float:
        """The gain [nat] that a trial must have more than: more where the validation set says nothing of it, but for
        the first dry friction of a joint, which acts wherever the joint moves, and for what the parameters' priors ask
        for by themselves, of which no rows say anything; and more where it gives a joint two masses."""
        asked = self.threshold.of(trial.key)
        if KINDS[trial.name].two_masses:
            asked = max(asked, SELECTION.least_two_mass)
        if not trial.untried or self.threshold.rubs(trial.key) or self.by_priors(trial):
            return asked
        return max(asked, SELECTION.least_untried)

    def by_priors(self, trial: Trial) -> bool:
        """Whether the priors of the parameters ask for a trial by themselves, and the rows do not."""
        return trial.without_rows > self.threshold.of(trial.key) > trial.of_rows


@dataclass(frozen=True)
class Chosen:
    """An effect of the model.

    key : (name, joint); occam [nat] : Occam factor of its parameters; stage : the one in which it, or the effect that
    it replaced, was accepted; gain [nat] : of log evidence over the model without it when it entered, of a pair beside
    the other.
    """

    key: Key
    occam: float
    stage: Stage
    gain: float

    @classmethod
    def of(cls, trial: Trial, history: tuple[Stage, ...], stage: Stage | None = None, gain: float = 0.0) -> Chosen:
        """The effect of a trial with its gain when accepted; else, of one that replaces another, with that one's stage
        and the gain over the model without it."""
        own = accepting(history, trial.key)
        if own is not None and own.accepted is not None:
            return cls(trial.key, trial.occam, own, own.accepted.gain)
        assert stage is not None
        return cls(trial.key, trial.occam, stage.naming(trial), gain)

    @property
    def tried(self) -> Trial:
        """Its trial in the stage, with the gain that it had."""
        return next(t for t in self.stage.trials if t.key == self.key)

    @property
    def trial(self) -> Trial:
        """Its trial in the stage, with the gain that it has."""
        return replace(self.tried, gain=self.gain)

    @property
    def by_priors(self) -> bool:
        """Whether the priors of the parameters ask for it by themselves, and the rows do not."""
        return self.stage.by_priors(self.trial)

    @property
    def spoken_for(self) -> bool:
        """Whether something else than other rows asks for it: the priors of the parameters, machines, as for the first
        dry friction of a joint, or its place, as for a push, which happens once and must stand out in its log."""
        return self.by_priors or self.stage.threshold.rubs(self.key) or not KINDS[self.key[0]].repeatable

    def named(self, name: str) -> Chosen:
        """The same effect under another of the names that a joint may have of it."""
        return replace(self, key=(name, self.key[1]), stage=self.stage.naming(self.tried.named(name)))


@dataclass(frozen=True)
class SelectionState:
    """What the selection has come to.

    model : the fitted model; jacobian (N, J, p + c) : derivatives of the innovations about it before whitening, by the
    parameters of the mechanism and `model.names`, None where the model has changed since; noise : the weighting of
    the innovations; chosen : the effects of the model, in its order; history : the stages so far; trials : those of
    the present stage; doubted : the state in a noise that the validation refused in this stage, None otherwise;
    retuned : the model with its parameters fitted and no effect, None before the first stage; retracted : effects that
    were taken out at the end, since they do not lower the validation error; barred : effects that came to values that
    no machine has, and why they may not be named.
    """

    model: Fitted
    jacobian: Floats | None
    noise: Weighting
    chosen: tuple[Chosen, ...] = ()
    history: tuple[Stage, ...] = ()
    trials: tuple[Trial, ...] = ()
    doubted: SelectionState | None = None
    retuned: Fitted | None = None
    retracted: tuple[Key, ...] = ()
    barred: tuple[tuple[Key, str], ...] = ()

    @property
    def keys(self) -> tuple[Key, ...]:
        """(name, joint) of the chosen effects."""
        return tuple(chosen.key for chosen in self.chosen)

    def others(self, stage: Stage) -> Iterator[Trial]:
        """Trials of a stage of what the model lacks: of what a joint may have several of under a name that is free."""
        for trial in stage.trials:
            if trial.key not in self.keys:
                yield trial
            elif trial.possible and (other := trial.beside(self.model.point.effects)) is not None:
                yield other

    @property
    def numbered(self) -> SelectionState:
        """The state where those that a joint has several of are numbered in the order of their places."""
        effects, chosen = list(self.model.point.effects), list(self.chosen)
        for first, joint in dict.fromkeys((KINDS[name].first, joint) for name, joint in self.keys):
            names = KINDS[first].names
            own = [n for n, (name, on) in enumerate(self.keys) if on == joint and name in names]
            for name, n in zip(names, sorted(own, key=lambda n: effects[n].place)):
                effects[n], chosen[n] = replace(effects[n], kind=KINDS[name]), chosen[n].named(name)
        point = replace(self.model.point, effects=tuple(effects))
        return replace(self, model=replace(self.model, point=point), chosen=tuple(chosen))

    @property
    def rubbing(self) -> frozenset[int | None]:
        """Joints (1-based) that have dry friction in the model."""
        return frozenset(joint for name, joint in self.keys if KINDS[name].dry)

    @property
    def derivatives(self) -> Floats:
        """`jacobian` of a model that was fitted."""
        assert self.jacobian is not None
        return self.jacobian

    @property
    def nearby(self) -> Floats | None:
        """Derivatives that may stand for those about a trial: of two-mass models, between which they change little."""
        return self.jacobian if self.model.point.two_mass else None

    @property
    def best(self) -> Trial | None:
        """The trial of a possible effect with the greatest gain, None without any."""
        return max((t for t in self.trials if t.problem is None), key=lambda t: t.gain, default=None)

    @property
    def weighted(self) -> WeightedModel:
        """The model with its weighting."""
        return WeightedModel(self.model, self.noise)

    @property
    def weighted_retuned(self) -> WeightedModel:
        """The model without effects, in the same weighting."""
        assert self.retuned is not None
        return WeightedModel(self.retuned, self.noise)


def accepting(history: tuple[Stage, ...], key: Key) -> Stage | None:
    """The first stage that accepted an effect, None without."""
    return next((stage for stage in history if stage.accepted is not None and stage.accepted.key == key), None)
