# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Kalman predictor of logs by a model: innovations, what they are in volts, and their noise.

The innovations of a true model are white and independent of the past, with feedback and without (Ljung, System
Identification, chapter 13). `prediction` fits models to them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import fft
from scipy.linalg import expm, solve_discrete_are

from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.identify.arrays import Bools, Floats, log_rows
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import changing
from puma_sim_core.identify.fitting.steps import followed_rate, parts_of_steps, stable_step
from puma_sim_core.identify.noise.weighting import Weighting, folded_response
from puma_sim_core.identify.remembered import Remembered
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.tracking import Tracked, innovations
from puma_sim_core.simulation.windows import driven_current, local_motion, true_start

#: which rows of a log are of the validation set: times (n,) [s] -> (n,)
RowChoice = Callable[[Floats], Bools]


@dataclass(frozen=True)
class Stretch:
    """One log for the predictor: time (n,) [s], voltage [V], position [rad or m], enable (n, J) or None, the start
    row's motion, which of the n - 1 innovations are fitted to and are of the validation set, and which are of readings
    that change (n - 1, J)."""

    time: Floats
    voltage: Floats
    position: Floats
    enable: Floats | None
    motion: tuple[Floats, Floats, Floats]
    fit: Bools
    validation: Bools
    changing: Bools

    @cached_property
    def row(self) -> float:
        """Time between rows [s], the median."""
        return float(np.median(np.diff(self.time)))

    def validated_at(self, chosen: RowChoice) -> Stretch:
        """The same log with another validation set."""
        usable, away = self.fit | self.validation, chosen(self.time[1:])[:, None]
        return replace(self, fit=usable & ~away, validation=usable & away)


