# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs on one even grid, positions filtered without phase to velocity and acceleration.

A row's voltage holds until the next row. What belongs to an instant is its mean over one step about it: for even logs
the mean of two rows, for uneven ones an exact integral. Positions of uneven logs are interpolated by a cubic through
their neighbours (Akima).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.interpolate import Akima1DInterpolator
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from puma_sim_core.errors import RecordingError
from puma_sim_core.identify.arrays import Bools, Floats, Ints, rows_of_segments, runs
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.log import Log, changes, step_of_few
from puma_sim_core.identify.settings import DATA, SCREENING


@dataclass(frozen=True)
class Trajectory:
    """A motion of one or several logs at even times; arrays (n, J), rows of all logs below each other.

    time (n,) [s], from each log's own clock; step [s]; segment (n,) : number of the log; voltage [V] : mean over one
    step about the time, 0 where the drive is off; enable : 1, 0, or between at a change; position [rad or m], velocity,
    acceleration : after the first filter.
    """

    time: Floats
    step: float
    segment: Ints
    voltage: Floats
    enable: Floats
    position: Floats
    velocity: Floats
    acceleration: Floats

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.position.shape[1]

    @property
    def stretches(self) -> list[slice]:
        """The rows of each log."""
        return rows_of_segments(self.segment)


@dataclass(frozen=True)
class Sampled(Trajectory):
    """Logs on one grid.

    setpoint (n, J) or None; quantum (J,) [rad or m] : step of the encoder; position_noise (J,) : standard deviation of
    one raw sample; cutoffs (first, second) [Hz]; every : the second filter's output is read each so many rows.
    """

    setpoint: Floats | None
    quantum: Floats
    position_noise: Floats
    cutoffs: tuple[float, float]
    every: int

    @property
    def velocity_noise(self) -> Floats:
        """(J,) standard deviation of `velocity` [rad/s] by the noise of the positions."""
        f = fft.rfftfreq(4096, self.step)
        density = 2.0 * self.position_noise**2 * self.step
        gain = np.sum((2 * np.pi * f * filters.response(f, self.cutoffs[0])) ** 2) * (f[1] - f[0])
        return np.sqrt(density * gain)

    def second(self, values: Floats, lag: float = 0.0, order: int = 0) -> Floats:
        """Columns (n, ...) through the second filter, log by log; see `filters.low_pass`."""
        out = np.empty_like(values, dtype=float)
        for rows in self.stretches:
            (out[rows],) = filters.low_pass(values[rows], self.step, self.cutoffs[1], (order,), lag)
        return out

    def kept(self) -> Ints:
        """Rows that are read after the second filter: each `every`-th one away from the ends."""
        margin = int(np.ceil(sum(map(filters.edge, self.cutoffs)) / self.step))
        parts = [np.arange(rows.start + margin, rows.stop - margin, self.every) for rows in self.stretches]
        return np.concatenate(parts).astype(int)


def resting(velocity: Floats, noise: Floats, step: float, cutoff: float, stretches: Sequence[slice]) -> Bools:
    """(n, J) whether a joint rests, or what a filter of a cutoff [Hz] spreads of that.

    velocity (n, J); noise (J,) : its standard deviation; stretches : the rows of each log.
    """
    speed = np.abs(velocity)
    slow = speed < np.maximum(SCREENING.residual_rest_noise * noise, SCREENING.residual_rest_share * speed.max(axis=0))
    shortest, reach = max(1, int(SCREENING.residual_rest_time / step)), int(0.5 / (cutoff * step))
    rests = np.zeros(slow.shape, dtype=bool)
    for rows in stretches:
        for j, own in enumerate(slow[rows].T):
            for first, end in runs(own):
                if end - first >= shortest:
                    rests[rows.start + max(0, first - reach) : min(rows.stop, rows.start + end + reach), j] = True
    return rests


def changing(log: Log) -> Bools:
    """(n, J) whether the reading of a joint changes by more than a step of its encoder near a row.

    A joint at rest has the same reading again and again: it shows none of the noise that it has in motion.
    """
    rows = 2 * round(DATA.encoder_rest / float(np.median(np.diff(log.time)))) + 1
    near = [reach(log.position, rows, axis=0) for reach in (maximum_filter1d, minimum_filter1d)]
    return np.asarray(near[0] - near[1] > (1.0 + DATA.encoder_blurred) * log.quantum)


def cutoffs(step: float) -> tuple[float, float]:
    """Cutoffs [Hz] of the two filters for rows every `step` [s]."""
    first = min(DATA.sampling_first_cutoff, DATA.sampling_first_share / step)
    return first, min(DATA.sampling_second_cutoff, DATA.sampling_second_share * first)


def shortest_span(step: float) -> float:
    """Time [s] that a log with rows every `step` [s] must last to be filtered."""
    return 4.0 * sum(map(filters.edge, cutoffs(step)))


