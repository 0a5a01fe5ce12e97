# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What rounding alone lets be true: bounds on parameters without any statistics.

A voltage that was rounded to a step d says that the controller's own was within d/2 of it. Each
sample so gives two linear inequalities in the parameters; all of them together enclose a set, and
linear programmes find its ends (Milanese and Belforte 1982). Where the set is empty, no linear
law of that kind made the record. The ends close in as 1/samples, not as its square root.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linprog

#: share of the half step that a sample may be off by: rounding of the record's own numbers
_SLACK = 1e-4
#: few unknowns and thousands of rows: looking for rows to leave out takes longer than solving
_OPTIONS = {"presolve": False}


class Enclosure:
    """All theta (n,) with |value - row' theta| <= step/2 in every row.

    rows (m, n), values (m,), step (m,) or a number, in the unit of the values.
    """

    def __init__(self, rows: np.ndarray, values: np.ndarray, step: ArrayLike):
        half = np.broadcast_to(0.5 * np.asarray(step, dtype=float), values.shape)
        rows = rows / half[:, None]
        # the solver's tolerances are absolute: all coefficients at most 1
        self._scale = np.abs(rows).max(axis=0)
        rows = rows / self._scale
        self._sides = np.vstack([rows, -rows])
        self._limits = np.concatenate([values / half, -values / half]) + 1.0 + _SLACK
        self._found: dict[tuple[float, ...], tuple[float, float] | None] = {}

    def is_empty(self) -> bool:
        """Whether no theta fits."""
        return self._solve(np.zeros(len(self._scale))) is None

    def ends(self, along: Iterable[float]) -> tuple[float, float] | None:
        """Least and greatest value of along' theta; None where the set is empty."""
        along = tuple(float(a) for a in along)
        if along not in self._found:
            cost = np.array(along) / self._scale
            size = float(np.abs(cost).max())
            low, high = (self._solve(sign * cost / size) for sign in (1.0, -1.0))
            self._found[along] = None if low is None or high is None else (low * size, -high * size)
        return self._found[along]

    def ratio_ends(self, above: Iterable[float], below: Iterable[float]) -> tuple[float, float] | None:
        """Least and greatest above' theta / below' theta, where below' theta > 0 in all of the set.

        Charnes and Cooper (1962): theta / (below' theta) and 1 / (below' theta) as unknowns. None
        where the set is empty or below' theta is not positive in all of it.
        """
        above, below = np.array(list(above), dtype=float), np.array(list(below), dtype=float)
        denominator = self.ends(below)
        if denominator is None or denominator[0] <= 0.0:
            return None
        # the unknowns are y = theta t and t, with below' y = unit, so that t is about 1
        unit = 0.5 * (denominator[0] + denominator[1])
        cost = np.append(above / self._scale, 0.0)
        size = np.abs(cost).max()
        found = []
        limits = {
            "A_ub": np.column_stack([self._sides, -self._limits]),
            "b_ub": np.zeros(len(self._limits)),
            "A_eq": np.append(below / self._scale, 0.0)[None, :],
            "b_eq": [unit],
            "bounds": [(None, None)] * len(self._scale) + [(0.0, None)],
        }
        for sign in (1.0, -1.0):
            result = linprog(sign * cost / size, **limits, method="highs", options=_OPTIONS)
            if result.status != 0:
                return None
            found.append(float(sign * result.fun * size / unit))
        return found[0], found[1]

    def _solve(self, cost: np.ndarray) -> float | None:
        free = [(None, None)] * len(self._scale)
        result = linprog(cost, A_ub=self._sides, b_ub=self._limits, bounds=free, method="highs", options=_OPTIONS)
        return float(result.fun) if result.status == 0 else None


def joint_rows(first: np.ndarray, second: np.ndarray, shared: int) -> np.ndarray:
    """Rows of two records in one: the first `shared` parameters in common, the others each's own.

    first (m1, n1), second (m2, n2); the result is (m1 + m2, n1 + n2 - shared).
    """
    rows = np.zeros((len(first) + len(second), first.shape[1] + second.shape[1] - shared))
    rows[: len(first), : first.shape[1]] = first
    rows[len(first) :, :shared] = second[:, :shared]
    rows[len(first) :, first.shape[1] :] = second[:, shared:]
    return rows