class Predictor:
    """Logs with a mechanism, ready to be predicted by plants.

    validation : for each log which of its rows are of the validation set; noise (J,) : standard deviation of the noise
    of a position [rad or m]; volts (J,) : of that of a row's voltage [V] that the gain is made for, None: the least
    with which the predictor forgets an error within the settling time, and a share of the friction scale. What is no
    white noise of these two is for the weighting of the innovations; expected (J,) : the noise of a row's voltage [V]
    as the filtered motion shows it.

    Attributes for each joint: gain (J, 3) of position [1], velocity [1/s] and current [A/rad] for an innovation;
    responses: innovations (k,) [rad/V] after a volt in one row that the model lacks; spread: standard deviation of an
    innovation [rad] of a true model; linear: transition, what a volt adds, and gain of the joint by itself; least (J,):
    least noise of a row's voltage [V].
    """

    def __init__(
        self,
        logs: Sequence[Log],
        mechanism: Mechanism,
        validation: Sequence[RowChoice],
        volts: Floats | None,
        noise: Floats,
        expected: Floats | None = None,
    ):
        self.mechanism = mechanism
        #: derivatives about the models that were looked at last
        self.derived = Remembered(FITTING.cached_models)
        #: innovations of the models that were run last
        self.remembered = Remembered(FITTING.cached_runs)
        self.stretches = [self._stretch(log, chosen) for log, chosen in zip(logs, validation)]
        self.step = float(np.median(np.concatenate([np.diff(s.time) for s in self.stretches])))
        self.responses: list[Floats] = []
        self.spread: list[float] = []
        self.linear: list[tuple[Floats, Floats, Floats]] = []
        #: noise of a position [rad or m]
        self.noise = noise = np.maximum(noise, FITTING.least_position_noise)
        models = self._joint_models()
        scale = mechanism.drive(mechanism.start).volts_per_torque * np.asarray(mechanism.torque_scale, dtype=float)
        if volts is None:
            settling = [_least_volts(model, r, self.step) for model, r in zip(models, noise.tolist())]
            volts = np.maximum(settling, FITTING.least_gain_noise * scale)
        #: noise of a row's voltage that the gain is made for [V]
        self.volts = np.maximum(volts, FITTING.least_voltage_noise)
        self.expected = self.volts if expected is None else expected
        self.gain = self._gain(models, noise)
        far = FITTING.farthest_pose
        low, high = np.array([[max(a, -far), min(b, far)] for a, b in mechanism.ranges]).T
        poses = low + (high - low) * np.random.default_rng(0).random((FITTING.poses, len(low)))
        #: parameters -> inertia matrices of the links throughout the ranges
        self.matrices = mechanism.inertia_matrices(poses)
        self.inertia_at_start = self._least_inertia(mechanism.start)
        self.least = FITTING.least_row_noise * scale
        #: volts (J,) of the nominal friction scale
        self.friction_volts = scale
        #: greatest step of integration [s]
        self.greatest_step = self._greatest_step()

    def feasible(self, theta: Floats) -> bool:
        """Whether the inertia matrix is positive definite throughout the ranges of the joints, as on any machine."""
        return self._least_inertia(theta) > FITTING.least_inertia * self.inertia_at_start

    def _greatest_step(self) -> float:
        """The greatest step [s] with which the start model predicts the logs as with the usual one, but for a small
        share of what their noise does: logs of few rows a second, of machines without windings, need no more."""
        usual = FITTING.greatest_step_time
        if self.step <= usual:
            return usual

        def errors(step: float) -> Floats:
            plant = self.mechanism.plant(self.mechanism.start)
            return np.concatenate([part.innovation for part in self._tracked(plant, None, step)])

        with suppress(NonFiniteStateError, ParameterError):
            near, least = errors(usual), FITTING.step_error * np.array(self.spread)
            for step in FITTING.further_steps:
                if np.all(np.sqrt(np.mean((errors(step) - near) ** 2, axis=0)) <= least):
                    return step
        return usual

    def _least_inertia(self, theta: Floats) -> float:
        """Least eigenvalue of the inertia matrix with the motors' [kg m^2 or kg]."""
        D = self.matrices(theta) + np.diag(self.mechanism.drive(theta).motor_inertia)
        return float(np.linalg.eigvalsh(D).min())

    def _stretch(self, log: Log, chosen: RowChoice) -> Stretch:
        first = int(np.searchsorted(log.time, log.time[0] + FITTING.start_time))
        velocity, acceleration = local_motion(log.time, log.position, first)
        # between quanta the slope is known better than the position
        near = slice(max(0, first - FITTING.start_rows), first + FITTING.start_rows + 1)
        x = log.time[near] - log.time[first]
        position = np.polynomial.polynomial.polyfit(x, log.position[near], 2)[0]
        enable = None
        if log.enable is not None and not np.all(log.enable):
            enable = np.broadcast_to(np.reshape(log.enable, (len(log.time), -1)), log.voltage.shape).astype(float)
        time = log.time[first:]
        counts = time[1:] > log.time[0] + FITTING.settling_time + FITTING.start_time
        usable = np.repeat(counts[:, None], log.position.shape[1], axis=1)
        return Stretch(
            time,
            voltage=np.ascontiguousarray(log.voltage[first:]),
            position=np.ascontiguousarray(log.position[first:]),
            enable=None if enable is None else enable[first:],
            motion=(position, velocity, acceleration),
            fit=usable,
            validation=np.zeros_like(usable),
            changing=changing(log)[first + 1 :],
        ).validated_at(chosen)

    def _joint_models(self) -> list[tuple[Floats, Floats]]:
        """Transition and voltage column of each joint by itself over a row, its inertia at its mean. States: position,
        velocity, and torque in volts where the current lags."""
        m = self.mechanism
        position = np.vstack([s.position for s in self.stretches])[:: FITTING.inertia_every]
        drive = m.drive(m.start)
        inertia = m.inertia(m.start, position).mean(axis=0) + drive.motor_inertia
        models = []
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
            block[:n, :n], block[:n, n:] = A * self.step, B * self.step
            block = expm(block)
            models.append((block[:n, :n], block[:n, n:]))
        return models

    def _gain(self, models: Sequence[tuple[Floats, Floats]], noise: Floats) -> Floats:
        """(J, 3) steady Kalman gain of each joint by itself."""
        resistance, gains = self.mechanism.drive(self.mechanism.start).resistance, list[list[float]]()
        for j, (F, G) in enumerate(models):
            gain, variance = _steady_gain(F, G, self.volts[j], noise[j])
            current = gain[2] / float(resistance[j]) if len(F) == 3 else 0.0
            gains.append([gain[0], gain[1], current])
            self.responses.append(_response(F, G, np.eye(1, len(F)), gain))
            self.linear.append((F, G[:, 0], gain))
            self.spread.append(float(np.sqrt(variance)))
        return np.array(gains)

    def errors(self, plant: Plant) -> Floats:
        """(N, J) innovations of all logs below each other; raises NonFiniteStateError."""
        return np.concatenate([part.innovation for part in self.tracked(plant)])

    def tracked(self, plant: Plant, corrected: Sequence[Bools] | None = None) -> list[Tracked]:
        """Innovations and predicted motion of each log; raises NonFiniteStateError.

        corrected : for each log whether a row's innovation moves the state (n - 1,), None: always.
        """
        return self._tracked(plant, corrected, self.greatest_step)

    def _tracked(self, plant: Plant, corrected: Sequence[Bools] | None, step: float) -> list[Tracked]:
        out = []
        for number, s in enumerate(self.stretches):
            own, simulator = None if corrected is None else corrected[number], started(plant, s, step)
            finer = parts_of_steps(plant, step)
            out.append(innovations(simulator, s.time, s.voltage, s.position, self.gain, s.enable, own, finer))
        return out

    def in_volts(self, errors: Floats, cutoff: float) -> Floats:
        """(N, J) voltages [V] that the model lacks by its innovations (N, J), up to `cutoff` [Hz]: the predictor's
        response undone frequency by frequency.

        It is undone up to a high cutoff first, and the voltages are continued beyond the ends of a log by reflection:
        innovations that are zero from its end on would be those of a voltage that ends them.
        """
        out = np.empty_like(errors)
        wide = max(cutoff, FITTING.undone_to / self.step)
        blurred, pad = (int(np.ceil(2.0 / (f * self.step))) for f in (wide, cutoff))
        for rows in log_rows(self.lengths):
            count = rows.stop - rows.start
            kept = max(count - blurred, 1)
            for j, taps in enumerate(self.responses):
                size = fft.next_fast_len(count + len(taps) + blurred, real=True)
                ratio = filters.response(fft.rfftfreq(size, self.step), wide) / fft.rfft(taps, size)
                volts = fft.irfft(fft.rfft(errors[rows, j], size) * ratio, size)[:kept]
                after = pad + count - kept
                longer = np.pad(volts, (pad, after), mode="symmetric")
                size = fft.next_fast_len(len(longer), real=True)
                passed = filters.response(fft.rfftfreq(size, self.step), cutoff)
                out[rows, j] = fft.irfft(fft.rfft(longer, size) * passed, size)[pad : pad + count]
        return out

    def floor_in_volts(self, cutoff: float, weighting: Weighting) -> Floats:
        """(J,) `in_volts` root mean square [V] of a true model whose innovations the weighting makes white."""
        size = 2 * (FITTING.spectrum_points - 1)
        f: Floats = np.fft.rfftfreq(size, self.step).astype(float)
        out = []
        for j, taps in enumerate(self.responses):
            passed = np.abs(folded_response(taps, size) * folded_response(weighting.filters[j], size)) ** 2
            ratio = np.abs(filters.response(f, cutoff)) ** 2 / passed
            out.append(np.sqrt(2.0 * self.step * ratio.sum() * f[1]) * weighting.scale[j])
        return np.array(out)

    def validated_at(self, validation: Sequence[RowChoice]) -> Predictor:
        """The same logs with another validation set, as for the constructor; derivatives are cached for both."""
        other = copy(self)
        other.stretches = [s.validated_at(chosen) for s, chosen in zip(self.stretches, validation)]
        return other

    def less(self, volts: Floats) -> Predictor:
        """The same logs with voltages (N, J) [V] taken from those that the plant gets."""
        other = copy(self)
        other.derived, other.remembered = Remembered(FITTING.cached_models), Remembered(FITTING.cached_runs)
        other.stretches = []
        for s, rows in zip(self.stretches, log_rows(self.lengths)):
            voltage = s.voltage.copy()
            voltage[:-1] -= volts[rows]
            other.stretches.append(replace(s, voltage=voltage))
        return other

    def shown(self, volts: Floats) -> Floats:
        """(N, J) innovations of voltages (N, J) [V] that the plant does not know of, each at its own joint alone."""
        out = np.empty_like(volts)
        for rows in log_rows(self.lengths):
            count = rows.stop - rows.start
            for j, taps in enumerate(self.responses):
                size = fft.next_fast_len(count + len(taps) - 1, real=True)
                out[rows, j] = fft.irfft(fft.rfft(volts[rows, j], size) * fft.rfft(taps, size), size)[:count]
        return out

    @property
    def lengths(self) -> tuple[int, ...]:
        """Innovations of each log."""
        return tuple(len(s.time) - 1 for s in self.stretches)

    @property
    def settling(self) -> int:
        """Innovations at the start of each log at least that count for nothing: there the predictor settles."""
        return min(int(np.argmax((s.fit | s.validation).any(axis=1))) for s in self.stretches)

    @property
    def fit_rows(self) -> Bools:
        """(N, J) whether an innovation may be used to fit."""
        return np.concatenate([s.fit for s in self.stretches])

    @property
    def validation_rows(self) -> Bools:
        """(N, J) whether an innovation is of the validation set."""
        return np.concatenate([s.validation for s in self.stretches])

    @property
    def moving_rows(self) -> Bools:
        """(N, J) rows to fit in which a joint moves."""
        return self.fit_rows & np.concatenate([s.changing for s in self.stretches])

    @property
    def noisy_rows(self) -> Bools:
        """(N, J) rows to fit that show the noise of a joint: those in which it moves, or all where these are few."""
        moving = self.moving_rows
        return np.where(_many(moving), moving, self.fit_rows)

    @property
    def unshown(self) -> Floats:
        """(J,) noise [rad or m] of the positions of joints that rest: their readings repeat, and show none; 0.0 for the
        others."""
        return np.where(_many(self.moving_rows), 0.0, self.noise)

    def unfiltered_weighting(self, errors: Floats) -> Weighting:
        """No filter, and the scale of changes from row to row: what lasts, as a missing effect, is no noise."""
        rows, unshown, scale = self.noisy_rows, self.unshown, np.ones(errors.shape[1])
        for j, response in enumerate(self.responses):
            change = np.diff(errors[:, j])[rows[1:, j] & rows[:-1, j]]
            if len(change):
                scale[j] = FITTING.deviation_of_median * np.median(np.abs(change)) / np.sqrt(2.0)
            spread = FITTING.least_median_share * float(np.std(change)) / np.sqrt(2.0)
            least = self.least[j] * float(np.linalg.norm(response))
            scale[j] = max(scale[j], spread, least, unshown[j], 1e-15)
        return Weighting(np.ones((len(scale), 1)), scale, self.lengths, self.settling)