def sample(logs: Sequence[Log]) -> Sampled:
    """Put logs on one grid.

    Raises
    ------
    RecordingError : a log that is too short for its filters.
    """
    step = float(np.median([float(np.median(np.diff(log.time))) for log in logs]))
    first, second = cutoffs(step)
    shortest = shortest_span(step)
    for log in logs:
        if log.span < shortest:
            raise RecordingError(f"lasts {log.span:.3g} s", where=log.name, expected=f"{shortest:.2g} s at least")
    grids = [on_grid(log, step) for log in logs]
    motions = [filters.low_pass(grid.position, step, first, (0, 1, 2)) for grid in grids]
    position, velocity, acceleration = (np.concatenate(parts) for parts in zip(*motions))
    setpoints = [grid.setpoint for grid in grids if grid.setpoint is not None]
    quantum = np.array([_quantum(np.concatenate(columns)) for columns in zip(*(log.position.T for log in logs))])
    noise = _white_noise([grid.position for grid in grids], step, first)
    return Sampled(
        np.concatenate([grid.time for grid in grids]),
        step,
        np.repeat(np.arange(len(grids)), [len(grid.time) for grid in grids]),
        np.concatenate([grid.voltage for grid in grids]),
        np.concatenate([grid.enable for grid in grids]),
        position,
        velocity,
        acceleration,
        np.concatenate(setpoints) if len(setpoints) == len(grids) else None,
        quantum,
        np.maximum(noise, quantum / np.sqrt(12.0)),
        (first, second),
        max(1, int(1.0 / (step * DATA.sampling_kept * second))),
    )


@dataclass(frozen=True)
class Grid:
    """A log at even times: (n,) and (n, J) before any filter."""

    time: Floats
    voltage: Floats
    enable: Floats
    position: Floats
    setpoint: Floats | None


def on_grid(log: Log, step: float) -> Grid:
    """A log at even times, `step` [s] apart."""
    enable = np.ones(log.voltage.shape) if log.enable is None else log.enable.astype(float)
    steps = (np.where(enable > 0.0, log.voltage, 0.0), enable)
    apart = np.diff(log.time) / step
    lasts = np.round(apart).astype(int)  # rows that each one holds for: more than one where some are missing
    if lasts.min() > 0 and abs(apart - lasts).max() < DATA.sampling_even:
        return _filled(log, steps, lasts)
    # from the first row on, so that a clock that began long before costs no digits
    begin, since = float(log.time[0]), log.time - log.time[0]
    # where most rows come evenly, on these: between two rows their noise is smoothed
    phase = float(np.angle(np.exp(2j * np.pi * since / step).sum())) % (2.0 * np.pi) / (2.0 * np.pi)
    time = step * (phase + np.arange(1.0, int(since[-1] / step) - 1))
    voltage, enable = (_step_mean(since, a, time, step) for a in steps)
    # a drive whose mean is on but for the rounding of an integral was not switched
    enable = np.round(enable, DATA.enable_digits)
    setpoint = None if log.setpoint is None else _interpolated(time, since, log.setpoint)
    return Grid(begin + time, voltage, enable, Akima1DInterpolator(since, log.position, axis=0)(time), setpoint)


def _filled(log: Log, steps: Sequence[Floats], lasts: Ints) -> Grid:
    """An evenly stamped log, rows that are missing between two others filled in: the motion goes on smoothly, and
    voltage and enable (n, J) hold. lasts (n - 1,) : steps of the grid to the next row."""
    voltage, enable = (np.repeat(a, [*lasts, 1], axis=0) for a in steps)
    voltage, enable = (0.5 * (a[1:] + a[:-1]) for a in (voltage, enable))
    time, position, setpoint = log.time, log.position, log.setpoint
    if lasts.max() > 1:
        place = np.r_[0, np.cumsum(lasts)].astype(float)
        at = np.arange(place[-1] + 1.0)
        time = np.interp(at, place, log.time)
        position = Akima1DInterpolator(place, log.position, axis=0)(at)
        setpoint = None if log.setpoint is None else _interpolated(at, place, log.setpoint)
    return Grid(time[1:], voltage, enable, position[1:], None if setpoint is None else setpoint[1:])


def _interpolated(at: Floats, time: Floats, values: Floats) -> Floats:
    """(m, J) values (n, J) at other times."""
    return np.column_stack([np.interp(at, time, column) for column in values.T])


def _step_mean(time: Floats, values: Floats, at: Floats, step: float) -> Floats:
    """Means over [at - step/2, at + step/2] of values that hold from row to row."""
    area = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * np.diff(time)[:, None], axis=0)])
    return (_interpolated(at + 0.5 * step, time, area) - _interpolated(at - 0.5 * step, time, area)) / step


def _quantum(position: Floats) -> float:
    """Step of an encoder: the smallest change, where all changes are whole multiples of it."""
    change = changes(position)
    if len(change) < DATA.encoder_changes:
        return step_of_few(change, len(position))
    least = float(np.quantile(change, 0.001))
    step = float(change[change < 1.5 * least].mean())
    count = change[change < 50.0 * step] / step
    return step if len(count) and np.abs(count - np.round(count)).mean() < 0.05 else 0.0


def _white_noise(raw: Sequence[Floats], step: float, cutoff: float) -> Floats:
    """(J,) standard deviation of one sample, from what lies between 1.5 cutoffs and Nyquist."""
    power, share = np.zeros(raw[0].shape[1]), 0.0
    for position in raw:
        n = len(position)
        window = np.hanning(n)[:, None]
        slope = np.linspace(0.0, 1.0, n)[:, None] * (position[-1] - position[0])
        spectrum = np.abs(np.fft.rfft((position - position[0] - slope) * window, axis=0)) ** 2
        high = np.fft.rfftfreq(n, step) > min(1.5 * cutoff, 0.4 / step)
        power = power + np.median(spectrum[high], axis=0) / np.log(2.0)
        share += float((window**2).sum())
    return np.sqrt(power / share)
