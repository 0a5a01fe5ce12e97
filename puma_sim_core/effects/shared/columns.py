# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Helpers of regressors: signs under noise, stretches of record, derivatives, scales."""

from __future__ import annotations

import itertools

import numpy as np

from puma_sim_core.effects.screening import TORQUE_COLUMN, Candidate, Illegal, Signals
from puma_sim_core.jit import compiled

#: a share of samples that a column must be different from zero in, else the log does not show it
LEAST_SHARE = 0.002
#: time constants [s] of what gets warm
_TIME_CONSTANTS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 600.0)


def smooth_sign(velocity: np.ndarray, noise: float) -> np.ndarray:
    """Sign of a noisy velocity: qd / sqrt(qd^2 + (2 noise)^2), 0 at rest.

    A hard sign would switch with the noise about each reversal, where dry friction does not.
    """
    width = max(2.0 * float(noise), 1e-9)
    return velocity / np.hypot(velocity, width)


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


def torque_volts(signals: Signals, joint: int, torque: np.ndarray) -> np.ndarray:
    """Voltage [V] that a torque (n,) [N.m] at a joint costs: k (1 + L/R d/dt) of it."""
    volts = torque
    if signals.lag[joint] != 0.0:
        volts = torque + signals.lag[joint] * derivative(torque, signals)
    return signals.volts_per_torque[joint] * volts


def motor_torque(signals: Signals, joint: int) -> np.ndarray:
    """Torque (n,) [N.m] that a motor gives at its joint after its viscous friction, by its voltage.

    Unlike what the model says that the motion takes, it holds all friction that acts, also that
    which the model lacks.
    """
    w = signals.velocity[:, joint]
    driven = (signals.voltage[:, joint] - signals.enable[:, joint] * signals.emf[joint] * w) / signals.volts_per_torque[
        joint
    ]
    lag = float(signals.lag[joint])
    if lag > 0.0:
        kept = np.full(len(driven), np.exp(-signals.step / lag))
        out = np.empty_like(driven)
        for part in stretches(signals):
            now = driven[part]
            mean = 0.5 * (now + np.concatenate([now[:1], now[:-1]]))
            out[part] = recursion(kept[part], (1.0 - kept[part]) * mean, float(now[0]))
        driven = out
    return driven - signals.viscous[joint] * w


def volt_scale(signals: Signals, joint: int) -> float:
    """Voltage [V] of the nominal friction torque, the unit of priors of voltages."""
    return float(signals.volts_per_torque[joint] * signals.torque_scale[joint])


def is_arm(signals: Signals) -> bool:
    """Whether the log is of the arm, whose sizes are those of the library's table."""
    return signals.joints == 3


def fastest(signals: Signals, joint: int) -> float:
    """Speed [rad/s] that only one sample in a hundred exceeds."""
    return float(np.quantile(np.abs(signals.velocity[:, joint]), 0.99))


def travelled(signals: Signals, joint: int) -> tuple[float, float]:
    """Lowest and highest position [rad] of the log."""
    q = signals.position[:, joint]
    return float(q.min()), float(q.max())


def whole_range(signals: Signals, joint: int) -> tuple[float, float]:
    """Range of the joint [rad]; what the log visits where that is more or no range is known."""
    low, high = (float(end) for end in signals.ranges[joint])
    seen_low, seen_high = travelled(signals, joint)
    if not np.isfinite([low, high]).all() or high <= low:
        return seen_low, seen_high
    return min(low, seen_low), max(high, seen_high)


def moves(signals: Signals, joint: int) -> bool:
    """Whether the joint moves faster than its velocity is known, in some part of the log."""
    return fastest(signals, joint) > max(5.0 * float(signals.velocity_noise[joint]), 1e-9)


def on_joint(joint: int, *columns: np.ndarray) -> tuple[dict[int, np.ndarray], ...]:
    """Columns of an effect that is seen on its own joint alone."""
    return tuple({joint: column} for column in columns)


def visible(columns: tuple[dict[int, np.ndarray], ...]) -> bool:
    """Whether no column is zero all but a few samples."""
    return all(any(np.count_nonzero(values) > LEAST_SHARE * values.size for values in c.values()) for c in columns)


