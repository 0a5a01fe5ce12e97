# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Columns of the frictions of a joint, dry in several forms and quadratic."""

from __future__ import annotations

import numpy as np

from puma_sim_core.effects.columns import dry_friction
from puma_sim_core.effects.columns.common import (
    candidate,
    fastest,
    is_arm,
    motor_torque,
    moves,
    on_joint,
    positive,
    recursion,
    smooth_sign,
    stretches,
    warming,
)
from puma_sim_core.effects.screening import TORQUE_COLUMN, Candidate, Illegal, Screening, Signals

#: more times the middling friction torque than any friction of a machine
_MOST = 12.0
#: share of a bump by which the sliding level below it may come out negative
_SLACK = 0.2
#: Stribeck velocities of a revolute joint [rad/s], and yield deflections of its bristles [rad]
_STRIBECK_VELOCITIES = np.geomspace(0.008, 0.15, 8)
_YIELD_DEFLECTIONS = np.geomspace(1e-4, 3e-3, 9)
#: share of the viscous friction lost that a fit may start from
_MOST_WARMED = 0.9
#: greatest share of the load that a gear takes
_GREATEST_COEFFICIENT = 0.5
#: what the load of a gear may be: the weight alone, or the torque that it transmits
_TRANSMITTED = (0.0, 1.0)


def _direction(signals: Signals, joint: int) -> np.ndarray:
    return smooth_sign(signals.velocity[:, joint], signals.velocity_noise[joint])


def coulomb(signals: Signals, joint: int) -> list[Candidate]:
    """sgn(qd); its coefficient is the level."""
    if not moves(signals, joint):
        return []
    scale = float(signals.torque_scale[joint])

    def values(c):
        return {"torque": positive(c[0], "level", "N.m", _MOST * scale)}

    return [candidate(on_joint(joint, _direction(signals, joint)), [0.5 * scale], [scale], values)]


def asymmetric_coulomb(signals: Signals, joint: int) -> list[Candidate]:
    """The positive and the negative part of sgn(qd); the coefficients are the two levels."""
    direction = _direction(signals, joint)
    forth, back = np.maximum(direction, 0.0), np.minimum(direction, 0.0)
    least = 0.02 * direction.size
    if not moves(signals, joint) or min(np.count_nonzero(forth > 0.5), np.count_nonzero(back < -0.5)) < least:
        return []
    scale = float(signals.torque_scale[joint])

    def values(c):
        return {
            "positive": positive(c[0], "level for qd > 0", "N.m", _MOST * scale),
            "negative": positive(c[1], "level for qd < 0", "N.m", _MOST * scale),
        }

    return [candidate(on_joint(joint, forth, back), [0.5 * scale] * 2, [scale] * 2, values)]


def stribeck(signals: Signals, joint: int) -> list[Candidate]:
    """sgn(qd) and exp(-(qd/vs)^2) sgn(qd), for a grid of vs."""
    if not moves(signals, joint):
        return []
    scale = float(signals.torque_scale[joint])
    velocity, direction = signals.velocity[:, joint], _direction(signals, joint)
    top = fastest(signals, joint)
    found = []
    grid = _STRIBECK_VELOCITIES
    if not is_arm(signals):
        grid = grid * min(1.0, top)
    for vs in grid:
        # below the noise the bump is the blur of the estimate; near the top speed it is a level
        if vs < signals.velocity_noise[joint] or vs > 0.7 * top:
            continue

        def values(c, vs=float(vs)):
            # a bump may leave so little level that viscous friction takes it, or a name before it
            # has
            level = max(c[0], 0.0) if c[0] > -_SLACK * c[1] else c[0]
            return {
                "torque": positive(c[1], "excess over the sliding level", "N.m", _MOST * scale),
                "velocity": vs,
                "sliding": positive(level, "sliding level", "N.m", _MOST * scale),
            }

        bump = np.exp(-((velocity / vs) ** 2)) * direction
        found.append(
            candidate(
                on_joint(joint, direction, bump),
                [0.5 * scale, 0.4 * scale],
                [scale, 0.6 * scale],
                values,
                {"velocity": float(vs)},
            )
        )
    return found


