# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Pinocchio: its articulated-body algorithm called from Python, RK4 and motors around it."""

from __future__ import annotations

import numpy as np

from benchmarks import denavit_hartenberg, rk4_loop
from benchmarks.task import Row, Task

#: before release 3 its articulated-body algorithm left armatures out
PACKAGES = ("pin>=3",)


def model_of(task: Task):
    """The Pinocchio model of the arm, motor inertias as armature."""
    import pinocchio as pin

    arm = task.plant.arm
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for k, (link, frame) in enumerate(zip(arm.links, denavit_hartenberg.links(arm)), start=1):
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"joint{k}")
        centre, inertia = denavit_hartenberg.in_joint_frame(link, frame)
        model.appendBodyToJoint(parent, pin.Inertia(link.mass, centre, inertia), pin.SE3.Identity())
        a, d, alpha = frame
        place = pin.SE3(denavit_hartenberg.turn_about_x(alpha), np.array([a, 0.0, d]))
    model.armature = np.array([motor.inertia for motor in arm.motors])
    model.gravity = pin.Motion(np.array([0.0, 0.0, -arm.gravity]), np.zeros(3))
    return model


def rows(task: Task) -> list[Row]:
    """One row: the loop in Python."""
    import pinocchio as pin

    model = model_of(task)
    data = model.createData()

    def acceleration(q, qd, torque):
        return pin.aba(model, data, q, qd, torque)

    return [Row("Pinocchio, aba + RK4 from Python", lambda: rk4_loop.simulate(task, acceleration), task.seconds)]
