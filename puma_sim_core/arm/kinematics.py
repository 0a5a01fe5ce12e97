# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Kinematics of the six links: homogeneous transforms and their derivatives (chapter 2).

Standard (distal) Denavit-Hartenberg: joint i turns about z_{i-1}, and the transform from frame i-1
to frame i is Rot(z, q) Trans(z, d) Trans(x, a) Rot(x, alpha). At q = 0 the upper arm is horizontal
along x0 and the forearm points up; positive q2 and q3 turn the arm down. Misprints of the thesis's
matrices are corrected: the offset d3 stands in the third transform, and the second has none.
All functions accept complex angles.
"""

from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters

#: twist of each link [rad], section 2.3
_ALPHA = np.radians([-90.0, 0.0, 90.0, -90.0, 90.0, 0.0])

#: derivative of a rotation about z: dT/dq = Q T (equation 2.2)
Q = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
Q.setflags(write=False)


def dh_table(arm: ArmParameters) -> np.ndarray:
    """(6, 3) rows (a [m], alpha [rad], d [m]) of the six links, section 2.3."""
    lengths = [0.0, arm.a2, arm.a3, 0.0, 0.0, 0.0]
    offsets = [0.0, 0.0, arm.d3, arm.d4, 0.0, 0.0]
    return np.column_stack([lengths, _ALPHA, offsets])


def dh_transform(q: complex, a: float, alpha: float, d: float) -> np.ndarray:
    """(4, 4) transform from frame i-1 to frame i; q, alpha [rad], a, d [m]; section 2.3."""
    s, c = np.sin(q), np.cos(q)
    # twists are quarter turns, whose sine and cosine should be exact
    sa, ca = _exact(np.sin(alpha)), _exact(np.cos(alpha))
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0.0, sa, ca, d], [0.0, 0.0, 0.0, 1.0]])


def link_transforms(q: ArrayLike, arm: ArmParameters | ArrayLike) -> np.ndarray:
    """Transforms from the base to frames 0 to n, for the first n joints.

    q : (n,) joint angles [rad], n from 0 to 6 for an arm; arm : ArmParameters, or a table (m, 3)
    of rows (a, alpha, d) with m >= n. Returns (n + 1, 4, 4), the first of them the identity.

    Raises ValueError: more angles than links.
    """
    q, table = _arguments(q, arm)
    out = np.empty((len(q) + 1, 4, 4), dtype=q.dtype)
    out[0] = np.eye(4)
    for i, row in enumerate(table):
        out[i + 1] = out[i] @ dh_transform(q[i], *row)
    return out


def forward_kinematics(q: ArrayLike, arm: ArmParameters | ArrayLike) -> np.ndarray:
    """(4, 4) transform from the base to the last of the n given joints' frames."""
    return link_transforms(q, arm)[-1]


def elbow_position(q: ArrayLike, arm: ArmParameters) -> np.ndarray:
    """(3,) origin of frame 2 in the base frame [m]; q: (at least 2,) [rad]."""
    return link_transforms(np.asarray(q)[:2], arm)[-1][:3, 3]


def wrist_position(q: ArrayLike, arm: ArmParameters) -> np.ndarray:
    """(3,) point where the axes of the wrist meet, in the base frame [m].

    q : (at least 3,) [rad]; joints 4 to 6 turn about this point and do not move it.
    """
    frame = link_transforms(np.asarray(q)[:3], arm)[-1]
    return frame[:3, 3] + arm.d4 * frame[:3, 2]


def wrist_path(q: ArrayLike, arm: ArmParameters) -> np.ndarray:
    """`wrist_position` of many poses at once, in closed form.

    q : (..., at least 3) [rad]. Returns (..., 3) [m]: X e_r + d3 e_t - Y z0 with X = a2 C2 + a3 C23 + d4 S23 and
    Y = a2 S2 + a3 S23 - d4 C23, where e_r and e_t turn with joint 1.
    """
    q = as_angles(q)
    return wrist_motion(q, np.zeros(q.shape), arm)[0]


def wrist_motion(q: ArrayLike, qd: ArrayLike, arm: ArmParameters) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of the wrist, the derivative of `wrist_path` with time.

    q [rad], qd [rad/s] : (..., at least 3). Returns [m] and [m/s], (..., 3) each.
    """
    q, qd = as_angles(q), as_angles(qd)
    s1, s2, s23 = (np.sin(angle) for angle in (q[..., 0], q[..., 1], q[..., 1] + q[..., 2]))
    c1, c2, c23 = (np.cos(angle) for angle in (q[..., 0], q[..., 1], q[..., 1] + q[..., 2]))
    x = arm.a2 * c2 + arm.a3 * c23 + arm.d4 * s23
    y = arm.a2 * s2 + arm.a3 * s23 - arm.d4 * c23
    turning, tilting, bending = qd[..., 0], qd[..., 1], qd[..., 1] + qd[..., 2]
    xd = (arm.d4 * c23 - arm.a3 * s23) * bending - arm.a2 * s2 * tilting
    yd = (arm.d4 * s23 + arm.a3 * c23) * bending + arm.a2 * c2 * tilting
    ahead, aside = x * c1 - arm.d3 * s1, x * s1 + arm.d3 * c1
    position = np.stack([ahead, aside, -y], axis=-1)
    return position, np.stack([xd * c1 - aside * turning, xd * s1 + ahead * turning, -yd], axis=-1)


def first_derivatives(q: ArrayLike, arm: ArmParameters | ArrayLike) -> np.ndarray:
    """dT_p/dq_i of the frames 1 to n, equation 2.3.

    Arguments of :func:`link_transforms`. Returns (n, n, 4, 4), [p - 1, i - 1]; zero where joint i
    is outside frame p.
    """
    q, table = _arguments(q, arm)
    n = len(q)
    steps = [dh_transform(angle, *row) for angle, row in zip(q, table)]
    #: transforms from frame i to the frames i to n
    between = [list(accumulate(steps[i:], np.matmul, initial=np.eye(4))) for i in range(n + 1)]
    out = np.zeros((n, n, 4, 4), dtype=q.dtype)
    for p in range(n):
        for i in range(p + 1):
            out[p, i] = between[0][i] @ Q @ between[i][p + 1 - i]
    return out


def _arguments(q: ArrayLike, arm: ArmParameters | ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    q = as_angles(q)
    table = dh_table(arm) if isinstance(arm, ArmParameters) else np.asarray(arm, dtype=float)
    if q.ndim != 1 or len(q) > len(table):
        raise ValueError(f"angles of shape {q.shape} for {len(table)} links; expected (n,) with n at most {len(table)}")
    return q, table[: len(q)]


def as_angles(q: ArrayLike) -> np.ndarray:
    """Angles as an array, real or complex."""
    q = np.asarray(q)
    return q if q.dtype.kind in "fc" else q.astype(float)


def _exact(value: float) -> float:
    return np.round(value) if abs(value - np.round(value)) < 1e-15 else value
