# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Free curves: the shape of what no effect of the library explains.

Each joint has a bank of curves: piecewise linear over one axis, plain or with the sign of the velocity, hystereses, a
step in time, spectral lines in time and in motor angle. Each is a hypothesis with a Gaussian prior on its heights.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np

from puma_sim_core.effects.screening import VOLTAGE_COLUMN, ByJoint, Candidate, Signals
from puma_sim_core.identify.arrays import Complexes, Floats, Ints
from puma_sim_core.identify.noise import innovations
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.result import GAP, HYSTERESIS, Shape
from puma_sim_core.identify.screening.causal import CausalScreen, Columns, Pairs
from puma_sim_core.identify.screening.evidence import Scored
from puma_sim_core.identify.screening.surrogates import level
from puma_sim_core.identify.settings import RESIDUALS
from puma_sim_core.jit import compiled

#: directions in which an axis acts
_SIGNED = "with the sign of the velocity"
_FINE = "in fine steps"
_STEP = "in one step"
_WITH_TORQUE = "in proportion to the torque"
#: cycles of the motor a turn that are looked for
_ORDERS = np.round(np.arange(RESIDUALS.orders[0], RESIDUALS.orders[1] + 0.01, RESIDUALS.orders[2]), 2)


@dataclass(frozen=True)
class Axis:
    """What a curve is drawn over.

    coordinate (n,) : at all rows; knots (k,); make : makes the columns (n, k) of unit heights at the knots; way : how
    the axis acts, in words after its name, "" for a plain curve.
    """

    name: str
    unit: str
    coordinate: Floats
    knots: Floats
    make: Callable[[], Floats]
    way: str = ""


@dataclass(frozen=True)
class _Columns(Sequence[dict[int, Floats]]):
    """Columns (n, width) of a joint, made each time they are read: those of all curves of a long log would take
    gigabytes."""

    joint: int
    width: int
    make: Callable[[], Floats]

    def __len__(self) -> int:
        return self.width

    def __getitem__(self, k: Any) -> Any:
        return {self.joint: self.make()[:, k]}

    def __iter__(self) -> Iterator[dict[int, Floats]]:
        return ({self.joint: column} for column in self.make().T)


def axes(signals: Signals, joint: int, position_unit: str = "rad") -> list[Axis]:
    """The axes of one joint (0-based)."""
    u = position_unit
    effort = "N.m" if u == "rad" else "N"
    velocity = signals.velocity[:, joint]
    direction = velocity / np.hypot(velocity, RESIDUALS.sign_noise * signals.velocity_noise[joint] + 1e-9)
    acceleration = _past_mean(signals, signals.acceleration[:, joint])
    quantities = [
        ("position", u, signals.position[:, joint]),
        ("velocity", f"{u}/s", velocity),
        ("acceleration", f"{u}/s^2", acceleration),
        ("voltage", "V", signals.voltage[:, joint]),
        ("torque", effort, signals.torque[:, joint]),
    ]
    for other in (j for j in range(signals.joints) if j != joint):
        quantities += [
            (f"position of joint {other + 1}", u, signals.position[:, other]),
            (f"velocity of joint {other + 1}", f"{u}/s", signals.velocity[:, other]),
            (f"torque of joint {other + 1}", effort, signals.torque[:, other]),
        ]
    found = []
    for name, unit, values in quantities:
        low, high = np.quantile(values, RESIDUALS.quantiles)
        if not high - low > RESIDUALS.least_range:
            continue
        # half of the knots follow the rows, half are even: bare stretches get few
        even = np.linspace(low, high, RESIDUALS.knots)
        dense = np.quantile(values, np.linspace(*RESIDUALS.quantiles, RESIDUALS.knots))
        knots = 0.5 * (even + dense)
        found.append(Axis(name, unit, values, knots, partial(hats, values, knots)))
        if name in ("position", "torque"):
            found.append(Axis(name, unit, values, knots, partial(_signed, values, knots, direction), _SIGNED))
        if name == "position":
            fine = np.linspace(low, high, RESIDUALS.fine_knots)
            found.append(Axis(name, unit, values, fine, partial(hats, values, fine), _FINE))
        if name in ("position", "voltage"):
            widths = (high - low) * np.array(RESIDUALS.play_widths)
            # Prandtl and Ishlinskii: a bank of play operators has the shape of any rate-independent hysteresis
            found.append(Axis(name, unit, values, widths, partial(_plays, values, signals.segment, widths), HYSTERESIS))
    time = signals.time
    first, last = time.min(), time.max()
    count = np.clip((last - first) / RESIDUALS.time_knot, RESIDUALS.least_time_knots, RESIDUALS.most_time_knots)
    knots = np.linspace(first, last, int(count))
    found.append(Axis("time", "s", time, knots, partial(hats, time, knots)))
    few = np.linspace(first, last, RESIDUALS.signed_time_knots)
    found.append(Axis("time", "s", time, few, partial(_signed, time, few, direction), _SIGNED))
    return found


