# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How well a motion tells effects apart, before it is made.

The parameters of the mechanism, with their priors, are projected out of the columns of both effects along the motion,
as in `evidence`. What is then left of one effect of a usual size when the other one may take any coefficients, over the
noise, is the gain of log evidence that a record of this motion would have for the one that is there: half of its
square, in nats.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, permutations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from puma_sim_core.effects import Effect, Kind
from puma_sim_core.effects.base import SENSING, TRANSMISSION
from puma_sim_core.effects.screening import TORQUE_COLUMN, VOLTAGE_COLUMN, Candidate, Illegal, Signals
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.sampling import resting
from puma_sim_core.identify.experiment.excitation import Builder, Motion, signals_along, voltages
from puma_sim_core.identify.screening.hypotheses import candidates
from puma_sim_core.identify.settings import DATA, EXPERIMENT
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

#: independent numbers a second in the second filter's band
NUMBERS = 2.0 * DATA.sampling_second_cutoff
#: (number of a suspect, that of the one it is told from, None: from the parameters alone)
Direction = tuple[int, int | None]
#: candidates of a suspect with their columns (m J, p)
Columns = Sequence[tuple[Candidate, Floats]]


@dataclass(frozen=True)
class Suspect:
    """An effect to be excited, on a joint (1-based; None for the whole arm)."""

    kind: Kind
    joint: int | None

    @property
    def label(self) -> str:
        """Such as NAME@2."""
        return self.kind.name if self.joint is None else f"{self.kind.name}@{self.joint}"


@dataclass(frozen=True)
class Distance:
    """What is left of one effect, [nat] for a usual one of its grid.

    nats : in the end; raw : before the parameters are projected out; share : greatest share that the other effect
    leaves of what the parameters leave.
    """

    nats: float
    raw: float
    share: float


