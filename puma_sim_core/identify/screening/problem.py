# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The residual r = V - Vhat and its regressors, at the rows that count (steps 1 and 2).

Vhat_j = k_j (1 + lag_j d/dt) torque_j + ke N_j qd_j. Voltage, model and every regressor pass the
same second filter, and are read at a few rows for each of its time constants. A joint at rest says
little of its friction, so that rows where it rests are left out for that joint.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from puma_sim_core.effects.screening import TORQUE_COLUMN, Candidate, Signals
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.sampling import Sampled
from puma_sim_core.identify.screening.known_effects import known_voltage
from puma_sim_core.identify.settings import SCREENING


@dataclass(frozen=True)
class Linear:
    """The model about a parameter vector: rows (m, J) [V] of residual and (m, J, p) of d Vhat."""

    theta: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray


class Problem:
    """Logs, a mechanism, and the rows that count.

    kept (m,): rows after the second filter; usable (m, J); held (m,): kept back; guard (m,).
    held_segments : logs that are kept back as a whole; hold_back : whether, without any, blocks of
    all logs are; place : where each lies in its period, 0..1.
    """

    def __init__(
        self,
        sampled: Sampled,
        mechanism,
        held_segments=(),
        hold_back: bool = True,
        place: float = SCREENING.residual_places[0],
    ):
        self.sampled = sampled
        self.place = place
        self.mechanism = mechanism
        self.kept = sampled.kept()
        self.segment = sampled.segment[self.kept]
        self.usable = ~self._resting() & ~self._switching()
        self.hold_back = hold_back and not held_segments
        self.held, self.guard = self._kept_back(frozenset(held_segments))

    @cached_property
    def voltage(self) -> np.ndarray:
        """(m, J) commanded voltage past the second filter [V]."""
        return self.sampled.second(self.sampled.voltage)[self.kept]

    @property
    def stretches(self) -> list[slice]:
        """Kept rows of each log."""
        starts = np.flatnonzero(np.diff(self.segment, prepend=-1))
        return [slice(int(a), int(b)) for a, b in zip(starts, [*starts[1:], len(self.segment)])]

    def fit_rows(self, joint: int) -> np.ndarray:
        """Numbers of the kept rows that a fit may use for a joint."""
        return np.flatnonzero(self.usable[:, joint] & ~self.held & ~self.guard)

    def held_rows(self, joint: int) -> np.ndarray:
        """Numbers of the kept rows that are kept back for a joint."""
        return np.flatnonzero(self.usable[:, joint] & self.held & ~self.guard)

    def like(self, residual: np.ndarray) -> Problem:
        """This problem, or one whose blocks lie where the rows kept back are more like the others
        by the residual (m, J) [V] of the retuned model.

        What happened once, such as a blow, cannot be found where it happened in rows kept back.
        """
        if not self.hold_back or self._unlike(residual) < SCREENING.residual_unlike:
            return self
        tried = [Problem(self.sampled, self.mechanism, (), True, place) for place in SCREENING.residual_places]
        return min(tried, key=lambda problem: problem._unlike(residual))

    def _unlike(self, residual) -> float:
        """Power of a residual at the rows kept back, and around them, over that of the rows to fit:
        the most of any joint. Or its peaks' power: a blow is lost in that of all rows where a joint
        lacks something else as well."""
        away, ratios = self.held | self.guard, [0.0]
        for usable, r in zip(self.usable.T, residual.T):
            kept, fit = r[usable & away], r[usable & ~away]
            if len(kept) and len(fit):
                ratios += [
                    float(share * size(kept**2) / max(size(fit**2), 1e-30))
                    for share, size in ((1.0, np.mean), (SCREENING.residual_peak, np.max))
                ]
        return max(ratios)

    def _resting(self) -> np.ndarray:
        s = self.sampled
        speed = np.abs(s.velocity)
        limit = np.maximum(
            SCREENING.residual_rest_noise * s.velocity_noise, SCREENING.residual_rest_share * speed.max(axis=0)
        )
        slow = speed < limit
        need = max(1, int(SCREENING.residual_rest_time / s.step))
        reach = int(0.5 / (s.cutoffs[1] * s.step))
        resting = np.zeros(slow.shape, dtype=bool)
        for rows in s.stretches:
            for j in range(s.joints):
                change = np.flatnonzero(np.diff(np.r_[0, slow[rows, j].astype(int), 0]))
                for first, last in zip(change[::2], change[1::2]):
                    if last - first >= need:
                        at = rows.start + max(0, first - reach)
                        resting[at : min(rows.stop, rows.start + last + reach), j] = True
        return resting[self.kept]

    def _switching(self) -> np.ndarray:
        """Rows that a change of `enable` reaches."""
        s = self.sampled
        part = np.abs(np.diff(s.enable, axis=0, prepend=s.enable[:1])) > 0.0
        if not part.any():
            return np.zeros((len(self.kept), s.joints), dtype=bool)
        reach = int(filters.edge(s.cutoffs[1]) / s.step)
        near = np.zeros_like(part)
        for j in range(s.joints):
            for row in np.flatnonzero(part[:, j]):
                near[max(0, row - reach) : row + reach + 1, j] = True
        return near[self.kept]

    def _kept_back(self, held_segments):
        s = self.sampled
        held = np.isin(self.segment, list(held_segments))
        if self.hold_back:
            period = SCREENING.residual_held_block / SCREENING.residual_held_share
            for rows in self.stretches:
                time = s.time[self.kept[rows]]
                length = time[-1] - time[0]
                blocks = max(1, int(round(length / period)))
                phase = (time - time[0]) / max(length, 1e-9) * blocks
                away = np.abs(np.mod(phase, 1.0) - self.place)
                # a place at the end of its period goes on at the start of the next
                held[rows] = np.minimum(away, 1.0 - away) < 0.5 * SCREENING.residual_held_share
        guard = np.zeros(len(held), dtype=bool)
        reach = int(np.ceil(SCREENING.residual_guard / (s.cutoffs[1] * s.step * s.every)))
        for rows in self.stretches:
            for row in np.flatnonzero(np.diff(held[rows].astype(int))):
                first = rows.start + row + 1
                guard[max(rows.start, first - reach // 2) : first + (reach + 1) // 2] = True
        return held, guard

    # the model about a parameter vector

    def signals(self, theta: np.ndarray, motion=None) -> Signals:
        """What the candidates of the effects read.

        motion : (time, step, segment, voltage, enable, position, velocity, acceleration) of
        another motion than the filtered one.
        """
        s, m = self.sampled, self.mechanism
        if motion is None:
            motion = (s.time, s.step, s.segment, s.voltage, s.enable, s.position, s.velocity, s.acceleration)
        time, step, segment, voltage, enable, q, qd, qdd = motion
        drive = m.drive(theta)
        link = m.torque(theta, q, qd, qdd)
        torque = link + drive.motor_inertia * qdd + drive.viscous * qd
        return Signals(
            time=time,
            step=step,
            segment=segment,
            voltage=voltage,
            position=q,
            velocity=qd,
            acceleration=qdd,
            link_torque=link,
            gravity_torque=m.gravity(theta, q),
            torque=torque,
            current=torque * drive.volts_per_torque / drive.resistance,
            enable=enable,
            link_inertia=m.inertia(theta, q),
            motor_inertia=drive.motor_inertia,
            viscous=drive.viscous,
            volts_per_torque=drive.volts_per_torque,
            lag=drive.lag,
            emf=drive.emf,
            gear=np.asarray(m.gear, dtype=float),
            torque_scale=np.asarray(m.torque_scale, dtype=float),
            velocity_noise=s.velocity_noise,
            quantum=s.quantum,
            ranges=tuple(m.ranges),
            gravity_tilt=m.gravity_tilt(theta, q),
            payload_torque=lambda z: m.payload_torque(theta, z, q, qd, qdd),
            inertia=m.inertia_matrix(theta, q),
            position_gradient=m.position_gradient(theta, q, qd, qdd),
        )

    def known(self, theta: np.ndarray, effects=()) -> np.ndarray:
        """(n, J) part of V - Vhat [V] that known effects make: those of the mechanism and more."""
        m = self.mechanism
        effects = (*m.effects, *effects)
        if not effects:
            return np.zeros_like(self.sampled.position)
        return known_voltage(replace(m, effects=effects), theta, self.signals(theta))

    def full_residual(self, theta: np.ndarray, effects=()) -> np.ndarray:
        """(n, J) residual [V] at all rows, past the second filter."""
        s, m = self.sampled, self.mechanism
        drive = m.drive(theta)
        torque = m.total_torque(theta, s.position, s.velocity, s.acceleration)
        k, lag = drive.volts_per_torque, drive.lag
        return s.second(s.voltage - self.known(theta, effects) - drive.emf * s.enable * s.velocity) - k * (
            s.second(torque) + lag * s.second(torque, order=1)
        )

    def linear(self, theta: np.ndarray, effects=()) -> Linear:
        """Residual and Jacobian of Vhat at the kept rows; effects: in the model beside those of
        the mechanism."""
        s, m = self.sampled, self.mechanism
        q, qd, qdd = s.position, s.velocity, s.acceleration
        drive = m.drive(theta)
        slopes = m.drive_jacobian(theta)
        torque = m.total_torque(theta, q, qd, qdd)
        dtorque = m.torque_jacobian(theta, q, qd, qdd)
        kept = self.kept
        T0, T1 = s.second(torque)[kept], s.second(torque, order=1)[kept]
        D0, D1 = s.second(dtorque)[kept], s.second(dtorque, order=1)[kept]
        w = s.second(s.enable * qd)[kept]
        k, lag, emf = drive.volts_per_torque, drive.lag, drive.emf
        dk, dlag, demf = slopes.volts_per_torque, slopes.lag, slopes.emf
        jacobian = (
            k[:, None] * (D0 + lag[:, None] * D1)
            + dk * (T0 + lag * T1)[:, :, None]
            + (k[:, None] * dlag) * T1[:, :, None]
            + demf * w[:, :, None]
        )
        residual = self.voltage - (k * (T0 + lag * T1) + emf * w)
        if effects or m.effects:
            residual = residual - s.second(self.known(theta, effects))[kept]
        return Linear(np.array(theta), residual, jacobian)

    def reduce(self, candidate: Candidate, signals: Signals) -> dict[int, np.ndarray]:
        """Joint -> (m, p) columns of a candidate in volts at the kept rows."""
        s = self.sampled
        p = len(candidate.columns)
        joints = sorted({j for column in candidate.columns for j in column})
        out = {}
        for j in joints:
            full = np.zeros((len(s.time), p))
            for c, column in enumerate(candidate.columns):
                if j in column:
                    full[:, c] = column[j]
            if candidate.unit == TORQUE_COLUMN:
                k, lag = signals.volts_per_torque[j], signals.lag[j]
                out[j] = k * s.second(full, lag=lag)[self.kept]
            else:
                out[j] = s.second(full * s.enable[:, j : j + 1])[self.kept]
        return out
