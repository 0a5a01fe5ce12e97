# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Logs on one even grid, positions filtered without phase to velocity and acceleration (step 1).

A row's voltage holds until the next row, so that what belongs to an instant is its mean over one
step about it: for even logs the mean of two rows, for uneven ones an exact integral. That is
the shift by half a sample. Positions of uneven logs are interpolated by a cubic through their
neighbours (Akima), voltages are integrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from puma_sim_core.errors import RecordingError
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.settings import DATA


@dataclass(frozen=True)
class Sampled:
    """One or several logs on one grid; arrays (n, J), rows of all logs below each other.

    time (n,) [s], from each log's own clock; step [s]; segment (n,): number of the log; voltage
    [V]: mean over one step about the time, 0 where the drive is off; enable (n, J): 1, 0, or
    between at a change; position [rad], velocity, acceleration: after the first filter; setpoint
    or None; quantum (J,) [rad]; position_noise (J,) [rad]: standard deviation of one raw sample;
    cutoffs (first, second) [Hz]; every: the second filter's output is read each so many rows.
    """

    time: np.ndarray
    step: float
    segment: np.ndarray
    voltage: np.ndarray
    enable: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    setpoint: np.ndarray | None
    quantum: np.ndarray
    position_noise: np.ndarray
    cutoffs: tuple[float, float]
    every: int

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.position.shape[1]

    @property
    def stretches(self) -> list[slice]:
        """The rows of each log."""
        starts = np.flatnonzero(np.diff(self.segment, prepend=-1))
        return [slice(int(a), int(b)) for a, b in zip(starts, [*starts[1:], len(self.segment)])]

    @property
    def velocity_noise(self) -> np.ndarray:
        """(J,) standard deviation of `velocity` [rad/s] by the noise of the positions."""
        f = np.fft.rfftfreq(4096, self.step)
        density = 2.0 * self.position_noise**2 * self.step
        gain = np.sum((2 * np.pi * f * filters.response(f, self.cutoffs[0])) ** 2) * (f[1] - f[0])
        return np.sqrt(density * gain)

    def second(self, values: np.ndarray, lag: float = 0.0, order: int = 0) -> np.ndarray:
        """Columns (n, ...) through the second filter, log by log; see `filters.low_pass`."""
        out = np.empty_like(values, dtype=float)
        for rows in self.stretches:
            (out[rows],) = filters.low_pass(values[rows], self.step, self.cutoffs[1], (order,), lag)
        return out

    def kept(self) -> np.ndarray:
        """Rows that are read after the second filter: each `every`-th one away from the ends."""
        margin = int(np.ceil(sum(map(filters.edge, self.cutoffs)) / self.step))
        return np.concatenate(
            [np.arange(rows.start + margin, rows.stop - margin, self.every) for rows in self.stretches]
        ).astype(int)


def sample(logs: Sequence) -> Sampled:
    """Put logs (`ingest.Log`) on one grid.

    Raises
    ------
    RecordingError : a log that is too short for its filters.
    """
    steps = [float(np.median(np.diff(log.time))) for log in logs]
    step = float(np.median(steps))
    first = min(DATA.sampling_first_cutoff, DATA.sampling_first_share / step)
    second = min(DATA.sampling_second_cutoff, DATA.sampling_second_share * first)
    shortest = 4.0 * (filters.edge(first) + filters.edge(second))
    parts = []
    for number, log in enumerate(logs):
        if log.time[-1] - log.time[0] < shortest:
            raise RecordingError(
                f"lasts {log.time[-1] - log.time[0]:.3g} s", where=log.name, expected=f"{shortest:.2g} s at least"
            )
        parts.append(_on_grid(log, step, first, number))
    joined = {
        key: np.concatenate([part[key] for part in parts])
        for key in parts[0]
        if parts[0][key] is not None and all(part[key] is not None for part in parts)
    }
    raw = [part.pop("raw") for part in parts]
    joined.pop("raw", None)
    quantum = np.array(
        [_quantum(np.concatenate([log.position[:, j] for log in logs])) for j in range(logs[0].position.shape[1])]
    )
    noise = np.maximum(_white_noise(raw, step, first), quantum / np.sqrt(12.0))
    every = max(1, int(1.0 / (step * DATA.sampling_kept * second)))
    return Sampled(
        step=step,
        quantum=quantum,
        position_noise=noise,
        cutoffs=(first, second),
        every=every,
        setpoint=joined.pop("setpoint", None),
        **joined,
    )


def _on_grid(log, step: float, cutoff: float, number: int) -> dict:
    gaps = np.diff(log.time)
    even = abs(gaps / step - 1.0).max() < DATA.sampling_even
    J = log.position.shape[1]
    enable = (
        np.ones(log.voltage.shape)
        if log.enable is None
        else np.broadcast_to(np.reshape(log.enable, (len(log.time), -1)), log.voltage.shape).astype(float)
    )
    drive = np.where(enable > 0.0, log.voltage, 0.0)
    if even:
        time = log.time[1:]
        pairs = [0.5 * (a[1:] + a[:-1]) for a in (drive, enable)]
        position = log.position[1:]
        setpoint = None if log.setpoint is None else log.setpoint[1:]
    else:
        n = int((log.time[-1] - log.time[0]) / step) - 1
        time = log.time[0] + step * np.arange(1, n)
        pairs = [_held_mean(log.time, a, time, step) for a in (drive, enable)]
        position = Akima1DInterpolator(log.time, log.position, axis=0)(time)
        setpoint = (
            None
            if log.setpoint is None
            else np.column_stack([np.interp(time, log.time, log.setpoint[:, j]) for j in range(J)])
        )
    q, qd, qdd = filters.low_pass(position, step, cutoff, (0, 1, 2))
    return {
        "time": time,
        "segment": np.full(len(time), number),
        "voltage": pairs[0],
        "enable": pairs[1],
        "position": q,
        "velocity": qd,
        "acceleration": qdd,
        "setpoint": setpoint,
        "raw": position,
    }


def _held_mean(time, values, at, step) -> np.ndarray:
    """Means over [at - step/2, at + step/2] of values that hold from row to row."""
    area = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * np.diff(time)[:, None], axis=0)])

    def to(t):
        return np.column_stack([np.interp(t, time, area[:, j]) for j in range(values.shape[1])])

    return (to(at + 0.5 * step) - to(at - 0.5 * step)) / step


def _quantum(position: np.ndarray) -> float:
    """Step of an encoder: the smallest change, where all changes are whole multiples of it."""
    change = np.abs(np.diff(position))
    size = float(np.abs(position).max()) or 1.0
    change = change[change > 1e-9 * size]
    if len(change) < 20:
        return 0.0
    least = float(np.quantile(change, 0.001))
    near = change[change < 1.5 * least]
    step = float(near.mean())
    count = change[change < 50.0 * step] / step
    return step if len(count) and np.abs(count - np.round(count)).mean() < 0.05 else 0.0


def _white_noise(raw, step, cutoff) -> np.ndarray:
    """(J,) standard deviation of one sample, from what lies between 1.5 cutoffs and Nyquist."""
    power, share = 0.0, 0.0
    for position in raw:
        n = len(position)
        window = np.hanning(n)[:, None]
        slope = np.linspace(0.0, 1.0, n)[:, None] * (position[-1] - position[0])
        spectrum = np.abs(np.fft.rfft((position - position[0] - slope) * window, axis=0)) ** 2
        high = np.fft.rfftfreq(n, step) > min(1.5 * cutoff, 0.4 / step)
        power = power + np.median(spectrum[high], axis=0) / np.log(2.0)
        share += float((window**2).sum())
    return np.sqrt(power / share)
