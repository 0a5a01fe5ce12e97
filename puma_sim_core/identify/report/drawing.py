# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Small charts as SVG texts: axes with ticks, and layers of lines, points, bands, stems, spans.

Nothing but this file draws them, so that a report needs no plotting library. They are narrow
enough that their letters stay readable on a phone. The same chart gives the same text.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from puma_sim_core.identify.report.text import MINUS

WIDTH, HEIGHT = 360.0, 226.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 50.0, 8.0, 8.0, 40.0
#: buckets along the axis of which a line keeps first, least, greatest and last
_BUCKETS = 220
_POINTS = 700
_INK, _SOFT, _GRID = "#1c1f23", "#4a5158", "#e3e6e9"

KINDS = ("line", "steps", "points", "band", "stems", "spans", "level", "marks")


@dataclass(frozen=True)
class Layer:
    """One layer of a chart.

    kind : "line" and "steps" (x, y), "points" (x, y), "band" (x, y low, y2 high), "stems" (x, y)
        from zero, "spans" (x begin, y end: shaded from the bottom to the top), "level" (y: lines
        across), "marks" (x, y: single large marks of the shape `mark`).
    """

    kind: str
    x: np.ndarray
    y: np.ndarray
    y2: np.ndarray | None = None
    colour: str = _INK
    width: float = 1.2
    opacity: float = 1.0
    dashes: str = ""
    mark: str = "circle"


@dataclass(frozen=True)
class Chart:
    """A chart: labels with units, layers from the bottom to the top.

    x_range, y_range : limits; taken from the layers where None. log_x : decades. y_names : names
    of the rows y = 0, 1, ... from the top, in place of numbers. hidden : the sentence that
    describes the chart to who cannot see it.
    """

    title: str
    x_label: str
    y_label: str
    layers: tuple[Layer, ...]
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    log_x: bool = False
    y_names: tuple[str, ...] = ()
    height: float = HEIGHT
    note: str = ""


def svg(chart: Chart, identifier: str) -> str:
    """The chart as an `<svg>` element; `identifier` is one that nothing else on the page has."""
    left = 62.0 if chart.y_names else _LEFT
    box = (left, _TOP, WIDTH - left - _RIGHT, chart.height - _TOP - _BOTTOM)
    x_range = chart.x_range or _range([layer.x for layer in chart.layers if layer.kind != "level"], 0.02, chart.log_x)
    y_range = chart.y_range or _range(
        [
            values
            for layer in chart.layers
            if layer.kind != "spans"
            for values in (layer.y, layer.y2)
            if values is not None
        ],
        0.06,
    )
    frame = _Frame(box, x_range, y_range, chart.log_x)
    label = escape(f"{chart.title}: {chart.y_label} against {chart.x_label}")
    parts = [
        f'<svg class="drawing" role="img" aria-label="{label}" '
        f'viewBox="0 0 {WIDTH:g} {chart.height:g}" xmlns="http://www.w3.org/2000/svg">',
        f'<clipPath id="{identifier}"><rect x="{box[0]:g}" y="{box[1]:g}" '
        f'width="{box[2]:g}" height="{box[3]:g}"/></clipPath>',
    ]
    spans = [layer for layer in chart.layers if layer.kind == "spans"]
    others = [layer for layer in chart.layers if layer.kind != "spans"]
    parts += [
        f'<g clip-path="url(#{identifier})">',
        *(_layer(each, frame) for each in spans),
        "</g>",
        _grid(frame, chart),
        f'<g clip-path="url(#{identifier})">',
        *(_layer(each, frame) for each in others),
        "</g>",
        _labels(frame, chart),
        "</svg>",
    ]
    return "".join(parts)


class _Frame:
    """From values to places on the drawing."""

    def __init__(self, box, x_range, y_range, log_x):
        self.left, self.top, self.width, self.height = box
        self.x_range, self.y_range, self.log_x = x_range, y_range, log_x

    def x(self, values):
        low, high = self.x_range
        values = np.asarray(values, dtype=float)
        if self.log_x:
            values = np.log10(np.where(values > 0.0, values, np.nan))
            low, high = math.log10(low), math.log10(high)
        return self.left + (values - low) / (high - low) * self.width

    def y(self, values):
        low, high = self.y_range
        share = (np.asarray(values, dtype=float) - low) / (high - low)
        return self.top + (1.0 - share) * self.height


