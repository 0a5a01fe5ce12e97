# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Logs led along by a model as an observer: innovations, what they say in volts, and their noise.

Of a true model the innovations are white and independent of the past, with feedback and without
(Ljung, System Identification, chapter 13). `prediction` fits models to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft
from scipy.linalg import expm, solve_discrete_are
from scipy.signal import fftconvolve

from puma_sim_core.identify.data import filters
from puma_sim_core.identify.noise.weighting import Weighting
from puma_sim_core.identify.remembered import Remembered
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.tracking import Tracked, innovations
from puma_sim_core.simulation.windows import driven_current, local_motion, true_start

#: time at the start of a log that the observer is given to settle [s]
SETTLING = 0.12
#: greatest step of integration [s]: a row of 1 ms is one step. RK4 is stable up to 8.4 ms, and its
#: error at 1 ms is far below any sensor's noise
_STEP = 1.2e-3
#: explicit steps of integration stay below so many time constants of a winding
_STABLE = 2.0
#: least noise of the voltage [V] and greatest share of the gain's bandwidth
_LEAST_VOLTS = 2e-3
#: noise that a row's voltage has at least, in volts of a middling friction torque: a log without
#: any must not make the last digits of a fit, or of an integration, into effects
_LEAST_ROW = 2e-2
#: least noise of a position, as a share of the deviation of its prediction
_LEAST_SENSED = 0.3
#: models whose derivatives are kept: each is asked for again with other weightings, by the tidying
#: of a stage and the start of the next, by the folds, and by the free curves
_REMEMBERED = 3
#: poses at which inertia is looked at, and the least of it as a share of that at the start
_POSES, _LEAST_INERTIA = 64, 0.1


@dataclass(frozen=True)
class Stretch:
    """One log for the observer: time (n,), voltage, position, enable (n, J) or None, the start
    row's motion, and which of the n - 1 innovations count for each joint (n - 1, J)."""

    time: np.ndarray
    voltage: np.ndarray
    position: np.ndarray
    enable: np.ndarray | None
    motion: tuple[np.ndarray, np.ndarray, np.ndarray]
    first: int
    fit: np.ndarray
    held: np.ndarray

    def keeping(self, held) -> Stretch:
        """The same log with the rows kept back that a function of times (n,) [s] says."""
        usable, away = self.fit | self.held, held(self.time[1:])[:, None]
        return replace(self, fit=usable & ~away, held=usable & away)


