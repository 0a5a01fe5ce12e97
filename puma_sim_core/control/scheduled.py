# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""PID control whose gains follow the pose: tables over q2 and q3, interpolated linearly.

Section 7.8 concludes that the PUMA's own controllers do this. D, C and G depend on q2 and q3
alone, and so do the tables. Between their points the gains are interpolated linearly in both
angles; beyond their edges the gains of the edge hold.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite
from typing import Any

import numpy as np

from puma_sim_core.checks import check_keys, check_positive, check_three_each
from puma_sim_core.control.sample_laws import packed, schedule_table, scheduled_gains, scheduled_pid
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import fitting
from puma_sim_core.servo.pid import PidGains

_WHERE = "gain schedule"
_NOTHING: tuple[float, ...] = (0.0,) * 9
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
    def table(self) -> list[float]:
        """The numbers of it in a row, see `sample_laws.schedule_table`."""
        return schedule_table(self.q2, self.q3, [getattr(self, name)[j] for j in range(3) for name in GAIN_NAMES])

    def at(self, q2: float, q3: float) -> list[tuple[float, float, float]]:
        """(gain, integral_time, derivative_time) of each joint at a pose [rad]."""
        values = fitting(scheduled_gains, self.table)(self.table, q2, q3)
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
        self._constants = packed(schedule.table)
        self._how = (self.period, self.limit, float(self.on_measurement))
        self.reset()

    def reset(self) -> None:
        """Forget the past: no sum, and no derivative at the next sample."""
        self._known = _NOTHING

    def update(self, t: float, setpoint: Sequence[float], measurement: Sequence[float]) -> tuple[float, ...]:
        """Volts for one sample at time t [s]; setpoint and measurement (3,) [rad]; raises ParameterError on others."""
        check_three_each(setpoint, measurement, "scheduled PID")
        (q1, q2, q3), (r1, r2, r3), c = measurement, setpoint, self._constants
        q, r = (float(q1), float(q2), float(q3)), (float(r1), float(r2), float(r3))
        volts: tuple[float, ...]
        volts, self._known = fitting(scheduled_pid, c)(c, self._how, q, r, self._known)
        return volts
