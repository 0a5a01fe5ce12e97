# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the arm carries: a point mass that moves with link 3."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from puma_sim_core.effects.base import ALWAYS, LOAD, Kind, Parameter
from puma_sim_core.effects.columns import SCREENINGS

if TYPE_CHECKING:
    from puma_sim_core.arm.parameters import ArmParameters


def attach_payload(arm: ArmParameters, values: dict[str, float]) -> ArmParameters:
    """The arm with a point mass in its third link.

    The pseudo inertia (equation 3.8) of link 3 gains m r r', with r = (x, y, z, 1) in the frame
    of the link.
    """
    if values["mass"] == 0.0:
        return arm  # to the last bit
    link = arm.links[2]
    r = np.array([values["x"], values["y"], values["z"], 1.0])
    pseudo = link.pseudo_inertia + values["mass"] * np.outer(r, r)
    mass = float(pseudo[3, 3])
    xx, yy, zz = (float(pseudo[n, n]) / mass for n in range(3))
    loaded = replace(
        link,
        mass=mass,
        centre=tuple(float(c) for c in pseudo[:3, 3] / mass),
        gyration_squared=(yy + zz, xx + zz, xx + yy),
        products=tuple(float(pseudo[a, b]) / mass for a, b in ((0, 1), (1, 2), (0, 2))),
    )
    return replace(arm, links=(arm.links[0], arm.links[1], loaded))


PAYLOAD = Kind(
    name="payload",
    acts=LOAD,
    stage=ALWAYS,
    screening=SCREENINGS["payload"],
    equation="point mass m at (x, y, z) in the frame of link 3",
    sentence="A load at the tip: it adds inertia and weight to all joints in fixed ratios.",
    parameters=(
        Parameter("mass", "kg", 0.0, 50.0, "m"),
        Parameter("x", "m", -2.0, 2.0, "along x3", default=0.0),
        Parameter("y", "m", -2.0, 2.0, "along y3, the axis of joint 3", default=0.0),
        Parameter("z", "m", -2.0, 2.0, "along the forearm, where the wrist is", from_arm=lambda arm, joint: arm.d4),
    ),
    per_joint=False,
    load=attach_payload,
)

KINDS = (PAYLOAD,)
