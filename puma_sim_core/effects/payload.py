# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""A point mass that moves with link 3."""

from __future__ import annotations

from typing import TYPE_CHECKING

from puma_sim_core.arm.loads import with_point_mass
from puma_sim_core.effects.base import LOAD, Kind, Parameter, Role
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, positive

if TYPE_CHECKING:
    pass

#: places of the mass along the forearm [m]; 0.4318 m is where the wrist is
_PLACES = (0.2, 0.3, 0.37, 0.4318, 0.5, 0.6)


def payload(signals: Signals, joint: int | None) -> list[Candidate]:
    """Torque of 1 kg at (0, 0, z) of link 3 on all joints, for a grid of z."""
    if signals.payload_torque is None:
        return []
    found = []
    for z in _PLACES:
        torque = signals.payload_torque(z)

        def values(c, z=z):
            return {"mass": positive(c[0], "mass", "kg", 15.0), "x": 0.0, "y": 0.0, "z": z}

        found.append(candidate([{j: torque[:, j] for j in range(signals.joints)}], [1.0], [2.0], values, {"z": z}))
    return found


EFFECT = Kind(
    name="payload",
    order=170,
    acts=LOAD,
    equation="point mass m at (x, y, z) in the frame of link 3",
    sentence="A load at the tip: it adds inertia and weight to all joints in fixed ratios.",
    parameters=(
        Parameter("mass", "kg", 0.0, 50.0, "m", plausible=(0.2, 8.0)),
        Parameter("x", "m", -2.0, 2.0, "along x3", default=0.0, role=Role.PLACE),
        Parameter("y", "m", -2.0, 2.0, "along y3, the axis of joint 3", default=0.0, role=Role.STRUCTURE),
        Parameter(
            "z",
            "m",
            -2.0,
            2.0,
            "along the forearm, where the wrist is",
            from_arm=lambda arm, joint: arm.d4,
            role=Role.PLACE,
        ),
    ),
    per_joint=False,
    load=lambda arm, values: with_point_mass(arm, **values),
    screening=Screening(payload, excitation="All joints in motion, with a forearm that changes its angle."),
    drawn_against=("link_torque", "torque", "position"),
    example="payload:mass=2",
)
