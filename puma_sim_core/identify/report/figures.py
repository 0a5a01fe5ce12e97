# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The figures of a report: which residual is drawn against what, and why.

Residuals are drawn in time for each joint, and against the variable on which the effect that was
found acts: a step at zero velocity says dry friction to a reader as no number does.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.identify.report.drawing import Chart, Layer
from puma_sim_core.identify.report.text import is_augmented, plain_unit, scale
from puma_sim_core.identify.result import Drawn, Explanation, NamedEffect, StageErrors

#: told apart by any colour vision, and on paper by their lightness
COLOURS = {"nominal": "#979ea5", "retuned": "#c8500a", "augmented": "#0060a8", "floor": "#1c1f23"}
MARKS = {"nominal": "ring", "retuned": "diamond", "augmented": "circle", "floor": "bar"}
HELD_OUT = "#e9eff6"
_BINS = 30
#: rows that a mean needs to be drawn
_ROWS = 6


def residual_in_time(explanation: Explanation) -> list[Chart]:
    """Residuals of all joints in time: nominal, retuned, augmented; held-out rows shaded."""
    drawn = explanation.drawn
    if drawn is None or not len(drawn.time):
        return []
    time, label = _time(drawn)
    charts = []
    for j in range(drawn.nominal.shape[1]):
        layers, unit = _residuals(explanation, time, j)
        charts.append(
            Chart(f"Residual of joint {j + 1} in time", label, f"residual [{unit}]", (_held_out(drawn, time), *layers))
        )
    return charts


def residual_against(explanation: Explanation) -> list[Chart]:
    """Residuals before and after against the variable that matters, for each effect found; where
    none has a name, against the axis of the shape."""
    drawn = explanation.drawn
    if drawn is None or not len(drawn.time):
        return []
    joints = range(drawn.nominal.shape[1])
    charts = []
    for effect in explanation.effects:
        for j in joints if effect.joint is None else (effect.joint - 1,):
            charts.append(_against(explanation, effect, j))
    if not explanation.effects and explanation.shape is not None:
        axis, j = explanation.shape.axis, explanation.shape.joint - 1
        if explanation.shape.line_hz is None and _signal(drawn, axis, j) is not None:
            charts.append(_scatter(explanation, axis, j, False, f"Joint {j + 1}: residual against {_axis_words(axis)}"))
    return charts


def shape_of_the_unnamed(explanation: Explanation) -> Chart | None:
    """The curve of what has no name over its axis, with its band."""
    shape = explanation.shape
    if shape is None or np.size(shape.centre) < 2:
        return None
    factor, unit = scale([*shape.curve], explanation.voltage_unit)
    low, high, curve = (np.asarray(v, dtype=float) * factor for v in (shape.low, shape.high, shape.curve))
    colour = COLOURS["retuned"]
    words = _axis_words(shape.axis)
    if shape.way == "with hysteresis":
        words = f"change of the {words} since it last reversed"
    elif shape.way:
        words = f"{words}, {shape.way}"
    if shape.line_hz is not None:
        words += " within one period"
    if shape.axis_unit not in ("", "1"):
        words += f" [{plain_unit(shape.axis_unit)}]"
    return Chart(
        f"Joint {shape.joint}: shape of what has no name",
        words,
        f"residual [{unit}]",
        (
            Layer("band", np.asarray(shape.centre), low, high, colour=colour, opacity=0.25),
            Layer("line", np.asarray(shape.centre), curve, colour=colour, width=2.2),
        ),
    )


