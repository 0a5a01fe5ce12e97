# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Runs of arms with two masses a drive, and their equations written down a second time, with
matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from arm_reference import energy, open_circuit, plant_of
from scipy.integrate import solve_ivp

from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

SHARE = 0.7
VISCOUS = [f"viscous_friction:joint={j},coefficient={h}" for j, h in ((1, 5.8), (2, 9.5), (3, 4))]
HELD = (Constraint("hold"),) * 3
POSE = (0.2, -0.5, 0.6)
START = ((0.1, -0.4, 0.7), (0.3, -0.2, 0.5), (0.5, -1.0, 0.8))


def free_only(joint):
    return tuple(Constraint() if j == joint else Constraint("hold") for j in (1, 2, 3))


def weightless(plant):
    return Plant(replace(plant.arm, gravity=0.0), plant.effects, plant.torque_form)


def elastic(joint, stiffness, damping=0.0):
    return f"joint_elasticity:joint={joint},stiffness={stiffness},damping={damping}"


def masses(plant, joint, pose=POSE):
    """Inertia of the rotor and of the link of a joint, the other joints held."""
    own = plant.arm.motor_inertia[joint - 1]
    return SHARE * own, inertia(pose, plant.loaded_arm)[joint - 1, joint - 1] + (1 - SHARE) * own


def started(
    plant,
    constraints=(Constraint(),) * 3,
    links=None,
    max_step=SERVO_PERIOD,
    position=POSE,
    velocity=None,
    current=(0.0, 0.0, 0.0),
):
    simulator = Simulator(plant, constraints=constraints, max_step=max_step)
    simulator.reset(position, velocity, current)
    if links is not None:
        simulator.links = tuple(links)
    return simulator


def rest(simulator, duration, step):
    """Run at 0 V; returns the recording and the links (n, 6) at its rows."""
    time = np.arange(0.0, duration + step / 2, step)
    return simulator.run(time, np.zeros((len(time), 3))), simulator.link_motion


class Oracle:
    """The equations of the module `two_mass` with matrices. spring: {joint: (K, B, gap)}; wave:
    {joint: (e, n, f)}; joints from 0. y = (q, qd, i, ql and qdl of the soft joints)."""

    def __init__(self, plant, spring, wave):
        self.plant, self.spring, self.wave = plant, spring, wave
        self.soft = sorted(spring)
        self.own = np.array(plant.arm.motor_inertia)
        self.link = np.diag([(1 - SHARE) * a if j in spring else 0.0 for j, a in enumerate(self.own)])

    def gear(self, q):
        u, slope, bend = np.array(q), np.ones(3), np.zeros(3)
        for j, (e, n, f) in self.wave.items():
            u[j] += e * np.sin(n * q[j] + f)
            slope[j] += e * n * np.cos(n * q[j] + f)
            bend[j] = -e * n * n * np.sin(n * q[j] + f)
        return u, slope, bend

    def torque(self, j, twist, rate):
        K, B, gap = self.spring[j]
        if gap == 0.0:
            return K * twist + B * rate
        over = twist - np.clip(twist, -gap / 2, gap / 2)
        raw = K * over + B * rate if over else 0.0
        return raw if raw * over > 0 else 0.0

    def __call__(self, t, y, voltage):
        arm, plant = self.plant.loaded_arm, self.plant
        q, w, current, n = y[:3], y[3:6], y[6:9], len(self.soft)
        u, slope, bend = self.gear(q)
        ql, wl = u.copy(), slope * w
        ql[self.soft], wl[self.soft] = y[9 : 9 + n], y[9 + n :]
        motor = np.array(plant.torque_per_ampere) * current - np.array(plant.viscous_friction) * w
        tau = np.zeros(3)
        for j in self.soft:
            tau[j] = self.torque(j, u[j] - ql[j], slope[j] * w[j] - wl[j])
        # unknowns: accelerations of the motors, then of the soft links, by the virtual work of all
        J = np.zeros((3, 3 + n))
        excess = bend * w * w
        for j in range(3):
            if j in self.soft:
                J[j, 3 + self.soft.index(j)], excess[j] = 1.0, 0.0
            else:
                J[j, j] = slope[j]
        M = inertia(ql, arm) + self.link
        c = np.einsum("ijk,j,k->i", coriolis(ql, arm), wl, wl) + gravity_torque(ql, arm)
        rotor = np.diag([SHARE * a if j in self.soft else a for j, a in enumerate(self.own)])
        left = J.T @ M @ J
        left[:3, :3] += rotor
        right = J.T @ (tau - c - M @ excess)
        right[:3] += motor - slope * tau
        a = np.linalg.solve(left, right)
        R, L, ke, N = (
            np.array([getattr(m, name) for m in plant.arm.motors])
            for name in ("resistance", "inductance", "back_emf", "gear_ratio")
        )
        return np.concatenate([w, a[:3], (voltage - R * current - ke * N * w) / L, y[9 + n :], a[3:]])

    def run(self, simulator, time, volts, tolerance, max_step=np.inf):
        """States at the rows, from the simulator's own start."""
        y = np.array(
            [*simulator.state, *(simulator.links[j] for j in self.soft), *(simulator.links[3 + j] for j in self.soft)]
        )
        rows = [y]
        for begin, end, v in zip(time[:-1], time[1:], volts):
            y = solve_ivp(
                self, (begin, end), y, args=(v,), method="DOP853", rtol=tolerance, atol=1e-12, max_step=max_step
            ).y[:, -1]
            rows.append(y)
        return np.array(rows)


def whole_energy(plant, run, motion, r, springs):
    """Energy [J] of links, rotors, weight and springs at a row."""
    own = np.array(plant.arm.motor_inertia)
    soft = np.isin((1, 2, 3), list(springs))
    # `energy` moves all of Ia with the link; a part of it moves with the rotor
    part = np.where(soft, SHARE, 1.0) * own
    total = energy(plant, motion[r, :3], motion[r, 3:])
    total += 0.5 * (part * (run.velocity[r] ** 2 - motion[r, 3:] ** 2)).sum()
    for joint, (stiffness, gap) in springs.items():
        twist = abs(run.position[r, joint - 1] - motion[r, joint - 1])
        total += 0.5 * stiffness * max(twist - gap / 2, 0.0) ** 2
    return total


def drift(effects, springs, max_step):
    plant = open_circuit(plant_of(*effects))
    run, motion = rest(started(plant, max_step=max_step, position=(0.1, -0.4, 0.7)), 0.4, 0.02)
    return max(
        abs(whole_energy(plant, run, motion, r, springs) - whole_energy(plant, run, motion, 0, springs))
        for r in range(len(run.time))
    )
