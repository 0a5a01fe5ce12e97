# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""References to move along, in ranges and at speeds of a PUMA."""

from __future__ import annotations

import numpy as np

from blind import arm_parameters as arm

TOP_SPEED = np.array([1.7, 1.15, 1.9])  # rad/s
TOP_ACCELERATION = np.array([7.0, 4.0, 9.0])  # rad/s2
#: where a motion may be centred, and how far it may go to either side
_CENTRE = ((-0.6, 0.6), (-1.9, -0.5), (0.5, 2.0))
_REACH = (1.2, 0.75, 0.9)
_MARGIN = 0.12

KINDS = ("fourier", "wide", "points", "triangles", "crawl", "micro", "bang", "constant", "repeat", "vertical")


def reference(kind: str, rng: np.random.Generator, time: np.ndarray, joint: int | None = None) -> np.ndarray:
    """Positions (n, 3) [rad] at the times (n,), about 1 ms apart.

    joint : (0-based) whose motion matters most; where `kind` is a slow one, the others move in a
    way of their own.
    """
    columns = []
    for j in range(3):
        own = kind
        if joint is not None and j != joint and kind in ("crawl", "micro", "constant", "vertical"):
            own = rng.choice(["fourier", "points", "triangles"])
        columns.append(_ONE[own](rng, time, j))
    q = _smoothed(np.stack(columns, axis=1), 25)
    return np.round(_inside(q), 9)


def _inside(q: np.ndarray) -> np.ndarray:
    """Moved, and shrunk where it must be, into the joints' ranges."""
    q = q.copy()
    for j, (low, high) in enumerate(arm.RANGES):
        low, high = low + _MARGIN, high - _MARGIN
        span = np.ptp(q[:, j])
        if span > high - low:
            q[:, j] = q[0, j] + (q[:, j] - q[0, j]) * (high - low) / span
        q[:, j] += max(0.0, low - q[:, j].min()) - max(0.0, q[:, j].max() - high)
    return q


def _smoothed(q: np.ndarray, width: int) -> np.ndarray:
    """Twice a mean over `width` ms: accelerations stay finite."""
    box = np.ones(width) / width
    for _ in range(2):
        padded = np.vstack([np.repeat(q[:1], width - 1, axis=0), q])
        q = np.stack([np.convolve(padded[:, j], box, "valid") for j in range(3)], axis=1)
    return q


def _centre(rng, j):
    return rng.uniform(*_CENTRE[j])


def _fourier(rng, time, j, lowest=1, highest=9, reach=1.0, speed=(0.45, 1.0)):
    """Finite Fourier series, faded in."""
    base = 2.0 * np.pi / time[-1]
    orders = rng.choice(np.arange(lowest, highest), size=min(4, highest - lowest), replace=False)
    q = np.zeros_like(time)
    for order in orders:
        q += rng.uniform(0.4, 1.0) / order * np.sin(base * order * time + rng.uniform(0.0, 2.0 * np.pi))
    q -= q[0]
    q *= np.clip(time / 0.8, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(time / 0.8, 0.0, 1.0))
    scale = min(
        rng.uniform(*speed) * TOP_SPEED[j] / np.abs(np.gradient(q, time[1])).max(), 2.0 * reach * _REACH[j] / np.ptp(q)
    )
    q *= scale
    return _centre(rng, j) + q - 0.5 * (q.max() + q.min())


def _wide(rng, time, j):
    return _fourier(rng, time, j, 1, 4, 1.35, (0.8, 1.0))


def _moves(time, corners, speeds, accelerations, rests):
    """Trapezoids from corner to corner with rests between them; the last one is held."""
    q = np.full_like(time, corners[0])
    at = rests[0]
    for k in range(1, len(corners)):
        distance = corners[k] - corners[k - 1]
        v, a = speeds[k - 1], accelerations[k - 1]
        size = abs(distance)
        if size == 0.0:
            continue
        v = min(v, np.sqrt(size * a))
        ramp, cruise = v / a, size / v - v / a
        x = time - at
        done = np.where(
            x < ramp,
            0.5 * a * np.clip(x, 0.0, None) ** 2,
            np.where(
                x < ramp + cruise,
                0.5 * v * ramp + v * (x - ramp),
                size - 0.5 * a * np.clip(2 * ramp + cruise - x, 0.0, None) ** 2,
            ),
        )
        q = np.where(x > 0.0, corners[k - 1] + np.sign(distance) * done, q)
        at += 2 * ramp + cruise + rests[k]
        if at > time[-1]:
            break
    return q


