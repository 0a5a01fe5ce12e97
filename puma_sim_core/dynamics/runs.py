# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Whole runs of the kernel in one call: voltages held row by row, or the digital servo.

The functions here take plain numbers, tuples and flat arrays, so that they compile; `Simulator`
and `Session` are their callers. A row of `out` holds the state x and the bristles, twelve numbers;
with `WIDE` stages behind them the measured positions m and the motion of the links, nine more.
A run stops at the first state that is not finite and returns its row, or -1.

Arguments that all functions share, beside those of `kernel`
    x       the state of the arm, nine numbers
    z       deflections of the bristles [rad], then positions [rad] and velocities [rad/s] of the
            links, which matter where a drive is soft: nine numbers
    m       measured positions [rad] of the three joints, true ones where nothing is SENSED
"""

from __future__ import annotations

from puma_sim_core.dynamics.circuit import settled_state
from puma_sim_core.dynamics.contact import cold_step, contact, contact_step
from puma_sim_core.dynamics.laws import (
    ALGEBRAIC,
    BRISTLE,
    CURRENT_LIMIT,
    DELAYED,
    DRY,
    LOCKED,
    MEMORY,
    SENSED,
    SMOOTH,
    TIMED,
    TWO_MASS,
    VARYING,
    WIDTH,
    Z_WIDTH,
    after_losses,
    deflections_of,
    row_readers,
    with_deflections,
    within_supply,
)
from puma_sim_core.dynamics.rigid import FREE, NO_SLIP, STILL, derivative, library_trigonometry, rk4_step
from puma_sim_core.dynamics.sensed import measured_after
from puma_sim_core.dynamics.servo import MEMORY_WIDTH, SERVO_WIDTH, delayed, servo_at_rest, servo_sample
from puma_sim_core.dynamics.timed import drive_at, push_over
from puma_sim_core.dynamics.torques import bristle_torques
from puma_sim_core.jit import compiled, inlined, merged, outlined

#: stages whose runs have rows of WIDE_ROW numbers instead of ROW
WIDE = SENSED | TWO_MASS | MEMORY
ROW, WIDE_ROW = 12, 12 + Z_WIDTH
deflections_in_row, z_in_row = row_readers(ROW)
#: stages of plants without dry friction that have a step of their own
_COMMON = SMOOTH | VARYING | BRISTLE | CURRENT_LIMIT | LOCKED
#: numbers of `late` in `run_servo` before the voltages that it holds back
LATE_WIDTH = 5


@inlined
def terminal_voltage(j, v, p):
    """Voltage [V] at motor j's terminals for the commanded one, a droop of the supply apart."""
    return within_supply(p, j * WIDTH, after_losses(p, j * WIDTH, v))


@compiled
def supply_voltages(v1, v2, v3, p):
    """Voltages [V] that the supply can give of the commanded ones: what a drive reports."""
    return within_supply(p, 0, v1), within_supply(p, WIDTH, v2), within_supply(p, 2 * WIDTH, v3)


@compiled
def terminal_voltages(v1, v2, v3, p):
    """Voltages [V] at the three motors' terminals for the commanded ones."""
    return terminal_voltage(0, v1, p), terminal_voltage(1, v2, p), terminal_voltage(2, v3, p)


@merged
def advance(x, z, m, v, t, h, n, body, drive, active, p, lock):
    """x, z and m after n steps of h seconds from time t [s] on with the voltages v held."""
    if active != 0:
        return advance_stages(x, z, m, v, t, h, n, body, drive, active, p, lock)
    b = deflections_of(z)
    for _ in range(n):
        # the literal 0 lets the compiler drop every stage that is not needed
        x, b = rk4_step(x, b, v, h, body, drive, 0, p, FREE, NO_SLIP)
    return x, z, m


@merged
def advance_stages(x, z, m, v, t, h, n, body, drive, active, p, lock):
    """`advance` for a plant with active stages."""
    b = deflections_of(z)
    for k in range(n):
        now, push = drive, STILL
        if active & TIMED:
            now = drive_at(t + (k + 0.5) * h, drive, p)
            push = push_over(t + k * h, h, p)
        if active & DRY:
            y, b = contact_step(x, b, v, h, body, now, active, p, lock, push)
        elif active & ~_COMMON == 0:
            # the mask lets the compiler drop the other stages
            y, b = rk4_step(x, b, v, h, body, now, active & _COMMON, p, lock, NO_SLIP)
        else:
            y, b = cold_step(x, b, v, h, body, now, active, p, lock, (0.0, 0.0, 0.0, -push[0], -push[1], -push[2]))
        if active & SENSED:
            m = measured_after(m, x, y, h, p)
        x = y
    return x, with_deflections(z, b), m


