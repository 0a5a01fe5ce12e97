# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One step of an arm whose links do not follow their motors exactly.

A soft joint, with a spring or backlash, has two rows: its rotor, a scalar with the motor, its
friction and the torque tau that it transmits; and its link, a row of the rigid-body equations
that tau drives. With u(q) the output angle of the gear at the motor's angle q, equal to q for a
round gear,

    rotor, soft    J qdd = kT i - H qd - friction - u'(q) tau(u - ql, du/dt - qdl)
    links          (D + (1 - motor_share) Ia) qldd + C(qdl, qdl) + G = tau - stops
    rigid joint    ql = u(q), qldd = u' qdd + u'' qd^2, and its link's row times u' in its rotor's:
                   Ia qdd = kT i - H qd - friction - u' (torque that the link takes)

so that a transmission error is exact in its amplitude e. What a model of first order in e would
lack was measured over 5 s of all joints in motion, e = 1 mrad on one of them: 1e-7 rad at one
period a turn, 1e-5 at eight, 2e-4 at fifty, of an effect on the motor's position of 5e-4 to 3e-3.

The state x belongs to the motors, and is what encoders on them measure. Behind the deflections of the bristles, z
holds positions [rad] and velocities [rad/s] of the three links. Arguments are those of `types`, with the table of
`plant.drive_train` behind p, the body made of its `link_arm`, and in v, behind the voltages, the torques [N.m] that
push the links from outside. A constraint holds the motor of a soft joint, not its link.
"""

from typing import Any

from puma_sim_core.dynamics.circuit import electric_rates, settled_state
from puma_sim_core.dynamics.contact import build_changing_step, build_contact
from puma_sim_core.dynamics.laws import (
    ALGEBRAIC,
    AT_REST,
    DRY,
    POSED,
    SMOOTH,
    TILT,
    deflections_of,
    link_torque,
    motor_torque,
    with_deflections,
    with_links,
)
from puma_sim_core.dynamics.rigid import library_trigonometry, remove_rows, rigid_body, solve
from puma_sim_core.dynamics.rk4 import build_step, sums_of
from puma_sim_core.dynamics.torques import bent_torques, effect_torques
from puma_sim_core.dynamics.types import NO_SLIP, STILL, Model
from puma_sim_core.effects.shared.drive_train import (
    TRAIN_WIDTH,
    gear_output,
    is_soft,
    rotor_inertia,
    transmitted,
    twist_under,
)
from puma_sim_core.jit import Table, Vec, inlined, interpreted, outlined

#: trig of a pose that nothing asks for
NO_POSE = (0.0, 1.0, 0.0, 1.0)


@inlined
def trains(p: Any) -> tuple[int, int, int]:
    """Where the three joints' trains start in p, at whose end the least rate of steps stands.

    Constants would do, but with them each function below would be compiled once for each.
    """
    end = len(p) - 1
    return end - 3 * TRAIN_WIDTH, end - 2 * TRAIN_WIDTH, end - TRAIN_WIDTH


@inlined
def steps_within(h: float, p: Table) -> int:
    """Steps that a step of h seconds is divided into, so that the drive trains are followed."""
    return int(h * p[len(p) - 1] * (1.0 - 1e-9)) + 1


@inlined
def link_motion(k: int, q: float, w: float, ql: float, wl: float, p: Table) -> Vec:
    """Position and velocity of a link: of its own if the joint is soft, else made by the motor."""
    if is_soft(p, k):
        return ql, wl
    u, slope, _ = gear_output(p, k, q)
    return u, slope * w


@inlined
def link_motions(x: Vec, s: Vec, p: Table) -> Vec:
    """`link_motion` of the three links, positions and then velocities; s : those of soft joints."""
    k1, k2, k3 = trains(p)
    u1, s1 = link_motion(k1, x[0], x[3], s[0], s[3], p)
    u2, s2 = link_motion(k2, x[1], x[4], s[1], s[4], p)
    u3, s3 = link_motion(k3, x[2], x[5], s[2], s[5], p)
    return u1, u2, u3, s1, s2, s3


@inlined
def coupling(k: int, q: float, w: float, ql: float, wl: float, p: Table) -> Vec:
    """(tau, u', factor, excess) of a joint.

    tau : torque [N.m] that a soft joint transmits; u' : ratio of the gear; the link's acceleration
    is `factor` times the unknown of its row plus `excess`.
    """
    u, slope, curvature = gear_output(p, k, q)
    if is_soft(p, k):
        return transmitted(p, k, u - ql, slope * w - wl), slope, 1.0, 0.0
    return 0.0, slope, slope, curvature * w * w


@inlined
def rotor_torques(x: Vec, model: Model, p: Table, slip: Vec, bend: Vec) -> Vec:
    """Torques [N.m] of the motors less friction and what else acts on the rotors."""
    q1, q2, q3, w1, w2, w3, i1, i2, i3 = x
    body, drive, active = model
    _, _, _, n1, h1, _, _, _, n2, h2, _, _, _, n3, h3 = drive
    motors = (n1 * i1 - h1 * w1, n2 * i2 - h2 * w2, n3 * i3 - h3 * w3)
    own = Model(body, drive, active & ~(SMOOTH | TILT))
    # only friction by the pose asks for the pose here
    trig = library_trigonometry(q2, q3) if active & POSED else NO_POSE
    t1, t2, t3 = effect_torques(x, motors, trig, own, p, slip, bend)
    if active & SMOOTH:
        t1 -= motor_torque(0, q1, w1, p)
        t2 -= motor_torque(1, q2, w2, p)
        t3 -= motor_torque(2, q3, w3, p)
    return t1, t2, t3


@inlined
def link_torques(s: Vec, t: Vec, trig: Vec, push: Vec, model: Model, p: Table) -> Vec:
    """Torques [N.m] on the links with what stops, springs and the outside do; t : those of the joints."""
    body, drive, active = model
    t1, t2, t3 = t[0] + push[0], t[1] + push[1], t[2] + push[2]
    if active & TILT:
        t1, t2, t3 = effect_torques(s, (t1, t2, t3), trig, Model(body, drive, TILT), p, NO_SLIP, STILL)
    if active & SMOOTH:
        t1 -= link_torque(0, s[0], s[3], p)
        t2 -= link_torque(1, s[1], s[4], p)
        t3 -= link_torque(2, s[2], s[5], p)
    return t1, t2, t3


@inlined
def rotor_row(k: int, m: float, b: float, factor: float, torque: float, p: Table) -> Vec:
    """Diagonal and right-hand side of a rigid joint's row, with its rotor in it."""
    if is_soft(p, k):
        return m, b
    return m * factor * factor + rotor_inertia(p, k), b * factor + torque


@inlined
def link_system(x: Vec, s: Vec, v: Vec, model: Model, p: Table, slip: Vec, bend: Vec) -> tuple[Any, ...]:
    """M and b of the rows of the links, and the torques [N.m] that accelerate soft rotors.

    The unknowns are accelerations: of the link where the joint is soft, of the motor where it is
    rigid. s : `link_motions`.
    """
    k1, k2, k3 = trains(p)
    rotor = rotor_torques(x, model, p, slip, bend)
    tau1, g1, f1, c1 = coupling(k1, x[0], x[3], s[0], s[3], p)
    tau2, g2, f2, c2 = coupling(k2, x[1], x[4], s[1], s[4], p)
    tau3, g3, f3, c3 = coupling(k3, x[2], x[5], s[2], s[5], p)
    trig = library_trigonometry(s[1], s[2])
    t1, t2, t3 = link_torques(s, (tau1, tau2, tau3), trig, (v[3], v[4], v[5]), model, p)
    m11, m12, m13, m22, m23, m33, b1, b2, b3 = rigid_body(s[3], s[4], s[5], t1, t2, t3, trig, model.body)
    b1 -= m11 * c1 + m12 * c2 + m13 * c3
    b2 -= m12 * c1 + m22 * c2 + m23 * c3
    b3 -= m13 * c1 + m23 * c2 + m33 * c3
    m11, b1 = rotor_row(k1, m11, b1, f1, rotor[0], p)
    m22, b2 = rotor_row(k2, m22, b2, f2, rotor[1], p)
    m33, b3 = rotor_row(k3, m33, b3, f3, rotor[2], p)
    system = (m11, f1 * f2 * m12, f1 * f3 * m13, m22, f2 * f3 * m23, m33, b1, b2, b3)
    return system, (rotor[0] - g1 * tau1, rotor[1] - g2 * tau2, rotor[2] - g3 * tau3)


@inlined
def rigid_lock(lock: Vec, p: Table) -> Vec:
    """The lock without its soft joints: it holds their rotors, not their links."""
    k1, k2, k3 = trains(p)
    l1, l2, l3, a1, a2, a3 = lock
    return (0.0 if is_soft(p, k1) else l1, 0.0 if is_soft(p, k2) else l2, 0.0 if is_soft(p, k3) else l3, a1, a2, a3)


@inlined
def rotor_acceleration(k: int, own: float, torque: float, locked: float, given: float, p: Table) -> Vec:
    """(acceleration of the rotor, of the soft link) [rad/s^2]; own : solution of the row."""
    if not is_soft(p, k):
        return own, 0.0
    return given if locked != 0.0 else torque / rotor_inertia(p, k), own


@outlined
def rates(y: Vec, v: Vec, model: Model, p: Table, lock: Vec, slip: Vec, bend: Vec) -> Vec:
    """Derivative of (q, qd, i, ql, qdl), fifteen numbers; zero for the links of rigid joints."""
    _body, _drive, _active = model
    k1, k2, k3 = trains(p)
    i1, i2, i3, e1, e2, e3 = electric_rates(y, v, model, p)
    x = (y[0], y[1], y[2], y[3], y[4], y[5], i1, i2, i3)
    s = link_motions(x, (y[9], y[10], y[11], y[12], y[13], y[14]), p)
    system, torques = link_system(x, s, v, model, p, slip, bend)
    a1, a2, a3 = solve(remove_rows(system, rigid_lock(lock, p)))
    a1, d1 = rotor_acceleration(k1, a1, torques[0], lock[0], lock[3], p)
    a2, d2 = rotor_acceleration(k2, a2, torques[1], lock[1], lock[4], p)
    a3, d3 = rotor_acceleration(k3, a3, torques[2], lock[2], lock[5], p)
    return y[3], y[4], y[5], a1, a2, a3, e1, e2, e3, y[12], y[13], y[14], d1, d2, d3


@inlined
def with_links_behind(x: Vec, z: Vec) -> Vec:
    """(q, qd, i, ql, qdl), fifteen numbers."""
    return (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], z[3], z[4], z[5], z[6], z[7], z[8])


