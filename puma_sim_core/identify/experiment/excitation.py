# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Motions that excite a machine, and the voltages that drive it along them.

The motion of a joint is a finite Fourier series about a pose (Swevers, Ganseman, Tukel, De Schutter
and Van Brussel, "Optimal Robot Excitation and Identification", 1997), of five harmonics, to which
come a slow triangle, since stiction shows where a joint creeps, and three fast waves, since
elasticity and delays show at 4 to 15 Hz. All of it swells from rest and dies away to rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from puma_sim_core.effects.screening import Signals
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.data.sampling import Trajectory
from puma_sim_core.identify.screening.hypotheses import signals_of
from puma_sim_core.identify.screening.known_effects import known_voltage
from puma_sim_core.identify.settings import EXPERIMENT
from puma_sim_core.plant.mechanism import Mechanism


@dataclass(frozen=True)
class Limits:
    """What a motion must keep to: position ((low, high), ...) [rad or m], velocity (J,) and
    voltage (J,), greatest magnitudes [rad/s, V]."""

    position: tuple[tuple[float, float], ...]
    velocity: Floats
    voltage: Floats

    @classmethod
    def of(cls, mechanism: Mechanism, voltage: float | None = None, velocity: float | None = None) -> Limits:
        """Ranges of a mechanism; the same greatest voltage and velocity for all joints.

        By default 40 V for an arm, and ten times that of the nominal friction torque for a single joint; 0.6 ranges of
        the joint a second.
        """
        J = mechanism.joints
        span = np.array([high - low for low, high in mechanism.ranges])
        if voltage is None:
            unit = mechanism.drive(mechanism.start).volts_per_torque * mechanism.torque_scale
            voltage = EXPERIMENT.motion_arm_voltage if J > 1 else EXPERIMENT.motion_other_voltage * float(unit[0])
        return cls(
            mechanism.ranges,
            EXPERIMENT.motion_speed * span if velocity is None else np.full(J, velocity),
            np.full(J, float(voltage)),
        )

    def hold(self, position: Floats) -> bool:
        """Whether positions (n, J) are within the ranges."""
        low, high = np.array(self.position).T
        return bool((position > low).all() and (position < high).all())

    @property
    def home(self) -> Floats:
        """(J,) middle of the ranges."""
        return np.array([0.5 * (low + high) for low, high in self.position])


@dataclass(frozen=True)
class Motion:
    """A motion of J joints that lasts `seconds`.

    centre (J,): pose at the start and at the end; amplitude, count, phase (J, 8): waves, the five
    harmonics first, `count` cycles a record each; triangle (J, 3): amplitude, cycles a record and
    phase; span (J, 2): when each joint begins to move and comes to rest [s].
    """

    seconds: float
    centre: Floats
    amplitude: Floats
    count: Floats
    phase: Floats
    triangle: Floats
    span: Floats

    def at(self, time: Floats) -> tuple[Floats, Floats, Floats]:
        """Positions, velocities and accelerations (n, J) at times (n,) [s]."""
        w = 2.0 * np.pi * self.count / self.seconds
        x, v, a = (np.zeros((len(time), len(self.centre))) for _ in range(3))
        for j, n in zip(*np.nonzero(self.amplitude)):
            angle = w[j, n] * time + self.phase[j, n]
            s, c = self.amplitude[j, n] * np.sin(angle), self.amplitude[j, n] * np.cos(angle)
            x[:, j] += s
            v[:, j] += w[j, n] * c
            a[:, j] -= w[j, n] ** 2 * s
        size, turns, phase = self.triangle.T
        w = 2.0 * np.pi * turns / self.seconds
        s, c = (EXPERIMENT.motion_sharp * f(w * time[:, None] + phase) for f in (np.sin, np.cos))
        root = np.sqrt(1.0 - s * s)
        size = size / np.arcsin(EXPERIMENT.motion_sharp)
        x, v = x + size * np.arcsin(s), v + size * w * c / root
        a = a - size * w * w * s * (1.0 - EXPERIMENT.motion_sharp**2) / root**3
        e, e1, e2 = self._envelope(time)
        return (self.centre + e * x, e1 * x + e * v, e2 * x + 2.0 * e1 * v + e * a)

    def _envelope(self, time: Floats) -> tuple[Floats, Floats, Floats]:
        """(n, J) share of the motion, with its first and second derivatives."""
        begin, end = self.span.T
        swell = np.minimum(EXPERIMENT.motion_swell, 0.4 * (end - begin))
        up, up1, up2 = _step((time[:, None] - begin) / swell)
        down, down1, down2 = _step((end - time[:, None]) / swell)
        # at least one of the two is constant wherever the other is not
        return up * down, (up1 * down - up * down1) / swell, (up2 * down + up * down2) / swell**2

    def shrunk(self, by: Floats, home: Floats) -> Motion:
        """The motion with its swings made smaller by (J,) factors, and nearer to a pose (J,)."""
        return replace(
            self,
            centre=home + (self.centre - home) * by,
            amplitude=self.amplitude * by[:, None],
            triangle=self.triangle * np.stack([by, by**0, by**0], axis=1),
        )


