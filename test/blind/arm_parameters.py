# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Numbers of the arm "bejczy" and its rigid-body voltages in closed form.

Source: the design notes' page on the model, sections 1 to 3 (thesis section 4.5, corrected).
The closed form serves to say how large an effect was; the motion itself is MuJoCo's.
"""

from __future__ import annotations

import numpy as np

A2, A3, D3, GRAVITY = 0.4318, -0.0191, 0.1505, 9.81
GEAR = np.array([62.55, 107.81, 53.63])
RANGES = np.deg2rad([[-160.0, 160.0], [-223.0, 43.0], [-52.0, 232.0]])
COUNTS = 1000  # of the encoder, a motor turn
QUANTUM = 2.0 * np.pi / (COUNTS * GEAR)

#: start values, three joints or links each, in the order of a vector of 39
NOMINAL = {
    "m": (12.96, 22.37, 6.97),
    "x": (0.0, -0.3289, 0.0136),
    "y": (0.3088, 0.0050, 0.0092),
    "z": (0.0389, 0.2038, 0.1522),
    "kxx": (0.1816, 0.0596, 0.0783),
    "kyy": (0.0152, 0.1930, 0.0786),
    "kzz": (0.1811, 0.1514, 0.0021),
    "Ia": (0.7766, 2.3616, 0.5827),
    "H": (5.80, 9.50, 3.98),
    "R": (1.6, 1.6, 1.6),
    "L": (4.8e-3, 4.8e-3, 4.8e-3),
    "ke": (0.26, 0.26, 0.26),
    "kt": (0.2611, 0.2611, 0.2611),
}
NAMES = tuple(NOMINAL)
#: relative width of what retuning takes as usual; viscous friction is less well known
WIDTH = {name: 0.25 if name == "H" else 0.06 for name in NAMES}

Parameters = dict[str, np.ndarray]


def nominal() -> Parameters:
    """The start values as arrays (3,)."""
    return {name: np.array(value) for name, value in NOMINAL.items()}


def wrong(rng: np.random.Generator) -> Parameters:
    """A true plant: up to 8 % beside the start values, viscous friction 25 %.

    Drawn again until D + Ia is safely positive definite in every pose, also with 30 % of the Ia of
    one joint, as the links of an elastic drive have it.
    """
    for _ in range(200):
        p = {
            name: np.round(value * (1.0 + rng.uniform(-1.0, 1.0, 3) * (0.25 if name == "H" else 0.08)), 9)
            for name, value in nominal().items()
        }
        if least_eigenvalue(p) > 0.35 and all(least_eigenvalue(p, 1.0 - 0.7 * np.eye(3)[j]) > 0.1 for j in range(3)):
            return p
    raise RuntimeError("no arm with a positive definite inertia was drawn")


def least_eigenvalue(p: Parameters, motor_share=(1.0, 1.0, 1.0)) -> float:
    """Smallest eigenvalue of D + share Ia over the poses."""
    q2, q3 = np.meshgrid(np.linspace(-3.9, 0.8, 25), np.linspace(-0.95, 4.1, 27))
    q = np.stack([np.zeros(q2.size), q2.ravel(), q3.ravel()], axis=1)
    D = inertia(q, p) + np.diag(np.asarray(motor_share) * p["Ia"])
    return float(np.linalg.eigvalsh(D).min())


def _angles(q):
    q2, q23 = q[:, 1], q[:, 1] + q[:, 2]
    return (np.sin(q2), np.cos(q2), np.sin(q[:, 2]), np.cos(q[:, 2]), np.sin(q23), np.cos(q23))


def inertia(q, p: Parameters) -> np.ndarray:
    """D (n, 3, 3) of the links alone at poses q (n, 3)."""
    S2, C2, S3, C3, S23, C23 = _angles(q)
    (m1, m2, m3), (_, x2, x3), (_, y2, y3), (_, z2, z3) = p["m"], p["x"], p["y"], p["z"]
    (_, xx2, xx3), (yy1, yy2, yy3), (_, zz2, zz3) = p["kxx"], p["kyy"], p["kzz"]
    D = np.empty((len(q), 3, 3))
    D[:, 0, 0] = (
        m1 * yy1
        + m2 * (xx2 * S2**2 + yy2 * C2**2 + (A2**2 + 2 * A2 * x2) * C2**2 - 2 * A2 * y2 * S2 * C2)
        + m3
        * (
            xx3 * S23**2
            + zz3 * C23**2
            + D3**2
            + 2 * y3 * D3
            + A2**2 * C2**2
            + A3**2 * C23**2
            + 2 * A2 * A3 * C2 * C23
            + 2 * x3 * (A2 * C2 * C23 + A3 * C23**2)
            + 2 * z3 * (A3 * C23 * S23 + A2 * C2 * S23)
        )
    )
    D[:, 0, 2] = m3 * ((D3 * x3 + A3 * y3 + A3 * D3) * S23 - D3 * z3 * C23)
    D[:, 0, 1] = m2 * A2 * z2 * S2 + m3 * A2 * (y3 + D3) * S2 + D[:, 0, 2]
    D33 = m3 * (yy3 + A3**2 + 2 * A3 * x3)
    h = m3 * A2 * ((A3 + x3) * C3 + z3 * S3)
    D[:, 2, 2], D[:, 1, 2] = D33, D33 + h
    D[:, 1, 1] = m2 * (zz2 + A2**2 + 2 * A2 * x2) + m3 * A2**2 + D33 + 2 * h
    D[:, 1, 0], D[:, 2, 0], D[:, 2, 1] = D[:, 0, 1], D[:, 0, 2], D[:, 1, 2]
    return D


def gravity(q, p: Parameters) -> np.ndarray:
    """G (n, 3) [N.m]."""
    S2, C2, _, _, S23, C23 = _angles(q)
    g2, s2, g3, s3 = gravity_constants(p)
    third = g3 * C23 + s3 * S23
    return np.stack([np.zeros(len(q)), g2 * C2 + s2 * S2 + third, third], axis=1)


def gravity_constants(p: Parameters) -> tuple[float, float, float, float]:
    """Coefficients of C2, S2, C23, S23 in the gravity torques [N.m]."""
    (_, m2, m3), (_, x2, x3), (_, y2, _), (_, _, z3) = p["m"], p["x"], p["y"], p["z"]
    return (-GRAVITY * (m2 * (x2 + A2) + m3 * A2), GRAVITY * m2 * y2, -GRAVITY * m3 * (x3 + A3), -GRAVITY * m3 * z3)


def coriolis(q, qd, p: Parameters) -> np.ndarray:
    """qd' C qd (n, 3) [N.m]."""
    S2, C2, S3, C3, S23, C23 = _angles(q)
    (_, m2, m3), (_, x2, x3), (_, y2, y3), (_, z2, z3) = p["m"], p["x"], p["y"], p["z"]
    (_, xx2, xx3), (_, yy2, _), (_, _, zz3) = p["kxx"], p["kyy"], p["kzz"]
    C113 = m3 * (
        (xx3 - zz3 - A3**2 - 2 * A3 * x3) * S23 * C23
        - A2 * (A3 + x3) * C2 * S23
        + A3 * z3 * (2 * C23**2 - 1)
        + A2 * z3 * C2 * C23
    )
    C112 = (
        m2 * ((xx2 - yy2 - A2**2 - 2 * A2 * x2) * S2 * C2 - A2 * y2 * (C2**2 - S2**2))
        - m3 * A2**2 * S2 * C2
        + C113
        - m3 * A2 * ((A3 + x3) * S2 * C23 + z3 * S2 * S23)
    )
    e = m3 * ((D3 * x3 + A3 * y3 + A3 * D3) * C23 + D3 * z3 * S23)
    C122 = m2 * A2 * z2 * C2 + m3 * A2 * (y3 + D3) * C2 + e
    C223 = m3 * A2 * (z3 * C3 - (A3 + x3) * S3)
    a, b, c = qd.T
    return np.stack(
        [
            2 * a * (C112 * b + C113 * c) + C122 * b**2 + e * (2 * b * c + c**2),
            -C112 * a**2 + C223 * (2 * b * c + c**2),
            -C113 * a**2 - C223 * b**2,
        ],
        axis=1,
    )


def motor_torque(q, qd, qdd, p: Parameters) -> np.ndarray:
    """Torque (n, 3) [N.m] that the motors must give at the joints: rigid arm, viscous friction."""
    return (
        np.einsum("nij,nj->ni", inertia(q, p), qdd) + coriolis(q, qd, p) + gravity(q, p) + p["Ia"] * qdd + p["H"] * qd
    )


def voltage(q, qd, qdd, step: float, p: Parameters) -> np.ndarray:
    """Voltage (n, 3) [V] of that motion, sampled every `step` [s]."""
    torque = motor_torque(q, qd, qdd, p)
    k = p["R"] / (GEAR * p["kt"])
    lagged = torque + p["L"] / p["R"] * np.gradient(torque, step, axis=0)
    return k * lagged + p["ke"] * GEAR * qd
