# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The trace form of the rigid body (equations 3.22 to 3.28), for any number of links: the reference of the closed form.

In all, q : (n,) [rad]; bodies : n pseudo inertias (4, 4); table : (n, 3) rows (a, alpha, d).
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.kinematics import dh_table, first_derivatives

STEP = 1e-40


def arm_table(arm: ArmParameters) -> np.ndarray:
    """(3, 3) Denavit-Hartenberg rows of the first three links."""
    return dh_table(arm)[:3]


def second_derivatives(q, table) -> np.ndarray:
    """d2T_p/dq_i dq_j (n, n, n, 4, 4), equation 2.4, by the complex step."""
    q = np.asarray(q, dtype=float)
    slopes = [first_derivatives(q + 1j * STEP * unit, table).imag / STEP for unit in np.eye(len(q))]
    return np.stack(slopes, axis=2)


def trace_inertia(q, bodies, table) -> np.ndarray:
    """D(q) [kg.m^2], equations 3.22 and 3.23."""
    first = first_derivatives(q, table)
    return np.einsum("piab,pbc,pjac->ij", first, np.asarray(bodies), first)


def trace_coriolis(q, bodies, table) -> np.ndarray:
    """C(q) [kg.m^2], equations 3.24 and 3.25: sum over p of trace(d2Tp/dqj dqk Jp dTp'/dqi)."""
    first, second = first_derivatives(q, table), second_derivatives(q, table)
    return np.einsum("pjkab,pbc,piac->ijk", second, np.asarray(bodies), first)


def trace_gravity(q, bodies, table, gravity=9.81) -> np.ndarray:
    """G(q) [N.m], equation 3.28 with its sign corrected; gravity [m/s^2] down the base axis z0."""
    moments = np.asarray(bodies)[:, :, 3]
    return gravity * np.einsum("pib,pb->i", first_derivatives(q, table)[:, :, 2, :], moments)
