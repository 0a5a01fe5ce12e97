# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Effects that the library does not have: they must be left unnamed, with their axis and joint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from blind import drives
from blind.effects import UNIT


@dataclass(frozen=True)
class Outsider:
    """draw : (rng, joint) -> (a, b, c, d) at strength 1, which scales a; axis : words of the
    axis that shows it, the best first; most : greatest strength."""

    kind: int
    draw: Callable
    axes: Callable
    motions: tuple[str, ...] = ("fourier", "wide", "points")
    joints: tuple[int, ...] = (0, 1, 2)
    most: float = 40.0
    start: float = 4.0


def _other(rng, j):
    return float(rng.choice([k for k in range(3) if k != j]))


def _fixed(*axes):
    return lambda values: list(axes)


OUTSIDE: dict[str, Outsider] = {
    "cable_from_another_joint": Outsider(
        drives.CABLE,
        lambda rng, j: (UNIT[j], rng.uniform(2.0, 4.0), rng.uniform(-1.5, 1.5), _other(rng, j)),
        lambda values: [f"position of joint {int(values[3]) + 1}"],
        ("wide", "fourier"),
    ),
    "cubic_spring": Outsider(
        drives.CUBIC_SPRING,
        lambda rng, j: (4.0 * UNIT[j], (0.0, -1.2, 1.2)[j] + rng.uniform(-0.2, 0.2), 0.0, 0.0),
        _fixed("position"),
        ("wide", "fourier"),
    ),
    "friction_step_in_time": Outsider(
        drives.FRICTION_STEP, lambda rng, j: (UNIT[j], rng.uniform(3.5, 6.5), 0.0, 0.0), _fixed("time", "velocity")
    ),
    "torque_step_in_time": Outsider(
        drives.TORQUE_STEP,
        lambda rng, j: (UNIT[j] * rng.choice([-1.0, 1.0]), rng.uniform(3.0, 7.0), 0.0, 0.0),
        _fixed("time"),
    ),
    "shake_in_time": Outsider(
        drives.SHAKE, lambda rng, j: (UNIT[j], rng.uniform(3.0, 9.0), rng.uniform(-np.pi, np.pi), 0.0), _fixed("time")
    ),
    "torque_of_absolute_acceleration": Outsider(
        drives.EVEN_INERTIA,
        lambda rng, j: (0.05, 0.0, 0.0, 0.0),
        _fixed("acceleration"),
        ("bang", "points", "bang"),
        most=30.0,
    ),
    "square_wave_over_position": Outsider(
        drives.SQUARE, lambda rng, j: (UNIT[j], rng.uniform(0.2, 0.6), rng.uniform(0.0, 1.0), 0.0), _fixed("position")
    ),
    "viscous_by_direction": Outsider(
        drives.EVEN_VISCOUS, lambda rng, j: (UNIT[j] * rng.choice([-1.0, 1.0]), 0.0, 0.0, 0.0), _fixed("velocity")
    ),
    "play_of_the_voltage": Outsider(
        drives.VOLTAGE_PLAY,
        lambda rng, j: (0.06, 0.0, 0.0, 0.0),
        _fixed("voltage", "velocity"),
        ("fourier", "points", "triangles"),
    ),
    "gain_by_direction": Outsider(
        drives.EVEN_GAIN, lambda rng, j: (0.006 * rng.choice([-1.0, 1.0]), 0.0, 0.0, 0.0), _fixed("voltage", "velocity")
    ),
    "torque_by_direction_of_load": Outsider(
        drives.EVEN_TORQUE, lambda rng, j: (0.02, 0.0, 0.0, 0.0), _fixed("torque"), joints=(0, 2), most=20.0
    ),
    "ripple_of_the_current": Outsider(
        drives.CURRENT_RIPPLE,
        lambda rng, j: (UNIT[j] / 3.0, float(rng.choice([1.0, 2.0])), rng.uniform(-3.0, 3.0), 0.0),
        _fixed("motor_angle"),
        ("constant", "triangles"),
        joints=(1, 2),
    ),
    "leak_from_another_motor": Outsider(drives.LEAK, lambda rng, j: (0.006, 0.0, 0.0, _other(rng, j)), _fixed(None)),
}


def put(table: np.ndarray, name: str, joint: int, values) -> None:
    """Enters an outsider with its values (a, b, c, d)."""
    table[joint, drives.OUTSIDE] = OUTSIDE[name].kind
    table[joint, drives.OUT_A : drives.OUT_D + 1] = values
