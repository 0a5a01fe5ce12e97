# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The figures of a report: which residual is drawn against what, and why.

Residuals are drawn in time, and against the variable on which the effect that was found acts.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.report.text import PART_WORDS, is_augmented
from puma_sim_core.identify.result import GAP, HYSTERESIS, Drawn, Explanation, NamedEffect, StageErrors
from puma_sim_core.identify.settings import REPORT
from puma_sim_core.pages.figure import Figure, Layer
from puma_sim_core.pages.text import scale, unit_text

#: colour, width of the line and words of each stage
_STAGES = {
    "nominal": ("grey", 1.0, "nominal: the model as given"),
    "retuned": ("orange", 1.1, "retuned: its parameters fitted, nothing added"),
    "augmented": ("blue", 1.2, "augmented: with what was found added"),
    "floor": ("ink", 1.0, "noise floor"),
}
#: told apart by their form alone
_MARKS: dict[str, dict[str, Any]] = {
    "nominal": {"marker": "o", "hollow": True, "size": 7.0},
    "retuned": {"marker": "D", "hollow": True, "size": 7.0},
    "augmented": {"marker": "o", "size": 7.0},
    "floor": {"marker": "|", "size": 13.0},
}


def residual_in_time(e: Explanation) -> list[Figure]:
    """Residuals of all joints in time: nominal, retuned, augmented; the validation set shaded."""
    if e.drawn is None or not len(e.drawn.time):
        return []
    time, label = _time(e.drawn)
    figures = []
    for j in range(e.drawn.nominal.shape[1]):
        series, unit = _series(e, ("nominal", "retuned", "augmented"), j)
        layers = [_validation(e.drawn, time)]
        for name, values in series.items():
            colour, width, words = _STAGES[name]
            layers.append(Layer("line", *_with_gaps(time, values), label=words, colour=colour, width=width))
        figures.append(Figure(f"Residual of joint {j + 1} in time", label, f"residual [{unit}]", tuple(layers)))
    return figures


def residual_against(e: Explanation) -> list[Figure]:
    """Residuals against the variable of each effect found; where none has a name, against the axis of the shape."""
    drawn = e.drawn
    if drawn is None or not len(drawn.time):
        return []
    if e.effects:
        joints = range(drawn.nominal.shape[1])
        return [
            _of_effect(e, drawn, effect, j)
            for effect in e.effects
            for j in (joints if effect.joint is None else (effect.joint - 1,))
        ]
    if e.shape is None or e.shape.line_hz is not None or _signal(drawn, e.shape.axis, e.shape.joint - 1) is None:
        return []
    return [_scatter(e, drawn, e.shape.axis, e.shape.joint - 1, False)]


def shape_of_the_unnamed(e: Explanation) -> Figure | None:
    """The curve of what has no name over its axis, with its band."""
    shape = e.shape
    if shape is None or np.size(shape.centre) < 2:
        return None
    factor, unit = scale([*shape.curve], e.voltage_unit)
    centre, low, high, curve = (np.asarray(v, dtype=float) for v in (shape.centre, shape.low, shape.high, shape.curve))
    words = _axis_words(shape.axis)
    if shape.way in (HYSTERESIS, GAP):
        words = f"change of the {words} since it last reversed"
    elif shape.way:
        words = f"{words}, {shape.way}"
    if shape.line_hz is not None:
        words += " within one period"
    if unit_text(shape.axis_unit):
        words += f" [{unit_text(shape.axis_unit)}]"
    layers = (
        Layer("band", centre, low * factor, high * factor, label="95 % band", colour="orange", opacity=0.25),
        Layer("line", centre, curve * factor, label="mean", colour="orange", width=2.2),
    )
    return Figure(f"Joint {shape.joint}: shape of what has no name", words, f"residual [{unit}]", layers)