def presliding(signals: Signals, joint: int) -> list[Candidate]:
    """Deflection of a bristle under the measured motion over its yield deflection zs, for a grid
    of zs; the coefficient is the sliding level Fc, the stiffness Fc / zs (Dahl 1968)."""
    if not moves(signals, joint):
        return []
    scale = float(signals.torque_scale[joint])
    grid = _YIELD_DEFLECTIONS
    if not is_arm(signals):
        # what the deflection is to the travelled range on the arm
        grid = grid * min(1.0, float(np.ptp(signals.position[:, joint])))
    found = []
    for zs in grid:

        def values(c, zs=float(zs)):
            level = positive(c[0], "sliding level", "N.m", _MOST * scale)
            return {"stiffness": level / zs, "torque": level}

        column = bristle(signals, joint, float(zs))
        found.append(
            candidate(on_joint(joint, column), [0.5 * scale], [scale], values, {"yield_deflection": float(zs)})
        )
    return found


def bristle(signals: Signals, joint: int, yield_deflection: float) -> np.ndarray:
    """Deflection (n,) of a bristle over its yield deflection, from -1 to 1.

    The exact solution of z' = qd - |qd| z / zs between samples with a constant velocity: what the
    model itself steps with. A stretch that begins in motion begins with a bent bristle.
    """
    q, qd = signals.position[:, joint], signals.velocity[:, joint]
    out = np.zeros(len(q))
    for part in stretches(signals):
        travel = np.diff(q[part], prepend=q[part.start])
        grown = -np.expm1(-np.abs(travel) / yield_deflection)
        begins = float(qd[part.start])
        start = np.sign(begins) if abs(begins) > 3.0 * signals.velocity_noise[joint] else 0.0
        out[part] = recursion(1.0 - grown, np.sign(travel) * grown, float(start))
    return out


def load_dependent(signals: Signals, joint: int) -> list[Candidate]:
    """|load| sgn(qd), the load the torque of gravity or of the motor; the coefficient is mu."""
    if not moves(signals, joint):
        return []
    direction, found = _direction(signals, joint), []
    # small servos have gears that pass on less than half
    most = _GREATEST_COEFFICIENT if is_arm(signals) else 1.0
    for share in _TRANSMITTED:
        load = transmitted_load(signals, joint, share)
        if np.abs(load).max() < 0.02 * signals.torque_scale[joint]:
            continue

        def values(c, share=share):
            return {"coefficient": positive(c[0], "coefficient of load friction", "", most), "transmitted": share}

        found.append(candidate(on_joint(joint, np.abs(load) * direction), [0.1], [0.1], values, {"transmitted": share}))
    return found


def transmitted_load(signals: Signals, joint: int, share: float) -> np.ndarray:
    """Load (n,) [N.m] of a joint's gear: `share` of the motor's torque, the rest gravity's."""
    gravity = signals.gravity_torque[:, joint]
    if share == 0.0:
        return gravity
    return gravity + share * (motor_torque(signals, joint) - gravity)


def position_dependent(signals: Signals, joint: int) -> list[Candidate]:
    """sgn(qd), cos q sgn(qd) and sin q sgn(qd): level F0 + F1 cos(q - f)."""
    if not moves(signals, joint):
        return []
    scale = float(signals.torque_scale[joint])
    q, direction = signals.position[:, joint], _direction(signals, joint)
    visited = np.linspace(q.min(), q.max(), 50)

    def values(c):
        mean = positive(c[0], "mean level", "N.m", _MOST * scale)
        amplitude, angle = float(np.hypot(c[1], c[2])), float(np.arctan2(c[2], c[1]))
        level = mean + amplitude * np.cos(visited - angle)
        if level.min() < -0.15 * level.max():
            raise Illegal(f"negative level {level.min():.3g} N.m at q = {visited[level.argmin()]:.3g} rad")
        return {"torque": mean, "amplitude": amplitude, "angle": angle}

    columns = on_joint(joint, direction, np.cos(q) * direction, np.sin(q) * direction)
    return [candidate(columns, [0.5 * scale, 0.0, 0.0], [scale, 0.5 * scale, 0.5 * scale], values)]


