# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs whose stamps come in ticks longer than a row: read as what they are, refused where they are something else."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from loop_logs import record

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify import explain
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.data.coarse_clock import evenly_stamped
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.overview import overview
from puma_sim_core.plant.mechanism_file import load_mechanism

PENDULUM = load_mechanism("pendulum")


@pytest.fixture(scope="module")
def log() -> Log:
    plant = PENDULUM.plant(PENDULUM.start * 1.02, (parse_effect("coulomb_friction:joint=1,torque=0.05"),))
    return record(PENDULUM, plant, volts=0.05, noise=2e-4)


def in_ticks(time, tick, digits=9):
    return np.round(np.floor(time / tick + 1e-9) * tick, digits)


@given(
    st.floats(5e-4, 8e-3),
    st.floats(1.3, 12.0),
    st.floats(0.0, 30.0),
    st.sampled_from([4, 6, 9]),
    st.integers(400, 3000),
)
def test_times_of_an_even_clock_come_back_whatever_its_ticks(step, ratio, start, digits, rows):
    tick = round(ratio * step, digits)
    time = start + step * np.arange(rows)
    shown = in_ticks(time, tick, digits)
    assume(len(np.unique(shown)) >= 40)
    position = np.sin(3.0 * time)[:, None]
    found = evenly_stamped(Log("log", shown, position, position))
    assert len(found.notes) == 1 and "the stamps repeat" in found.notes[0]
    # a clock that is early or late as a whole changes nothing
    assert np.ptp(found.time - time) < 0.15 * tick
    assert np.diff(found.time) == pytest.approx(step, rel=0.01)


@pytest.mark.thorough
def test_such_a_log_is_used_whole_and_has_the_answer_of_its_true_times(log):
    shown = replace(log, time=in_ticks(log.time, 0.01))
    assert "a row every 2 ms (at most 2)" in overview(shown, PENDULUM).lines("rad")[0]
    found = check(shown, PENDULUM)
    assert [len(part) for part in found.parts] == [len(log)] and not found.faults and not found.cuts
    answers = [explain(each, plant="pendulum", strict=True) for each in (log, shown)]
    assert any("the stamps repeat" in note for note in answers[1].notes)
    for answer in answers:
        (effect,) = answer.effects
        torque = effect.parameters["torque"]
        assert effect.name == "coulomb_friction" and torque.low < 0.05 < torque.high


@pytest.mark.parametrize(
    "change",
    [
        # positions that were read once a tick
        lambda log, time: replace(log, time=time, position=log.position[np.searchsorted(time, time)]),
        # rows that did not come evenly
        lambda log, time: replace(log, time=in_ticks(log.time + 0.004 * np.sin(log.time), 0.005)),
        # a clock that stands for a while
        lambda log, time: replace(log, time=np.where((time > 2.0) & (time < 2.1), 2.0, time)),
        # rows that are missing
        lambda log, time: replace(log, time=np.where(time > 3.0, time + 0.05, time)),
        # a clock that goes back
        lambda log, time: replace(log, time=np.where(time > 3.0, time - 1.0, time)),
    ],
)
def test_other_stamps_stay_as_they_are(log, change):
    changed = change(log, in_ticks(log.time, 0.01))
    assert evenly_stamped(changed) is changed
    assert check(changed, PENDULUM).faults


def test_times_that_increase_stay_as_they_are(log):
    assert evenly_stamped(log) is log
    once = replace(log, time=np.where(np.arange(len(log)) == 700, log.time[699], log.time))
    assert evenly_stamped(once) is once
