# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Identification of a controller: what it finds, how sure it is, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from controller_records import COUNT, VOLT_STEP, H, record

from puma_sim_core.errors import ParameterError, RecordingError
from puma_sim_core.servo.pid import PidGains, recursive_coefficients
from puma_sim_core.tuning.bounded_error import Enclosure
from puma_sim_core.tuning.controller_log import ControllerLog, lattice_step
from puma_sim_core.tuning.least_squares import RecursiveLeastSquares
from puma_sim_core.tuning.pid_identification import compare_gains, identify_pid
from puma_sim_core.tuning.transfer_function import METHODS, identify_transfer_function, implied_gains, poles

pytestmark = pytest.mark.long
GAINS = (137.0, 0.315, 0.032)
EXACT = {"count": 0.0, "volt_step": 0.0}


def values(found):
    return found.gain.value, found.integral_time.value, found.derivative_time.value


def intervals(found):
    return found.gain, found.integral_time, found.derivative_time


# --------------------------------------------------------------------- recursive least squares


@pytest.mark.parametrize("forgetting", [1.0, 0.99])
def test_the_recursion_gives_the_batch_after_any_row(forgetting):
    rng = np.random.default_rng(1)
    # columns of very different size, as the error and its sum are
    rows = rng.standard_normal((60, 4)) * [1.0, 1e4, 1e-4, 1.0]
    values = rng.standard_normal(60)
    recursion = RecursiveLeastSquares(4, forgetting)
    for n, (row, value) in enumerate(zip(rows, values), start=1):
        recursion.update(row, value)
        if n in (4, 5, 17, 60):
            w = np.sqrt(forgetting ** np.arange(n - 1, -1, -1))
            batch = np.linalg.lstsq(w[:, None] * rows[:n], w * values[:n], rcond=1e-14)[0]
            assert recursion.estimate == pytest.approx(batch, rel=1e-8)
    together = RecursiveLeastSquares(4, forgetting)
    together.update(rows[:23], values[:23])
    together.update(rows[23:], values[23:])
    assert together.estimate == pytest.approx(recursion.estimate, rel=1e-9)
    weighted = rows * forgetting ** (0.5 * np.arange(59, -1, -1))[:, None]
    assert recursion.information == pytest.approx(weighted.T @ weighted, rel=1e-9)


def test_the_recursion_says_when_rows_do_not_determine_the_parameters():
    recursion = RecursiveLeastSquares(2)
    for _ in range(5):
        recursion.update([1.0, 2.0], 3.0)
    assert not recursion.determined
    with pytest.raises(ParameterError, match="5 rows do not determine 2 parameters"):
        recursion.estimate
    for bad in (
        {"rows": [1.0], "values": 1.0},
        {"rows": [1.0, np.nan], "values": 1.0},
        {"rows": [[1.0, 2.0]], "values": [1.0, 2.0]},
    ):
        with pytest.raises(ParameterError, match="expected"):
            recursion.update(**bad)
    for factor in (0.0, -0.5, 1.01, "1"):
        with pytest.raises(ParameterError, match="forgetting factor"):
            RecursiveLeastSquares(2, factor)


# ------------------------------------------------------------------------------- exact records


@pytest.mark.parametrize("gains", [GAINS, (900.0, 0.2, 0.01), (20.0, 3.0, 0.002)])
@pytest.mark.parametrize("on_measurement", [False, True])
def test_without_rounding_the_gains_are_exact(gains, on_measurement):
    found = identify_pid(record(gains, 1, on_measurement=on_measurement, **EXACT))
    assert values(found) == pytest.approx(gains, rel=1e-9)
    assert found.derivative == ("measurement" if on_measurement else "error")
    assert all(g in i for g, i in zip(gains, intervals(found)))
    assert not found.rounding_only and found.residual < 1e-10


