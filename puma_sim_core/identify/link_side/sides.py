# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs as the comparison of both sides of a transmission reads them: even, filtered without phase, at a few rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.identify.arrays import Floats, Ints, rows_of_segments
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import Grid, on_grid
from puma_sim_core.identify.settings import LINK_SIDE
from puma_sim_core.plant.mechanism import Mechanism


@dataclass(frozen=True)
class Sides:
    """The two readings of joints at m kept rows of several logs; arrays (m, J) unless said otherwise.

    step : of the rows before they were kept [s]; every : each so many were kept; cutoff : of the filter [Hz];
    time (m,), segment (m,) : and number of the log. difference : link less motor [rad or m]; motor, velocity : of the
    motor; link_velocity; torque : that the transmission passes on [N.m or N]; flank : its sign, filtered; grids : each
    log before the filter.
    """

    step: float
    every: int
    cutoff: float
    time: Floats
    segment: Ints
    difference: Floats
    motor: Floats
    velocity: Floats
    link_velocity: Floats
    torque: Floats
    flank: Floats
    grids: tuple[Grid, ...]

    @property
    def place(self) -> Ints:
        """(m,) number of a row in its log."""
        return np.concatenate([np.arange(r.stop - r.start) for r in rows_of_segments(self.segment)])

    def late(self, joint: int, time: float) -> tuple[Floats, Floats]:
        """(m,) what the motor's reading, `time` [s] late, has less the motor's reading, and its slope with the time."""
        position, slope = [], []
        for grid in self.grids:
            own = grid.position[:, joint : joint + 1]
            late, rate = filters.low_pass(own, self.step, self.cutoff, (0, 1), delay=time)
            rows = _kept(len(own), self.step, self.cutoff, self.every)
            position.append(late[rows, 0])
            slope.append(-rate[rows, 0])
        return np.concatenate(position) - self.motor[:, joint], np.concatenate(slope)


def _kept(rows: int, step: float, cutoff: float, every: int) -> Ints:
    margin = int(np.ceil(filters.edge(cutoff) / step))
    return np.arange(margin, rows - margin, every)


def sides(logs: Sequence[Log], mechanism: Mechanism) -> Sides | None:
    """Both sides of the transmissions, None where no log is long enough or has a link's position."""
    usable = [log for log in logs if log.link_position is not None]
    if not usable:
        return None
    step = float(np.median([float(np.median(np.diff(log.time))) for log in usable]))
    cutoff = min(LINK_SIDE.cutoff, LINK_SIDE.cutoff_share / step)
    every = max(1, int(1.0 / (step * LINK_SIDE.kept * cutoff)))
    usable = [log for log in usable if log.span > 4.0 * filters.edge(cutoff)]
    if not usable:
        return None
    drive = mechanism.drive(mechanism.start)
    grids, parts, segments, times = list[Grid](), list[list[Floats]](), list[Ints](), list[Floats]()
    for number, log in enumerate(usable):
        motor = on_grid(log, step)
        assert log.link_position is not None
        link = on_grid(replace(log, position=np.nan_to_num(log.link_position)), step)
        rows = _kept(len(motor.time), step, cutoff, every)
        q, qd, qdd = filters.low_pass(motor.position, step, cutoff, (0, 1, 2))
        link_position, link_velocity = filters.low_pass(link.position, step, cutoff, (0, 1))
        (volts,) = filters.low_pass(motor.voltage, step, cutoff)
        torque = (volts - drive.emf * qd) / drive.volts_per_torque - drive.motor_inertia * qdd - drive.viscous * qd
        torque[:, ~np.array(mechanism.driven)] = 0.0
        (flank,) = filters.low_pass(np.sign(torque), step, cutoff)
        parts.append([values[rows] for values in (link_position - q, q, qd, link_velocity, torque, flank)])
        grids.append(motor)
        segments.append(np.full(len(rows), number))
        times.append(motor.time[rows])
    difference, q, qd, link_velocity, torque, flank = (np.concatenate(own) for own in zip(*parts))
    time, segment = np.concatenate(times), np.concatenate(segments)
    return Sides(step, every, cutoff, time, segment, difference, q, qd, link_velocity, torque, flank, tuple(grids))
