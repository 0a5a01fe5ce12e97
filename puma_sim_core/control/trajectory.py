# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Setpoints of a joint trajectory: points with times, as motion planners give them, at the rate of the setpoints.

Between two points the path is the polynomial that has what the points hold at both ends: of degree five with positions,
velocities and accelerations, of degree three with positions and velocities. With positions alone the velocities are
those of a monotone cubic (Fritsch and Butland 1984): it does not leave the range between neighbouring points, and rests
at the first and the last.

What the arm cannot follow is refused as a whole: a joint out of its range, faster than its motor turns without load, or
an acceleration for which the rigid arm needs more voltage than there is. Effects are not counted in.
"""

from collections.abc import Sequence
from math import ceil, isfinite
from typing import NamedTuple

import numpy as np

from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.errors import CommandError
from puma_sim_core.plant.plant import Plant

#: how far from the present setpoint a trajectory may begin [rad]; what MoveIt allows by default
START_TOLERANCE = 0.01
#: velocity that counts as rest at the last point [rad/s]: a hundredth of a degree in ten setpoints
REST = 1e-3
#: longest trajectory [s] and most points: to look at one of this size takes less than a period of the setpoints
LONGEST, MOST_POINTS = 120.0, 1000
#: rounding that a path may be out of a range by [rad]
_ROUNDING = 1e-9
#: least time between two points [s]: what the messages of ROS can tell apart
_APART = 1e-9
_WHERE = "trajectory"


class Waypoint(NamedTuple):
    """A point of a trajectory: when [s], and for each joint that the trajectory names its position [rad] and, where
    they are given, velocity [rad/s] and acceleration [rad/s^2]."""

    time: float
    position: Sequence[float]
    velocity: Sequence[float] = ()
    acceleration: Sequence[float] = ()


class Follower(NamedTuple):
    """Who is to follow: the plant, the names of its joints, the time between setpoints [s], the voltage limit [V]."""

    plant: Plant
    joint_names: Sequence[str]
    period: float
    voltage_limit: float


def trajectory_setpoints(
    follower: Follower, names: Sequence[str], points: Sequence[Waypoint], start: Sequence[float]
) -> np.ndarray:
    """(n, 3) setpoints [rad] from now on, one each period, of which the last is the last point.

    names : the joints in the order of the points, each of the arm's once. points : with times that increase from
    now; where the first comes later than at 0 the path begins at `start`, at rest. start : (3,) the present setpoint
    [rad].

    Raises
    ------
    CommandError : what cannot be read or followed; names the point, the joint and the reason.
    """
    order = _order(follower.joint_names, names)
    _check_alike(points, len(names))
    times = [point.time for point in points]
    _check_times(times)
    # (n, kinds, 3)
    rows = np.array([point[1 : 1 + _depth(points[0])] for point in points], dtype=float)[..., order]
    _check_finite(rows)
    if times[0] > 0.0:
        times.insert(0, 0.0)
        rows = np.concatenate([np.zeros_like(rows[:1]), rows])
        rows[0, 0] = start
    _check_ends(follower.joint_names, rows, start)
    # a path through points far outside could not even be made
    _check_ranges(follower, np.array(times), rows[:, 0])
    steps = ceil(times[-1] / follower.period - 1e-9)
    sampled = np.minimum(follower.period * np.arange(steps + 1), times[-1])
    # where velocities or accelerations of points are beyond all bounds, so is what follows from them
    with np.errstate(all="ignore"):
        path = _path(np.array(times), rows)
        position = path(sampled)
        position[-1] = rows[-1, 0]
        _check_ranges(follower, sampled, position)
        _check_moves(follower, sampled, position, path.derivative()(sampled), path.derivative(2)(sampled))
    return position


_KINDS = ("position", "velocity", "acceleration")


def _refuse(what: str, expected: str) -> CommandError:
    return CommandError(what, where=_WHERE, expected=expected)


def _order(joint_names: Sequence[str], names: Sequence[str]) -> list[int]:
    """Places of the arm's joints among the names."""
    names, wanted = list(names), f"{', '.join(joint_names)}, each once"
    for name in names:
        if name not in joint_names:
            raise _refuse(f"unknown joint '{name}'", wanted)
        if names.count(name) > 1:
            raise _refuse(f"joint '{name}' stands twice", wanted)
    for name in joint_names:
        if name not in names:
            raise _refuse(f"joint '{name}' is missing", wanted)
    return [names.index(name) for name in joint_names]


