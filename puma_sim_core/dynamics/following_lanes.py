# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`following` of several models side by side in the lanes of `lanes`: arms with the same joints, with or without dry
friction that has one level for each direction, limits of the current and motors without inductance.

In most rows joints slide in one direction and no current comes near its limit: friction is then a torque that stays
the same, and a lane needs no branch. A row in which that does not hold of a lane (a joint with dry friction rests or
reverses, a current may meet its limit) is taken again by `following`, of that lane alone.
"""

from collections.abc import Callable
from typing import Any

from puma_sim_core.dynamics.contact import passing
from puma_sim_core.dynamics.following import moved_by, predicted
from puma_sim_core.dynamics.lanes import LANE_NUMBERS, LANES, in_lane, lane_of, lane_step, one_of_two, put_state
from puma_sim_core.dynamics.laws import (
    ALGEBRAIC,
    AT_REST,
    CURRENT_LIMIT,
    DRY,
    LOCKED,
    UNBENT,
    constant_level,
    current_bound,
)
from puma_sim_core.dynamics.runs import advance, terminals
from puma_sim_core.dynamics.types import STILL, Drive, Model, Rows, State
from puma_sim_core.jit import Table, Vec, compiled, fitting, inlined, outlined, written

#: stages that a model in a lane may have
IN_LANES = DRY | CURRENT_LIMIT | ALGEBRAIC | LOCKED
#: numbers of one lane: those of `lanes`, those of `limits`, viscous friction with the back-EMF of motors without
#: inductance in it (`circuit.with_damping`), the state at the start of a row, and 1.0 where it is to be taken again
LIMITS, DAMPING, BEFORE, ALONE = LANE_NUMBERS, LANE_NUMBERS + 9, LANE_NUMBERS + 12, LANE_NUMBERS + 21
FOLLOWED = ALONE + 1
#: share of its limit from which a current may meet it within a step
CLEAR = 0.9
#: no drive is cut off
_ON = (1.0, 1.0, 1.0)


def build_sliding(step: Callable[..., Any], one_of_two: Callable[..., Any]) -> Callable[..., Any]:
    """A step whose joints slide as at its start, on top of one like `lanes.lane_step`: (x, v, h, body, drive, limits,
    damping, p, lock) -> state, and whether it does not hold."""

    @inlined
    def ends(w: Table, after: Table, positive: Table, negative: Table) -> Table:
        """Whether a joint with dry friction rests or reverses."""
        return (positive + negative > 0.0) & (w * after <= 0.0)

    @inlined
    def near(i: Table, v: Table, w: Table, y: Table, r: Table, k: Table, h: float, limit: Table) -> Table:
        """Whether a current may meet its limit within a step.

        No stage of a stable step takes it further than its rate at the start, but for what that changes by.
        """
        i = one_of_two(y == 0.0, (v - k * w) / r, i)
        return abs(i) + h * abs((v - r * i - k * w) * y) >= limit

    @inlined
    def sliding_step(
        x: Vec, v: Vec, h: float, body: Vec, drive: Vec, limits: Vec, damping: Vec, p: Table, lock: Vec
    ) -> tuple[Vec, Table]:
        q1, q2, q3, w1, w2, w3, i1, i2, i3 = x
        f1, f2, f3, n1, n2, n3, c1, c2, c3 = limits
        d1, d2, d3 = damping
        y1, r1, k1, t1, _, y2, r2, k2, t2, _, y3, r3, k3, t3, _ = drive
        damped = (y1, r1, k1, t1, d1, y2, r2, k2, t2, d2, y3, r3, k3, t3, d3)
        through = (
            one_of_two(y1 == 0.0, v[0] / r1, i1),
            one_of_two(y2 == 0.0, v[1] / r2, i2),
            one_of_two(y3 == 0.0, v[2] / r3, i3),
        )
        friction = one_of_two(w1 > 0.0, f1, -n1), one_of_two(w2 > 0.0, f2, -n2), one_of_two(w3 > 0.0, f3, -n3)
        slip, model = (0.0, 0.0, 0.0, *friction), Model(body, damped, DRY | LOCKED)
        z, _ = step((q1, q2, q3, w1, w2, w3, *through), UNBENT, v, h, model, p, lock, slip)
        alone = ends(w1, z[3], f1, n1) | ends(w2, z[4], f2, n2) | ends(w3, z[5], f3, n3)
        alone = alone | near(i1, v[0], w1, y1, r1, k1, h, c1) | near(z[6], v[0], z[3], y1, r1, k1, 0.0, c1)
        alone = alone | near(i2, v[1], w2, y2, r2, k2, h, c2) | near(z[7], v[1], z[4], y2, r2, k2, 0.0, c2)
        alone = alone | near(i3, v[2], w3, y3, r3, k3, h, c3) | near(z[8], v[2], z[5], y3, r3, k3, 0.0, c3)
        return z, alone

    return sliding_step


@inlined
def moved(x: Vec, e: Vec, gain: Table) -> Vec:
    """The state of an arm whose joints slide that innovations e [rad] have moved."""
    return (
        x[0] + gain[0] * e[0],
        x[1] + gain[3] * e[1],
        x[2] + gain[6] * e[2],
        x[3] + gain[1] * e[0],
        x[4] + gain[4] * e[1],
        x[5] + gain[7] * e[2],
        x[6] + gain[2] * e[0],
        x[7] + gain[5] * e[1],
        x[8] + gain[8] * e[2],
    )


sliding_step = build_sliding(lane_step, one_of_two)
#: (a, m) -> the numbers of `limits` and the damping of lane m, and its state at the start of a row; (a, m, active) ->
#: its model
limits_of = written("limits_of", "a, m", [f"return ({', '.join(in_lane(LIMITS, 9))})"], {})
damping_of = written("damping_of", "a, m", [f"return ({', '.join(in_lane(DAMPING, 3))})"], {})
_MODEL = f"return Model(({', '.join(in_lane(12, 20))}), Drive({', '.join(in_lane(32, 15))}), active)"
model_of = written("model_of", "a, m, active", [_MODEL], {"Model": Model, "Drive": Drive})
before_of = written("before_of", "a, m", [f"return ({', '.join(in_lane(BEFORE, 9))})"], {})


@compiled
def _limits(p: Table) -> Vec:
    return (
        constant_level(0, 1.0, p),
        constant_level(1, 1.0, p),
        constant_level(2, 1.0, p),
        constant_level(0, -1.0, p),
        constant_level(1, -1.0, p),
        constant_level(2, -1.0, p),
        CLEAR * current_bound(0, p),
        CLEAR * current_bound(1, p),
        CLEAR * current_bound(2, p),
    )


def limits(p: Table) -> Vec:
    """Levels of friction [N.m] in positive and in negative direction, and currents [A] that are near their limit."""
    return fitting(_limits, p)(p)


@outlined
def row_alone(x: Vec, v: Vec, t: float, h: float, n: int, model: Model, parts: int, p: Table, lock: Vec) -> Vec:
    """The state of an arm after n steps of h seconds."""
    return predicted(advance, State(x, AT_REST, STILL), v, t, h, n, model, parts, p, lock).x


@outlined
def moved_alone(x: Vec, e: Vec, v: Vec, over: float, t: float, gain: Table, model: Model, p: Table, lock: Vec) -> Vec:
    """The state of an arm that innovations e [rad] have moved."""
    return moved_by(passing, State(x, AT_REST, STILL), e, v, _ON, over, t, gain, model, p, lock).x


@inlined
def slide(a: Table, h: float, p: Table, lock: Vec) -> None:
    """One step of all lanes that slide."""
    for m in range(LANES):
        x, v, body, drive = lane_of(a, m)
        y, alone = sliding_step(x, v, h, body, drive, limits_of(a, m), damping_of(a, m), p, lock)
        put_state(a, m, y)
        a[ALONE * LANES + m] = one_of_two(alone, 1.0, a[ALONE * LANES + m])


@compiled
def follow_lanes(
    a: Table,
    active: int,
    rows: Rows,
    measured: Table,
    corrected: Table,
    gain: Table,
    tables: Table,
    alike: bool,
    parts: Table,
    lock: Vec,
    out: Table,
) -> None:
    """Innovations of one group of LANES models that follow a measured motion.

    a : flat, FOLLOWED * LANES, number k of lane m at k * LANES + m, moved on; active : stages of all of them, of
    `IN_LANES`; rows : commanded voltages and steps; measured (n, 3) [rad], at the ends of the rows; corrected (n,),
    gain (9,) and parts (LANES,) as for `following.Track`; tables (LANES, ...) : packed effects of each lane; alike :
    whether those on the voltages are the same; lock : of all; out (LANES, n, 3): the innovations [rad].
    """
    since = 0.0
    for r in range(len(rows.count)):
        h, n, t = rows.step[r], rows.count[r], rows.time[r]
        v = terminals(rows.voltage, r, tables[0])
        for m in range(LANES):
            if not alike:
                v = terminals(rows.voltage, r, tables[m])
            for k in range(3):
                a[(9 + k) * LANES + m] = v[k]
            for k in range(9):
                a[(BEFORE + k) * LANES + m] = a[k * LANES + m]
            a[ALONE * LANES + m] = 0.0
        for _ in range(n):
            slide(a, h, tables[0], lock)
        since += n * h
        for m in range(LANES):
            if a[ALONE * LANES + m] != 0.0:
                _, v, _, _ = lane_of(a, m)
                model = model_of(a, m, active)
                put_state(a, m, row_alone(before_of(a, m), v, t, h, n, model, parts[m], tables[m], lock))
        for j in range(3):
            for m in range(LANES):
                out[m, r, j] = measured[r][j] - a[j * LANES + m]
        if not corrected[r]:
            continue
        for m in range(LANES):
            e = (out[m, r, 0], out[m, r, 1], out[m, r, 2])
            x, v, _, _ = lane_of(a, m)
            if a[ALONE * LANES + m] != 0.0:
                model = model_of(a, m, active)
                put_state(a, m, moved_alone(x, e, v, since, t + n * h, gain, model, tables[m], lock))
            else:
                put_state(a, m, moved(x, e, gain))
        since = 0.0
