# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Steps, ramps and smooth moves of the joints; and the reference that controllers make of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from puma_sim_core.control.reference import Bounds, SetpointReference
from puma_sim_core.control.setpoints import Move, joint_path, joint_setpoints
from puma_sim_core.errors import ParameterError

START = (0.1, -1.2, 1.0)
BY = (0.5, -0.3, 0.0)
T, N = 0.028, 30
V, A = (2.2, 1.28, 2.5), (15.0, 10.0, 20.0)


@pytest.mark.parametrize("shape, duration", [("step", 0.0), ("ramp", 0.7), ("quintic", 0.7)])
def test_moves_start_and_end_where_they_should(shape, duration):
    time, setpoint = joint_setpoints(START, [Move(0.28, duration, BY, shape)], 1.4)
    np.testing.assert_allclose(np.diff(time), T, atol=1e-12)
    assert len(time) == 51
    assert (setpoint[:10] == START).all()
    np.testing.assert_allclose(
        setpoint[time > 0.28 + duration - 1e-9],
        np.add(START, BY) + np.zeros((sum(time > 0.28 + duration - 1e-9), 1)),
        atol=1e-12,
    )


def test_a_step_is_in_the_setpoint_of_its_own_time():
    for k in range(1, 200):
        _time, setpoint = joint_setpoints((0.0,) * 3, [Move(k * T, 0.0, (1.0,) * 3, "step")], 10.0)
        assert np.flatnonzero(setpoint[:, 0])[0] == k


def test_moves_add_up():
    time = np.linspace(0.0, 3.0, 50)
    moves = [Move(0.1, 1.0, (1, 2, 3)), Move(0.5, 0.0, (1, 0, 0), "step"), Move(1.0, 1.5, (0, -1, 0), "ramp")]
    np.testing.assert_allclose(joint_path(START, moves, time), np.array(START) + sum(m.at(time) for m in moves))
    assert (joint_path(START, [], time) == START).all()


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Move(0.0, 1.0, BY, "jump"), "shape 'jump'; expected step or ramp or quintic"),
        (lambda: Move(0.0, 1.0, BY, "step"), "expected times"),
        (lambda: Move(0.0, 0.0, BY, "ramp"), "expected times"),
        (lambda: Move(math.nan, 1.0, BY), "expected times"),
        (lambda: Move(0.0, 1.0, (1.0, 2.0)), "by = .*; expected three finite numbers"),
        (lambda: Move(0.0, 1.0, (1.0, 2.0, math.inf)), "three finite numbers"),
        (lambda: joint_setpoints(START, [], 0.0), "duration 0.0 s; expected a positive number"),
        (lambda: joint_setpoints(START, [], 1.0, -1.0), "period -1.0 s"),
    ],
)
def test_moves_that_cannot_be_are_named(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


# ------------------------------------------------------------------------------------- reference


def reference(path, **changes):
    """(time, position, velocity, acceleration) of joint 1 for setpoints path(t), from path(0)."""
    made = SetpointReference(T / N, T, Bounds(**{"greatest_velocity": V, "greatest_acceleration": A, **changes}))
    samples, rows = np.arange(60 * N), []
    start = (float(path(0.0)), 0.0, 0.0)
    for k in samples:
        rows.append(made.update((float(path((k // N) * T)), 0.0, 0.0), start)[0])
    return samples * T / N, *np.array(rows).T


@pytest.mark.parametrize("lead", [0.0, 0.5, 1.0])
def test_a_resting_setpoint_is_a_resting_reference_exactly(lead):
    _, position, velocity, acceleration = reference(lambda t: 0.3, lead=lead)
    assert set(position) == {0.3} and not velocity.any() and not acceleration.any()


def test_a_path_of_constant_acceleration_is_followed_without_delay():
    # the velocity begins within one bound of acceleration, so that the bounds hold nothing back
    def path(t):
        return 0.3 * t + 0.4 * t * t

    time, position, velocity, acceleration = reference(path)
    late = time > 4 * T
    np.testing.assert_allclose(position[late], path(time[late]), atol=1e-12)
    np.testing.assert_allclose(velocity[late], 0.3 + 0.8 * time[late], atol=1e-10)
    np.testing.assert_allclose(acceleration[late], 0.8, atol=1e-8)


def test_without_lead_it_is_one_and_a_half_periods_late():
    time, position, velocity, _ = reference(lambda t: 0.4 * t, lead=0.0)
    late = time > 4 * T
    np.testing.assert_allclose(position[late], 0.4 * (time[late] - 1.5 * T), atol=1e-12)
    np.testing.assert_allclose(velocity[late], 0.4, atol=1e-12)


@pytest.mark.parametrize("lead", [0.0, 1.0])
def test_velocity_is_the_slope_of_the_position(lead):
    def path(t):
        return 0.2 * math.sin(4.0 * t) * min(t, 1.0) ** 3

    time, position, velocity, _ = reference(path, lead=lead)
    h = time[1]
    within = np.flatnonzero(np.arange(len(time) - 1) % N < N - 1)
    slope = np.diff(position)[within] / h
    mean = 0.5 * (velocity[:-1] + velocity[1:])[within]
    np.testing.assert_allclose(slope, mean, atol=2e-4)


@settings(max_examples=60)
@given(st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=6))
def test_whatever_the_setpoints_without_lead_the_bounds_hold(jumps):
    targets = np.repeat(jumps, 12)
    _, position, velocity, acceleration = reference(lambda t: targets[min(round(t / T), len(targets) - 1)], lead=0.0)
    assert np.abs(velocity).max() <= V[0] * (1 + 1e-9)
    assert np.abs(acceleration).max() <= A[0] * (1 + 1e-6)
    assert np.isfinite(position).all()


@pytest.mark.parametrize("size", [0.001, 0.03, 0.1, 0.4, 1.5, -0.7])
def test_a_step_is_reached_exactly_and_hardly_passed(size):
    _, position, velocity, _ = reference(lambda t: size if t > 0.1 else 0.0)
    assert position[-1] == pytest.approx(size, abs=1e-12) and abs(velocity[-1]) < 1e-9
    beyond = (position / size).max() - 1.0
    # a period's worth of braking at the most
    assert beyond * abs(size) <= A[0] * T * T


def test_a_reset_starts_where_the_arm_is():
    made = SetpointReference(T / N, T, Bounds(V, A))
    for _ in range(100):
        made.update((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    made.reset()
    assert made.update((0.2, 0.3, 0.4), (0.2, 0.3, 0.4)) == [(0.2, 0, 0), (0.3, 0, 0), (0.4, 0, 0)]


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"lead": 1.5}, "lead 1.5; expected 0 to 1"),
        ({"greatest_velocity": (1.0, 0.0, 1.0)}, "greatest velocity .* three positive numbers"),
        ({"greatest_acceleration": (1.0, 1.0)}, "greatest acceleration .* three positive numbers"),
    ],
)
def test_references_that_cannot_be_are_named(changes, message):
    with pytest.raises(ParameterError, match=message):
        reference(lambda t: 0.0, **changes)
