# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The arm as a MuJoCo model: links, rotors behind elastic or loose drives, springs and stops."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import mujoco
import numpy as np

from blind import arm_parameters as arm

#: MuJoCo's dry friction is a soft constraint; these make its creep at rest 1e-8 of the torque
_SHARP = 'solreffriction="2e-4 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"'


@dataclass
class Mechanics:
    """What MuJoCo itself adds to the rigid arm. Joints are 0-based.

    spring : joint -> (stiffness [N.m/rad], angle [rad]).
    stop : joint -> (lower, upper [rad], stiffness [N.m/rad]).
    drive : joint -> (stiffness [N.m/rad], damping [N.m.s/rad], gap [rad]): the rotor, with 70 % of
        the motor's inertia, behind a spring with play.
    payload : (mass [kg], x, y, z [m]) in the frame of link 3.
    tilt : (x, y) [rad] of the base.
    """

    spring: dict[int, tuple[float, float]] = field(default_factory=dict)
    stop: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    drive: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    payload: tuple[float, float, float, float] | None = None
    tilt: tuple[float, float] = (0.0, 0.0)


MOTOR_SHARE = 0.7


def _joint(j: int, armature: float, mechanics: Mechanics) -> str:
    spring = ""
    if j in mechanics.spring:
        stiffness, angle = mechanics.spring[j]
        spring = f'stiffness="{stiffness!r}" springref="{angle!r}"'
    return f'<joint name="joint{j}" axis="0 0 1" armature="{armature!r}" {spring} {_SHARP}/>'


def _placed(a: float, d: float, alpha: float) -> str:
    return f'pos="{a!r} 0 {d!r}" quat="{math.cos(alpha / 2)!r} {math.sin(alpha / 2)!r} 0 0"'


def model(p: arm.Parameters, mechanics: Mechanics, step: float):
    """(compiled model, degree of freedom of each motor (3,)).

    Degrees of freedom 0 to 2 are the links; rotors of elastic or loose drives follow. Masses and
    inertias are written after compiling, since link 2 is not a possible body by itself.
    """
    places = ((0.0, 0.0, 0.0), (0.0, 0.0, -math.pi / 2), (arm.A2, 0.0, 0.0))
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    bodies = ""
    for j, place in enumerate(places):
        armature = float(p["Ia"][j]) * (1.0 - MOTOR_SHARE if j in mechanics.drive else 1.0)
        bodies += f'<body name="link{j}" {_placed(*place)}>{_joint(j, armature, mechanics)}{inertial}'
    if mechanics.payload:
        mass, x, y, z = mechanics.payload
        # frame 3 of Denavit and Hartenberg stands behind joint 3's body frame
        bodies += (
            f'<body {_placed(arm.A3, arm.D3, math.pi / 2)}><body pos="{x!r} {y!r} {z!r}">'
            f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1e-9 1e-9 1e-9"/>'
            "</body></body>"
        )
    bodies += "</body>" * 3
    motor, tendons = np.arange(3), ""
    for extra, (j, (stiffness, damping, gap)) in enumerate(sorted(mechanics.drive.items())):
        motor[j] = 3 + extra
        bodies += (
            f'<body><joint name="rotor{j}" axis="0 0 1" '
            f'armature="{MOTOR_SHARE * float(p["Ia"][j])!r}" {_SHARP}/>'
            '<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/></body>'
        )
        tendons += (
            f'<fixed stiffness="{stiffness!r}" damping="{damping!r}" '
            f'springlength="{-gap / 2!r} {gap / 2!r}"><joint joint="rotor{j}" coef="1"/>'
            f'<joint joint="joint{j}" coef="-1"/></fixed>'
        )
    for j, (lower, upper, stiffness) in mechanics.stop.items():
        tendons += (
            f'<fixed stiffness="{stiffness!r}" springlength="{lower!r} {upper!r}">'
            f'<joint joint="joint{j}" coef="1"/></fixed>'
        )
    gx, gy, gz = _gravity(mechanics.tilt)
    made = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option timestep="{step!r}" integrator="Euler" '
        f'gravity="{gx!r} {gy!r} {gz!r}"><flag contact="disable"/></option>'
        f"<worldbody>{bodies}</worldbody><tendon>{tendons}</tendon></mujoco>"
    )
    _write_inertias(made, p, places)
    made.dof_damping[motor] = p["H"]
    return made, motor


def _gravity(tilt) -> tuple[float, float, float]:
    """Gravity in the frame of a base that leans by (x, y): g (x, y, -1) to first order."""
    lean = math.hypot(*tilt)
    across = math.sin(lean) / lean if lean > 0.0 else 1.0
    return (arm.GRAVITY * across * tilt[0], arm.GRAVITY * across * tilt[1], -arm.GRAVITY * math.cos(lean))


def _write_inertias(made, p, places) -> None:
    frames = (*places[1:], (arm.A3, arm.D3, math.pi / 2))
    for j, (a, d, alpha) in enumerate(frames):
        c, s = math.cos(alpha), math.sin(alpha)
        turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        centre = np.array([p["x"][j], p["y"][j], p["z"][j]])
        kxx, kyy, kzz = p["kxx"][j], p["kyy"][j], p["kzz"][j]
        # second moments of mass about the frame of the link, then inertia about its centre
        about = np.diag([kxx, kyy, kzz])
        about = about - (centre @ centre * np.eye(3) - np.outer(centre, centre))
        inertia = p["m"][j] * (turn @ about @ turn.T)
        principal, axes = np.linalg.eigh(inertia)
        if np.linalg.det(axes) < 0.0:
            axes[:, 0] = -axes[:, 0]
        body = mujoco.mj_name2id(made, mujoco.mjtObj.mjOBJ_BODY, f"link{j}")
        made.body_mass[body] = p["m"][j]
        made.body_ipos[body] = turn @ centre + (a, 0.0, d)
        made.body_inertia[body] = principal
        mujoco.mju_mat2Quat(made.body_iquat[body], np.ascontiguousarray(axes).ravel())
    mujoco.mj_setConst(made, mujoco.MjData(made))