@inlined
def is_finite(x):
    """Whether all nine numbers of the state are finite."""
    q1, q2, q3, w1, w2, w3, i1, i2, i3 = x
    total = q1 + q2 + q3 + w1 + w2 + w3 + i1 + i2 + i3
    return total - total == 0.0


@inlined
def store(out, r, x, z):
    """Write state and bristles to row r."""
    for j in range(9):
        out[r, j] = x[j]
    for j in range(3):
        out[r, 9 + j] = z[j]


@inlined
def store_wide(out, r, z, m):
    """Write measured positions, links and further deflections to row r, behind what `store` writes."""
    for j in range(3):
        out[r, ROW + j] = m[j]
    for j in range(Z_WIDTH - 3):
        out[r, ROW + 3 + j] = z[3 + j]


@outlined
def run_plain(x, z, volts, counts, steps, body, drive, p, out):
    """`run_voltages` for a plant that needs no stage, in a loop that has nothing else in it."""
    store(out, 0, x, z)
    for r in range(len(counts)):
        v = (
            terminal_voltage(0, volts[r][0], p),
            terminal_voltage(1, volts[r][1], p),
            terminal_voltage(2, volts[r][2], p),
        )
        b = deflections_of(z)
        for _ in range(counts[r]):
            x, b = rk4_step(x, b, v, steps[r], body, drive, 0, p, FREE, NO_SLIP)
        if not is_finite(x):
            return r + 1
        store(out, r + 1, x, z)
    return -1


@compiled
def run_voltages(x, z, m, volts, times, counts, steps, body, drive, active, p, lock, out):
    """Run with voltages held row by row.

    volts (n, 3) [V] as they reach the amplifiers, a delay of the input taken out; row r is held from
    times[r] [s] for counts[r] steps of steps[r] seconds; out (n + 1, ROW or WIDE_ROW), whose row r
    is the state at the start of row r. Returns the first row that is not finite, or -1.
    """
    if active == 0:
        return run_plain(x, z, volts, counts, steps, body, drive, p, out)
    return held_rows(advance, x, z, m, volts, times, counts, steps, body, drive, active, p, lock, out)


@merged
def held_rows(advance, x, z, m, volts, times, counts, steps, body, drive, active, p, lock, out):
    """`run_voltages` with a function like `advance`."""
    store(out, 0, x, z)
    if active & WIDE:
        store_wide(out, 0, z, m)
    for r in range(len(counts)):
        v = (
            terminal_voltage(0, volts[r][0], p),
            terminal_voltage(1, volts[r][1], p),
            terminal_voltage(2, volts[r][2], p),
        )
        x, z, m = advance(x, z, m, v, times[r], steps[r], counts[r], body, drive, active, p, lock)
        if not is_finite(x):
            return r + 1
        store(out, r + 1, x, z)
        if active & WIDE:
            store_wide(out, r + 1, z, m)
    return -1


@inlined
def arriving(j, u, late):
    """(voltage that reaches amplifier j at the start of a sample, that after the held-back part);
    u [V]: asked for in this sample, which takes the place of the oldest in `late`."""
    size = int(late[4])
    k = LATE_WIDTH + j * size
    oldest = late[k]
    for i in range(k, k + size - 1):
        late[i] = late[i + 1]
    late[k + size - 1] = u
    return oldest, late[k]