_rk4_step = build_step(rates, sums_of(15, "a{i} + d{i} + 2.0 * (b{i} + c{i})"), library_trigonometry)


@outlined
def two_mass_step(x: Vec, z: Vec, v: Vec, h: float, model: Model, p: Table, lock: Vec, slip: Vec) -> tuple[Any, ...]:
    """State and z after one Runge-Kutta step of h seconds, as `rigid.arm_step`."""
    y = with_links_behind(x, z)
    y, bent = _rk4_step(y, deflections_of(z), v, h, model, p, lock, slip)
    x = (y[0], y[1], y[2], y[3], y[4], y[5], y[6], y[7], y[8])
    s = link_motions(x, (y[9], y[10], y[11], y[12], y[13], y[14]), p)
    return x, with_links(with_deflections(z, bent), s)


@inlined
def without_link(k: int, c: int, system: Vec, torque: float, p: Table) -> Vec:
    """The system with the link's row c of a soft joint eliminated and its rotor's in its place."""
    m11, m12, m13, m22, m23, m33, b1, b2, b3 = system
    if not is_soft(p, k):
        return m11, m12, m13, m22, m23, m33, b1, b2, b3
    inertia = rotor_inertia(p, k)
    if c == 0:
        f2, f3 = m12 / m11, m13 / m11
        return (inertia, 0.0, 0.0, m22 - f2 * m12, m23 - f2 * m13, m33 - f3 * m13, torque, b2 - f2 * b1, b3 - f3 * b1)
    if c == 1:
        f1, f3 = m12 / m22, m23 / m22
        return (m11 - f1 * m12, 0.0, m13 - f1 * m23, inertia, 0.0, m33 - f3 * m23, b1 - f1 * b2, torque, b3 - f3 * b2)
    f1, f2 = m13 / m33, m23 / m33
    return (m11 - f1 * m13, m12 - f1 * m23, 0.0, m22 - f2 * m23, 0.0, inertia, b1 - f1 * b3, b2 - f2 * b3, torque)


