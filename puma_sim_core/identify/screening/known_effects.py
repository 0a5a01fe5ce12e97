# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What effects that a model already holds make of the voltage along a measured motion.

Inverse dynamics give the voltage of a motion by the model without effects; the difference that
known effects make to it is taken from the same laws that the kernel simulates, along the measured
motion, so that a model with effects can be the start of an explanation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from puma_sim_core.dynamics.laws import BRISTLE, DROOP, DRY, SENSED, SMOOTH, TILT, TIMED, VARYING, combined
from puma_sim_core.dynamics.rigid import library_trigonometry
from puma_sim_core.dynamics.runs import terminal_voltage
from puma_sim_core.dynamics.timed import drive_at, push_over
from puma_sim_core.dynamics.torques import (
    bristle_level,
    bristle_step,
    gravity_torques,
    has_bristle,
    inverse_torque,
    sliding_level,
    smooth_torques,
    tilted_torques,
)
from puma_sim_core.dynamics.types import Constants
from puma_sim_core.effects.base import SENSING, Effect, Point
from puma_sim_core.effects.screening import Signals
from puma_sim_core.effects.shared.columns import stretches, torque_volts
from puma_sim_core.identify.settings import SCREENING
from puma_sim_core.jit import BACKEND, compiled, interpreted
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.delay import delay_of
from puma_sim_core.simulation.run_inputs import native

_share, _bound = (combined(point, interpreted) for point in (Point.SUPPLY_SHARE, Point.CURRENT_BOUND))


class _Motion(NamedTuple):
    """Rows of a motion: time (n,), its step, position and velocity (n, 3), torque that the motion takes without
    effects and viscous friction (n, 3) [N.m], direction of sliding, smooth about reversals (n, 3), and 1.0 where a
    stretch of record begins, with bristles at rest (n,)."""

    time: Any
    step: float
    position: Any
    velocity: Any
    motor: Any
    sign: Any
    begins: Any


@compiled
def _taken(motion, constants, out):
    """Torques (n, 3) [N.m] that the effects of a plant take at the rows of a motion."""
    model, p = constants
    body, drive, active = model
    z1, z2, z3 = 0.0, 0.0, 0.0
    for r in range(len(motion.time)):
        q, w, sign = motion.position[r], motion.velocity[r], motion.sign[r]
        trig = library_trigonometry(q[1], q[2])
        G2, G3 = gravity_torques(trig, body)
        f1, f2, f3 = 0.0, 0.0, 0.0
        if active & SMOOTH:
            f1, f2, f3 = smooth_torques((q[0], q[1], q[2], w[0], w[1], w[2]), p)
        if active & TILT:
            g1, g2, g3 = tilted_torques(q[0], trig, body, p)
            f1, f2, f3 = f1 + g1, f2 + g2, f3 + g3
        t1, t2, t3 = motion.motor[r][0] + f1, motion.motor[r][1] + f2, motion.motor[r][2] + f3
        if active & TIMED:
            push = push_over(motion.time[r] - 0.5 * motion.step, motion.step, p)
            now = drive_at(motion.time[r], drive, p)
            t1, t2, t3 = t1 - push[0], t2 - push[1], t3 - push[2]
            f1 += (now[4] - drive[4]) * w[0] - push[0]
            f2 += (now[9] - drive[9]) * w[1] - push[1]
            f3 += (now[14] - drive[14]) * w[2] - push[2]
        if active & (DRY | VARYING):
            f1 += _sliding(0, q[0], w[0], sign[0], 0.0, t1, p)
            f2 += _sliding(1, q[1], w[1], sign[1], G2, t2, p)
            f3 += _sliding(2, q[2], w[2], sign[2], G3, t3, p)
        if active & BRISTLE:
            if motion.begins[r] != 0.0:
                z1, z2, z3 = 0.0, 0.0, 0.0
            else:
                before = motion.position[r - 1]
                z1, g1 = _bent(0, z1, q[0] - before[0], q[0], w[0], 0.0, t1, p)
                z2, g2 = _bent(1, z2, q[1] - before[1], q[1], w[1], G2, t2, p)
                z3, g3 = _bent(2, z3, q[2] - before[2], q[2], w[2], G3, t3, p)
                f1, f2, f3 = f1 + g1, f2 + g2, f3 + g3
        out[r, 0] = f1
        out[r, 1] = f2
        out[r, 2] = f3


@compiled
def _sliding(j, q, w, sign, gravity, torque, p):
    """Dry friction [N.m] of joint j, 0.0 where it acts through a bristle; torque : that of the
    motor without it."""
    if has_bristle(j, p):
        return 0.0
    torque = inverse_torque(j, sign, q, gravity, torque, abs(w), p)
    return sign * sliding_level(j, 1.0 if w > 0.0 else -1.0, q, gravity, torque, abs(w), p)


@compiled
def _bent(j, z, travel, q, w, gravity, torque, p):
    """Deflection [rad] and torque [N.m] of joint j's bristle after `travel` [rad]; torque : that
    of the motor without it."""
    end, own = bristle_step(j, z, 0.0, 0.0, p)
    # its own torque is part of the load that bounds it
    for _ in range(2):
        level = bristle_level(j, q, gravity, torque + own, w, p)
        end, own = bristle_step(j, z, travel, level, p)
    return end, own