@compiled
def run_servo(
    x, z, m, start, setpoints, samples, steps, h, servo, memory, late, body, drive, active, p, lock, out, volts
):
    """Run under the digital servo from time `start` [s] on.

    setpoints (n, 3) [rad], each held for `samples` samples of `steps` steps of h seconds; servo:
    the table of `ServoConfig`; memory: flat, `servo_memory` and `ServoConfig.held_back`, taken up
    and left as the servo's memory; late: the table of `delay.SampledDelay`, taken up and left.
    out (n * samples + 1, ROW or WIDE_ROW) and volts (n * samples, 3), as the servo asks for them,
    a row a sample. Returns the first row of `out` that is not finite, or -1.
    """
    return servo_rows(
        advance,
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


@merged
def servo_rows(
    advance, x, z, m, start, setpoints, samples, steps, h, servo, memory, late, body, drive, active, p, lock, out, volts
):
    """`run_servo` with a function like `advance`."""
    store(out, 0, x, z)
    if active & WIDE:
        store_wide(out, 0, z, m)
    row = 0
    pieces = 2 if active & DELAYED else 1
    for r in range(len(setpoints)):
        for _ in range(samples):
            for j in range(3):
                k = j * MEMORY_WIDTH
                u, memory[k], memory[k + 1] = servo_sample(
                    setpoints[r][j], m[j] if active & SENSED else x[j], memory[k], memory[k + 1], servo, j * SERVO_WIDTH
                )
                volts[row, j] = delayed(j, u, memory, servo)
            u1, u2, u3 = volts[row, 0], volts[row, 1], volts[row, 2]
            o1, o2, o3 = u1, u2, u3
            t, n, step = start + row * (steps * h), steps, h
            if active & DELAYED:
                o1, u1 = arriving(0, u1, late)
                o2, u2 = arriving(1, u2, late)
                o3, u3 = arriving(2, u3, late)
                n, step = int(late[0]), late[1]
            for _ in range(pieces):
                v = (terminal_voltage(0, o1, p), terminal_voltage(1, o2, p), terminal_voltage(2, o3, p))
                x, z, m = advance(x, z, m, v, t, step, n, body, drive, active, p, lock)
                if active & DELAYED:
                    o1, o2, o3 = u1, u2, u3
                    t += n * step
                    n, step = int(late[2]), late[3]
            row += 1
            if not is_finite(x):
                return row
            store(out, row, x, z)
            if active & WIDE:
                store_wide(out, row, z, m)
    return -1


@compiled
def servo_memory(setpoint, position, servo):
    """The memory of a servo at rest for `run_servo`, 3 * MEMORY_WIDTH numbers, without those that
    a delay holds back.

    setpoint, position : triples [rad]; servo : the table of `ServoConfig`.
    """
    total1, before1 = servo_at_rest(setpoint[0], position[0], servo, 0)
    total2, before2 = servo_at_rest(setpoint[1], position[1], servo, SERVO_WIDTH)
    total3, before3 = servo_at_rest(setpoint[2], position[2], servo, 2 * SERVO_WIDTH)
    return total1, before1, total2, before2, total3, before3


@compiled
def accelerations(out, volts, times, body, drive, active, p, lock, result):
    """Joint accelerations [rad/s^2] at the rows of `out`, written to result (n, 3).

    volts (n, 3): the voltage that reaches the amplifiers from each row on; times (n,) [s].
    """
    for r in range(len(result)):
        x = (out[r, 0], out[r, 1], out[r, 2], out[r, 3], out[r, 4], out[r, 5], out[r, 6], out[r, 7], out[r, 8])
        v = (
            terminal_voltage(0, volts[r][0], p),
            terminal_voltage(1, volts[r][1], p),
            terminal_voltage(2, volts[r][2], p),
        )
        now, push = drive, STILL
        if active & TIMED:
            now, push = drive_at(times[r], drive, p), push_over(times[r], 0.0, p)
        if active & ALGEBRAIC:
            x = settled_state(x, v, now, active, p)
        slip = (0.0, 0.0, 0.0, -push[0], -push[1], -push[2])
        held, bend, stages = lock, STILL, active
        if active & DRY:
            held, slip = contact(x, body, now, active, p, lock, push)
            if held[0] + held[1] + held[2] > 0.0:
                stages = active | LOCKED
        if active & BRISTLE:
            _, bend = bristle_torques(deflections_in_row(out, r, active), 0.0, 0.0, 0.0, STILL, p)
        a = derivative(
            x[0],
            x[1],
            x[2],
            x[3],
            x[4],
            x[5],
            x[6],
            x[7],
            x[8],
            v[0],
            v[1],
            v[2],
            library_trigonometry(x[1], x[2]),
            body,
            now,
            stages,
            p,
            held,
            slip,
            bend,
        )
        for j in range(3):
            result[r, j] = a[j]
