# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm linearised about a pose at rest, exactly sampled, and the loop that PID closes around it.

Some joints are free and the others truly locked (their rows and columns removed). About a pose the free ones obey
``M qdd = kT i - H qd - (dG/dq) q`` and ``L di/dt = v - R i - ke N qd``, the third-order model of chapter 5 without what
vanishes at rest. Of the effects, viscous friction and loads are in it. All functions take many poses at once.
"""

from collections.abc import Sequence
from math import inf

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from puma_sim_core.arm.rigid_body import gravity_torque, inertia
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.pid import PidGains


def is_linear(plant: Plant) -> bool:
    """Whether the plant has nothing that the linearised joints lack, as no effect that needs a
    stage of the kernel is in them. (Nor is a limit of the voltage in them.)"""
    return plant.constants.active == 0


def stiffness(plant: Plant, pose: ArrayLike) -> np.ndarray:
    """dG/dq at poses (..., 3) [rad]: (..., 3, 3) [N.m/rad], by the complex step."""
    pose = np.asarray(pose, dtype=float)
    out = np.empty(pose.shape + (3,))
    for j in range(3):
        moved = pose.astype(complex)
        moved[..., j] += 1e-30j
        out[..., :, j] = gravity_torque(moved, plant.loaded_arm).imag / 1e-30
    return out


def linearised(plant: Plant, pose: ArrayLike, joints: Sequence[int] = (1, 2, 3)) -> tuple[np.ndarray, np.ndarray]:
    """(A, B) of dx/dt = A x + B v about poses (..., 3) [rad] at rest.

    joints : the n free ones, 1-based. x = (q, qd, i) of the free joints, as deviations; A is
    (..., 3n, 3n), B (3n, n); q [rad], i [A], v [V].
    """
    at = [joint - 1 for joint in joints]
    n = len(at)
    pose = np.asarray(pose, dtype=float)
    motors = [plant.arm.motors[j] for j in at]
    m = inertia(pose, plant.loaded_arm)[..., at, :][..., at] + np.diag([motor.inertia for motor in motors])
    inverse = np.linalg.inv(m)
    a = np.zeros(pose.shape[:-1] + (3 * n, 3 * n))
    a[..., :n, n : 2 * n] = np.eye(n)
    a[..., n : 2 * n, :n] = -inverse @ stiffness(plant, pose)[..., at, :][..., at]
    a[..., n : 2 * n, n : 2 * n] = -inverse * [plant.viscous_friction[j] for j in at]
    a[..., n : 2 * n, 2 * n :] = inverse * [plant.torque_per_ampere[j] for j in at]
    a[..., 2 * n :, n : 2 * n] = -np.diag([k.back_emf * k.gear_ratio / k.inductance for k in motors])
    a[..., 2 * n :, 2 * n :] = -np.diag([k.resistance / k.inductance for k in motors])
    b = np.zeros((3 * n, n))
    b[2 * n :] = np.diag([1.0 / k.inductance for k in motors])
    return a, b


def sampled(a: np.ndarray, b: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """(F, G) of x(k+1) = F x(k) + G v, exact for a voltage held over a sample of `period` [s].

    a : (..., N, N); b : (N, n). The matrix exponential of both together.
    """
    size, n = b.shape
    joined = np.zeros(a.shape[:-2] + (size + n, size + n))
    joined[..., :size, :size] = a
    joined[..., :size, size:] = b
    joined = expm(joined * period)
    return joined[..., :size, :size], joined[..., :size, size:]


def proportional_loop(f: np.ndarray, g: np.ndarray, gain: ArrayLike, delay: int = 0) -> np.ndarray:
    """The map of one joint's loop under proportional control, (..., 3 + delay, 3 + delay).

    f : (..., 3, 3); g : (..., 3, 1); gain : (...) [V/rad], they broadcast. The voltages on their
    way are states: the oldest acts, the newest answers q.
    """
    gain = np.asarray(gain, dtype=float)
    shape = np.broadcast_shapes(gain.shape, f.shape[:-2])
    loop = np.zeros(shape + (3 + delay, 3 + delay))
    loop[..., :3, :3] = f
    if delay == 0:
        loop[..., :3, 0] -= gain[..., None] * g[..., 0]
        return loop
    loop[..., :3, 3] = g[..., 0]
    for i in range(3, 2 + delay):
        loop[..., i, i + 1] = 1.0
    loop[..., 2 + delay, 0] = -gain
    return loop


def pid_loop(f: np.ndarray, g: np.ndarray, gains: Sequence[PidGains], period: float, delay: int = 0) -> np.ndarray:
    """The map of the loops of n joints under the digital servo's PID law.

    f : (..., 3n, 3n); g : (..., 3n, n), of `sampled`; gains : one a joint. States: x, the sums of those with integral
    action, the last positions of those with derivative action, and the voltages on their way. Square, of that size.
    """
    n = len(gains)
    summed = [j for j in range(n) if gains[j].integral_time < inf]
    kept = [j for j in range(n) if gains[j].derivative_time > 0.0]
    sums = {j: 3 * n + i for i, j in enumerate(summed)}
    last = {j: 3 * n + len(summed) + i for i, j in enumerate(kept)}
    late = 3 * n + len(summed) + len(kept)
    size = late + n * delay
    law = np.zeros((n, size))
    loop = np.zeros(f.shape[:-2] + (size, size))
    loop[..., : 3 * n, : 3 * n] = f
    for j, k in enumerate(gains):
        law[j, j] = -k.gain
        if j in sums:
            rate = period / k.integral_time
            loop[..., sums[j], sums[j]] = 1.0
            loop[..., sums[j], j] = -rate
            law[j, j] -= k.gain * rate
            law[j, sums[j]] = k.gain
        if j in last:
            rate = k.derivative_time / period
            loop[..., last[j], j] = 1.0
            law[j, j] -= k.gain * rate
            law[j, last[j]] = k.gain * rate
    if delay == 0:
        loop[..., : 3 * n, :] += g @ law
        return loop
    loop[..., : 3 * n, late : late + n] = g
    for i in range(late, late + n * (delay - 1)):
        loop[..., i, i + n] = 1.0
    loop[..., size - n :, :] = law
    return loop


def radius(loop: np.ndarray) -> np.ndarray:
    """Greatest magnitude of a map's eigenvalues, (...): the loop is stable where it is below 1."""
    return np.abs(np.linalg.eigvals(loop)).max(axis=-1)


def least_damped(loop: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Damping ratio [-] and period [s] of the oscillation that dies out last in relative terms.

    Of the eigenvalues z of a map (..., N, N) that oscillate, s = log(z) / period, the one with
    the least -Re s / |s|. NaN where nothing oscillates; negative damping is an oscillation that grows. Shapes (...).
    """
    z = np.linalg.eigvals(loop)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.log(z) / period
        damping = np.where((np.abs(z) > 1e-12) & (np.abs(s.imag) > 1e-9), -s.real / np.abs(s), np.nan)
        none = np.isnan(damping).all(axis=-1)
        which = np.argmin(np.where(np.isnan(damping), inf, damping), axis=-1)[..., None]
        at = np.take_along_axis(s, which, -1)[..., 0]
        ratio = np.take_along_axis(damping, which, -1)[..., 0]
        return (np.where(none, np.nan, ratio), np.where(none, np.nan, 2.0 * np.pi / np.abs(at.imag)))
