# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Joint trajectories become setpoints: the polynomials that the points ask for, and refusals with a reason."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from puma_sim_core.control.trajectory import Follower, Waypoint, trajectory_setpoints
from puma_sim_core.errors import CommandError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.session import Session, SessionConfig

NAMES = ("joint1", "joint2", "joint3")
PERIOD, START = 0.028, (0.1, -0.4, 0.6)
FOLLOWER = Follower(Plant.of("bejczy"), NAMES, PERIOD, 40.0)


def setpoints(*points, names=NAMES, start=START):
    return trajectory_setpoints(FOLLOWER, names, points, start)


def motion(degree: int, seed: int = 1):
    """A polynomial of the degree in each joint that begins at rest at the start: values and derivatives at a time."""
    rng = np.random.default_rng(seed)
    rows = [np.polynomial.Polynomial([s, 0.0, 0.0, *rng.uniform(-0.01, 0.01, degree - 2)]) for s in START]

    def at(time, order=0):
        return tuple(float((row.deriv(order) if order else row)(time)) for row in rows)

    return at


@pytest.mark.parametrize("names", [NAMES, ("joint3", "joint1", "joint2")])
def test_points_with_accelerations_are_joined_by_quintics(names):
    """A polynomial of degree five is met between its points; brought to rest by a last one."""
    at, order = motion(5), [NAMES.index(name) for name in names]

    def point(time, *values):
        return Waypoint(time, *(np.array(value)[order] for value in values))

    times = (0.0, 0.7, 1.1, 2.0)
    points = [point(time, at(time), at(time, 1), at(time, 2)) for time in times]
    found = setpoints(*points, point(5.0, at(2.0), (0, 0, 0), (0, 0, 0)), names=names)
    for row in range(int(2.0 / PERIOD)):
        assert np.allclose(found[row], at(row * PERIOD), atol=1e-12, rtol=0)


def test_points_with_velocities_are_joined_by_cubics():
    at = motion(3)
    points = [Waypoint(time, at(time), at(time, 1)) for time in (0.0, 0.9, 1.4, 2.0)]
    found = setpoints(*points, Waypoint(5.0, at(2.0), (0.0, 0.0, 0.0)))
    for row in range(int(2.0 / PERIOD)):
        assert np.allclose(found[row], at(row * PERIOD), atol=1e-12, rtol=0)


def test_a_single_position_is_reached_from_the_present_setpoint_at_rest():
    target = (0.5, -0.2, 0.9)
    found = setpoints(Waypoint(2.0, target))
    assert len(found) == 1 + round(2.0 / PERIOD + 0.5)
    share = np.minimum(PERIOD * np.arange(len(found)) / 2.0, 1.0)[:, None]
    # the cubic at rest at both ends
    expected = np.array(START) + share**2 * (3.0 - 2.0 * share) * (np.array(target) - START)
    assert np.allclose(found, expected, atol=1e-12, rtol=0)
    assert tuple(found[-1]) == target


@given(st.lists(st.floats(-0.4, 0.4), min_size=1, max_size=8))
def test_positions_alone_are_not_overshot(targets):
    points = [Waypoint(2.0 * n, (0.1, target, 0.6)) for n, target in enumerate(targets, start=1)]
    found = setpoints(*points)[:, 1]
    knots = [START[1], *targets]
    for row, value in enumerate(found[:-1]):
        place = min(int(row * PERIOD / 2.0), len(targets) - 1)
        low, high = sorted(knots[place : place + 2])
        assert low - 1e-12 <= value <= high + 1e-12
    assert found[-1] == targets[-1]


def test_positions_alone_are_joined_as_scipy_joins_them():
    """Monotone cubics at rest at both ends; an independent implementation, with turns and equal points."""
    times = np.array([0.0, 0.5, 0.9, 2.0, 2.3, 4.0, 5.0])
    rng = np.random.default_rng(4)
    position = np.array(START) + 0.03 * rng.standard_normal((len(times), 3)).cumsum(axis=0)
    position[0], position[4, 1] = START, position[3, 1]
    slopes = PchipInterpolator(times, position).derivative()(times)
    slopes[[0, -1]] = 0.0
    found = setpoints(*(Waypoint(*point) for point in zip(times, position)))
    wanted = CubicHermiteSpline(times, position, slopes)(np.minimum(PERIOD * np.arange(len(found)), times[-1]))
    np.testing.assert_allclose(found, wanted, atol=1e-13, rtol=0)


def test_a_session_follows_what_was_accepted():
    session = Session(SessionConfig(plant=FOLLOWER.plant, command_interface="position", initial_position=START))
    wanted = setpoints(Waypoint(1.0, (0.3, -0.7, 0.9)), Waypoint(2.5, (0.6, -0.6, 0.5)))
    positions = []
    for row in wanted:
        session.command(row.tolist())
        positions.append(session.step().position)
    # the setpoint of a step is reached a servo's lag later
    assert np.abs(np.array(positions) - wanted).max() < 0.06
    for _ in range(40):
        session.command(wanted[-1].tolist())
        session.step()
    assert np.abs(np.array(session.state.position) - wanted[-1]).max() < 0.01
    assert session.counters.saturated == 0