def _range(arrays: Sequence, margin: float, log: bool = False) -> tuple[float, float]:
    """Limits that hold all finite values with a margin."""
    values = np.concatenate([np.asarray(each, dtype=float).ravel() for each in arrays] or [[0.0]])
    values = values[np.isfinite(values) & ((values > 0.0) if log else True)]
    if not values.size:
        return (0.1, 1.0) if log else (0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if log:
        grow = max((high / low) ** (2 * margin), 1.3)
        return low / grow, high * grow
    wide = high - low or abs(high) or 1.0
    return low - margin * wide, high + margin * wide


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers from low to high, at most so many: steps of 1, 2 or 5 times a power of 10."""
    step = 10.0 ** math.floor(math.log10((high - low) / most))
    for factor in (1.0, 2.0, 5.0, 10.0):
        if (high - low) / (step * factor) <= most:
            step *= factor
            break
    first = math.ceil(low / step - 1e-9)
    return [index * step for index in range(first, math.floor(high / step + 1e-9) + 1)]


def decades(low: float, high: float) -> list[float]:
    """Numbers of a logarithmic axis: 1, 2, 5 within few decades, else powers of 10."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    wide = math.log10(high / low)
    factors = (1.0, 2.0, 5.0) if wide <= 1.7 else (1.0, 3.0) if wide <= 2.5 else (1.0,)
    return [factor * 10.0**power for power in powers for factor in factors if low <= factor * 10.0**power <= high]


def _tick_labels(values: Sequence[float]) -> list[str]:
    """All with the same decimals, as few as tell them apart."""
    step = min((b - a for a, b in itertools.pairwise(values)), default=1.0)
    largest = max((abs(value) for value in values), default=0.0)
    if largest >= 1e5 or 0.0 < step < 1e-4:
        return [f"{value:.3g}".replace("-", MINUS) for value in values]
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return [f"{value + 0.0:.{decimals}f}".replace("-", MINUS) for value in values]


def _grid(frame: _Frame, chart: Chart) -> str:
    parts = []
    across = decades(*frame.x_range) if frame.log_x else ticks(*frame.x_range, 6)
    right, bottom = frame.left + frame.width, frame.top + frame.height
    names = [f"{value:g}" for value in across] if frame.log_x else _tick_labels(across)
    for value, name in zip(across, names):
        at = float(frame.x(value))
        parts.append(
            f'<path d="M{at:.1f} {frame.top:g}V{bottom + 3:g}" stroke="{_GRID}"/>'
            f'<text x="{at:.1f}" y="{bottom + 14:g}" text-anchor="middle">{name}</text>'
        )
    down = list(range(len(chart.y_names))) if chart.y_names else ticks(*frame.y_range, 6)
    names = [escape(name) for name in chart.y_names] if chart.y_names else _tick_labels(down)
    for value, name in zip(down, names):
        at = float(frame.y(value))
        shade = "#b9bfc5" if value == 0.0 and not chart.y_names else _GRID
        parts.append(
            f'<path d="M{frame.left - 3:g} {at:.1f}H{right:g}" stroke="{shade}"/>'
            f'<text x="{frame.left - 6:g}" y="{at + 3.6:.1f}" text-anchor="end">'
            f"{name}</text>"
        )
    return (
        f'<g fill="{_SOFT}" font-size="10.5" font-family="inherit" stroke-width="1">'
        + "".join(parts).replace("<text ", '<text stroke="none" ')
        + "</g>"
    )


def _labels(frame: _Frame, chart: Chart) -> str:
    bottom = frame.top + frame.height
    parts = [
        f'<path d="M{frame.left:g} {frame.top:g}V{bottom:g}H{frame.left + frame.width:g}" '
        f'fill="none" stroke="#6b7279"/>',
        f'<text x="{frame.left + frame.width / 2:g}" y="{bottom + 31:g}" '
        f'text-anchor="middle" font-size="11.5" fill="{_INK}">{escape(chart.x_label)}</text>',
    ]
    if chart.y_label:
        middle = frame.top + frame.height / 2
        parts.append(
            f'<text transform="translate(11 {middle:g}) rotate(-90)" '
            f'text-anchor="middle" font-size="11.5" fill="{_INK}">'
            f"{escape(chart.y_label)}</text>"
        )
    return "".join(parts)


def _layer(layer: Layer, frame: _Frame) -> str:
    style = f'stroke-opacity="{layer.opacity:g}" ' if layer.opacity != 1.0 else ""
    stroke = f'fill="none" stroke="{layer.colour}" {style}stroke-width="{layer.width:g}"' + (
        f' stroke-dasharray="{layer.dashes}"' if layer.dashes else ""
    )
    if layer.kind == "spans":
        return "".join(
            f'<rect x="{a:.1f}" y="{frame.top:g}" width="{max(b - a, 0.7):.1f}" '
            f'height="{frame.height:g}" fill="{layer.colour}"/>'
            for a, b in zip(frame.x(layer.x), frame.x(layer.y))
        )
    if layer.kind == "level":
        return "".join(
            f'<path d="M{frame.left:g} {at:.1f}h{frame.width:g}" {stroke}/>' for at in frame.y(np.atleast_1d(layer.y))
        )
    if layer.kind == "marks":
        return "".join(
            mark_svg(layer.mark, float(x), float(y), layer.colour)
            for x, y in zip(frame.x(layer.x), frame.y(layer.y))
            if math.isfinite(x) and math.isfinite(y)
        )
    if layer.kind == "band":
        keep = np.isfinite(layer.x) & np.isfinite(layer.y) & np.isfinite(layer.y2)
        x, low, high = (np.asarray(v, dtype=float)[keep] for v in (layer.x, layer.y, layer.y2))
        if x.size < 2:
            return ""
        path = _path(
            np.concatenate([frame.x(x), frame.x(x)[::-1]]), np.concatenate([frame.y(high), frame.y(low)[::-1]])
        )
        return f'<path d="{path}Z" fill="{layer.colour}" fill-opacity="{layer.opacity:g}"/>'
    x, y = np.asarray(layer.x, dtype=float), np.asarray(layer.y, dtype=float)
    if layer.kind == "stems":
        zero = float(frame.y(0.0))
        path = "".join(
            f"M{a:.1f} {zero:.1f}V{b:.1f}"
            for a, b in zip(frame.x(x), frame.y(y))
            if math.isfinite(a) and math.isfinite(b)
        )
        return f'<path d="{path}" {stroke}/>'
    if layer.kind == "points":
        keep = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
        # every so many-th, but no multiple of a period of the record
        keep = keep[np.unique(np.linspace(0, keep.size - 1, min(keep.size, _POINTS)).astype(int))]
        path = "".join(f"M{a:.1f} {b:.1f}h.01" for a, b in zip(frame.x(x[keep]), frame.y(y[keep])))
        return f'<path d="{path}" stroke-linecap="round" {stroke}/>'
    x, y = thin(x, y)
    if layer.kind == "steps":
        x, y = np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]
    return f'<path d="{_path(frame.x(x), frame.y(y))}" stroke-linejoin="round" {stroke}/>'


