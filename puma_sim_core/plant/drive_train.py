# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Constants that `two_mass` takes of a plant whose links do not follow their motors exactly."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import ceil, floor, log10, sqrt

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.parameters import smallest_eigenvalue, within_a_turn
from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.effects import Effect
from puma_sim_core.effects.base import Train
from puma_sim_core.effects.registry import vanishes
from puma_sim_core.effects.shared.drive_train import in_series
from puma_sim_core.errors import ParameterError

#: phase of the fastest vibration in a step [rad]: RK4 then turns it by 2e-4 of itself too little and damps it by 7e-5
_PHASE_IN_A_STEP = 0.4
#: decay of the fastest damped motion in a step; RK4 is stable up to 2.7
_DECAY_IN_A_STEP = 1.0
#: spacing of the poses that the fastest vibration is looked for at [rad]
_POSES = 0.2


class DriveTrains:
    """The drive trains of an arm.

    Parameters
    ----------
    arm : with its loads attached.
    effects : of the plant; those that vanish count as absent.
    drive : the constants of the motors, as the kernel takes them.

    Attributes
    ----------
    link_arm : the arm whose motor inertias are what turns with the links alone: none where a joint
        is rigid (the rotor's is added by `two_mass`), a part where rotor and link are two masses.
    table : numbers of `effects.shared.drive_train`, joint by joint, and the least steps in a second.

    Raises ParameterError: D + (1 - motor_share) Ia not positive definite, with the pose; two shares on one joint; a
    motor without inertia.
    """

    def __init__(self, arm: ArmParameters, effects: Iterable[Effect], drive: Sequence[float]):
        acting = [effect for effect in effects if not vanishes(effect)]
        found = [
            [e.kind.train(e.values) for e in acting if e.kind.train is not None and e.joint == joint]
            for joint in (1, 2, 3)
        ]
        shares = [_share(trains, joint) for joint, trains in enumerate(found, start=1)]
        own = [motor.inertia for motor in arm.motors]
        remaining = [0.0 if share is None else (1.0 - share) * Ia for share, Ia in zip(shares, own)]
        self.link_arm = _with_inertias(arm, remaining)
        _check(arm, shares)
        trains = [_train(*each) for each in zip(found, (1, 2, 3), shares, own)]
        self.table = [number for train in trains for number in train]
        self.table.append(_least_rate(arm, acting, remaining, trains, drive))


def _check(arm: ArmParameters, shares: list[float | None]) -> None:
    """Raise where D + (1 - motor_share) Ia is not positive definite."""
    joints = [j for j, share in enumerate(shares, start=1) if share is not None]
    if not joints:
        return
    inertias = [m.inertia if share is None else (1.0 - share) * m.inertia for share, m in zip(shares, arm.motors)]
    lowest, q2, q3 = smallest_eigenvalue(_with_inertias(arm, inertias))
    if not lowest > 0.0:
        raise ParameterError(
            "the inertia of the links, D + (1 - motor_share) Ia, is not positive definite: its "
            f"smallest eigenvalue is {lowest:.4g} kg.m^2 at q2 = {np.degrees(q2):.1f} deg, "
            f"q3 = {np.degrees(q3):.1f} deg",
            where="elasticity or backlash on joint " + ", ".join(map(str, joints)),
            expected="a smaller motor_share, or another parameter set",
        )


def _least_rate(
    arm: ArmParameters, acting: list[Effect], remaining: list[float], trains: list[list[float]], drive: Sequence[float]
) -> float:
    """Steps in a second [1/s], two digits, that hold the fastest motion of the trains."""
    soft = [j for j in range(3) if trains[j][0]]
    if not soft:
        return 0.0
    matrix = np.diag([remaining[j] if j in soft else arm.motors[j].inertia for j in range(3)])
    links = np.linalg.inv(inertia(_poses(arm), arm) + matrix)
    rotors = np.diag([1.0 / trains[j][4] for j in soft])
    # 1/m of two masses with a spring between, m the reduced mass
    mobility = rotors + links[:, soft][:, :, soft]
    stiffness, damping = np.zeros(3), np.zeros(3)
    electric, braking = 0.0, 0.0
    for j in soft:
        _, stiffness[j], damping[j], _, rotor, amplitude, order, _ = trains[j]
        slope = (1.0 + amplitude * order) ** 2
        stiffness[j] *= slope
        damping[j] *= slope
        admittance, resistance, emf, kT, viscous = drive[5 * j : 5 * j + 5]
        braking = max(braking, (viscous + kT * emf / resistance) / rotor)
        electric = max(electric, sqrt(admittance * kT * emf / rotor))
        # one of the two masses alone is never easier to move than both against each other
        for effect in acting:
            if effect.kind.stiffening is not None and effect.joint == j + 1:
                further = effect.kind.stiffening(effect.values)
                stiffness[j] += further[0]
                damping[j] += further[1]
    frequency = sqrt(_greatest(mobility, stiffness[soft]))
    decay = _greatest(mobility, damping[soft]) + max(braking, electric)
    return _two_digits(max(frequency / _PHASE_IN_A_STEP, decay / _DECAY_IN_A_STEP))


def _share(trains: list[Train], joint: int) -> float | None:
    """motor_share of a joint, None where it is rigid."""
    shares = {train.motor_share for train in trains if train.motor_share is not None}
    if len(shares) > 1:
        what, where = f"motor_share {' and '.join(f'{s:g}' for s in sorted(shares))}", f"joint {joint}"
        raise ParameterError(what, where=f"elasticity and backlash of {where}", expected="the same: it has one rotor")
    return shares.pop() if shares else None


def _train(trains: list[Train], joint: int, share: float | None, motor_inertia: float) -> list[float]:
    springs = [train.spring for train in trains if train.spring is not None]
    wave = next((train.wave for train in trains if train.wave is not None), (0.0, 0.0, 0.0))
    if not springs:
        return [0.0, 0.0, 0.0, 0.0, float(motor_inertia), *wave]
    if share is None or not share * motor_inertia > 0.0:
        raise ParameterError(
            f"motor inertia {motor_inertia:g} kg.m^2",
            where=f"elasticity or backlash on joint {joint}",
            expected="more than 0: the rotor moves against its link",
        )
    gap = sum(train.gap for train in trains)
    return [1.0, *in_series(springs), 0.5 * gap, float(share * motor_inertia), *wave]


def _with_inertias(arm: ArmParameters, inertias: Iterable[float]) -> ArmParameters:
    first, second, third = (replace(motor, inertia=float(Ia)) for motor, Ia in zip(arm.motors, inertias))
    return replace(arm, motors=(first, second, third))


def _poses(arm: ArmParameters) -> np.ndarray:
    second, third = (np.linspace(low, high, int((high - low) / _POSES) + 2) for low, high in within_a_turn(arm))
    second, third = np.meshgrid(second, third, indexing="ij")
    return np.stack([np.zeros(second.size), second.ravel(), third.ravel()], axis=-1)


def _greatest(mobility: np.ndarray, weights: np.ndarray) -> float:
    """Greatest eigenvalue of weights times mobility over all poses, made symmetric."""
    root = np.sqrt(weights)
    return float(np.linalg.eigvalsh(root[:, None] * mobility * root).max())


def _two_digits(value: float) -> float:
    """The value rounded up to two digits: the last bits of an eigenvalue differ by machine."""
    scale = 10.0 ** (floor(log10(value)) - 1)
    return ceil(value / scale) * scale
