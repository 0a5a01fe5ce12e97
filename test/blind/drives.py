# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Motors, amplifiers, sensors and the position controller around MuJoCo's arm.

The loop is compiled by numba and calls `mj_step` of MuJoCo's own library, 2 microseconds a step.
Velocities of MuJoCo's semi-implicit steps belong to half steps, so the current is advanced with
them exactly over each step: a leapfrog, of second order apart from friction.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from math import cos, exp, floor, inf, pi, sin
from pathlib import Path

import mujoco
import numba
import numpy as np

from blind import arm_parameters as arm
from blind.arm_mujoco import Mechanics, model

(LIBRARY,) = Path(mujoco.__file__).parent.glob("libmujoco*.so*")
# compiled code finds the functions of libraries that are open to the whole process
ctypes.CDLL(str(LIBRARY), mode=ctypes.RTLD_GLOBAL)
_mj_step = numba.types.ExternalFunction("mj_step", numba.types.void(numba.types.intp, numba.types.intp))

# columns of the table of effects, one row a joint
(
    COULOMB,
    BIAS,
    STRIBECK,
    STRIBECK_SPEED,
    LOAD,
    POSITION,
    POSITION_ANGLE,
    BRISTLE,
    BRISTLE_LEVEL,
    QUADRATIC,
    RIPPLE,
    RIPPLE_ORDER,
    RIPPLE_PHASE,
    PUSH,
    PUSH_TIME,
    PUSH_WIDTH,
    WARM,
    WARM_TIME,
    HOT,
    HOT_TIME,
    DEAD_BAND,
    OFFSET,
    SATURATION,
    LIMIT,
    SENSOR_LAG,
    ENCODER,
    NONLINEAR,
    NONLINEAR_PERIOD,
    NONLINEAR_PHASE,
    ECCENTRIC,
    ECCENTRIC_ORDER,
    ECCENTRIC_PHASE,
    HALF_GAP,
    CONTACT,
    CONTACT_LOSS,
    OUTSIDE,
    OUT_A,
    OUT_B,
    OUT_C,
    OUT_D,
    COLUMNS,
) = range(41)

# kinds of what is outside the library, in column OUTSIDE
(
    CABLE,
    CUBIC_SPRING,
    FRICTION_STEP,
    TORQUE_STEP,
    SHAKE,
    EVEN_INERTIA,
    SQUARE,
    EVEN_VISCOUS,
    VOLTAGE_PLAY,
    EVEN_GAIN,
    EVEN_TORQUE,
    CURRENT_RIPPLE,
    LEAK,
) = range(1, 14)


def no_effects() -> np.ndarray:
    """Table (3, COLUMNS) of a plant with viscous friction alone."""
    table = np.zeros((3, COLUMNS))
    table[:, [SATURATION, LIMIT]] = inf
    table[:, [STRIBECK_SPEED, PUSH_WIDTH, WARM_TIME, HOT_TIME, NONLINEAR_PERIOD]] = 1.0
    return table


#: steps of MuJoCo in a row of `Run.motion`
STEPS = 10


@dataclass(frozen=True)
class Sampling:
    """Of controller and log: period [s], divided into `rows` of about 1 ms, these into `STEPS` of
    about 0.1 ms."""

    period: float

    @property
    def rows(self) -> int:
        return max(1, round(self.period * 1000.0))

    @property
    def row(self) -> float:
        """Length [s] of a row of `Run.motion`."""
        return self.period / self.rows

    @property
    def step(self) -> float:
        """Step [s] of MuJoCo."""
        return self.row / STEPS


@dataclass
class Controller:
    """Digital PID with feed-forward. Arrays (n, 3): n samples; gains (3,).

    voltage : fed forward, dither included; setpoint : with its own dither. kp [V/rad], ki
    [V/(rad s)], kd [V s/rad]: zero for a run without feedback.
    """

    voltage: np.ndarray
    setpoint: np.ndarray
    kp: np.ndarray
    ki: np.ndarray
    kd: np.ndarray
    limit: float = 40.0


