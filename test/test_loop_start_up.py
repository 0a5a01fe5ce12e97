# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The start of a log in which the machine does not answer to its input is left out, and nothing else is."""

from dataclasses import replace
from types import SimpleNamespace

import loop_logs
import numpy as np
import pytest
from loop_logs import SECONDS, record

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify import explain
from puma_sim_core.identify.checks.start_up import held_starts
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.settings import CHECKS
from puma_sim_core.plant.mechanism_file import load_mechanism

STEP = 0.01
PENDULUM = load_mechanism("pendulum")


def held(*sizes, begin=0.0, place=0.0, rows=600, joint=1, joints=2, first=1):
    """What is left out of logs whose innovations are so many times as large, from a time until so many seconds."""
    logs, errors = [], []
    for n, (size, until) in enumerate(sizes):
        time = 3.0 + STEP * np.arange(rows + 1)
        blank = np.zeros((rows + 1, joints))
        position = np.where(time[:, None] - time[0] < until, place, blank)
        logs.append(Log(f"log{n}", time, blank, position, rows=first + np.arange(rows + 1)))
        e = np.random.default_rng(n).standard_normal((rows, joints))
        passed = time[1:] - time[0]
        e[(passed >= begin) & (passed < until), joint] *= size
        errors.append(e)
    predictor = SimpleNamespace(stretches=[SimpleNamespace(time=log.time) for log in logs])
    return held_starts(logs, predictor, np.concatenate(errors))


def test_rows_up_to_the_last_window_that_is_worse_than_any_later_one_are_left_out():
    (fault,) = held((20.0, 0.5))
    assert (fault.channel, fault.row) == ("position2", 1)
    assert fault.rows * STEP == pytest.approx(0.5, abs=CHECKS.start_window + STEP)


@pytest.mark.parametrize(
    "size, until",
    [
        (1.0, 0.0),
        # large at the start, but no larger than by chance later
        (1.3, 0.5),
        # the predictor settles by itself
        (50.0, 0.2),
        # an effect that goes on acting
        (20.0, 6.0),
    ],
)
def test_what_may_be_chance_or_an_effect_is_no_start(size, until):
    assert held((size, until)) == [None]


def test_a_part_behind_a_gap_has_no_start_of_its_own():
    assert held((20.0, 0.5), first=41) == [None]


def test_a_start_in_a_place_that_the_log_does_not_come_to_again_stays():
    """A stop that the joint is pressed in at first."""
    assert held((20.0, 0.5), place=0.1) == [None]


def test_an_impact_a_little_later_is_no_start():
    assert held((20.0, 0.6), begin=0.5) == [None]


def test_a_log_that_is_hardly_longer_than_a_start_is_left_whole():
    assert held((20.0, 0.5), rows=int((CHECKS.start_longest + CHECKS.start_beside) / STEP) - 2) == [None]


def test_each_log_has_a_start_of_its_own():
    found = held((1.0, 0.0), (20.0, 0.6), (20.0, 0.4), joint=0)
    assert found[0] is None and [fault.channel for fault in found[1:]] == ["position1"] * 2
    assert found[1].rows > found[2].rows > 0.3 / STEP


def of_friction(off=0.0):
    """A log of a pendulum with dry friction whose drive is off for so many seconds, which the log does not say."""
    plant = PENDULUM.plant(PENDULUM.start * 1.02, (parse_effect("coulomb_friction:joint=1,torque=0.05"),))
    enable = (np.arange(0.0, SECONDS, loop_logs.STEP) >= off).astype(float)
    return replace(record(PENDULUM, plant, volts=0.05, noise=2e-4, enable=enable), enable=None)


@pytest.mark.thorough
def test_a_drive_that_is_off_at_first_leaves_the_answer_of_the_rest():
    log = of_friction(0.5)
    found = explain(log, plant="pendulum")
    (cut,) = found.cuts
    assert (cut.channel, cut.row) == ("position1", 1)
    assert log.time[cut.rows] == pytest.approx(0.5, abs=0.12)
    (effect,) = found.effects
    assert (effect.name, effect.joint) == ("coulomb_friction", 1)
    assert effect.parameters["torque"].low < 0.05 < effect.parameters["torque"].high
    # the same rows, where nobody wrote the others down
    alone = explain(log.part(slice(cut.rows, None)), plant="pendulum")
    assert [e.parameters for e in alone.effects] == [e.parameters for e in found.effects]
    assert not alone.cuts
    # and a held-out log is read without its start, too
    found = explain(of_friction(), held_out=[replace(log, name="beside")], plant="pendulum")
    assert any("beside is read without: position1, does not answer" in note for note in found.notes)
    tables = found.errors
    assert tables["held_out_logs"].voltage_rms.augmented < 1.5 * tables["fit"].voltage_rms.augmented


@pytest.mark.long
def test_a_strict_reading_refuses_such_a_start():
    found = explain(of_friction(0.5), plant="pendulum", strict=True)
    assert found.verdict == "DATA_FAULT" and found.faults[0].channel == "position1"
    assert "does not answer to its input" in found.sentence