def _step(x: Floats) -> tuple[Floats, Floats, Floats]:
    """A step from 0 to 1 over 0..1 that bends and turns smoothly, with two derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return (x**3 * (10.0 - 15.0 * x + 6.0 * x * x), 30.0 * (x * (1.0 - x)) ** 2, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x))


# ------------------------------------------------------------------------------ how they are made


class Builder:
    """Makes motions of a mechanism within limits."""

    def __init__(self, mechanism: Mechanism, limits: Limits, seconds: float):
        self.mechanism, self.limits, self.seconds = mechanism, limits, seconds
        self.theta = mechanism.start
        self.drive = mechanism.drive(self.theta)
        self.half = np.array([0.5 * (high - low) for low, high in limits.position])
        self.volts = self.drive.volts_per_torque * mechanism.torque_scale
        self.time = np.linspace(0.0, seconds, max(200, int(200 * seconds)))

    def plain(self) -> Motion:
        """The obvious motion: one sine a joint about the middle of its range,
        of a fifth of the range."""
        m = self._rest()
        for j in range(self.mechanism.joints):
            m.amplitude[j, 0] = 0.4 * self.half[j]
            m.count[j, 0] = max(1, round(self.seconds / (4.0 + j)))
        return self.within(m)

    def random(self, rng: np.random.Generator, wanted: frozenset[int]) -> Motion:
        """A random motion; joints (0-based) that are not wanted may be left at rest."""
        m = self._rest()
        for j in range(self.mechanism.joints):
            self._place(m, j, rng)
            if j in wanted or rng.random() < 0.6:
                self._swing(m, j, rng)
                if rng.random() < 0.35:
                    self._triangle(m, j, rng)
                if rng.random() < 0.4:
                    self._shake(m, j, rng)
                if rng.random() < 0.2:
                    self._span(m, j, rng)
        return self.within(m)

    def changed(self, motion: Motion, rng: np.random.Generator) -> Motion:
        """A neighbour of a motion."""
        m = deepcopy(motion)
        for j in range(self.mechanism.joints):
            if j > 0 and rng.random() < 0.3:
                continue
            what = rng.integers(8)
            if what == 0:
                m.centre[j] += 0.15 * self.half[j] * rng.normal()
            elif what == 1:
                m.amplitude[j, : EXPERIMENT.motion_harmonics] *= np.exp(0.4 * rng.normal())
            elif what == 2:
                m.phase[j] += 0.5 * rng.normal(size=m.phase.shape[1])
            elif what == 3:
                m.amplitude[j] *= np.exp(0.5 * rng.normal(size=m.amplitude.shape[1]))
            elif what == 4:
                self._swing(m, j, rng)
            elif what == 5:
                self._triangle(m, j, rng)
            elif what == 6:
                self._shake(m, j, rng)
            elif rng.random() < 0.5:
                self._span(m, j, rng)
            else:
                m.triangle[j, 0] *= np.exp(0.7 * rng.normal())
                m.amplitude[j, EXPERIMENT.motion_harmonics :] *= np.exp(0.7 * rng.normal())
        return self.within(m)

    def _rest(self) -> Motion:
        J, K = self.mechanism.joints, EXPERIMENT.motion_harmonics + EXPERIMENT.motion_fast
        return Motion(
            self.seconds,
            self.limits.home,
            np.zeros((J, K)),
            np.ones((J, K)),
            np.zeros((J, K)),
            np.tile([0.0, 1.0, 0.0], (J, 1)),
            np.tile([EXPERIMENT.motion_rest, self.seconds - EXPERIMENT.motion_rest], (J, 1)),
        )

    def _place(self, m: Motion, j: int, rng: np.random.Generator) -> None:
        """A pose: the middle of the range, or somewhere."""
        away = rng.uniform(-1.0, 1.0) if rng.random() < 0.7 else 0.0
        m.centre[j] = self.limits.home[j] + (1.0 - 2.0 * EXPERIMENT.motion_margin) * self.half[j] * away

    def _swing(self, m: Motion, j: int, rng: np.random.Generator) -> None:
        """The Fourier series: its base, how fast it falls off, and its size."""
        base = np.exp(rng.uniform(np.log(1.0 / self.seconds), np.log(max(EXPERIMENT.motion_base, 1.0 / self.seconds))))
        k = np.arange(1, EXPERIMENT.motion_harmonics + 1)
        shape = rng.normal(size=EXPERIMENT.motion_harmonics) / k ** rng.uniform(0.0, 2.0)
        size = self.half[j] * (
            rng.uniform(0.3, 1.0) if rng.random() < 0.5 else np.exp(rng.uniform(np.log(0.02), np.log(0.3)))
        )
        m.count[j, : EXPERIMENT.motion_harmonics] = max(1, round(base * self.seconds)) * k
        m.phase[j, : EXPERIMENT.motion_harmonics] = rng.uniform(0.0, 2.0 * np.pi, EXPERIMENT.motion_harmonics)
        m.amplitude[j, : EXPERIMENT.motion_harmonics] = size * shape / np.abs(shape).sum()

    def _triangle(self, m: Motion, j: int, rng: np.random.Generator) -> None:
        """A slow triangle of a few cycles; half of the time in place of the series."""
        if rng.random() < 0.5:
            m.amplitude[j, : EXPERIMENT.motion_harmonics] *= 0.05
        size = self.half[j] * np.exp(rng.uniform(np.log(0.01), np.log(0.8)))
        m.triangle[j] = size, rng.integers(1, max(2, round(0.6 * self.seconds)) + 1), rng.uniform(0.0, 2.0 * np.pi)

    def _shake(self, m: Motion, j: int, rng: np.random.Generator) -> None:
        """Fast waves that take a part of the nominal friction's voltage each."""
        counts = np.round(rng.uniform(*EXPERIMENT.motion_fast_band, EXPERIMENT.motion_fast) * self.seconds)
        w = 2.0 * np.pi * counts / self.seconds
        inertia = self.drive.motor_inertia[j] + self.mechanism.inertia(self.theta, m.centre[None])[0, j]
        takes = np.hypot(
            self.drive.emf[j] * w + self.drive.volts_per_torque[j] * self.drive.viscous[j] * w,
            self.drive.volts_per_torque[j] * inertia * w * w,
        )
        m.count[j, EXPERIMENT.motion_harmonics :] = counts
        m.phase[j, EXPERIMENT.motion_harmonics :] = rng.uniform(0.0, 2.0 * np.pi, EXPERIMENT.motion_fast)
        m.amplitude[j, EXPERIMENT.motion_harmonics :] = (
            self.volts[j] * np.exp(rng.uniform(np.log(0.05), np.log(2.0), EXPERIMENT.motion_fast)) / takes
        )

    def _span(self, m: Motion, j: int, rng: np.random.Generator) -> None:
        """The joint moves for a part of the record."""
        first, last = np.sort(rng.uniform(0.0, 1.0, 2))
        if last - first < 0.3:
            first, last = 0.0, 1.0
        m.span[j] = EXPERIMENT.motion_rest + np.array([first, last]) * (self.seconds - 2.0 * EXPERIMENT.motion_rest)

    # --------------------------------------------------------------------------------- limits

    def within(self, m: Motion) -> Motion:
        """The motion moved and made smaller until it keeps to the limits."""
        limits = self.limits
        low, high = np.array(limits.position).T
        free = (1.0 - 2.0 * EXPERIMENT.motion_margin) * 2.0 * self.half
        q, qd, _ = m.at(self.time)
        by = np.minimum(
            1.0,
            np.minimum(
                free / np.maximum(np.ptp(q, axis=0), 1e-12), limits.velocity / np.maximum(np.abs(qd).max(axis=0), 1e-12)
            ),
        )
        m = m.shrunk(by, m.centre)
        for _ in range(12):
            q, qd, qdd = m.at(self.time)
            inside = np.clip(
                m.centre,
                low + EXPERIMENT.motion_margin * 2.0 * self.half + m.centre - q.min(axis=0),
                high - EXPERIMENT.motion_margin * 2.0 * self.half + m.centre - q.max(axis=0),
            )
            q, m = q + inside - m.centre, replace(m, centre=inside)
            peak = np.abs(self.mechanism.model_voltage(self.theta, q, qd, qdd)).max(axis=0)
            over = peak / (EXPERIMENT.motion_voltage_share * limits.voltage)
            if (over <= 1.0).all():
                break
            # the torques of a joint come from the others' motion too
            by = np.where(over > 1.0, 0.97 / over, 1.0 / max(1.0, over.max()) ** 0.25)
            m = m.shrunk(by, m.centre)
        return m


