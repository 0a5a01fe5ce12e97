# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the arm is: links, motors and geometry of a rigid three-link PUMA 560, with their units."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Link:
    """Mass and its distribution, in the frame of the link (section 2.2: distal frames).

    mass [kg]; centre (x, y, z) of mass [m]; gyration_squared (xx, yy, zz) [m^2], the squares of the
    radii of gyration about the axes of the link frame; products (xy, yz, xz) [m^2], each the mean
    of the product of the two coordinates over the mass, about the same origin.
    """

    mass: float
    centre: tuple[float, float, float]
    gyration_squared: tuple[float, float, float]
    products: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def pseudo_inertia(self) -> np.ndarray:
        """(4, 4) matrix of the integrals of r r' dm with r = (x, y, z, 1); equation 3.8.

        Units: kg.m^2 in the upper left 3 x 3, kg.m in the last row and column, kg in the corner.
        """
        kxx, kyy, kzz = self.gyration_squared
        pxy, pyz, pxz = self.products
        x, y, z = self.centre
        return self.mass * np.array(
            [
                [(kyy + kzz - kxx) / 2, pxy, pxz, x],
                [pxy, (kzz + kxx - kyy) / 2, pyz, y],
                [pxz, pyz, (kxx + kyy - kzz) / 2, z],
                [x, y, z, 1.0],
            ]
        )


@dataclass(frozen=True)
class Motor:
    """One permanent-magnet motor with its gears (section 5.1).

    resistance [ohm], inductance [H], back_emf [V.s/rad] and torque_constant [N.m/A] at the motor
    shaft, gear_ratio [-] (turns of the motor for one of the joint), inertia [kg.m^2] of rotor and
    gears reflected to the joint (Ia).
    """

    resistance: float
    inductance: float
    back_emf: float
    torque_constant: float
    gear_ratio: float
    inertia: float


@dataclass(frozen=True)
class ArmParameters:
    """Three links and three motors; a value, never changed after it is made.

    a2, a3, d3 [m]: Denavit-Hartenberg lengths (d2 = 0); d4 [m]: from the elbow to the wrist, used
    by the six-link kinematics; gravity [m/s^2], down the base axis z0; joint_ranges ((lo, hi), ...)
    [rad]; suggested_effects: effect strings that the source gives beside its rigid body, kept for
    whoever wants them and not active.

    ``sources`` maps the key of a number in the file to (value, source text); it takes no part in
    comparisons, and a number that was replaced since no longer has a source.
    """

    name: str
    source: str
    links: tuple[Link, Link, Link]
    motors: tuple[Motor, Motor, Motor]
    a2: float
    a3: float
    d3: float
    d4: float
    gravity: float
    joint_ranges: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    suggested_effects: tuple[str, ...] = ()
    sources: Mapping[str, tuple[Any, str]] = field(default_factory=dict, compare=False, repr=False)

    @property
    def motor_inertia(self) -> np.ndarray:
        """(3,) Ia [kg.m^2], the motor inertias at the joints."""
        return np.array([motor.inertia for motor in self.motors])
