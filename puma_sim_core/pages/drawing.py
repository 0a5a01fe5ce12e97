# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Figures drawn by matplotlib as SVG inside a page; the same figure gives the same text.

A drawing is small enough that its letters stay readable when a page makes it as narrow as a phone.
Colours become variables of the style sheet, so that the page can be light or dark.
"""

import html
import io
import math
import os
import re
import textwrap
from collections.abc import Sequence

import matplotlib.style
import numpy as np
from matplotlib import figure as canvas
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from puma_sim_core.errors import RecordingError
from puma_sim_core.files import whole_bytes
from puma_sim_core.pages.figure import COLOURS, Figure, Layer, legend
from puma_sim_core.pages.text import raised

_LIGHT = {name: light for name, (light, _) in COLOURS.items()}
_VARIABLES = {light: f"var(--{name})" for name, light in _LIGHT.items()}
_DOTS = 500
_STYLE = {
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.5,
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.5,
    "text.parse_math": False,
    "text.color": _LIGHT["ink"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": _LIGHT["soft"],
    "axes.labelcolor": _LIGHT["ink"],
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.xmargin": 0.02,
    "axes.formatter.limits": (-4, 5),
    "axes.formatter.useoffset": False,
    "grid.color": _LIGHT["line"],
    "grid.linewidth": 0.6,
    "xtick.color": _LIGHT["soft"],
    "ytick.color": _LIGHT["soft"],
    "savefig.facecolor": "none",
    "figure.facecolor": "none",
    "axes.facecolor": "none",
}


def svg(figure: Figure, identifier: str) -> str:
    """The drawing as an ``<svg>`` element; no other on the page may have its identifier.

    Its attribute ``data-axes`` holds left, top, right and bottom of the axes as shares of the drawing, and the limits
    of x, for scripts that point into it.
    """
    with matplotlib.style.context(["default", {**_STYLE, "svg.hashsalt": identifier}]):
        drawing = canvas.Figure(figsize=(figure.width, figure.height), layout="constrained")
        axes = drawing.add_subplot()
        for layer in figure.layers:
            _draw(axes, layer)
        _set_axes(axes, figure)
        file = io.StringIO()
        metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        # `savefig` would draw twice
        FigureCanvasSVG(drawing).print_svg(file, metadata=metadata)  # type: ignore[no-untyped-call]
        box = axes.get_position()
        place = " ".join(f"{each:.6g}" for each in (box.x0, 1.0 - box.y1, box.x1, 1.0 - box.y0, *axes.get_xlim()))
    label = html.escape(f"{figure.title}: {figure.y_label} against {figure.x_label}")
    return _inline(file.getvalue(), label, place)


def save(figures: Sequence[Figure], path: str | os.PathLike[str]) -> None:
    """Write figures over one x, one below the other, as a picture: PNG, SVG or PDF, by the ending of the path.

    Raises RecordingError: the file cannot be written.
    """
    with matplotlib.style.context(["default", {**_STYLE, "savefig.facecolor": _LIGHT["paper"], "svg.hashsalt": "0"}]):
        tall = 0.4 + sum(figure.height for figure in figures)
        drawing = canvas.Figure(figsize=(2 * figures[0].width, tall), layout="constrained")
        ratios = [figure.height for figure in figures]
        several = drawing.subplots(len(figures), sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
        for axes, figure in zip(several, figures):
            for layer in figure.layers:
                _draw(axes, layer)
            _set_axes(axes, figure)
            axes.set_title(figure.title, loc="left", fontsize="medium")
            axes.label_outer()
        lines = [
            Line2D([], [], color=_LIGHT[each.colour], dashes=each.dashes or (None, None), label=each.label)
            for each in legend(figures)
        ]
        drawing.legend(handles=lines, loc="outside lower center", ncols=max(1, len(lines)), frameon=False)
        kind = os.path.splitext(path)[1][1:].lower()
        # without the date: the same log, the same bytes
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
        picture = io.BytesIO()
        drawing.savefig(picture, format=kind, dpi=150, metadata=dates)
    with whole_bytes(path, RecordingError) as file:
        file.write(picture.getvalue())


def _draw(axes: Axes, layer: Layer) -> None:
    x, y, colour = layer.x, layer.y, _LIGHT[layer.colour]
    if layer.kind == "map":
        axes.grid(False)
        mesh = axes.pcolormesh(x, y, np.ma.masked_invalid(layer.y2), shading="nearest", cmap="viridis", rasterized=True)
        axes.figure.colorbar(mesh, ax=axes, label=_lines(layer.label, 34))
    elif layer.kind == "spans":
        for begin, end in zip(x, y):
            axes.axvspan(begin, end, color=colour, linewidth=0.7, zorder=0)
    elif layer.kind == "band":
        axes.fill_between(x, y, layer.y2, color=colour, alpha=layer.opacity, linewidth=0.0)
    elif layer.kind == "stems":
        axes.vlines(x, 0.0, y, color=colour, linewidth=layer.width)
    elif layer.kind == "dots":
        keep = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
        # evenly, but no multiple of a period of the record
        keep = keep[np.unique(np.linspace(0, keep.size - 1, min(keep.size, _DOTS)).astype(int))]
        axes.plot(x[keep], y[keep], ".", color=colour, alpha=layer.opacity, markersize=layer.size, markeredgewidth=0.0)
    else:
        axes.plot(
            x,
            y,
            color=colour,
            linestyle="none" if layer.kind == "marks" else (0, layer.dashes) if layer.dashes else "-",
            linewidth=layer.width,
            drawstyle="steps-post" if layer.kind == "steps" else "default",
            marker=layer.marker,
            markersize=layer.size,
            markerfacecolor=_LIGHT["paper"] if layer.hollow else colour,
            markeredgewidth=1.6 if layer.hollow or layer.marker == "|" else 0.0,
        )


def _set_axes(axes: Axes, figure: Figure) -> None:
    axes.set_xlabel(_lines(figure.x_label, 56))
    axes.set_ylabel(_lines(figure.y_label, 34))
    if figure.equal:
        axes.set_aspect("equal", adjustable="datalim")
    for axis, log, limits in (("x", figure.log_x, figure.x_range), ("y", figure.log_y, figure.y_range)):
        if log:
            axes.set(**{f"{axis}scale": "log", f"{axis}margin": 0.05})
            _label_decades(getattr(axes, f"{axis}axis"))
        if limits is not None:
            axes.set(**{f"{axis}lim": limits})
    if figure.y_names:
        axes.set_yticks(range(len(figure.y_names)), figure.y_names)
    elif axes.get_ylim()[0] < 0.0 < axes.get_ylim()[1]:
        axes.axhline(0.0, color=_LIGHT["grey"], linewidth=0.6, zorder=0.5)


def _label_decades(axis: Axis) -> None:
    """Over few decades 1, 2, 5, 10 as plain numbers, and no crowd of labels between them."""
    low, high = axis.get_view_interval()
    decades = math.log10(high / low)
    axis.set_minor_formatter(NullFormatter())
    if decades <= 3.2:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades <= 2.2 else (1.0,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    else:
        axis.set_major_formatter(FuncFormatter(lambda value, _: raised(f"10^{round(math.log10(value))}")))


def _lines(words: str, width: int) -> str:
    return textwrap.fill(raised(words), width)


def _inline(text: str, label: str, place: str) -> str:
    """The element alone, as wide as its place, without what nothing refers to."""
    box = re.search(r'viewBox="[^"]*"', text)[0]  # type: ignore[index]
    body = text[text.index(">", text.index("<svg")) + 1 :].strip()
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", body, flags=re.DOTALL)
    body = re.sub(r'<g id="[^"]*"', "<g", re.sub(r">\s+<", "><", body))
    body = re.sub(r"<[^>]+>", lambda tag: _short(tag[0]), body)
    return (
        f'<svg class="drawing" role="img" aria-label="{label}" {box} data-axes="{place}" '
        f'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">{body}'
    )


def _short(tag: str) -> str:
    """A tag with its places to a hundredth of a point and its colours as variables."""
    tag = re.sub(r"(\.\d\d)\d+", r"\1", tag.replace("\n", ""))
    return re.sub(r"(?<=: )#[0-9a-f]{6}", lambda colour: _VARIABLES.get(colour[0], colour[0]), tag)
