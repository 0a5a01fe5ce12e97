# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""How much of a log's voltage the nominal model can explain at all, coarsely and robustly.

The slow part of each joint's voltage is split as the model says, V = k (inertial + gravity torque)
+ (emf + k H) qd, each part with a factor, and terms that stand for friction, offsets, springs,
drag, stops and loads. All factors are confined to what wrong parameters and the effects of the
library can make of them, so that what is left over is more than any of them explains. Rows where a
joint rests do not count for it: dry friction may hold it there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from puma_sim_core.identify.data import filters
from puma_sim_core.identify.settings import CHECKS

#: place of the column of dry friction, before that of friction that grows with the weight
_DRY_COLUMN = 4


@dataclass(frozen=True)
class Coarse:
    """Slow part of a log: (n, J) voltage and its change by time, position, velocity, acceleration,
    and enable from 0.0 to 1.0; step [s]."""

    voltage: np.ndarray
    voltage_rate: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    enable: np.ndarray
    step: float

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.position.shape[1]

    def changed(self, *, positions=None, scale=1.0, offset=0.0, voltages=None, volts=1.0, clock: float = 1.0) -> Coarse:
        """With position columns in another order, times `scale`, plus `offset`; voltage columns in
        another order, times `volts`; and time times `clock`. scale, offset, volts: (J,) or one."""
        p = slice(None) if positions is None else list(positions)
        v = slice(None) if voltages is None else list(voltages)
        return replace(
            self,
            voltage=self.voltage[:, v] * volts,
            voltage_rate=self.voltage_rate[:, v] * volts / clock,
            position=self.position[:, p] * scale + offset,
            velocity=self.velocity[:, p] * scale / clock,
            acceleration=self.acceleration[:, p] * scale / clock**2,
        )

    def thinned(self, rows: int) -> Coarse:
        """With every so many rows left out that there are about `rows`."""
        every = max(1, len(self.voltage) // rows)
        return replace(
            self,
            step=self.step * every,
            **{
                name: getattr(self, name)[::every]
                for name in ("voltage", "voltage_rate", "position", "velocity", "acceleration", "enable")
            },
        )


def coarse(log, cutoff: float = CHECKS.plausibility_cutoff) -> Coarse | None:
    """The part of a log below `cutoff` [Hz]; None where it is too short or too uneven for one. Its
    numbers must be finite and its times increase."""
    step = float(np.median(np.diff(log.time)))
    length = float(log.time[-1] - log.time[0])
    cutoff = min(cutoff, 0.2 / step)
    n = int(length / step) + 1
    if length < 4.0 * filters.edge(cutoff) or n > 4 * len(log):
        return None
    at = log.time[0] + step * np.arange(n)
    enable = np.ones(log.voltage.shape) if log.enable is None else log.enable

    def even(values):
        return np.column_stack([np.interp(at, log.time, column) for column in values.T])

    volts, rate = filters.low_pass(even(np.where(enable > 0.5, log.voltage, 0.0)), step, cutoff, (0, 1))
    (enable,) = filters.low_pass(even(enable), step, cutoff)
    q, qd, qdd = filters.low_pass(even(log.position), step, cutoff, (0, 1, 2))
    margin = int(0.5 * filters.edge(cutoff) / step)
    every = max(1, int(0.15 / (cutoff * step)), (n - 2 * margin) // CHECKS.plausibility_rows)
    rows = slice(margin, n - margin, every)
    return Coarse(volts[rows], rate[rows], q[rows], qd[rows], qdd[rows], enable[rows], step * every)


@dataclass(frozen=True)
class Fit:
    """One joint's voltage: how many rows counted (0: the joint rests); root mean squares of what
    is left over and of the voltage about its mean [V]; volts of dry friction, None of a joint that
    rests; residual (n,) [V], counted (n,)."""

    rows: int
    left: float
    scale: float
    dry: float | None
    residual: np.ndarray
    counted: np.ndarray


class Plausibility:
    """Fits of the nominal model to coarse series; see the module.

    unit (J,) : volts of a middling friction; speed (J,) : emf + k H [V.s/rad].
    """

    def __init__(self, mechanism):
        self.mechanism = mechanism
        self.theta = mechanism.start
        self.drive = drive = mechanism.drive(self.theta)
        self.k = drive.volts_per_torque
        self.unit = self.k * np.asarray(mechanism.torque_scale, dtype=float)
        self.speed = drive.emf + self.k * drive.viscous

    def moving(self, c: Coarse, joint: int) -> np.ndarray:
        """(n,) where a joint moves under power."""
        speed = np.abs(c.velocity[:, joint])
        slow = (self.speed[joint] * speed < CHECKS.plausibility_slow * self.unit[joint]) | (
            speed < CHECKS.plausibility_slow_share * float(speed.max())
        )
        reach = max(1, int(0.5 / (CHECKS.plausibility_cutoff * c.step)))
        near = np.convolve(slow, np.ones(2 * reach + 1), "same") > 0.5
        return ~near & (c.enable[:, joint] > 0.99)

    def fit(self, c: Coarse, joint: int, without: np.ndarray | None = None, parts=None) -> Fit:
        """The best that confined factors make of one joint's voltage; rows `without` (n,) do not
        count; parts : `torques` of c."""
        parts = parts or self.torques(c)
        columns, low, high = self._columns(c, joint, *parts)
        counted = self.moving(c, joint)
        if without is not None:
            counted &= ~without
        volts, unit = c.voltage[:, joint], self.unit[joint]
        if counted.sum() < 2 * columns.shape[1]:
            return self._at_rest(c, joint, parts[0])
        sizes = np.sqrt(np.mean(columns[counted] ** 2, axis=0)) + 1e-12
        table, wanted = columns[counted] / sizes, volts[counted]
        # a triangle of the same normal equations: quick for any number of rows
        triangle = np.linalg.qr(np.column_stack([table, wanted]), mode="r")
        x = lsq_linear(triangle[:, :-1], triangle[:, -1], (low * sizes, high * sizes), method="bvls").x / sizes
        residual = volts - columns @ x
        dry = unit * x[_DRY_COLUMN] + x[_DRY_COLUMN + 1] * float(np.abs(columns[counted, _DRY_COLUMN + 1]).max())
        return Fit(
            int(counted.sum()), _rms(residual[counted]), float(np.std(wanted)), float(max(dry, 0.0)), residual, counted
        )

    def torques(self, c: Coarse) -> tuple[np.ndarray, np.ndarray]:
        """(n, J) torque of the links, and the part of gravity."""
        return (
            self.mechanism.torque(self.theta, c.position, c.velocity, c.acceleration),
            self.mechanism.gravity(self.theta, c.position),
        )

    def _at_rest(self, c: Coarse, joint: int, torque: np.ndarray) -> Fit:
        """A joint that does not move: volts beyond those that friction holds are left over."""
        counted = c.enable[:, joint] > 0.99
        beyond = c.voltage[:, joint] - self.k[joint] * torque[:, joint]
        beyond = np.sign(beyond) * np.maximum(np.abs(beyond) - CHECKS.plausibility_held * self.unit[joint], 0.0)
        if not counted.any():
            return Fit(0, 0.0, 0.0, None, beyond, counted)
        return Fit(0, _rms(beyond[counted]), float(np.std(c.voltage[counted, joint])), None, beyond, counted)

    def _columns(self, c: Coarse, joint: int, torque: np.ndarray, weight: np.ndarray):
        """Columns (n, p) [V] of a joint's voltage, and the bounds (p,) of their factors."""
        k, unit = self.k[joint], self.unit[joint]
        q, v = c.position[:, joint], c.velocity[:, joint]
        gravity = k * weight
        inertial = k * (
            torque[:, joint] - weight[:, joint] + self.drive.motor_inertia[joint] * c.acceleration[:, joint]
        )
        speed = self.speed[joint] * v
        fastest, reach = float(np.abs(v).max()) or 1.0, float(np.ptp(q)) or 1.0
        sign = np.tanh(v / (CHECKS.plausibility_dry_width * fastest))
        factor = CHECKS.plausibility_emf if self.drive.emf[joint] > 0.0 else CHECKS.plausibility_inertial
        listed = [
            (inertial, CHECKS.plausibility_inertial),
            (gravity[:, joint], CHECKS.plausibility_gravity),
            (speed, factor),
            (speed * np.abs(v) / fastest, CHECKS.plausibility_drag),
            (unit * sign, CHECKS.plausibility_dry),
            (np.abs(gravity[:, joint]) * sign, (0.0, 0.5)),
            (np.full(len(v), unit), (-CHECKS.plausibility_offset, CHECKS.plausibility_offset)),
            (unit * (q - q.mean()) / reach, (-CHECKS.plausibility_offset, CHECKS.plausibility_offset)),
        ]
        for share in CHECKS.plausibility_stops:
            listed.append((unit * np.maximum(q - (q.max() - share * reach), 0.0) / reach, (0.0, np.inf)))
            listed.append((unit * np.minimum(q - (q.min() + share * reach), 0.0) / reach, (0.0, np.inf)))
        listed += [
            (gravity[:, other], CHECKS.plausibility_others)
            for other in range(c.joints)
            if other != joint and np.any(gravity[:, other])
        ]
        columns, limits = zip(*listed)
        low, high = zip(*limits)
        return np.column_stack(columns), np.array(low), np.array(high)

    def share(self, fit: Fit, joint: int, floor: float = CHECKS.plausibility_floor) -> float:
        """Share of a joint's voltage that is left over; one that is smaller than `floor` times
        the volts of a middling friction counts as that."""
        unit = self.unit[joint]
        return float(np.hypot(fit.left, CHECKS.plausibility_noise * unit) / np.hypot(fit.scale, floor * unit))

    def fits(self, c: Coarse) -> list[Fit]:
        """`fit` of each joint."""
        parts = self.torques(c)
        return [self.fit(c, joint, parts=parts) for joint in range(c.joints)]

    def shares(self, fits: list[Fit], floor: float = CHECKS.plausibility_floor) -> np.ndarray:
        """(J,) `share` of each joint."""
        return np.array([self.share(fit, joint, floor) for joint, fit in enumerate(fits)])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
