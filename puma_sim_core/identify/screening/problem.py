# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The residual r = V - Vhat and its regressors, at the rows that count.

Vhat_j = k_j (1 + lag_j d/dt) torque_j + ke N_j qd_j. Voltage, model and every regressor pass the same second filter,
and are read at a few rows for each of its time constants. A joint at rest says little of its friction: rows where it
rests are left out for that joint.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from puma_sim_core.effects import Effect
from puma_sim_core.effects.screening import TORQUE_COLUMN, Candidate, Signals
from puma_sim_core.identify.arrays import Bools, Floats, Ints, rows_of_segments
from puma_sim_core.identify.data import filters
from puma_sim_core.identify.data.sampling import Sampled, resting
from puma_sim_core.identify.screening.hypotheses import by_joint, signals_of
from puma_sim_core.identify.screening.known_effects import known_voltage
from puma_sim_core.identify.settings import SCREENING
from puma_sim_core.plant.mechanism import Mechanism


@dataclass(frozen=True)
class Linear:
    """The model about a parameter vector: rows (m, J) [V] of residual and (m, J, p) of d Vhat."""

    theta: Floats
    residual: Floats
    jacobian: Floats


class Problem:
    """Logs, a mechanism, and the rows that count.

    place : where each block of the validation set lies in its period, 0..1; None: the logs are the validation set as a
    whole. kept (m,) : rows after the second filter; usable (m, J); validation (m,) : rows of the validation set;
    guard (m,) : rows about its blocks, which count for neither.
    """

    def __init__(self, sampled: Sampled, mechanism: Mechanism, place: float | None = SCREENING.residual_places[0]):
        self.sampled, self.mechanism, self.place = sampled, mechanism, place
        self.kept = sampled.kept()
        self.segment: Ints = sampled.segment[self.kept]
        rests = resting(sampled.velocity, sampled.velocity_noise, sampled.step, sampled.cutoffs[1], sampled.stretches)
        self.usable = ~rests[self.kept] & ~self._switching()
        self.validation, self.guard = self._validation()

    @cached_property
    def voltage(self) -> Floats:
        """(m, J) commanded voltage past the second filter [V]."""
        return self.sampled.second(self.sampled.voltage)[self.kept]

    @property
    def stretches(self) -> list[slice]:
        """Kept rows of each log."""
        return rows_of_segments(self.segment)

    def fit_rows(self, joint: int) -> Ints:
        """Numbers of the kept rows that a fit may use for a joint."""
        return np.flatnonzero(self.usable[:, joint] & ~self.validation & ~self.guard)

    def like(self, residual: Floats) -> Problem:
        """This problem, or one whose validation blocks are more like the other rows by the residual (m, J) [V] of the
        retuned model: what happened only there cannot be found."""
        if self._unlike(residual) < SCREENING.residual_unlike:
            return self
        tried = [self.at(place) for place in SCREENING.residual_places]
        return min(tried, key=lambda problem: problem._unlike(residual))

    def at(self, place: float) -> Problem:
        """The same logs with the blocks of the validation set at another place."""
        return Problem(self.sampled, self.mechanism, place)

    def _unlike(self, residual: Floats) -> float:
        """Power of a residual in the validation set, and around it, over that of the rows to fit: the most of any
        joint. Or its peaks' power: an impact is lost in that of all rows where a joint lacks something else as well."""
        away, ratios = self.validation | self.guard, [0.0]
        for usable, r in zip(self.usable.T, residual.T):
            inside, fit = r[usable & away] ** 2, r[usable & ~away] ** 2
            if len(inside) and len(fit):
                ratios.append(float(np.mean(inside) / max(np.mean(fit), 1e-30)))
                ratios.append(float(SCREENING.residual_peak * np.max(inside) / max(np.max(fit), 1e-30)))
        return max(ratios)

    def _switching(self) -> Bools:
        """Rows that a change of `enable` reaches."""
        s = self.sampled
        change = np.abs(np.diff(s.enable, axis=0, prepend=s.enable[:1])) > 0.0
        reach = int(filters.edge(s.cutoffs[1]) / s.step)
        near = np.zeros_like(change)
        for row, j in np.argwhere(change).tolist():
            near[max(0, row - reach) : row + reach + 1, j] = True
        return near[self.kept]

    def _validation(self) -> tuple[Bools, Bools]:
        """(m,) rows of the validation set, and those about its blocks."""
        s = self.sampled
        validation = np.full(len(self.segment), self.place is None)
        guard = np.zeros(len(validation), dtype=bool)
        if self.place is None:
            return validation, guard
        period = SCREENING.residual_validation_block / SCREENING.residual_validation_share
        for rows in self.stretches:
            time = s.time[self.kept[rows]]
            length = time[-1] - time[0]
            blocks = max(1, int(round(length / period)))
            phase = (time - time[0]) / max(length, 1e-9) * blocks
            away = np.abs(np.mod(phase, 1.0) - self.place)
            # a place at the end of its period goes on at the start of the next
            validation[rows] = np.minimum(away, 1.0 - away) < 0.5 * SCREENING.residual_validation_share
        reach = int(np.ceil(SCREENING.residual_guard / (s.cutoffs[1] * s.step * s.every)))
        for rows in self.stretches:
            for row in np.flatnonzero(np.diff(validation[rows].astype(int))):
                first = rows.start + row + 1
                guard[max(rows.start, first - reach // 2) : first + (reach + 1) // 2] = True
        return validation, guard

    # the model about a parameter vector

    def signals(self, theta: Floats) -> Signals:
        """What the candidates of the effects read."""
        return signals_of(self.mechanism, theta, self.sampled, self.sampled.velocity_noise, self.sampled.quantum)

    def known(self, theta: Floats, effects: Iterable[Effect] = ()) -> Floats:
        """(n, J) part of V - Vhat [V] that known effects make: those of the mechanism and more."""
        effects = (*self.mechanism.effects, *effects)
        if not effects:
            return np.zeros_like(self.sampled.position)
        return known_voltage(replace(self.mechanism, effects=effects), theta, self.signals(theta))

    def full_residual(self, theta: Floats) -> Floats:
        """(n, J) residual [V] at all rows, past the second filter."""
        s, drive = self.sampled, self.mechanism.drive(theta)
        torque = self.mechanism.total_torque(theta, s.position, s.velocity, s.acceleration)
        return s.second(s.voltage - self.known(theta) - drive.emf * s.enable * s.velocity) - drive.volts_per_torque * (
            s.second(torque) + drive.lag * s.second(torque, order=1)
        )

    def linear(self, theta: Floats, effects: Collection[Effect] = ()) -> Linear:
        """Residual and Jacobian of Vhat at the kept rows. effects : in the model beside those of the mechanism."""
        s, m, kept = self.sampled, self.mechanism, self.kept
        q, qd, qdd = s.position, s.velocity, s.acceleration
        drive, slopes = m.drive(theta), m.drive_jacobian(theta)
        torque, dtorque = m.total_torque(theta, q, qd, qdd), m.torque_jacobian(theta, q, qd, qdd)
        T0, T1, D0, D1 = (s.second(values, order=order)[kept] for values in (torque, dtorque) for order in (0, 1))
        w = s.second(s.enable * qd)[kept]
        k, lag = drive.volts_per_torque, drive.lag
        jacobian = (
            k[:, None] * (D0 + lag[:, None] * D1)
            + slopes.volts_per_torque * (T0 + lag * T1)[:, :, None]
            + (k[:, None] * slopes.lag) * T1[:, :, None]
            + slopes.emf * w[:, :, None]
        )
        residual = self.voltage - (k * (T0 + lag * T1) + drive.emf * w)
        if effects or m.effects:
            residual = residual - s.second(self.known(theta, effects))[kept]
        return Linear(np.array(theta), residual, jacobian)

    def reduce(self, candidate: Candidate, signals: Signals) -> dict[int, Floats]:
        """Joint -> (m, p) columns of a candidate in volts at the kept rows."""
        s, out = self.sampled, by_joint(candidate, len(self.sampled.time))
        for j, full in out.items():
            if candidate.unit == TORQUE_COLUMN:
                out[j] = signals.volts_per_torque[j] * s.second(full, lag=signals.lag[j])[self.kept]
            else:
                out[j] = s.second(full * s.enable[:, j : j + 1])[self.kept]
        return out
