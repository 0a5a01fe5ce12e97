# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The shape of what no effect of the library explains (step 10).

For each joint a bank of free curves: piecewise linear over one axis at a time, whole and with the
sign of the velocity, and single lines of the spectrum in time and in motor angle. Each is a
hypothesis like any other, with a Gaussian prior on the heights of its knots; the one with the
greatest gain of evidence is the axis, and its heights with their band are the curve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..effects.screening import VOLTAGE_COLUMN, Candidate, Signals
from .evidence import Scored
from .result import Shape

#: knots of a curve over a physical axis; of one over time [s between knots]
_KNOTS, _TIME_KNOT = 9, 0.5
_MOST_TIME_KNOTS = 60
#: prior of a knot's height, in volts of a middling friction torque
_HEIGHT = 0.5
#: lines per 1/(length of record), and the highest line in terms of the second cutoff
_LINES, _TOP_LINE = 2.0, 0.95
#: least frequency of a line, in periods over the record
_LEAST_PERIODS = 4.0
#: cycles of the motor a turn that are looked for
_ORDERS = np.round(np.arange(0.5, 12.01, 0.25), 2)


@dataclass(frozen=True)
class Axis:
    """What a curve is drawn over: name and unit; per full-rate row its coordinate (n,); signed:
    the curve is multiplied by the sign of the velocity."""

    name: str
    unit: str
    coordinate: np.ndarray
    knots: np.ndarray
    signed: bool = False


def axes(signals: Signals, joint: int, position_unit: str = "rad") -> list[Axis]:
    """The axes of one joint (0-based)."""
    u = position_unit
    effort = "N.m" if u == "rad" else "N"
    quantities = [("position", u, signals.position[:, joint]),
                  ("velocity", f"{u}/s", signals.velocity[:, joint]),
                  ("acceleration", f"{u}/s^2", signals.acceleration[:, joint]),
                  ("voltage", "V", signals.voltage[:, joint]),
                  ("torque", effort, signals.torque[:, joint])]
    for other in range(signals.joints):
        if other != joint:
            quantities.append((f"position of joint {other + 1}", u, signals.position[:, other]))
            quantities.append((f"velocity of joint {other + 1}", f"{u}/s",
                               signals.velocity[:, other]))
            quantities.append((f"torque of joint {other + 1}", effort, signals.torque[:, other]))
    found = []
    for name, unit, values in quantities:
        low, high = np.quantile(values, [0.002, 0.998])
        if not high - low > 1e-9:
            continue
        # half of the knots follow the rows, half are even: bare stretches get few
        even = np.linspace(low, high, _KNOTS)
        dense = np.quantile(values, np.linspace(0.002, 0.998, _KNOTS))
        found.append(Axis(name, unit, values, 0.5 * (even + dense)))
        if name in ("position", "torque"):
            found.append(Axis(name, unit, values, 0.5 * (even + dense), signed=True))
    time = signals.time
    for number in np.unique(signals.segment):
        t = time[signals.segment == number]
    count = int(np.clip((time.max() - time.min()) / _TIME_KNOT, 8, _MOST_TIME_KNOTS))
    found.append(Axis("time", "s", time, np.linspace(time.min(), time.max(), count)))
    few = np.linspace(time.min(), time.max(), 8)
    found.append(Axis("time", "s", time, few, signed=True))
    return found


def hats(values: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """(n, k) piecewise-linear basis, constant beyond the ends."""
    eye = np.eye(len(knots))
    return np.column_stack([np.interp(values, knots, column) for column in eye])


def scores(causal, shifts, position_unit: str = "rad") -> tuple[list, float]:
    """(`Scored`, its axis or None for a line) of all curves of all joints, best first, and the
    greatest gain that chance gives any of them."""
    signals, found = causal.signals, []

    def add(name, joint, pairs, axis):
        scored = causal.score_columns(name, joint, pairs)
        if scored is not None:
            found.append((scored, axis, pairs))

    for j in range(signals.joints):
        height = _HEIGHT * float(signals.volts_per_torque[j] * signals.torque_scale[j])
        direction = signals.velocity[:, j] / np.hypot(
            signals.velocity[:, j], 2.0 * signals.velocity_noise[j] + 1e-9)
        for axis in axes(signals, j, position_unit):
            columns = hats(axis.coordinate, axis.knots)
            if axis.signed:
                columns = columns * direction[:, None]
            p = columns.shape[1]
            candidate = Candidate(tuple({j: column} for column in columns.T), VOLTAGE_COLUMN,
                                  np.zeros(p), np.full(p, height), _free, {})
            add(axis.name, j + 1, [(candidate, causal.columns(candidate))], axis)
        add("line", j + 1, _time_lines(causal, j, height), None)
        if signals.gear[j] > 1.0:
            add("motor_angle", j + 1, _angle_lines(causal, j, height), None)
    found.sort(key=lambda row: -row[0].gain)
    chance = causal.chance([(scored, pairs) for scored, _, pairs in found], shifts) \
        if found else 0.0
    return [(scored, axis) for scored, axis, _ in found], chance


def _free(coefficients):
    """Any curve is allowed."""
    return {}


def _pair(height, grid) -> Candidate:
    return Candidate((), VOLTAGE_COLUMN, np.zeros(2), np.full(2, height), _free, grid)


def _time_lines(causal, j, height) -> list:
    time = causal.block_times(j)
    length = time.max() - time.min()
    top = causal.problem.sampled.cutoffs[1]
    frequencies = np.arange(_LEAST_PERIODS / length, _TOP_LINE * top, 1.0 / (_LINES * length))
    gains = causal.response(j, frequencies)
    pairs = []
    for f, gain in zip(frequencies, gains):
        phase = 2.0 * np.pi * f * time + np.angle(gain)
        columns = abs(gain) * np.column_stack([np.sin(phase), np.cos(phase)])
        pairs.append((_pair(height, {"frequency": float(f)}), {j: columns}))
    return pairs


def _angle_lines(causal, j, height) -> list:
    signals = causal.signals
    speed = np.abs(signals.velocity[:, j]) * signals.gear[j] / (2.0 * np.pi)
    pairs = []
    for order in _ORDERS:
        if (order * speed < causal.problem.sampled.cutoffs[1]).mean() < 0.1:
            continue
        phase = order * signals.gear[j] * signals.position[:, j]
        candidate = Candidate(({j: np.sin(phase)}, {j: np.cos(phase)}), VOLTAGE_COLUMN,
                              np.zeros(2), np.full(2, height), _free, {"order": float(order)})
        pairs.append((candidate, causal.columns(candidate)))
    return pairs


def describe(scored: Scored, axis: Axis | None, ranking) -> Shape:
    """The curve of the best hypothesis with its 95 % band."""
    spread = 1.96 * np.sqrt(np.diag(scored.covariance))
    heights = scored.coefficients
    if axis is not None:
        return Shape(axis.name, axis.unit, scored.joint, axis.knots, heights, heights - spread,
                     heights + spread, None, ranking)
    phase = np.linspace(0.0, 2.0 * np.pi, 33)
    curve = heights[0] * np.sin(phase) + heights[1] * np.cos(phase)
    band = np.sqrt((np.sin(phase) * spread[0]) ** 2 + (np.cos(phase) * spread[1]) ** 2)
    grid = scored.entry.candidate.grid
    if "frequency" in grid:
        return Shape("time", "s", scored.joint, phase / (2.0 * np.pi * grid["frequency"]), curve,
                     curve - band, curve + band, grid["frequency"], ranking)
    return Shape("motor_angle", "rad", scored.joint, phase / grid["order"], curve, curve - band,
                 curve + band, None, ranking)
