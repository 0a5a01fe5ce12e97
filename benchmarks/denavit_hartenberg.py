# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm as other libraries want it: frames and inertias about the centres of mass."""

from __future__ import annotations

import math

import numpy as np

from puma_sim_core.arm.arm import ArmParameters, Link


def links(arm: ArmParameters) -> list[tuple[float, float, float]]:
    """(a, d, alpha) of each link [m, rad]; standard convention, d2 = 0."""
    return [(0.0, 0.0, -math.pi / 2), (arm.a2, 0.0, 0.0), (arm.a3, arm.d3, math.pi / 2)]


def turn_about_x(alpha: float) -> np.ndarray:
    """Rotation (3, 3) by alpha [rad] about x."""
    c, s = math.cos(alpha), math.sin(alpha)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def central_inertia(link: Link) -> np.ndarray:
    """Inertia (3, 3) [kg.m^2] about the centre of mass, axes of the link frame.

    Not always that of a possible body (thesis, link 2); the equations of motion do not mind.
    """
    centre = np.asarray(link.centre)
    moments = np.asarray(link.pseudo_inertia)[:3, :3] - link.mass * np.outer(centre, centre)
    return np.trace(moments) * np.eye(3) - moments


def in_joint_frame(link: Link, frame: tuple[float, float, float]):
    """(centre (3,) [m], central inertia (3, 3)) in the frame that turns with the link's joint.

    That frame has its origin on the joint's axis; the link frame, in which the thesis gives the
    masses, sits at the far end of the link.
    """
    a, d, alpha = frame
    turn = turn_about_x(alpha)
    return (np.array([a, 0.0, d]) + turn @ np.asarray(link.centre), turn @ central_inertia(link) @ turn.T)
