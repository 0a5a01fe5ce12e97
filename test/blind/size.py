# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How large an effect was in a record: what retuning cannot absorb of it, over the noise floor.

All of it is known here without noise: the voltage that the rigid plant with the true parameters
would have needed for the motion that happened, against the voltage that was given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from blind import arm_parameters as arm
from blind.drives import Run, Sampling

BAND = 25.0  # Hz
_TAPS = 121
_EDGE = 150  # rows at either end that the filter does not reach well


@dataclass
class Sizes:
    """Size of an effect, joint by joint (3,): `ratio` over the floor; `voltage` [V rms] not
    absorbed; `raw` [V rms] before retuning; `floor` [V rms] of noise and quantisation in band;
    `distinct`: ratio of what Coulomb friction besides does not absorb either; `strain`: what
    retuning costs by its priors, as a ratio over the floor of all joints together."""

    ratio: np.ndarray
    voltage: np.ndarray
    raw: np.ndarray
    floor: np.ndarray
    distinct: np.ndarray
    strain: float


def measure(run: Run, p: arm.Parameters, sampling: Sampling, noise: np.ndarray, torque_noise: np.ndarray) -> Sizes:
    """Sizes of all that made the run differ from the rigid plant of parameters p."""
    band, step, rows = min(BAND, 0.45 / sampling.period), sampling.row, sampling.rows
    taps = _low_pass(band * step)
    q = run.motion
    qd = np.gradient(q, step, axis=0)
    qdd = np.zeros_like(q)
    qdd[1:-1] = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / step**2
    held = np.repeat(run.commanded + noise, rows, axis=0)
    held = 0.5 * (held + np.vstack([held[:1], held[:-1]]))
    pushed = np.repeat(torque_noise, rows, axis=0)
    pushed = 0.5 * (pushed + np.vstack([pushed[:1], pushed[:-1]]))
    k = p["R"] / (arm.GEAR * p["kt"])
    pushed = k * (pushed + p["L"] / p["R"] * np.gradient(pushed, step, axis=0))
    residual = held - arm.voltage(q, qd, qdd, step, p) + pushed
    unknown = np.repeat(noise, rows, axis=0) + pushed
    kept = slice(_EDGE, len(q) - _EDGE, max(1, int(0.25 / band / step)))
    r = _filtered(residual, taps)[kept]
    floor = np.sqrt(
        (_filtered(unknown, taps)[kept] ** 2).mean(axis=0) + _quantisation(run, q, p, sampling, band, k) ** 2
    )
    smooth = [_filtered(x, taps)[kept] for x in (q, qd, qdd)]
    spacing = step * kept.step
    columns = _columns(smooth, spacing, p)
    friction = _filtered(np.sign(qd) * (np.abs(qd) > 2e-3), taps)[kept]
    left, strain = _absorbed(r, columns, floor)
    extended = columns + [np.where(np.arange(3) == j, 50.0 * friction, 0.0) for j in range(3)]
    beyond, _ = _absorbed(r, extended, floor)

    def rms(x):
        return np.sqrt((x**2).mean(axis=0))

    return Sizes(rms(left) / floor, rms(left), rms(r), floor, rms(beyond) / floor, strain)


def _low_pass(cycles: float) -> np.ndarray:
    x = np.arange(_TAPS) - _TAPS // 2
    taps = np.sinc(2.0 * cycles * x) * np.hamming(_TAPS)
    return taps / taps.sum()


def _filtered(x: np.ndarray, taps: np.ndarray) -> np.ndarray:
    half = len(taps) // 2
    padded = np.vstack([2 * x[0] - x[half:0:-1], x, 2 * x[-1] - x[-2 : -half - 2 : -1]])
    return np.stack([np.convolve(padded[:, j], taps, "valid") for j in range(x.shape[1])], axis=1)


def _quantisation(run: Run, q, p, sampling: Sampling, band: float, k) -> np.ndarray:
    """Rms voltage (3,) that the error of the logged position makes in the inverse model."""
    error = run.measured - q[:: sampling.rows]
    if not error.any():
        return np.zeros(3)
    f = np.fft.rfftfreq(len(error), sampling.period)
    s = 2j * np.pi * f
    mass = arm.inertia(q[::50], p).mean(axis=0).diagonal() + p["Ia"]
    gain = np.outer(s, p["ke"] * arm.GEAR) + np.outer(s**2, k * mass)
    spectrum = np.fft.rfft(error - error.mean(axis=0), axis=0) * gain * (f <= band)[:, None]
    return np.sqrt((np.fft.irfft(spectrum, len(error), axis=0) ** 2).mean(axis=0))


def _columns(smooth, spacing: float, p: arm.Parameters) -> list[np.ndarray]:
    """Change (n, 3) of the voltage for one prior width of each parameter."""
    base = arm.voltage(*smooth, spacing, p)
    columns = []
    for name in arm.NAMES:
        for j in range(3):
            changed = {key: value.copy() for key, value in p.items()}
            width = arm.WIDTH[name] * arm.NOMINAL[name][j]
            if width == 0.0:
                continue
            changed[name][j] += 1e-3 * width
            columns.append((arm.voltage(*smooth, spacing, changed) - base) / 1e-3)
    return [column for column in columns if np.abs(column).max() > 1e-9]


def _absorbed(r, columns, floor) -> tuple[np.ndarray, float]:
    """What is left (n, 3) of r after the best columns with unit priors, and what those cost."""
    X = np.stack([(column / floor).ravel() for column in columns], axis=1)
    y = (r / floor).ravel()
    b = np.linalg.solve(X.T @ X + np.eye(X.shape[1]), X.T @ y)
    return (y - X @ b).reshape(r.shape) * floor, float(np.sqrt(b @ b / len(r)))
