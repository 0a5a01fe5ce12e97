# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""How far a log is from the nominal plant, in the widths of the priors.

All parameters of the mechanism, linearised, and the effects that add slow volts, each with the width that machines
have, share out the voltage. The cost is half the sum of the squares of their deviations and of the residual. A position
with a wrong scale or offset has a high cost as it stands and a low one once it is corrected.
"""

from collections.abc import Sequence

import numpy as np

from puma_sim_core.identify.arrays import Bools, Floats
from puma_sim_core.identify.checks.plausibility import Coarse, Plausibility
from puma_sim_core.identify.settings import CHECKS


class PriorFit:
    """Costs of coarse series under a mechanism's priors."""

    def __init__(self, model: Plausibility):
        self.model = model
        self.mechanism = model.mechanism
        self.slopes = self.mechanism.drive_jacobian(model.theta)

    def cost(self, c: Coarse, counted: Sequence[Bools]) -> float:
        """Cost of the best parameters and effects. counted : rows of each joint that count, (n,) each."""
        m, theta, model = self.mechanism, self.model.theta, self.model
        q, qd, qdd = c.position, c.velocity, c.acceleration
        torque = m.torque(theta, q, qd, qdd) + model.drive.motor_inertia * qdd + model.drive.viscous * qd
        expected = model.k * torque + model.drive.emf * qd
        parts = [self._slopes(c, torque) * m.deviations]
        load = m.payload_torque(theta, (0.0, 0.0, CHECKS.prior_fit_lever), q, qd, qdd)
        if load is not None:
            parts.append((CHECKS.prior_fit_load * model.k * load)[:, :, None])
            if m.library_sized:
                # the centre of a load beside the forearm's line turns the weight as a wrong zero would
                beside = m.payload_torque(theta, (CHECKS.prior_fit_aside, 0.0, CHECKS.prior_fit_lever), q, qd, qdd)
                parts.append((CHECKS.prior_fit_load * model.k * (np.asarray(beside) - load))[:, :, None])
        tilt = m.gravity_tilt(theta, q)
        if tilt is not None:
            parts.append(CHECKS.prior_fit_tilt * model.k[:, None] * tilt)
        shared = np.concatenate(parts, axis=2)
        weight = m.gravity(theta, q) * model.k
        tables, wanted = [], []
        for j, rows in enumerate(counted):
            if rows.sum() < 2:
                continue
            volts = c.voltage[rows, j]
            own = self._own_columns(c, j, rows, weight)
            block = np.zeros((len(own), c.joints * own.shape[1]))
            block[:, j * own.shape[1] : (j + 1) * own.shape[1]] = own
            # rows closer than the correlation time share one value's weight
            scale = np.sqrt(min(1.0, c.step / CHECKS.prior_fit_correlated)) / float(
                np.hypot(CHECKS.prior_fit_noise * model.unit[j], CHECKS.prior_fit_share * np.std(volts))
            )
            tables.append(scale * np.hstack([shared[rows, j], block]))
            wanted.append(scale * (volts - expected[rows, j]))
        if not tables:
            return 0.0
        table, y = np.concatenate(tables), np.concatenate(wanted)
        x = np.linalg.solve(table.T @ table + np.eye(table.shape[1]), table.T @ y)
        return 0.5 * (float(np.sum((y - table @ x) ** 2)) + float(x @ x))

    def _own_columns(self, c: Coarse, j: int, rows: Bools, weight: Floats) -> Floats:
        """(m, p) volts of a standard deviation of each effect of one joint."""
        q, v, unit = c.position[rows, j], c.velocity[rows, j], self.model.unit[j]
        fastest = float(np.abs(v).max()) or 1.0
        steps = [np.tanh(v / (width * fastest)) for width in CHECKS.prior_fit_dry_widths]
        return np.column_stack(
            [
                np.full(len(v), CHECKS.prior_fit_offset * unit),
                *(CHECKS.prior_fit_dry * unit * step for step in steps),
                CHECKS.prior_fit_spring * unit * (q - q.mean()) / max(float(np.ptp(q)), 1e-9),
                CHECKS.prior_fit_loaded * np.abs(weight[rows, j]) * steps[0],
                CHECKS.prior_fit_drag * self.model.speed[j] * v * np.abs(v) / fastest,
                # the motion that is read is that of voltages some milliseconds before
                CHECKS.prior_fit_lag * c.voltage_rate[rows, j],
            ]
        )

    def _slopes(self, c: Coarse, torque: Floats) -> Floats:
        """(n, J, p) derivative of the model's voltage; the drive's derivatives are taken once."""
        q, qd, qdd, s = c.position, c.velocity, c.acceleration, self.slopes
        result = self.mechanism.link_jacobian(self.model.theta, q, qd, qdd)
        result += qdd[:, :, None] * s.motor_inertia + qd[:, :, None] * s.viscous
        result *= self.model.k[:, None]
        return result + torque[:, :, None] * s.volts_per_torque + qd[:, :, None] * s.emf
