# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Metrics against responses that are known in closed form; ill-posed ones are named."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from puma_sim_core.control.metrics import effort, step_quality, tracking_error
from puma_sim_core.errors import ParameterError
from puma_sim_core.recording.recording import Recording

TIME = np.linspace(0.0, 20.0, 40001)


@given(st.floats(0.1, 2.0), st.floats(-5.0, 5.0), st.floats(0.01, 3.0), st.booleans())
def test_a_first_order_response(tau, start, size, downward):
    end = start - size if downward else start + size
    response = end + (start - end) * np.exp(-TIME / tau)
    found = step_quality(TIME, response, start, end)
    assert found.overshoot == pytest.approx(0.0, abs=1e-9)
    assert found.rise_time == pytest.approx(tau * math.log(9.0), rel=1e-4)
    assert found.settling_time == pytest.approx(tau * math.log(50.0), rel=1e-4)


@pytest.mark.parametrize("zeta", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("band", [0.02, 0.05])
def test_a_second_order_response(zeta, band):
    omega, root = 3.0, math.sqrt(1.0 - zeta * zeta)
    envelope = np.exp(-zeta * omega * TIME)
    phase = omega * root * TIME
    y = 1.0 - envelope * (np.cos(phase) + zeta / root * np.sin(phase))
    found = step_quality(TIME, 0.3 + 0.1 * y, 0.3, 0.4, band=band)
    assert found.overshoot == pytest.approx(math.exp(-math.pi * zeta / root), abs=1e-6)
    # from the definition: the last time outside the band, and none later
    inside = np.abs(y - 1.0) <= band
    last = TIME[np.flatnonzero(~inside)[-1]]
    assert last <= found.settling_time <= last + TIME[1]
    assert found.rise_time == pytest.approx(
        np.interp(0.9, y[: y.argmax()], TIME[: y.argmax()]) - np.interp(0.1, y[: y.argmax()], TIME[: y.argmax()]),
        abs=1e-6,
    )


def test_a_step_within_a_record_counts_from_where_it_is():
    time = np.linspace(0.0, 10.0, 10001)
    y = np.where(time < 2.0, 0.0, 1.0 - np.exp(-(time - 2.0)))
    found = step_quality(time, y, 0.0, 1.0, at=2.0)
    assert found.settling_time == pytest.approx(math.log(50.0), abs=1e-3)
    assert found.rise_time == pytest.approx(math.log(9.0), abs=1e-3)


def test_responses_that_do_not_arrive_are_infinite():
    slow = step_quality(TIME, 0.5 * (1.0 - np.exp(-TIME)), 0.0, 1.0)
    assert slow[:4] == (0.0, math.inf, math.inf, 0.0) and slow.steady_error == pytest.approx(0.5, abs=1e-6)
    swinging = step_quality(TIME, 1.0 - np.cos(TIME), 0.0, 1.0)
    assert swinging.overshoot == pytest.approx(1.0, abs=1e-6)
    assert swinging.settling_time == math.inf and swinging.rise_time < 2.0
    assert step_quality([0.0, 1.0, 2.0], [1.0, 1.0, 1.0], 0.0, 1.0) == (0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "arguments, options, message",
    [
        (([0.0, 1.0], [0.0, 1.0], 1.0, 1.0), {}, "from 1 to 1: there is no step; expected a start and"),
        (([0.0, 1.0], [0.0, 1.0], 0.0, 0.0), {}, "there is no step"),
        (([0.0, 1.0], [0.0, 1.0], 1.0, 1.0 + 1e-15), {}, "there is no step"),
        (([0.0, 1.0], [0.0, math.nan], 0.0, 1.0), {}, "expected (two )?finite numbers"),
        (([0.0, 1.0], [0.0, 1.0], 0.0, math.inf), {}, "expected (two )?finite numbers"),
        (([0.0, 0.0], [0.0, 1.0], 0.0, 1.0), {}, "two at least, increasing"),
        (([0.0], [0.0], 0.0, 1.0), {}, "two at least, increasing"),
        (([0.0, 1.0], [0.0, 1.0, 2.0], 0.0, 1.0), {}, "time of shape"),
        (([0.0, 1.0], [0.0, 1.0], 0.0, 1.0), {"at": 3.0}, "no samples after 3 s"),
        (([0.0, 1.0], [0.0, 1.0], 0.0, 1.0), {"band": 0.0}, "band 0.0; expected between 0 and 1"),
    ],
)
def test_ill_posed_steps_are_named(arguments, options, message):
    with pytest.raises(ParameterError, match=message):
        step_quality(*arguments, **options)


def recording(**columns):
    time = np.linspace(0.0, 1.0, 5)
    return Recording(time=time, **columns)


def test_tracking_errors_are_those_of_their_definition():
    rng = np.random.default_rng(1)
    position, path = rng.normal(size=(2, 5, 3))
    for found in (
        tracking_error(recording(position=position, setpoint=path)),
        tracking_error(recording(position=position), path),
    ):
        for j in range(3):
            errors = [p - r for p, r in zip(position[:, j], path[:, j])]
            assert found.rms[j] == pytest.approx(math.sqrt(math.fsum(e * e for e in errors) / 5))
            assert found.worst[j] == max(map(abs, errors))
    for bad in (None, path[:3]):
        with pytest.raises(ParameterError, match="no path beside the positions"):
            tracking_error(recording(position=position), bad)


def test_volts_count_for_as_long_as_they_are_held():
    volts = np.array([[40.0, 0.0, -40.0], [10.0, -20.0, -40.0], [99.0, 99.0, 99.0]])
    run = Recording(time=np.array([0.0, 3.0, 4.0]), voltage=volts)
    found = effort(run, 40.0)
    np.testing.assert_allclose(found.rms, np.sqrt([(3 * 1600 + 100) / 4, 400 / 4, 1600]))
    np.testing.assert_allclose(found.saturated, [0.75, 0.0, 1.0])
    assert effort(run, math.inf).saturated.tolist() == [0.0, 0.0, 0.0]
    # a converter of 3 bits ends a quarter below
    np.testing.assert_allclose(effort(run, 50.0, within=0.25).saturated, [0.75, 0.0, 1.0])
    for bad, limit in ((recording(), 40.0), (Recording(time=np.zeros(1), voltage=volts[:1]), 40.0), (run, 0.0)):
        with pytest.raises(ParameterError, match="effort"):
            effort(bad, limit)
