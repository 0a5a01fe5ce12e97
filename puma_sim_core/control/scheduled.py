# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""PID control whose gains follow the pose: tables over q2 and q3, interpolated linearly.

Section 7.8 concludes that the PUMA's own controllers do this. D, C and G depend on q2 and q3
alone, and so do the tables. Between their points the gains are interpolated linearly in both
angles; beyond their edges the gains of the edge hold.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite
from typing import Any

import numpy as np

from puma_sim_core.checks import check_keys, check_positive, check_three_each
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import interpreted
from puma_sim_core.servo.pid import PidGains, pid_law

_law: Callable[..., Any] = interpreted(pid_law)
_WHERE = "gain schedule"
GAIN_NAMES = ("gain", "integral_time", "derivative_time")
_KEYS = ("q2", "q3", *GAIN_NAMES)


@dataclass(frozen=True)
class GainSchedule:
    """Gains of the three joints as functions of q2 and q3.

    Parameters
    ----------
    q2, q3 : the angles of the tables [rad], increasing, two at least of each.
    gain [V/rad], integral_time [s] (inf: no integral action), derivative_time [s] : one entry a
        joint, each a number that holds everywhere or a table with a row for each q2 and a column
        for each q3; one row or one column holds for all.

    Raises ParameterError: names the entry and what was expected.
    """

    q2: tuple[float, ...]
    q3: tuple[float, ...]
    gain: Sequence[Any]
    integral_time: Sequence[Any]
    derivative_time: Sequence[Any]

    def __post_init__(self) -> None:
        for name in ("q2", "q3"):
            object.__setattr__(self, name, _angles(getattr(self, name), name))
        shape = (len(self.q2), len(self.q3))
        for name in GAIN_NAMES:
            entries = getattr(self, name)
            if isinstance(entries, str) or not isinstance(entries, Sequence) or len(entries) != 3:
                what = f"{name} = {entries!r}"
                raise ParameterError(what, where=_WHERE, expected="three entries, one for each joint")
            entries = tuple(_entry(entry, f"{name} of joint {j}", shape) for j, entry in enumerate(entries, 1))
            object.__setattr__(self, name, entries)
        for j in range(3):
            entries = [np.broadcast_to(getattr(self, name)[j], shape) for name in GAIN_NAMES]
            for values in np.stack(entries, axis=-1).reshape(-1, 3).tolist():
                # PidGains refuses what no controller can have
                check_positive(PidGains(*values).gain, f"gain of joint {j + 1}", "", _WHERE)

    @cached_property
    def _cells(self) -> list[list[tuple[Any, ...]]]:
        """For each interval of q2 and q3 the nine values: a number, or the two lower ones and their differences."""

        def cell(entry: Any, i: int, k: int) -> Any:
            if type(entry) is float:
                return entry
            low, high = entry[i], entry[i + 1]
            return low[k], low[k + 1] - low[k], high[k], high[k + 1] - high[k]

        entries = [getattr(self, name)[j] for j in range(3) for name in GAIN_NAMES]
        rows, columns = range(len(self.q2) - 1), range(len(self.q3) - 1)
        return [[tuple(cell(entry, i, k) for entry in entries) for k in columns] for i in rows]

    def at(self, q2: float, q3: float) -> list[tuple[float, float, float]]:
        """(gain, integral_time, derivative_time) of each joint at a pose [rad]."""
        i, a = _place(self.q2, q2)
        k, b = _place(self.q3, q3)
        values = []
        for value in self._cells[i][k]:
            if type(value) is not float:
                low, up, high, up_high = value
                left = low + b * up
                value = left + a * (high + b * up_high - left)
            values.append(value)
        return list(zip(values[::3], values[1::3], values[2::3]))

    def to_mapping(self) -> dict[str, list[Any]]:
        """Plain values for a file."""
        gains = {name: [np.array(entry).tolist() for entry in getattr(self, name)] for name in GAIN_NAMES}
        return {"q2": list(self.q2), "q3": list(self.q3), **gains}

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> GainSchedule:
        """The inverse of `to_mapping`; raises ParameterError."""
        check_keys(mapping, _KEYS, _WHERE)
        return cls(**mapping)


