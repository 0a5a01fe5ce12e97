# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The voltage that the effects of a model take along a measured motion.

Inverse dynamics give the voltage of a motion by the model without effects. What known effects add to it comes from the
laws that the kernel simulates, so that a model with effects can be the start of an explanation.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from puma_sim_core.dynamics.circuit import drive_at
from puma_sim_core.dynamics.laws import BRISTLE, DROOP, DRY, SENSED, SMOOTH, TILT, TIMED, VARYING, combined
from puma_sim_core.dynamics.rigid import library_trigonometry
from puma_sim_core.dynamics.runs import terminal_voltage
from puma_sim_core.dynamics.torques import (
    bristle_level,
    bristle_step,
    gravity_torques,
    has_bristle,
    inverse_torque,
    push_over,
    sliding_level,
    smooth_torques,
    tilted_torques,
)
from puma_sim_core.dynamics.types import Constants
from puma_sim_core.effects.base import SENSING, Effect, Memory, Point
from puma_sim_core.effects.screening import Signals
from puma_sim_core.effects.shared.columns import stretches, torque_volts
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.settings import SCREENING
from puma_sim_core.jit import BACKEND, compiled, interpreted
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.delay import delay_of
from puma_sim_core.simulation.run_inputs import native

_share, _bound = (combined(point, interpreted) for point in (Point.SUPPLY_SHARE, Point.CURRENT_BOUND))


#: an array for the compiled kernel, lists of floats for the interpreted one
Numbers = Floats | Sequence[float]
Table = Floats | Sequence[Sequence[float]]


class _Motion(NamedTuple):
    """Rows of a motion: time (n,), its step, position and velocity (n, 3), torque that the motion takes without
    effects and viscous friction (n, 3) [N.m], direction of sliding, smooth about reversals (n, 3), and 1.0 where a
    log begins, with bristles at rest (n,)."""

    time: Numbers
    step: float
    position: Table
    velocity: Table
    motor: Table
    sign: Table
    begins: Numbers


@compiled
def _taken(motion: _Motion, constants: Constants, out: Floats) -> None:
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
def _sliding(j: int, q: float, w: float, sign: float, gravity: float, torque: float, p: Numbers) -> float:
    """Dry friction [N.m] of joint j, 0.0 where it acts through a bristle; torque : the motor's without it."""
    if has_bristle(j, p):
        return 0.0
    torque = inverse_torque(j, sign, q, gravity, torque, abs(w), p)
    return sign * sliding_level(j, 1.0 if w > 0.0 else -1.0, q, gravity, torque, abs(w), p)


@compiled
def _bent(
    j: int, z: float, travel: float, q: float, w: float, gravity: float, torque: float, p: Numbers
) -> tuple[float, float]:
    """Deflection [rad] and torque [N.m] of joint j's bristle after `travel` [rad]; torque : the motor's without it."""
    end, own = bristle_step(j, z, 0.0, 0.0, p)
    # its own torque is part of the load that bounds it
    for _ in range(2):
        level = bristle_level(j, q, gravity, torque + own, w, p)
        end, own = bristle_step(j, z, travel, level, p)
    return end, own


@compiled
def _terminal(volts: Table, p: Numbers, out: Floats) -> None:
    for r in range(len(volts)):
        for j in range(3):
            out[r, j] = terminal_voltage(j, volts[r][j], p)