# ----------------------------------------------------------------------------------------- voltages


def signals_along(
    mechanism: Mechanism, step: float, motion: Sequence[Floats], voltage: Floats, noise: Floats, coupled: bool
) -> Signals:
    """`Signals` of a motion at even times from 0 on.

    motion : positions, velocities and accelerations (n, J), as voltage; noise (J,) : standard deviation of the velocity
    that the log of such a motion will have; coupled : as for `signals_of`.
    """
    n, drive = len(voltage), mechanism.drive(mechanism.start)
    segment, enable = np.zeros(n, dtype=int), np.ones_like(voltage)
    trajectory = Trajectory(step * np.arange(n, dtype=float), step, segment, voltage, enable, *motion)
    signals = signals_of(mechanism, mechanism.start, trajectory, noise, np.zeros(mechanism.joints), coupled=coupled)
    return replace(signals, torque_per_ampere=drive.resistance / drive.volts_per_torque)


def voltages(mechanism: Mechanism, motion: Motion, time: Floats, noise: Floats) -> Floats:
    """(n, J) voltages [V] that drive the start model along a motion, each held for a step.

    Those of `mechanism.model_voltage`, with the winding's lag, at the middle of each step, and what effects of the
    model take. time (n,) : even times from 0 on; noise as for `signals_along`.
    """
    theta, step = mechanism.start, float(time[1] - time[0])
    drive = mechanism.drive(theta)
    at = motion.at(np.minimum(time + 0.5 * step, motion.seconds))
    volts = mechanism.model_voltage(theta, *at)
    if drive.lag.any():
        rate = np.gradient(mechanism.total_torque(theta, *at), step, axis=0)
        volts = volts + drive.volts_per_torque * drive.lag * rate
    total = volts
    for _ in range(2 if mechanism.effects else 0):  # a dead-band or a delay reads the voltages themselves
        total = volts + known_voltage(mechanism, theta, signals_along(mechanism, step, at, total, noise, True))
    return total
