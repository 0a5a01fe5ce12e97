# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The torques of the effects at the joints, from the laws of the registry.

The arguments are those of `types`. Smooth torques depend on position and
velocity; dry friction is a level, of which a part stays the same over a step, a part falls with
the speed and a part depends on the pose; and it may act through a bristle.
"""

from math import exp

from puma_sim_core.dynamics.laws import (
    BRISTLE,
    DRY,
    POSED,
    SMOOTH,
    TILT,
    TIMED,
    VARYING,
    WIDTH,
    arm_torques,
    bristle_stiffness,
    constant_level,
    deflection_torques,
    has_pose_level,
    link_torque,
    loaded_torque,
    motor_torque,
    pose_level,
    push_torque,
    speed_level,
)
from puma_sim_core.dynamics.types import STILL, Model
from puma_sim_core.jit import Table, Vec, inlined, outlined


@inlined
def smooth_torque(j: int, q: float, qd: float, p: Table) -> float:
    """Torque [N.m] of joint j's smooth effects, positive against positive motion."""
    return link_torque(j, q, qd, p) + motor_torque(j, q, qd, p)


@inlined
def sliding_level(j: int, direction: float, q: float, gravity: float, torque: float, speed: float, p: Table) -> float:
    """All dry friction [N.m] of joint j when it slides in `direction` at `speed` >= 0 [rad/s] in
    a pose, as `pose_level` takes it."""
    level = constant_level(j, direction, p)
    level += speed_level(j, speed, p)
    return level + pose_level(j, q, gravity, torque, p)


@inlined
def inverse_torque(j: int, sign: float, q: float, gravity: float, torque: float, speed: float, p: Table) -> float:
    """Torque [N.m] that joint j's motor gives, after viscous friction, where a motion takes
    `torque` beside dry friction; sign : of its velocity, -1..1."""
    direction = 1.0 if sign > 0.0 else -1.0
    torque += sign * sliding_level(j, direction, q, 0.0, 0.0, speed, p)
    return loaded_torque(j, gravity, sign, torque, p)


@inlined
def has_dry(j: int, p: Table) -> bool:
    """Whether joint j has dry friction, in one direction and in one pose at least."""
    return (
        constant_level(j, 1.0, p) > 0.0
        or constant_level(j, -1.0, p) > 0.0
        or speed_level(j, 0.0, p) > 0.0
        or has_pose_level(j, p)
    )


@inlined
def has_bristle(j: int, p: Table) -> bool:
    """Whether joint j's dry friction acts through a bristle."""
    return bristle_stiffness(j, p) > 0.0


@inlined
def bristle_level(j: int, q: float, gravity: float, torque: float, qd: float, p: Table) -> float:
    """Dry friction [N.m] that bounds joint j's bristle at velocity qd; 0.0 without a bristle."""
    if not has_bristle(j, p):
        return 0.0
    return sliding_level(j, 1.0 if qd > 0.0 else -1.0, q, gravity, torque, abs(qd), p)


@inlined
def bristle_flow(deflection: float, travel: float, yield_deflection: float) -> float:
    """Deflection [rad] of a bristle after the joint has moved by `travel` [rad] (Dahl 1968).

    The exact solution of z' = qd - |qd| z / zs at constant velocity. It never leaves [-zs, zs], however stiff the
    bristle is, where an explicit step would.
    """
    if travel == 0.0:
        return deflection
    if yield_deflection <= 0.0:
        return 0.0
    # 1 - exp() loses digits of the share, never more than 1e-16 of the yield deflection
    grown = 1.0 - exp(-abs(travel) / yield_deflection)
    end = yield_deflection if travel > 0.0 else -yield_deflection
    return deflection + (end - deflection) * grown


@inlined
def bristle_step(j: int, z: float, travel: float, level: float, p: Table) -> Vec:
    """Deflection [rad] of joint j's bristle after `travel` [rad], and its torque [N.m]."""
    stiffness = bristle_stiffness(j, p)
    if stiffness == 0.0:
        return 0.0, 0.0
    z = bristle_flow(z, travel, level / stiffness)
    return z, stiffness * z


