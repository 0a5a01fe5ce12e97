# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The page of the results, with the printed numbers beside ours, and the JSON: the same results, the same bytes.

The page's template is `templates/thesis.html`; figures of the thesis become figures of the pages here.
"""

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from puma_sim_core import __version__
from puma_sim_core import json_text as layout
from puma_sim_core.pages import figure as pages
from puma_sim_core.pages.page import environment, render
from puma_sim_core.pages.text import number_text
from puma_sim_core.thesis.registry import Experiment
from puma_sim_core.thesis.result import Curve, Figure, Heatmap, Result

#: raised when the layout of the JSON changes
FORMAT = 1
#: points that the JSON keeps of a curve, about
POINTS = 480
#: lists longer than this stand in the JSON alone
_LIST = 6
_COLOURS = ("blue", "orange", "green", "purple", "black", "yellow", "sky")
#: a second round of the colours is told from the first by its dashes
_DASHES: tuple[tuple[float, ...], ...] = ((), (1.0, 1.0), (4.0, 1.0, 1.0, 1.0))
_MARKERS = "osD^v"
Found = tuple[Experiment, Result]


def page(results: Mapping[str, Found], seed: int, progress: Callable[[float], None] = lambda share: None) -> str:
    """The page of experiments by number; progress is called with the share of them that are drawn."""
    found = list(results.values())

    def counted() -> Iterator[Found]:
        for index, each in enumerate(found):
            yield each
            progress((index + 1) / len(found))

    return render(_PAGES, "thesis.html", contents=found, sections=counted(), seed=seed)


def first_sentence(text: str) -> str:
    """The first sentence of a summary, for lists of contents."""
    return re.split(r"(?<=[.!?])\s+(?=[A-Z])", " ".join(text.split()), maxsplit=1)[0]


def drawn(figure: Figure | Heatmap) -> pages.Figure:
    """The figure as the pages draw it."""
    # the thesis's plots are all in chapter 7; other keys belong to drawings of our own
    name = f"Plot {figure.key}" if re.fullmatch(r"7\.\d+[a-z]?", figure.key) else ""
    if figure.key.startswith("figure "):
        name = figure.key.capitalize()
    words = (f"{name}. {figure.title}" if name else figure.title, figure.x_label, figure.y_label)
    if isinstance(figure, Heatmap):
        layers = [pages.Layer("map", figure.x, figure.y, figure.values, label=figure.value_label)]
        return pages.Figure(*words, tuple(layers), note=figure.note)
    layers = [_layer(curve, index) for curve, index in zip(figure.curves, _partners(figure.curves))]
    how = {name: getattr(figure, name) for name in ("log_x", "log_y", "equal", "note")}
    return pages.Figure(*words, tuple(layers), **how)


def _partners(curves: Sequence[Curve]) -> list[int]:
    """Index of the colour of each curve: as many dashed curves (or points) as full ones share their colours."""
    index = list(range(len(curves)))
    full = [i for i in index if curves[i].style in ("line", "steps")]
    for style in ("dashed", "points"):
        others = [i for i, curve in enumerate(curves) if curve.style == style]
        if len(others) == len(full) > 1:
            for rank, pair in enumerate(zip(full, others)):
                for i in pair:
                    index[i] = rank
    return index


def _layer(curve: Curve, index: int) -> pages.Layer:
    kind = {"dashed": "line", "points": "marks"}.get(curve.style, curve.style)
    marked = kind == "marks" or curve.x.size == 1
    return pages.Layer(
        kind,
        curve.x,
        curve.y,
        label=curve.label,
        colour=_COLOURS[index % len(_COLOURS)],
        dashes=(4.0, 2.0) if curve.style == "dashed" else _DASHES[(index // len(_COLOURS)) % len(_DASHES)],
        marker=_MARKERS[index % len(_MARKERS)] if marked else "",
        # a measured curve; large marks would run into a band
        size=1.8 if kind == "marks" and curve.x.size > 60 else 4.0,
    )


def _short(value: Any) -> str:
    """A further number as the page shows it; long lists are named."""
    if isinstance(value, dict):
        return f"{len(value)} entries, in the JSON"
    if isinstance(value, list):
        if len(value) > _LIST or any(isinstance(item, (list, dict)) for item in value):
            return f"{len(value)} values, in the JSON"
        return ", ".join(map(_short, value))
    return "none" if value is None else number_text(value)


_PAGES = environment(
    "puma_sim_core.thesis",
    anchor=lambda found: "e" + re.sub(r"[^0-9A-Za-z]+", "-", found.number),
    number=lambda found: found.number if found.number[:1].isdigit() else "",
    drawn=drawn,
    first_sentence=first_sentence,
    number_text=number_text,
    paragraphs=lambda text: re.split(r"\n\s*\n", text.strip()),
    short=_short,
)


def json_text(results: Mapping[str, Found], seed: int) -> str:
    """The results of experiments by number; rows and figures in order, all keys sorted.

    Numbers stand with as many digits as tell them from their neighbours. A gap of a curve is
    null. Rows and figures that change from run to run are left out.
    """
    content = [
        {
            **{name: getattr(found, name) for name in ("number", "chapter", "title")},
            "summary": result.summary,
            "rows": [{**vars(row), "agrees": None if row.differs is None else not row.differs} for row in result.rows],
            "figures": [_figure(figure) for figure in result.figures],
            "numbers": result.numbers,
        }
        for found, result in results.values()
    ]
    head = {"format": FORMAT, "version": __version__, "seed": seed}
    return layout.json_text({**head, "experiments": content}, sort_keys=True)


def thin(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) of at most about `POINTS` points of a curve: first, least and greatest of each run of neighbours."""
    x, y = curve.x, curve.y
    if x.size <= POINTS:
        return x, y
    edges = np.linspace(0, x.size, POINTS // 3 + 1).astype(int)
    keep = {0, x.size - 1}
    for first, last in itertools.pairwise(edges):
        part = y[first:last]
        keep.add(first)
        if not np.all(np.isnan(part)):
            keep.update((first + np.nanargmin(part), first + np.nanargmax(part)))
    # a gap that fell between kept points would be drawn over
    keep.update(np.flatnonzero(np.diff(np.isnan(y).astype(int)) == 1) + 1)
    index = sorted(keep)
    return x[index], y[index]


def _figure(figure: Figure | Heatmap) -> dict[str, Any]:
    if isinstance(figure, Heatmap):
        return {**vars(figure), **{name: _list(getattr(figure, name)) for name in ("x", "y", "values")}}
    curves = [
        {"label": curve.label, "style": curve.style, **dict(zip("xy", map(_list, thin(curve))))}
        for curve in figure.curves
    ]
    return {name: value for name, value in vars(figure).items() if name != "equal"} | {"curves": curves}


def _list(values: np.ndarray) -> list[Any]:
    if values.ndim > 1:
        return [_list(row) for row in values]
    return [value if math.isfinite(value) else None for value in values.tolist()]