@compiled
def _terminal(volts, p, out):
    for r in range(len(volts)):
        for j in range(3):
            out[r, j] = terminal_voltage(j, volts[r][j], p)


def known_voltage(mechanism: Mechanism, theta, signals: Signals) -> np.ndarray:
    """(n, J) part of V - Vhat [V] that the mechanism's own effects make.

    Vhat is the model without effects, `Mechanism.model_voltage` with its lag, and signals are those
    of that model (`Signals`). What remains, V - Vhat - this, is what the start model does not
    explain. Zero where there are no effects. Elasticity and play are taken joint by joint; where
    a current is held by its limit the remainder is 0.
    """
    joints = mechanism.joints
    total = np.zeros((len(signals.time), joints))
    if not mechanism.effects:
        return total
    plant = mechanism.plant(theta)
    hidden = 3 - joints
    active = plant.constants.active
    constants = plant.constants._replace(table=native(plant.constants.table))
    p = constants.table
    if active & SENSED:
        _add(total, [e for e in plant.effects if e.kind.acts == SENSING], signals, signals.torque)
    taken = _torques(plant, signals, constants)[:, hidden:]
    total += np.stack([torque_volts(signals, j, taken[:, j]) for j in range(joints)], axis=1)
    torque, drive = signals.torque + taken, mechanism.drive(theta)
    current = torque * drive.volts_per_torque / drive.resistance
    _add(total, [e for e in plant.effects if e.kind.acts != SENSING], signals, torque)
    total += _lost_before_the_motor(signals, current, active, p, hidden)
    limit = np.array([_bound(j, p) for j in range(hidden, 3)])
    model = _model(signals)
    remainder = signals.voltage - model - total
    held = (np.abs(current) >= SCREENING.known_held * limit) & (remainder * current > 0.0)
    return np.where(held, signals.voltage - model, total) * signals.enable


def _model(signals: Signals) -> np.ndarray:
    """(n, J) voltage of the model without effects."""
    motors = [torque_volts(signals, j, signals.torque[:, j]) for j in range(signals.joints)]
    return np.stack(motors, axis=1) + signals.emf * signals.velocity


def _torques(plant: Plant, signals: Signals, constants: Constants) -> np.ndarray:
    """(n, 3) torques that the effects take [N.m]."""
    hidden = ((0, 0), (3 - plant.joints, 0))
    speed = signals.velocity
    width = np.maximum(2.0 * signals.velocity_noise, 1e-9)
    motor = signals.torque - signals.viscous * speed
    begins = np.diff(signals.segment, prepend=signals.segment[0] - 1) != 0
    arrays = [
        signals.time,
        *(np.pad(values, hidden) for values in (signals.position, speed, motor, speed / np.hypot(speed, width))),
        begins.astype(float),
    ]
    if BACKEND != "numba":
        arrays = [values.tolist() for values in arrays]
    out = np.zeros((len(signals.time), 3))
    _taken(_Motion(arrays[0], signals.step, *arrays[1:]), constants, out)
    return out


def _lost_before_the_motor(signals: Signals, current, active: int, p, hidden: int) -> np.ndarray:
    """(n, J) commanded less terminal voltage [V]."""
    late = delay_of(active, p)
    arriving = signals.voltage
    if late > 0.0:
        arriving = np.empty_like(signals.voltage)
        cuts = np.flatnonzero(np.diff(signals.segment)) + 1
        for rows in np.split(np.arange(len(signals.time)), cuts):
            for j in range(signals.joints):
                arriving[rows, j] = np.interp(signals.time[rows] - late, signals.time[rows], signals.voltage[rows, j])
    padded = np.pad(arriving, ((0, 0), (hidden, 0)))
    out = np.zeros_like(padded)
    _terminal(padded if BACKEND == "numba" else padded.tolist(), p, out)
    terminal = out[:, hidden:]
    if active & DROOP:
        drawn = np.pad(current, ((0, 0), (hidden, 0))).tolist()
        terminal = terminal * np.array([[_share(0, *row, p)] for row in drawn])
    return signals.voltage - terminal


def _add(total: np.ndarray, effects: list[Effect], signals: Signals, torque: np.ndarray) -> None:
    """Add to (n, J) what effects say of their voltage along the motion [V], where the laws do not."""
    for effect in effects:
        j = (effect.joint or 1) - 1
        if effect.kind.known_voltage is not None:
            for i, volts in effect.kind.known_voltage(signals, j, effect.values, torque).items():
                total[:, i] += volts
        elif effect.kind.memory is not None:
            total[:, j] += torque_volts(signals, j, _remembered(effect, signals, j))


def _remembered(effect: Effect, signals: Signals, j: int) -> np.ndarray:
    """(n,) torque [N.m] of an effect with a deflection of its own, which each stretch begins without."""
    follow, law = (interpreted(function) for function in effect.kind.memory)
    p, out = list(effect.values.values()), np.zeros(len(signals.time))
    for part in stretches(signals):
        deflection = 0.0
        q = signals.position[part, j].tolist()
        for n, (before, now) in enumerate(zip(q[:1] + q[:-1], q, strict=True)):
            deflection = follow(p, 0, deflection, now - before)
            out[part.start + n] = law(p, 0, deflection)
    return out
