# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Helpers of regressors: candidates of a grid, signs under noise, stretches of record, derivatives, scales."""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial, wraps
from typing import Any

import numpy as np

from puma_sim_core.effects.screening import TORQUE_COLUMN, ByJoint, Candidate, Illegal, Signals, reached
from puma_sim_core.jit import compiled

#: a share of samples that a column must be different from zero in, else the log does not show it
_LEAST_SHARE = 0.002
#: time constants [s] of what gets warm
_TIME_CONSTANTS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 600.0)
#: a screening function, and what turns coefficients and, as keywords, numbers of the grid into parameters
_Search = Callable[[Signals, int], list[Candidate]]
_ToValues = Callable[..., dict[str, float]]


def candidate(
    columns: Iterable[ByJoint],
    mean: Sequence[float],
    deviation: Sequence[float],
    values: _ToValues,
    grid: Mapping[str, float] | None = None,
    unit: str = TORQUE_COLUMN,
    fixed: bool = False,
    tried: int = 1,
) -> Candidate:
    """A Candidate from sequences; `values` takes its coefficients and, as keywords, its numbers of the grid."""
    point = {name: float(number) for name, number in (grid or {}).items()}
    prior = np.asarray(mean, float), np.asarray(deviation, float)
    return Candidate(tuple(columns), unit, *prior, partial(values, **point), point, fixed, tried)


def sized(name: str, check: Callable[..., float], *limits: Any) -> _ToValues:
    """Values of an effect with one coefficient, which is the parameter `name`: as checked, beside those of the grid."""
    return lambda c, **grid: {name: check(c[0], *limits)} | {key: grid[key] for key in grid if key != name}


def when_moving(search: _Search) -> _Search:
    """A screening function that finds nothing where no part of the log has the joint move."""

    @wraps(search)
    def found(signals: Signals, joint: int) -> list[Candidate]:
        return search(signals, joint) if moves(signals, joint) else []

    return found