def quadratic(signals: Signals, joint: int) -> list[Candidate]:
    """qd |qd|; the coefficient is c."""
    if not moves(signals, joint):
        return []
    speed = fastest(signals, joint)
    # the arm's drag is that of a middling friction torque at 1 to 2 rad/s, however slow the log
    unit = float(signals.torque_scale[joint]) / max(speed, 1.0 if is_arm(signals) else 0.0) ** 2
    velocity = signals.velocity[:, joint]

    def values(c):
        return {"coefficient": positive(c[0], "drag coefficient", "N.m.s2/rad2", 20.0 * unit)}

    return [candidate(on_joint(joint, velocity * np.abs(velocity)), [0.3 * unit], [0.6 * unit], values)]


def warm_up(signals: Signals, joint: int) -> list[Candidate]:
    """-H qd (1 - exp(-t/T)) for a grid of T; the coefficient is the share of H that is lost."""
    if not moves(signals, joint) or signals.viscous[joint] == 0.0:
        return []

    def values(c, T):
        # the share is of a friction that was retuned without the effect: it may be too low by half
        share = positive(c[0], "lost share of viscous friction", "", 4.0)
        return {"share": min(share, _MOST_WARMED), "time_constant": T}

    column = -signals.viscous[joint] * signals.velocity[:, joint]
    return warming(signals, joint, column, values, [0.4], [0.3], TORQUE_COLUMN)


_NOT_BY_VOLTAGE = (
    "follows the sign of the velocity, the dead-band that of the voltage: the two "
    "differ where gravity drives the joint or brakes it"
)

