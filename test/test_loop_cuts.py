# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Rows that cannot be used are left out, and the rest of a log is explained as if they had never been there."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loop_logs import record

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify import explain
from puma_sim_core.identify.arrays import runs
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.checks.row_faults import time_faults
from puma_sim_core.identify.data.log import Log
from puma_sim_core.plant.mechanism_file import load_mechanism

PENDULUM = load_mechanism("pendulum")


def of_friction(**more) -> Log:
    plant = PENDULUM.plant(PENDULUM.start * 1.02, (parse_effect("coulomb_friction:joint=1,torque=0.05"),))
    return record(PENDULUM, plant, volts=0.05, noise=2e-4, **more)


@pytest.fixture(scope="module")
def log() -> Log:
    return of_friction()


@pytest.fixture(scope="module")
def whole(log):
    """The explanation of the log with all its rows."""
    return explain(log, plant="pendulum")


def with_rows(log: Log, rows: np.ndarray) -> Log:
    """Some rows of a log, as a file that lacks the others."""
    return replace(log, time=log.time[rows], voltage=log.voltage[rows], position=log.position[rows])


@given(st.sets(st.integers(0, 4999), min_size=1, max_size=6), st.integers(1, 9))
def test_parts_are_the_rows_between_those_without_a_number(places, width):
    log = PLAIN
    bad = np.zeros(len(log), dtype=bool)
    for place in places:
        bad[place : place + width] = True
    position = np.where(bad[:, None], np.nan, log.position)
    found = check(replace(log, position=position), PENDULUM)
    assert found.parts and not found.faults
    used = np.zeros(len(log), dtype=bool)
    for part in found.parts:
        rows = part.rows - 1
        assert np.array_equal(part.time, log.time[rows]) and np.array_equal(part.voltage, log.voltage[rows])
        assert not used[rows].any()
        used[rows] = True
    for first, end in runs(~bad):
        # a stretch is used from end to end, unless it is too short for a motion
        assert used[first:end].all() or (not used[first:end].any() and end - first <= 500)
    assert not (used & bad).any()


def test_few_rows_that_are_gone_do_not_split_a_log(log):
    position, rows = log.position.copy(), np.delete(np.arange(5000), [800, 1600, 1601, 3000])
    position[2000] = np.nan
    position[2500:2503] = np.nan
    repeated = np.insert(rows, 900, rows[899])
    found = check(with_rows(replace(log, position=position), repeated), PENDULUM)
    (part,) = found.parts
    assert np.array_equal(part.time, log.time[np.delete(rows, np.searchsorted(rows, [2000, 2500, 2501, 2502]))])
    assert np.flatnonzero(np.diff(part.rows) > 1).tolist() == [899, 1996, 2495]
    assert {(cut.channel, cut.row, cut.rows) for cut in found.cuts} == {("time", 901, 1), ("position1", 1999, 1)}
    assert "Rows are missing or late in 5 places: up to 0.008 s, with rows every 0.002 s." in found.notes
    # four in a row are more than a motion of 60 Hz can be followed over
    position[2503] = np.nan
    assert len(check(replace(log, position=position), PENDULUM).parts) == 2


@pytest.mark.parametrize("step", [2e-4, 1e-3, 5e-3, 0.02, 0.1])
def test_one_row_may_be_missing_at_any_rate(step):
    gone = np.delete(np.arange(5000), [1200, 3100])
    still = np.zeros((5000, 1))
    log = Log("log", step * np.arange(5000.0), still, still)
    assert not time_faults(with_rows(log, gone))
    (fault,) = time_faults(with_rows(log, np.delete(gone, slice(3099, 3199))))
    assert fault.row == 3100 and "about 101 rows" in fault.what


def test_what_is_left_between_many_rows_that_are_gone_is_no_log(log):
    # the other four rows of five have voltages that the machine got, and no time
    found = check(
        replace(log, time=0.01 * np.floor(log.time / 0.01 + 1e-9) + np.where(log.time > 5.0, 0.003, 0.0)), PENDULUM
    )
    assert not found.parts and {fault.channel for fault in found.faults} == {"time"}