@outlined
def motor_system(x: Vec, z: Vec, v: Vec, slip: Vec, model: Model, p: Table) -> Vec:
    """M and b of the motors alone, with friction on the sliding ones: what contacts are decided by.

    A soft rotor has a row without couplings; the links of soft joints, which no friction holds,
    are eliminated.
    """
    k1, k2, k3 = trains(p)
    s = link_motions(x, (z[3], z[4], z[5], z[6], z[7], z[8]), p)
    bend = bent_torques(deflections_of(z), model.active, p)
    system, torques = link_system(x, s, v, model, p, slip, bend)
    system = without_link(k1, 0, system, torques[0], p)
    system = without_link(k2, 1, system, torques[1], p)
    return without_link(k3, 2, system, torques[2], p)


motor_contact, motor_margin, _passing = (outlined(interpreted(found)) for found in build_contact(motor_system))
_changing_step = build_changing_step(two_mass_step, motor_contact, motor_margin)


@outlined
def train_step(x: Vec, z: Vec, v: Vec, h: float, model: Model, p: Table, lock: Vec, push: Vec) -> tuple[Any, ...]:
    """State and z after `h` seconds, in as many steps as the drive trains need.

    Arguments as `contact.contact_step`: v are the voltages, push the torques from outside.
    """
    count = steps_within(h, p)
    part = h / count
    held = (v[0], v[1], v[2], push[0], push[1], push[2])
    for _ in range(count):
        if model.active & DRY:
            if model.active & ALGEBRAIC:
                x = settled_state(x, v, model, p)
            x, z = _changing_step(x, z, held, part, model, p, lock, STILL)
        else:
            x, z = two_mass_step(x, z, held, part, model, p, lock, NO_SLIP)
    return x, z


