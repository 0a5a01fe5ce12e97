# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Sections 7.6 and 7.7: what the experiments say holds, and their parts do what they claim."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD
from puma_sim_core.thesis import chapter_7_7 as search
from puma_sim_core.thesis.motions import CASES, UPRIGHT, path, printed_pid, run
from puma_sim_core.thesis.registry import Context, find
from puma_sim_core.tuning.ziegler_nichols import settings

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(BACKEND != "numba", reason="minutes of simulated time: compiled kernel only"),
]
OWN, THESIS = "gains of the corrected model", "thesis's gains"


@cache
def result(number):
    (found,) = find(number)
    return found.run(Context())


@pytest.mark.parametrize(
    "number, plots",
    [("7.7.1", {"7.17", "7.18"}), ("7.7.2", {"7.19", "7.20"}), ("7.7.3", {"7.21"}), ("7.7.4", {"7.22"})],
)
def test_every_plot_is_redrawn(number, plots):
    figures = {figure.key: figure for figure in result(number).figures}
    assert plots <= set(figures)
    for key in plots:
        assert len(figures[key].curves) >= 3
        assert all(np.isfinite(curve.y).all() for curve in figures[key].curves)


def test_every_printed_ultimate_gain_has_its_row():
    rows = {row.quantity: row for row in result("7.6").rows}
    for case in CASES:
        gain, period = rows[f"Kmax, {case.name}"], rows[f"Tp, {case.name}"]
        assert (gain.printed, period.printed) == (case.printed.gain, case.printed.period)
        assert "Does not reproduce" in gain.note and "Does not reproduce" in period.note


def test_the_two_methods_agree_in_the_experiment():
    numbers = result("7.6").numbers
    for exact, simulated in (
        ("ultimate_gain", "ultimate_gain_simulated"),
        ("ultimate_period", "ultimate_period_simulated"),
    ):
        np.testing.assert_allclose(numbers[simulated], numbers[exact], rtol=0.03)


def test_one_pid_cannot_serve_joint_1():
    # what the map says of two poses, by simulation: steps of a milliradian, no limits
    plant = Plant.of()
    upright, horizontal = CASES[0], CASES[1]
    gains = settings(upright.ultimate(plant))
    for case, grows in ((upright, False), (horizontal, True)):
        by = np.array([1e-3, 0.0, 0.0])
        record = run(
            plant, [gains] * 3, case.pose, path(case.pose, ((0.1, 0.0, by),), 4.0), alone=1, voltage_limit=np.inf
        )
        error = np.abs(record.position[:, 0] - 1e-3)
        n = len(error) // 4
        assert (error[-n:].max() > error[-2 * n : -n].max()) == grows
    assert 0.0 < result("7.7.1").numbers["7.7.1-fixed-7.17_unstable_share"] < 1.0
    assert result("7.7.1").numbers["7.7.1-fixed-7.18_unstable_share"] == 0.0


# ------------------------------------------------------------------------------------------ 7.7.4


def signal(before, after, period, step=0.001, seconds=16.0):
    time = np.arange(0.0, seconds, step)
    size = np.where(time < 0.75 * seconds, before, after)
    y = size * np.sin(2 * np.pi * time / period)
    return SimpleNamespace(time=time, position=np.stack([y, 0.5 * y, 0.0 * y], axis=1))


def test_tail_measures_amplitude_and_period():
    found = search.tail(signal(0.02, 0.02, 0.35), 0.001)
    assert found.sustained and found.after == pytest.approx((0.02, 0.01, 0.0), rel=1e-3)
    assert found.period == pytest.approx(0.35, rel=1e-3)
    assert not search.tail(signal(0.02, 0.005, 0.35), 0.001).sustained
    assert not search.tail(signal(0.02, 0.02, 40.0), 0.001).sustained
    assert str(search.tail(signal(0.0, 0.0, 1.0), 0.001)) == "dies out"


def test_at_the_stated_rate_nothing_sustains_it_with_the_printed_gains():
    numbers = result("7.7.4").numbers
    loud = [m.name for m in search.MECHANISMS if m.name not in numbers["quiet_with_the_thesis_gains"]]
    assert loud == ["sampled each 50 ms, one sample of delay"]
    assert numbers[f"{THESIS} | {loud[0]} | ramps"][4] is True
    assert numbers[f"{THESIS} | {loud[0]} | ramps | alone"] == [3]


def test_a_short_delay_and_the_coupling_make_a_limit_cycle_with_our_own_gains():
    numbers = result("7.7.4").numbers
    *alone, together = numbers[f"{OWN} | delay borne alone, together"]
    assert min(alone) > together
    for delay in range(1, min(alone) + 1):
        name = next(m.name for m in search.MECHANISMS if m.delay == delay and m.name.startswith("delay"))
        assert numbers[f"{OWN} | {name} | ramps"][4] == (delay > together)
        if delay > together:
            assert numbers[f"{OWN} | {name} | ramps | alone"] == []


def test_the_amplifier_bounds_that_limit_cycle():
    gains = search.gains_of(Plant.of(), SERVO_PERIOD, 0)
    late = next(m for m in search.MECHANISMS if m.delay == 3)
    record = search.attempt(late, gains, "ramps", duration=4.0)
    end = record.time > 3.0
    assert np.abs(record.voltage[end]).max() == 40.0
    assert np.ptp(record.position[end, 0]) < 0.1


def test_delay_borne_is_where_the_simulated_arm_begins_to_oscillate():
    gains = search.gains_of(Plant.of(), SERVO_PERIOD, 0)
    borne = search.greatest_delay(Plant.of(), gains, (1, 2, 3))
    for delay, sustained in ((borne, False), (borne + 1, True)):
        start = np.array(UPRIGHT)
        record = run(
            Plant.of(), gains, start, path(start, ((0.1, 0.0, [1e-3] * 3),), 12.0), servo={"delay_samples": delay}
        )
        assert search.tail(record, SERVO_PERIOD).sustained == sustained


def test_moves_sum_up_in_a_path():
    setpoint = path((1.0, 0.0, 0.0), ((1.0, 0.0, (0.5, 0.0, 0.0)), (0.0, 2.0, (0.0, 0.0, 2.0))), 4.0, 0.02)
    assert setpoint.shape == (200, 3)
    np.testing.assert_array_equal(setpoint[[49, 50], 0], [1.0, 1.5])
    np.testing.assert_allclose(setpoint[[50, 150], 2], [1.01, 2.0])
    assert [g.gain for g in printed_pid("7.17", "7.21")] == [90.0, 162.0]
