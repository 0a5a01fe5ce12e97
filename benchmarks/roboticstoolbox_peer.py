# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Robotics Toolbox for Python: its forward dynamics in an RK4 loop, and its own integrator."""

from __future__ import annotations

import numpy as np

from benchmarks import denavit_hartenberg, rk4_loop
from benchmarks.task import STEP, Row, Task

PACKAGES = ("roboticstoolbox-python",)

#: `fdyn` is so slow that it does the beginning of the task only
_FDYN_SECONDS = 1.0
#: what leaving out the inductance (L/R = 3 ms) may do
_FDYN_TOLERANCE = 5e-3


def robot_of(task: Task):
    """The arm as a `DHRobot`; the motor inertia goes in with a gear ratio of one."""
    import roboticstoolbox as rtb

    arm = task.plant.arm
    made = []
    for link, motor, (a, d, alpha) in zip(arm.links, arm.motors, denavit_hartenberg.links(arm)):
        made.append(
            rtb.RevoluteDH(
                a=a,
                d=d,
                alpha=alpha,
                m=link.mass,
                r=list(link.centre),
                I=denavit_hartenberg.central_inertia(link),
                Jm=motor.inertia,
                G=1.0,
                B=0.0,
                Tc=[0.0, 0.0],
            )
        )
    robot = rtb.DHRobot(made)
    # releases differ in the sign of this vector
    robot.gravity = robot.gravity * (arm.gravity / np.linalg.norm(robot.gravity))
    return robot


def rows(task: Task) -> list[Row]:
    """`accel` in the same RK4 loop, and `fdyn`."""
    robot = robot_of(task)
    motors = task.plant.arm.motors
    torque = np.array(task.plant.torque_per_ampere)
    emf = np.array([m.back_emf * m.gear_ratio for m in motors])
    resistance = np.array([m.resistance for m in motors])

    def motor_torque(robot, t, q, qd):
        volts = task.voltages[min(int(t / STEP), task.steps - 1)]
        return torque * (volts - emf * qd) / resistance

    seconds = min(_FDYN_SECONDS, task.seconds)

    def fdyn():
        done = robot.fdyn(seconds, task.state[:3], motor_torque, qd0=task.state[3:6], solver_args={"max_step": STEP})
        return done.q[-1]

    return [
        Row("Robotics Toolbox, accel + RK4 from Python", lambda: rk4_loop.simulate(task, robot.accel), task.seconds),
        Row(
            "Robotics Toolbox, fdyn",
            fdyn,
            seconds,
            tolerance=_FDYN_TOLERANCE,
            note=f"its RK45, steps of at most 1 ms; {seconds:g} s measured and scaled up; its "
            "state has no current, so motors without inductance",
        ),
    ]