def _depth(point: Waypoint) -> int:
    return 1 + bool(len(point.velocity)) + bool(len(point.acceleration))


def _check_alike(points: Sequence[Waypoint], joints: int) -> None:
    """All hold the same, of each joint."""
    if not 0 < len(points) <= MOST_POINTS:
        raise _refuse(f"{len(points) or 'no'} points", f"at least one, at most {MOST_POINTS}")
    for number, point in enumerate(points, start=1):
        for kind, values in zip(_KINDS, point[1:]):
            if len(values) != joints and (kind == "position" or len(values)):
                raise _refuse(f"point {number} has {len(values)} of {kind}", f"{joints}, one for each joint")
        if len(point.acceleration) and not len(point.velocity):
            raise _refuse(f"point {number} has accelerations and no velocities", "velocities as well")
        if _depth(point) != _depth(points[0]):
            holds = " and ".join(_KINDS[: _depth(point)])
            raise _refuse(f"point {number} holds {holds}", f"{' and '.join(_KINDS[: _depth(points[0])])}, as point 1")


def _check_finite(rows: np.ndarray) -> None:
    bad = np.argwhere(~np.isfinite(rows))
    if len(bad):
        number, kind, _ = bad[0]
        raise _refuse(f"point {number + 1}, {_KINDS[kind]} {rows[number, kind].tolist()}", "finite numbers")


def _check_times(times: Sequence[float]) -> None:
    before = 0.0
    for number, time in enumerate(times, start=1):
        if not isfinite(time) or time - before < (_APART if number > 1 or time else 0.0):
            raise _refuse(f"point {number} at {time!r} s", f"more than {before!r} s" if number > 1 else "0 s or later")
        before = time
    if not 0.0 < times[-1] <= LONGEST:
        raise _refuse(f"the last point at {times[-1]!r} s", f"more than 0, at most {LONGEST:g} s")


def _check_ends(joint_names: Sequence[str], rows: np.ndarray, start: Sequence[float]) -> None:
    """The path begins where the setpoint is, and ends at rest."""
    for name, first, present, last in zip(joint_names, rows[0][0], start, rows[-1].T):
        if abs(first - present) > START_TOLERANCE:
            expected = f"within {START_TOLERANCE:g} rad of the present setpoint, {present:.4f} rad"
            raise _refuse(f"point 1 at 0 s: {name} at {first:.4f} rad", expected)
        if len(last) > 1 and abs(last[1]) > REST:
            raise _refuse(f"last point: velocity of {name} {last[1]:.4g} rad/s", "0, since nothing comes after it")


def _path(times: np.ndarray, rows: np.ndarray) -> "_Path":
    """The path through rows (n, kinds, 3) at times (n,)."""
    position = rows[:, 0]
    if rows.shape[1] == 3:
        return _quintic(times, *np.moveaxis(rows, 1, 0))
    return _cubic(times, position, rows[:, 1] if rows.shape[1] == 2 else _monotone_slopes(times, position))


class _Path:
    """Polynomials on the intervals between times (n,).

    coefficients : (degree + 1, n - 1, 3) of powers of the time since the beginning of each, the highest first.

    SciPy has the same; importing it took a third of the time in which a node starts.
    """

    def __init__(self, times: np.ndarray, coefficients: np.ndarray) -> None:
        self._times, self._coefficients = times, coefficients

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """(m, 3) values at times (m,) from the first to the last."""
        place = np.clip(np.searchsorted(self._times, t, side="right") - 1, 0, len(self._times) - 2)
        since = (t - self._times[place])[:, None]
        value = np.zeros((len(t), self._coefficients.shape[2]))
        for coefficient in self._coefficients:
            value = value * since + coefficient[place]
        return value

    def derivative(self, order: int = 1) -> "_Path":
        """The path of its derivative."""
        coefficients = self._coefficients
        for _ in range(order):
            powers = np.arange(len(coefficients) - 1, 0, -1.0)
            coefficients = coefficients[:-1] * powers[:, None, None]
        return _Path(self._times, coefficients)