def _past_mean(signals: Signals, values: Floats) -> Floats:
    """(n,) values averaged over a short past: at rest, steps between quanta look like impacts."""
    rows = max(1, int(RESIDUALS.past / signals.step))
    total = np.cumsum(np.r_[0.0, values])
    first = np.maximum(np.arange(len(values)) + 1 - rows, 0)
    return (total[1:] - total[first]) / (np.arange(len(values)) + 1 - first)


@compiled
def play(values: Floats, segment: Ints, half: float) -> Floats:
    """(n,) values less the output of a play operator of half width `half`, centred where a segment starts."""
    out = np.empty_like(values)
    y = values[0]
    for i in range(values.size):
        if i > 0 and segment[i] != segment[i - 1]:
            y = values[i]
        y = min(max(y, values[i] - half), values[i] + half)
        out[i] = values[i] - y
    return out


def hats(values: Floats, knots: Floats) -> Floats:
    """(n, k) piecewise-linear basis, constant beyond the ends."""
    return np.column_stack([np.interp(values, knots, column) for column in np.eye(len(knots))])


def _signed(values: Floats, knots: Floats, direction: Floats) -> Floats:
    """(n, k) `hats` with the sign of the velocity."""
    return hats(values, knots) * direction[:, None]


def _plays(values: Floats, segment: Ints, widths: Floats) -> Floats:
    """(n, k) `play` of several widths, each -1 or 1 once its width is used up."""
    return np.hstack([_play_of_width(values, segment, width) for width in widths.tolist()])


def _play_of_width(values: Floats, segment: Ints, width: float) -> Floats:
    """(n, 1) `play` of a width over half of it: -1 or 1 once the width is used up."""
    half = 0.5 * width
    return play(np.ascontiguousarray(values), segment, half)[:, None] / half


@dataclass(frozen=True)
class Curve:
    """A free curve over an axis, or a spectral line (axis None), as scored; way : as `Axis.way`."""

    scored: Scored
    axis: Axis | None
    pairs: Pairs
    way: str = ""

    @property
    def joint(self) -> int:
        """Its joint (1-based)."""
        assert self.scored.joint is not None
        return self.scored.joint

    @property
    def candidate(self) -> Candidate:
        """The candidate that fits best."""
        return self.scored.estimate.entry.candidate

    @property
    def heights(self) -> Floats:
        """(k,) heights at the knots [V], or of sine and cosine."""
        return self.scored.estimate.coefficients

    def volts(self, causal: CausalScreen) -> Floats:
        """(N, J) voltage [V] of the curve at the rows before the innovations."""
        if self.candidate.columns:
            return causal.volts(self.candidate, self.heights)
        out = np.zeros_like(causal.signals.voltage)
        phase = 2.0 * np.pi * self.candidate.grid["frequency"] * causal.signals.time
        out[:, self.joint - 1] = self.heights[0] * np.sin(phase) + self.heights[1] * np.cos(phase)
        return out * causal.signals.enable