def candidate(columns, mean, deviation, values, grid=None, unit=TORQUE_COLUMN, fixed=False, tried=1) -> Candidate:
    """A Candidate from sequences."""
    return Candidate(
        columns=tuple(columns),
        unit=unit,
        mean=np.asarray(mean, float),
        deviation=np.asarray(deviation, float),
        values=values,
        grid=dict(grid or {}),
        fixed=fixed,
        tried=tried,
    )


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


def slow_enough(signals: Signals, joint: int, order: float) -> bool:
    """Whether waves of `order` [1/rad] in the position pass at less than 25 Hz, which the filters
    of the screening let through, for a tenth of the moving time at least."""
    speed = np.abs(signals.velocity[:, joint])
    moving = speed > max(3.0 * float(signals.velocity_noise[joint]), 1e-9)
    slow = order * speed / (2.0 * np.pi) < 25.0
    return bool(np.count_nonzero(moving & slow) > 0.1 * max(int(np.count_nonzero(moving)), 1))


def waves(signals: Signals, joint: int, order: float) -> bool:
    """Whether sin(order q) shows itself: a whole wave is travelled, slowly enough."""
    low, high = travelled(signals, joint)
    return order * (high - low) > 2.0 * np.pi and slow_enough(signals, joint, order)


def change_of_voltage(signals: Signals, joint: int, dq, dqd, dqdd, motor: bool = True) -> dict[int, np.ndarray]:
    """Voltages {joint: (n,)} by which the model's change when a joint's motion does, to first
    order: dq [rad], dqd [rad/s], dqdd [rad/s^2], (n,) each.

    motor : False where the link's motion changes and the motor's does not. What the velocity does
    to centripetal and Coriolis torques is left out: it is small beside back-EMF.
    """
    own = signals.link_inertia[:, joint] * dqdd
    if signals.position_gradient is not None:
        own = own + signals.position_gradient[:, joint, joint] * dq
    if motor:
        own = own + signals.motor_inertia[joint] * dqdd + signals.viscous[joint] * dqd
    volts = torque_volts(signals, joint, own)
    found = {joint: volts + signals.emf[joint] * dqd if motor else volts}
    for i in range(signals.joints):
        if i == joint or signals.inertia is None:
            continue
        other = signals.inertia[:, i, joint] * dqdd
        if signals.position_gradient is not None:
            other = other + signals.position_gradient[:, i, joint] * dq
        found[i] = torque_volts(signals, i, other)
    return found


def wave_numbers(
    signals: Signals, joint: int, lowest: float, highest: float, drift: float = 1.0, most: int = 40
) -> np.ndarray:
    """Wave numbers [1/rad] so close that one between two of them is not missed.

    drift : phase [rad] by which two neighbours drift apart from the middle of the travelled range
        to an end of it; waves half of it apart, 1.0 at the most, still look alike.
    """
    low, high = travelled(signals, joint)
    spacing = 2.0 * drift / max(high - low, 1e-9)
    count = int(np.clip(np.ceil((highest - lowest) / spacing) + 1, 2, most))
    return np.linspace(lowest, highest, count)


def warming(signals, joint, column, values, mean, deviation, unit) -> list[Candidate]:
    """Candidates of a column that grows as 1 - exp(-t/T), one for each T.

    A record much shorter than T shows the slope alone, so that all such T look alike: of those
    beyond ten times the record's end none is kept.
    """
    found: list[Candidate] = []
    end = float(signals.time[-1])
    for T in _TIME_CONSTANTS:
        if found and 10.0 * end < T and T > 30.0:
            break
        grown = -np.expm1(-np.maximum(signals.time, 0.0) / T)

        def with_time(c, T=T):
            return values(c, T)

        found.append(candidate(on_joint(joint, column * grown), mean, deviation, with_time, {"time_constant": T}, unit))
    return found


@compiled
def recursion(kept, gained, start):
    """x[0] = start, x[i] = kept[i] x[i-1] + gained[i]: a first-order state at varying rates.

    kept, gained : (n,) arrays, of which entry 0 is not read. Returns (n,).
    """
    out = kept.copy()
    x = start
    out[0] = x
    for i in range(1, kept.size):
        x = kept[i] * x + gained[i]
        out[i] = x
    return out


def wave_motion(q, qd, qdd, number):
    """(value, rate, acceleration) of sin(number q), and of cos(number q)."""
    s, c = np.sin(number * q), np.cos(number * q)
    first, second = number * qd, number**2 * qd**2
    return ((s, c * first, number * c * qdd - s * second), (c, -s * first, -number * s * qdd - c * second))