class Judge:
    """Judges motions by how well they tell suspects apart, or show a single one. suspects : one or
    several, each of which is to be told from each other one."""

    def __init__(self, builder: Builder, suspects: tuple[Suspect, ...]):
        self.builder, self.suspects = builder, suspects
        self.mechanism, self.limits = builder.mechanism, builder.limits
        self.coupled = any(s.kind.acts in (SENSING, TRANSMISSION) for s in suspects)
        self.noise = velocity_noise(self.mechanism)
        self.step = EXPERIMENT.separation_fine if any(s.kind.fine for s in suspects) else EXPERIMENT.separation_step
        #: directions that count; `design` drops those of special cases
        self.directions: list[Direction] = (
            [(0, None)] if len(suspects) == 1 else list(permutations(range(len(suspects)), 2))
        )

    def planned(self, motion: Motion) -> Signals:
        """Signals of the motion as it is planned."""
        time = self._time(motion)
        return self._signals(motion.at(time), voltages(self.mechanism, motion, time, self.noise))

    def simulated(self, motion: Motion, effects: Iterable[Effect] = ()) -> Signals | None:
        """Signals of what the start model with effects does under the motion's voltages; None where it leaves its
        ranges."""
        time = self._time(motion)
        volts = voltages(self.mechanism, motion, time, self.noise)
        position = simulate(plant_with(self.mechanism, None, effects), motion, time, volts, EXPERIMENT.separation_fine)
        if position is None or not self.limits.hold(position):
            return None
        return self._signals(filters.low_pass(position, self.step, DATA.sampling_first_cutoff, (0, 1, 2)), volts)

    def _time(self, motion: Motion) -> Floats:
        whole = round(EXPERIMENT.separation_kept / self.step)
        return self.step * np.arange(int(motion.seconds / self.step) // whole * whole + 1, dtype=float)

    def _signals(self, motion: Sequence[Floats], volts: Floats) -> Signals:
        mean = volts.copy()
        mean[1:] = 0.5 * (volts[1:] + volts[:-1])
        return signals_along(self.mechanism, self.step, motion, mean, self.noise, self.coupled)

    # ------------------------------------------------------------------------------- scores

    def on_plan(self, motion: Motion, directions: Sequence[Direction] = ()) -> list[Distance]:
        """Distances of directions, by default all, along the motion as planned."""
        return self._distances(self.planned(motion), directions or self.directions)

    def on_simulation(self, motion: Motion) -> list[Distance] | None:
        """Distances of the directions along what the machine does if the effect is there: friction holds where the plan
        creeps. None where it leaves its ranges."""
        found = []
        for number, own in groupby(self.directions, key=lambda direction: direction[0]):
            signals = self.simulated(motion, self.usual[number])
            if signals is None:
                return None
            found += self._distances(signals, list(own))
        return found

    @cached_property
    def usual(self) -> list[tuple[Effect, ...]]:
        """Each suspect with a usual size, to be simulated; empty where none can be made."""
        signals = self.planned(self.builder.plain())
        return [_usual_effect(suspect, candidates(suspect.kind, suspect.joint, signals)) for suspect in self.suspects]

    def columns(self, motion: Motion) -> list[int]:
        """Number of columns of each suspect along a motion."""
        signals = self.planned(motion)
        return [sum(len(c.columns) for c in candidates(s.kind, s.joint, signals)) for s in self.suspects]

    def _distances(self, signals: Signals, directions: Sequence[Direction]) -> list[Distance]:
        base = Parameters(self.mechanism, signals)
        banks: dict[int, Columns] = {}
        for number in {n for pair in directions for n in pair if n is not None}:
            found = candidates(self.suspects[number].kind, self.suspects[number].joint, signals)
            banks[number] = list(zip(found, base.reduced(found))) if found else []
        return [_distance(base, banks[of], () if against is None else banks[against]) for of, against in directions]


def _usual_effect(suspect: Suspect, found: Sequence[Candidate]) -> tuple[Effect, ...]:
    """An effect by the candidate nearest to the middle of its grid that is legal, none without any."""
    middle = len(found) // 2
    for n in sorted(range(len(found)), key=lambda n: abs(n - middle)):
        c = found[n]
        try:
            return (Effect(suspect.kind, suspect.joint, c.values(np.where(c.mean != 0.0, c.mean, 0.5 * c.deviation))),)
        except (Illegal, ParameterError):
            continue
    return ()


def velocity_noise(mechanism: Mechanism) -> Floats:
    """(J,) standard deviation of velocities [rad/s] by an encoder's counts, past the first filter at the servo's
    rate."""
    if mechanism.joints > 1:
        count = 2.0 * np.pi / (EXPERIMENT.separation_counts * np.abs(mechanism.gear))
    else:
        count = np.array([(high - low) / EXPERIMENT.separation_counts_of_range for low, high in mechanism.ranges])
    f = np.linspace(0.0, 0.5 / SERVO_PERIOD, 2000)
    gain = np.sum((2.0 * np.pi * f * filters.response(f, DATA.sampling_first_cutoff)) ** 2) * f[1]
    return count / np.sqrt(12.0) * np.sqrt(2.0 * SERVO_PERIOD * gain)


def plant_with(mechanism: Mechanism, theta: Floats | None, effects: Iterable[Effect]) -> Plant:
    """Plant of a mechanism with further effects, without those that it cannot have twice."""
    try:
        return mechanism.plant(theta, effects)
    except ParameterError:
        return mechanism.plant(theta)


def simulate(
    plant: Plant, motion: Motion, time: Floats, volts: Floats, max_step: float = SERVO_PERIOD
) -> Floats | None:
    """(n, J) measured positions of a plant under voltages, from rest in the motion's pose on; None
    where its state stops being finite."""
    simulator = Simulator(plant, max_step=max_step)
    motors = [plant.arm.motors[axis] for axis in plant.axes]
    simulator.reset(tuple(motion.centre), current=tuple(v / motor.resistance for v, motor in zip(volts[0], motors)))
    try:
        return simulator.run(time, volts).position
    except NonFiniteStateError:
        return None


class Parameters:
    """The parameters' derivatives along a motion, and columns as they are at the kept rows."""

    def __init__(self, mechanism: Mechanism, signals: Signals):
        self.signals = signals
        n, whole = len(signals.time), round(EXPERIMENT.separation_kept / signals.step)
        margin = sum(map(filters.edge, (DATA.sampling_first_cutoff, DATA.sampling_second_cutoff)))
        first = int(np.ceil(margin / EXPERIMENT.separation_kept))
        self.kept = np.arange(first * whole, n - first * whole, whole)
        rests = resting(
            signals.velocity, signals.velocity_noise, signals.step, DATA.sampling_second_cutoff, [slice(0, n)]
        )
        self.moving = ~rests[self.kept]
        theta, step, cutoff = mechanism.start, EXPERIMENT.separation_coarse, DATA.sampling_second_cutoff
        thin = slice(None, None, round(step / signals.step))
        q, qd, qdd = (a[thin] for a in (signals.position, signals.velocity, signals.acceleration))
        drive, slopes = mechanism.drive(theta), mechanism.drive_jacobian(theta)
        rows = np.arange(first, first + len(self.kept)) * round(EXPERIMENT.separation_kept / step)
        by_torque = mechanism.torque_jacobian(theta, q, qd, qdd)
        torque = mechanism.total_torque(theta, q, qd, qdd)
        out = np.empty((len(rows), signals.joints, len(theta)))
        for j in range(signals.joints):
            k, lag = drive.volts_per_torque[j], drive.lag[j]
            (acting,) = filters.low_pass(by_torque[:, j], step, cutoff, (0,), lag)
            T0, T1 = filters.low_pass(torque[:, j], step, cutoff, (0, 1))
            (w,) = filters.low_pass(qd[:, j], step, cutoff)
            out[:, j] = k * acting[rows]
            out[:, j] += np.outer((T0 + lag * T1)[rows], slopes.volts_per_torque[j])
            out[:, j] += np.outer(T1[rows], k * slopes.lag[j]) + np.outer(w[rows], slopes.emf[j])
        self.N = self._rows(out * mechanism.deviations)
        self.factor = cho_factor(np.eye(self.N.shape[1]) + _product(self.N, self.N), lower=True)

    def _rows(self, values: Floats) -> Floats:
        """(m, J, p) as (m J, p) in units of the noise, 0 where a joint rests."""
        values = values * (self.moving[:, :, None] / EXPERIMENT.separation_noise)
        # the noise is that of a band; a kept row stands for the time to the next
        weight = np.sqrt(NUMBERS * EXPERIMENT.separation_kept)
        return weight * values.reshape(-1, values.shape[2])

    def reduced(self, found: Sequence[Candidate]) -> list[Floats]:
        """(m J, p) columns of each candidate."""
        s = self.signals
        starts = np.cumsum([0, *(len(c.columns) for c in found)]).tolist()
        out = np.zeros((len(self.kept), s.joints, starts[-1]))
        for unit in (TORQUE_COLUMN, VOLTAGE_COLUMN):
            for j in range(s.joints):
                own = [
                    (first + n, column[j])
                    for first, c in zip(starts, found)
                    if c.unit == unit
                    for n, column in enumerate(c.columns)
                    if j in column
                ]
                if own:
                    at, full = zip(*own)
                    lag, factor = (s.lag[j], s.volts_per_torque[j]) if unit == TORQUE_COLUMN else (0.0, 1.0)
                    (past,) = filters.low_pass(np.stack(full, axis=1), s.step, DATA.sampling_second_cutoff, (0,), lag)
                    out[:, j, list(at)] = past[self.kept] * factor
        return np.split(self._rows(out), starts[1:-1], axis=1)

    def gram(self, X: Floats) -> Floats:
        """X'PX of columns, P projects the parameters out."""
        NX = _product(self.N, X)
        return _product(X, X) - NX.T @ cho_solve(self.factor, NX)


def _product(A: Floats, B: Floats) -> Floats:
    """A'B, in blocks so small that no library spreads them over threads: that takes longer here, and lets the last bits
    depend on the number of cores."""
    out = np.zeros((A.shape[1], B.shape[1]))
    for first in range(0, len(A), EXPERIMENT.separation_block):
        out += A[first : first + EXPERIMENT.separation_block].T @ B[first : first + EXPERIMENT.separation_block]
    return out


def _distance(base: Parameters, of: Columns, against: Columns) -> Distance:
    """What the motion leaves of an effect when another one takes what it can."""
    if not of:
        return Distance(0.0, 0.0, 0.0)
    stacked = [X for _, X in (*of, *against)]
    Z = np.concatenate(stacked, axis=1)
    G = base.gram(Z)
    raw = np.einsum("ij,ij->j", Z, Z)
    ends = np.cumsum([X.shape[1] for X in stacked]).tolist()
    places = [slice(end - X.shape[1], end) for end, X in zip(ends, stacked)]
    nats, powers, shares = [], [], []
    for (candidate, _), own in zip(of, places):
        # mean square of coefficients of a usual effect
        M = np.outer(candidate.mean, candidate.mean) + np.diag(candidate.deviation**2)
        left = free = float((G[own, own] * M).sum())
        for other in places[len(of) :]:
            inner = G[other, other] + np.diag(1e-9 * (np.diag(G[other, other]) + raw[other]) + 1e-300)
            cross = np.linalg.solve(inner, G[other, own])
            left = min(left, float(((G[own, own] - G[own, other] @ cross) * M).sum()))
        nats.append(0.5 * max(left, 0.0))
        powers.append(0.5 * float(raw[own] @ np.diag(M)))
        shares.append(max(left, 0.0) / max(free, 1e-300))
    return Distance(_usual(nats), _usual(powers), max(shares))


def _usual(nats: Sequence[float]) -> float:
    """A usual one of gains over a grid that may span decades."""
    return float(np.expm1(np.mean(np.log1p(nats))))