class Predictor:
    """Logs with a mechanism, ready to be predicted by plants.

    logs : `ingest.Log` each; held : for each log a function of times (n,) -> True where kept
    back; volts (J,): standard deviation of the voltage noise of one row, and noise (J,) that of a
    position: they set the gain of the observer.
    """

    def __init__(self, logs: Sequence, mechanism, held, volts, noise):
        self.mechanism = mechanism
        #: derivatives about the models that were looked at last
        self.derived = Remembered(_REMEMBERED)
        self.stretches = [self._stretch(log, kept) for log, kept in zip(logs, held)]
        step = float(np.median(np.concatenate([np.diff(s.time) for s in self.stretches])))
        self.step = step
        #: innovation of each joint after a volt that the model lacks in one row [rad/V]
        self.responses: list[np.ndarray] = []
        #: standard deviation of an innovation [rad] when the model is true
        self.spread: list[float] = []
        #: transition, what a volt in a row adds, and gain, of each joint by itself
        self.linear: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        #: noise of a row's voltage that the gain is made for [V]
        self.volts = np.maximum(volts, _LEAST_VOLTS)
        self.gain = self._gain(self.volts, np.maximum(noise, 1e-9), step)
        low, high = np.array([[max(a, -4.0), min(b, 4.0)] for a, b in mechanism.ranges]).T
        self.poses = low + (high - low) * np.random.default_rng(0).random((_POSES, len(low)))
        self.inertia_at_start = self._least_inertia(mechanism.start)
        #: noise of a row's voltage that there is at least [V]
        self.least = _LEAST_ROW * (
            mechanism.drive(mechanism.start).volts_per_torque * np.asarray(mechanism.torque_scale, dtype=float)
        )

    def feasible(self, theta: np.ndarray) -> bool:
        """Whether the inertia matrix is positive definite throughout the ranges of the joints: what
        is missing may pull parameters to where it is not, and no such machine moves."""
        return self._least_inertia(theta) > _LEAST_INERTIA * self.inertia_at_start

    def _least_inertia(self, theta) -> float:
        """Least eigenvalue of the inertia matrix with the motors' [kg m^2 or kg]."""
        D = self.mechanism.inertia_matrix(theta, self.poses)
        D = D + np.diag(self.mechanism.drive(theta).motor_inertia)
        return float(np.linalg.eigvalsh(D).min())

    def _stretch(self, log, held) -> Stretch:
        first = int(np.searchsorted(log.time, log.time[0] + 0.03))
        velocity, acceleration = local_motion(log.time, log.position, first)
        # between quanta the slope is known better than the position
        near = slice(max(0, first - 12), first + 13)
        x = log.time[near] - log.time[first]
        position = np.polynomial.polynomial.polyfit(x, log.position[near], 2)[0]
        enable = (
            None
            if log.enable is None
            else np.broadcast_to(np.reshape(log.enable, (len(log.time), -1)), log.voltage.shape).astype(float)
        )
        if enable is not None and enable.all():
            enable = None
        time = log.time[first:]
        counts = time[1:] > log.time[0] + SETTLING + 0.03
        usable = np.repeat(counts[:, None], log.position.shape[1], axis=1)
        return Stretch(
            time,
            np.ascontiguousarray(log.voltage[first:]),
            np.ascontiguousarray(log.position[first:]),
            None if enable is None else enable[first:],
            (position, velocity, acceleration),
            first,
            usable,
            np.zeros_like(usable),
        ).keeping(held)

    def _gain(self, volts, noise, step) -> np.ndarray:
        """(J, 3) steady Kalman gain of each joint by itself, its inertia at its mean."""
        m = self.mechanism
        position = np.vstack([s.position for s in self.stretches])[::50]
        drive = m.drive(m.start)
        inertia = m.inertia(m.start, position).mean(axis=0) + drive.motor_inertia
        gains = []
        for j in range(m.joints):
            k, lag, emf = drive.volts_per_torque[j], drive.lag[j], drive.emf[j]
            M, H = inertia[j], drive.viscous[j]
            # in units of torque per volt the current is i' = (V - emf w - i') / lag, torque i' / k
            if lag > 0.0:
                A = np.array([[0.0, 1.0, 0.0], [0.0, -H / M, 1.0 / (k * M)], [0.0, -emf / lag, -1.0 / lag]])
                B = np.array([[0.0], [0.0], [1.0 / lag]])
            else:
                A = np.array([[0.0, 1.0], [0.0, -(H + emf / k) / M]])
                B = np.array([[0.0], [1.0 / (k * M)]])
            n = len(A)
            block = np.zeros((n + 1, n + 1))
            block[:n, :n], block[:n, n:] = A * step, B * step
            block = expm(block)
            F, G = block[:n, :n], block[:n, n:]
            C = np.zeros((1, n))
            C[0, 0] = 1.0
            Q = G @ G.T * volts[j] ** 2 + np.diag([1e-18, 1e-12, 1e-12][:n])
            R = noise[j] ** 2
            P = solve_discrete_are(F.T, C.T, Q, np.array([[R]]))
            if _LEAST_SENSED**2 * P[0, 0] > R:
                # positions without noise would be followed so closely that the error of the start
                # rings for a second
                R = _LEAST_SENSED**2 * P[0, 0]
                P = solve_discrete_are(F.T, C.T, Q, np.array([[R]]))
            gain = (P @ C.T / (P[0, 0] + R)).ravel()
            current = gain[2] / self._resistance(j) if n == 3 else 0.0
            gains.append([gain[0], gain[1], current])
            self.responses.append(_response(F, G, C, gain))
            self.linear.append((F, G[:, 0], gain))
            self.spread.append(float(np.sqrt(P[0, 0] + R)))
        return np.array(gains)

    def _resistance(self, joint: int) -> float:
        arm = getattr(self.mechanism.plant(self.mechanism.start), "arm", None)
        motors = getattr(arm, "motors", ())
        return float(motors[joint].resistance) if len(motors) > joint else 1.0

    def errors(self, plant: Plant) -> np.ndarray:
        """(N, J) innovations of all logs below each other; raises NonFiniteStateError."""
        return np.concatenate([part.innovation for part in self.tracked(plant)])

    def tracked(self, plant: Plant, corrected=None) -> list[Tracked]:
        """What the observer makes of each log; raises NonFiniteStateError.

        corrected : for each log whether a row's innovation moves the state (n - 1,), None: always.
        """
        parts = []
        for number, s in enumerate(self.stretches):
            simulator = Simulator(plant, max_step=stable_step(plant, _STEP))
            position, velocity = true_start(plant, s.motion[0], s.motion[1], s.motion[2])
            current = driven_current(plant, s.time, s.voltage, 0, velocity, s.motion[2])
            if s.enable is not None:
                current = np.where(s.enable[0] != 0.0, current, 0.0)
            simulator.reset(position, velocity, current, time=float(s.time[0]))
            parts.append(
                innovations(
                    simulator,
                    s.time,
                    s.voltage,
                    s.position,
                    self.gain,
                    s.enable,
                    None if corrected is None else corrected[number],
                )
            )
        return parts

    def in_volts(self, errors: np.ndarray, cutoff: float) -> np.ndarray:
        """(N, J) voltages [V] that the model lacks by its innovations (N, J), up to `cutoff` [Hz].

        What an observer made of them is undone frequency by frequency.
        """
        out, start = np.empty_like(errors), 0
        for s in self.stretches:
            n = len(s.time) - 1
            for j in range(errors.shape[1]):
                out[start : start + n, j] = self._undone(errors[start : start + n, j], j, cutoff)
            start += n
        return out

    def _undone(self, errors, joint, cutoff):
        taps = self.responses[joint]
        size = fft.next_fast_len(len(errors) + len(taps) + int(2.0 / (cutoff * self.step)), real=True)
        f = fft.rfftfreq(size, self.step)
        ratio = filters.response(f, cutoff) / fft.rfft(taps, size)
        return fft.irfft(fft.rfft(errors, size) * ratio, size)[: len(errors)]

    def floor_in_volts(self, cutoff: float) -> np.ndarray:
        """(J,) `in_volts` root mean square [V] of a true model with this noise."""
        f = np.linspace(0.0, 0.5 / self.step, 4097)
        out = []
        for taps, spread in zip(self.responses, self.spread):
            turn = np.exp(-2j * np.pi * np.outer(f, np.arange(len(taps))) * self.step)
            ratio = np.abs(filters.response(f, cutoff) / (turn @ taps)) ** 2
            out.append(np.sqrt(2.0 * self.step * ratio.sum() * f[1]) * spread)
        return np.array(out)

    def open_loop_variance(self, volts, noise, rows: int) -> np.ndarray:
        """(rows, J) variance [rad^2 or m^2] of the errors of a true model's positions, so many rows
        after it was last corrected: noise (J,) of a row's voltage [V] and of a position."""
        out = np.empty((rows, len(self.linear)))
        for j, (F, G, gain) in enumerate(self.linear):
            kept = np.eye(len(F))
            kept[:, 0] -= gain
            driven = volts[j] ** 2 * np.outer(G, G)
            seen = noise[j] ** 2 * np.outer(gain, gain)
            P = kept @ _settled(F @ kept, F @ seen @ F.T + driven) @ kept.T + seen
            for r in range(rows):
                P = F @ P @ F.T + driven
                out[r, j] = P[0, 0] + noise[j] ** 2
        return out

    def noise_behind(self, variance, noise) -> tuple[np.ndarray, np.ndarray]:
        """(J,) noise of a row's voltage [V] and of a position that give the innovations of a true
        model a variance (J,); noise (J,): what a position's may at most be."""
        one, none = np.ones(len(self.linear)), np.zeros(len(self.linear))
        driven, seen = (self.open_loop_variance(*pair, 1)[0] for pair in ((one, none), (none, one)))
        sensed = np.minimum(noise**2, variance / seen)
        return np.sqrt(np.maximum(variance - seen * sensed, 0.0) / driven), np.sqrt(sensed)

    def keeping(self, held) -> Predictor:
        """The same logs with other rows kept back; derivatives are remembered for both. held: as
        for the constructor."""
        other = copy(self)
        other.stretches = [s.keeping(each) for s, each in zip(self.stretches, held)]
        return other

    def less(self, volts: np.ndarray) -> Predictor:
        """The same logs with voltages (N, J) [V] taken from those that the plant gets."""
        other, start = copy(self), 0
        other.derived = Remembered(_REMEMBERED)
        other.stretches = []
        for s in self.stretches:
            voltage = s.voltage.copy()
            voltage[:-1] -= volts[start : start + len(voltage) - 1]
            other.stretches.append(replace(s, voltage=voltage))
            start += len(voltage) - 1
        return other

    def shown(self, volts: np.ndarray) -> np.ndarray:
        """(N, J) innovations that voltages (N, J) [V] which the plant does not know of would make,
        each at its own joint alone."""
        out, start = np.empty_like(volts), 0
        for n in self.lengths:
            for j, taps in enumerate(self.responses):
                out[start : start + n, j] = fftconvolve(volts[start : start + n, j], taps)[:n]
            start += n
        return out

    @property
    def lengths(self) -> tuple[int, ...]:
        """Innovations of each log."""
        return tuple(len(s.time) - 1 for s in self.stretches)

    @property
    def fit_rows(self) -> np.ndarray:
        """(N, J) whether an innovation may be used to fit."""
        return np.concatenate([s.fit for s in self.stretches])

    @property
    def held_rows(self) -> np.ndarray:
        """(N, J) whether an innovation is kept back."""
        return np.concatenate([s.held for s in self.stretches])

    def white_weighting(self, errors: np.ndarray) -> Weighting:
        """No filter, and a scale from row to row: what lasts, such as an effect that is missing,
        does not count as noise."""
        J, rows = errors.shape[1], self.fit_rows
        filters, scale = np.ones((J, 1)), np.ones(J)
        for j in range(J):
            both = rows[1:, j] & rows[:-1, j]
            change = np.diff(errors[:, j])[both]
            scale[j] = 1.4826 * np.median(np.abs(change)) / np.sqrt(2.0) if len(change) else 1.0
            scale[j] = max(
                scale[j],
                0.3 * float(np.std(change)) / np.sqrt(2.0),
                self.least[j] * float(np.linalg.norm(self.responses[j])),
                1e-15,
            )
        return Weighting(filters, scale, self.lengths)


def _response(F, G, C, gain) -> np.ndarray:
    """Innovations (k,) of an observer after one row of a voltage that it does not know of."""
    kept = F @ (np.eye(len(F)) - gain[:, None] @ C)
    x, out = -G[:, 0], []
    greatest = 0.0
    while len(out) < 4000:
        out.append(float(C[0] @ x))
        greatest = max(greatest, abs(out[-1]))
        if len(out) > 5 and abs(out[-1]) < 1e-4 * greatest and abs(x).max() < 1e2:
            break
        x = kept @ x
    return np.array(out)


def _settled(A, Q) -> np.ndarray:
    """P = A P A' + Q of a stable A, by doubling (Smith 1968, SIAM J. Appl. Math. 16:198): a log
    without noise makes the linear equations for P too ill-conditioned to be solved."""
    while np.abs(A).max() > 1e-12:
        A, Q = A @ A, Q + A @ Q @ A.T
    return Q


def stable_step(plant: Plant, at_most: float) -> float:
    """Step of integration [s] at which a plant's windings are stable: a fit may make them quick."""
    lags = [m.inductance / m.resistance for m in plant.arm.motors[3 - plant.joints :] if m.inductance > 0.0]
    return min([at_most, *(_STABLE * lag for lag in lags)])
