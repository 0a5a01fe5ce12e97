# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Position, velocity and acceleration that a controller can follow, from setpoints as they come.

Setpoints come every 28 ms and are not known in advance. Three stages make a path of them:

1. Bounds. Each setpoint is followed as fast as a greatest velocity and acceleration allow, and
   exactly where it stays within them; a step becomes a fast move that brakes in time.
2. A quadratic B-spline through three successive points p0, p1, p2 that are T apart, u = 0 to 1
   in each period: ``r = [(1 - u)^2 p0 + (1 + 2u - 2u^2) p1 + u^2 p2] / 2``, whose velocity is
   continuous and whose acceleration is the second difference over T^2. It is 1.5 T late.
3. Lead. ``r + c r' + (c^2/2 - T^2/8) r''`` and its derivative with c = 1.5 T make up for that: a path of constant
   acceleration is followed exactly. While the bounds hold the path back there is nothing to be in time for, and a lead
   would only overshoot where it brakes: c is then taken away, and given back within eight periods.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, sqrt

from puma_sim_core.checks import check_positive, check_three_positive
from puma_sim_core.control.sample_laws import reference_at
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import plain

_at = plain(reference_at)
#: delay of the spline in periods of the setpoints
_LATE = 1.5
#: periods in which the lead comes back
_BACK = 8
_WHERE = "setpoint reference"


@dataclass(frozen=True)
class Bounds:
    """Within which setpoints are followed exactly.

    greatest_velocity (3,) [rad/s] and greatest_acceleration (3,) [rad/s^2], positive; lead : share of the delay that
    is made up for, 0 to 1. Raises ParameterError on others.
    """

    greatest_velocity: Sequence[float]
    greatest_acceleration: Sequence[float]
    lead: float = 1.0

    def __post_init__(self) -> None:
        check_three_positive(self.greatest_velocity, "greatest velocity", _WHERE)
        check_three_positive(self.greatest_acceleration, "greatest acceleration", _WHERE)
        if not 0.0 <= self.lead <= 1.0:
            raise ParameterError(f"lead {self.lead!r}", where=_WHERE, expected="0 to 1")


class SetpointReference:
    """The reference of three joints, sample by sample.

    period : between samples [s]; setpoint_period : T [s], a whole number of periods; where : whose reference it is,
    in errors. Raises ParameterError on others.
    """

    def __init__(self, period: float, setpoint_period: float, bounds: Bounds, where: str = _WHERE):
        #: T [s], and the time that the lead makes up for [s]
        self.period = check_positive(setpoint_period, "setpoint_period", "s", where)
        self._samples = round(setpoint_period / check_positive(period, "period", "s", where))
        if self._samples < 1 or abs(self._samples * period - setpoint_period) > 1e-9 * setpoint_period:
            expected = f"a whole part of {setpoint_period!r} s"
            raise ParameterError(f"period = {period!r} s", where=where, expected=expected)
        pairs = zip(bounds.greatest_velocity, bounds.greatest_acceleration)
        self._joints = [_Bounded(self.period, float(v), float(a)) for v, a in pairs]
        self.lead = bounds.lead * _LATE * self.period
        self._k: int | None = None
        self._pieces: tuple[float, ...] = ()

    def reset(self) -> None:
        """Forget the past: the next sample starts at rest where the arm is."""
        self._k = None

    def update(self, setpoint: Sequence[float], measurement: Sequence[float]) -> list[tuple[float, ...]]:
        """(position [rad], velocity [rad/s], acceleration [rad/s^2]) of each joint at a sample.

        setpoint, measurement : (3,) [rad]; the setpoint is taken at the first sample of its
        period, the measurement at the first of all.
        """
        u, pieces = self.pieces(setpoint, measurement)
        return [_at(pieces[at : at + 7], u, self.period, self.lead) for at in (0, 7, 14)]

    def pieces(self, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, tuple[float, ...]]:
        """u, and the seven numbers of each joint's path in this period, joint by joint, as `reference_at` takes them;
        like `update`, and once a sample."""
        if self._k is None:
            self._k = 0
            for joint, y in zip(self._joints, measurement):
                joint.start(float(y))
        if self._k == 0:
            self._pieces = tuple(
                number for joint, r in zip(self._joints, setpoint) for number in self._piece(joint, float(r))
            )
        u = self._k / self._samples
        self._k = (self._k + 1) % self._samples
        return u, self._pieces

    def _piece(self, joint: _Bounded, setpoint: float) -> tuple[float, ...]:
        """What holds between two setpoints of a joint: p0, p1 - p0, p2 - p1, the acceleration, and of the lead its
        first share, what that gains, and the slope of the lead."""
        joint.take(setpoint)
        p0, p1, p2 = joint.points
        first, second = p1 - p0, p2 - p1
        before, after = joint.shares
        gained = after - before
        acceleration = (second - first) / (self.period * self.period)
        return p0, first, second, acceleration, before, gained, self.lead * gained / self.period


class _Bounded:
    """Setpoints of one joint with bounded velocity V and acceleration A, a point every T."""

    def __init__(self, T: float, V: float, A: float):
        self._T, self._V, self._A = T, V, A

    def start(self, q: float) -> None:
        self.points = (q, q, q)
        self.shares = (1.0, 1.0)
        self._velocity = 0.0
        self._target = q

    def take(self, target: float) -> None:
        T, V, A = self._T, self._V, self._A
        ahead = min(max((target - self._target) / T, -V), V)
        self._target = target
        p = self.points[2]
        # what is left when we move along with the setpoint, and the speed from which that is
        # enough to brake in steps of A T
        rest = target - p - ahead * T
        braking = A * T * (sqrt(0.25 + 2.0 * abs(rest) / (A * T * T)) - 0.5)
        wanted = ahead + copysign(min(abs(rest) / T, braking), rest)
        wanted = min(max(wanted, self._velocity - A * T), self._velocity + A * T)
        wanted = min(max(wanted, -V), V)
        at_target = abs(target - p - wanted * T) <= 1e-12 * (1.0 + abs(target))
        after = target if at_target else p + wanted * T
        self._velocity = wanted
        self.points = (self.points[1], p, after)
        self.shares = (self.shares[1], min(self.shares[1] + 1.0 / _BACK, 1.0) if at_target else 0.0)
