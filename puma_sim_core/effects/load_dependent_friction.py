# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Dry friction of the gears that grows with their load."""

import numpy as np

from puma_sim_core.effects.base import SIZE, STRUCTURE, TORQUE, Kind, Law, Parameter, Point
from puma_sim_core.effects.screening import Candidate, Screening, Signals
from puma_sim_core.effects.shared.columns import candidate, is_arm, motor_torque, on_joint, positive, sized, when_moving
from puma_sim_core.effects.shared.dry_friction import direction_of
from puma_sim_core.jit import Table, inlined

#: greatest share of the load that a gear takes on an arm
_GREATEST_COEFFICIENT = 0.5
#: greatest share that is usual. Of a drive with an efficiency e it is 1 - e; twice this, the greatest that is named, is
#: that of a worm of 2 degrees of lead: e = tan(lead) / tan(lead + friction angle) = 0.3 with a coefficient of 0.08
_USUAL_LOSS = 0.35
#: least share of its torque that a gear passes on when it drives; with less it would block
_LEAST_SHARE = 0.02


@inlined
def load_level(p: Table, k: int, q: float, gravity: float, torque: float) -> float:
    """Level [N.m] under the torque of gravity [N.m] and the motor's [N.m], its viscous friction taken off."""
    if p[k + 1] == 0.0:
        return p[k] * abs(gravity)
    return p[k] * abs(gravity + p[k + 1] * (torque - gravity))


@inlined
def loaded_torque(p: Table, k: int, gravity: float, sign: float, torque: float) -> float:
    """Torque [N.m] of a motor that gives `torque` and, on top, what this friction takes of it.

    sign : of the velocity, -1..1. The friction loads the gear that it is made by: the load u is
    c + s |u| with c that of `torque`, s = sign mu a, |s| < 1, so that |u| = |c| / (1 - s sgn c).
    """
    load = gravity + p[k + 1] * (torque - gravity)
    own = sign * p[k]
    share = 1.0 - p[k + 1] * (own if load > 0.0 else -own)
    return torque + own * abs(load) / max(share, _LEAST_SHARE)


@inlined
def has_load_level(p: Table, k: int) -> bool:
    """Whether there is any."""
    return p[k] > 0.0


@when_moving
def load_dependent(signals: Signals, joint: int) -> list[Candidate]:
    """|load| sgn(qd), the load the torque of gravity, of the motor, or of the mesh; the coefficient is mu.

    What the mesh transmits is the motor's torque less that which speeds up the rotor, T - Ia qdd. With
    (D + Ia) qdd = T - G this is G + a (T - G) with a = D/(D + Ia), D the inertia of the links. Both are by the start
    values: friction that is missing may have stretched those of the model.
    """
    gravity, direction = signals.gravity_torque[:, joint], direction_of(signals, joint)
    if signals.mesh_share is None:
        links, rotor = float(np.mean(signals.link_inertia[:, joint])), float(signals.motor_inertia[joint])
        mesh = links / (links + rotor)
    else:
        mesh = float(signals.mesh_share[joint])
    # small servos have gears that pass on less than half
    most = _GREATEST_COEFFICIENT if is_arm(signals) else 1.0
    values = sized("coefficient", positive, "coefficient of load friction", "", most)
    loads = {share: gravity + share * (motor_torque(signals, joint) - gravity) for share in (0.0, mesh, 1.0)}
    return [
        candidate(on_joint(joint, np.abs(load) * direction), [0.1], [0.1], values, {"transmitted": share})
        for share, load in loads.items()
        if not np.abs(load).max() < 0.02 * signals.torque_scale[joint]
    ]


EFFECT = Kind(
    name="load_dependent_friction",
    order=70,
    acts=TORQUE,
    equation="tau = mu |G(q) + a (T - G(q))| sgn(qd), T = N kt i - H qd what the motor gives; at "
    "rest any torque up to that level is held",
    sentence="Dry friction of the gears that grows with the load they carry: the weight of the "
    "pose (a = 0), the torque of the motor (a = 1), or a mean of the two, such as what the teeth bear "
    "(a = D/(D + Ia), the share of the links in the inertia).",
    parameters=(
        Parameter("coefficient", "1", 0.0, 1.0, "mu, of the load", SIZE, (0.02, _USUAL_LOSS)),
        Parameter(
            "transmitted",
            "1",
            0.0,
            1.0,
            "a, share of the motor's torque in the load, of gravity's the rest",
            STRUCTURE,
            default=0.0,
        ),
    ),
    laws=(
        Law(Point.POSE_LEVEL, load_level),
        Law(Point.HAS_POSE_LEVEL, has_load_level),
        Law(Point.LOADED_TORQUE, loaded_torque),
    ),
    directed=True,
    screening=Screening(
        load_dependent,
        "Reversals in many poses and at several accelerations, so that the torque that "
        "the gear bears differs between them.",
        common=lambda torque: {"coefficient": 0.1, "transmitted": 1.0},
    ),
    drawn_against=("gravity_torque", "link_torque", "torque"),
    example="load_dependent_friction:joint=2,coefficient=0.1",
)
