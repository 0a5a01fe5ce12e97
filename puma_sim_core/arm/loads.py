# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Loads that move with the last link."""

from dataclasses import replace

import numpy as np

from puma_sim_core.arm.arm import ArmParameters, Link


def with_point_mass(arm: ArmParameters, mass: float, x: float, y: float, z: float) -> ArmParameters:
    """Attach a point mass [kg] at (x, y, z) [m] in the frame of link 3.

    The pseudo inertia (equation 3.8) of link 3 gains m r r', with r = (x, y, z, 1).
    """
    if mass == 0.0:
        return arm  # to the last bit
    link = arm.links[2]
    r = np.array([x, y, z, 1.0])
    pseudo = link.pseudo_inertia + mass * np.outer(r, r)
    whole = float(pseudo[3, 3])
    xx, yy, zz = (float(pseudo[n, n]) / whole for n in range(3))
    centre: tuple[float, ...] = tuple(float(c) for c in pseudo[:3, 3] / whole)
    products: tuple[float, ...] = tuple(float(pseudo[a, b]) / whole for a, b in ((0, 1), (1, 2), (0, 2)))
    loaded = Link(whole, centre, (yy + zz, xx + zz, xx + yy), products)  # type: ignore[arg-type]
    return replace(arm, links=(*arm.links[:2], loaded))