def _many(moving: Bools) -> Bools:
    """(J,) whether enough rows (N, J) show the noise of a joint."""
    return np.asarray(moving.sum(axis=0) >= FITTING.least_noisy_rows)


def started(plant: Plant, stretch: Stretch, step: float) -> Simulator:
    """A simulator at the first row of a log. step : of integration, at most [s]."""
    s = stretch
    simulator = Simulator(plant, max_step=stable_step(plant, step), train_rate=followed_rate(plant, s.row))
    position, velocity = true_start(plant, *s.motion)
    current = driven_current(plant, s.time, s.voltage, 0, velocity, s.motion[2])
    if s.enable is not None:
        current = np.where(s.enable[0] != 0.0, current, 0.0)
    simulator.reset(position, velocity, current, time=float(s.time[0]))
    return simulator


def _steady_gain(F: Floats, G: Floats, volts: float, noise: float) -> tuple[Floats, float]:
    """Steady Kalman gain (n,) of a joint, and the variance of its innovations."""
    n = len(F)
    C = np.eye(1, n)
    Q = G @ G.T * volts**2 + np.diag(FITTING.regular_variance[:n])
    R = noise**2
    P = solve_discrete_are(F.T, C.T, Q, np.array([[R]]))
    if (least := FITTING.least_noise_of_prediction**2 * P[0, 0]) > R:
        R, P = least, solve_discrete_are(F.T, C.T, Q, np.array([[least]]))
    return (P @ C.T / (P[0, 0] + R)).ravel(), float(P[0, 0] + R)


