# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""How far a log is from the nominal plant, in the widths of the priors.

All parameters of the mechanism, linearised, and the effects that add slow volts, each with the
width that machines have, share out the voltage; what it costs is half the sum of the squares of
their deviations and of what is left over. A position with a wrong scale or offset is far away as it
stands and near once it is put right.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.identify.checks.plausibility import Coarse, Plausibility
from puma_sim_core.identify.settings import CHECKS


class PriorFit:
    """Costs of coarse series under a mechanism's priors."""

    def __init__(self, model: Plausibility):
        self.model = model
        self.mechanism = model.mechanism
        self.slopes = self.mechanism.drive_jacobian(model.theta)

    def costs(self, c: Coarse, counted: list[np.ndarray], joints=None) -> tuple[float, float]:
        """(all, that of what is left over): cost of the best parameters and effects.

        counted : rows of each joint that count, (n,) each; joints : only these have a voltage.
        """
        m, theta, model = self.mechanism, self.model.theta, self.model
        joints = range(c.joints) if joints is None else joints
        q, qd, qdd = c.position, c.velocity, c.acceleration
        torque = m.torque(theta, q, qd, qdd) + model.drive.motor_inertia * qdd + model.drive.viscous * qd
        expected = model.k * torque + model.drive.emf * qd
        shared = [self._slopes(c, torque) * m.deviations]
        load = m.payload_torque(theta, CHECKS.prior_fit_lever, q, qd, qdd)
        if load is not None:
            shared.append((CHECKS.prior_fit_load * model.k * load)[:, :, None])
        tilt = m.gravity_tilt(theta, q)
        if tilt is not None:
            shared.append(CHECKS.prior_fit_tilt * model.k[:, None] * tilt)
        shared = np.concatenate(shared, axis=2)
        weight = m.gravity(theta, q) * model.k
        table, wanted = [], []
        for j in joints:
            rows = counted[j]
            if rows.sum() < 2:
                continue
            v, unit = qd[rows, j], model.unit[j]
            fastest = float(np.abs(v).max()) or 1.0
            steps = [np.tanh(v / (width * fastest)) for width in CHECKS.prior_fit_dry_widths]
            part = q[rows, j]
            own = np.column_stack(
                [
                    np.full(len(v), CHECKS.prior_fit_offset * unit),
                    *(CHECKS.prior_fit_dry * unit * step for step in steps),
                    CHECKS.prior_fit_spring * unit * (part - part.mean()) / max(float(np.ptp(part)), 1e-9),
                    CHECKS.prior_fit_loaded * np.abs(weight[rows, j]) * steps[0],
                    CHECKS.prior_fit_drag * model.speed[j] * v * np.abs(v) / fastest,
                    # the motion that is read is that of voltages some milliseconds before
                    CHECKS.prior_fit_lag * c.voltage_rate[rows, j],
                ]
            )
            block = np.zeros((len(v), c.joints * own.shape[1]))
            block[:, j * own.shape[1] : (j + 1) * own.shape[1]] = own
            # rows closer than the correlation time share one value's weight
            scale = np.sqrt(min(1.0, c.step / CHECKS.prior_fit_correlated)) / float(
                np.hypot(CHECKS.prior_fit_noise * unit, CHECKS.prior_fit_share * np.std(c.voltage[rows, j]))
            )
            table.append(scale * np.hstack([shared[rows, j], block]))
            wanted.append(scale * (c.voltage[rows, j] - expected[rows, j]))
        if not table:
            return 0.0, 0.0
        table, wanted = np.concatenate(table), np.concatenate(wanted)
        normal = table.T @ table + np.eye(table.shape[1])
        x = np.linalg.solve(normal, table.T @ wanted)
        left = float(np.sum((wanted - table @ x) ** 2))
        return 0.5 * (left + float(x @ x)), 0.5 * left

    def _slopes(self, c: Coarse, torque: np.ndarray) -> np.ndarray:
        """(n, J, p) derivative of the model's voltage, as `Mechanism.voltage_jacobian` has it; the
        drive's derivatives are taken once."""
        q, qd, qdd, s = c.position, c.velocity, c.acceleration, self.slopes
        result = self.mechanism.link_jacobian(self.model.theta, q, qd, qdd)
        result += qdd[:, :, None] * s.motor_inertia + qd[:, :, None] * s.viscous
        result *= self.model.k[:, None]
        return result + torque[:, :, None] * s.volts_per_torque + qd[:, :, None] * s.emf
