# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Figures as SVG texts for the page, drawn by matplotlib (extra ``plot``).

The same figure gives the same text: no date, no random identifiers. Each drawing is small enough
that its letters stay readable when the page makes it as narrow as a phone.
"""

from __future__ import annotations

import io
import itertools
import re
import textwrap

import numpy as np

from puma_sim_core.errors import ParameterError
from puma_sim_core.thesis.result import Curve, Figure, Heatmap

#: points of a curve that a drawing (or the JSON) keeps, about one for each pixel
POINTS = 480
#: colours that people with any colour vision tell apart, dark enough for white paper
COLOURS = ("#0060a8", "#c8500a", "#00785a", "#a8487f", "#3a3a3a", "#b88a00", "#3c9dd8")
_SIZE = (4.6, 2.95)
_STYLE = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.labelcolor": "#222222",
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "axes.formatter.limits": (-4, 5),
    "axes.formatter.useoffset": False,
    "axes.unicode_minus": True,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "lines.linewidth": 1.3,
    "lines.markersize": 4.0,
    "mathtext.default": "regular",
}
#: a second round of the colours is told from the first by its dashes
_DASHES = ("-", (0, (1, 1)), (0, (4, 1, 1, 1)))
_RAISED = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")


def require_matplotlib() -> None:
    """Raises ParameterError, which says how to get it, where matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ParameterError(
            "matplotlib is not installed", where="the page", expected="the extra `plot`: pip install matplotlib"
        ) from None


def thin(curve: Curve, points: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) of at most about ``points`` points of a curve, with all that a reader would see.

    Of each run of neighbours the first, least and greatest stay, so that no peak is lost.
    """
    x, y = curve.x, curve.y
    if x.size <= points:
        return x, y
    edges = np.linspace(0, x.size, points // 3 + 1).astype(int)
    keep = {0, x.size - 1}
    for first, last in itertools.pairwise(edges):
        part = y[first:last]
        if np.all(np.isnan(part)):
            keep.add(int(first))
            continue
        keep.update((int(first), int(first + np.nanargmin(part)), int(first + np.nanargmax(part))))
    # a gap that fell between kept points would be drawn over
    keep.update(int(i) for i in np.flatnonzero(np.diff(np.isnan(y).astype(int)) == 1) + 1)
    index = np.array(sorted(keep))
    return x[index], y[index]


def styles(figure: Figure) -> list[dict]:
    """Colour, dashes and marker of each curve of a figure, as matplotlib's names.

    Where there are as many dashed curves (or clouds of points) as full ones, each has the colour
    of its partner.
    """
    full = [i for i, curve in enumerate(figure.curves) if curve.style in ("line", "steps")]
    colour = {i: i for i in range(len(figure.curves))}
    for kind in ("dashed", "points"):
        others = [i for i, curve in enumerate(figure.curves) if curve.style == kind]
        if len(others) == len(full) > 1:
            colour.update(zip(full, range(len(full))))
            colour.update(zip(others, range(len(others))))
    return [_style(curve, colour[i]) for i, curve in enumerate(figure.curves)]


def _style(curve: Curve, index: int) -> dict:
    turn = (index // len(COLOURS)) % len(_DASHES)
    style = {"color": COLOURS[index % len(COLOURS)], "linestyle": _DASHES[turn]}
    if curve.style == "dashed":
        style["linestyle"] = (0, (4, 2))
    elif curve.style == "points":
        style.update(linestyle="none", marker="osD^v"[index % 5])
        if curve.x.size > 60:
            # a measured curve; large marks would run into a band
            style.update(markersize=1.8, markeredgewidth=0.0)
    elif curve.style == "steps":
        style["drawstyle"] = "steps-post"
    if curve.x.size == 1:
        style["marker"] = "osD^v"[index % 5]
    return style


def svg(figure: Figure | Heatmap, prefix: str) -> str:
    """The drawing as an ``<svg>`` element; ``prefix`` keeps its identifiers apart on the page.

    Raises
    ------
    ParameterError : matplotlib is missing.
    """
    require_matplotlib()
    import matplotlib
    from matplotlib.figure import Figure as Canvas

    with matplotlib.rc_context(
        {**matplotlib.rcParamsDefault, **_STYLE, "svg.hashsalt": prefix, "backend": matplotlib.rcParams["backend"]}
    ):
        canvas = Canvas(figsize=_SIZE, layout="constrained")
        axes = canvas.add_subplot()
        if isinstance(figure, Heatmap):
            _draw_map(canvas, axes, figure)
        else:
            _draw_curves(axes, figure)
        axes.set_xlabel(_plain(figure.x_label, 56))
        axes.set_ylabel(_plain(figure.y_label, 34))
        file = io.StringIO()
        canvas.savefig(file, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return _inline(file.getvalue(), figure, prefix)


def _draw_curves(axes, figure: Figure) -> None:
    for curve, style in zip(figure.curves, styles(figure)):
        axes.plot(*thin(curve), **style)
    axes.margins(x=0.02)
    if figure.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if figure.log_x:
        axes.set_xscale("log")
        _label_decades(axes.xaxis, axes.get_xlim())
    if figure.log_y:
        axes.set_yscale("log")
        _label_decades(axes.yaxis, axes.get_ylim())


def _label_decades(axis, limits) -> None:
    """Over few decades 1, 2, 5, 10 as plain numbers, and no crowd of labels between them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"10{str(round(np.log10(value))).translate(_RAISED)}"))
    if limits[0] > 0 and np.log10(limits[1] / limits[0]) <= 3.2:
        narrow = np.log10(limits[1] / limits[0]) <= 2.2
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if narrow else (1.0,)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _draw_map(canvas, axes, figure: Heatmap) -> None:
    axes.grid(False)
    mesh = axes.pcolormesh(
        figure.x, figure.y, np.ma.masked_invalid(figure.values), shading="nearest", cmap="viridis", rasterized=True
    )
    canvas.colorbar(mesh, ax=axes, label=_plain(figure.value_label, 34))


