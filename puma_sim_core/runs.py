# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Whole runs of the kernel in one call: voltages held row by row, or the digital servo.

The functions here take plain numbers, tuples and flat arrays, so that they compile; `Simulator`
and `Session` are their callers. A row of `out` holds the state and the bristles, twelve numbers.
A run stops at the first state that is not finite and returns its row, or -1.
"""

from __future__ import annotations

from . import effects as _registry
from .backend import compiled, inlined, outlined
from .contact import contact, contact_step
from .control.servo import MEMORY_WIDTH, SERVO_WIDTH, delayed, servo_at_rest, servo_sample
from .effects.amplifier import SATURATION, saturated
from .kernel import (BRISTLE, DRY, FREE, LOCKED, NO_SLIP, STILL, WIDTH, bristle_torques, derivative,
                     library_trigonometry, rk4_step)

_SATURATION = _registry.slot(SATURATION)


@inlined
def terminal_voltage(j, v, p):
    """Voltage [V] at motor j's terminals for the commanded one."""
    k = j * WIDTH
    v = saturated(p, k + _SATURATION, v)
    return v


@compiled
def terminal_voltages(v1, v2, v3, p):
    """Voltages [V] at the three motors' terminals for the commanded ones."""
    return terminal_voltage(0, v1, p), terminal_voltage(1, v2, p), terminal_voltage(2, v3, p)


@inlined
def advance(x, z, v, h, n, body, drive, active, p, lock):
    """State and bristles after n steps of h seconds with the voltages v held."""
    if active == 0:
        for _ in range(n):
            # the literal 0 lets the compiler drop every stage that is not needed
            x, z = rk4_step(x, z, v, h, body, drive, 0, p, FREE, NO_SLIP)
    elif active & DRY:
        for _ in range(n):
            x, z = contact_step(x, z, v, h, body, drive, active, p, lock)
    else:
        for _ in range(n):
            x, z = rk4_step(x, z, v, h, body, drive, active, p, lock, NO_SLIP)
    return x, z


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


@outlined
def run_plain(x, z, volts, counts, steps, body, drive, p, out):
    """`run_voltages` for a plant that needs no stage, in a loop that has nothing else in it."""
    store(out, 0, x, z)
    for r in range(len(counts)):
        v = (terminal_voltage(0, volts[r][0], p), terminal_voltage(1, volts[r][1], p),
             terminal_voltage(2, volts[r][2], p))
        for _ in range(counts[r]):
            x, z = rk4_step(x, z, v, steps[r], body, drive, 0, p, FREE, NO_SLIP)
        if not is_finite(x):
            return r + 1
        store(out, r + 1, x, z)
    return -1


@compiled
def run_voltages(x, z, volts, counts, steps, body, drive, active, p, lock, out):
    """Run with voltages held row by row.

    volts (n, 3) [V]; row r is held for counts[r] steps of steps[r] seconds; out (n + 1, 12),
    whose row r is the state at the start of row r. Returns the first row that is not finite,
    or -1.
    """
    if active == 0:
        return run_plain(x, z, volts, counts, steps, body, drive, p, out)
    store(out, 0, x, z)
    for r in range(len(counts)):
        v = (terminal_voltage(0, volts[r][0], p), terminal_voltage(1, volts[r][1], p),
             terminal_voltage(2, volts[r][2], p))
        x, z = advance(x, z, v, steps[r], counts[r], body, drive, active, p, lock)
        if not is_finite(x):
            return r + 1
        store(out, r + 1, x, z)
    return -1


@compiled
def run_servo(x, z, setpoints, samples, steps, h, servo, memory, body, drive, active, p, lock,
              out, volts):
    """Run under the digital servo.

    setpoints (n, 3) [rad], each held for `samples` samples of `steps` steps of h seconds; servo:
    the table of `ServoConfig`; memory: flat, `servo_memory` and `ServoConfig.held_back`, taken up
    and left as the servo's memory.
    out (n * samples + 1, 12) and volts (n * samples, 3), a row a sample. Returns the first row
    of `out` that is not finite, or -1.
    """
    store(out, 0, x, z)
    row = 0
    for r in range(len(setpoints)):
        for _ in range(samples):
            for j in range(3):
                m = j * MEMORY_WIDTH
                u, memory[m], memory[m + 1] = servo_sample(
                    setpoints[r][j], x[j], memory[m], memory[m + 1], servo, j * SERVO_WIDTH)
                volts[row, j] = terminal_voltage(j, delayed(j, u, memory, servo), p)
            v = (volts[row, 0], volts[row, 1], volts[row, 2])
            x, z = advance(x, z, v, h, steps, body, drive, active, p, lock)
            row += 1
            if not is_finite(x):
                return row
            store(out, row, x, z)
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
def accelerations(out, volts, body, drive, active, p, lock, result):
    """Joint accelerations [rad/s^2] at the rows of `out`, written to result (n, 3).

    volts (n, 3): the voltage that acts from each row on (it matters to a current limit only).
    """
    for r in range(len(result)):
        x = (out[r, 0], out[r, 1], out[r, 2], out[r, 3], out[r, 4], out[r, 5],
             out[r, 6], out[r, 7], out[r, 8])
        held, slip, bend, stages = lock, NO_SLIP, STILL, active
        if active & DRY:
            held, slip = contact(x, body, drive, active, p, lock)
            if held[0] + held[1] + held[2] > 0.0:
                stages = active | LOCKED
        if active & BRISTLE:
            _, bend = bristle_torques((out[r, 9], out[r, 10], out[r, 11]), 0.0, 0.0, 0.0,
                                      STILL, p)
        a = derivative(x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8],
                       volts[r][0], volts[r][1], volts[r][2], library_trigonometry(x[1], x[2]),
                       body, drive, stages, p, held, slip, bend)
        for j in range(3):
            result[r, j] = a[j]
