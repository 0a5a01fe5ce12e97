# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""MuJoCo with the same arm: same inertias, same motors, its RK4 at the same step.

The actuator is MuJoCo's own ``dcmotor`` (since 3.7), whose activation is the armature current.
It has one constant K for torque and back-EMF. Ours are two, ke and kt; with currents and voltages
scaled by sqrt(kt/ke), K = sqrt(ke kt) gives the same motion.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks import denavit_hartenberg
from benchmarks.task import STEP, Row, Task

PACKAGES = ("mujoco",)

STEP_LOOP, ROLLOUT = "MuJoCo, mj_step from Python", "MuJoCo, rollout"

#: accelerations agree to 1e-11; over a run the current is advanced to first order only, an error
#: that halves with the step
_TOLERANCE = 2e-4
_NOTE = "MuJoCo advances the current of its motors to first order in the step"


def model_of(task: Task):
    """The compiled MuJoCo model.

    Inertias are written after compiling: link 2 of the thesis is no possible rigid body, and the
    compiler would refuse it, although D + Ia is positive definite.
    """
    import mujoco

    arm = task.plant.arm
    frames = denavit_hartenberg.links(arm)
    bodies = "".join(
        f'<body name="link{k}" {_placed(before)}><joint name="joint{k}" axis="0 0 1" '
        f'armature="{motor.inertia!r}"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        for k, (before, motor) in enumerate(zip([(0.0, 0.0, 0.0), *frames], arm.motors), start=1)
    )
    motors = "".join(
        f'<dcmotor joint="joint{k}" gear="{m.gear_ratio!r}" resistance="{m.resistance!r}" '
        f'motorconst="{m.torque_constant!r} {m.back_emf!r}" inductance="{m.inductance!r} 0"/>'
        for k, m in enumerate(arm.motors, start=1)
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/>'
        f'<option timestep="{STEP}" gravity="0 0 {-arm.gravity!r}" integrator="RK4"/>'
        f"<worldbody>{bodies}{'</body>' * 3}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    for k, (link, frame) in enumerate(zip(arm.links, frames), start=1):
        centre, inertia = denavit_hartenberg.in_joint_frame(link, frame)
        principal, axes = np.linalg.eigh(inertia)
        if np.linalg.det(axes) < 0.0:
            axes[:, 0] = -axes[:, 0]
        model.body_mass[k] = link.mass
        model.body_ipos[k] = centre
        model.body_inertia[k] = principal
        mujoco.mju_mat2Quat(model.body_iquat[k], axes.ravel())
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _placed(frame: tuple[float, float, float]) -> str:
    """Place of a body behind a link of these (a, d, alpha)."""
    a, d, alpha = frame
    return f'pos="{a!r} 0 {d!r}" quat="{math.cos(alpha / 2)!r} {math.sin(alpha / 2)!r} 0 0"'


def rows(task: Task) -> list[Row]:
    """The step loop in Python, and the rollout of the same model, as it is and at its leanest."""
    import mujoco
    from mujoco import rollout

    scale = np.sqrt([m.torque_constant / m.back_emf for m in task.plant.arm.motors])
    control = np.ascontiguousarray(task.voltages * scale)
    model, lean = model_of(task), model_of(task)
    lean.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = task.state[:3], task.state[3:6]
    data.act[:] = task.state[6:] * scale
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, data, start, spec)

    def step_loop():
        mujoco.mj_setState(model, data, start, spec)
        for volts in control:
            data.ctrl[:] = volts
            mujoco.mj_step(model, data)
        return data.qpos.copy()

    states = np.empty((1, task.steps, len(start)))
    pool = rollout.Rollout(nthread=0)

    def roll(which):
        pool.rollout(which, data, start[None], control[None], state=states)
        return states[0, -1, 1:4].copy()

    made = {
        STEP_LOOP: step_loop,
        ROLLOUT: lambda: roll(model),
        f"{ROLLOUT}, contacts and constraints off": lambda: roll(lean),
    }
    return [Row(label, run, task.seconds, calls=2, tolerance=_TOLERANCE, note=_NOTE) for label, run in made.items()]
