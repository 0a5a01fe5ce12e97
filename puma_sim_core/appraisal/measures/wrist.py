# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The wrist between the rows of a response, and how far what repeats itself scatters (ISO 9283)."""

from collections import Counter
from collections.abc import Sequence
from math import sqrt
from typing import Any

import numpy as np

from puma_sim_core.appraisal.trials.response import Response
from puma_sim_core.control.curve import Curve, cubic
from puma_sim_core.errors import ParameterError

#: slack of a time that a sum of periods has rounded [s]
_ROUNDING = 1e-9


class Wrist:
    """Path of the wrist of a response, with its velocity.

    time (n,) [s]; position (n, 3) [m]; velocity (n, 3) [m/s]; commanded (n, 3) [m].

    Raises ParameterError: a response without an arm.
    """

    def __init__(self, response: Response):
        if response.arm is None or response.wrist is None or response.commanded_wrist is None:
            raise ParameterError(
                "no arm", where="measures at the wrist", expected="a response with the arm's kinematics"
            )
        self.time, self.commanded = response.time, response.commanded_wrist
        self.position, self.velocity = response.wrist

    def row(self, time: float) -> int:
        """The last row that is not behind a time [s]; ParameterError for a time outside the response."""
        low, high = float(self.time[0]), float(self.time[-1])
        if not low - _ROUNDING <= time <= high + _ROUNDING:
            expected = f"a time within the response, {low:.6g} to {high:.6g} s"
            raise ParameterError(f"{time:.6g} s", where="measures at the wrist", expected=expected)
        return int(np.searchsorted(self.time, time + _ROUNDING, side="right")) - 1

    def rows(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cubics (4, k, 3) [m] between rows (k,) and those behind them, and their lengths (k, 1) [s]."""
        length = (self.time[row + 1] - self.time[row])[:, None]
        ends = self.position[row], self.position[row + 1], self.velocity[row] * length, self.velocity[row + 1] * length
        return cubic(*ends), length

    def squared_distance(self, point: np.ndarray, start: float, until: float) -> Curve:
        """Square of the distance from a point (3,) [m], over the rows from start to until [s]."""
        first, last = self.row(start), self.row(until) + 1
        if last - first < 2:
            what = f"from {start:.6g} to {until:.6g} s: {last - first} rows"
            raise ParameterError(what, where="measures at the wrist", expected="two rows at least")
        away, moving = self.position[first:last] - point, self.velocity[first:last]
        return Curve(self.time[first:last], (away**2).sum(axis=1), 2.0 * (away * moving).sum(axis=1))


def repeatability(points: Sequence[np.ndarray]) -> float:
    """Mean distance of n >= 2 points (3,) from their barycentre, and three standard deviations of it (clause 7.2.2)."""
    distances = np.linalg.norm(np.asarray(points) - np.mean(points, axis=0), axis=1)
    return float(distances.mean()) + 3.0 * scatter(distances)


def scatter(values: Sequence[float] | np.ndarray) -> float:
    """Standard deviation with n - 1 of n >= 2 values."""
    return sqrt(float(np.var(values, ddof=1)))


def repeated(counts: Counter[Any], trials: int) -> bool:
    """Whether anything of these numbers in a trial occurs twice in so many trials."""
    return any(count * trials > 1 for count in counts.values())