def curves(causal: CausalScreen, position_unit: str = "rad", joints: Collection[int] | None = None) -> list[Curve]:
    """All curves of some joints (1-based; None: of all), best first."""
    signals = causal.signals
    found: list[Curve] = []

    def add(name: str, joint: int, pairs: Pairs, axis: Axis | None, way: str = "") -> None:
        scored = causal.score_columns(name, joint, pairs)
        if scored is not None:
            found.append(Curve(scored, axis, pairs, way))

    for j in (j for j in range(signals.joints) if joints is None or j + 1 in joints):
        height = RESIDUALS.height * float(signals.volts_per_torque[j] * signals.torque_scale[j])
        for axis in axes(signals, j, position_unit):
            candidate = _candidate(_Columns(j, len(axis.knots), axis.make), height, {"height": height})
            add(axis.name, j + 1, [(candidate, causal.columns(candidate))], axis, axis.way)
            if axis.way == HYSTERESIS:
                add(axis.name, j + 1, *_gap(causal, j, height, axis), GAP)
        add("line", j + 1, _time_lines(causal, j, height), None)
        add("time", j + 1, *_step(causal, j, height), _STEP)
        if signals.gear[j] > 1.0:
            torque = _past_mean(signals, signals.torque[:, j])
            size = float(np.sqrt(np.mean(torque**2))) or 1.0
            add("motor_angle", j + 1, _angle_lines(causal, j, height, 1.0), None)
            # of currents that do not commutate evenly
            add("motor_angle", j + 1, _angle_lines(causal, j, height, torque / size), None, _WITH_TORQUE)
    return sorted(found, key=lambda curve: -curve.scored.gain)


def again(causal: CausalScreen, curve: Curve) -> Curve:
    """A curve as scored in another screen."""
    candidate, joint = curve.candidate, curve.joint
    pairs: Pairs
    if candidate.columns:
        pairs = [(candidate, causal.columns(candidate))]
    else:
        lines = _time_lines(causal, joint - 1, float(candidate.deviation[0]))
        pairs = [pair for pair in lines if pair[0].grid["frequency"] == candidate.grid["frequency"]]
    scored = causal.score_columns(curve.scored.name, joint, pairs)
    assert scored is not None
    return replace(curve, scored=scored, pairs=pairs)


def best_of_joints(found: list[Curve], share: float) -> list[Curve]:
    """The best curve of each joint that gains such a share of the best gain at least."""
    best: dict[int, Curve] = {}
    for curve in found:
        best.setdefault(curve.joint, curve)
    return [c for c in best.values() if c.scored.gain >= share * found[0].scored.gain]


def simplest_first(found: list[Curve]) -> list[Curve]:
    """The curves, first the simplest on the best one's joint that gains nearly as much: many knots fit anything."""
    if not found:
        return found
    least = RESIDUALS.nearly * found[0].scored.gain
    near = [c for c in found if c.joint == found[0].joint and c.scored.gain > least]
    first = min(near or found[:1], key=lambda c: len(c.heights))
    return [first, *(c for c in found if c is not first)]


def chance(causal: CausalScreen, found: list[Curve], shifts: Floats) -> float:
    """The gain [nat] that chance gives the best of the curves (`surrogates.level`), once the best one is taken out."""
    if not found:
        return 0.0
    best = found[0]
    own = next(columns for candidate, columns in best.pairs if candidate is best.candidate)
    placebos = causal.placebos_without(best.scored.estimate, own, shifts)
    return level(np.max([placebos.gains(curve.pairs) for curve in found], axis=0))


def noise(causal: CausalScreen, found: list[Curve]) -> Weighting:
    """The weighting by what is left of each joint after the curve that explains it best.

    Each of a joint's first curves, and none at all, is judged by the likelihood with the noise that it leaves.
    """
    predictor, before = causal.predictor, causal.fit.weighting
    alone, taps = causal.left(), []
    for j in range(causal.J):
        best = innovations.noise(predictor, alone[:, j], j, before)
        most = best.log_likelihood
        own = [(c, c.axis) for c in found if c.axis is not None and c.joint == j + 1]
        clear = [(curve, axis) for curve, axis in own if curve.scored.gain > RESIDUALS.clear]
        for curve, axis in clear[: RESIDUALS.most_curves]:
            left = causal.left(curve.scored.estimate)
            noise_left = innovations.noise(predictor, left[:, j], j, before)
            worth = noise_left.log_likelihood - RESIDUALS.occam_knot * len(axis.knots)
            if worth > most:
                best, most = noise_left, worth
        taps.append(best.taps)
    return Weighting(np.array(taps), np.ones(len(taps)), predictor.lengths, predictor.settling)