SCREENINGS = {
    "coulomb_friction": Screening(
        coulomb,
        look_alikes=(
            ("voltage_dead_band", "friction " + _NOT_BY_VOLTAGE),
            ("stribeck_friction", "Coulomb friction is flat in the speed, without a bump at low speed"),
            ("asymmetric_coulomb_friction", "the step has the same height in both directions"),
            ("load_dependent_friction", "the step does not change with the load"),
            ("position_dependent_friction", "the step does not change with the position"),
            ("presliding_friction", "the step is sharp in position, without a hysteresis loop at the reversal"),
            ("backlash", "the friction lasts as long as the joint moves"),
        ),
        excitation="At least six reversals of the joint, with motion at several speeds.",
        plausible=(("torque", 0.4, 40.0),),
        coordinates=dry_friction.coulomb,
    ),
    "asymmetric_coulomb_friction": Screening(
        asymmetric_coulomb,
        look_alikes=(
            ("coulomb_friction", "the step is of another height in each direction"),
            (
                "voltage_offset",
                "an offset also acts at rest and without a step at reversals; with "
                "Coulomb friction beside it, it is the same while the joint moves",
            ),
            ("base_tilt", "the difference of the levels does not turn with the pose"),
            ("joint_spring", "the difference of the levels does not change with the position"),
            ("stribeck_friction", "the levels differ by direction and do not change with the speed"),
            ("voltage_dead_band", "the step follows the sign of the velocity and differs by direction"),
        ),
        excitation="Motion in both directions for about equal times, with many reversals.",
        contains=("coulomb_friction",),
        plausible=(("positive", 0.4, 40.0), ("negative", 0.4, 40.0)),
        coordinates=dry_friction.asymmetric,
    ),
    "stribeck_friction": Screening(
        stribeck,
        look_alikes=(
            ("coulomb_friction", "friction rises as the joint slows down below a few times the Stribeck velocity"),
            ("presliding_friction", "the bump is one in velocity, not a loop in position after the reversal"),
            ("asymmetric_coulomb_friction", "the bump is the same in both directions"),
            ("backlash", "the bump comes at reversals of the velocity, not of the transmitted torque"),
            ("quadratic_friction", "friction changes at low speed, not at high speed"),
            ("impulse", "the bump comes back at each slow motion"),
        ),
        excitation="Crawling at 0.01 to 0.2 rad/s, for example slow triangles of the position.",
        contains=("coulomb_friction",),
        plausible=(("torque", 0.4, 30.0), ("velocity", 0.008, 0.15), ("sliding", 0.0, 40.0)),
        prior=(("velocity", *dry_friction.VELOCITY),),
        coordinates=dry_friction.stribeck,
        usual=dry_friction.usual_stribeck,
    ),
    "presliding_friction": Screening(
        presliding,
        look_alikes=(
            ("coulomb_friction", "friction turns over with the travel after a reversal, not at once"),
            ("backlash", "the loop comes at reversals of the velocity, not of the transmitted torque"),
            ("joint_elasticity", "the loop depends on the travel, not on the frequency"),
            ("joint_spring", "the restoring torque ends within a milliradian of each reversal"),
            ("stribeck_friction", "the torque follows the travel since the reversal, not the speed"),
            ("soft_stop", "the loop comes after each reversal, at any position"),
        ),
        excitation="Reversals with slow travel of 0.1 to 1 mrad about them.",
        contains=("coulomb_friction",),
        plausible=(("torque", 0.4, 40.0), ("stiffness", 1e3, 1e6)),
        prior=(("stiffness", *dry_friction.STIFFNESS),),
        coordinates=dry_friction.presliding,
    ),
    "load_dependent_friction": Screening(
        load_dependent,
        look_alikes=(
            (
                "position_dependent_friction",
                "the step follows the torque that the gear bears, "
                "which other joints and accelerations change "
                "too, not the joint's own position",
            ),
            ("coulomb_friction", "the step vanishes where the load does"),
            ("payload", "the torque changes sign with the velocity, a weight's does not"),
        ),
        excitation="Reversals in many poses and at several accelerations, so that the torque that "
        "the gear bears differs between them.",
        plausible=(("coefficient", 0.02, 0.3),),
    ),
    "position_dependent_friction": Screening(
        position_dependent,
        look_alikes=(
            (
                "load_dependent_friction",
                "the step follows the joint's own position, not the "
                "load; a weight, accelerations, or other angles of the "
                "other joints, separate the two",
            ),
            ("coulomb_friction", "the height of the step changes with the position"),
            ("sensor_nonlinearity", "the torque is a step at reversals and does not grow with the speed"),
            (
                "torque_ripple",
                "the torque changes sign with the velocity, and its period is that of the joint, not of the motor",
            ),
        ),
        excitation="Reversals over the full range of the joint.",
        contains=("coulomb_friction",),
        plausible=(("amplitude", 0.4, 30.0), ("torque", 0.4, 40.0)),
        coordinates=dry_friction.position,
    ),
    "quadratic_friction": Screening(
        quadratic,
        look_alikes=(
            ("voltage_saturation", "drag grows with the square of the speed at all voltages"),
            ("supply_droop", "drag does not change with the currents of the joints"),
            ("stribeck_friction", "the curve bends at high speed, not at low speed"),
            ("friction_warm_up", "the drag is the same at the beginning and at the end"),
            ("current_limit", "the drag comes with the speed, not with great torque"),
        ),
        excitation="Speeds above half of the greatest, in both directions.",
        plausible=(("coefficient", 0.5, 30.0),),
    ),
    "friction_warm_up": Screening(
        warm_up,
        look_alikes=(
            (
                "resistance_drift",
                "the loss follows the speed, not the torque, and a hold against gravity does not change",
            ),
            ("quadratic_friction", "friction falls with time at the same speed"),
        ),
        excitation="The same fast motion at the beginning and at the end.",
        plausible=(("share", 0.1, 0.9), ("time_constant", 1.0, 2000.0)),
    ),
}