GOOD = (0.3, -0.2, 0.8)
REST = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("points", "names", "reason"),
    [
        ([], NAMES, "no points; expected at least one"),
        (
            [Waypoint(1.0, GOOD)],
            ("joint1", "joint2", "elbow"),
            "unknown joint 'elbow'; expected joint1, joint2, joint3",
        ),
        ([Waypoint(1.0, GOOD)], ("joint1", "joint2", "joint2"), "joint 'joint2' stands twice"),
        ([Waypoint(1.0, GOOD[:2])], ("joint1", "joint2"), "joint 'joint3' is missing"),
        ([Waypoint(1.0, GOOD[:2])], NAMES, "point 1 has 2 of position; expected 3"),
        ([Waypoint(1.0, ())], NAMES, "point 1 has 0 of position"),
        ([Waypoint(1.0, GOOD, REST[:1])], NAMES, "point 1 has 1 of velocity"),
        ([Waypoint(1.0, GOOD, (), REST)], NAMES, "accelerations and no velocities"),
        ([Waypoint(1.0, (0.3, float("nan"), 0.8))], NAMES, r"point 1, position \[0.3, nan, 0.8\]; expected finite"),
        ([Waypoint(1.0, GOOD, REST), Waypoint(2.0, GOOD)], NAMES, "point 2 holds position; .* velocity, as point 1"),
        ([Waypoint(-1.0, GOOD)], NAMES, "point 1 at -1.0 s; expected 0 s or later"),
        ([Waypoint(float("inf"), GOOD)], NAMES, "point 1 at inf s"),
        ([Waypoint(1.0, GOOD), Waypoint(1.0, GOOD)], NAMES, "point 2 at 1.0 s; expected more than 1.0 s"),
        ([Waypoint(0.0, START)], NAMES, "the last point at 0.0 s"),
        ([Waypoint(900.0, GOOD)], NAMES, "the last point at 900.0 s; expected more than 0, at most 120 s"),
        (
            [Waypoint(0.0, GOOD), Waypoint(1.0, GOOD)],
            NAMES,
            "point 1 at 0 s: joint1 at 0.3000 rad; expected within 0.01",
        ),
        ([Waypoint(1.0, GOOD, (0.0, 0.2, 0.0))], NAMES, "velocity of joint2 0.2 rad/s; expected 0, since nothing"),
        ([Waypoint(9.0, (0.3, 0.9, 0.8))], NAMES, r"joint2 would be at 0.9000 rad .*-3.8921 to 0.7505 rad"),
        (
            [Waypoint(1.0, GOOD), Waypoint(2.0, (1e308, -0.2, 0.8)), Waypoint(3.0, GOOD)],
            NAMES,
            "joint1 would be at 1000",
        ),
        ([Waypoint(1.0, GOOD, (0.0, 1e308, 0.0)), Waypoint(2.0, GOOD, REST)], NAMES, "joint2 would be at"),
        ([Waypoint(1.0, GOOD, REST, (0.0, 1e308, 0.0)), Waypoint(2.0, GOOD, REST, REST)], NAMES, "joint2 would be at"),
        ([Waypoint(5e-324, GOOD), Waypoint(2.0, GOOD)], NAMES, "point 1 at 5e-324 s; expected 0 s or later"),
        ([Waypoint(1.0, GOOD), Waypoint(1.0 + 1e-15, GOOD)], NAMES, "point 2 at 1.0"),
        ([Waypoint(0.4, (1.3, -0.4, 0.6))], NAMES, "joint1 would turn at .* rad/s, the speed without load"),
        ([Waypoint(0.05, (0.18, -0.4, 0.6))], NAMES, "joint1 would need .* V at .* at most 40 V: give it more time"),
    ],
)
def test_what_cannot_be_followed_is_refused_by_name_and_reason(points, names, reason):
    with pytest.raises(CommandError, match=f"trajectory: .*{reason}"):
        setpoints(*points, names=names)


def test_a_range_is_kept_between_the_points_too():
    fast = (0.0, 1.0, 0.0)
    points = [Waypoint(1.0, (0.1, 0.7, 0.6), fast), Waypoint(2.0, (0.1, 0.7, 0.6), REST)]
    with pytest.raises(CommandError, match=r"joint2 would be at 0\.7\d+ rad"):
        setpoints(*points)


def test_the_voltage_that_is_asked_for_is_that_of_the_arm():
    """The lowest limit under which a motion is accepted is about the voltage that the simulated arm gets."""
    points = [Waypoint(1.2, (0.9, -0.4, 0.6))]
    low, high = 1.0, 40.0
    while high - low > 0.01:
        middle = (low + high) / 2
        try:
            trajectory_setpoints(FOLLOWER._replace(voltage_limit=middle), NAMES, points, START)
            high = middle
        except CommandError:
            low = middle
    wanted = setpoints(*points)
    still = SessionConfig(
        plant=FOLLOWER.plant, command_interface="position", controller="computed_torque", initial_position=START
    )
    session = Session(still)
    volts = []
    for row in wanted:
        session.command(row.tolist())
        volts.append(session.step().voltage)
    assert np.abs(volts).max() == pytest.approx(high, rel=0.15)
