# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Stick and slip: one step of the model with dry friction in it.

Dry friction has no derivative at rest, so each joint is at every moment in one of two states.
It slides in a direction that is known, and friction is a smooth torque; or it sticks, and its
row is taken out like that of a locked joint, so that its velocity stays exactly zero for as long
as the torque it must bear is below the level of friction. A step runs with the states of its
start. Where one of them ends inside the step (a velocity changes sign, a torque exceeds its
level), the moment is located by an Illinois iteration on the step itself, and the rest of the
step goes on from there with new states. So the order of the Runge-Kutta step survives reversals.
"""

from collections.abc import Callable
from typing import Any

from puma_sim_core.dynamics.circuit import settled_state
from puma_sim_core.dynamics.laws import ALGEBRAIC, DRY, LOCKED, TIMED, VARYING, constant_level, deflections_of
from puma_sim_core.dynamics.rigid import arm_step, library_trigonometry, remove_rows, rigid_body, solve
from puma_sim_core.dynamics.torques import (
    bent_torques,
    effect_torques,
    gravity_torques,
    has_bristle,
    has_dry,
    sliding_level,
)
from puma_sim_core.dynamics.types import Model
from puma_sim_core.jit import Table, Vec, inlined, interpreted, merged, outlined

#: changes of contact that are located inside one step; more than that is chatter, see below
_CHANGES = 12
_ITERATIONS = 60
#: a change is located to this share of the step
_RESOLUTION = 1e-12


@inlined
def slip_direction(j: int, locked: float, w: float, p: Table) -> float:
    """Direction in which joint j slides against dry friction: +1, -1, or 0 where it does not."""
    if locked != 0.0 or w == 0.0 or has_bristle(j, p):
        return 0.0
    return 1.0 if w > 0.0 else -1.0


@inlined
def rests(x: Vec, lock: Vec) -> bool:
    """Whether a joint that is free to move is at rest."""
    return (x[3] == 0.0 and lock[0] == 0.0) or (x[4] == 0.0 and lock[1] == 0.0) or (x[5] == 0.0 and lock[2] == 0.0)


@inlined
def sliding(s1: float, s2: float, s3: float, p: Table, push: Vec) -> Vec:
    """The kernel's `slip` for the three directions, and for torques [N.m] that push the joints."""
    return (
        s1,
        s2,
        s3,
        (s1 * constant_level(0, s1, p) if s1 != 0.0 else 0.0) - push[0],
        (s2 * constant_level(1, s2, p) if s2 != 0.0 else 0.0) - push[1],
        (s3 * constant_level(2, s3, p) if s3 != 0.0 else 0.0) - push[2],
    )


@inlined
def motion(j: int, locked: float, w: float, p: Table) -> Vec:
    """(direction of sliding, 1.0 if at rest) of joint j; (0, 0) where dry friction does nothing."""
    if locked != 0.0 or has_bristle(j, p) or not has_dry(j, p):
        return 0.0, 0.0
    if w == 0.0:
        return 0.0, 1.0
    return 1.0 if w > 0.0 else -1.0, 0.0


@inlined
def overload(j: int, sticks: float, torque: float, x: Vec, load: Vec, p: Table) -> float:
    """Torque [N.m] by which a sticking joint is pushed beyond its level; negative while held."""
    if sticks == 0.0:
        return -1.0
    direction = 1.0 if torque > 0.0 else -1.0
    return abs(torque) - sliding_level(j, direction, x[j], load[j], load[3 + j], 0.0, p)


@inlined
def free_system(x: Vec, z: Vec, v: Vec, slip: Vec, model: Model, p: Table) -> Vec:
    """The system of the arm with friction on its sliding joints only, and with what bends.

    z : deflections; v : of a step, for arms that need it (`two_mass.motor_system`).
    """
    _, _, _, w1, w2, w3, i1, i2, i3 = x
    _, _, _, n1, h1, _, _, _, n2, h2, _, _, _, n3, h3 = model.drive
    trig = library_trigonometry(x[1], x[2])
    motors = (n1 * i1 - h1 * w1, n2 * i2 - h2 * w2, n3 * i3 - h3 * w3)
    bend = bent_torques(z, model.active, p)
    t1, t2, t3 = effect_torques(x, motors, trig, model, p, slip, bend)
    return rigid_body(w1, w2, w3, t1, t2, t3, trig, model.body)


