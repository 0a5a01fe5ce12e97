# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""From measured logs to what the model lacks: the whole method, stage by stage."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from puma_sim_core import __version__
from puma_sim_core.effects import KINDS
from puma_sim_core.errors import RecordingError
from puma_sim_core.identify import outcome
from puma_sim_core.identify.checks import feedback
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.checks.wrong_zero import wrong_zeros
from puma_sim_core.identify.data.ingest import Log, read_log
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.fitting import intervals
from puma_sim_core.identify.fitting.prediction import Point, PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.residuals.unnamed import Unnamed
from puma_sim_core.identify.result import DATA_FAULT, Explanation
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.detect import detectable
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.screening.search import Search
from puma_sim_core.identify.selection.held_out import HeldOut
from puma_sim_core.identify.selection.selected import Selected
from puma_sim_core.identify.selection.selection import Selection
from puma_sim_core.identify.selection.validate import rms
from puma_sim_core.plant.mechanism import load_mechanism

#: least and greatest noise of a row's voltage that the observer reckons with, in volts of a
#: middling friction torque
_LEAST_NOISE, _GREATEST_NOISE = 0.02, 0.5


def explain(
    logs: str | Log | Sequence,
    *,
    held_out: Sequence = (),
    plant: str = "puma560",
    parameters: str | None = None,
    model=None,
    columns: Mapping[str, str] | None = None,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> Explanation:
    """What the model lacks, by measured logs.

    Parameters
    ----------
    logs : paths of CSV files or bags, or `Log` objects; one or several.
    held_out : further ones that are used for nothing but the errors; without any, blocks of the
        logs are kept back.
    plant : "puma560", "pendulum", "slide", or the path of a mechanism file.
    parameters, model : a parameter set, or a model file, to start from.
    columns : channel -> column of the files, such as {"voltage1": "motor_V"}.
    seed : of the placebos and of simulated noise.
    progress : told (what is done, share 0..1).

    Returns
    -------
    Explanation : with verdict DATA_FAULT, and nothing else, where the data cannot be used.

    Raises
    ------
    RecordingError : a file that cannot be read, or is too short for any analysis.
    ParameterError, ModelError : a mechanism, set or model that cannot be used.
    """
    begin = clock.perf_counter()
    progress = progress or (lambda what, share: None)
    mechanism = load_mechanism(plant, parameters=parameters, model=model)
    progress("reading", 0.0)
    fitted, kept = (_logs(given, columns, mechanism.joints) for given in (logs, held_out))
    if not fitted:
        raise RecordingError("no log", where="explain", expected="one at least")
    common = dict(
        mechanism=mechanism.name,
        logs=tuple(log.name for log in fitted),
        held_out_logs=tuple(log.name for log in kept),
        version=__version__,
        seed=seed,
        position_unit=mechanism.position_unit,
    )
    faults, notes = [], []
    for log in (*fitted, *kept):
        found, said = check(log, mechanism)
        faults += found
        # what is so of several logs is said once
        notes += [note for note in said if note not in notes]
    analysis = None if faults else Analysis.of(fitted, kept, mechanism, seed, progress)
    faults = faults or wrong_zeros(analysis.selected.stages)
    if faults:
        return Explanation(
            DATA_FAULT,
            outcome.fault_sentence(faults),
            faults=tuple(faults),
            notes=tuple(notes),
            seconds=clock.perf_counter() - begin,
            **common,
        )
    analysis.source = {"plant": str(plant), "parameters": parameters, "model": None if model is None else str(model)}
    return analysis.explanation(tuple(notes), begin, common)


def _logs(given, columns, joints) -> list[Log]:
    if isinstance(given, (str, Log)) or hasattr(given, "__fspath__"):
        given = [given]
    return [log if isinstance(log, Log) else read_log(log, columns, joints) for log in given]


@dataclass
class Analysis:
    """Everything that the stages leave behind."""

    logs: list
    mechanism: object
    problem: Problem
    search: Search
    predictor: Predictor
    selection: Selection
    selected: object
    held_out: HeldOut
    seed: int
    progress: Callable
    source: dict = field(default_factory=dict)

    @classmethod
    def of(cls, fitted, kept, mechanism, seed, progress) -> Analysis:
        """Steps 1 to 6, and the retraction of step 7."""
        logs = [*fitted, *kept]
        sampled = sample(logs)
        segments = range(len(fitted), len(logs))
        problem = Problem(sampled, mechanism, tuple(segments), hold_back=not kept)
        library = {
            name: kind for name, kind in KINDS.items() if kind.screening is not None and mechanism.possible(name)
        }
        search = Search(problem, library, progress)
        progress("retuning", 0.03)
        retuned = search.retune(mechanism.start)
        alike = problem.like(retuned.residual())
        if alike is not problem:
            problem, search = alike, Search(alike, library, progress)
            retuned = search.retune(retuned.theta)
        bank = search.bank(retuned.theta)
        noise = _row_noise(search, retuned)

        def kept_back(of: Problem) -> list:
            return [_held(of, n) for n in range(len(logs))]

        predictor = Predictor(logs, mechanism, kept_back(problem), noise, sampled.position_noise)
        selection = Selection(search, predictor, library, seed, progress)
        selected = selection.run(retuned.theta, bank)
        progress("validating", 0.86)
        held_out = HeldOut.of(problem, predictor, kept_back)
        selected = _confirmed(selection, selected, held_out)
        return cls(logs, mechanism, problem, search, predictor, selection, selected, held_out, seed, progress)

    def explanation(self, notes, begin, common) -> Explanation:
        """Steps 7 to 11."""
        m, p = self.mechanism, self.problem
        self.progress("what is left", 0.87)
        shapes, chance = self._unnamed()
        s = self.selected
        final = s.final
        fit = PredictionFit(self.predictor, s.weighting)
        causal = CausalScreen(fit, final.point, final.errors, final.jacobian, p)
        self.progress("what could have been seen", 0.93)
        rows = []
        for name, kind in self.search.library.items():
            for j in [None] if not kind.per_joint else range(m.joints):
                pairs = [(c, causal.gram(c)) for c in kind.screening.candidates(causal.signals, j)]
                joint = None if j is None else j + 1
                row = detectable(name, joint, kind, pairs, s.stages[-1].needed(joint))
                rows.append(replace(row, unit=m.unit(row.unit)))
        self.progress("errors", 0.96)
        residuals, errors = self._errors()
        model = m.plant(final.point.theta, final.point.effects)
        linear = p.linear(final.point.theta, final.point.effects)
        bias = feedback.test(p, self.search.settle(linear, ()))
        spread = intervals.intervals(fit, final)
        return outcome.compose(self, errors, residuals, shapes, chance, rows, bias, spread, model, notes, begin, common)

    def _errors(self) -> tuple[dict, dict]:
        """(N, J) voltages [V] that the nominal, the retuned and the augmented model lack, and the
        tables of errors (step 7)."""
        p, s, start = self.predictor, self.selected, Point(self.mechanism.start, ())
        fitted = self.held_out.folds[0].validation
        plants = {
            name: self.mechanism.plant(point.theta, point.effects)
            for name, point in (("nominal", start), ("retuned", s.retuned.point), ("augmented", s.final.point))
        }
        residuals = {name: fitted.volts(plant) for name, plant in plants.items()}
        floor = self._less(s.final.point) * p.floor_in_volts(self.problem.sampled.cutoffs[1])
        left = np.where(p.fit_rows, p.errors(plants["augmented"]), np.nan)
        volts, sensed = p.noise_behind(np.nanvar(left, axis=0), self.problem.sampled.position_noise)
        # what a remainder leaves in the innovations is no noise, nor is all that came before a name
        noise = np.minimum(volts, p.volts), sensed
        models = {"nominal": start, "retuned": s.retuned_model, "augmented": s.model}
        return residuals, {
            "fit": fitted.errors(plants, residuals, floor, noise),
            **self.held_out.errors(models, floor, noise),
        }

    def _unnamed(self) -> tuple[list, float]:
        """Free curves against what is left, and what chance gives any of them; names give way to a
        curve that leaves clearly less than they do (step 10)."""
        unnamed = Unnamed(self.predictor, self.problem, self.seed)
        shapes, chance = unnamed.shapes(self.selected.final)
        if self.selected.keys:
            bare = self.selection.bare(self.selected)
            acting = {joint for _, joint in self.selected.keys}
            remains = outcome.remainder(self.selected, shapes, chance, self._left()) is not None
            if unnamed.stands(bare.final, self.selected.final, None if None in acting else acting, remains):
                self.selected = bare
                shapes, chance = unnamed.shapes(bare.final)
        return shapes, chance

    def _less(self, point) -> np.ndarray:
        """(J,) noise of the innovations of a model, at most 1, over that which the observer was
        made for: before it was known what is noise and what an effect."""
        raw = self.predictor.errors(self.mechanism.plant(point.theta, point.effects))
        raw = np.where(self.predictor.fit_rows, raw, np.nan)
        return np.minimum(1.0, np.nanstd(raw, axis=0) / np.array(self.predictor.spread))

    def _left(self) -> np.ndarray:
        """(J,) residual of the rows to fit after what was chosen, in terms of its floor."""
        point, cutoff = self.selected.final.point, self.problem.sampled.cutoffs[1]
        volts = self.held_out.folds[0].validation.volts(self.mechanism.plant(point.theta, point.effects))
        floor = self._less(point) * self.predictor.floor_in_volts(cutoff)
        return rms(volts, self.predictor.fit_rows) / floor


def _confirmed(selection: Selection, selected: Selected, held_out: HeldOut) -> Selected:
    """The selection without the effects, weakest first, that do not lower the error held out (step
    7)."""
    while selected.keys and not held_out.lower(selected.model, selected.retuned_model):
        selected = selection.without(selected, min(selected.keys, key=selected.gain_of))
    return selected


def _held(problem: Problem, number: int):
    """Function of times [s] of one log: whether they are kept back."""
    rows = problem.segment == number
    time = problem.sampled.time[problem.kept[rows]]
    held = problem.held[rows].astype(float)
    return lambda t: np.interp(t, time, held) > 0.5


def _row_noise(search: Search, fit) -> np.ndarray:
    """(J,) standard deviation [V] of a row's voltage noise, without what may be an effect."""
    m = search.problem.mechanism
    drive = m.drive(m.start)
    unit = drive.volts_per_torque * np.asarray(m.torque_scale)
    weights = search.noise_of(fit.residual(), white_only=True)
    volts = np.sqrt([w[0] for w in weights])
    return np.clip(volts, _LEAST_NOISE * unit, _GREATEST_NOISE * unit)
