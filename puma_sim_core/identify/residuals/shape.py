# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The shape of what no effect of the library explains (step 10).

For each joint a bank of free curves: piecewise linear over one axis at a time, whole and with the
sign of the velocity, hystereses, a step in time, and single lines of the spectrum in time and in
motor angle. Each
is a hypothesis like any other, with a Gaussian prior on the heights of its knots; the one with the
greatest gain of evidence is the axis, and its heights with their band are the curve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.effects.screening import VOLTAGE_COLUMN, Candidate, Signals
from puma_sim_core.identify.noise import colour
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.result import Shape
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.jit import compiled

#: knots of a curve over a physical axis; of one over time [s between knots]
_KNOTS, _TIME_KNOT = 9, 0.5
#: knots of a fine curve over the position
_FINE_KNOTS = 40
_MOST_TIME_KNOTS = 60
#: widths of the plays of a hysteresis, as shares of the range
_PLAYS = np.array([0.004, 0.01, 0.025, 0.06, 0.15])
#: ways of an axis to act
_SIGNED, _HYSTERESIS = "with the sign of the velocity", "with hysteresis"
_FINE = "in fine steps"
_STEP = "in one step"
_WITH_TORQUE = "in proportion to the torque"
#: past over which an acceleration is averaged [s]
_PAST = 0.025
#: prior of a knot's height, in volts of a middling friction torque
_HEIGHT = 0.5
#: least gain [nat] of a curve that may be taken out before the noise is measured, how many are
#: tried for each joint, and the price of a knot [nat]
_CLEAR, _RIVALS, _KNOT_PRICE = 10.0, 6, 1.0
#: share of the best gain from which on a simpler curve goes before it
_NEARLY = 0.97
#: places of a step in time: between the first ones at most so long [s] and at least so many, and
#: between those about the best of these
_STEP_APART, _STEPS, _STEPS_ABOUT = 0.25, 40, 20
#: lines per 1/(length of record), and the highest line in terms of the second cutoff
_LINES, _TOP_LINE = 2.0, 0.95
#: least frequency of a line, in periods over the record
_LEAST_PERIODS = 4.0
#: cycles of the motor a turn that are looked for
_ORDERS = np.round(np.arange(0.5, 12.01, 0.25), 2)


@dataclass(frozen=True)
class Axis:
    """What a curve is drawn over: name and unit, its coordinate (n,) at all rows, knots (k,), and
    the columns (n, k) of unit heights at them. way : how the axis acts, in words after its name;
    "" for a plain curve."""

    name: str
    unit: str
    coordinate: np.ndarray
    knots: np.ndarray
    columns: np.ndarray
    way: str = ""


def axes(signals: Signals, joint: int, position_unit: str = "rad") -> list[Axis]:
    """The axes of one joint (0-based)."""
    u = position_unit
    effort = "N.m" if u == "rad" else "N"
    velocity = signals.velocity[:, joint]
    direction = velocity / np.hypot(velocity, 2.0 * signals.velocity_noise[joint] + 1e-9)
    acceleration = _past_mean(signals, signals.acceleration[:, joint])
    quantities = [
        ("position", u, signals.position[:, joint]),
        ("velocity", f"{u}/s", velocity),
        ("acceleration", f"{u}/s^2", acceleration),
        ("voltage", "V", signals.voltage[:, joint]),
        ("torque", effort, signals.torque[:, joint]),
    ]
    for other in range(signals.joints):
        if other != joint:
            quantities.append((f"position of joint {other + 1}", u, signals.position[:, other]))
            quantities.append((f"velocity of joint {other + 1}", f"{u}/s", signals.velocity[:, other]))
            quantities.append((f"torque of joint {other + 1}", effort, signals.torque[:, other]))
    found = []
    for name, unit, values in quantities:
        low, high = np.quantile(values, [0.002, 0.998])
        if not high - low > 1e-9:
            continue
        # half of the knots follow the rows, half are even: bare stretches get few
        even = np.linspace(low, high, _KNOTS)
        dense = np.quantile(values, np.linspace(0.002, 0.998, _KNOTS))
        knots = 0.5 * (even + dense)
        columns = hats(values, knots)
        found.append(Axis(name, unit, values, knots, columns))
        if name in ("position", "torque"):
            found.append(Axis(name, unit, values, knots, columns * direction[:, None], _SIGNED))
        if name == "position":
            fine = np.linspace(low, high, _FINE_KNOTS)
            found.append(Axis(name, unit, values, fine, hats(values, fine), _FINE))
        if name in ("position", "voltage"):
            widths = (high - low) * _PLAYS
            found.append(Axis(name, unit, values, widths, _plays(values, signals.segment, widths), _HYSTERESIS))
    time = signals.time
    count = int(np.clip((time.max() - time.min()) / _TIME_KNOT, 8, _MOST_TIME_KNOTS))
    knots = np.linspace(time.min(), time.max(), count)
    found.append(Axis("time", "s", time, knots, hats(time, knots)))
    few = np.linspace(time.min(), time.max(), 8)
    found.append(Axis("time", "s", time, few, hats(time, few) * direction[:, None], _SIGNED))
    return found


