# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Links as other programs want them: bodies that together have the arm's D, C and G.

The motion determines fifteen combinations of the thirty numbers of three links. In the frames of the
URDF (z along the joint's axis) the planar second moments of links 2 and 3 are among them. Their second
moments across the plane, the integrals of z^2, enter only through one sum with the inertia of link 1
about its axis: what is given to one of the three is taken from another. That is the choice made here.
"""

from typing import NamedTuple

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.kinematics import dh_table, dh_transform

#: a smallest eigenvalue counts as above zero from this share of the largest on
_LEAST_SHARE = 1e-9


class Bodies(NamedTuple):
    """Pseudo inertias (3, 4, 4) of the three links in the frames of the URDF, as `Link.pseudo_inertia`
    has them; `possible` if each is that of a body, which has no negative mass anywhere."""

    pseudo_inertias: np.ndarray
    possible: bool


def link_bodies(arm: ArmParameters) -> Bodies:
    """The links of an arm as three bodies with its D, C and G, without the inertias of the motors.

    Published links that are bodies are kept. Else masses, centres and products of links 2 and 3 are kept,
    their second moments across the plane are the least that a body can have, and what is left of the
    sum is shared out equally among them and link 1, which becomes a ball of its mass at the shoulder.
    Where the sum does not suffice, or a planar moment is negative, the published links are given as they
    are, `possible` false.
    """
    frames = [dh_transform(0.0, *row) for row in dh_table(arm)[:3]]
    published = np.array([frame @ link.pseudo_inertia @ frame.T for frame, link in zip(frames, arm.links)])
    if all(map(_is_body, published)):
        return Bodies(published, True)
    chosen = published.copy()
    left = float(published[0, 0, 0] + published[0, 1, 1])
    for matrix in chosen[1:]:
        others = np.delete(np.delete(matrix, 2, 0), 2, 1)
        if not _is_body(others):
            return Bodies(published, False)
        least = float(matrix[2, [0, 1, 3]] @ np.linalg.solve(others, matrix[2, [0, 1, 3]]))
        left += float(matrix[2, 2]) - least
        matrix[2, 2] = least
    chosen[1:, 2, 2] += left / 3.0
    chosen[0] = np.diag([left / 6.0] * 3 + [arm.links[0].mass])
    possible = all(map(_is_body, chosen))
    return Bodies(chosen if possible else published, possible)


def mass_properties(pseudo_inertia: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """(mass [kg], centre (3,) [m], inertia (3, 3) about the centre [kg.m^2]) of a pseudo inertia (4, 4)."""
    mass = float(pseudo_inertia[3, 3])
    centre = pseudo_inertia[:3, 3] / mass
    moments = pseudo_inertia[:3, :3] - mass * np.outer(centre, centre)
    return mass, centre, np.trace(moments) * np.eye(3) - moments


def _is_body(moments: np.ndarray) -> bool:
    values = np.linalg.eigvalsh(moments)
    return bool(values[0] > _LEAST_SHARE * values[-1])