def noise_after(causal: CausalScreen, curve: Curve) -> Weighting:
    """The weighting by what is left of each joint after a curve."""
    left = causal.left(curve.scored.estimate)
    return innovations.weighting(causal.predictor, left, causal.fit.weighting)


def _candidate(columns: Sequence[ByJoint], height: float, grid: dict[str, float], p: int = 0) -> Candidate:
    """A curve with a prior on its heights [V]. p : number of these, where there are no columns."""
    p = p or len(columns)
    # lazy columns are read as a tuple is
    return Candidate(
        cast(tuple[ByJoint, ...], columns), VOLTAGE_COLUMN, np.zeros(p), np.full(p, height), lambda heights: {}, grid
    )


def _step(causal: CausalScreen, j: int, height: float) -> tuple[Pairs, Axis]:
    """(candidate, its columns) of one step in time at each of several places, and the axis of the best."""
    time = causal.signals.time
    first, last = float(time.min()), float(time.max())
    apart = min(RESIDUALS.step_distance, (last - first) / RESIDUALS.least_steps)
    coarse = np.arange(first + apart, last - 0.5 * apart, apart)
    make = partial(_after, time)
    pairs, place = _placed(causal, "time", j, height, make, (coarse, partial(_about, distance=apart)))
    return pairs, Axis("time", "s", time, np.array([first, place, place, last]), partial(make, place), _STEP)


def _gap(causal: CausalScreen, j: int, height: float, bank: Axis) -> tuple[Pairs, Axis]:
    """(candidate, its columns) of one play operator of each of several widths over the quantity of a bank of them, and
    the axis of the best: the width of a single gap lies between those of the bank."""
    signals, values = causal.signals, bank.coordinate
    low, high = np.quantile(values, RESIDUALS.quantiles)
    widths = (high - low) * np.geomspace(*RESIDUALS.gap_widths)
    make = partial(_play_of_width, values, signals.segment)
    apart = float(widths[1] - widths[0]) / float(widths[0])
    pairs, width = _placed(causal, bank.name, j, height, make, (widths, lambda width: _about(width, apart * width)))
    return pairs, replace(bank, knots=np.array([width]), make=partial(make, width), way=GAP)


def _about(place: float, distance: float) -> Floats:
    """Places about a place, less than a distance away."""
    return np.linspace(place - distance, place + distance, RESIDUALS.places_about + 1)[1:-1]


def _placed(
    causal: CausalScreen,
    name: str,
    j: int,
    height: float,
    make: Callable[[float], Floats],
    places: tuple[Floats, Callable[[float], Floats]],
) -> tuple[Pairs, float]:
    """(candidate, its columns) of what has one column (n, 1), at several places and at those about the best; the best.

    make : the column at a place; places : the coarse ones, and those about one of them.
    """

    def at(some: Floats) -> list[tuple[Candidate, Columns]]:
        found = [
            _candidate(_Columns(j, 1, partial(make, place)), height, {"height": height, "place": place})
            for place in map(float, some)
        ]
        return [(candidate, causal.columns(candidate)) for candidate in found]

    def best(pairs: Pairs) -> float:
        scored = causal.score_columns(name, j + 1, pairs)
        assert scored is not None
        return scored.estimate.entry.candidate.grid["place"]

    coarse, about = places
    pairs = at(coarse)
    pairs += at(about(best(pairs)))
    return pairs, best(pairs)


def _after(time: Floats, place: float) -> Floats:
    """(n, 1) a step at a time."""
    return (time > place).astype(float)[:, None]


