# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Viscous friction: the one effect that the thesis itself has, so that every mechanism has it as a parameter."""

from puma_sim_core.effects.base import TORQUE, Kind, Parameter

EFFECT = Kind(
    name="viscous_friction",
    order=10,
    acts=TORQUE,
    equation="tau = H qd",
    sentence="Friction that grows with the speed; in voltage it cannot be distinguished from back-EMF.",
    parameters=(Parameter("coefficient", "N.m.s/rad", 0.0, 500.0, "H, at the joint"),),
    drawn_against=("velocity",),
    example="viscous_friction:joint=2,coefficient=10",
)
