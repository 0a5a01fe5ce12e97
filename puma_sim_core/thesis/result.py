# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What an experiment gives back: rows beside the printed numbers, figures, numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

STYLES = ("line", "dashed", "points", "steps")
#: a row agrees with the print when the two differ by no more than this share
AGREEMENT = 0.01


@dataclass(frozen=True)
class Row:
    """One quantity: what the thesis prints and what this project finds.

    Parameters
    ----------
    quantity : what it is, in words or with the thesis's symbol.
    unit : its unit, "" for none.
    printed : the thesis's number or words; None where it prints nothing.
    ours : this project's number or words.
    note : plain sentence where the two differ, and why.
    agrees : whether the two agree; None leaves it to :attr:`differs`.
    """

    quantity: str
    unit: str
    printed: float | str | None
    ours: float | str
    note: str = ""
    agrees: bool | None = None

    def __post_init__(self) -> None:
        for name in ("printed", "ours"):
            value = _plain(getattr(self, name), f"row {self.quantity!r}, {name}")
            object.__setattr__(self, name, value)

    @property
    def differs(self) -> bool | None:
        """Whether ours is off the printed number by more than a hundredth.

        None where the two are not both numbers, so that only a reader can tell.
        """
        if self.agrees is not None:
            return not self.agrees
        if not _is_number(self.printed) or not _is_number(self.ours):
            return None
        greatest = max(abs(self.printed), abs(self.ours))
        return abs(self.printed - self.ours) > AGREEMENT * greatest


@dataclass(frozen=True)
class Curve:
    """One line of a figure. x, y: arrays of one length; NaN makes a gap.

    style : "line", "dashed", "points" or "steps" (the value holds until the next x).

    Raises
    ------
    ValueError : unequal lengths, no points, or an unknown style.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    style: str = "line"

    def __post_init__(self) -> None:
        x, y = (np.atleast_1d(np.asarray(v, dtype=float)) for v in (self.x, self.y))
        if x.ndim != 1 or x.shape != y.shape or x.size == 0:
            raise ValueError(
                f"curve {self.label!r}: x {x.shape} and y {y.shape}; expected two equally long, non-empty vectors"
            )
        if self.style not in STYLES:
            raise ValueError(f"curve {self.label!r}: style {self.style!r}; expected {STYLES}")
        object.__setattr__(self, "x", x)
        object.__setattr__(self, "y", y)


@dataclass(frozen=True)
class Figure:
    """A plot of curves.

    ``key`` is the thesis's plot number ("7.17"), its figure ("figure 2.7"), or a name of our own.
    ``equal``: a metre across is as long as a metre up.
    """

    key: str
    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    note: str = ""
    log_x: bool = False
    log_y: bool = False
    equal: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "curves", tuple(self.curves))
        if not self.curves:
            raise ValueError(f"figure {self.key}: no curves; expected at least one")


@dataclass(frozen=True)
class Heatmap:
    """A map of one value over two axes: x (nx,), y (ny,), values (ny, nx); NaN is left white.

    Raises
    ------
    ValueError : the shapes do not fit.
    """

    key: str
    title: str
    x_label: str
    y_label: str
    x: np.ndarray
    y: np.ndarray
    values: np.ndarray
    value_label: str
    note: str = ""

    def __post_init__(self) -> None:
        for name in ("x", "y", "values"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        if self.x.ndim != 1 or self.y.ndim != 1 or (self.values.shape != (self.y.size, self.x.size)):
            raise ValueError(
                f"heatmap {self.key}: x {self.x.shape}, y {self.y.shape}, values "
                f"{self.values.shape}; expected (nx,), (ny,), (ny, nx)"
            )


@dataclass(frozen=True)
class Result:
    """Everything that one experiment found.

    Parameters
    ----------
    summary : plain sentences for a person; the first stands alone in the list of contents.
    rows : quantities beside the printed ones.
    figures : the redrawn plots.
    numbers : further numbers for the JSON (and the page), by name.
    page_rows, page_figures : shown in the page and left out of the JSON, since they change from
        run to run (measured run times).
    """

    summary: str
    rows: tuple[Row, ...] = ()
    figures: tuple[Figure | Heatmap, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    page_rows: tuple[Row, ...] = ()
    page_figures: tuple[Figure | Heatmap, ...] = ()

    def __post_init__(self) -> None:
        for name in ("rows", "figures", "page_rows", "page_figures"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(
            self, "numbers", {str(name): _plain(value, f"number {name!r}") for name, value in self.numbers.items()}
        )


def matrix_text(rows: Sequence[Sequence[str]]) -> str:
    """A matrix as lines with its columns one below the other; tables show it so."""
    texts = [[text.replace("-", "\N{MINUS SIGN}") for text in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts)]
    return "\n".join("  ".join(f"{text:>{width}}" for text, width in zip(row, widths)) for row in texts)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _plain(value: Any, where: str) -> Any:
    """NumPy's types as Python's; a number that is not finite is refused, since JSON has none."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, (list, tuple)):
        return [_plain(item, where) for item in value]
    if isinstance(value, Mapping):
        return {str(name): _plain(item, where) for name, item in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{where}: {value}; expected a finite number (or words, or None)")
    if value is not None and not isinstance(value, (bool, int, float, str)):
        raise ValueError(f"{where}: {type(value).__name__}; expected a number, words or a list")
    return value