def whiteness(e: Explanation) -> list[Figure]:
    """Autocorrelation of what is left of each joint, with the bound that white noise keeps."""
    figures = []
    for joint, (lags, values, bound) in sorted(e.drawn.whiteness.items() if e.drawn is not None else ()):
        # at lag 0 it is 1 whatever is left
        lags, values = lags[lags > 0.0], values[lags > 0.0]
        if not lags.size:
            continue
        factor, unit = scale(lags, "s")
        inside = float(np.mean(np.abs(values) <= bound))
        limit = 1.1 * max(3.0 * bound, float(np.nanmax(np.abs(values), initial=0.0)))
        span, level = _padded(np.append(lags, 0.0) * factor), np.full(2, bound)
        white = Layer("band", np.array(span), -level, level, "95 % bound of white noise", "blue", opacity=0.14)
        stems = Layer("stems", lags * factor, values, label="autocorrelation", colour="blue", width=1.6)
        title, words = f"Joint {joint}: autocorrelation of what is left", "within the 95 % bound of white noise"
        note = f"{100.0 * inside:.0f} % of the lags are {words}, \N{PLUS-MINUS SIGN}{bound:.3f}."
        labels, limits = (f"lag [{unit}]", "autocorrelation [1]"), (-limit, limit)
        figures.append(Figure(title, *labels, (white, stems), x_range=span, y_range=limits, note=note))
    return figures


def errors_chart(e: Explanation, part: str, quantity: str) -> Figure | None:
    """Errors of the four stages, joint by joint, on a logarithmic axis; None without any."""
    if part not in e.errors:
        return None
    stages: StageErrors = getattr(e.errors[part], quantity)
    base = e.voltage_unit if quantity == "voltage_rms" else e.position_unit
    values = {name: np.atleast_1d(np.asarray(getattr(stages, name), dtype=float)) for name in _STAGES}
    if not any(np.any(each > 0.0) for each in values.values()):
        return None
    factor, unit = scale(np.concatenate(list(values.values())), base)
    count = values["nominal"].size
    what = {"voltage_rms": "Residual of the voltage", "position_rms": "Open-loop position error"}[quantity]
    layers = []
    for name, each in values.items():
        colour, _, words = _STAGES[name]
        rows = np.arange(each.size, dtype=float)
        layers.append(Layer("marks", each * factor, rows, label=words, colour=colour, **_MARKS[name]))
    return Figure(
        f"{what}, {PART_WORDS[part]}",
        f"root mean square [{unit}]",
        "joint",
        tuple(layers),
        y_range=(count - 0.5, -0.5),
        log_x=True,
        height=0.85 + 0.43 * count,
        y_names=tuple(str(j + 1) for j in range(count)),
    )


def _series(e: Explanation, stages: tuple[str, ...], j: int) -> tuple[dict[str, np.ndarray], str]:
    """(residuals of joint j of these stages, their unit); without the augmented model where there is none."""
    series = {name: getattr(e.drawn, name)[:, j] for name in stages if name != "augmented" or is_augmented(e)}
    factor, unit = scale(np.concatenate(list(series.values())), e.voltage_unit)
    return {name: values * factor for name, values in series.items()}, unit


def _of_effect(e: Explanation, drawn: Drawn, effect: NamedEffect, j: int) -> Figure:
    kind = KINDS[effect.name]
    axis = next((name for name in kind.drawn_against if _signal(drawn, name, j) is not None), "time")
    figure = _scatter(e, drawn, axis, j, kind.directed and "velocity" in drawn.signals)
    if not {"time", "width"} <= set(effect.parameters):
        return figure
    middle, width = (effect.parameters[name].value for name in ("time", "width"))
    begin, end = figure.x_range or (-math.inf, math.inf)
    near = (max(begin, middle - 6.0 * width), min(end, middle + 6.0 * width))
    return replace(figure, x_range=near) if near[0] < near[1] else figure


def _scatter(e: Explanation, drawn: Drawn, axis: str, j: int, directed: bool) -> Figure:
    """Retuned and augmented residuals over a signal, with their means in bins."""
    series, unit = _series(e, ("retuned", "augmented"), j)
    words = "residual"
    if directed:
        velocity = drawn.signals["velocity"][:, j]
        moves = np.abs(velocity) > 0.05 * np.sqrt(np.nanmean(velocity**2))
        sign = np.where(moves, np.sign(velocity), np.nan)
        series = {name: values * sign for name, values in series.items()}
        words = "residual \N{MULTIPLICATION SIGN} direction"
    time, time_label = _time(drawn)
    x = _signal(drawn, axis, j)
    layers = []
    if axis == "time" or x is None:
        x, label = time, time_label
        layers.append(_validation(drawn, time))
    else:
        factor, x_unit = scale(x, _axis_unit(e, axis))
        x, label = x * factor, f"{_axis_words(axis)} [{unit_text(x_unit)}]"
    means = []
    for name, values in series.items():
        colour = _STAGES[name][0]
        centre, mean = _means(x, values)
        layers.append(Layer("dots", x, values, label=f"{name}, rows", colour=colour, opacity=0.32))
        means.append(Layer("line", centre, mean, colour="paper", width=4.6))
        means.append(Layer("line", centre, mean, label=f"{name}, mean", colour=colour, width=2.6))
    title = f"Joint {j + 1}: residual against {_axis_words(axis)}"
    return Figure(title, label, f"{words} [{unit}]", (*layers, *means), x_range=_padded(x))


