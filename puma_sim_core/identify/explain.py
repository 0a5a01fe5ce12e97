# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""From measured logs to what the model lacks: the whole method, stage by stage."""

import os
import time as clock
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from puma_sim_core import __version__
from puma_sim_core.errors import RecordingError
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.checks import feedback
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.checks.wrong_zero import wrong_zeros
from puma_sim_core.identify.data.ingest import read_log
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.fitting import intervals
from puma_sim_core.identify.fitting.prediction import Point, PredictionFit
from puma_sim_core.identify.fitting.trials import Trials
from puma_sim_core.identify.outcome import Findings, compose, fault_sentence
from puma_sim_core.identify.prepare import Prepared, prepare, silent
from puma_sim_core.identify.residuals.shape import Curve
from puma_sim_core.identify.residuals.unnamed import Unnamed, remainder
from puma_sim_core.identify.result import DATA_FAULT, Detectable, Errors, Explanation, Fault, FeedbackBias
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.detect import detectable
from puma_sim_core.identify.screening.hypotheses import candidates, hypotheses
from puma_sim_core.identify.screening.short_list import ShortList
from puma_sim_core.identify.selection.cross_validation import CrossValidation
from puma_sim_core.identify.selection.selection import Selection
from puma_sim_core.identify.selection.state import SelectionState
from puma_sim_core.identify.selection.validate import rms
from puma_sim_core.identify.settings import CHECKS
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.mechanism_file import load_mechanism

#: paths of CSV files or bags, or logs; one or several
Logs = str | os.PathLike[str] | Log | Iterable[str | os.PathLike[str] | Log]


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
    progress = progress or silent
    mechanism = load_mechanism(plant, parameters=parameters, model=model)
    progress("reading", 0.0)
    fitted, validation = (_logs(given, columns, mechanism.joints) for given in (logs, held_out))
    if not fitted:
        raise RecordingError("no log", where="explain", expected="one at least")
    checked = [check(log, mechanism) for log in fitted]
    cuts = [cut for each in checked for cut in each.cuts]
    faults = [fault for each in checked for fault in each.faults] or (cuts if strict else [])
    notes = list(dict.fromkeys(note for each in checked for note in each.notes))
    beside, unusable = usable(validation, mechanism)
    if not faults:
        parts = [part for each in checked for part in each.parts]
        stages = Stages(prepare(parts, mechanism, progress), seed, progress, beside)
        state = stages.select()
        doubts = [doubt for each in checked for doubt in each.doubts]
        faults = wrong_zeros(state.history) or stages.unexplained(state, doubts)
    if faults:
        explanation = Explanation(DATA_FAULT, fault_sentence(faults), faults=tuple(faults))
    else:
        source = {"plant": str(plant), "parameters": parameters, "model": None if model is None else str(model)}
        explanation = compose(stages.findings(stages.validate(state), source))
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
        seconds=clock.perf_counter() - begin,
    )


def _logs(given: Logs, columns: Mapping[str, str] | None, joints: int) -> list[Log]:
    several = [given] if isinstance(given, (str, Log, os.PathLike)) else given
    return [log if isinstance(log, Log) else read_log(log, columns, joints) for log in several]


def usable(held_out: list[Log], mechanism: Mechanism) -> tuple[list[Log], list[str]]:
    """What of held-out logs errors can be measured on, and notes on the logs and the rows that are left out."""
    parts, notes = list[Log](), list[str]()
    for log in held_out:
        found = check(log, mechanism)
        parts += found.parts
        if found.faults:
            notes.append(f"Held-out log {log.name} is left out. {fault_sentence(list(found.faults))}")
        else:
            notes += [f"Held-out log {log.name} is read without: {cut.channel}, {cut.what}." for cut in found.cuts]
    return parts, notes