def known_voltage(mechanism: Mechanism, theta: Floats, signals: Signals) -> Floats:
    """(n, J) part of V - Vhat [V] that the mechanism's own effects make, 0 without any.

    Vhat is the model without effects, `Mechanism.model_voltage` with its lag; signals are those of that model. V - Vhat
    less this is what the start model does not explain. Elasticity and backlash are taken joint by joint; where a
    current is at its limit all of V - Vhat counts as explained.
    """
    joints = mechanism.joints
    total = np.zeros((len(signals.time), joints))
    if not mechanism.effects:
        return total
    plant = mechanism.plant(theta)
    active = plant.constants.active
    constants = plant.constants._replace(table=native(plant.constants.table))
    p = constants.table
    if active & SENSED:
        _add(total, [e for e in plant.effects if e.kind.acts == SENSING], signals, signals.torque)
    taken = _torques(signals, constants, plant)
    total += np.stack([torque_volts(signals, j, taken[:, j]) for j in range(joints)], axis=1)
    torque, drive = signals.torque + taken, mechanism.drive(theta)
    current = torque * drive.volts_per_torque / drive.resistance
    _add(total, [e for e in plant.effects if e.kind.acts != SENSING], signals, torque)
    total += _lost_before_the_motor(signals, current, active, p, plant)
    limit = np.array([_bound(j, p) for j in plant.axes])
    motors = [torque_volts(signals, j, signals.torque[:, j]) for j in range(joints)]
    lacking = signals.voltage - (np.stack(motors, axis=1) + signals.emf * signals.velocity)
    limited = (np.abs(current) >= SCREENING.known_held * limit) & ((lacking - total) * current > 0.0)
    return np.where(limited, lacking, total) * signals.enable


def _torques(signals: Signals, constants: Constants, plant: Plant) -> Floats:
    """(n, J) torques that the effects take [N.m]."""
    speed = signals.velocity
    width = np.maximum(2.0 * signals.velocity_noise, 1e-9)
    motor = signals.torque - signals.viscous * speed
    begins = np.diff(signals.segment, prepend=signals.segment[0] - 1) != 0
    joints = (signals.position, speed, motor, speed / np.hypot(speed, width))
    position, *others = (plant.spread(values) for values in joints)
    still = [axis for axis in range(3) if axis not in plant.axes]
    position[:, still] = np.array(plant.rest)[still]
    arrays = [signals.time, position, *others, begins.astype(float)]
    time, *columns = (a if BACKEND == "numba" else a.tolist() for a in arrays)
    out = np.zeros((len(signals.time), 3))
    _taken(_Motion(time, signals.step, *columns), constants, out)
    return out[:, plant.axes]


def _lost_before_the_motor(signals: Signals, current: Floats, active: int, p: Sequence[float], plant: Plant) -> Floats:
    """(n, J) commanded less terminal voltage [V]."""
    late = delay_of(active, p)
    arriving = signals.voltage
    if late > 0.0:
        arriving = np.empty_like(signals.voltage)
        for rows in stretches(signals):
            for j in range(signals.joints):
                arriving[rows, j] = np.interp(signals.time[rows] - late, signals.time[rows], signals.voltage[rows, j])
    padded = plant.spread(arriving)
    out = np.zeros_like(padded)
    _terminal(padded if BACKEND == "numba" else padded.tolist(), p, out)
    terminal = out[:, plant.axes]
    if active & DROOP:
        drawn = plant.spread(current).tolist()
        terminal = terminal * np.array([[_share(0, *row, p)] for row in drawn])
    return signals.voltage - terminal


def _add(total: Floats, effects: Iterable[Effect], signals: Signals, torque: Floats) -> None:
    """Add to (n, J) the voltage [V] of effects that declare it themselves, or have a deflection of their own."""
    for effect in effects:
        j = (effect.joint or 1) - 1
        if effect.kind.known_voltage is not None:
            for i, volts in effect.kind.known_voltage(signals, j, effect.values, torque).items():
                total[:, i] += volts
        elif effect.kind.memory is not None:
            total[:, j] += torque_volts(signals, j, _remembered(effect.kind.memory, effect, signals, j))


def _remembered(memory: Memory, effect: Effect, signals: Signals, j: int) -> Floats:
    """(n,) torque [N.m] of an effect with a deflection of its own, at rest at the start of each log."""
    follow, law = (interpreted(function) for function in memory)
    p, out = list(effect.values.values()), np.zeros(len(signals.time))
    for part in stretches(signals):
        deflection = 0.0
        q = signals.position[part, j].tolist()
        for n, (before, now) in enumerate(zip(q[:1] + q[:-1], q, strict=True)):
            deflection = follow(p, 0, deflection, now - before)
            out[part.start + n] = law(p, 0, deflection)
    return out
