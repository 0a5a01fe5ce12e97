# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""How well a motion tells two effects apart, before it is made (step 11).

The columns of both effects along the motion are taken off the parameters of the mechanism, whose
priors let them give way a little, as in `evidence`. What is then left of one effect of a usual
size when the other one may take any coefficients, over the noise, is the gain of log evidence that
a record of this motion would have for the one that is there: half of its square, in nats.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import binary_dilation, binary_opening

from puma_sim_core.effects import Effect, Kind
from puma_sim_core.effects.base import SENSING, TRANSMISSION
from puma_sim_core.effects.screening import TORQUE_COLUMN, VOLTAGE_COLUMN, Candidate, Illegal, Signals
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.experiment.excitation import Builder, Motion, signals_of, voltages
from puma_sim_core.identify.settings import EXPERIMENT
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

#: independent numbers a second in that band
NUMBERS = 2.0 * EXPERIMENT.separation_second


@dataclass(frozen=True)
class Suspect:
    """An effect to be excited: its kind and joint (0-based; None for the whole arm)."""

    kind: Kind
    joint: int | None

    @property
    def label(self) -> str:
        """Such as NAME@2."""
        return self.kind.name if self.joint is None else f"{self.kind.name}@{self.joint + 1}"


@dataclass(frozen=True)
class Distance:
    """What is left of one effect, [nat] for a usual one of its grid.

    nats : in the end; raw : before the parameters take what they can; share : greatest share that
    the other effect leaves of what the parameters leave.
    """

    nats: float
    raw: float
    share: float


