# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The runs of `runs` for arms whose links do not follow their motors, and the choice between both.

They are compiled by themselves, so that nobody waits for the one who does not use the other.
"""

from __future__ import annotations

from puma_sim_core.dynamics import runs
from puma_sim_core.dynamics.laws import SENSED, TIMED, TWO_MASS
from puma_sim_core.dynamics.rigid import STILL
from puma_sim_core.dynamics.runs import held_rows, servo_rows, terminal_voltage, z_in_row
from puma_sim_core.dynamics.sensed import measured_after
from puma_sim_core.dynamics.timed import drive_at, push_over
from puma_sim_core.dynamics.two_mass import settled_links, train_rates, train_step, trains
from puma_sim_core.jit import compiled, inlined, interpreted


@inlined
def train_advance(x, z, m, v, t, h, n, body, drive, active, p, lock):
    """`runs.advance` with drive trains."""
    for k in range(n):
        now, push = drive, STILL
        if active & TIMED:
            now = drive_at(t + (k + 0.5) * h, drive, p)
            push = push_over(t + k * h, h, p)
        y, z = train_step(x, z, v, h, body, now, active, p, lock, push)
        if active & SENSED:
            m = measured_after(m, x, y, h, p)
        x = y
    return x, z, m


@compiled
def _train_voltages(x, z, m, volts, times, counts, steps, body, drive, active, p, lock, out):
    return held_rows(train_advance, x, z, m, volts, times, counts, steps, body, drive, active, p, lock, out)


@compiled
def _train_servo(
    x, z, m, start, setpoints, samples, steps, h, servo, memory, late, body, drive, active, p, lock, out, volts
):
    return servo_rows(
        train_advance,
        x,
        z,
        m,
        start,
        setpoints,
        samples,
        steps,
        h,
        servo,
        memory,
        late,
        body,
        drive,
        active,
        p,
        lock,
        out,
        volts,
    )


@compiled
def _train_accelerations(out, volts, times, body, drive, active, p, lock, result):
    for r in range(len(result)):
        x = (out[r, 0], out[r, 1], out[r, 2], out[r, 3], out[r, 4], out[r, 5], out[r, 6], out[r, 7], out[r, 8])
        z = z_in_row(out, r)
        v = (
            terminal_voltage(0, volts[r][0], p),
            terminal_voltage(1, volts[r][1], p),
            terminal_voltage(2, volts[r][2], p),
        )
        now, push = drive, STILL
        if active & TIMED:
            now, push = drive_at(times[r], drive, p), push_over(times[r], 0.0, p)
        a = train_rates(x, z, v, body, now, active, p, lock, push)
        for j in range(3):
            result[r, j] = a[3 + j]


@compiled
def _settled(x, time, body, drive, active, stiff, p, lock):
    now, push = drive, STILL
    if active & TIMED:
        now, push = drive_at(time, drive, p), push_over(time, 0.0, p)
    return settled_links(x, body, now, active, stiff, p, lock, push)


def links_at(state, time, body, drive, active, table, lock) -> tuple[float, ...]:
    """Positions [rad] and velocities [rad/s] of links that follow their motors without swinging.

    state : of the motors, nine numbers; time [s]. A soft joint is twisted by the torque that its
    link takes when it moves with the motor, and play lies on the side of that torque.
    """
    if not active & TWO_MASS:
        return tuple(state[:6])
    stiff = table.copy()
    for train in interpreted(trains)(stiff):
        stiff[train] = 0.0
    return tuple(_settled(tuple(state), float(time), body, drive, active, stiff, table, lock))


def run_voltages(x, z, m, volts, times, counts, steps, body, drive, active, p, lock, out) -> int:
    """`runs.run_voltages` of any arm."""
    run = _train_voltages if active & TWO_MASS else runs.run_voltages
    return run(x, z, m, volts, times, counts, steps, body, drive, active, p, lock, out)


def run_servo(
    x, z, m, start, setpoints, samples, steps, h, servo, memory, late, body, drive, active, p, lock, out, volts
) -> int:
    """`runs.run_servo` of any arm."""
    run = _train_servo if active & TWO_MASS else runs.run_servo
    return run(
        x, z, m, start, setpoints, samples, steps, h, servo, memory, late, body, drive, active, p, lock, out, volts
    )


def accelerations(out, volts, times, body, drive, active, p, lock, result) -> None:
    """`runs.accelerations` of any arm: those of the motors over their gear ratios."""
    run = _train_accelerations if active & TWO_MASS else runs.accelerations
    run(out, volts, times, body, drive, active, p, lock, result)
