# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The schedule of the steps: nothing lost, nothing early, whatever the clock does."""

from __future__ import annotations

import math
import random

import pytest

from puma_sim_ros.node.pacing import Lateness, Pacer

PERIOD_NS = 28_000_000


class Clock:
    """A clock that a test moves."""

    def __init__(self, now: int = 123_456_789) -> None:
        self.now = now

    def __call__(self) -> int:
        return self.now


def steps_due(pacer: Pacer) -> int:
    done = 0
    while pacer.remaining() == 0.0:
        pacer.begin_step()
        done += 1
    return done


def test_no_step_is_early_and_each_deadline_gives_one():
    clock = Clock()
    pacer = Pacer(PERIOD_NS, clock=clock)
    assert steps_due(pacer) == 0
    start = clock.now
    for step in range(1, 1001):
        clock.now = start + step * PERIOD_NS - 1
        assert steps_due(pacer) == 0
        clock.now += 1
        assert steps_due(pacer) == 1
    assert pacer.steps == 1000
    assert pacer.overruns == 0
    assert pacer.lateness.worst == 0.0


@pytest.mark.parametrize("factor", [0.1, 1.0, 3.0, 17.7])
def test_random_lateness_loses_no_step(factor):
    clock = Clock()
    pacer = Pacer(PERIOD_NS, factor, clock)
    start, rng = clock.now, random.Random(1)
    for _ in range(3000):
        clock.now += int(rng.expovariate(1.0) * PERIOD_NS / factor)
        steps_due(pacer)
        assert pacer.steps == math.floor((clock.now - start) * factor / PERIOD_NS)


def test_a_stall_is_caught_up_and_each_overrun_counted():
    clock = Clock()
    pacer = Pacer(PERIOD_NS, clock=clock)
    clock.now += int(5.5 * PERIOD_NS)
    assert steps_due(pacer) == 5
    # the deadlines 1 to 4 were a period or more ago, the fifth half a period
    assert pacer.overruns == 4
    assert pacer.lateness.worst == pytest.approx(4.5 * PERIOD_NS * 1e-9)
    clock.now += PERIOD_NS // 2
    assert steps_due(pacer) == 1
    assert pacer.overruns == 4


def test_rounding_does_not_add_up():
    clock = Clock()
    pacer = Pacer(PERIOD_NS, 3.0, clock)
    start = clock.now
    for _ in range(100_000):
        clock.now += math.ceil(pacer.remaining() * 1e9)
        if pacer.remaining() > 0.0:
            clock.now += 1
        pacer.begin_step()
    assert abs(clock.now - start - 100_000 * PERIOD_NS / 3.0) < 10


def test_a_pause_is_not_caught_up():
    clock = Clock()
    pacer = Pacer(PERIOD_NS, clock=clock)
    clock.now += 10 * PERIOD_NS
    pacer.restart()
    assert steps_due(pacer) == 0
    assert pacer.remaining() == pytest.approx(PERIOD_NS * 1e-9)


def test_a_new_pace_counts_from_the_present_deadline():
    clock = Clock()
    pacer = Pacer(PERIOD_NS, 1.0, clock)
    clock.now += PERIOD_NS + 1000
    assert steps_due(pacer) == 1
    pacer.real_time_factor = 2.0
    clock.now += PERIOD_NS // 2 - 1001
    assert steps_due(pacer) == 0
    clock.now += 1
    assert steps_due(pacer) == 1


@pytest.mark.parametrize("factor", [0.0, -1.0, math.nan, math.inf])
def test_a_pace_that_is_not_positive_and_finite_is_refused(factor):
    pacer = Pacer(PERIOD_NS, clock=Clock())
    with pytest.raises(ValueError, match="above 0"):
        pacer.real_time_factor = factor
    assert pacer.real_time_factor == 1.0


def test_quantiles_are_those_of_the_sorted_values_within_a_bin():
    rng = random.Random(2)
    values = [int(10 ** rng.uniform(2, 9)) for _ in range(5000)]
    lateness = Lateness()
    for value in values:
        lateness.add(value)
    values.sort()
    for fraction in (0.01, 0.5, 0.9, 0.99, 1.0):
        exact = values[max(1, math.ceil(fraction * len(values))) - 1] * 1e-9
        found = lateness.quantile(fraction)
        assert exact <= found * (1 + 1e-12)
        assert found <= max(exact * 2 ** (1 / 16), 1e-6) * (1 + 1e-12)
    assert lateness.worst == values[-1] * 1e-9


def test_no_step_has_no_lateness():
    assert Lateness().quantile(0.99) == 0.0