@inlined
def gravity_torques(trig: Vec, body: Table) -> Vec:
    """Gravity torques [N.m] of joints 2 and 3 on a level base; joint 1 has none."""
    s2, c2, su, cu = trig
    G3 = body[16] * cu + body[17] * su
    return body[18] * c2 + body[19] * s2 + G3, G3


@inlined
def smooth_torques(x: Vec, p: Table) -> Vec:
    """`smooth_torque` of the three joints."""
    return smooth_torque(0, x[0], x[3], p), smooth_torque(1, x[1], x[4], p), smooth_torque(2, x[2], x[5], p)


@outlined
def tilted_torques(q1: float, trig: Vec, body: Table, p: Table) -> Vec:
    """Torques [N.m] of effects of the whole arm that depend on the pose, against positive motion."""
    return arm_torques(0, WIDTH, q1, trig, body, p)


@inlined
def effect_torques(x: Vec, t: Vec, trig: Vec, model: Model, p: Table, slip: Vec, bend: Vec) -> Vec:
    """Torques at the joints [N.m] less what the active effects take.

    x : positions and velocities, what stands behind them is not read; t : what the motors give after viscous friction
    [N.m], which is what loads the gears.
    """
    body, _, active = model
    t1, t2, t3 = t
    if active & SMOOTH:
        f1, f2, f3 = smooth_torques(x, p)
        t1 -= f1
        t2 -= f2
        t3 -= f3
    if active & TILT:
        g1, g2, g3 = tilted_torques(x[0], trig, body, p)
        t1 -= g1
        t2 -= g2
        t3 -= g3
    if active & (DRY | TIMED):
        s1, s2, s3, c1, c2, c3 = slip
        t1 -= c1
        t2 -= c2
        t3 -= c3
        if active & VARYING:
            t1 -= s1 * speed_level(0, abs(x[3]), p)
            t2 -= s2 * speed_level(1, abs(x[4]), p)
            t3 -= s3 * speed_level(2, abs(x[5]), p)
        if active & POSED:
            G2, G3 = gravity_torques(trig, body)
            t1 -= s1 * pose_level(0, x[0], 0.0, t[0], p)
            t2 -= s2 * pose_level(1, x[1], G2, t[1], p)
            t3 -= s3 * pose_level(2, x[2], G3, t[2], p)
    if active & BRISTLE:
        f1, f2, f3 = bend
        t1 -= f1
        t2 -= f2
        t3 -= f3
    return t1, t2, t3


@inlined
def bristle_levels(x: Vec, motors: Vec, trig: Vec, model: Model, p: Table) -> Vec:
    """`bristle_level` of the three joints; motors : what they give after viscous friction [N.m]."""
    body = model.body
    G2, G3 = gravity_torques(trig, body)
    return (
        bristle_level(0, x[0], 0.0, motors[0], x[3], p),
        bristle_level(1, x[1], G2, motors[1], x[4], p),
        bristle_level(2, x[2], G3, motors[2], x[5], p),
    )


#: (z, t1, t2, t3, level, p) -> deflections after travels t1, t2, t3 [rad], and their torques [N.m]
bristle_torques = deflection_torques(bristle_step)


@inlined
def bent_torques(z: Vec, active: int, p: Table) -> Vec:
    """Torques [N.m] of deflections z as they are."""
    if active & BRISTLE:
        _, bend = bristle_torques(z, 0.0, 0.0, 0.0, STILL, p)
        return bend
    return STILL


@inlined
def push_over(time: float, step: float, p: Table) -> Vec:
    """Torques [N.m] from outside in the direction of +q: the mean from `time` to `time` + `step`
    [s], or the value at an instant for step 0."""
    return (push_torque(0, time, step, p), push_torque(1, time, step, p), push_torque(2, time, step, p))