@inlined
def loads(x: Vec, model: Model) -> Vec:
    """Gravity torques [N.m] of the three joints on a level base, and what their motors give
    after viscous friction, with the currents as they are."""
    _, _, _, w1, w2, w3, i1, i2, i3 = x
    _, _, _, n1, h1, _, _, _, n2, h2, _, _, _, n3, h3 = model.drive
    G2, G3 = gravity_torques(library_trigonometry(x[1], x[2]), model.body)
    return 0.0, G2, G3, n1 * i1 - h1 * w1, n2 * i2 - h2 * w2, n3 * i3 - h3 * w3


@inlined
def borne_torques(system: Vec, lock: Vec) -> Vec:
    """Torques [N.m] that push each joint while the locked ones do not accelerate freely, and the accelerations."""
    m11, m12, m13, m22, m23, m33, b1, b2, b3 = system
    a1, a2, a3 = solve(remove_rows(system, lock))
    return (
        b1 - m11 * a1 - m12 * a2 - m13 * a3,
        b2 - m12 * a1 - m22 * a2 - m23 * a3,
        b3 - m13 * a1 - m23 * a2 - m33 * a3,
        a1,
        a2,
        a3,
    )


@inlined
def trial(digit: int, may: float) -> Vec:
    """(sticks, direction) of a joint at rest for a digit: 0 sticks, 1 and 2 let it go."""
    if may == 0.0:
        return 0.0, 0.0
    if digit == 0:
        return 1.0, 0.0
    return 0.0, 1.0 if digit == 1 else -1.0


@inlined
def starting_levels(g1: float, g2: float, g3: float, x: Vec, load: Vec, p: Table) -> Vec:
    """Friction [N.m], with its sign, of joints at rest that start in these directions."""
    return (
        g1 * sliding_level(0, g1, x[0], load[0], load[3], 0.0, p),
        g2 * sliding_level(1, g2, x[1], load[1], load[4], 0.0, p),
        g3 * sliding_level(2, g3, x[2], load[2], load[5], 0.0, p),
    )


@inlined
def past_friction(
    j: int, sticks: float, inertia: float, torque: float, d: float, h: float, x: Vec, load: Vec, p: Table
) -> float:
    """What friction leaves of a velocity d [rad/s] that a further torque, over h seconds, would give joint j: all where
    it does not stick, else what the torque beyond its level gives. torque [N.m] : what the joint bears already."""
    if sticks == 0.0:
        return d
    torque += inertia * d / h
    direction = 1.0 if torque > 0.0 else -1.0
    beyond = abs(torque) - sliding_level(j, direction, x[j], load[j], load[3 + j], 0.0, p)
    return direction * max(beyond, 0.0) * h / inertia


@inlined
def halt(x: Vec, slip: Vec) -> Vec:
    """The state with the velocity of each joint that has passed through rest set to zero."""
    q1, q2, q3, w1, w2, w3, i1, i2, i3 = x
    if slip[0] * w1 < 0.0:
        w1 = 0.0
    if slip[1] * w2 < 0.0:
        w2 = 0.0
    if slip[2] * w3 < 0.0:
        w3 = 0.0
    return q1, q2, q3, w1, w2, w3, i1, i2, i3


@inlined
def with_held(model: Model, held: Vec) -> Model:
    """The model with the stage of locked joints where any joint is held."""
    if held[0] + held[1] + held[2] > 0.0:
        return Model(model.body, model.drive, model.active | LOCKED)
    return model


