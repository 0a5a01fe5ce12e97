# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`following` of several models side by side in the lanes of `lanes`: arms without constraints, with dry friction that
has one level for each direction and with limits of the current, or with neither.

In most rows joints slide in one direction and no current comes near its limit: friction is then a torque that stays
the same, and a lane needs no branch. A row in which that does not hold of a lane (a joint with dry friction rests or
reverses, a current may meet its limit) is taken again by `following`, of that lane alone.
"""

from collections.abc import Callable
from typing import Any

from puma_sim_core.dynamics.contact import passing
from puma_sim_core.dynamics.following import moved_by, predicted
from puma_sim_core.dynamics.lanes import LANE_NUMBERS, LANES, in_lane, lane_of, lane_step, one_of_two, put_state
from puma_sim_core.dynamics.laws import AT_REST, CURRENT_LIMIT, DRY, UNBENT, constant_level, current_bound
from puma_sim_core.dynamics.runs import advance, terminals
from puma_sim_core.dynamics.types import FREE, STILL, Drive, Model, Rows, State
from puma_sim_core.jit import Table, Vec, compiled, fitting, inlined, outlined, written

#: stages that a model in a lane may have
IN_LANES = DRY | CURRENT_LIMIT
#: numbers of one lane: those of `lanes`, those of `limits`, the state at the start of a row, and 1.0 where the row is
#: to be taken again
LIMITS, BEFORE, ALONE = LANE_NUMBERS, LANE_NUMBERS + 9, LANE_NUMBERS + 18
FOLLOWED = ALONE + 1
#: share of its limit from which a current may meet it within a step
CLEAR = 0.9
#: no drive is cut off
_ON = (1.0, 1.0, 1.0)


def build_sliding(step: Callable[..., Any], one_of_two: Callable[..., Any]) -> Callable[..., Any]:
    """A step whose joints slide as at its start: (x, v, h, body, drive, limits, p) -> state, and whether it does not
    hold, on top of a step like `lanes.lane_step`. limits : of `limits`."""

    @inlined
    def ends(w: Table, after: Table, positive: Table, negative: Table) -> Table:
        """Whether a joint with dry friction rests or reverses."""
        return (positive + negative > 0.0) & (w * after <= 0.0)

    @inlined
    def sliding_step(x: Vec, v: Vec, h: float, body: Vec, drive: Vec, limits: Vec, p: Table) -> tuple[Vec, Table]:
        _, _, _, w1, w2, w3, i1, i2, i3 = x
        f1, f2, f3, n1, n2, n3, c1, c2, c3 = limits
        y1, r1, k1, _, _, y2, r2, k2, _, _, y3, r3, k3, _, _ = drive
        friction = one_of_two(w1 > 0.0, f1, -n1), one_of_two(w2 > 0.0, f2, -n2), one_of_two(w3 > 0.0, f3, -n3)
        y, _ = step(x, UNBENT, v, h, Model(body, drive, DRY), p, FREE, (0.0, 0.0, 0.0, *friction))
        alone = ends(w1, y[3], f1, n1) | ends(w2, y[4], f2, n2) | ends(w3, y[5], f3, n3)
        # no stage of a stable step takes a current further than its rate at the start, but for what that changes by
        alone = alone | (abs(i1) + h * abs((v[0] - r1 * i1 - k1 * w1) * y1) >= c1) | (abs(y[6]) >= c1)
        alone = alone | (abs(i2) + h * abs((v[1] - r2 * i2 - k2 * w2) * y2) >= c2) | (abs(y[7]) >= c2)
        alone = alone | (abs(i3) + h * abs((v[2] - r3 * i3 - k3 * w3) * y3) >= c3) | (abs(y[8]) >= c3)
        return y, alone

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
#: (a, m) -> the numbers of `limits` of lane m; (a, m, active) -> its model; (a, m) -> its state at the start of a row
limits_of = written("limits_of", "a, m", [f"return ({', '.join(in_lane(LIMITS, 9))})"], {})
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
def row_alone(x: Vec, v: Vec, t: float, h: float, n: int, model: Model, parts: int, p: Table) -> Vec:
    """The state of an arm after n steps of h seconds."""
    return predicted(advance, State(x, AT_REST, STILL), v, t, h, n, model, parts, p, FREE).x


@outlined
def moved_alone(x: Vec, e: Vec, v: Vec, over: float, t: float, gain: Table, model: Model, p: Table) -> Vec:
    """The state of an arm that innovations e [rad] have moved."""
    return moved_by(passing, State(x, AT_REST, STILL), e, v, _ON, over, t, gain, model, p, FREE).x


@inlined
def slide(a: Table, h: float, p: Table) -> None:
    """One step of all lanes that slide."""
    for m in range(LANES):
        x, v, body, drive = lane_of(a, m)
        y, alone = sliding_step(x, v, h, body, drive, limits_of(a, m), p)
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
    out: Table,
) -> None:
    """Innovations of one group of LANES models that follow a measured motion.

    a : flat, FOLLOWED * LANES, number k of lane m at k * LANES + m, moved on; active : stages of all of them, of
    `IN_LANES`; rows : commanded voltages and steps; measured (n, 3) [rad], at the ends of the rows; corrected (n,),
    gain (9,) and parts (LANES,) as for `following.Track`; tables (LANES, ...) : packed effects of each lane; alike :
    whether those on the voltages are the same; out (LANES, n, 3): the innovations [rad].
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
            slide(a, h, tables[0])
        since += n * h
        for m in range(LANES):
            if a[ALONE * LANES + m] != 0.0:
                _, v, _, _ = lane_of(a, m)
                model = model_of(a, m, active)
                put_state(a, m, row_alone(before_of(a, m), v, t, h, n, model, parts[m], tables[m]))
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
                put_state(a, m, moved_alone(x, e, v, since, t + n * h, gain, model, tables[m]))
            else:
                put_state(a, m, moved(x, e, gain))
        since = 0.0