def _monotone_slopes(times: np.ndarray, position: np.ndarray) -> np.ndarray:
    """(n, 3) velocities at points: 0 at both ends and where the direction changes, else a mean of the two secants, the
    weighted harmonic one (Fritsch and Butland 1984)."""
    T = np.diff(times)[:, None]
    secant = np.diff(position, axis=0) / T
    before, after = secant[:-1], secant[1:]
    slopes = np.zeros_like(position)
    w = T[:-1] + 2 * T[1:], 2 * T[:-1] + T[1:]
    mean = (w[0] + w[1]) / (w[0] / before + w[1] / after)
    slopes[1:-1] = np.where(np.sign(before) * np.sign(after) > 0, mean, 0.0)
    return slopes


def _cubic(times: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> _Path:
    """The polynomials of degree three."""
    T = np.diff(times)[:, None]
    p, v = position[:-1], velocity[:-1]
    # what the end is off by where the velocity stays, times T^0, T^1
    d, dv = np.diff(position, axis=0) - T * v, T * np.diff(velocity, axis=0)
    return _Path(times, np.stack([(dv - 2 * d) / T**3, (3 * d - dv) / T**2, v, p]))


def _quintic(times: np.ndarray, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> _Path:
    """The polynomials of degree five."""
    T = np.diff(times)[:, None]
    p, v, a = position[:-1], velocity[:-1], acceleration[:-1]
    # what the end is off by where the acceleration stays, times T^0, T^1, T^2
    d = np.diff(position, axis=0) - T * (v + T * a / 2)
    dv = T * (np.diff(velocity, axis=0) - T * a)
    da = T**2 * np.diff(acceleration, axis=0)
    c3, c4, c5 = 10 * d - 4 * dv + da / 2, -15 * d + 7 * dv - da, 6 * d - 3 * dv + da / 2
    return _Path(times, np.stack([c5 / T**5, c4 / T**4, c3 / T**3, a / 2, v, p]))


def _check(
    follower: Follower, within: np.ndarray, what: str, values: np.ndarray, time: np.ndarray, expected: Sequence[str]
) -> None:
    """Refuse the first of the values (n, 3) that is not within; `what` has places for joint and value."""
    if not within.all():
        row, joint = (int(place) for place in np.argwhere(~within)[0])
        said = what.format(follower.joint_names[joint], float(values[row, joint]))
        raise _refuse(f"{said} at {time[row]:.3f} s", expected[joint])


def _check_ranges(follower: Follower, time: np.ndarray, position: np.ndarray) -> None:
    low, high = np.array(follower.plant.arm.joint_ranges).T
    ranges = [f"{first:.4f} to {last:.4f} rad" for first, last in follower.plant.arm.joint_ranges]
    within = (position >= low - _ROUNDING) & (position <= high + _ROUNDING)
    _check(follower, within, "{} would be at {:.4f} rad", position, time, ranges)


def _check_moves(
    follower: Follower, time: np.ndarray, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> None:
    arm, limit = follower.plant.arm, follower.voltage_limit
    back_emf = np.array([motor.back_emf * motor.gear_ratio for motor in arm.motors])
    greatest = limit / back_emf
    speeds = [f"at most {value:.4g} rad/s, the speed without load" for value in greatest]
    _check(follower, np.abs(velocity) <= greatest, "{} would turn at {:.4g} rad/s", velocity, time, speeds)
    torque = (inertia(position, arm) + np.diag(arm.motor_inertia)) @ acceleration[..., None]
    moving = np.einsum("nijk,nj,nk->ni", coriolis(position, arm), velocity, velocity)
    torque = torque[..., 0] + moving + gravity_torque(position, arm)
    resistance = np.array([motor.resistance for motor in arm.motors])
    volts = torque * resistance / np.array(follower.plant.torque_per_ampere) + back_emf * velocity
    supply = [f"at most {limit:g} V: give it more time"] * 3
    _check(follower, np.abs(volts) <= limit, "{} would need {:.1f} V", volts, time, supply)
