# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A figure as data: axes with labels, and layers from the bottom to the top."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

#: colours by name, on a light page and on a dark one; those of layers differ to any colour vision
COLOURS = {
    "paper": ("#ffffff", "#14171a"),
    "ink": ("#1c1f23", "#e4e7ea"),
    "soft": ("#525a63", "#a7b0b9"),
    "line": ("#d6dade", "#394149"),
    "span": ("#e9eff6", "#24303c"),
    "grey": ("#979ea5", "#79828b"),
    "blue": ("#0060a8", "#4f9fe6"),
    "orange": ("#c8500a", "#f08a45"),
    "green": ("#00785a", "#35b792"),
    "purple": ("#a8487f", "#dc86b5"),
    "black": ("#3a3a3a", "#c6c6c6"),
    "yellow": ("#b88a00", "#dcb53c"),
    "sky": ("#3c9dd8", "#a3d8f5"),
}


@dataclass(frozen=True)
class Layer:
    """One layer of a figure; NaN makes a gap.

    Parameters
    ----------
    kind : "line" and "steps" (x, y; a step holds until the next x), "dots" (x, y: a cloud, thinned),
        "marks" (x, y), "band" (x, from y to y2), "stems" (x, y: lines from zero), "spans" (from x to y,
        over the whole height), "map" (x (nx,), y (ny,), y2 (ny, nx): colours).
    label : its words in the legend, "" for none; of a map the label of the colour bar.
    colour : one of `COLOURS`.
    dashes : lengths of strokes and gaps [line widths], () for a full line.
    marker : matplotlib's name of the mark; hollow : only its outline.
    """

    kind: str
    x: np.ndarray
    y: np.ndarray
    y2: np.ndarray | float = 0.0
    label: str = ""
    colour: str = "ink"
    width: float = 1.3
    opacity: float = 1.0
    dashes: tuple[float, ...] = ()
    marker: str = ""
    size: float = 4.0
    hollow: bool = False


@dataclass(frozen=True)
class Figure:
    """One pair of axes; the labels carry the units.

    Parameters
    ----------
    x_range, y_range : limits; those of the layers where None.
    y_names : names of the rows y = 0, 1, ... in place of numbers.
    height, width : of the drawing [inch].
    equal : a metre across is as long as a metre up.
    note : a sentence below the figure.
    """

    title: str
    x_label: str
    y_label: str
    layers: tuple[Layer, ...]
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    log_x: bool = False
    log_y: bool = False
    equal: bool = False
    y_names: tuple[str, ...] = ()
    height: float = 2.95
    width: float = 4.6
    note: str = ""


def legend(figures: Iterable[Figure]) -> list[Layer]:
    """The first layer of each label in these figures, for the legend that they share."""
    labelled: dict[str, Layer] = {}
    for figure in figures:
        for layer in figure.layers:
            if layer.label and layer.kind != "map":
                labelled.setdefault(layer.label, layer)
    return list(labelled.values())
