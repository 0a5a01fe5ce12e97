# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""From measured logs to what the model lacks: the whole method, stage by stage."""

import os
import time as clock
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from puma_sim_core import __version__
from puma_sim_core.effects import KINDS
from puma_sim_core.errors import RecordingError
from puma_sim_core.executors import one_thread_of_algebra
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.checks import feedback
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.checks.wrong_zero import wrong_zeros
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.machine_log import read_for, with_volts
from puma_sim_core.identify.fitting import intervals
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.identify.link_side import outcome as link_outcome
from puma_sim_core.identify.link_side.compare import compare as compare_sides
from puma_sim_core.identify.memory import release
from puma_sim_core.identify.noise.open_loop import NoiseFloor, noise_behind, variance_of_innovations
from puma_sim_core.identify.outcome import Findings, beyond_noise, compose, fault_sentence
from puma_sim_core.identify.prepare import Prepared, prepare, silent
from puma_sim_core.identify.report.json import report_mapping
from puma_sim_core.identify.residuals.shape import Curve
from puma_sim_core.identify.residuals.unnamed import Unnamed
from puma_sim_core.identify.result import DATA_FAULT, Detectable, Errors, Explanation, Fault, FeedbackBias
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.detect import detectable
from puma_sim_core.identify.screening.hypotheses import candidates, hypotheses, open_to
from puma_sim_core.identify.screening.short_list import ShortList
from puma_sim_core.identify.selection.cross_validation import CrossValidation, WeightedModel
from puma_sim_core.identify.selection.selection import Selection
from puma_sim_core.identify.selection.state import SelectionState
from puma_sim_core.identify.settings import CHECKS, RESIDUALS
from puma_sim_core.identify.several.agreement import agreement as compare
from puma_sim_core.identify.several.one_by_one import OneByOne, within
from puma_sim_core.identify.standing import NAMED, TIED, better_by, standings
from puma_sim_core.jit import is_compiled
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.mechanism_file import load_mechanism

_NOT_HELD_OUT = "Held-out logs are not read where the two sides of transmissions are compared: blocks of the logs are."
#: paths of CSV files or bags, or logs; one or several
Logs = str | os.PathLike[str] | Log | Iterable[str | os.PathLike[str] | Log]