def test_the_coefficients_and_forms_agree_with_the_controllers_own():
    log = record(GAINS, 2, **EXACT)
    velocity, positional = identify_pid(log, form="velocity"), identify_pid(log)
    q = recursive_coefficients(PidGains(*values(velocity)), H)
    assert velocity.coefficients == pytest.approx(q, rel=1e-9)
    assert positional.coefficients == velocity.coefficients
    assert implied_gains(q, H) == pytest.approx(values(velocity), rel=1e-6)
    # the law that the coefficients stand for gives the next voltage
    e, u = log.error, log.voltage
    predicted = u[1:-1] + np.array(q) @ [e[2:], e[1:-1], e[:-2]]
    assert predicted == pytest.approx(u[2:], abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("order", [1, 2])
def test_a_free_denominator_is_found_exactly_without_rounding(method, order):
    found = identify_transfer_function(record(GAINS, 3, **EXACT), order=order, method=method)
    a = [c.value for c in found.denominator]
    assert a == pytest.approx([-1.0, 0.0][:order], abs=1e-7)
    assert found.poles[0] == pytest.approx(1.0, abs=1e-6)
    assert found.coefficients == pytest.approx(identify_pid(record(GAINS, 3, **EXACT)).coefficients, rel=1e-6)


def test_poles_are_the_roots_of_the_denominator():
    assert poles([-1.3, 0.4]) == pytest.approx((0.8, 0.5))
    assert {round(z.imag, 12) for z in poles([0.0, 0.25])} == {0.5, -0.5}


# ----------------------------------------------------------------------------- rounded records


def test_the_rounding_of_a_record_is_seen():
    found = identify_pid(record(GAINS, 0))
    assert found.rounding_only
    assert found.voltage_step == pytest.approx(VOLT_STEP, rel=1e-9)
    assert found.position_step == pytest.approx(COUNT, rel=1e-9)
    assert found.residual == pytest.approx(VOLT_STEP / 12.0**0.5, rel=0.05)
    assert not identify_pid(record(GAINS, 0, noise=0.01)).rounding_only


@pytest.mark.parametrize(
    "gains", [GAINS, (137.0, 0.315, 0.0), (20.0, 3.0, 0.002), (900.0, 0.2, 0.01), (50.0, 1e9, 0.005)]
)
@pytest.mark.parametrize("amplitude", [0.006, 0.001])
def test_with_rounding_alone_the_intervals_always_hold(gains, amplitude):
    """Also where a sample moves the voltage by less than a step: no statistics are in them."""
    for seed in range(5):
        found = identify_pid(record(gains, seed, amplitude=amplitude, samples=1536))
        assert found.rounding_only
        assert all(gain in interval for gain, interval in zip(gains, intervals(found))), found


def test_certain_intervals_close_in_as_the_record_grows():
    short, long = (identify_pid(record(GAINS, 1, samples=n)) for n in (512, 4096))
    for a, b, true in zip(intervals(short), intervals(long), GAINS):
        assert b.high - b.low < (a.high - a.low) / 2.0
        assert b.high - b.low < 0.002 * true


def test_the_intervals_of_least_squares_cover_as_often_as_they_say():
    """Of 200 records; three standard deviations of such a share are 0.046."""
    hits = np.zeros(3)
    for seed in range(200):
        found = identify_pid(record(GAINS, 1000 + seed, samples=2048), derivative="error", bounds=False)
        hits += [gain in interval for gain, interval in zip(GAINS, found.least_squares)]
    assert ((hits / 200 > 0.95 - 0.046) & (hits / 200 < 0.95 + 0.046)).all(), hits / 200


def test_the_intervals_hold_with_noise_that_is_not_rounding():
    hits = np.zeros(3)
    for seed in range(100):
        found = identify_pid(
            record(GAINS, 2000 + seed, samples=1024, noise=0.05), bounds=False, derivative="error", confidence=0.9
        )
        hits += [gain in interval for gain, interval in zip(GAINS, intervals(found))]
    assert ((hits > 80) & (hits < 99)).all(), hits


def test_a_free_denominator_is_biased_by_rounding_and_instruments_take_the_bias_away():
    def gains_of(log, method):
        found = identify_transfer_function(log, method=method)
        return implied_gains(found.coefficients, log.period)[:2]

    logs = [record(GAINS, 3000 + seed) for seed in range(24)]
    free, instruments = (np.array([gains_of(log, method) for log in logs]) for method in METHODS)
    known = np.array([values(identify_pid(log, form="velocity", bounds=False))[:2] for log in logs])
    true = np.array([GAINS[0] * (1.0 + H / GAINS[1]), GAINS[1] + H])
    off = {
        name: (found.mean(axis=0) / true - 1.0, found.std(axis=0) / true / 24**0.5)
        for name, found in (("free", free), ("instruments", instruments), ("known", known))
    }
    # Kg and 1/Ti too great, by far more than chance
    assert off["free"][0][0] > 5.0 * off["free"][1][0] > 0.0
    assert off["free"][0][1] < -5.0 * off["free"][1][1]
    for name in ("instruments", "known"):
        assert (np.abs(off[name][0]) < 4.0 * off[name][1]).all(), off
    # and what is known of the denominator is worth a factor of ten
    assert (10.0 * off["known"][1] < off["instruments"][1]).all(), off


def test_a_controller_without_integral_action_has_no_upper_end_of_its_integral_time():
    found = identify_pid(record((137.0, 1e9, 0.032), 4))
    assert found.integral_time.value == found.integral_time.high == np.inf
    assert found.integral_time.low > 10.0
    noisy = identify_pid(record((137.0, 1e9, 0.032), 4, noise=0.02))
    assert noisy.integral_time.value == noisy.integral_time.high == np.inf
    found = identify_pid(record((137.0, 0.315, 0.0), 4))
    assert found.derivative_time.low == 0.0 and found.derivative_time.high < 1e-4


def test_with_a_forgetting_factor_the_end_of_the_record_counts():
    later = (160.0, 0.25, 0.025)
    log = record(GAINS, 5, changed=later, volt_step=0.0)
    assert values(identify_pid(log, forgetting=0.98)) == pytest.approx(later, rel=1e-3)
    whole = identify_pid(record(GAINS, 5, changed=later))
    assert abs(whole.gain.value / 160.0 - 1.0) > 0.01 and not whole.rounding_only


def test_samples_at_the_limit_are_left_out():
    log = record((300.0, 0.1, 0.02), 6, limit=14.0, amplitude=0.03)
    assert np.mean(np.abs(log.voltage) >= 14.0 - 2.0 * VOLT_STEP) > 0.02
    found = identify_pid(log, limit=14.0)
    assert found.saturated > 50
    assert values(found) == pytest.approx((300.0, 0.1, 0.02), rel=0.01)
    assert not identify_pid(log).rounding_only


def test_the_delay_of_a_controller_is_taken_out():
    log = record(GAINS, 7)
    late = replace(log, voltage=np.concatenate([np.zeros(2), log.voltage[:-2]]))
    assert values(identify_pid(late.with_delay(2))) == pytest.approx(GAINS, rel=5e-3)
    with pytest.raises(ParameterError, match="delay: samples -1; expected a whole number from 0"):
        late.with_delay(-1)


def test_steps_are_found_and_not_made_up():
    rng = np.random.default_rng(8)
    assert lattice_step(0.3 * rng.integers(-50, 50, 400)) == pytest.approx(0.3)
    assert lattice_step(0.25 * np.array([0, 2, 5, 7, 10, 2, 5])) == pytest.approx(0.25)
    assert lattice_step(rng.standard_normal(400)) == 0.0
    assert lattice_step(np.zeros(10)) == 0.0


def test_an_enclosure_has_the_corners_that_its_lines_cross_at():
    rng = np.random.default_rng(9)
    theta = np.array([2.0, 0.5])
    rows = rng.uniform(0.5, 3.0, (12, 2))
    values = np.round(rows @ theta / 0.1) * 0.1
    sides = [(row, v + s * 0.05) for row, v in zip(rows, values) for s in (-1, 1)]
    corners = []
    for (a, b), (c, d) in combinations(sides, 2):
        if abs(np.linalg.det([a, c])) > 1e-9:
            point = np.linalg.solve([a, c], [b, d])
            if (np.abs(rows @ point - values) <= 0.05 + 1e-9).all():
                corners.append(point)
    corners = np.array(corners)
    found = Enclosure(rows, values, 0.1)
    for along in ([1.0, 0.0], [0.0, 1.0], [1.0, -2.0]):
        ends = corners @ along
        assert found.ends(along) == pytest.approx((ends.min(), ends.max()), abs=1e-4)
    ratio = corners[:, 1] / corners[:, 0]
    assert found.ratio_ends([0.0, 1.0], [1.0, 0.0]) == pytest.approx((ratio.min(), ratio.max()), abs=1e-4)
    values[3] += 1.0
    assert Enclosure(rows, values, 0.1).is_empty()
    assert Enclosure(rows, values, 0.1).ends([1.0, 0.0]) is None


# ---------------------------------------------------------------------------- gain scheduling


def compared(first, second, seeds, samples=4096, **options):
    return [
        compare_gains(
            *(
                identify_pid(record(gains, seed + shift, samples=samples), derivative="error", **options)
                for gains, shift in ((first, 0), (second, 10_000))
            )
        )
        for seed in seeds
    ]


def test_equal_gains_are_seldom_called_different_by_chance():
    p = [c.p_value for c in compared(GAINS, GAINS, range(100), bounds=False)]
    # 5 % of 100 records, and three standard deviations more
    assert sum(value < 0.05 for value in p) <= 12
    assert sum(value < 0.01 for value in p) <= 4
    assert 0.3 < np.mean(p) < 0.7


def test_equal_gains_are_never_called_different_by_the_bounds():
    found = compared(GAINS, GAINS, range(500, 508), samples=1536)
    assert all(c.one_controller_possible and not c.different for c in found)


@pytest.mark.parametrize("other", [(138.4, 0.315, 0.032), (137.0, 0.318, 0.032), (137.0, 0.315, 0.0323)])
def test_a_change_of_a_hundredth_in_one_gain_is_found(other):
    by_chance = compared(GAINS, other, range(600, 630), bounds=False)
    assert all(c.one_controller_possible is None for c in by_chance)
    assert sum(c.different for c in by_chance) >= 27
    assert all(c.different and c.one_controller_possible is False for c in compared(GAINS, other, range(700, 703)))


def test_estimates_that_cannot_be_compared_are_refused():
    a = identify_pid(record(GAINS, 1), bounds=False)
    for other in (
        identify_pid(record(GAINS, 1), form="velocity", bounds=False),
        identify_pid(record(GAINS, 1, on_measurement=True), bounds=False),
        replace(a, period=2.0 * H),
    ):
        with pytest.raises(ParameterError, match="one period, one form and one kind"):
            compare_gains(a, other)
    with pytest.raises(ParameterError, match="level 1.5"):
        compare_gains(a, a, level=1.5)


# -------------------------------------------------------------------------- what is refused


def still(setpoint=0.0, voltage=0.0, samples=500):
    return ControllerLog(H, np.full(samples, setpoint), np.zeros(samples), np.zeros(samples) + voltage, "still")


def test_records_without_excitation_give_an_error_and_no_number():
    rest = still(0.001, VOLT_STEP * np.round(np.arange(500) * 0.01))
    with pytest.raises(RecordingError, match="still: no excitation: the error does not change"):
        identify_pid(rest)
    with pytest.raises(RecordingError, match="no excitation"):
        identify_transfer_function(rest)
    moving = record(GAINS, 1)
    with pytest.raises(RecordingError, match="the voltage does not change"):
        identify_pid(replace(moving, voltage=np.zeros(len(moving))))
    # a single sinusoid gives two numbers for three gains
    w = 2.0 * np.pi * 0.02 * np.arange(600)
    e = 0.01 * np.sin(w)
    sine = ControllerLog(H, e, np.zeros(600), 100.0 * e + 3.0 * np.cos(w), "sine")
    with pytest.raises(RecordingError, match="no sufficient excitation"):
        identify_pid(sine)


def test_a_joint_at_rest_under_control_is_refused_or_says_that_it_knows_little():
    """Counts that toggle excite a little: what is then said must be true."""
    log = record(GAINS, 11, amplitude=0.0)
    try:
        found = identify_pid(log)
    except RecordingError as error:
        assert "excitation" in str(error) or "not change" in str(error)
    else:
        assert GAINS[0] in found.gain


def test_voltages_of_something_else_are_refused():
    log = record(GAINS, 12)
    rng = np.random.default_rng(12)
    with pytest.raises(RecordingError, match="record 12: a PID leaves"):
        identify_pid(replace(log, voltage=rng.standard_normal(len(log))))
    with pytest.raises(RecordingError, match="Kg is negative"):
        identify_pid(replace(log, voltage=-log.voltage))
    with pytest.raises(RecordingError, match="4096 of 4096 samples at the limit of 40 V"):
        identify_pid(replace(log, voltage=np.where(log.error > 0.0, 40.0, -40.0)), limit=40.0)


@pytest.mark.parametrize(
    "options, says",
    [
        ({"form": "parallel"}, "form 'parallel'; expected positional or velocity"),
        ({"derivative": "none"}, "derivative 'none'"),
        ({"confidence": 1.0}, "confidence 1.0"),
        ({"forgetting": 0.0}, "forgetting factor"),
        ({"limit": 0.0}, "limit 0.0 V"),
    ],
)
def test_options_outside_their_range_are_refused(options, says):
    with pytest.raises(ParameterError, match=says):
        identify_pid(record(GAINS, 1, samples=300), **options)


def test_transfer_function_options_outside_their_range_are_refused():
    log = record(GAINS, 1, samples=300)
    for options in ({"order": 3}, {"method": "guess"}, {"confidence": 0.0}):
        with pytest.raises(ParameterError):
            identify_transfer_function(log, **options)
    for q in ((5.0, -9.0, 5.0), (3.0, -4.0, 1.0)):
        with pytest.raises(ParameterError, match="PID coefficients"):
            implied_gains(q, H)


def test_logs_that_are_not_columns_of_one_length_are_refused():
    for columns, says in (
        ((np.zeros(20), np.zeros(20), np.zeros(19)), "of shape"),
        ((np.zeros(5),) * 3, "5 samples"),
        ((np.full(20, np.nan), np.zeros(20), np.zeros(20)), "not finite"),
    ):
        with pytest.raises(RecordingError, match=says):
            ControllerLog(H, *columns)
    with pytest.raises(RecordingError, match="period 0"):
        ControllerLog(0.0, *(np.zeros(20),) * 3)
    with pytest.raises(ParameterError, match="step of the positions"):
        record(GAINS, 1, samples=300).with_counts(0.0)