def _past_mean(signals: Signals, values) -> np.ndarray:
    """(n,) values averaged over a short past: at rest, steps between quanta look like blows."""
    rows = max(1, int(_PAST / signals.step))
    total = np.cumsum(np.r_[0.0, values])
    first = np.maximum(np.arange(len(values)) + 1 - rows, 0)
    return (total[1:] - total[first]) / (np.arange(len(values)) + 1 - first)


def _plays(values, segment, widths) -> np.ndarray:
    """(n, k) what a play of each width [unit of values] holds back of a quantity: a bank of
    Prandtl and Ishlinskii, which has the shape of any hysteresis without a rate."""
    return np.column_stack([play(np.ascontiguousarray(values), segment, 0.5 * float(w)) for w in widths])


@compiled
def play(values, segment, half):
    """values less the output of a play of half width `half`, at rest in its middle at the start of
    each segment. Arrays (n,), returns (n,)."""
    out = np.empty_like(values)
    y = values[0]
    for i in range(values.size):
        if i > 0 and segment[i] != segment[i - 1]:
            y = values[i]
        y = min(max(y, values[i] - half), values[i] + half)
        out[i] = values[i] - y
    return out


def hats(values: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """(n, k) piecewise-linear basis, constant beyond the ends."""
    eye = np.eye(len(knots))
    return np.column_stack([np.interp(values, knots, column) for column in eye])


@dataclass(frozen=True)
class Curve:
    """A free curve over an axis, or a line (axis None), as scored, with its candidates' columns.
    way : how the axis acts, as `Axis.way`."""

    scored: Scored
    axis: Axis | None
    pairs: list | _Lines
    way: str = ""

    def volts(self, causal) -> np.ndarray:
        """(N, J) voltage [V] of the curve at the rows before the innovations."""
        candidate, heights = self.scored.entry.candidate, self.scored.coefficients
        if candidate.columns:
            return causal.volts(candidate, heights)
        out, j = np.zeros_like(causal.signals.voltage), self.scored.joint - 1
        phase = 2.0 * np.pi * candidate.grid["frequency"] * causal.signals.time
        out[:, j] = heights[0] * np.sin(phase) + heights[1] * np.cos(phase)
        return out * causal.signals.enable


def curves(causal, position_unit: str = "rad", joints=None) -> list[Curve]:
    """All curves of some joints (1-based; None: of all), best first."""
    signals, found = causal.signals, []

    def add(name, joint, pairs, axis, way=""):
        scored = causal.score_columns(name, joint, pairs)
        if scored is not None:
            found.append(Curve(scored, axis, pairs, way))

    for j in range(signals.joints):
        if joints is not None and j + 1 not in joints:
            continue
        height = _HEIGHT * float(signals.volts_per_torque[j] * signals.torque_scale[j])
        for axis in axes(signals, j, position_unit):
            columns = axis.columns if not axis.way == _HYSTERESIS else (axis.columns * (height / axis.knots[-1]))
            p = columns.shape[1]
            candidate = Candidate(
                tuple({j: column} for column in columns.T),
                VOLTAGE_COLUMN,
                np.zeros(p),
                np.full(p, height),
                _free,
                {"height": height},
            )
            add(axis.name, j + 1, [(candidate, causal.columns(candidate))], axis, axis.way)
        add("line", j + 1, _time_lines(causal, j, height), None)
        add("time", j + 1, *_step(causal, j, height), _STEP)
        if signals.gear[j] > 1.0:
            torque = _past_mean(signals, signals.torque[:, j])
            size = float(np.sqrt(np.mean(torque**2))) or 1.0
            add("motor_angle", j + 1, _angle_lines(causal, j, height, 1.0), None)
            # of currents that do not commutate evenly
            add("motor_angle", j + 1, _angle_lines(causal, j, height, torque / size), None, _WITH_TORQUE)
    return sorted(found, key=lambda curve: -curve.scored.gain)


def again(causal, curve: Curve) -> Curve:
    """A curve as scored in another screen."""
    candidate, joint = curve.scored.entry.candidate, curve.scored.joint
    if candidate.columns:
        pairs = [(candidate, causal.columns(candidate))]
    else:
        line = candidate.grid["frequency"]
        pairs = [
            pair
            for pair in _time_lines(causal, joint - 1, float(candidate.deviation[0]))
            if pair[0].grid["frequency"] == line
        ]
    return replace(curve, scored=causal.score_columns(curve.scored.name, joint, pairs), pairs=pairs)


def best_of_joints(found: list[Curve], share: float) -> list[Curve]:
    """The best curve of each joint that gains such a share of the best gain at least."""
    best: dict[int, Curve] = {}
    for curve in found:
        best.setdefault(curve.scored.joint, curve)
    return [c for c in best.values() if c.scored.gain >= share * found[0].scored.gain]


def simplest_first(found: list[Curve]) -> list[Curve]:
    """The curves with the simplest first of those of the best one's joint that gain nearly as much:
    one with many knots, as over time, has the shape of anything."""
    if not found:
        return found
    near = [
        c for c in found if c.scored.joint == found[0].scored.joint and c.scored.gain > _NEARLY * found[0].scored.gain
    ]
    first = min(near or found[:1], key=lambda c: len(c.scored.coefficients))
    return [first, *(c for c in found if c is not first)]


def chance(causal, found: list[Curve], shifts) -> float:
    """Greatest gain that chance gives any of the curves, once the best one is taken out."""
    return causal.chance([(curve.scored, curve.pairs) for curve in found], shifts) if found else 0.0


def noise(causal, found: list[Curve]):
    """The weighting by what is left of each joint after the curve that explains it best.

    Each of the first curves of a joint, and none at all, is set beside the others with the noise
    that it leaves, by the likelihood of the two together: what a curve explains is then no noise,
    and noise that a curve follows by chance does not make the rest look clear.
    """
    predictor, before = causal.predictor, causal.fit.weighting
    alone, taps = causal.left(), []
    for j in range(causal.J):
        best = colour.noise(predictor, alone[:, j], j, before)
        most = best.log_likelihood
        own = [c for c in found if c.axis is not None and c.scored.joint == j + 1 and c.scored.gain > _CLEAR]
        for curve in own[:_RIVALS]:
            left = causal.left(curve.scored.entry.candidate, curve.scored.coefficients)
            noise_left = colour.noise(predictor, left[:, j], j, before)
            worth = noise_left.log_likelihood - _KNOT_PRICE * len(curve.axis.knots)
            if worth > most:
                best, most = noise_left, worth
        taps.append(best.taps)
    return Weighting(np.array(taps), np.ones(len(taps)), predictor.lengths)


def _free(coefficients):
    """Any curve is allowed."""
    return {}


def _pair(height, grid) -> Candidate:
    return Candidate((), VOLTAGE_COLUMN, np.zeros(2), np.full(2, height), _free, grid)


def _step(causal, j, height) -> tuple[list, Axis]:
    """(candidate, its columns) of one step in time at each of several places, and their axis."""
    time = causal.signals.time
    first, last = float(time.min()), float(time.max())

    def at(places):
        found = []
        for place in places:
            column = (time > place).astype(float)
            candidate = Candidate(
                ({j: column},),
                VOLTAGE_COLUMN,
                np.zeros(1),
                np.array([height]),
                _free,
                {"height": height, "time": float(place)},
            )
            found.append((candidate, causal.columns(candidate)))
        return found

    apart = min(_STEP_APART, (last - first) / _STEPS)
    coarse = at(np.arange(first + apart, last - 0.5 * apart, apart))
    best = causal.score_columns("time", j + 1, coarse).entry.candidate.grid["time"]
    pairs = coarse + at(np.linspace(best - apart, best + apart, _STEPS_ABOUT + 1)[1:-1])
    best = causal.score_columns("time", j + 1, pairs).entry.candidate
    knots = np.array([first, best.grid["time"], best.grid["time"], last])
    return pairs, Axis("time", "s", time, knots, best.columns[0][j][:, None], _STEP)


def _time_lines(causal, j, height) -> _Lines:
    time = causal.block_times(j)
    length = time.max() - time.min()
    top = causal.problem.sampled.cutoffs[1]
    frequencies = np.arange(_LEAST_PERIODS / length, _TOP_LINE * top, 1.0 / (_LINES * length))
    return _Lines(
        j,
        time,
        causal.response(j, frequencies),
        frequencies,
        [_pair(height, {"frequency": float(f)}) for f in frequencies],
    )


@dataclass(frozen=True)
class _Lines:
    """(candidate, its columns) of each line in time. Their number grows with the length of the log,
    as does a column: all at once they would take gigabytes."""

    joint: int
    time: np.ndarray
    gains: np.ndarray
    frequencies: np.ndarray
    candidates: list

    def __len__(self) -> int:
        return len(self.candidates)

    def __iter__(self):
        for candidate, f, gain in zip(self.candidates, self.frequencies, self.gains):
            phase = 2.0 * np.pi * f * self.time + np.angle(gain)
            yield candidate, {self.joint: abs(gain) * np.column_stack([np.sin(phase), np.cos(phase)])}


def _angle_lines(causal, j, height, factor) -> list:
    """(candidate, its columns) of each line in motor angle, times a factor (n,) or 1.0."""
    signals = causal.signals
    speed = np.abs(signals.velocity[:, j]) * signals.gear[j] / (2.0 * np.pi)
    pairs = []
    for order in _ORDERS:
        if (order * speed < causal.problem.sampled.cutoffs[1]).mean() < 0.1:
            continue
        phase = order * signals.gear[j] * signals.position[:, j]
        columns = {j: factor * np.sin(phase)}, {j: factor * np.cos(phase)}
        candidate = Candidate(columns, VOLTAGE_COLUMN, np.zeros(2), np.full(2, height), _free, {"order": float(order)})
        pairs.append((candidate, causal.columns(candidate)))
    return pairs


def describe(best: Curve, ranking) -> Shape:
    """The best curve with its 95 % band."""
    scored, axis = best.scored, best.axis
    spread = 1.96 * np.sqrt(np.diag(scored.covariance))
    heights = scored.coefficients
    if axis is not None and axis.way == _HYSTERESIS:
        # the branch after a reversal: each play gives way until its width is used up
        change = np.concatenate([[0.0], axis.knots])
        columns = (
            scored.entry.candidate.grid["height"]
            / axis.knots[-1]
            * (np.minimum(change[:, None], axis.knots) - 0.5 * axis.knots)
        )
        curve = columns @ heights
        band = 1.96 * np.sqrt(np.einsum("ij,jk,ik->i", columns, scored.covariance, columns))
        return Shape(
            axis.name, axis.unit, scored.joint, change, curve, curve - band, curve + band, None, ranking, axis.way
        )
    if axis is not None:
        if axis.way == _STEP:
            heights, spread = (np.array([0.0, 0.0, x[0], x[0]]) for x in (heights, spread))
        return Shape(
            axis.name,
            axis.unit,
            scored.joint,
            axis.knots,
            heights,
            heights - spread,
            heights + spread,
            None,
            ranking,
            axis.way,
        )
    phase = np.linspace(0.0, 2.0 * np.pi, 33)
    curve = heights[0] * np.sin(phase) + heights[1] * np.cos(phase)
    band = np.sqrt((np.sin(phase) * spread[0]) ** 2 + (np.cos(phase) * spread[1]) ** 2)
    grid = scored.entry.candidate.grid
    if "frequency" in grid:
        return Shape(
            "time",
            "s",
            scored.joint,
            phase / (2.0 * np.pi * grid["frequency"]),
            curve,
            curve - band,
            curve + band,
            grid["frequency"],
            ranking,
        )
    return Shape(
        "motor_angle",
        "rad",
        scored.joint,
        phase / grid["order"],
        curve,
        curve - band,
        curve + band,
        None,
        ranking,
        best.way,
    )