def build_contact(system: Callable[..., Any]) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]:
    """Functions that find the contacts of joints, how far a state is from their end, and what passes them.

    system : a function like `free_system`. Returns (x, z, v, model, p, lock, push) -> lock with sticking joints, slip;
    (x, z, v, model, p, lock, held, slip) -> margin, negative once the contact has ended; and
    (x, z, v, d, h, model, p, lock, push) -> the velocities of `past_friction`.
    """

    @inlined
    def contact(x: Vec, z: Vec, v: Vec, model: Model, p: Table, lock: Vec, push: Vec) -> tuple[Any, ...]:
        """Which joints stick and where the others slide: (lock with sticking joints, slip).

        z, v : what the system may need.

        Each joint at rest either sticks, below its level, or starts in a direction in which it then
        accelerates. Exactly one combination holds for all three together: M is positive definite,
        and the accelerations are the minimum of a strictly convex function (Moreau). They are tried
        in turn, all stuck first. Letting go one joint after the other would not do: where one pulls
        another loose, a third may have to stop again.
        """
        _, _, _, w1, w2, w3, _, _, _ = x
        l1, l2, l3, a1, a2, a3 = lock
        s1, may1 = motion(0, l1, w1, p)
        s2, may2 = motion(1, l2, w2, p)
        s3, may3 = motion(2, l3, w3, p)
        held, slip = lock, sliding(s1, s2, s3, p, push)
        if may1 + may2 + may3 > 0.0:
            m11, m12, m13, m22, m23, m33, b1, b2, b3 = system(x, z, v, slip, model, p)
            load = loads(x, model)
            least = 1e300
            for n in range(27):
                n1, n2, n3 = n % 3, n // 3 % 3, n // 9
                if (n1 and may1 == 0.0) or (n2 and may2 == 0.0) or (n3 and may3 == 0.0):
                    continue
                k1, g1 = trial(n1, may1)
                k2, g2 = trial(n2, may2)
                k3, g3 = trial(n3, may3)
                f1, f2, f3 = starting_levels(g1, g2, g3, x, load, p)
                stuck = (l1 + k1, l2 + k2, l3 + k3, a1, a2, a3)
                d1, d2, d3, c1, c2, c3 = borne_torques((m11, m12, m13, m22, m23, m33, b1 - f1, b2 - f2, b3 - f3), stuck)
                # by how much the combination fails [N.m]; more than 0 for all is rounding only
                failure = max(
                    overload(0, k1, d1, x, load, p),
                    overload(1, k2, d2, x, load, p),
                    overload(2, k3, d3, x, load, p),
                    -g1 * c1 * m11,
                    -g2 * c2 * m22,
                    -g3 * c3 * m33,
                )
                if failure < least:
                    least = failure
                    held = stuck
                    slip = sliding(s1 + g1, s2 + g2, s3 + g3, p, push)
                    if failure <= 0.0:
                        break
        return held, slip

    @inlined
    def margin(x: Vec, z: Vec, v: Vec, model: Model, p: Table, lock: Vec, held: Vec, slip: Vec) -> float:
        """How far the state is from the end of its contact: negative once it has ended.

        The smallest of: velocity along the direction of sliding [rad/s], level less torque of a
        sticking joint [N.m].
        """
        least = 1e300
        for j in range(3):
            if slip[j] != 0.0:
                least = min(least, slip[j] * x[3 + j])
        k1 = held[0] - lock[0]
        k2 = held[1] - lock[1]
        k3 = held[2] - lock[2]
        if k1 + k2 + k3 > 0.0:
            d1, d2, d3, _, _, _ = borne_torques(system(x, z, v, slip, model, p), held)
            load = loads(x, model)
            if k1 != 0.0:
                least = min(least, -overload(0, k1, d1, x, load, p))
            if k2 != 0.0:
                least = min(least, -overload(1, k2, d2, x, load, p))
            if k3 != 0.0:
                least = min(least, -overload(2, k3, d3, x, load, p))
        return least

    @inlined
    def passing(x: Vec, z: Vec, v: Vec, d: Vec, h: float, model: Model, p: Table, lock: Vec, push: Vec) -> Vec:
        """`past_friction` of the velocities d [rad/s] of three joints."""
        held, slip = contact(x, z, v, model, p, lock, push)
        k1 = held[0] - lock[0]
        k2 = held[1] - lock[1]
        k3 = held[2] - lock[2]
        if k1 + k2 + k3 == 0.0:
            return d
        found = system(x, z, v, slip, model, p)
        t1, t2, t3, _, _, _ = borne_torques(found, held)
        load = loads(x, model)
        return (
            past_friction(0, k1, found[0], t1, d[0], h, x, load, p),
            past_friction(1, k2, found[3], t2, d[1], h, x, load, p),
            past_friction(2, k3, found[5], t3, d[2], h, x, load, p),
        )

    return contact, margin, passing


