# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`dynamics.following` of several models side by side in `registers`: arms with the same joints and the same stages.

In most rows joints slide in one direction and no current comes near its limit: a lane then needs no search for the
moment at which a contact ends. A row in which that does not hold of a lane (a joint with dry friction rests or
reverses, a current may meet its limit) is taken again by `dynamics.following`, of that lane alone.
"""

from collections.abc import Callable
from typing import Any

from puma_sim_core.dynamics.contact import passing
from puma_sim_core.dynamics.following import moved_by, predicted
from puma_sim_core.dynamics.lanes.effects import LANE_BY_LANE, effect_step
from puma_sim_core.dynamics.lanes.places import (
    ALONE,
    before_of,
    damping_of,
    has_dry_of,
    levels_of,
    model_of,
    near_limit_of,
    put_before,
    stage_of,
    step_drive_of,
)
from puma_sim_core.dynamics.lanes.registers import (
    LANES,
    body_of,
    drive_of,
    lane_step,
    one_of_two,
    put_state,
    put_volts,
    state_of,
    volts_of,
)
from puma_sim_core.dynamics.laws import (
    ALGEBRAIC,
    AT_REST,
    CURRENT_LIMIT,
    DELAYED,
    DRY,
    LOCKED,
    UNBENT,
    constant_level,
    current_bound,
)
from puma_sim_core.dynamics.runs import advance, terminals
from puma_sim_core.dynamics.torques import has_dry
from puma_sim_core.dynamics.types import STILL, Model, Rows, State
from puma_sim_core.jit import Table, Vec, compiled, fitting, inlined, outlined

#: stages whose steps are vector instructions throughout: dry friction has one level for each direction
SLIDING = DRY | CURRENT_LIMIT | ALGEBRAIC | LOCKED | DELAYED
#: stages that a model in a lane may have
IN_LANES = SLIDING | LANE_BY_LANE
#: share of its limit from which a current may meet it within a step
CLEAR = 0.9
#: no drive is cut off
_ON = (1.0, 1.0, 1.0)


def build_sliding(
    step: Callable[..., Any], one_of_two: Callable[..., Any]
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """A step whose joints slide as at its start, on top of one like `lanes.lane_step`: (x, v, h, body, drive, levels,
    damping, p, lock) -> state; and whether a step does not hold: (x, after, v, h, drive, has_dry, near_limit) -> true
    where a joint with dry friction rests or reverses, or a current may meet its limit."""

    @inlined
    def sliding_step(
        x: Vec, v: Vec, h: float, body: Vec, drive: Vec, levels: Vec, damping: Vec, p: Table, lock: Vec
    ) -> Vec:
        q1, q2, q3, w1, w2, w3, i1, i2, i3 = x
        f1, f2, f3, n1, n2, n3 = levels
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
        after, _ = step((q1, q2, q3, w1, w2, w3, *through), UNBENT, v, h, model, p, lock, slip)
        return after

    @inlined
    def near(i: Table, v: Table, w: Table, y: Table, r: Table, k: Table, h: float, limit: Table) -> Table:
        """Whether a current may meet its limit within a step.

        No stage of a stable step takes it further than its rate at the start, but for what that changes by.
        """
        i = one_of_two(y == 0.0, (v - k * w) / r, i)
        return abs(i) + h * abs((v - r * i - k * w) * y) >= limit

    @inlined
    def leaves(x: Vec, after: Vec, v: Vec, h: float, drive: Vec, has_dry: Vec, near_limit: Vec) -> Table:
        y1, r1, k1, _, _, y2, r2, k2, _, _, y3, r3, k3, _, _ = drive
        c1, c2, c3 = near_limit
        out = (has_dry[0] > 0.0) & (x[3] * after[3] <= 0.0)
        out = out | (has_dry[1] > 0.0) & (x[4] * after[4] <= 0.0)
        out = out | (has_dry[2] > 0.0) & (x[5] * after[5] <= 0.0)
        out = out | near(x[6], v[0], x[3], y1, r1, k1, h, c1) | near(after[6], v[0], after[3], y1, r1, k1, 0.0, c1)
        out = out | near(x[7], v[1], x[4], y2, r2, k2, h, c2) | near(after[7], v[1], after[4], y2, r2, k2, 0.0, c2)
        out = out | near(x[8], v[2], x[5], y3, r3, k3, h, c3) | near(after[8], v[2], after[5], y3, r3, k3, 0.0, c3)
        return out

    return sliding_step, leaves


sliding_step, leaves = build_sliding(lane_step, one_of_two)


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


@compiled
def _bounds(p: Table) -> Vec:
    return (
        constant_level(0, 1.0, p),
        constant_level(1, 1.0, p),
        constant_level(2, 1.0, p),
        constant_level(0, -1.0, p),
        constant_level(1, -1.0, p),
        constant_level(2, -1.0, p),
        1.0 if has_dry(0, p) else 0.0,
        1.0 if has_dry(1, p) else 0.0,
        1.0 if has_dry(2, p) else 0.0,
        CLEAR * current_bound(0, p),
        CLEAR * current_bound(1, p),
        CLEAR * current_bound(2, p),
    )


def bounds(p: Table) -> Vec:
    """The numbers of a lane from `LEVELS` on, up to its damping."""
    return fitting(_bounds, p)(p)


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
    """One step of lanes that have stages of `SLIDING` alone."""
    for m in range(LANES):
        x, v, drive = state_of(a, m), volts_of(a, m), drive_of(a, m)
        after = sliding_step(x, v, h, body_of(a, m), drive, levels_of(a, m), damping_of(a, m), p, lock)
        alone = leaves(x, after, v, h, drive, has_dry_of(a, m), near_limit_of(a, m))
        put_state(a, m, after)
        a[ALONE * LANES + m] = one_of_two(alone, 1.0, a[ALONE * LANES + m])


@inlined
def slide_with_effects(a: Table, h: float, t: float, active: int, tables: Table, lock: Vec) -> None:
    """One step of lanes that have others."""
    effect_step(a, h, t, active, tables, lock)
    for m in range(LANES):
        x, after, drive = state_of(a, m), stage_of(a, m), step_drive_of(a, m)
        alone = leaves(x, after, volts_of(a, m), h, drive, has_dry_of(a, m), near_limit_of(a, m))
        put_state(a, m, after)
        a[ALONE * LANES + m] = one_of_two(alone, 1.0, a[ALONE * LANES + m])


@compiled
def follow_lanes(
    a: Table,
    active: int,
    rows: Rows,
    target: Table,
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

    a : flat, FOLLOWED * LANES, the numbers of `places`, moved on; active : stages of all of them, of `IN_LANES`;
    rows : commanded voltages and steps; target (k,), of measured (n, 3) [rad], corrected (n,), gain (9,) and parts
    (LANES,) as for `dynamics.following.Track`; tables (LANES, ...) : packed effects of each lane; alike : whether those
    on the voltages are the same; lock : of all; out (LANES, n, 3): the innovations [rad].
    """
    since = 0.0
    for r in range(len(rows.count)):
        h, n, t = rows.step[r], rows.count[r], rows.time[r]
        v = terminals(rows.voltage, r, tables[0])
        for m in range(LANES):
            if not alike:
                v = terminals(rows.voltage, r, tables[m])
            put_volts(a, m, v)
            put_before(a, m, state_of(a, m))
            a[ALONE * LANES + m] = 0.0
        for k in range(n):
            if active & LANE_BY_LANE:
                slide_with_effects(a, h, t + k * h, active, tables, lock)
            else:
                slide(a, h, tables[0], lock)
        since += n * h
        for m in range(LANES):
            if a[ALONE * LANES + m] != 0.0:
                model = model_of(a, m, active)
                x = row_alone(before_of(a, m), volts_of(a, m), t, h, n, model, parts[m], tables[m], lock)
                put_state(a, m, x)
        i = target[r]
        if i < 0:
            continue
        for j in range(3):
            for m in range(LANES):
                out[m, i, j] = measured[i][j] - a[j * LANES + m]
        over, since = since, 0.0
        if not corrected[i]:
            continue
        end = t + n * h
        for m in range(LANES):
            x, e = state_of(a, m), (out[m, i, 0], out[m, i, 1], out[m, i, 2])
            if a[ALONE * LANES + m] != 0.0:
                model, v = model_of(a, m, active), volts_of(a, m)
                put_state(a, m, moved_alone(x, e, v, over, end, gain, model, tables[m], lock))
            else:
                put_state(a, m, moved(x, e, gain))