@dataclass
class Run:
    """What a run left. `commanded`, `measured` (n, 3): the log; `motion` (m, 3): the motor-side
    position as the sensor has it, without quantum, `rows` times a sample."""

    commanded: np.ndarray
    measured: np.ndarray
    motion: np.ndarray


def simulate(
    p: arm.Parameters,
    mechanics: Mechanics,
    table: np.ndarray,
    droop: float,
    delay: float,
    controller: Controller,
    sampling: Sampling,
    noise: np.ndarray,
    torque_noise: np.ndarray,
    quantised: bool = True,
) -> Run:
    """The run of a plant that starts at rest at the first setpoint.

    noise [V], torque_noise [N.m] (n, 3): held for a sample each; sampling : of the controller and
    the log; quantised : whether the encoders count.
    """
    made, motor = model(p, mechanics, sampling.step)
    data = mujoco.MjData(made)
    # the log starts where it is asked to be, as its encoders say
    start = controller.setpoint[0] - table[:, ENCODER]
    data.qpos[:3] = start
    hold = arm.gravity(start[None], p)[0]
    for j, dof in enumerate(motor):
        if dof != j:
            stiffness, _, gap = mechanics.drive[j]
            data.qpos[dof] = start[j] + hold[j] / stiffness + np.sign(hold[j]) * gap / 2
    commanded = np.zeros_like(controller.voltage)
    measured = np.zeros_like(commanded)
    motion = np.zeros((len(commanded) * sampling.rows, 3))
    drive = np.stack([p["R"], p["L"], p["ke"] * arm.GEAR, p["kt"] * arm.GEAR, p["Ia"], p["H"]])
    gains = np.stack([controller.kp, controller.ki, controller.kd])
    _loop(
        made._address,
        data._address,
        data.qpos,
        data.qvel,
        data.qacc,
        data.qfrc_applied,
        made.dof_frictionloss,
        made.dof_damping,
        motor,
        drive,
        table,
        droop,
        delay,
        controller.voltage,
        controller.setpoint,
        gains,
        controller.limit,
        sampling.rows,
        STEPS,
        sampling.step,
        noise,
        torque_noise,
        arm.QUANTUM if quantised else np.zeros(3),
        np.array(arm.gravity_constants(p)),
        hold,
        commanded,
        measured,
        motion,
    )
    return Run(commanded, measured, motion)


@numba.njit(cache=True)
def _sensed(e, q):
    """Position that an ideal encoder of the motor gives for a link at q."""
    if e[ECCENTRIC] != 0.0:
        motor = q
        for _ in range(4):
            motor = q - e[ECCENTRIC] * sin(e[ECCENTRIC_ORDER] * motor + e[ECCENTRIC_PHASE])
        return motor
    return q


@numba.njit(cache=True)
def _weight(gravity, j, q):
    """Gravity torque [N.m] of joint j."""
    if j == 0:
        return 0.0
    third = gravity[2] * cos(q[1] + q[2]) + gravity[3] * sin(q[1] + q[2])
    return third if j == 2 else third + gravity[0] * cos(q[1]) + gravity[1] * sin(q[1])


@numba.njit(cache=True)
def _outside_torque(e, j, t, q, qd, qdd, torque, current, gear, others):
    """Torque [N.m] that something outside the library takes."""
    kind, a, b, c, d = int(e[OUTSIDE]), e[OUT_A], e[OUT_B], e[OUT_C], e[OUT_D]
    if kind == CABLE:
        return a * sin(b * (others[int(d)] - c))
    if kind == CUBIC_SPRING:
        return a * (q - b) ** 3
    if kind == TORQUE_STEP:
        return a if t > b else 0.0
    if kind == SHAKE:
        return a * sin(2.0 * pi * b * t + c)
    if kind == EVEN_INERTIA:
        return a * abs(qdd)
    if kind == SQUARE:
        return a * max(-1.0, min(1.0, 20.0 * sin(2.0 * pi * (q - c) / b)))
    if kind == EVEN_VISCOUS:
        return a * abs(qd)
    if kind == EVEN_TORQUE:
        return a * abs(torque)
    if kind == CURRENT_RIPPLE:
        return a * current * sin(b * gear * q + c)
    return 0.0