def visible(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Those without a column that is zero all but a few samples."""

    def shows(column: ByJoint) -> bool:
        return any(np.count_nonzero(values) > _LEAST_SHARE * values.size for values in column.values())

    return [found for found in candidates if all(map(shows, found.columns))]


def on_joint(joint: int, *columns: np.ndarray) -> tuple[ByJoint, ...]:
    """Columns of an effect that is seen on its own joint alone."""
    return tuple({joint: column} for column in columns)


def positive(value: float, what: str, unit: str, most: float = np.inf) -> float:
    """The value, where it lies in 0..most; Illegal names it otherwise."""
    value = float(value)
    if not value >= 0.0:
        raise Illegal(f"negative {what} {value:.3g} {unit}")
    if value > most:
        raise Illegal(f"{what} {value:.3g} {unit}, more than {most:.3g} {unit}")
    return value


def bounded(value: float, what: str, unit: str, most: float) -> float:
    """The value of either sign, where its magnitude is at most `most`; Illegal otherwise."""
    value = float(value)
    if not abs(value) <= most:
        raise Illegal(f"{what} {value:.3g} {unit}, more than {most:.3g} {unit} in magnitude")
    return value


def polar(cosine: float, sine: float) -> tuple[float, float]:
    """Amplitude and angle of two coefficients."""
    return float(np.hypot(cosine, sine)), float(np.arctan2(sine, cosine))


def stretches(signals: Signals) -> list[slice]:
    """The stretches of record, in order: nothing is continuous from one to the next."""
    cuts = np.flatnonzero(np.diff(signals.segment)) + 1
    edges = [0, *cuts.tolist(), len(signals.segment)]
    return [slice(a, b) for a, b in itertools.pairwise(edges) if b > a]


def derivative(values: np.ndarray, signals: Signals) -> np.ndarray:
    """Time derivative of (n,) or (n, J) values by central differences, stretch by stretch."""
    out = np.zeros_like(values, dtype=float)
    for part in stretches(signals):
        if part.stop - part.start > 2:
            out[part] = np.gradient(values[part], signals.step, axis=0, edge_order=2)
    return out


def is_arm(signals: Signals) -> bool:
    """Whether the sizes of the library's tables are the machine's own."""
    return signals.library_sized


def volt_scale(signals: Signals, joint: int) -> float:
    """Voltage [V] of the nominal friction torque, the unit of priors of voltages."""
    return float(signals.volts_per_torque[joint] * signals.torque_scale[joint])


def fastest(signals: Signals, joint: int) -> float:
    """Speed [rad/s] that only one sample in a hundred exceeds."""
    return float(np.quantile(np.abs(signals.velocity[:, joint]), 0.99))


def moves(signals: Signals, joint: int) -> bool:
    """Whether the joint moves faster than its velocity is known, in some part of the log.

    The quantile of noise alone is 2.58 of its standard deviation, with a standard error of 0.15 from 500 rows.
    """
    return fastest(signals, joint) > max(3.0 * float(signals.velocity_noise[joint]), 1e-9)


def travelled(signals: Signals, joint: int) -> tuple[float, float]:
    """Lowest and highest position [rad] of the log."""
    q = signals.position[:, joint]
    return float(q.min()), float(q.max())


def of_travel(signals: Signals, joint: int) -> float:
    """Factor of the arm's deflections [rad] at other mechanisms: what they are to the travelled range on the arm."""
    return 1.0 if is_arm(signals) else min(1.0, float(np.ptp(signals.position[:, joint])))


def whole_range(signals: Signals, joint: int) -> tuple[float, float]:
    """Range of the joint [rad]; what the log visits where that is more or no range is known."""
    low, high = signals.ranges[joint]
    return reached((float(low), float(high)), travelled(signals, joint))


def smooth_sign(velocity: np.ndarray, noise: float) -> np.ndarray:
    """Sign of a noisy velocity: qd / sqrt(qd^2 + (2 noise)^2), 0 at rest; a hard sign would switch with the noise."""
    return velocity / np.hypot(velocity, max(2.0 * float(noise), 1e-9))


def torque_volts(signals: Signals, joint: int, torque: np.ndarray) -> np.ndarray:
    """Voltage [V] that a torque (n,) [N.m] at a joint costs: k (1 + L/R d/dt) of it."""
    volts = torque
    if signals.lag[joint] != 0.0:
        volts = torque + signals.lag[joint] * derivative(torque, signals)
    return signals.volts_per_torque[joint] * volts


def over_resistance(signals: Signals, joint: int, volts: np.ndarray) -> np.ndarray:
    """Voltage (n,) over the resistance of a winding under `volts`, from the steady current of each first sample on."""
    lag = float(signals.lag[joint])
    if lag <= 0.0:
        return volts
    out, kept = np.empty_like(volts), np.exp(-signals.step / lag)
    for part in stretches(signals):
        # the voltage between two samples is about the mean of both
        mean = 0.5 * (volts[part] + np.concatenate([volts[part][:1], volts[part][:-1]]))
        out[part] = recursion(np.full(mean.size, kept), (1.0 - kept) * mean, float(mean[0]))
    return out


def motor_torque(signals: Signals, joint: int) -> np.ndarray:
    """Torque (n,) [N.m] that a motor gives at its joint after its viscous friction, by its voltage.

    Unlike the torque of the model, it holds all friction that acts.
    """
    w = signals.velocity[:, joint]
    across = signals.voltage[:, joint] - signals.enable[:, joint] * signals.emf[joint] * w
    driven = over_resistance(signals, joint, across / signals.volts_per_torque[joint])
    return driven - signals.viscous[joint] * w


def slow_enough(signals: Signals, joint: int, order: float) -> bool:
    """Whether waves of `order` [1/rad] in the position pass at less than 25 Hz, which the filters of the screening let
    through, for a tenth of the moving time at least."""
    speed = np.abs(signals.velocity[:, joint])
    moving = speed > max(3.0 * float(signals.velocity_noise[joint]), 1e-9)
    slow = order * speed / (2.0 * np.pi) < 25.0
    return bool(np.count_nonzero(moving & slow) > 0.1 * max(int(np.count_nonzero(moving)), 1))


def waves(signals: Signals, joint: int, order: float) -> bool:
    """Whether sin(order q) shows itself: a whole wave is travelled, slowly enough."""
    low, high = travelled(signals, joint)
    return order * (high - low) > 2.0 * np.pi and slow_enough(signals, joint, order)


def warming(
    signals: Signals, joint: int, column: np.ndarray, values: _ToValues, prior: tuple[float, float], unit: str
) -> list[Candidate]:
    """Candidates of a column that grows as 1 - exp(-t/T), one for each T, which `values` takes as `time_constant`.

    A record much shorter than T shows the slope alone, so that all such T look alike: of those beyond ten times the
    record's end none is kept.
    """
    mean, deviation = prior
    most = max(10.0 * float(signals.time[-1]), 30.0)
    return [
        candidate(on_joint(joint, column * grown(signals, T)), [mean], [deviation], values, {"time_constant": T}, unit)
        for T in _TIME_CONSTANTS
        if most >= T
    ]


def grown(signals: Signals, time_constant: float) -> np.ndarray:
    """1 - exp(-t/T) (n,); 0 before 0."""
    return -np.expm1(-np.maximum(signals.time, 0.0) / time_constant)


@compiled
def recursion(kept: np.ndarray, gained: np.ndarray, start: float) -> np.ndarray:
    """x[0] = start, x[i] = kept[i] x[i-1] + gained[i]: a first-order state at varying rates.

    kept, gained : (n,), of which entry 0 is not read.
    """
    out, x = kept.copy(), start
    out[0] = x
    for i in range(1, kept.size):
        x = kept[i] * x + gained[i]
        out[i] = x
    return out
