# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How much of a log's voltage the nominal model can explain, coarsely and robustly.

The slow part of each joint's voltage is split as the model says, V = k (inertial + gravity torque) + (emf + k H) qd,
each part with a factor, and terms for friction, offsets, springs, drag, stops and loads. All factors are bounded by
what wrong parameters and the effects of the library can make of them: the residual is more than any of them explains.
Rows where a joint rests do not count for it: dry friction may hold it there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from puma_sim_core.identify.arrays import Bools, Floats
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.settings import CHECKS, FITTING
from puma_sim_core.plant.mechanism import Mechanism

#: place of the column of dry friction, before that of friction that grows with the weight
_DRY_COLUMN = 4


@dataclass(frozen=True)
class Change:
    """A change of a log: positions in another order, times `scale`, plus `offset`; voltages in another order, times
    `volts`; time times `clock`. scale, offset, volts : (J,) or one."""

    positions: tuple[int, ...] | None = None
    scale: Floats | float = 1.0
    offset: Floats | float = 0.0
    voltages: tuple[int, ...] | None = None
    volts: Floats | float = 1.0
    clock: float = 1.0


@dataclass(frozen=True)
class Coarse:
    """Slow part of a log, (n, J): voltage and its derivative, motion, enable from 0.0 to 1.0; step [s]."""

    voltage: Floats
    voltage_rate: Floats
    position: Floats
    velocity: Floats
    acceleration: Floats
    enable: Floats
    step: float

    @property
    def joints(self) -> int:
        """Number of joints."""
        return self.position.shape[1]

    @property
    def enabled(self) -> Bools:
        """(n, J) whether a drive is on."""
        return self.enable > CHECKS.plausibility_enabled

    def changed(self, change: Change) -> Coarse:
        """The log with a change."""
        p = slice(None) if change.positions is None else list(change.positions)
        v = slice(None) if change.voltages is None else list(change.voltages)
        return replace(
            self,
            voltage=self.voltage[:, v] * change.volts,
            voltage_rate=self.voltage_rate[:, v] * change.volts / change.clock,
            position=self.position[:, p] * change.scale + change.offset,
            velocity=self.velocity[:, p] * change.scale / change.clock,
            acceleration=self.acceleration[:, p] * change.scale / change.clock**2,
        )

    def thinned(self, rows: int) -> Coarse:
        """About so many rows, evenly spaced."""
        every = max(1, len(self.voltage) // rows)
        arrays = {name: a[::every] for name, a in vars(self).items() if name != "step"}
        return Coarse(**arrays, step=self.step * every)


def coarse(log: Log, cutoff: float = CHECKS.plausibility_cutoff) -> Coarse | None:
    """The part of a log below `cutoff` [Hz], None of a too short or uneven one; finite numbers and increasing times."""
    step = float(np.median(np.diff(log.time)))
    cutoff = min(cutoff, 0.2 / step)
    if log.span < 4.0 * filters.edge(cutoff) or too_uneven(log):
        return None
    n = int(log.span / step) + 1
    at = log.time[0] + step * np.arange(n)
    on = np.ones(log.voltage.shape) if log.enable is None else log.enable

    def low_pass(values: Floats, *orders: int) -> list[Floats]:
        even = np.column_stack([np.interp(at, log.time, column) for column in values.T])
        return filters.low_pass(even, step, cutoff, orders)

    volts, rate = low_pass(np.where(on > 0.5, log.voltage, 0.0), 0, 1)
    q, qd, qdd = low_pass(log.position, 0, 1, 2)
    (enable,) = low_pass(on, 0)
    margin = int(0.5 * filters.edge(cutoff) / step)
    every = max(1, int(0.15 / (cutoff * step)), (n - 2 * margin) // CHECKS.plausibility_rows)
    rows = slice(margin, n - margin, every)
    return Coarse(volts[rows], rate[rows], q[rows], qd[rows], qdd[rows], enable[rows], step * every)


def too_uneven(log: Log) -> bool:
    """Whether an even grid by the middle step of a log would have several times its rows."""
    return int(log.span / float(np.median(np.diff(log.time)))) + 1 > 4 * len(log)


@dataclass(frozen=True)
class Fit:
    """One joint's voltage: how many rows counted (0: the joint rests); root mean squares of the residual and of the
    voltage about its mean [V], of a passive joint those of its weight; volts of dry friction, None of a joint that
    rests; residual (n,) [V], counted (n,)."""

    rows: int
    left: float
    scale: float
    dry: float | None
    residual: Floats
    counted: Bools


class Plausibility:
    """Fits of the nominal model to coarse series; see the module.

    unit (J,) : volts of the nominal friction; speed (J,) : emf + k H [V.s/rad]; friction_work (J,) : of the nominal
    friction over the range, or a turn [J].
    """

    def __init__(self, mechanism: Mechanism):
        self.mechanism = mechanism
        self.theta = mechanism.start
        self.drive = drive = mechanism.drive(self.theta)
        self.k = drive.volts_per_torque
        self.unit = self.k * np.asarray(mechanism.torque_scale, dtype=float)
        self.speed = drive.emf + self.k * drive.viscous
        widths = np.minimum([high - low for low, high in mechanism.ranges], 2.0 * np.pi)
        self.friction_work = np.asarray(mechanism.torque_scale, dtype=float) * widths

    def inertia(self, c: Coarse) -> Floats:
        """(J,) mean inertia that a joint moves."""
        return self.mechanism.inertia(self.theta, c.position).mean(axis=0) + self.drive.motor_inertia

    def moving(self, c: Coarse, joint: int) -> Bools:
        """(n,) where a joint moves under power."""
        speed = np.abs(c.velocity[:, joint])
        slow = self.speed[joint] * speed < CHECKS.plausibility_slow * self.unit[joint]
        if self.drive.emf[joint] == 0.0:
            # nothing brakes it but friction: it moves where its inertia carries it on
            slow &= 0.5 * self.inertia(c)[joint] * speed**2 < CHECKS.plausibility_carried * self.friction_work[joint]
        slow |= speed < CHECKS.plausibility_slow_share * float(speed.max())
        reach = max(1, int(0.5 / (CHECKS.plausibility_cutoff * c.step)))
        near = np.convolve(slow, np.ones(2 * reach + 1), "same") > 0.5
        return ~near & c.enabled[:, joint]

    def fit(
        self, c: Coarse, joint: int, without: Bools | None = None, torques: tuple[Floats, Floats] | None = None
    ) -> Fit:
        """The best that bounded factors make of one joint's voltage. without (n,) : rows that do not count; torques :
        `torques` of c."""
        torque, weight = torques or self.torques(c)
        columns, low, high = self._columns(c, joint, torque, weight)
        counted = self.moving(c, joint)
        if without is not None:
            counted &= ~without
        if counted.sum() < 2 * columns.shape[1]:
            return self._at_rest(c, joint, torque)
        volts = c.voltage[:, joint]
        sizes = np.sqrt(np.mean(columns[counted] ** 2, axis=0)) + 1e-12
        table, wanted = columns[counted] / sizes, volts[counted]
        # a triangle of the same normal equations: quick for any number of rows
        triangle = np.asarray(np.linalg.qr(np.column_stack([table, wanted]), mode="r"))
        x = lsq_linear(triangle[:, :-1], triangle[:, -1], (low * sizes, high * sizes), method="bvls").x / sizes
        residual, heaviest = volts - columns @ x, float(np.abs(columns[counted, _DRY_COLUMN + 1]).max())
        dry = float(max(self.unit[joint] * x[_DRY_COLUMN] + x[_DRY_COLUMN + 1] * heaviest, 0.0))
        # a passive joint balances its weight with its motion
        acts = wanted if self.mechanism.driven[joint] else self.k[joint] * weight[counted, joint]
        return Fit(int(counted.sum()), rms(residual[counted]), float(np.std(acts)), dry, residual, counted)

    def torques(self, c: Coarse) -> tuple[Floats, Floats]:
        """(n, J) torque of the links, and the part of gravity."""
        torque = self.mechanism.torque(self.theta, c.position, c.velocity, c.acceleration)
        return torque, self.mechanism.gravity(self.theta, c.position)

    def _at_rest(self, c: Coarse, joint: int, torque: Floats) -> Fit:
        """A joint that does not move: volts beyond those that friction holds are the residual."""
        counted = c.enabled[:, joint]
        held = CHECKS.plausibility_held * self.unit[joint]
        beyond = soft_threshold(c.voltage[:, joint] - self.k[joint] * torque[:, joint], held)
        if not counted.any():
            return Fit(0, 0.0, 0.0, None, beyond, counted)
        return Fit(0, rms(beyond[counted]), float(np.std(c.voltage[counted, joint])), None, beyond, counted)

    def _columns(self, c: Coarse, joint: int, torque: Floats, weight: Floats) -> tuple[Floats, Floats, Floats]:
        """Columns (n, p) [V] of a joint's voltage, and the bounds (p,) of their factors."""
        k, unit = self.k[joint], self.unit[joint]
        q, v = c.position[:, joint], c.velocity[:, joint]
        gravity, speed, inertia = k * weight, self.speed[joint] * v, self.drive.motor_inertia[joint]
        inertial = k * (torque[:, joint] - weight[:, joint] + inertia * c.acceleration[:, joint])
        fastest, reach = float(np.abs(v).max()) or 1.0, float(np.ptp(q)) or 1.0
        sign = np.tanh(v / (CHECKS.plausibility_dry_width * fastest))
        offset = (-CHECKS.plausibility_offset, CHECKS.plausibility_offset)
        listed: list[tuple[Floats, tuple[float, float]]] = [
            (inertial, CHECKS.plausibility_inertial),
            (gravity[:, joint], CHECKS.plausibility_gravity),
            (speed, CHECKS.plausibility_emf if self.drive.emf[joint] > 0.0 else CHECKS.plausibility_inertial),
            (speed * np.abs(v) / fastest, CHECKS.plausibility_drag),
            (unit * sign, CHECKS.plausibility_dry),
            (np.abs(gravity[:, joint]) * sign, CHECKS.plausibility_loaded),
            (np.full(len(v), unit), offset),
            (unit * (q - q.mean()) / reach, offset),
        ]
        listed += [(unit * past, (0.0, np.inf)) for past in ends(q)]
        listed += [
            (gravity[:, other], CHECKS.plausibility_others)
            for other in range(c.joints)
            if other != joint and np.any(gravity[:, other])
        ]
        columns, limits = zip(*listed)
        low, high = zip(*limits)
        return np.column_stack(columns), np.array(low), np.array(high)

    def share(self, fit: Fit, joint: int, floor: float = CHECKS.plausibility_floor) -> float:
        """Share of a joint's voltage that is not explained; `floor` times the nominal friction's volts is the least."""
        unit = self.unit[joint]
        return float(np.hypot(fit.left, CHECKS.plausibility_noise * unit) / np.hypot(fit.scale, floor * unit))

    def fits(self, c: Coarse) -> list[Fit]:
        """`fit` of each joint."""
        torques = self.torques(c)
        return [self.fit(c, joint, torques=torques) for joint in range(c.joints)]

    def lasting_fits(self, c: Coarse) -> list[Fit]:
        """`fits` without rows that the rest of the log leaves far out of line, where these are few.

        A push from outside takes a few rows; a channel that is wrong is wrong in all of them. Rows beyond four robust
        deviations are left out until none is new (Rousseeuw and Leroy 1987, Robust Regression, chapter 1).
        """
        torques, found = self.torques(c), list[Fit]()
        for joint, fit in enumerate(self.fits(c)):
            without = np.zeros(len(c.voltage), dtype=bool)
            for _ in range(CHECKS.plausibility_event_rounds):
                left = np.abs(fit.residual)
                if not fit.rows:
                    break
                usual = FITTING.deviation_of_median * float(np.median(left[fit.counted]))
                far = left > CHECKS.plausibility_event * usual
                if np.array_equal(far, without) or far.mean() > CHECKS.plausibility_event_share:
                    break
                without, fit = far, self.fit(c, joint, far, torques)
            found.append(fit)
        return found

    def shares(self, fits: Sequence[Fit], floor: float = CHECKS.plausibility_floor) -> Floats:
        """(J,) `share` of each joint."""
        return np.array([self.share(fit, joint, floor) for joint, fit in enumerate(fits)])


def ends(q: Floats) -> list[Floats]:
    """How far positions (n,) are past where stops may begin, at either end of the travel and as shares of it."""
    reach, found = float(np.ptp(q)) or 1.0, list[Floats]()
    for share in CHECKS.plausibility_stops:
        found.append(np.maximum(q - (q.max() - share * reach), 0.0) / reach)
        found.append(np.minimum(q - (q.min() + share * reach), 0.0) / reach)
    return found


def soft_threshold(values: Floats, limit: float) -> Floats:
    """Values (n,) less a limit of their magnitude, 0 within it."""
    return np.sign(values) * np.maximum(np.abs(values) - limit, 0.0)


def rms(values: Floats) -> float:
    """Root mean square of values (n,)."""
    return float(np.sqrt(np.mean(values**2)))