def _path(x: np.ndarray, y: np.ndarray) -> str:
    """A line through the points, broken where one is not finite."""
    parts, pen = [], "M"
    for a, b in zip(x, y):
        if not (math.isfinite(a) and math.isfinite(b)):
            pen = "M"
            continue
        parts.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    return "".join(parts)


def thin(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A line with all that can be seen of it: of each bucket of neighbours first, least, greatest
    and last, and the gaps (NaN)."""
    if x.size <= 4 * _BUCKETS:
        return x, y
    edges = np.linspace(0, x.size, _BUCKETS + 1).astype(int)
    keep = set(np.flatnonzero(np.diff(np.isnan(y).astype(int)) == 1) + 1)
    for first, last in itertools.pairwise(edges):
        part = y[first:last]
        keep.update((first, last - 1))
        if not np.all(np.isnan(part)):
            keep.update((first + np.nanargmin(part), first + np.nanargmax(part)))
    index = np.array(sorted(int(each) for each in keep))
    return x[index], y[index]


def mark_svg(mark: str, x: float, y: float, colour: str) -> str:
    """One mark: "circle" (full), "ring", "diamond", "bar", each told by its form alone."""
    if mark == "circle":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{colour}"/>'
    if mark == "ring":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.4" fill="#fff" stroke="{colour}" stroke-width="2"/>'
    if mark == "diamond":
        return (
            f'<path d="M{x:.1f} {y - 5.4:.1f}l5.4 5.4l-5.4 5.4l-5.4 -5.4z" fill="#fff" '
            f'stroke="{colour}" stroke-width="2"/>'
        )
    return f'<path d="M{x:.1f} {y - 9:.1f}v18" stroke="{colour}" stroke-width="2.4"/>'


def key_svg(kind: str, colour: str, dashes: str = "", mark: str = "circle", width: float = 2.2) -> str:
    """A short piece of a layer, for a legend."""
    inside = {
        "spans": f'<path d="M0 0h26v12h-26z" fill="{colour}"/>',
        "band": f'<path d="M0 1h26v10h-26z" fill="{colour}" fill-opacity=".3"/>',
        "points": f'<path d="M4 8h.01M12 4h.01M20 7h.01" stroke="{colour}" stroke-width="4" stroke-linecap="round"/>',
        "marks": mark_svg(mark, 13.0, 6.0, colour),
    }.get(kind)
    if inside is None:
        dash = f' stroke-dasharray="{dashes}"' if dashes else ""
        inside = f'<path d="M0 6H26" stroke="{colour}" stroke-width="{width:g}"{dash}/>'
    return (
        f'<svg class="key" viewBox="0 0 26 12" width="26" height="12" aria-hidden="true" '
        f'overflow="visible">{inside}</svg>'
    )