def _points(rng, time, j):
    count = 40
    corners = _centre(rng, j) + _REACH[j] * rng.uniform(-1.0, 1.0, count)
    return _moves(
        time,
        corners,
        TOP_SPEED[j] * rng.uniform(0.3, 1.0, count),
        TOP_ACCELERATION[j] * rng.uniform(0.5, 1.0, count),
        rng.uniform(0.05, 0.5, count),
    )


def _repeat(rng, time, j):
    """The same few moves over and over, with holds."""
    few = _centre(rng, j) + _REACH[j] * rng.uniform(-1.0, 1.0, 3)
    corners = np.tile(few, 15)
    return _moves(
        time,
        corners,
        np.full(45, TOP_SPEED[j] * rng.uniform(0.6, 1.0)),
        np.full(45, TOP_ACCELERATION[j] * rng.uniform(0.5, 1.0)),
        np.tile(rng.uniform(0.05, 0.4, 3), 15),
    )


def _zigzag(rng, time, j, speeds, half_periods):
    count = 200
    v, half = rng.uniform(*speeds, count), rng.uniform(*half_periods, count)
    steps = v * half * np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    corners = np.concatenate([[0.0], np.cumsum(steps)])
    # no drift away: each turn back aims a little at the middle
    for k in range(1, count + 1):
        corners[k] = 0.8 * corners[k - 1] + steps[k - 1] if k > 1 else 0.5 * steps[0]
    return _centre(rng, j) + _moves(time, corners, v, np.full(count, TOP_ACCELERATION[j]), np.zeros(count + 1))


def _triangles(rng, time, j):
    return _zigzag(rng, time, j, (0.08, 0.4), (0.5, 1.4))


def _crawl(rng, time, j):
    q = _zigzag(rng, time, j, (0.015, 0.15), (0.5, 1.3))
    return q


def _micro(rng, time, j):
    """Small sines that reverse often, on a slow wander."""
    slow = _zigzag(rng, time, j, (0.02, 0.15), (0.8, 1.6))
    f = rng.uniform(0.7, 1.6)
    return slow + rng.uniform(2e-3, 12e-3) * np.sin(2.0 * np.pi * f * time)


def _constant(rng, time, j):
    return _zigzag(rng, time, j, (0.1, 0.55 if j != 1 else 0.35), (0.9, 2.2))


def _bang(rng, time, j):
    """Full acceleration one way, then the other."""
    count = 60
    size = rng.uniform(0.15, 0.6, count) * _REACH[j]
    corners = _centre(rng, j) + size * np.where(np.arange(count) % 2 == 0, 0.5, -0.5)
    return _moves(
        time, corners, np.full(count, TOP_SPEED[j]), TOP_ACCELERATION[j] * rng.uniform(0.7, 1.2, count), np.zeros(count)
    )


def _vertical(rng, time, j):
    """About the poses in which gravity changes the side of the teeth."""
    centre = (rng.uniform(-0.5, 0.5), -np.pi / 2 + rng.uniform(-0.1, 0.15), rng.uniform(-0.1, 0.1) - 0.05)[j]
    q = _fourier(rng, time, j, 2, 12, 0.5, (0.5, 0.9)) if rng.random() < 0.5 else _bang(rng, time, j)
    return centre + q - 0.5 * (q.max() + q.min())


_ONE = {
    "fourier": _fourier,
    "wide": _wide,
    "points": _points,
    "triangles": _triangles,
    "crawl": _crawl,
    "micro": _micro,
    "bang": _bang,
    "constant": _constant,
    "repeat": _repeat,
    "vertical": _vertical,
}


def dither(rng: np.random.Generator, time: np.ndarray, amplitude, band=(1.0, 8.0)):
    """Sum of sines (n, 3) sampled at `time` (n,), peak about `amplitude` (3,)."""
    lines = 5
    out = np.zeros((len(time), 3))
    for j in range(3):
        f = rng.uniform(*band, lines)
        phase = rng.uniform(0.0, 2.0 * np.pi, lines)
        out[:, j] = np.sin(2.0 * np.pi * np.outer(time, f) + phase).sum(axis=1)
    return np.round(out * np.asarray(amplitude) / 3.0, 9)
