# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a voltage on one joint does to the innovations of all: joints move each other by their inertia.

The error of a predicted state obeys e' = A e + B V between rows, V the voltage that the model lacks, and loses K C e at
a row, K the predictor's gains. A holds the inertia of all joints, of the usual pose of the log; what a joint does to
another then goes with their term of the inverse at the pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from puma_sim_core.effects.screening import Signals
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.fitting.predictor import Predictor, innovations_of

#: (joint that is moved, joint of the voltage), both 0-based
Pair = tuple[int, int]


@dataclass(frozen=True)
class Coupling:
    """responses : pair -> (k,) innovations [rad/V] of the first after one row of a volt on the second; shares : pair of
    two joints -> (N,) their term of the inverse inertia at the pose, over that of the response."""

    responses: dict[Pair, Floats]
    shares: dict[Pair, Floats]

    @staticmethod
    def of(predictor: Predictor, theta: Floats, signals: Signals) -> Coupling:
        """The coupling of a model along a motion. signals : of it."""
        mechanism = predictor.mechanism
        mobility = np.linalg.inv(mechanism.inertia_matrix(theta, signals.position) + np.diag(signals.motor_inertia))
        mean = mobility.mean(axis=0)
        # of a term that changes its sign the mean says little
        usual = np.where(mean < 0.0, -1.0, 1.0) * np.sqrt(np.mean(mobility**2, axis=0))
        np.fill_diagonal(usual, mean.diagonal())
        joints = range(mechanism.joints)
        pairs = [(i, j) for i in joints for j in joints if usual[i, j] != 0.0]
        made = _responses(predictor, signals, usual)
        shares = {(i, j): mobility[:, i, j] / usual[i, j] for i, j in pairs if i != j}
        return Coupling({(i, j): made[j][:, i] for i, j in pairs}, shares)


def _responses(predictor: Predictor, signals: Signals, mobility: Floats) -> list[Floats]:
    """For each joint the innovations (k, J) of all after a volt on it in one row. mobility (J, J) : inverse inertia."""
    gains = [gain for _, _, gain in predictor.linear]
    first = np.cumsum([0, *(len(gain) for gain in gains)])
    n, joints = int(first[-1]), len(gains)
    A, B, K, C = np.zeros((n, n)), np.zeros((n, joints)), np.zeros((n, joints)), np.zeros((joints, n))
    for j, gain in enumerate(gains):
        q, w = first[j], first[j] + 1
        A[q, w], C[j, q], K[q : q + len(gain), j] = 1.0, 1.0, gain
        k, lag, emf = signals.volts_per_torque[j], signals.lag[j], signals.emf[j]
        # torques of the joint, which move all: as in `Predictor`, torque in volts where the current lags
        torque, volt = np.zeros(n), 0.0
        torque[w] = -signals.viscous[j]
        if len(gain) == 3:
            torque[w + 1] = 1.0 / k
            A[w + 1, w], A[w + 1, w + 1], B[w + 1, j] = -emf / lag, -1.0 / lag, 1.0 / lag
        else:
            torque[w] -= emf / k
            volt = 1.0 / k
        for i in range(joints):
            A[first[i] + 1] += mobility[i, j] * torque
            B[first[i] + 1, j] += mobility[i, j] * volt
    block = np.zeros((n + joints, n + joints))
    block[:n, :n], block[:n, n:] = A * predictor.step, B * predictor.step
    block = expm(block)
    F, G = block[:n, :n], block[:n, n:]
    kept = F @ (np.eye(n) - K @ C)
    return [innovations_of(kept, -G[:, j], C) for j in range(joints)]