def _plain(text: str, width: int) -> str:
    """Lines no longer than an axis; dollar signs are letters, not the start of a formula."""
    raised = re.sub(r"\^(-?[0-9]+)", lambda m: m[1].translate(_RAISED), text)
    return textwrap.fill(raised, width).replace("$", r"\$")


def _inline(text: str, figure: Figure | Heatmap, prefix: str) -> str:
    """The element alone, as wide as its place, with identifiers of its own."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{prefix}-', text)
    text = re.sub(r'(xlink:href="#|url\(#)', rf"\g<1>{prefix}-", text)
    box = re.search(r'viewBox="[^"]*"', text).group(0)
    label = _attribute(f"{figure.title}: {figure.y_label} against {figure.x_label}")
    head = (
        f'<svg class="drawing" role="img" aria-label="{label}" {box} '
        f'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'
    )
    return head + text[text.index(">") + 1 :].strip()


def legend_svg(style: dict) -> str:
    """A short piece of a curve's line, for the legend below the drawing."""
    colour, dashes = style["color"], style["linestyle"]
    parts = []
    if dashes != "none":
        pattern = ""
        if isinstance(dashes, tuple):
            pattern = f' stroke-dasharray="{" ".join(str(2 * each) for each in dashes[1])}"'
        parts.append(f'<path d="M0 5H26" stroke="{colour}" stroke-width="2.2"{pattern}/>')
    if "marker" in style:
        shape = {
            "o": '<circle cx="13" cy="5" r="3.5"',
            "s": '<path d="M10 2h6v6h-6z"',
            "D": '<path d="M13 1l4 4-4 4-4-4z"',
            "^": '<path d="M13 1l4 8h-8z"',
            "v": '<path d="M13 9l4-8h-8z"',
        }[style["marker"]]
        parts.append(f'{shape} fill="{colour}"/>')
    return (
        f'<svg class="key" viewBox="0 0 26 10" width="26" height="10" aria-hidden="true" '
        f'fill="none">{"".join(parts)}</svg>'
    )


def _attribute(text: str) -> str:
    return text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;").replace(">", "&gt;")
