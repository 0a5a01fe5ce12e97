# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What an experiment gives back: rows beside the printed numbers, figures, numbers.

All raise ValueError for what cannot be drawn or written: numbers that are not finite, shapes that
do not fit, an unknown style.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeGuard

import numpy as np

STYLES = ("line", "dashed", "points", "steps")
#: a row agrees with the print when the two differ by no more than this share
AGREEMENT = 0.01
#: further numbers of an experiment by name
Numbers = dict[str, Any]


@dataclass(frozen=True)
class Row:
    """One quantity: what the thesis prints (None: nothing) and what this project finds, as numbers or words.

    note : where the two differ, and why; agrees : whether the two agree, None leaves it to :attr:`differs`.
    """

    quantity: str
    unit: str
    printed: float | str | None
    ours: float | str
    note: str = ""
    agrees: bool | None = None

    def __post_init__(self) -> None:
        _set(self, **{n: _plain(getattr(self, n), f"row {self.quantity!r}, {n}") for n in ("printed", "ours")})

    @property
    def differs(self) -> bool | None:
        """Whether ours is off the printed number by more than a hundredth; None unless both are numbers."""
        if self.agrees is not None:
            return not self.agrees
        if not _is_number(self.printed) or not _is_number(self.ours):
            return None
        return abs(self.printed - self.ours) > AGREEMENT * max(abs(self.printed), abs(self.ours))


@dataclass(frozen=True)
class Curve:
    """One line of a figure of one of the STYLES ("steps": y holds until the next x); NaN makes a gap."""

    label: str
    x: np.ndarray
    y: np.ndarray
    style: str = "line"

    def __post_init__(self) -> None:
        x, y = (np.atleast_1d(np.asarray(v, dtype=float)) for v in (self.x, self.y))
        if x.ndim != 1 or x.shape != y.shape or x.size == 0 or self.style not in STYLES:
            raise ValueError(
                f"curve {self.label!r}: x {x.shape}, y {y.shape}, style {self.style!r}; "
                f"expected two equally long, non-empty vectors and one of {STYLES}"
            )
        _set(self, x=x, y=y)


@dataclass(frozen=True)
class Figure:
    """A plot of curves, one at least.

    key : plot ("7.17") or figure ("figure 2.7") of the thesis, or our own; equal : a metre across is one up.
    """

    key: str
    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve]
    note: str = ""
    log_x: bool = False
    log_y: bool = False
    equal: bool = False

    def __post_init__(self) -> None:
        _set(self, curves=tuple(self.curves))
        if not self.curves:
            raise ValueError(f"figure {self.key}: no curves; expected at least one")


@dataclass(frozen=True)
class Heatmap:
    """A map of one value over two axes: x (nx,), y (ny,), values (ny, nx); NaN is left white."""

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
        x, y, values = (np.asarray(v, dtype=float) for v in (self.x, self.y, self.values))
        if x.ndim != 1 or y.ndim != 1 or values.shape != (y.size, x.size):
            raise ValueError(
                f"heatmap {self.key}: x {x.shape}, y {y.shape}, values {values.shape}; expected (nx,), (ny,), (ny, nx)"
            )
        _set(self, x=x, y=y, values=values)


@dataclass(frozen=True)
class Result:
    """Everything that one experiment found.

    summary : its first sentence stands alone in the list of contents; numbers : further ones by name;
    page_rows, page_figures : not in the JSON, since they change from run to run (measured run times).
    """

    summary: str
    rows: Sequence[Row] = ()
    figures: Sequence[Figure | Heatmap] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    page_rows: Sequence[Row] = ()
    page_figures: Sequence[Figure | Heatmap] = ()

    def __post_init__(self) -> None:
        _set(self, **{name: tuple(getattr(self, name)) for name in ("rows", "figures", "page_rows", "page_figures")})
        _set(self, numbers={str(name): _plain(value, f"number {name!r}") for name, value in self.numbers.items()})


def significant(value: Any, digits: int) -> Any:
    """A number, or each one of a list, with so many significant digits."""
    return [significant(each, digits) for each in value] if np.ndim(value) else float(f"{value:.{digits}g}")


def matrix_text(rows: Sequence[Sequence[str]]) -> str:
    """A matrix as lines with its columns one below the other; tables show it so."""
    texts = [[text.replace("-", "\N{MINUS SIGN}") for text in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts)]
    return "\n".join("  ".join(f"{text:>{width}}" for text, width in zip(row, widths)) for row in texts)


def _set(frozen: object, **values: object) -> None:
    """Set fields of a frozen dataclass while it is made."""
    for name, value in values.items():
        object.__setattr__(frozen, name, value)


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _plain(value: Any, where: str) -> Any:
    """NumPy's types as Python's; a number that is not finite is refused, since JSON has none."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item, where) for item in value]
    if isinstance(value, Mapping):
        return {str(name): _plain(item, where) for name, item in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{where}: {value}; expected a finite number (or words, or None)")
    if value is not None and not isinstance(value, (bool, int, float, str)):
        raise ValueError(f"{where}: {type(value).__name__}; expected a number, words or a list")
    return value