def _time_lines(causal: CausalScreen, j: int, height: float) -> _Lines:
    time = causal.block_times(j)
    length = time.max() - time.min()
    top = RESIDUALS.top_line * causal.problem.sampled.cutoffs[1]
    frequencies = np.arange(RESIDUALS.least_periods / length, top, 1.0 / (RESIDUALS.line_density * length))
    candidates = [_candidate((), height, {"frequency": float(f)}, 2) for f in frequencies]
    return _Lines(j, time, causal.response(j, frequencies), frequencies, candidates)


@dataclass(frozen=True)
class _Lines:
    """(candidate, its columns) of each spectral line in time, one by one: of a long log all would take gigabytes."""

    joint: int
    time: Floats
    gains: Complexes
    frequencies: Floats
    candidates: list[Candidate]

    def __len__(self) -> int:
        return len(self.candidates)

    def __iter__(self) -> Iterator[tuple[Candidate, Columns]]:
        for candidate, f, gain in zip(self.candidates, self.frequencies, self.gains):
            phase = 2.0 * np.pi * f * self.time + np.angle(gain)
            yield candidate, {self.joint: abs(gain) * np.column_stack([np.sin(phase), np.cos(phase)])}


def _angle_lines(causal: CausalScreen, j: int, height: float, factor: Floats | float) -> Pairs:
    """(candidate, its columns) of each line in motor angle, times a factor (n,) or 1.0."""
    signals = causal.signals
    speed = np.abs(signals.velocity[:, j]) * signals.gear[j] / (2.0 * np.pi)
    pairs = []
    for order in _ORDERS:
        if (order * speed < causal.problem.sampled.cutoffs[1]).mean() >= RESIDUALS.least_order_rows:
            make = partial(_waves, order * signals.gear[j], signals.position[:, j], factor)
            candidate = _candidate(_Columns(j, 2, make), height, {"order": float(order)})
            pairs.append((candidate, causal.columns(candidate)))
    return pairs


def _waves(turns: float, position: Floats, factor: Floats | float) -> Floats:
    """(n, 2) sine and cosine over a position, times a factor."""
    phase = turns * position
    return np.column_stack([factor * np.sin(phase), factor * np.cos(phase)])


def describe(best: Curve, ranking: tuple[tuple[str, float], ...]) -> Shape:
    """The best curve with its 95 % band."""
    axis, heights, covariance, grid = best.axis, best.heights, best.scored.estimate.covariance, best.candidate.grid
    spread = RESIDUALS.normal_quantile * np.sqrt(np.diag(covariance))
    name, unit, way, frequency = "motor_angle", "rad", best.way, grid.get("frequency")
    if axis is None:
        phase = np.linspace(0.0, 2.0 * np.pi, RESIDUALS.line_points)
        curve = heights[0] * np.sin(phase) + heights[1] * np.cos(phase)
        band = np.sqrt((np.sin(phase) * spread[0]) ** 2 + (np.cos(phase) * spread[1]) ** 2)
        if frequency is None:
            centre = phase / grid["order"]
        else:
            name, unit, centre = "time", "s", phase / (2.0 * np.pi * frequency)
    else:
        name, unit, way, centre, curve, band = axis.name, axis.unit, axis.way, axis.knots, heights, spread
        if way == _STEP:
            curve, band = (np.array([0.0, 0.0, x[0], x[0]]) for x in (heights, spread))
        elif way in (HYSTERESIS, GAP):
            # the branch after a reversal: each play operator moves until its width is used up
            centre = np.concatenate([[0.0], axis.knots])
            shares = np.minimum(centre[:, None], axis.knots) - 0.5 * axis.knots
            columns = 2.0 / axis.knots * shares
            curve = columns @ heights
            band = RESIDUALS.normal_quantile * np.sqrt(np.einsum("ij,jk,ik->i", columns, covariance, columns))
    return Shape(name, unit, best.joint, centre, curve, curve - band, curve + band, frequency, ranking, way)
