# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""When each step is due on the wall clock, and how late it was. No ROS here; the clock is injected.

Simulated time is the number of steps times the period. A timer callback for each step would lose
steps, since ROS timers drop the periods that they miss; a schedule of deadlines cannot: a step
that is late is done late, and the next ones follow at once until the schedule is caught up. Only
where the process stood still for long (a debugger, a machine that slept) the schedule begins anew.
"""

import math
import time
from collections.abc import Callable
from itertools import accumulate

_LEAST_NS = 1000
_BINS_PER_FACTOR_TWO = 16
_BINS = 32 * _BINS_PER_FACTOR_TWO
#: a step that is later than so many periods, and than a second, is not caught up with: the schedule begins anew
GREATEST_LAG = 36
_GREATEST_LAG_NS = 1_000_000_000


class Lateness:
    """Statistics of lateness over any number of steps, in constant memory and time.

    A histogram whose bins grow by 2**(1/16): a quantile is given by the upper edge of its bin,
    at most 4.5 % above the true value. Below 1 us everything is one bin.
    """

    def __init__(self) -> None:
        self._counts = [0] * _BINS
        self.count = 0
        self.worst_ns = 0

    def add(self, late_ns: int) -> None:
        """Count one step that began ``late_ns`` [ns] after its deadline (negative counts as 0)."""
        self.count += 1
        self.worst_ns = max(self.worst_ns, late_ns)
        place = 0
        if late_ns > _LEAST_NS:
            place = min(math.ceil(_BINS_PER_FACTOR_TWO * math.log2(late_ns / _LEAST_NS)), _BINS - 1)
        self._counts[place] += 1

    def quantile(self, fraction: float) -> float:
        """Lateness [s] that ``fraction`` (0..1) of the steps did not exceed; 0 before any step."""
        wanted = max(1, math.ceil(fraction * self.count))
        for place, seen in enumerate(accumulate(self._counts)):
            if seen >= wanted:
                return min(_LEAST_NS * 2.0 ** (place / _BINS_PER_FACTOR_TWO), self.worst_ns) * 1e-9
        return 0.0

    @property
    def worst(self) -> float:
        """Greatest lateness [s]."""
        return self.worst_ns * 1e-9

    def in_ms(self) -> dict[str, str]:
        """Median, 99 % quantile and worst, as texts in ms."""
        values = {"median": self.quantile(0.5), "p99": self.quantile(0.99), "worst": self.worst}
        return {name: f"{1e3 * value:.3f}" for name, value in values.items()}


class Pacer:
    """The schedule of steps of `period_ns` [ns] on a clock [ns] that never goes back.

    The loop that uses it waits for `remaining`, and calls `begin_step` before each step. The k-th
    deadline is ``start + k * period / real_time_factor``: computed from the start, so that
    neither rounding nor lateness adds up.
    """

    def __init__(
        self, period_ns: int, real_time_factor: float = 1.0, clock: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._period_ns, self._clock = period_ns, clock
        self.lateness, self.steps = Lateness(), 0
        self.overruns = 0  #: steps that began when the next one was already due
        self.stalls, self.given_up = 0, 0.0  #: times that the schedule began anew, and what that left out [s]
        self._set_factor(real_time_factor)
        self.restart()

    def _set_factor(self, factor: float) -> None:
        if not (factor > 0.0 and math.isfinite(factor)):
            raise ValueError(f"real_time_factor {factor}; expected a finite number above 0")
        self._factor = factor
        self._wall_period = self._period_ns / factor

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds for each second of the clock."""
        return self._factor

    @real_time_factor.setter
    def real_time_factor(self, factor: float) -> None:
        # counted from the last deadline: a change of pace neither skips a step nor adds one
        anchor = self._deadline - self._wall_period
        self._set_factor(factor)
        self._start, self._scheduled = anchor, 1
        self._deadline = anchor + self._wall_period

    def restart(self) -> None:
        """Make the next step due one period from now: at the start, after a pause or a reset."""
        self._start, self._scheduled = self._clock(), 1
        self._deadline = self._start + self._wall_period

    def remaining(self) -> float:
        """Time until the next step is due [s]; 0 when it is due or late."""
        return max(0.0, (self._deadline - self._clock()) * 1e-9)

    def begin_step(self) -> None:
        """Count a step that begins now, and set the deadline of the one after it."""
        late_ns = self._clock() - self._deadline
        if late_ns > max(GREATEST_LAG * self._wall_period, _GREATEST_LAG_NS):
            # how late that was says nothing of the pace
            self.stalls += 1
            self.given_up += late_ns * 1e-9
            self.steps += 1
            self.restart()
            return
        self.lateness.add(int(late_ns))
        if late_ns >= self._wall_period:
            self.overruns += 1
        self.steps += 1
        self._scheduled += 1
        self._deadline = self._start + self._scheduled * self._wall_period

    def summary(self) -> str:
        """One line for a person."""
        late = ", ".join(f"{name} {value} ms" for name, value in self.lateness.in_ms().items())
        stalls = f", stalls {self.stalls} ({self.given_up:.3g} s given up)" if self.stalls else ""
        return f"steps {self.steps}, overruns {self.overruns}{stalls}, lateness {late}"