@outlined
def train_passing(x: Vec, z: Vec, v: Vec, d: Vec, h: float, model: Model, p: Table, lock: Vec, push: Vec) -> Vec:
    """`contact.passing` of the motors of drive trains."""
    held = (v[0], v[1], v[2], push[0], push[1], push[2])
    return _passing(x, z, held, d, h, model, p, lock, STILL)


@outlined
def train_rates(x: Vec, z: Vec, v: Vec, model: Model, p: Table, lock: Vec, push: Vec) -> Vec:
    """`rates` at a state, with the joints that stick found and the bristles bent as they are."""
    held = (v[0], v[1], v[2], push[0], push[1], push[2])
    still, slip, bend = lock, NO_SLIP, bent_torques(deflections_of(z), model.active, p)
    if model.active & ALGEBRAIC:
        x = settled_state(x, v, model, p)
    if model.active & DRY:
        still, slip = motor_contact(x, z, held, model, p, lock, STILL)
    y = with_links_behind(x, z)
    return rates(y, held, model, p, still, slip, bend)


@inlined
def settled_link(k: int, q: float, w: float, torque: float, p: Table) -> Vec:
    """Position [rad] and velocity [rad/s] of a link that follows its motor under `torque` [N.m]."""
    u, slope, _ = gear_output(p, k, q)
    return u - twist_under(p, k, torque) if is_soft(p, k) else u, slope * w


@inlined
def link_acceleration(k: int, q: float, w: float, a: float, p: Table) -> float:
    """Acceleration [rad/s^2] of a link that follows its motor."""
    _, slope, curvature = gear_output(p, k, q)
    return slope * a + curvature * w * w


@outlined
def settled_links(x: Vec, model: Model, p: Table, stiff: Table, lock: Vec, push: Vec) -> Vec:
    """Positions and velocities of links that follow their motors without swinging, six numbers.

    Each joint is twisted by the torque that its link would take if no joint were soft; backlash lies
    on the side of that torque. stiff : the table with its joints made rigid.
    """
    k1, k2, k3 = trains(p)
    v = (0.0, 0.0, 0.0)
    rigid = Model(model.body, model.drive, model.active & ~ALGEBRAIC)
    r = train_rates(x, AT_REST, v, rigid, stiff, lock, push)
    a1 = link_acceleration(k1, x[0], x[3], r[3], p)
    a2 = link_acceleration(k2, x[1], x[4], r[4], p)
    a3 = link_acceleration(k3, x[2], x[5], r[5], p)
    s = link_motions(x, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), stiff)
    # the weight and inertia of the twisted arm differ a little from those of the straight one
    for _ in range(3):
        trig = library_trigonometry(s[1], s[2])
        e1, e2, e3 = link_torques(s, (0.0, 0.0, 0.0), trig, push, model, p)
        m11, m12, m13, m22, m23, m33, b1, b2, b3 = rigid_body(s[3], s[4], s[5], e1, e2, e3, trig, model.body)
        t1 = m11 * a1 + m12 * a2 + m13 * a3 - b1
        t2 = m12 * a1 + m22 * a2 + m23 * a3 - b2
        t3 = m13 * a1 + m23 * a2 + m33 * a3 - b3
        l1, u1 = settled_link(k1, x[0], x[3], t1, p)
        l2, u2 = settled_link(k2, x[1], x[4], t2, p)
        l3, u3 = settled_link(k3, x[2], x[5], t3, p)
        s = (l1, l2, l3, u1, u2, u3)
    return s