class Judge:
    """Judges motions by how well they tell suspects apart, or show a single one.

    builder : of the motions; suspects : one or two.
    """

    def __init__(self, builder: Builder, suspects: tuple[Suspect, ...]):
        self.builder, self.suspects = builder, suspects
        self.mechanism, self.limits = builder.mechanism, builder.limits
        self.shaken = any(s.kind.acts in (SENSING, TRANSMISSION) for s in suspects)
        self.noise = velocity_noise(self.mechanism)
        self.step = EXPERIMENT.separation_fine if any(s.kind.fine for s in suspects) else EXPERIMENT.separation_step
        #: directions (of, against) that count; `design` drops those of special cases
        self.directions = [(0, None)] if len(suspects) == 1 else [(0, 1), (1, 0)]

    def planned(self, motion: Motion) -> Signals:
        """Signals of the motion as it is planned."""
        time = self._time(motion)
        return self._seen(*motion.at(time), voltages(self.mechanism, motion, time, self.noise))

    def played(self, motion: Motion, effects=()) -> Signals | None:
        """Signals of what the start model with effects does under the motion's voltages; None
        where it leaves its ranges."""
        time = self._time(motion)
        volts = voltages(self.mechanism, motion, time, self.noise)
        position = play(plant_with(self.mechanism, None, effects), motion, time, volts, EXPERIMENT.separation_fine)
        if position is None or not self.limits.hold(position):
            return None
        return self._seen(*filters.low_pass(position, self.step, EXPERIMENT.separation_first, (0, 1, 2)), volts)

    def _time(self, motion: Motion) -> np.ndarray:
        whole = round(EXPERIMENT.separation_kept / self.step)
        return self.step * np.arange(int(motion.seconds / self.step) // whole * whole + 1)

    def _seen(self, q, qd, qdd, volts) -> Signals:
        held = volts.copy()
        held[1:] = 0.5 * (volts[1:] + volts[:-1])
        return signals_of(self.mechanism, self.step, q, qd, qdd, held, self.noise, self.shaken)

    # ------------------------------------------------------------------------------- scores

    def on_plan(self, motion: Motion, directions=None) -> list[Distance]:
        """Distances of directions, by default all, along the motion as planned."""
        return self._distances(self.planned(motion), directions or self.directions)

    def on_play(self, motion: Motion) -> list[Distance] | None:
        """Distances of the directions along what the machine does if the effect is there: friction
        holds where the plan crawls. None where it leaves its ranges."""
        found = []
        for direction in self.directions:
            signals = self.played(motion, self.usual[direction[0]])
            if signals is None:
                return None
            found += self._distances(signals, [direction])
        return found

    @cached_property
    def usual(self) -> list[tuple[Effect, ...]]:
        """Each suspect with a usual size, to be simulated; empty where none can be made."""
        signals = self.planned(self.builder.plain())
        return [self._usual(suspect, signals) for suspect in self.suspects]

    def _usual(self, suspect: Suspect, signals: Signals) -> tuple[Effect, ...]:
        candidates = self._candidates(suspect, signals)
        middle = len(candidates) // 2
        for n in sorted(range(len(candidates)), key=lambda n: abs(n - middle)):
            c = candidates[n]
            usual = np.where(c.mean != 0.0, c.mean, 0.5 * c.deviation)
            try:
                return (Effect(suspect.kind, None if suspect.joint is None else suspect.joint + 1, c.values(usual)),)
            except (Illegal, ParameterError):
                continue
        return ()

    def shown(self, number: int, motion: Motion) -> bool:
        """Whether a motion has columns of a suspect."""
        return bool(self._candidates(self.suspects[number], self.planned(motion)))

    def columns(self, motion: Motion) -> int:
        """Number of columns of all suspects."""
        signals = self.planned(motion)
        return sum(len(c.columns) for suspect in self.suspects for c in self._candidates(suspect, signals))

    def _candidates(self, suspect: Suspect, signals: Signals) -> list[Candidate]:
        return suspect.kind.screening.candidates(signals, suspect.joint)

    def _distances(self, signals: Signals, directions) -> list[Distance]:
        base = _Parameters(self.mechanism, signals)
        banks = {}
        for number in {n for pair in directions for n in pair if n is not None}:
            candidates = self._candidates(self.suspects[number], signals)
            banks[number] = list(zip(candidates, base.reduced(candidates))) if candidates else []
        return [_distance(base, banks[of], None if against is None else banks[against]) for of, against in directions]


def velocity_noise(mechanism: Mechanism) -> np.ndarray:
    """(J,) standard deviation of velocities [rad/s] by an encoder's counts, past the first filter
    at the servo's rate."""
    if mechanism.joints > 1:
        count = 2.0 * np.pi / (EXPERIMENT.separation_counts * np.abs(mechanism.gear))
    else:
        count = np.array([(high - low) / EXPERIMENT.separation_counts_of_range for low, high in mechanism.ranges])
    f = np.linspace(0.0, 0.5 / SERVO_PERIOD, 2000)
    gain = np.sum((2.0 * np.pi * f * filters.response(f, EXPERIMENT.separation_first)) ** 2) * f[1]
    return count / np.sqrt(12.0) * np.sqrt(2.0 * SERVO_PERIOD * gain)


def plant_with(mechanism: Mechanism, theta, effects):
    """Plant of a mechanism with further effects, without those that it cannot have twice."""
    try:
        return mechanism.plant(theta, effects)
    except ParameterError:
        return mechanism.plant(theta)


def play(plant, motion: Motion, time, volts, max_step: float = SERVO_PERIOD) -> np.ndarray | None:
    """(n, J) measured positions of a plant under voltages, from rest in the motion's pose on; None
    where its state stops being finite."""
    simulator = Simulator(plant, max_step=max_step)
    motors = plant.arm.motors[3 - plant.joints :]
    simulator.reset(tuple(motion.centre), current=tuple(v / motor.resistance for v, motor in zip(volts[0], motors)))
    try:
        return simulator.run(time, volts).position
    except NonFiniteStateError:
        return None


class _Parameters:
    """The parameters' derivatives along a motion, and columns as they are at the kept rows."""

    def __init__(self, mechanism: Mechanism, signals: Signals):
        self.signals = signals
        n, whole = len(signals.time), round(EXPERIMENT.separation_kept / signals.step)
        margin = sum(map(filters.edge, (EXPERIMENT.separation_first, EXPERIMENT.separation_second)))
        first = int(np.ceil(margin / EXPERIMENT.separation_kept)) * whole
        self.kept = np.arange(first, n - first, whole)
        self.moving = ~_resting(signals)[self.kept]
        theta, thin = mechanism.start, slice(None, None, round(EXPERIMENT.separation_coarse / signals.step))
        q, qd, qdd = (a[thin] for a in (signals.position, signals.velocity, signals.acceleration))
        drive, slopes = mechanism.drive(theta), mechanism.drive_jacobian(theta)
        rows = np.arange(first // whole, first // whole + len(self.kept)) * round(
            EXPERIMENT.separation_kept / EXPERIMENT.separation_coarse
        )
        by_torque = mechanism.torque_jacobian(theta, q, qd, qdd)
        torque = mechanism.total_torque(theta, q, qd, qdd)
        out = np.empty((len(rows), signals.joints, len(theta)))
        for j in range(signals.joints):
            k, lag = drive.volts_per_torque[j], drive.lag[j]
            (acting,) = filters.low_pass(
                by_torque[:, j], EXPERIMENT.separation_coarse, EXPERIMENT.separation_second, (0,), lag
            )
            T0, T1 = filters.low_pass(torque[:, j], EXPERIMENT.separation_coarse, EXPERIMENT.separation_second, (0, 1))
            (w,) = filters.low_pass(qd[:, j], EXPERIMENT.separation_coarse, EXPERIMENT.separation_second)
            out[:, j] = k * acting[rows]
            out[:, j] += np.outer((T0 + lag * T1)[rows], slopes.volts_per_torque[j])
            out[:, j] += np.outer(T1[rows], k * slopes.lag[j]) + np.outer(w[rows], slopes.emf[j])
        self.N = self._rows(out * mechanism.deviations)
        self.factor = cho_factor(np.eye(self.N.shape[1]) + _product(self.N, self.N), lower=True)

    def _rows(self, values: np.ndarray) -> np.ndarray:
        """(m, J, p) as (m J, p) in units of the noise, 0 where a joint rests."""
        values = values * (self.moving[:, :, None] / EXPERIMENT.separation_noise)
        # the noise is that of a band; a kept row stands for the time to the next
        weight = np.sqrt(NUMBERS * EXPERIMENT.separation_kept)
        return weight * values.reshape(-1, values.shape[2])

    def reduced(self, candidates: list[Candidate]) -> list[np.ndarray]:
        """(m J, p) columns of each candidate."""
        s = self.signals
        widths = [len(c.columns) for c in candidates]
        out = np.zeros((len(self.kept), s.joints, sum(widths)))
        for unit in (TORQUE_COLUMN, VOLTAGE_COLUMN):
            for j in range(s.joints):
                at, full = [], []
                for first, c in zip(np.cumsum([0, *widths]), candidates):
                    if c.unit == unit:
                        at += [first + n for n, column in enumerate(c.columns) if j in column]
                        full += [column[j] for column in c.columns if j in column]
                if not full:
                    continue
                torque = unit == TORQUE_COLUMN
                (past,) = filters.low_pass(
                    np.stack(full, axis=1), s.step, EXPERIMENT.separation_second, (0,), s.lag[j] if torque else 0.0
                )
                out[:, j, at] = past[self.kept] * (s.volts_per_torque[j] if torque else 1.0)
        return np.split(self._rows(out), np.cumsum(widths)[:-1], axis=1)

    def gram(self, X: np.ndarray) -> np.ndarray:
        """X'PX of columns, P off the parameters."""
        NX = _product(self.N, X)
        return _product(X, X) - NX.T @ cho_solve(self.factor, NX)


def _product(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """A'B, in blocks so small that no library spreads them over threads: that costs more than it
    gains here, and lets the last bits depend on the number of cores."""
    out = np.zeros((A.shape[1], B.shape[1]))
    for first in range(0, len(A), EXPERIMENT.separation_block):
        out += A[first : first + EXPERIMENT.separation_block].T @ B[first : first + EXPERIMENT.separation_block]
    return out


def _resting(signals: Signals) -> np.ndarray:
    """(n, J) whether a joint rests."""
    reach, out = int(EXPERIMENT.separation_rest_time / signals.step), np.zeros(signals.velocity.shape, dtype=bool)
    for j in range(signals.joints):
        speed = np.abs(signals.velocity[:, j])
        slow = speed < max(EXPERIMENT.separation_rest_noise * signals.velocity_noise[j], 2e-3 * speed.max())
        long = binary_opening(slow, np.ones(reach))
        out[:, j] = binary_dilation(long, np.ones(2 * int(0.5 / (EXPERIMENT.separation_second * signals.step)) + 1))
    return out


def _distance(base: _Parameters, of, against) -> Distance:
    """What the motion leaves of an effect when another one takes what it can."""
    if not of:
        return Distance(0.0, 0.0, 0.0)
    widths = [X.shape[1] for _, X in of]
    stacked = [X for _, X in of] + ([] if against is None else [X for _, X in against])
    Z = np.concatenate(stacked, axis=1)
    G = base.gram(Z)
    raw = np.einsum("ij,ij->j", Z, Z)
    others, at = [], sum(widths)
    for _, X in against or ():
        others.append(slice(at, at + X.shape[1]))
        at += X.shape[1]
    nats, powers, shares, at = [], [], [], 0
    for (candidate, _), p in zip(of, widths):
        own = slice(at, at + p)
        at += p
        # mean square of coefficients of a usual effect
        M = np.outer(candidate.mean, candidate.mean) + np.diag(candidate.deviation**2)
        left = free = float((G[own, own] * M).sum())
        for other in others:
            inner = G[other, other]
            inner = inner + np.diag(1e-9 * (np.diag(inner) + raw[other]) + 1e-300)
            cross = np.linalg.solve(inner, G[other, own])
            left = min(left, float(((G[own, own] - G[own, other] @ cross) * M).sum()))
        nats.append(0.5 * max(left, 0.0))
        powers.append(0.5 * float(raw[own] @ np.diag(M)))
        shares.append(max(left, 0.0) / max(free, 1e-300))
    return Distance(_usual(nats), _usual(powers), max(shares))


def _usual(nats: list[float]) -> float:
    """A usual one of gains over a grid that may span decades."""
    return float(np.expm1(np.mean(np.log1p(nats))))
