# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The third-order model in the thesis's states (q, qd, qdd), with its named matrices (chapter 5).

    Dbar qddd = v - (FMAT + BMAT + GMAT + HMAT) qdd - (JKMAT + KMAT) qd - LMAT

It follows from the motor circuit (5.1) and from the derivative of the equations of motion (5.4),
with their misprints corrected: joint torque is N kt i, the term with qdd and qd stands twice and
not three times, and LMAT is subtracted. The states (q, qd, i) describe the same system; everything
that is simulated runs on those, because effects with jumps (dry friction) have no derivative. This
module is the thesis's form for readers and the check of the other.

Derivatives of D, C and G with time are taken by the complex step, Im f(q + i e qd) / e, which has
no difference of near-equal numbers and is exact to rounding (Squire and Trapp, SIAM Review 40,
1998). All arguments are therefore real.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.checks import check_choice

#: so small that its square vanishes beside 1 in double precision, and far from underflow
_STEP = 1e-40
#: equation 5.2 as physics has it, F = N kt i, and as it is printed, F = kt i
TORQUE_FORMS = ("physical", "printed")
_NONE = (0.0, 0.0, 0.0)


class ThirdOrderMatrices(NamedTuple):
    """Section 6.4, corrected; H viscous friction, kT torque at the joint per ampere.

    =====  ======  ==========  ==================================================
    Dbar   (3, 3)  V.s^3/rad   LKMAT (D + Ia)
    FMAT   (3, 3)  V.s^2/rad   rows (2 L / kT) qd' C^i
    BMAT   (3, 3)  V.s^2/rad   LKMAT Ddot
    GMAT   (3, 3)  V.s^2/rad   diag(R / kT) D
    HMAT   (3, 3)  V.s^2/rad   diag((R Ia + L H) / kT)
    JKMAT  (3, 3)  V.s/rad     rows qd' (L Cdot^i + R C^i) / kT
    KMAT   (3, 3)  V.s/rad     diag(ke N + R H / kT)
    LMAT   (3,)    V           (L Gdot + R G) / kT
    LKMAT  (3, 3)  V.s/(N.m)   diag(L / kT)
    =====  ======  ==========  ==================================================
    """

    Dbar: np.ndarray
    FMAT: np.ndarray
    BMAT: np.ndarray
    GMAT: np.ndarray
    HMAT: np.ndarray
    JKMAT: np.ndarray
    KMAT: np.ndarray
    LMAT: np.ndarray
    LKMAT: np.ndarray


def joint_torque_per_ampere(arm: ArmParameters, torque_form: str = "physical") -> np.ndarray:
    """(3,) kT [N.m/A]: N kt ("physical"), or kt as equation 5.2 is printed ("printed").
    ParameterError for another.
    """
    check_choice(torque_form, "torque_form", TORQUE_FORMS)
    return np.array([m.torque_constant * (m.gear_ratio if torque_form == "physical" else 1) for m in arm.motors])


def matrices(
    q: ArrayLike, qd: ArrayLike, arm: ArmParameters, viscous: ArrayLike = _NONE, torque_form: str = "physical"
) -> ThirdOrderMatrices:
    """Named matrices at a state.

    q [rad], qd [rad/s], viscous [N.m.s/rad] : (3,), real.
    ParameterError: unknown torque form.
    """
    q, qd, viscous = (np.asarray(item, dtype=float) for item in (q, qd, viscous))
    resistance, inductance, emf = _motor_constants(arm)
    torque = joint_torque_per_ampere(arm, torque_form)
    ahead = q + 1j * _STEP * qd
    d, c, g = inertia(q, arm), coriolis(q, arm), gravity_torque(q, arm)
    d_dot, c_dot, g_dot = (function(ahead, arm).imag / _STEP for function in (inertia, coriolis, gravity_torque))
    l_k, r_k = inductance / torque, resistance / torque
    return ThirdOrderMatrices(
        Dbar=l_k[:, None] * (d + np.diag(arm.motor_inertia)),
        FMAT=2 * l_k[:, None] * (qd @ c),
        BMAT=l_k[:, None] * d_dot,
        GMAT=r_k[:, None] * d,
        HMAT=np.diag(r_k * arm.motor_inertia + l_k * viscous),
        JKMAT=l_k[:, None] * (qd @ c_dot) + r_k[:, None] * (qd @ c),
        KMAT=np.diag(emf + r_k * viscous),
        LMAT=l_k * g_dot + r_k * g,
        LKMAT=np.diag(l_k),
    )


def jerk(
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    v: ArrayLike,
    arm: ArmParameters,
    viscous: ArrayLike = _NONE,
    torque_form: str = "physical",
) -> np.ndarray:
    """Third derivative of the joint angles, equation 5.9.

    q [rad], qd [rad/s], qdd [rad/s^2], v [V], viscous [N.m.s/rad] : (3,), real.
    Returns (3,) [rad/s^3].
    ParameterError: unknown torque form.
    """
    m = matrices(q, qd, arm, viscous, torque_form)
    right = (
        np.asarray(v, dtype=float)
        - (m.FMAT + m.BMAT + m.GMAT + m.HMAT) @ np.asarray(qdd)
        - (m.JKMAT + m.KMAT) @ np.asarray(qd)
        - m.LMAT
    )
    return np.linalg.solve(m.Dbar, right)


def acceleration_from_current(
    q: ArrayLike,
    qd: ArrayLike,
    current: ArrayLike,
    arm: ArmParameters,
    viscous: ArrayLike = _NONE,
    torque_form: str = "physical",
) -> np.ndarray:
    """Acceleration of the joints that motor currents give, equations 5.2 and 5.4.

    q [rad], qd [rad/s], current [A], viscous [N.m.s/rad] : (3,), real or complex.
    Returns (3,) [rad/s^2].
    ParameterError: unknown torque form.
    """
    qd = np.asarray(qd)
    against = np.einsum("ijk,j,k->i", coriolis(q, arm), qd, qd) + np.asarray(viscous) * qd + gravity_torque(q, arm)
    torque = joint_torque_per_ampere(arm, torque_form) * np.asarray(current)
    return np.linalg.solve(inertia(q, arm) + np.diag(arm.motor_inertia), torque - against)


def current_rate(qd: ArrayLike, current: ArrayLike, v: ArrayLike, arm: ArmParameters) -> np.ndarray:
    """di/dt of the motor circuits, equation 5.1: (v - R i - ke N qd) / L.

    qd [rad/s], current [A], v [V] : (3,), real or complex. Returns (3,) [A/s].
    """
    resistance, inductance, emf = _motor_constants(arm)
    return (np.asarray(v) - resistance * np.asarray(current) - emf * np.asarray(qd)) / inductance


def _motor_constants(arm: ArmParameters) -> np.ndarray:
    """R, L and ke N of the three motors."""
    return np.array([(m.resistance, m.inductance, m.back_emf * m.gear_ratio) for m in arm.motors]).T