def build_changing_step(
    step: Callable[..., Any], contact: Callable[..., Any], margin: Callable[..., Any]
) -> Callable[..., Any]:
    """The step of a system in which joints stick and slip, on top of one with known contacts.

    step : (x, z, v, h, model, p, lock, slip) -> x, z; contact, margin : of `build_contact`.
    """

    @inlined
    def changing_step(
        x: Vec, z: Vec, v: Vec, h: float, model: Model, p: Table, lock: Vec, push: Vec
    ) -> tuple[Any, ...]:
        """`contact_step` where a joint is at rest, or reverses: contacts are found and followed."""
        left = h
        y, z_end = x, z
        for _ in range(_CHANGES):
            held, slip = contact(x, z, v, model, p, lock, push)
            stages = with_held(model, held)
            y, z_end = step(x, z, v, left, stages, p, held, slip)
            g_high = margin(y, z_end, v, model, p, lock, held, slip)
            if not g_high < 0.0:
                return y, z_end
            low, high = 0.0, left
            g_low = max(margin(x, z, v, model, p, lock, held, slip), 0.0)
            y = halt(y, slip)
            side = 0
            for _ in range(_ITERATIONS):
                if high - low <= _RESOLUTION * h:
                    break
                middle = 0.5 * (low + high)
                if g_low > 0.0:
                    middle = low + (high - low) * g_low / (g_low - g_high)
                    # where one end is the moment itself, the other end comes to it
                    if not middle > low:
                        middle = low + _RESOLUTION * h
                    elif not middle < high:
                        middle = high - _RESOLUTION * h
                y_middle, z_middle = step(x, z, v, middle, stages, p, held, slip)
                g = margin(y_middle, z_middle, v, model, p, lock, held, slip)
                if g < 0.0:
                    high, g_high = middle, g
                    if side < 0:
                        g_low *= 0.5
                    side = -1
                    y, z_end = halt(y_middle, slip), z_middle
                else:
                    low, g_low = middle, g
                    if side > 0:
                        g_high *= 0.5
                    side = 1
            x, z = y, z_end
            left -= high
            if left <= _RESOLUTION * h:
                return x, z
        held, slip = contact(x, z, v, model, p, lock, push)
        stages = with_held(model, held)
        y, z_end = step(x, z, v, left, stages, p, held, slip)
        return halt(y, slip), z_end

    return changing_step


contact, margin, _passing = build_contact(free_system)


@outlined
def passing(x: Vec, z: Vec, v: Vec, d: Vec, h: float, model: Model, p: Table, lock: Vec, push: Vec) -> Vec:
    """`past_friction` of the velocities d [rad/s] of an arm's joints; z : all of it."""
    return _passing(x, deflections_of(z), v, d, h, model, p, lock, push)


@outlined
def cold_step(x: Vec, z: Vec, v: Vec, h: float, model: Model, p: Table, held: Vec, slip: Vec) -> tuple[Any, ...]:
    """`rigid.arm_step` as a call, for the places that few steps pass."""
    return arm_step(x, z, v, h, model, p, held, slip)


changing_step = outlined(interpreted(build_changing_step(cold_step, contact, margin)))


@merged
def contact_step(x: Vec, z: Vec, v: Vec, h: float, model: Model, p: Table, lock: Vec, push: Vec) -> tuple[Any, ...]:
    """State and bristles after `h` seconds with dry friction; arguments as `rigid.arm_step`.

    push : torques [N.m] in the direction of positive motion, constant over the step.

    Most steps slide all through, and cost no more than a look at the signs. Should the contact
    change more than a dozen times within one step (joints that chatter against each other), the
    rest of that step is taken in one go, and a joint that reverses in it is stopped at its end.
    """
    active = model.active
    if active & ALGEBRAIC:
        # what decides whether a joint sticks is the current that these voltages drive
        x = settled_state(x, v, model, p)
    if not rests(x, lock):
        slip = sliding(
            slip_direction(0, lock[0], x[3], p),
            slip_direction(1, lock[1], x[4], p),
            slip_direction(2, lock[2], x[5], p),
            p,
            push,
        )
        # stages given as literals let the compiler drop all others
        if active == DRY:
            y, z_end = arm_step(x, z, v, h, Model(model.body, model.drive, DRY), p, lock, slip)
        elif active & ~(DRY | VARYING | LOCKED | TIMED) == 0:
            y, z_end = arm_step(x, z, v, h, Model(model.body, model.drive, DRY | VARYING | LOCKED), p, lock, slip)
        else:
            y, z_end = cold_step(x, z, v, h, model, p, lock, slip)
        if slip[0] * y[3] >= 0.0 and slip[1] * y[4] >= 0.0 and slip[2] * y[5] >= 0.0:
            return y, z_end
    return changing_step(x, z, v, h, model, p, lock, push)
