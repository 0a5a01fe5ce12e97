# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Motions that several open-loop experiments need: one joint driven while the others are locked."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np

from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import Recording
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Constraint, Simulator

HELD, FREE = Constraint("hold"), Constraint()

#: (q1, q2, q3) [rad]: horizontal and stretched, upright and stretched
HORIZONTAL = (0.0, 0.0, radians(90.0))
UPRIGHT = (0.0, radians(-90.0), radians(90.0))
#: the angle of joint 3 with the forearm folded back (section 7.4.2), and stretched
FOLDED, STRETCHED = radians(-52.0), radians(90.0)


def with_joint(pose, joint: int, angle: float) -> tuple[float, float, float]:
    """The pose [rad] with joint 1, 2 or 3 at another angle."""
    return tuple(float(angle) if j == joint - 1 else float(q) for j, q in enumerate(pose))


def open_circuit(plant: Plant) -> Plant:
    """The plant with motors that carry no current at 0 V, however they are turned.

    Without back-EMF nothing drives a current that starts at zero: it stays zero exactly, which is
    what an open circuit does. The voltage across the open terminals is not modelled.
    """
    motors = tuple(replace(motor, back_emf=0.0) for motor in plant.arm.motors)
    return Plant(replace(plant.arm, motors=motors), plant.effects, plant.torque_form)


def one_joint(plant: Plant, joint: int, max_step: float = SERVO_PERIOD) -> Simulator:
    """A simulator of the plant with the two other joints truly locked."""
    return Simulator(plant, constraints=tuple(FREE if j == joint else HELD for j in (1, 2, 3)), max_step=max_step)


def drive(simulator: Simulator, joint: int, pose, voltage: float, duration: float, sample: float = 0.02) -> Recording:
    """The joint under a constant voltage [V] from rest at a pose [rad], for `duration` [s]."""
    time = sample * np.arange(int(np.ceil(duration / sample)) + 1)
    volts = np.zeros((len(time), 3))
    volts[:, joint - 1] = voltage
    simulator.reset(pose)
    return simulator.run(time, volts)


def first_time(time, values, level: float) -> float:
    """When the values first reach the level [s], between samples by a straight line.

    Infinity if they never do.
    """
    side = np.sign(np.asarray(values) - level)
    reached = np.flatnonzero(side != side[0])
    if not reached.size:
        return float("inf")
    k = int(reached[0])
    share = (level - values[k - 1]) / (values[k] - values[k - 1])
    return float(time[k - 1] + share * (time[k] - time[k - 1]))


def crossing_time(simulator: Simulator, joint: int, pose, voltage: float, longest: float) -> float:
    """Time [s] that a constant voltage takes to drive a joint from one end of its range to the
    other, from rest; infinity if it takes longer than `longest` [s]. The sign of the voltage
    tells the direction; `pose` [rad] gives the angles of the other joints."""
    low, high = simulator.plant.arm.joint_ranges[joint - 1]
    start, end = (low, high) if voltage > 0.0 else (high, low)
    recording = drive(simulator, joint, with_joint(pose, joint, start), voltage, longest)
    return first_time(recording.time, recording.position[:, joint - 1], end)
