# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Held-out logs stay outside the analysis: they change nothing but their own errors."""

from dataclasses import replace

import numpy as np
import pytest
from loop_logs import record

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify.explain import explain, usable
from puma_sim_core.identify.report.json import report_text
from puma_sim_core.plant.mechanism_file import load_mechanism

NOISE = {"volts": 0.05, "noise": 2e-4}


@pytest.fixture(scope="module")
def logs():
    mechanism = load_mechanism("pendulum")
    plant = mechanism.plant(mechanism.start * 1.02, (parse_effect("coulomb_friction:joint=1,torque=0.05"),))
    log = record(mechanism, plant, **NOISE)
    other = record(mechanism, mechanism.plant(mechanism.start * 0.9), seconds=7.0, **NOISE)
    return log, replace(other, name="other")


def rest(explanation) -> str:
    """`report.json` without the held-out logs, their errors, and the seconds."""
    errors = {part: each for part, each in explanation.errors.items() if part != "held_out_logs"}
    return report_text(replace(explanation, errors=errors, held_out_logs=(), seconds=0.0))


@pytest.mark.long
def test_a_log_of_another_machine_changes_nothing_but_its_own_errors(logs):
    log, other = logs
    alone, beside = explain(log, plant="pendulum"), explain(log, held_out=[other, log], plant="pendulum")
    assert [effect.name for effect in alone.effects] == ["coulomb_friction"]
    assert rest(beside) == rest(alone)
    assert beside.held_out_logs == ("other", "own") and "held_out_logs" not in alone.errors
    assert beside.errors["held_out_logs"].position_rms.augmented[0] > alone.errors["held_out"].position_rms.augmented[0]


@pytest.mark.long
def test_errors_of_a_held_out_log_are_those_of_its_own_motion(logs):
    log, _ = logs
    found = explain(log, held_out=log, plant="pendulum")
    own, folds = found.errors["held_out_logs"].position_rms, found.errors["held_out"].position_rms
    # the same rows, with the model that was fitted to them as well
    assert 0.5 * folds.augmented[0] < own.augmented[0] < 1.5 * folds.augmented[0] < 0.5 * own.retuned[0]


def test_rows_that_a_held_out_log_is_read_without_are_noted(logs):
    log, _ = logs
    position = log.position.copy()
    position[2000:2006] = np.nan
    kept, (note,) = usable([replace(log, position=position)], load_mechanism("pendulum"))
    assert [len(part) for part in kept] == [2000, 2994]
    assert note.startswith("Held-out log own is read without: position1, no number at row 2001")


def test_a_faulty_held_out_log_is_left_out_and_named(logs):
    log, other = logs
    other = replace(other, position=other.position + 0.3)
    kept, (note,) = usable([log, other], load_mechanism("pendulum"))
    assert kept == [log]
    assert note.startswith("Held-out log other is left out.") and "offset by about 0.3 rad" in note