def _means(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means in bins of equal width; an edge is at zero, so that a step there stays sharp."""
    keep = np.isfinite(x) & np.isfinite(y)
    x, y = x[keep], y[keep]
    low, high = np.quantile(x, (0.002, 0.998)) if x.size else (0.0, 0.0)
    if high <= low:
        return np.zeros(0), np.zeros(0)
    width = (high - low) / REPORT.bins
    first, last = (math.floor(low / width), math.ceil(high / width)) if low < 0.0 < high else (0, REPORT.bins)
    edges = (0.0 if low < 0.0 < high else low) + width * np.arange(first, last + 1)
    place = np.digitize(x, edges) - 1
    centre, mean = (np.full(edges.size - 1, np.nan) for _ in range(2))
    for index in range(edges.size - 1):
        rows = place == index
        if np.count_nonzero(rows) >= REPORT.bin_rows:
            centre[index], mean[index] = np.mean(x[rows]), np.mean(y[rows])
    if low < 0.0 < high:
        # no line through the step
        centre, mean = (np.insert(each, -first, np.nan) for each in (centre, mean))
    return centre, mean


def _time(drawn: Drawn) -> tuple[np.ndarray, str]:
    """Times that grow, and their label: logs that each begin at zero stand one after another."""
    time = np.asarray(drawn.time, dtype=float)
    jumps = np.flatnonzero(np.diff(time) <= 0.0)
    if not jumps.size:
        return time, "time [s]"
    step = float(np.median(np.diff(time)[np.diff(time) > 0.0])) if np.any(np.diff(time) > 0.0) else 1.0
    shift = np.zeros_like(time)
    for at in jumps:
        # a hole wide enough to break the line
        shift[at + 1 :] += time[at] - time[at + 1] + 10.0 * step
    return time + shift, "time, one log after another [s]"


def _with_gaps(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The line with a NaN in each hole of the record, over which it must not be drawn."""
    steps = np.diff(time)
    holes = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1 if steps.size else np.zeros(0, dtype=int)
    return np.insert(time, holes, np.nan), np.insert(values, holes, np.nan)


def _validation(drawn: Drawn, time: np.ndarray) -> Layer:
    """Spans of the rows that were not fitted."""
    flag = np.concatenate([[0], (np.asarray(drawn.held_out) > 0.5).astype(int), [0]])
    begin, end = np.flatnonzero(np.diff(flag) == 1), np.flatnonzero(np.diff(flag) == -1) - 1
    label = "validation set" if begin.size else ""
    return Layer("spans", time[begin], time[end], label=label, colour="span")


def _padded(x: np.ndarray) -> tuple[float, float]:
    low, high = float(np.nanmin(x)), float(np.nanmax(x))
    wide = high - low or 1.0
    return low - 0.02 * wide, high + 0.02 * wide


def _axis_words(axis: str) -> str:
    return axis.replace("_", " ")


def _axis_unit(e: Explanation, axis: str) -> str:
    base, axis = e.position_unit, axis.partition(" of joint ")[0]
    torque = "N.m" if base == "rad" else "N"
    return {
        "time": "s",
        "position": base,
        "velocity": f"{base}/s",
        "acceleration": f"{base}/s2",
        "voltage": e.voltage_unit,
        "voltage_rate": f"{e.voltage_unit}/s",
        "current": "A",
        "supply_current": "A",
        "motor_angle": "rad",
    }.get(axis, torque)


def _signal(drawn: Drawn, axis: str, j: int) -> np.ndarray | None:
    """The signal (m,) of joint j (0-based), or of the joint that "velocity of joint 2" names."""
    name, of, joint = axis.partition(" of joint ")
    if name == "time":
        return np.asarray(drawn.time)
    j = int(joint) - 1 if of else j
    values = drawn.signals.get(name)
    return None if values is None or j >= values.shape[1] else values[:, j]