class Stages:
    """The stages after the preparation of the logs; seed, progress and held_out as for `explain`."""

    def __init__(
        self, prepared: Prepared, seed: int, progress: Callable[[str, float], None], held_out: Sequence[Log] = ()
    ):
        self.prepared = prepared
        #: logs outside the analysis with their predictor
        self.beside = prepared.beside(held_out) if held_out else None
        self.problem = prepared.problem
        self.predictor = prepared.predictor
        self.mechanism = prepared.problem.mechanism
        self.seed = seed
        self.progress = progress
        short_list = ShortList(prepared.search, self.predictor, prepared.search.bank(prepared.retuned.theta))
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
        return self.selection.run(self.prepared.retuned.theta)

    def unexplained(self, state: SelectionState, doubts: Sequence[Fault]) -> list[Fault]:
        """The doubts about joints whose voltage the effects found do not explain for most of the time."""
        if not doubts or not state.chosen:
            return list(doubts)
        p, left = self.predictor, np.abs(self._volts(state.model.point))
        volts = np.concatenate([stretch.voltage[1:] for stretch in p.stretches])
        found = []
        for doubt in doubts:
            j = int(doubt.channel[-1]) - 1
            rows = p.fit_rows[:, j]
            size = np.median(np.abs(volts[rows, j] - np.median(volts[rows, j])))
            if not np.median(left[rows, j]) < CHECKS.channel_another * size:
                found.append(doubt)
        return found

    def validate(self, state: SelectionState) -> SelectionState:
        """The selection without the effects, weakest first, that do not lower the error in cross-validation."""
        self.progress("validating", 0.86)
        return retracted(self.selection, state, self.folds)

    def findings(self, state: SelectionState, source: Mapping[str, str | None]) -> Findings:
        """What the stages after the validation find. source : how `explain` was called."""
        state, curves, chance = self.free_curves(state)
        detectability = self.detectability(state)
        residuals, errors = self.errors(state)
        bias, bounds = self.feedback_bias(state), intervals.intervals(self.fit(state), state.model)
        return Findings(self.prepared, state, curves, chance, errors, residuals, detectability, bias, bounds, source)

    def free_curves(self, state: SelectionState) -> tuple[SelectionState, list[Curve], float]:
        """Free curves, and their gain by chance; effects are retracted where a curve leaves clearly less than they."""
        self.progress("what is left", 0.87)
        unnamed = Unnamed(self.predictor, self.problem, self.seed)
        curves, chance = unnamed.shapes(state.model)
        if state.chosen:
            bare = self.selection.without(state, *state.keys)
            joints = {joint for _, joint in state.keys if joint is not None}
            left = rms(self._volts(state.model.point), self.predictor.fit_rows) / self._floor(state)
            remains = remainder(state, curves, chance, left) is not None
            everywhere = any(joint is None for _, joint in state.keys)
            if unnamed.preferred(bare.model, state.model, None if everywhere else joints, remains):
                return bare, *unnamed.shapes(bare.model)
        return state, curves, chance

    def detectability(self, state: SelectionState) -> tuple[Detectable, ...]:
        """The smallest size of each effect that the log could have shown."""
        self.progress("what could have been seen", 0.93)
        fit, model = self.fit(state), state.model
        causal = CausalScreen(fit, model.point, model.errors, fit.whitened(state.derivatives), self.problem)
        rows = []
        for kind, joint in hypotheses(self.prepared.library.values(), self.mechanism.joints):
            pairs = [(c, causal.gram(c)) for c in candidates(kind, joint, causal.signals)]
            row = detectable(kind, joint, pairs, state.history[-1].needed(joint))
            rows.append(replace(row, unit=self.mechanism.unit(row.unit)))
        return tuple(rows)

    def errors(self, state: SelectionState) -> tuple[dict[str, Floats], dict[str, Errors]]:
        """(N, J) voltages [V] that the nominal, the retuned and the augmented model lack, and the tables of errors."""
        self.progress("errors", 0.96)
        p, start = self.predictor, Point(self.mechanism.start, ())
        points = {"nominal": start, "retuned": state.weighted_retuned.fitted.point, "augmented": state.model.point}
        plants = {name: point.plant(self.mechanism) for name, point in points.items()}
        residuals = {name: self._volts(point) for name, point in points.items()}
        floor = self._floor(state)
        left = np.where(p.fit_rows, p.errors(plants["augmented"]), np.nan)
        volts, sensed = p.noise_behind(np.nanvar(left, axis=0), self.problem.sampled.position_noise)
        # what a remainder leaves in the innovations is no noise, nor is all that came before a name
        noise = np.minimum(volts, p.volts), sensed
        weighted = {"retuned": state.weighted_retuned, "augmented": state.weighted}
        tables = {"fit": self.folds.folds[0].validation.errors(plants, residuals, floor, noise)}
        tables |= self.folds.errors({"nominal": start, **weighted}, floor, noise)
        if self.beside is not None:
            beside = CrossValidation.of(*self.beside, self.prepared.validation)
            tables["held_out_logs"] = beside.errors({"nominal": start, **weighted}, floor, noise)["held_out"]
        return residuals, tables

    def feedback_bias(self, state: SelectionState) -> FeedbackBias:
        """Whether feedback in the recording biases what was found."""
        linear = self.problem.linear(state.model.point.theta, state.model.point.effects)
        return feedback.test(self.problem, self.prepared.search.settle(linear))

    def _volts(self, point: Point) -> Floats:
        """(N, J) voltages [V] that a model lacks."""
        return self.folds.folds[0].validation.volts(point.plant(self.mechanism))

    def _floor(self, state: SelectionState) -> Floats:
        """(J,) noise of the residual [V]: the predictor's, less as the selection lowered the innovations."""
        raw = self.predictor.errors(state.model.point.plant(self.mechanism))
        raw = np.where(self.predictor.fit_rows, raw, np.nan)
        less = np.minimum(1.0, np.nanstd(raw, axis=0) / np.array(self.predictor.spread))
        return less * self.predictor.floor_in_volts(self.problem.sampled.cutoffs[1])


def retracted(selection: Selection, state: SelectionState, folds: CrossValidation) -> SelectionState:
    """The selection without the effects, weakest first, that do not lower the error in cross-validation."""
    while state.chosen and not folds.lower(state.weighted, state.weighted_retuned):
        state = selection.without(state, min(state.chosen, key=lambda chosen: chosen.gain).key)
    return state
