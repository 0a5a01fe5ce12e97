# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""When the positions of a log were read: at their stamps, or a row before."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loop_logs import record

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify import explain
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.data.late_stamps import bends, read_in_time
from puma_sim_core.identify.data.log import Log
from puma_sim_core.plant.mechanism_file import load_mechanism

PENDULUM = load_mechanism("pendulum")
STEP, ENCODER = 2e-3, 4e-4


def loops(late: dict[int, float], rows: int = 3000) -> np.ndarray:
    """(rows + 1,) instants at which loops begin; some take longer, by so many seconds."""
    steps = np.full(rows, STEP)
    steps[list(late)] += list(late.values())
    return np.concatenate([[0.0], np.cumsum(steps)])


def motion(time: np.ndarray) -> np.ndarray:
    """(n, 2) readings of two encoders at some times."""
    q = np.column_stack([np.sin(7.0 * time), 0.8 * np.cos(5.0 * time) + 0.1 * np.sin(31.0 * time)])
    return ENCODER * np.round(q / ENCODER)


#: late rows apart from each other: of several in turn that are as late only the first and the last are uneven
LATE = st.dictionaries(st.integers(1, 598).map(lambda k: 5 * k), st.floats(2e-3, 8e-3), min_size=12, max_size=60)


@given(LATE)
def test_positions_of_the_begin_of_a_loop_are_taken_at_that_time(late):
    begin = loops(late)
    volts = np.random.default_rng(0).standard_normal((3000, 2))
    found = read_in_time(Log("log", begin[1:], volts, motion(begin[:-1]), setpoint=volts))
    if found.notes:
        np.testing.assert_array_equal(found.position, motion(found.time))
        assert found.row(0) == 2
        # commands hold from their own stamp on
        np.testing.assert_array_equal(found.voltage, volts[:-1])
        np.testing.assert_array_equal(found.setpoint, volts[:-1])
        assert "at the begin of a row" in found.notes[0] and len(found) == 2999
    else:
        # few late rows may lie where nothing moves
        assert len(late) < 40 and len(found) == 3000


@given(LATE)
def test_positions_that_are_read_at_their_stamps_stay(late):
    time = loops(late)[1:]
    log = Log("log", time, np.zeros((3000, 2)), motion(time))
    assert read_in_time(log) is log


@given(LATE, st.integers(0, 100))
def test_stamps_that_jitter_about_an_even_clock_stay(late, seed):
    stamps = STEP * np.arange(3000) + np.random.default_rng(seed).uniform(0.0, 0.4 * STEP, 3000)
    log = Log("log", stamps, np.zeros((3000, 2)), motion(STEP * np.arange(3000)))
    assert read_in_time(log) is log


@pytest.mark.parametrize("rows", [1, 2, 3, 4, 5])
def test_few_rows_stay(rows):
    time = loops({2: 8e-3})
    log = Log("log", time[1 : rows + 1], np.zeros((rows, 2)), motion(time)[:rows])
    assert read_in_time(log) is log


def test_rows_without_numbers_and_stamps_that_stand_do_not_hide_the_late_ones():
    begin = loops(dict.fromkeys(range(100, 2900, 50), 4e-3))
    position, stamps = motion(begin[:-1]), begin[1:].copy()
    position[700], stamps[1200], stamps[2000] = np.nan, stamps[1199], np.nan
    found = read_in_time(Log("log", stamps, np.zeros((3000, 2)), position))
    assert found.notes and np.array_equal(found.position, position[1:], equal_nan=True)
    nothing = Log("log", stamps, np.zeros((3000, 2)), np.full((3000, 2), np.nan))
    assert read_in_time(nothing) is nothing


def test_bends_are_those_of_the_line_between_neighbours():
    time = np.array([0.0, 1.0, 3.0, 4.0])
    np.testing.assert_allclose(bends(time, np.array([[0.0], [2.0], [3.0], [3.0]])), [[1.0], [1.0 / 3.0]])


@pytest.mark.long
def test_a_log_that_is_stamped_late_gives_the_answer_of_one_that_is_not():
    """Seen on a measured double pendulum: at each late row the motion seemed to jump, and the log was cut there."""
    late = dict.fromkeys(range(200, 4900, 150), 4e-3)
    begin = loops(late, 5000)
    plant = PENDULUM.plant(PENDULUM.start * 1.02, (parse_effect("coulomb_friction:joint=1,torque=0.05"),))
    log = record(PENDULUM, plant, volts=0.05, noise=2e-4, time=begin)
    # row k has the position of the begin of its loop, and the stamp of its end
    stamped = replace(
        log, time=log.time[1:], position=log.position[:-1], voltage=log.voltage[1:], rows=log.rows[:-1], name="late"
    )
    (part,) = check(stamped, PENDULUM).parts
    np.testing.assert_array_equal(part.position, log.position[1:-1])
    found, whole = (explain(each, plant="pendulum") for each in (stamped, log))
    (effect,), (of_whole,) = found.effects, whole.effects
    assert effect.name == of_whole.name == "coulomb_friction" and found.verdict == whole.verdict
    torque, expected = effect.parameters["torque"], of_whole.parameters["torque"]
    assert abs(torque.value - expected.value) < 0.1 * (expected.high - expected.low)
    assert any("at the begin of a row" in note for note in found.notes)
