# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A step of lanes whose effects depend on more than the direction of motion: friction over speed or pose, torques over
position or time.

The laws of effects branch, so that their torques are taken lane by lane; the loops around them, of sines and cosines,
the rigid body and the sums of the Runge-Kutta step (`rk4`), the compiler turns into vector instructions.
"""

from puma_sim_core.dynamics.circuit import drive_at, with_damping
from puma_sim_core.dynamics.contact import sliding, slip_direction
from puma_sim_core.dynamics.lanes.places import (
    model_of,
    put_rate,
    put_slip,
    put_stage,
    put_step_drive,
    put_sum,
    put_torque,
    put_trig,
    rate_of,
    slip_of,
    stage_of,
    step_drive_of,
    sum_of,
    torque_of,
    trig_of,
)
from puma_sim_core.dynamics.lanes.registers import (
    LANES,
    body_of,
    polynomial_trigonometry,
    put_state,
    state_of,
    volts_of,
)
from puma_sim_core.dynamics.laws import ALGEBRAIC, DRY, POSED, SMOOTH, TILT, TIMED, VARYING
from puma_sim_core.dynamics.rigid import remove_rows, rigid_body, solve
from puma_sim_core.dynamics.rk4 import ARM
from puma_sim_core.dynamics.torques import effect_torques, push_over
from puma_sim_core.dynamics.types import STILL, Model
from puma_sim_core.jit import Table, Vec, inlined, outlined

#: stages whose torques are taken lane by lane
LANE_BY_LANE = SMOOTH | VARYING | POSED | TILT | TIMED
_moved = ARM.moved


@outlined
def begin_step(a: Table, h: float, t: float, active: int, tables: Table, lock: Vec) -> None:
    """What stays the same over a step from time t [s] on: drive, and torques of friction and from outside."""
    for m in range(LANES):
        p, x, push = tables[m], state_of(a, m), STILL
        model = model_of(a, m, active)
        if active & TIMED:
            model, push = Model(model.body, drive_at(t + 0.5 * h, model.drive, p), active), push_over(t, h, p)
        if active & ALGEBRAIC:
            x, model = with_damping(x, volts_of(a, m), model)
            put_state(a, m, x)
        put_step_drive(a, m, model.drive)
        s1, s2, s3 = 0.0, 0.0, 0.0
        if active & DRY:
            s1 = slip_direction(0, lock[0], x[3], p)
            s2 = slip_direction(1, lock[1], x[4], p)
            s3 = slip_direction(2, lock[2], x[5], p)
        put_slip(a, m, sliding(s1, s2, s3, p, push))


@outlined
def stage_rates(a: Table, active: int, tables: Table, lock: Vec) -> None:
    """Derivatives of the states of a stage."""
    for m in range(LANES):
        x = stage_of(a, m)
        _, _, _, n1, h1, _, _, _, n2, h2, _, _, _, n3, h3 = step_drive_of(a, m)
        put_trig(a, m, polynomial_trigonometry(x[1], x[2]))
        put_torque(a, m, (n1 * x[6] - h1 * x[3], n2 * x[7] - h2 * x[4], n3 * x[8] - h3 * x[5]))
    for m in range(LANES):
        model, trig = model_of(a, m, active), trig_of(a, m)
        torques = effect_torques(stage_of(a, m), torque_of(a, m), trig, model, tables[m], slip_of(a, m), STILL)
        put_torque(a, m, torques)
    for m in range(LANES):
        x, v, t = stage_of(a, m), volts_of(a, m), torque_of(a, m)
        y1, r1, k1, _, _, y2, r2, k2, _, _, y3, r3, k3, _, _ = step_drive_of(a, m)
        system = rigid_body(x[3], x[4], x[5], t[0], t[1], t[2], trig_of(a, m), body_of(a, m))
        a1, a2, a3 = solve(remove_rows(system, lock))
        e1 = (v[0] - r1 * x[6] - k1 * x[3]) * y1
        e2 = (v[1] - r2 * x[7] - k2 * x[4]) * y2
        e3 = (v[2] - r3 * x[8] - k3 * x[5]) * y3
        put_rate(a, m, (x[3], x[4], x[5], a1, a2, a3, e1, e2, e3))


@inlined
def effect_step(a: Table, h: float, t: float, active: int, tables: Table, lock: Vec) -> None:
    """One step of all lanes from time t [s] on, in which joints slide as at its start; its end is left as the state of
    a stage."""
    begin_step(a, h, t, active, tables, lock)
    for m in range(LANES):
        put_stage(a, m, state_of(a, m))
    stage_rates(a, active, tables, lock)
    for m in range(LANES):
        put_sum(a, m, rate_of(a, m))
        put_stage(a, m, _moved(state_of(a, m), 0.5 * h, rate_of(a, m)))
    stage_rates(a, active, tables, lock)
    for m in range(LANES):
        put_sum(a, m, _moved(sum_of(a, m), 2.0, rate_of(a, m)))
        put_stage(a, m, _moved(state_of(a, m), 0.5 * h, rate_of(a, m)))
    stage_rates(a, active, tables, lock)
    for m in range(LANES):
        put_sum(a, m, _moved(sum_of(a, m), 2.0, rate_of(a, m)))
        put_stage(a, m, _moved(state_of(a, m), h, rate_of(a, m)))
    stage_rates(a, active, tables, lock)
    for m in range(LANES):
        put_sum(a, m, _moved(sum_of(a, m), 1.0, rate_of(a, m)))
        put_stage(a, m, _moved(state_of(a, m), h / 6.0, sum_of(a, m)))
