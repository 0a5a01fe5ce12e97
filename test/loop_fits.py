# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Models of a pendulum that lack an effect, for tests of fits."""

from __future__ import annotations

from loop_logs import pieces, record

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify.data.machine_log import read_for, with_volts
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.trials import Base, Trials
from puma_sim_core.identify.noise import innovations
from puma_sim_core.identify.prepare import prepare
from puma_sim_core.identify.screening.causal import CausalScreen
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.selection.state import SelectionState
from puma_sim_core.plant.mechanism_file import load_mechanism

NOISE = 0.02
PENDULUM = load_mechanism("pendulum")


def lacking(effect):
    """The fitted model without an effect of a log of a pendulum with it, the trials, and the state of the selection."""
    plant = PENDULUM.plant(effects=(effect,))
    log = record(PENDULUM, plant, volts=NOISE, noise=1e-5)
    problem, _, predictor = pieces(PENDULUM, log, NOISE, 1e-5)
    fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(plant)))
    base = fit.run(Point(PENDULUM.start, ()), (), rounds=8)
    raw = fit.derivatives(base.point, ())
    state = SelectionState(base, raw, fit.weighting)
    return Base(fit, base, fit.whitened(raw)), Trials(predictor, problem), state


def tried(base, trials, text):
    """The trial of an effect in the text form, from the start values of the parameters."""
    effect = parse_effect(text)
    scored = Scored(effect.kind.name, 1, 0.0, values=dict(effect.values))
    return trials.run(base, scored, Point(PENDULUM.start, (effect,)))


def of_machine(record, folder):
    """The fit of a simulated log of another machine with the noise of the true model, its trials, and that model."""
    mechanism = record.mechanism
    prepared = prepare([with_volts(read_for(mechanism, str(record.write(folder))), mechanism)], mechanism)
    true = Point(mechanism.clip(record.theta), record.effects)
    raw = prepared.predictor.errors(true.plant(mechanism))
    fit = PredictionFit(prepared.predictor, innovations.weighting(prepared.predictor, raw))
    return fit, Trials(prepared.predictor, prepared.problem), true


def screen_of(fit, trials, model):
    """The screening of the innovations of a fitted model."""
    jacobian = fit.whitened(fit.derivatives(model.point, model.names))
    return CausalScreen(fit, model.point, model.errors, jacobian, trials.problem)
