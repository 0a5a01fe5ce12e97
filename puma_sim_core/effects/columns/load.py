# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Columns of what the arm carries: a point mass on the forearm."""

from __future__ import annotations

from puma_sim_core.effects.columns.common import candidate, positive
from puma_sim_core.effects.screening import Candidate, Screening, Signals

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


SCREENINGS = {
    "payload": Screening(
        payload,
        look_alikes=(
            ("joint_spring", "the torques of all joints keep the ratios of one mass at one place"),
            ("load_dependent_friction", "a weight pulls the same way in both directions of motion"),
            ("encoder_offset", "inertia grows with the weight"),
            ("voltage_offset", "the torque changes with the pose"),
            ("resistance_drift", "the torque is the same at the beginning and at the end"),
            ("soft_stop", "all joints feel the weight, in all poses"),
        ),
        excitation="All joints in motion, with a forearm that changes its angle.",
        plausible=(("mass", 0.2, 8.0),),
    )
}