@one_thread_of_algebra()
def explain(
    logs: Logs,
    *,
    held_out: Logs = (),
    plant: str = "puma560",
    parameters: str | None = None,
    model: str | os.PathLike[str] | None = None,
    columns: Mapping[str, str] | None = None,
    seed: int = 0,
    strict: bool = False,
    agreement: bool | Executor = False,
    progress: Callable[[str, float], None] | None = None,
) -> Explanation:
    """What the model lacks, by measured logs.

    Parameters
    ----------
    logs : paths of CSV files or bags, or `Log` objects; one or several.
    held_out : further ones that are used for nothing but their own errors; nothing else of the result changes. One
        with a fault of its data is left out, and a note says so.
    plant : "puma560", "pendulum", "slide", or the path of a mechanism file.
    parameters, model : a parameter set, or a model file, to start from.
    columns : channel -> column of the files, such as {"voltage1": "motor_V"}.
    seed : of the placebos and of simulated noise.
    strict : refuse a log with rows that cannot be used, in place of leaving them out.
    agreement : explain several logs one by one as well, and compare the answers. It takes about as long again as the
        logs together; an executor of `open_executor` explains them at the same time, with the same result.
    progress : called with (what is done, share 0..1).

    Returns
    -------
    Explanation : with verdict DATA_FAULT, and nothing else, where the data cannot be used.

    Raises
    ------
    RecordingError : a file that cannot be read, or is too short for any analysis.
    ParameterError, ModelError : a mechanism, set or model that cannot be used.
    """
    begin = clock.perf_counter()
    progress = told = progress or silent
    mechanism = load_mechanism(plant, parameters=parameters, model=model)
    progress("reading", 0.0)
    fitted, validation = (_logs(given, columns, mechanism) for given in (logs, held_out))
    if not fitted:
        raise RecordingError("no log", where="explain", expected="one at least")
    one_by_one = bool(agreement) and len(fitted) > 1
    if one_by_one:
        progress = within(told, 0.0, 0.5)
    checked = [check(log, mechanism) for log in fitted]
    cuts = [cut for each in checked for cut in each.cuts]
    faults = [fault for each in checked for fault in each.faults] or (cuts if strict else [])
    notes = list(dict.fromkeys(note for each in checked for note in each.notes))
    beside, unusable = usable(validation, mechanism)
    parts = [part for each in checked for part in each.parts]
    if not faults and mechanism.links_known:
        is_compiled("identification")  # a program may wait here until it is
    source: dict[str, Any] = {"plant": plant, "parameters": parameters, "model": model}
    alone = None
    if one_by_one and not faults:
        executor = agreement if isinstance(agreement, Executor) else None
        alone = OneByOne(fitted, partial(_alone, **source, seed=seed, strict=strict), executor)
    if not faults and mechanism.links_known:
        doubts = [doubt for each in checked for doubt in each.doubts]
        prepared = prepare(parts, mechanism, progress)
        cuts += prepared.cuts
        faults = list(prepared.cuts) if strict else []
    if not faults and mechanism.links_known:
        stages = Stages(prepared, seed, progress, beside, doubts)
        if stages.beside is not None:
            unusable += [_read_without(name, cut) for name, cut in stages.beside.cuts.items()]
        release()
        state = stages.select()
        faults = wrong_zeros(state.history, cuts) or stages.unexplained(state, doubts)
    sides = () if faults else compare_sides(parts, mechanism, seed)
    if faults:
        explanation = Explanation(DATA_FAULT, fault_sentence(faults), faults=tuple(faults))
    elif not mechanism.links_known:
        explanation = link_outcome.explanation(sides, mechanism.position_unit)
        unusable += [_NOT_HELD_OUT] if validation else []
    else:
        told_of = {name: None if given is None else str(given) for name, given in source.items()}
        explanation = replace(compose(stages.findings(stages.validate(state), told_of)), link_side=sides)
        notes += [link_outcome.sentence(side, mechanism.position_unit) for side in sides]
    compared = None
    if alone is not None and not faults:
        compared = compare([log.name for log in fitted], alone.reports(within(told, 0.5, 1.0)))
    elif alone is not None:
        alone.cancel()
    return replace(
        explanation,
        mechanism=mechanism.name,
        logs=tuple(log.name for log in fitted),
        held_out_logs=tuple(log.name for log in validation),
        version=__version__,
        seed=seed,
        position_unit=mechanism.position_unit,
        notes=(*notes, *explanation.notes, *unusable),
        cuts=() if faults else tuple(cuts),
        agreement=compared,
        seconds=clock.perf_counter() - begin,
    )


def _alone(log: Log, progress: Callable[[str, float], None], **asked: Any) -> dict[str, Any] | None:
    """The report of a log by itself, None where it is too short; asked : how it is explained."""
    try:
        return report_mapping(explain(log, **asked, progress=progress))
    except RecordingError:
        return None


def _logs(given: Logs, columns: Mapping[str, str] | None, mechanism: Mechanism) -> list[Log]:
    several = [given] if isinstance(given, (str, Log, os.PathLike)) else given
    return [
        with_volts(log if isinstance(log, Log) else read_for(mechanism, log, columns), mechanism) for log in several
    ]


def usable(held_out: list[Log], mechanism: Mechanism) -> tuple[list[Log], list[str]]:
    """What of held-out logs errors can be measured on, and notes on the logs and the rows that are left out."""
    parts, notes = list[Log](), list[str]()
    for log in held_out:
        found = check(log, mechanism)
        parts += found.parts
        if found.faults:
            notes.append(f"Held-out log {log.name} is left out. {fault_sentence(list(found.faults))}")
        else:
            notes += [_read_without(log.name, cut) for cut in found.cuts]
    return parts, notes


def _read_without(name: str, cut: Fault) -> str:
    """A note on rows of a held-out log that are left out."""
    return f"Held-out log {name} is read without: {cut.channel}, {cut.what}."


