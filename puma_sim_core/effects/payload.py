# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A point mass that moves with link 3."""

from puma_sim_core.arm.loads import with_point_mass
from puma_sim_core.effects.base import LOAD, PLACE, SIZE, Kind, Parameter
from puma_sim_core.effects.screening import ByJoint, Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import bounded, candidate, positive
from puma_sim_core.jit import Table

#: places of the mass along the forearm [m]; 0.4318 m is where the wrist is
_PLACES = (0.2, 0.3, 0.37, 0.4318, 0.5, 0.6)
#: half of what a hand holds: the centre of a load is so far from the line of the forearm [m]
_ASIDE = 0.1


def payload(signals: Signals, joint: int | None) -> list[Candidate]:
    """Torque of 1 kg at (0, 0, z) of link 3 on all joints, and of 1 kg.m beside the forearm, for a grid of z."""
    torque = signals.payload_torque
    if torque is None:
        return []

    def values(c: Table, z: float) -> dict[str, float]:
        mass = positive(c[0], "mass", "kg", 15.0)
        x = bounded(c[1] / max(mass, 1e-9), "distance from the forearm", "m", 2.0 * _ASIDE)
        return {"mass": mass, "x": x, "y": 0.0, "z": z}

    def columns(z: float) -> list[ByJoint]:
        central = torque((0.0, 0.0, z))
        return [dict(enumerate(each.T)) for each in (central, (torque((_ASIDE, 0.0, z)) - central) / _ASIDE)]

    return [candidate(columns(z), [1.0, 0.0], [2.0, 2.0 * _ASIDE], values, {"z": z}) for z in _PLACES]


EFFECT = Kind(
    name="payload",
    order=170,
    acts=LOAD,
    equation="point mass m at (x, y, z) in the frame of link 3",
    sentence="A load at the tip: it adds inertia and weight to all joints in fixed ratios.",
    parameters=(
        Parameter("mass", "kg", 0.0, 1e4, "m", SIZE, (0.2, 8.0)),
        Parameter("x", "m", -2.0, 2.0, "along x3", PLACE, default=0.0),
        Parameter("y", "m", -2.0, 2.0, "along y3, the axis of joint 3", PLACE, default=0.0),
        Parameter(
            "z", "m", -2.0, 2.0, "along the forearm, where the wrist is", PLACE, from_arm=lambda arm, joint: arm.d4
        ),
    ),
    per_joint=False,
    load=lambda arm, values: with_point_mass(arm, **values),
    screening=Screening(payload, "All joints in motion, with a forearm that changes its angle."),
    drawn_against=("link_torque", "torque", "position"),
    example="payload:mass=2",
)