def whiteness(explanation: Explanation) -> list[Chart]:
    """Autocorrelation of what is left of each joint, with the bound that white noise keeps."""
    drawn = explanation.drawn
    if drawn is None:
        return []
    charts = []
    for joint, (lags, values, bound) in sorted(drawn.whiteness.items()):
        lags, values = (np.asarray(v, dtype=float) for v in (lags, values))
        # at lag 0 it is 1 whatever is left
        lags, values = lags[lags > 0.0], values[lags > 0.0]
        if not lags.size:
            continue
        factor, unit = scale(lags, "s")
        inside = float(np.mean(np.abs(values) <= bound))
        limit = 1.1 * max(3.0 * bound, float(np.nanmax(np.abs(values), initial=0.0)))
        x_range = _padded(np.append(lags, 0.0) * factor)
        charts.append(
            Chart(
                f"Joint {joint}: autocorrelation of what is left",
                f"lag [{unit}]",
                "autocorrelation [1]",
                (
                    Layer(
                        "band", np.array(x_range), np.full(2, -bound), np.full(2, bound), colour="#0060a8", opacity=0.14
                    ),
                    Layer("stems", lags * factor, values, colour=COLOURS["augmented"], width=1.6),
                ),
                x_range=x_range,
                y_range=(-limit, limit),
                note=f"{100.0 * inside:.0f} % of the lags are within the 95 % bound of white noise, "
                f"\N{PLUS-MINUS SIGN}{bound:.3f}.",
            )
        )
    return charts


def errors_chart(explanation: Explanation, part: str, quantity: str) -> Chart | None:
    """Errors of the four stages, joint by joint, on a logarithmic axis; None without any."""
    if part not in explanation.errors:
        return None
    stages: StageErrors = getattr(explanation.errors[part], quantity)
    base = explanation.voltage_unit if quantity == "voltage_rms" else explanation.position_unit
    values = {name: np.atleast_1d(np.asarray(getattr(stages, name), dtype=float)) for name in COLOURS}
    factor, unit = scale(np.concatenate(list(values.values())), base)
    count = values["nominal"].size
    rows = np.arange(count, dtype=float)
    if not any(np.any(np.isfinite(each) & (each > 0.0)) for each in values.values()):
        return None
    words = {"voltage_rms": "Residual of the voltage", "position_rms": "Open-loop position error"}
    return Chart(
        f"{words[quantity]}, {part.replace('_', '-')} data",
        f"root mean square [{unit}]",
        "",
        tuple(
            Layer("marks", each * factor, rows, colour=COLOURS[name], mark=MARKS[name]) for name, each in values.items()
        ),
        y_range=(count - 0.5, -0.5),
        log_x=True,
        height=66.0 + 34.0 * count,
        y_names=tuple(f"joint {j + 1}" for j in range(count)),
    )


def _residuals(explanation: Explanation, time: np.ndarray, j: int) -> tuple[list[Layer], str]:
    drawn = explanation.drawn
    series = {name: getattr(drawn, name)[:, j] for name in ("nominal", "retuned", "augmented")}
    if not is_augmented(explanation):
        del series["augmented"]
    factor, unit = scale(np.concatenate(list(series.values())), explanation.voltage_unit)
    widths = {"nominal": 1.0, "retuned": 1.1, "augmented": 1.2}
    return [
        Layer("line", *_with_gaps(time, values * factor), colour=COLOURS[name], width=widths[name])
        for name, values in series.items()
    ], unit


def _against(explanation: Explanation, effect: NamedEffect, j: int) -> Chart:
    axis = next(
        (name for name in KINDS[effect.name].drawn_against if _signal(explanation.drawn, name, j) is not None), "time"
    )
    directed = KINDS[effect.name].directed and "velocity" in explanation.drawn.signals
    title = f"Joint {j + 1}: residual against {_axis_words(axis)}"
    chart = _scatter(explanation, axis, j, directed, title)
    if {"time", "width"} <= set(effect.parameters):
        middle, width = (effect.parameters[name].value for name in ("time", "width"))
        begin, end = chart.x_range or (-math.inf, math.inf)
        near = (max(begin, middle - 6.0 * width), min(end, middle + 6.0 * width))
        if near[0] < near[1]:
            return replace(chart, x_range=near)
    return chart


