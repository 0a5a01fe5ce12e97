# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What proves a misprint: a reference beside the corrected and the printed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

#: a printed form must miss the reference by so many tolerances; anything less proves nothing
CLEARANCE = 5.0


@dataclass(frozen=True)
class Between:
    """A reference that is a range: what the text or physics demands of a number."""

    low: float
    high: float


@dataclass(frozen=True)
class Evidence:
    """Corrected and printed form beside a reference.

    Parameters
    ----------
    quantity : what is compared. unit : its unit, "" for words and pure numbers.
    by : how the reference was derived.
    reference : numbers (scalar or array), a :class:`Between`, or words and sets, which must agree
        exactly. correct, printed : the same quantity by the two forms; an array of another shape
        than the reference's disagrees.
    tolerance : in the unit; what rounding, or the digits that the thesis prints, can explain.
    """

    quantity: str
    unit: str
    by: str
    reference: Any
    correct: Any
    printed: Any
    tolerance: float = 0.0

    @property
    def is_numeric(self) -> bool:
        return isinstance(self.reference, Between) or _numbers(self.reference) is not None

    @property
    def correct_error(self) -> float:
        """Greatest distance of the corrected form from the reference; for words 0 or 1."""
        return self._distance(self.correct)

    @property
    def printed_error(self) -> float:
        """Greatest distance of the printed form from the reference; for words 0 or 1."""
        return self._distance(self.printed)

    @property
    def proved(self) -> bool:
        """Whether the corrected form agrees with the reference and the printed form does not."""
        return self.correct_error <= self.tolerance and self.printed_error > CLEARANCE * self.tolerance

    def effect(self) -> str:
        """What the misprint does to the numbers, in a sentence."""
        unit = f" {self.unit}" if self.unit else ""
        if not self.is_numeric:
            return f"{self.quantity}: {_words(self.printed)} instead of {_words(self.correct)}."
        correct, printed = _numbers(self.correct), _numbers(self.printed)
        if isinstance(self.reference, Between):
            low, high = self.reference.low, self.reference.high
            range_ = (
                f"above {low:.4g}"
                if not np.isfinite(high)
                else f"below {high:.4g}"
                if not np.isfinite(low)
                else f"{low:.4g} to {high:.4g}"
            )
            return (
                f"{self.quantity}: {_list(printed)}{unit} as printed, {_list(correct)}{unit} "
                f"corrected; it must be {range_}{unit}."
            )
        if printed.shape != correct.shape or printed.size <= 3:
            return f"{self.quantity}: {_list(printed)}{unit} as printed, {_list(correct)}{unit} corrected."
        size = float(np.max(np.abs(_numbers(self.reference))))
        return (
            f"{self.quantity}: wrong by up to {self.printed_error:.4g}{unit}, where the true "
            f"values reach {size:.4g}{unit}."
        )

    def _distance(self, value) -> float:
        if isinstance(self.reference, Between):
            value = _numbers(value)
            below, above = self.reference.low - value, value - self.reference.high
            return float(max(0.0, np.max(below), np.max(above)))
        reference = _numbers(self.reference)
        if reference is None:
            return 0.0 if value == self.reference else 1.0
        value = _numbers(value)
        if value is None or value.shape != reference.shape:
            return float("inf")
        return float(np.max(np.abs(value - reference)))


@dataclass(frozen=True)
class Erratum:
    """One misprint.

    key : short name, unique. where : section or equation. printed, correct : the two forms.
    evidence : computes the proof. note : what else a reader should know.
    """

    key: str
    where: str
    printed: str
    correct: str
    evidence: Callable[[], Evidence]
    note: str = ""


def _numbers(value):
    """The value as an array of floats, or None for words, sets and truth values."""
    if isinstance(value, (str, bool, frozenset, Between)) or value is None:
        return None
    array = np.asarray(value)
    return array.astype(float) if array.dtype.kind in "fiu" else None


def _words(value) -> str:
    if isinstance(value, (frozenset, tuple)):
        return ", ".join(sorted(map(str, value)) if isinstance(value, frozenset) else map(str, value))
    return str(value)


def _list(values: np.ndarray) -> str:
    # what is left of a zero by rounding is a zero
    items = [f"{value if abs(value) > 1e-12 else 0.0:.5g}" for value in np.atleast_1d(values).ravel()]
    return items[0] if len(items) == 1 else f"({', '.join(items)})"
