# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Hysteresis of a gear, an effect with a state of its own: it winds up by some travel, and then slips."""

import numpy as np

from puma_sim_core.effects.base import TORQUE, Kind, LookAlike, Memory, Parameter, Role
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, on_joint, positive, stretches
from puma_sim_core.jit import inlined

#: travels [rad] that are tried
_TRAVELS = np.geomspace(0.005, 0.1, 8)


@inlined
def follow(p, k, deflection, travel):
    """Deflection [rad] after the joint has moved by `travel` [rad]: it never leaves -s to s."""
    return min(max(deflection + travel, -p[k + 1]), p[k + 1])


@inlined
def torque(p, k, deflection):
    """Torque [N.m] of a deflection, positive against positive motion."""
    return p[k] * deflection / p[k + 1]


def candidates(signals: Signals, joint: int) -> list[Candidate]:
    """The deflection under the measured motion over its greatest, for a grid of travels; the coefficient is T."""
    scale, found = float(signals.torque_scale[joint]), []

    def values(c, travel):
        return {"torque": positive(c[0], "torque", "N.m", 12.0 * scale), "travel": travel}

    for travel in _TRAVELS:
        column = np.zeros(len(signals.time))
        for part in stretches(signals):
            steps = np.diff(signals.position[part, joint], prepend=signals.position[part.start, joint]).tolist()
            deflection = 0.0
            for n, step in enumerate(steps):
                deflection = min(max(deflection + step, -travel), travel)
                column[part.start + n] = deflection / travel
        found.append(candidate(on_joint(joint, column), [0.5 * scale], [scale], values, {"travel": travel}))
    return found


EFFECT = Kind(
    name="gear_hysteresis",
    acts=TORQUE,
    equation="tau = T z / s, z the travel since the last reversal within -s to s",
    sentence="A gear that winds up over some travel after each reversal before it slips with a constant torque.",
    parameters=(
        Parameter("torque", "N.m", 0.0, 500.0, "T, where it slips", plausible=(0.4, 40.0)),
        Parameter(
            "travel",
            "rad",
            1e-4,
            1.0,
            "s, by which it winds up",
            neutral=1.0,
            role=Role.RATE,
            plausible=(1e-3, 0.2),
            logarithmic=True,
        ),
    ),
    memory=Memory(follow, torque),
    screening=Screening(candidates, excitation="Reversals with slow travel of some multiples of s about them."),
    look_alikes=(
        LookAlike(
            "presliding_friction",
            "the torque rises in proportion to the travel up to a corner",
            "the torque bends over smoothly within a milliradian",
        ),
    ),
    drawn_against=("velocity",),
    example="gear_hysteresis:joint=2,torque=8,travel=0.02",
)