def _least_volts(model: tuple[Floats, Floats], noise: float, step: float) -> float:
    """The least noise of a row's voltage [V] with whose gain a joint forgets an error within the settling time, by the
    slowest pole of the predictor: bisection over the logarithm."""
    F, G = model
    rows = max(FITTING.settling_time / step, FITTING.least_memory_rows)

    def forgets(volts: float) -> bool:
        gain, _ = _steady_gain(F, G, volts, noise)
        kept = F - np.outer(F @ gain, np.eye(1, len(F)))
        return float(np.abs(np.linalg.eigvals(kept)).max()) ** rows <= FITTING.forgotten

    # the volts that move the joint by the noise of a position within that time
    moved = np.linalg.matrix_power(F, max(int(rows), 1))[0] @ G[:, 0]
    low = high = np.log(noise / max(abs(float(moved)), 1e-300))
    while not forgets(float(np.exp(high))) and high - low < FITTING.memory_range:
        high += 1.0
    while forgets(float(np.exp(low))) and high - low < FITTING.memory_range:
        low -= 1.0
    for _ in range(FITTING.memory_bisections):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if forgets(float(np.exp(middle))) else (middle, high)
    return float(np.exp(high))


def _response(F: Floats, G: Floats, C: Floats, gain: Floats) -> Floats:
    """Innovations (k,) of a predictor after one row of a voltage that it does not know of."""
    return innovations_of(F @ (np.eye(len(F)) - gain[:, None] @ C), -G[:, 0], C)[:, 0]


def innovations_of(kept: Floats, x: Floats, C: Floats) -> Floats:
    """Innovations (k, J) of an error x (n,) of a predicted state, until they are a small share of the greatest.

    kept (n, n) : what a row keeps of an error; C (J, n) : the innovations that one makes.
    """
    out, greatest = list[Floats](), 0.0
    while len(out) < FITTING.response_rows:
        out.append(C @ x)
        size = float(np.abs(out[-1]).max())
        greatest = max(greatest, size)
        if len(out) > 5 and size < FITTING.response_end * greatest and abs(x).max() < 1e2:
            break
        x = kept @ x
    return np.array(out)
