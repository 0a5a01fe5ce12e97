# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Plants for the tests, and the equations of motion written down a second time, with matrices."""

from __future__ import annotations

import struct
from dataclasses import replace
from functools import cache

import numpy as np
from trace_form import arm_table

from puma_sim_core.arm.kinematics import link_transforms
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.rigid_body import coriolis, gravity_torque, inertia
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant

#: the values of the regression in the design notes
VISCOUS = tuple(f"viscous_friction:joint={j},coefficient={h}" for j, h in ((1, 0.3), (2, 0.5), (3, 0.2)))
START = ((0.1, -0.4, 0.7), (0.3, -0.2, 0.5), (0.5, -1.0, 0.8))


arm_of = cache(load_parameters)


def plant_of(*effects: str, name: str = "bejczy", torque_form: str = "physical") -> Plant:
    return Plant(arm_of(name), tuple(map(parse_effect, effects)), torque_form)


def open_circuit(plant: Plant) -> Plant:
    """The plant with motors that carry no current, whatever turns them, at 0 V."""
    motors = tuple(replace(motor, back_emf=0.0) for motor in plant.arm.motors)
    return Plant(replace(plant.arm, motors=motors), plant.effects, plant.torque_form)


def mass_matrix(plant: Plant, q) -> np.ndarray:
    """D + Ia."""
    arm = plant.loaded_arm
    return inertia(q, arm) + np.diag(arm.motor_inertia)


def driving_torque(plant: Plant, q, qd, current) -> np.ndarray:
    """What accelerates the joints, dry friction and stops apart."""
    arm = plant.loaded_arm
    qd = np.asarray(qd)
    return (
        np.array(plant.torque_per_ampere) * current
        - np.array(plant.viscous_friction) * qd
        - np.einsum("ijk,j,k->i", coriolis(q, arm), qd, qd)
        - gravity_torque(q, arm)
    )


def reduced_accelerations(M, b, given) -> np.ndarray:
    """Accelerations where `given` (None: free) prescribes some: the others' rows alone."""
    a = np.array([0.0 if g is None else g for g in given])
    free = [j for j in range(3) if given[j] is None]
    if free:
        a[free] = np.linalg.solve(M[np.ix_(free, free)], (b - M @ a)[free])
    return a


def right_hand_side(plant: Plant, voltage, given=(None, None, None), torque=None):
    """f(t, y) of y = (q, qd, i) for voltages held; torque(q, qd) acts at the joints besides."""
    motors = plant.arm.motors
    R, L, ke, N = (
        np.array([getattr(m, name) for m in motors]) for name in ("resistance", "inductance", "back_emf", "gear_ratio")
    )

    def f(t, y):
        q, qd, current = y[:3], y[3:6], y[6:]
        b = driving_torque(plant, q, qd, current)
        if torque is not None:
            b = b + torque(q, qd)
        qdd = reduced_accelerations(mass_matrix(plant, q), b, given)
        return np.concatenate([qd, qdd, (voltage - R * current - ke * N * qd) / L])

    return f


def energy(plant: Plant, q, qd) -> float:
    """Kinetic energy with that of the rotors, and potential energy of the centres of mass [J]."""
    arm = plant.loaded_arm
    frames = link_transforms(q, arm_table(arm))[1:]
    heights = [(frame @ (*link.centre, 1.0))[2] for frame, link in zip(frames, arm.links)]
    potential = arm.gravity * sum(link.mass * z for link, z in zip(arm.links, heights))
    return 0.5 * np.asarray(qd) @ mass_matrix(plant, q) @ qd + potential


def bits(values) -> tuple[bytes, ...]:
    """The bytes of each number, so that -0.0 and 0.0 differ."""
    return tuple(struct.pack("<d", float(value)) for value in np.ravel(values))


def smooth_voltages(amplitude, duration: float, row: float = 0.032):
    """(time, voltage) of rows that hold samples of sines."""
    time = np.arange(0.0, duration + row / 2, row)
    phase = np.outer(time, (3.1, 2.3, 4.7)) + (0.3, 1.0, 2.0)
    return time, np.asarray(amplitude) * np.sin(phase)