@numba.njit(cache=True)
def _loop(
    mp,
    dp,
    qpos,
    qvel,
    qacc,
    applied,
    frictionloss,
    damping,
    motor,
    drive,
    table,
    droop,
    delay,
    feed,
    setpoint,
    gains,
    limit,
    rows,
    steps,
    h,
    noise,
    torque_noise,
    quantum,
    gravity,
    hold,
    commanded,
    measured,
    motion,
):
    n = feed.shape[0]
    per_sample = rows * steps
    T = per_sample * h
    R, L, emf, kt, Ia, H = drive[0], drive[1], drive[2], drive[3], drive[4], drive[5]
    current = np.zeros(3)
    integral = np.zeros(3)
    before = np.zeros(3)
    bristle = np.zeros(3)
    lagged = np.zeros(3)
    play = np.zeros(3)
    smooth = np.zeros(3)
    link = np.zeros(3)
    behind = int(floor(delay / h))
    part = delay / h - behind
    given_volts = np.zeros(3)
    for j in range(3):
        current[j] = hold[j] / kt[j]
        lagged[j] = _sensed(table[j], qpos[motor[j]])
        play[j] = R[j] * current[j]
    for k in range(n):
        for s in range(per_sample):
            t = (k * per_sample + s) * h
            if s % steps == 0:
                row = k * rows + s // steps
                for j in range(3):
                    e = table[j]
                    seen = lagged[j] if e[SENSOR_LAG] > 0.0 else _sensed(e, qpos[motor[j]])
                    if e[NONLINEAR] != 0.0:
                        seen += e[NONLINEAR] * sin(2.0 * pi * seen / e[NONLINEAR_PERIOD] + e[NONLINEAR_PHASE])
                    motion[row, j] = seen + e[ENCODER]
            if s == 0:
                for j in range(3):
                    seen = motion[k * rows, j]
                    if quantum[j] > 0.0:
                        seen = quantum[j] * floor(seen / quantum[j] + 0.5)
                    measured[k, j] = seen
                    error = setpoint[k, j] - seen
                    integral[j] += error * T
                    slope = (error - before[j]) / T if k > 0 else 0.0
                    before[j] = error
                    v = feed[k, j] + gains[0, j] * error + gains[1, j] * integral[j] + gains[2, j] * slope
                    commanded[k, j] = max(-limit, min(limit, v))
            # the voltage of this step: a delay may end inside it
            late = k * per_sample + s - behind
            now, earlier = max(late, 0) // per_sample, max(late - 1, 0) // per_sample
            for j in range(3):
                given_volts[j] = (1.0 - part) * commanded[now, j] + part * commanded[earlier, j]
            loads = abs(current[0]) + abs(current[1]) + abs(current[2])
            for j in range(3):
                link[j] = qpos[j]
            # mechanics: torque at the start of the step, dry friction and viscous left to MuJoCo
            for j in range(3):
                e = table[j]
                dof = motor[j]
                q, qd = qpos[dof], qvel[dof]
                level = e[COULOMB]
                if e[STRIBECK] != 0.0:
                    level += e[STRIBECK] * exp(-((qd / e[STRIBECK_SPEED]) ** 2))
                if e[POSITION] != 0.0:
                    level += e[POSITION] * cos(q - e[POSITION_ANGLE])
                if e[LOAD] != 0.0:
                    level += e[LOAD] * abs(_weight(gravity, j, qpos))
                if e[OUTSIDE] == FRICTION_STEP and t > e[OUT_B]:
                    level += e[OUT_A]
                frictionloss[dof] = max(level, 0.0)
                damping[dof] = H[j]
                if e[WARM] != 0.0:
                    damping[dof] = H[j] * (1.0 - e[WARM] * (1.0 - exp(-t / e[WARM_TIME])))
                given = kt[j] * current[j] + torque_noise[k, j]
                taken = e[BIAS] + e[QUADRATIC] * qd * abs(qd)
                if e[BRISTLE] != 0.0:
                    taken += e[BRISTLE] * bristle[j]
                if e[RIPPLE] != 0.0:
                    taken += e[RIPPLE] * sin(e[RIPPLE_ORDER] * q + e[RIPPLE_PHASE])
                if e[PUSH] != 0.0:
                    x = (t - e[PUSH_TIME]) / e[PUSH_WIDTH]
                    if abs(x) < 0.5:
                        taken -= e[PUSH] * cos(pi * x) ** 2
                if e[OUTSIDE] > 0.0:
                    smooth[j] += h / 2e-3 * (qacc[dof] - smooth[j])
                    taken += _outside_torque(e, j, t, q, qd, smooth[j], given, current[j], arm.GEAR[j], link)
                net = given - taken
                if e[ECCENTRIC] != 0.0:
                    # the motor turns by dm/dl, and its inertia is felt through that ratio
                    m = _sensed(e, q)
                    x = e[ECCENTRIC_ORDER] * m + e[ECCENTRIC_PHASE]
                    ratio = 1.0 / (1.0 + e[ECCENTRIC] * e[ECCENTRIC_ORDER] * cos(x))
                    bend = e[ECCENTRIC] * e[ECCENTRIC_ORDER] ** 2 * sin(x) * (ratio * qd) ** 2 * ratio
                    net = net * ratio - Ia[j] * (ratio * (ratio * qacc[dof] + bend) - qacc[dof])
                    net -= H[j] * qd * (ratio * ratio - 1.0)
                if e[CONTACT_LOSS] != 0.0:
                    # what teeth in contact lose; they push and never pull
                    twist = q - qpos[j]
                    deep = abs(twist) - e[HALF_GAP]
                    loss = 0.0
                    if deep > 0.0:
                        loss = e[CONTACT_LOSS] * (qd - qvel[j])
                        if twist > 0.0:
                            loss = max(loss, -e[CONTACT] * deep)
                        else:
                            loss = min(loss, e[CONTACT] * deep)
                    net -= loss
                    applied[j] = loss
                applied[dof] = net
            _mj_step(mp, dp)
            # electrics: the velocity now held is that of the middle of the step
            for j in range(3):
                e = table[j]
                dof = motor[j]
                qd = qvel[dof]
                if e[BRISTLE] != 0.0:
                    full = e[BRISTLE_LEVEL] / e[BRISTLE]
                    end = full if qd > 0.0 else -full
                    bristle[j] += (end - bristle[j]) * (1.0 - exp(-abs(qd) * h / full))
                v = given_volts[j]
                if e[DEAD_BAND] != 0.0:
                    v -= max(-e[DEAD_BAND], min(e[DEAD_BAND], v))
                v -= e[OFFSET]
                if e[OUTSIDE] > 0.0:
                    if e[OUTSIDE] == VOLTAGE_PLAY:
                        play[j] = max(v - e[OUT_A], min(v + e[OUT_A], play[j]))
                        v = play[j]
                    elif e[OUTSIDE] == EVEN_GAIN:
                        v -= e[OUT_A] * abs(v)
                    elif e[OUTSIDE] == LEAK:
                        v += e[OUT_A] * given_volts[int(e[OUT_D])]
                v = max(-e[SATURATION], min(e[SATURATION], v))
                v *= 1.0 - droop * loads
                v += noise[k, j]
                resistance = R[j]
                if e[HOT] != 0.0:
                    resistance *= 1.0 + e[HOT] * (1.0 - exp(-t / e[HOT_TIME]))
                speed = qd
                if e[ECCENTRIC] != 0.0:
                    x = e[ECCENTRIC_ORDER] * _sensed(e, qpos[dof]) + e[ECCENTRIC_PHASE]
                    speed = qd / (1.0 + e[ECCENTRIC] * e[ECCENTRIC_ORDER] * cos(x))
                final = (v - emf[j] * speed) / resistance
                i = final + (current[j] - final) * exp(-resistance * h / L[j])
                current[j] = max(-e[LIMIT], min(e[LIMIT], i))
                if e[SENSOR_LAG] > 0.0:
                    q = _sensed(e, qpos[dof] - 0.5 * h * qd)  # in the middle of the step
                    lagged[j] += (q - lagged[j]) * (1.0 - exp(-h / e[SENSOR_LAG]))