def _scatter(explanation: Explanation, axis: str, j: int, directed: bool, title: str) -> Chart:
    """Retuned and augmented residuals over a signal, with their means in bins."""
    drawn = explanation.drawn
    in_time = axis == "time"
    time, time_label = _time(drawn)
    x = time if in_time else _signal(drawn, axis, j)
    stages = ("retuned", "augmented") if is_augmented(explanation) else ("retuned",)
    series = {name: getattr(drawn, name)[:, j] for name in stages}
    words = "residual"
    if directed:
        velocity = drawn.signals["velocity"][:, j]
        moves = np.abs(velocity) > 0.05 * np.sqrt(np.nanmean(velocity**2))
        sign = np.where(moves, np.sign(velocity), np.nan)
        series = {name: values * sign for name, values in series.items()}
        words = "residual \N{MULTIPLICATION SIGN} direction"
    factor, unit = scale(np.concatenate(list(series.values())), explanation.voltage_unit)
    x_factor, x_unit = scale(x, _axis_unit(explanation, axis))
    x = x * x_factor
    layers = [_held_out(drawn, time)] if in_time else []
    for name, values in series.items():
        layers.append(Layer("points", x, values * factor, colour=COLOURS[name], width=2.2, opacity=0.32))
    for name, values in series.items():
        centre, mean = _means(x, values * factor)
        layers.append(Layer("line", centre, mean, colour="#ffffff", width=4.6))
        layers.append(Layer("line", centre, mean, colour=COLOURS[name], width=2.6))
    label = time_label if in_time else f"{_axis_words(axis)} [{plain_unit(x_unit)}]"
    return Chart(title, label, f"{words} [{unit}]", tuple(layers), x_range=_padded(x))


def _means(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means in bins of equal width; an edge is at zero, so that a step there stays sharp."""
    keep = np.isfinite(x) & np.isfinite(y)
    x, y = x[keep], y[keep]
    if not x.size:
        return np.zeros(0), np.zeros(0)
    low, high = np.quantile(x, (0.002, 0.998))
    if high <= low:
        return np.zeros(0), np.zeros(0)
    width = (high - low) / _BINS
    first, last = (math.floor(low / width), math.ceil(high / width)) if low < 0.0 < high else (0, _BINS)
    edges = (0.0 if low < 0.0 < high else low) + width * np.arange(first, last + 1)
    place = np.digitize(x, edges) - 1
    centre, mean = (np.full(edges.size - 1, np.nan) for _ in range(2))
    for index in range(edges.size - 1):
        rows = place == index
        if np.count_nonzero(rows) >= _ROWS:
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
    holes = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1 if steps.size else []
    return np.insert(time, holes, np.nan), np.insert(values, holes, np.nan)


def _held_out(drawn: Drawn, time: np.ndarray) -> Layer:
    """Spans of the rows that were not fitted."""
    flag = np.concatenate([[0], (np.asarray(drawn.held_out) > 0.5).astype(int), [0]])
    begin, end = np.flatnonzero(np.diff(flag) == 1), np.flatnonzero(np.diff(flag) == -1) - 1
    return Layer("spans", time[begin], time[end], colour=HELD_OUT)


def _padded(x: np.ndarray) -> tuple[float, float]:
    low, high = float(np.nanmin(x)), float(np.nanmax(x))
    wide = high - low or 1.0
    return low - 0.02 * wide, high + 0.02 * wide


def _axis_words(axis: str) -> str:
    return axis.replace("_", " ")


def _axis_unit(explanation: Explanation, axis: str) -> str:
    base, axis = explanation.position_unit, axis.partition(" of joint ")[0]
    torque = "N.m" if base == "rad" else "N"
    return {
        "time": "s",
        "position": base,
        "velocity": f"{base}/s",
        "acceleration": f"{base}/s2",
        "voltage": explanation.voltage_unit,
        "voltage_rate": f"{explanation.voltage_unit}/s",
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