class Stages:
    """The stages after the preparation of the logs; seed, progress and held_out as for `explain`; doubts : those of
    the gate."""

    def __init__(
        self,
        prepared: Prepared,
        seed: int,
        progress: Callable[[str, float], None],
        held_out: Sequence[Log] = (),
        doubts: Sequence[Fault] = (),
    ):
        self.prepared = prepared
        #: logs outside the analysis with their predictor
        self.beside = prepared.beside(held_out) if held_out else None
        self.problem = prepared.problem
        self.predictor = prepared.predictor
        self.mechanism = prepared.problem.mechanism
        self.seed = seed
        self.progress = progress
        bank, doubted = prepared.search.bank(prepared.theta), {_joint(doubt) for doubt in doubts}
        short_list = ShortList(prepared.search, self.predictor, bank, doubted)
        self.selection = Selection(short_list, Trials(self.predictor, self.problem), prepared.library, seed, progress)

    def fit(self, state: SelectionState) -> PredictionFit:
        """The fit in the noise of a state."""
        return PredictionFit(self.predictor, state.noise)

    @cached_property
    def folds(self) -> CrossValidation:
        """The rows that models are measured at."""
        return CrossValidation.of(self.problem, self.predictor, self.prepared.validation)

    def select(self) -> SelectionState:
        """Screening, fits, and selection of effects."""
        return self.selection.run(self.prepared.theta)

    def unexplained(self, state: SelectionState, doubts: Sequence[Fault]) -> list[Fault]:
        """The doubts about joints whose voltage the effects found leave most of."""
        if not doubts or not state.chosen:
            return list(doubts)
        p, left = self.predictor, np.abs(self._volts(state.model.point))
        volts = np.concatenate([stretch.voltage[1:] for stretch in p.stretches])
        found = []
        for doubt in doubts:
            j = _joint(doubt) - 1
            own = volts[p.fit_rows[:, j], j]
            # means: a voltage that is clipped most of the time has a median deviation of zero
            # and one that is there all the time has no size of its own: as in the gate, that of friction counts
            least = CHECKS.channel_another_floor * float(p.friction_volts[j])
            size = max(float(np.abs(own - own.mean()).mean()), least)
            if not left[p.fit_rows[:, j], j].mean() < CHECKS.channel_another * size:
                found.append(doubt)
        return found

    def validate(self, state: SelectionState) -> SelectionState:
        """The selection without the effects, weakest first, that do not predict better in cross-validation."""
        self.progress("validating", 0.86)
        return retracted(self.selection, state, self.folds, self._noise_holds)

    def _noise_holds(self, state: SelectionState) -> bool:
        """Whether the errors in open loop are of the size that the noise makes, or the effects found say nothing of
        that: what happens once, such as a push, has no other fold to be predicted from."""
        if not any(KINDS[name].repeatable for name, _ in state.keys):
            return True
        table = self.folds.errors(self._models(state), self._floor(state))["held_out"]
        return beyond_noise(table.position_rms, self._most_of_noise(state)) is None

    def findings(self, state: SelectionState, source: Mapping[str, str | None]) -> Findings:
        """What the stages after the validation find. source : how `explain` was called."""
        release()
        state, curves, chance = self.free_curves(state)
        release()
        detectability = self.detectability(state)
        residuals, errors = self.errors(state)
        beyond = beyond_noise(errors["held_out"].position_rms, self._most_of_noise(state))
        bias, bounds = self.feedback_bias(state), intervals.intervals(self.fit(state), state.model)
        return Findings(
            self.prepared, state, curves, chance, errors, beyond, residuals, detectability, bias, bounds, source
        )

    def free_curves(self, state: SelectionState) -> tuple[SelectionState, list[Curve], float]:
        """Free curves, and their gain by chance; effects are retracted where a curve leaves clearly less than they."""
        self.progress("what is left", 0.87)
        unnamed = Unnamed(self.predictor, self.problem, self.seed)
        curves, chance = unnamed.shapes(state.model)
        if state.chosen:
            bare = self.selection.without(state, *state.keys)
            joints = {joint for _, joint in state.keys if joint is not None}
            everywhere = any(joint is None for _, joint in state.keys)
            occam = sum(chosen.occam for chosen in state.chosen)
            if unnamed.preferred(bare.model, state.model, occam, None if everywhere else joints):
                return bare, *unnamed.shapes(bare.model)
        return state, curves, chance

    def detectability(self, state: SelectionState) -> tuple[Detectable, ...]:
        """The smallest size of each effect that the log could have shown beside the effects found.

        Of these, and of what is tied with them, it is that in the model without any, and no larger than the one found.
        """
        self.progress("what could have been seen", 0.93)
        tried = standings(state, partial(better_by, self.predictor))
        alike = {row.key: row.trial.effect for row in tried if row.verdict in (NAMED, TIED)}
        alike |= dict(zip(state.keys, state.model.point.effects))
        fit, bare = self.fit(state), state.weighted_retuned.fitted
        beside = CausalScreen(fit, state.model.point, state.model.errors, fit.whitened(state.derivatives), self.problem)
        alone = beside
        if alike:
            columns = fit.whitened(fit.derivatives(bare.point, ()))
            alone = CausalScreen(fit, bare.point, bare.errors, columns, self.problem)
        rows = []
        for kind, joint in hypotheses(self.prepared.library.values(), self.mechanism):
            if (kind.name, joint) not in state.keys and not open_to(kind, joint, state.keys):
                continue
            found = alike.get((kind.name, joint))
            causal = beside if found is None else alone
            pairs = [(c, causal.gram(c)) for c in candidates(kind, joint, causal.signals)]
            threshold = state.history[-1].threshold.of((kind.name, joint))
            rows.append(detectable(kind, joint, self.mechanism, self.predictor.step, pairs, threshold, found))
        return tuple(rows)

    def errors(self, state: SelectionState) -> tuple[dict[str, Floats], dict[str, Errors]]:
        """(N, J) voltages [V] that the nominal, the retuned and the augmented model lack, and the tables of errors."""
        self.progress("errors", 0.96)
        models = self._models(state)
        points = {name: m if isinstance(m, Point) else m.fitted.point for name, m in models.items()}
        plants = {name: point.plant(self.mechanism) for name, point in points.items()}
        residuals = {name: self._volts(point) for name, point in points.items()}
        floor = self._floor(state)
        tables = {"fit": self.folds.folds[0].validation.errors(plants, residuals, floor)}
        tables |= self.folds.errors(models, floor)
        if self.beside is not None:
            beside = CrossValidation.of(self.beside.problem, self.beside.predictor, self.prepared.validation)
            tables["held_out_logs"] = beside.errors(models, floor)["held_out"]
        return residuals, tables

    def _models(self, state: SelectionState) -> dict[str, WeightedModel | Point]:
        """The start values, the retuned model and that with the effects found."""
        start = Point(self.mechanism.start, ())
        return {"nominal": start, "retuned": state.weighted_retuned, "augmented": state.weighted}

    def _most_of_noise(self, state: SelectionState) -> Floats:
        """(J,) largest errors [rad or m] in open loop that noise makes, whose voltage is as slow as noise may be."""
        p = self.predictor
        left = np.where(p.fit_rows, p.errors(state.model.point.plant(self.mechanism)), np.nan)
        slow = noise_behind(p, left, self.problem.sampled.position_noise, RESIDUALS.slowest_noise)
        return self.folds.noise_in_windows(slow)

    def feedback_bias(self, state: SelectionState) -> FeedbackBias:
        """Whether feedback in the recording biases what was found."""
        linear = self.problem.linear(state.model.point.theta, state.model.point.effects)
        return feedback.test(self.problem, self.prepared.search.settle(linear))

    def _volts(self, point: Point) -> Floats:
        """(N, J) voltages [V] that a model lacks."""
        return self.folds.folds[0].validation.volts(point.plant(self.mechanism))

    def _floor(self, state: SelectionState) -> NoiseFloor:
        """What the noise leaves, as the weighting of the innovations has it."""
        p, noise = self.predictor, state.noise
        volts = p.floor_in_volts(self.problem.sampled.cutoffs[1], noise)
        return NoiseFloor(volts, partial(variance_of_innovations, p, noise))


def _joint(doubt: Fault) -> int:
    """The joint (1-based) of a doubt about its channel."""
    return int(doubt.channel[-1])


def retracted(
    selection: Selection,
    state: SelectionState,
    folds: CrossValidation,
    noise_holds: Callable[[SelectionState], bool] = lambda _: True,
) -> SelectionState:
    """The selection without the effects, weakest first, that do not predict better in cross-validation.

    What something else speaks for goes last, and need not predict better: not worse by more than chance. noise_holds :
    whether errors in open loop are of the size that the noise of a state makes.
    """
    while state.chosen:
        as_good = all(chosen.spoken_for for chosen in state.chosen)
        if folds.better(state.weighted, state.weighted_retuned, partial(noise_holds, state), as_good):
            break
        weakest = min(state.chosen, key=lambda chosen: (chosen.spoken_for, chosen.gain))
        state = selection.without(state, weakest.key)
    return state