def _angles(values: Iterable[float], name: str) -> tuple[float, ...]:
    try:
        angles = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        angles = ()
    if len(angles) < 2 or not all(map(isfinite, angles)) or any(b <= a for a, b in itertools.pairwise(angles)):
        raise ParameterError(f"{name} = {values!r}", where=_WHERE, expected="increasing angles [rad], two at least")
    return angles


def _entry(entry: Any, what: str, shape: tuple[int, int]) -> Any:
    try:
        values = np.array(entry, dtype=float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape == () and not isinstance(entry, (bool, str)):
        return float(entry)
    if values.ndim != 2 or any(n not in (1, m) for n, m in zip(values.shape, shape)) or not np.isfinite(values).all():
        expected = f"a number, or {shape[0]} rows of {shape[1]} numbers"
        raise ParameterError(f"{what} = {entry!r}"[:200], where=_WHERE, expected=expected)
    return tuple(tuple(row) for row in np.broadcast_to(values, shape).tolist())


def _place(angles: Sequence[float], q: float) -> tuple[int, float]:
    """The interval of the table that q [rad] lies in, and the share of it, 0 to 1."""
    i = min(max(bisect_right(angles, q) - 1, 0), len(angles) - 2)
    return i, min(max((q - angles[i]) / (angles[i + 1] - angles[i]), 0.0), 1.0)


class ScheduledPid:
    """Independent PID control with scheduled gains; the law is that of `pid.Pid`.

    The sum of the integral action is kept in volts, so that a change of the gain moves nothing by
    itself. With the same gains everywhere it gives the same bits as `pid.Pid`.

    period : h [s], the stated rate of `update`; limit : greatest magnitude of the output [V];
    on_measurement : take the derivative of the measurement, not of the error.

    Raises ParameterError: a period or limit that is not positive.
    """

    def __init__(self, schedule: GainSchedule, period: float, *, limit: float = inf, on_measurement: bool = True):
        self.schedule = schedule
        self.period = check_positive(period, "period", "s", "scheduled PID")
        self.limit = check_positive(limit, "limit", "V", "scheduled PID", infinite=True)
        self.on_measurement = bool(on_measurement)
        self.reset()

    def reset(self) -> None:
        """Forget the past: no sum, and no derivative at the next sample."""
        self._total = (0.0, 0.0, 0.0)
        self._gain: tuple[float, float, float] | None = None
        self._before: tuple[float, float, float] | None = None

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """Volts for one sample at time t [s]; setpoint and measurement (3,) [rad]; raises ParameterError on others."""
        check_three_each(setpoint, measurement, "scheduled PID")
        # joint by joint, without a loop: an appraisal calls this a thousand times a second
        q1, q2, q3 = map(float, measurement)
        (g1, i1, d1), (g2, i2, d2), (g3, i3, d3) = self.schedule.at(q2, q3)
        r1, r2, r3 = map(float, setpoint)
        error = e1, e2, e3 = r1 - q1, r2 - q2, r3 - q3
        now = n1, n2, n3 = (-q1, -q2, -q3) if self.on_measurement else error
        (b1, b2, b3), (s1, s2, s3), h, limit = self._before or now, self._total, self.period, self.limit
        k1, k2, k3 = self._gain or (g1, g2, g3)
        u1, s1 = _law(e1, n1, b1, s1 * (k1 / g1), g1, h / i1, d1 / h, limit)
        u2, s2 = _law(e2, n2, b2, s2 * (k2 / g2), g2, h / i2, d2 / h, limit)
        u3, s3 = _law(e3, n3, b3, s3 * (k3 / g3), g3, h / i3, d3 / h, limit)
        self._before, self._total, self._gain = now, (s1, s2, s3), (g1, g2, g3)
        return u1, u2, u3