def test_a_jump_of_the_motion_splits_a_log_however_short(log):
    time = log.time.copy()
    time[3000:] -= 0.04
    found = check(with_rows(replace(log, time=time), np.r_[0:3000, 3021:5000]), PENDULUM)
    assert [part.row(0) for part in found.parts] == [1, 3001], found.cuts


def test_a_gap_splits_a_log_and_loses_no_row(log):
    gone = np.r_[0:2100, 2107:5000]
    found = check(with_rows(log, gone), PENDULUM)
    assert [len(part) for part in found.parts] == [2100, 2893] and found.parts[1].row(0) == 2101
    (cut,) = found.cuts
    assert (cut.channel, cut.row, cut.rows) == ("time", 2101, 0) and "a gap of 0.016 s" in cut.what


def test_clocks_that_begin_again_are_two_parts(log):
    twice = Log("two", *(np.concatenate([part, part]) for part in (log.time, log.voltage, log.position)))
    found = check(twice, PENDULUM)
    assert [len(part) for part in found.parts] == [5000, 5000]
    assert "goes back" in found.cuts[0].what


def test_a_log_with_little_left_is_refused_and_says_how_much_is_needed(log):
    position = log.position.copy()
    for row in range(5):
        position[row::150] = np.nan
    found = check(replace(log, position=position), PENDULUM)
    assert not found.parts and {fault.channel for fault in found.faults} == {"position1", "time"}
    assert "33 more" in found.faults[0].what
    assert "145 rows over 0.288 s" in found.faults[1].what and "1 s at least" in found.faults[1].what


def test_stamps_that_stand_still_from_some_row_on_are_left_out(log):
    # as of a counter that is full: most times repeat, and the median step is none
    found = check(replace(log, time=np.minimum(log.time, log.time[1800])), PENDULUM)
    assert [len(part) for part in found.parts] == [1801] and not found.faults
    (cut,) = found.cuts
    assert (cut.channel, cut.row) == ("time", log.row(1801)) and "time is repeated" in cut.what
    found = check(replace(log, time=np.full(len(log), 3.5)), PENDULUM)
    assert not found.parts and "too short: 5000 rows over 0 s" in found.faults[0].what


def test_a_channel_that_nothing_needs_may_have_rows_without_a_number(log):
    current = np.full_like(log.position, np.nan)
    found = check(replace(log, current=current), PENDULUM)
    assert not found.cuts and found.parts[0].current is None and "current" in found.notes[0]


@pytest.mark.long
def test_single_rows_may_be_gone_all_over_a_log(log, whole):
    """Split at each of them, such a log had no part of a second, and was refused."""
    position = log.position.copy()
    position[::150] = np.nan
    found = explain(replace(log, position=position), plant="pendulum")
    (effect,), (of_whole,) = found.effects, whole.effects
    assert effect.name == of_whole.name == "coulomb_friction" and found.verdict == whole.verdict
    torque, expected = effect.parameters["torque"], of_whole.parameters["torque"]
    assert abs(torque.value - expected.value) < 0.1 * (expected.high - expected.low)


@pytest.mark.thorough
def test_the_same_answer_with_rows_lost(log, whole):
    rows = np.r_[0:1400, 1412:5000]
    hurt = with_rows(log, rows)
    position = hurt.position.copy()
    position[3000:3003] = np.nan
    position[3700] += 0.4
    hurt = replace(hurt, position=position, name="hurt")
    cut = explain(hurt, plant="pendulum")
    assert {(fault.channel, fault.row, fault.rows) for fault in cut.cuts} == {("time", 1401, 0), ("position1", 3001, 3)}
    assert "1 more" in next(fault.what for fault in cut.cuts if fault.channel == "position1")
    for found in (whole, cut):
        (effect,) = found.effects
        assert (
            effect.name == "coulomb_friction"
            and effect.parameters["torque"].low < 0.05 < effect.parameters["torque"].high
        )
    assert cut.logs == ("hurt",)
    refused = explain(hurt, plant="pendulum", strict=True)
    assert refused.verdict == "DATA_FAULT" and refused.faults == cut.cuts and refused.cuts == ()


PLAIN = of_friction()
