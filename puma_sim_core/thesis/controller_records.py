# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Records of joint 1's controller as section 7.1.2 took them, from a controller of known gains."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot, pi

import numpy as np

from puma_sim_core.arm.inverse_kinematics import wrist_angles
from puma_sim_core.arm.kinematics import wrist_position
from puma_sim_core.control.setpoints import smooth_share
from puma_sim_core.dynamics.pid import PidGains
from puma_sim_core.dynamics.servo import DEFAULT_GAINS, ServoConfig
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator
from puma_sim_core.tuning.controller_log import ControllerLog

#: "about 4 kbytes": the longest record of section 7.1.2, taken as 4096 samples of each channel
RECORD = 4096
#: of the encoder, a motor turn
COUNTS = 1000
#: the end effector's repeated motion [m]
STROKE = 0.010


@dataclass(frozen=True)
class Motion:
    """Where the wrist goes to and fro: joint angles at one end [rad], displacement [m], and how
    long one stroke may take [s]."""

    start: tuple[float, float, float]
    displacement: tuple[float, float, float] = (STROKE, 0.0, 0.0)
    stroke: tuple[float, float] = (0.25, 0.42)


def motions(arm) -> dict[str, Motion]:
    """The two motions of the section.

    The arm that is stretched horizontally points along y, half a millimetre short of its reach:
    along x, a motion in x would not turn joint 1 at all. The highest point itself is above the
    shoulder, where any motion would turn joint 1 by much; the wrist moves 28 mm below it, slowly
    enough that the derivative of a step of the setpoint stays below 40 V, and "fast", where it
    does not.
    """
    forearm = hypot(arm.a3, arm.d4)
    stretched = atan2(arm.d4, arm.a3)
    reach = hypot(arm.a2 + forearm - 0.0005, arm.d3)
    horizontal = wrist_angles(
        (-0.5 * STROKE, (reach**2 - 0.25 * STROKE**2) ** 0.5, 0.0), arm, (0.5 * pi, -0.03, stretched + 0.06)
    )
    high = (0.5 * pi, -0.5 * pi + 0.2, stretched + 0.1)
    return {
        "7.9": Motion(tuple(horizontal)),
        "7.10": Motion(high, stroke=(0.7, 1.0)),
        "fast": Motion(high),
        "along x": Motion((0.0, -0.03, stretched + 0.06), (-STROKE, 0.0, 0.0)),
    }


@dataclass(frozen=True)
class Maker:
    """Makes records of joint 1's controller as section 7.1.2 took them."""

    plant: Plant

    def log(
        self,
        motion: Motion,
        gains: PidGains,
        rng: np.random.Generator,
        *,
        bits: int | None = 12,
        on_measurement: bool = False,
    ) -> ControllerLog:
        """RECORD samples: setpoints each 28 ms, encoder counts, voltages of `bits` bits.

        The duration of a stroke and the place between two counts where joint 1 starts are random.
        """
        arm = self.plant.arm
        stroke, between = rng.uniform(*motion.stroke), rng.uniform(-1e-4, 1e-4)
        setpoint = repeated(arm, motion, stroke, RECORD // 30 + 1)
        start = setpoint[0].copy()
        start[0] += between
        simulator = Simulator(self.plant)
        simulator.reset(start)
        # the other joints' servo is ours; its derivative is of the measurement, without kicks
        servo = ServoConfig(
            (gains, *DEFAULT_GAINS[1:]),
            converter_bits=bits,
            encoder_counts=COUNTS,
            derivative_on_measurement=on_measurement,
        )
        run = simulator.run_servo(setpoint, servo)
        step = 2.0 * pi / (COUNTS * arm.motors[0].gear_ratio)
        return ControllerLog(
            SERVO_PERIOD, run.setpoint[:RECORD, 0], run.position[:RECORD, 0], run.voltage[:RECORD, 0], "record"
        ).with_counts(abs(step))


def repeated(arm, motion: Motion, stroke: float, rows: int, period: float = 0.028) -> np.ndarray:
    """(rows, 3) setpoints [rad] of a straight stroke of `stroke` seconds, to and fro."""
    origin = wrist_position(np.array(motion.start), arm)
    share = np.arange(rows) * period / stroke
    whole = np.floor(share)
    part = smooth_share(share - whole)
    part = np.where(whole % 2.0 == 0.0, part, 1.0 - part)
    setpoint = np.empty((rows, 3))
    before = np.array(motion.start)
    for row in range(rows):
        before = setpoint[row] = wrist_angles(origin + part[row] * np.array(motion.displacement), arm, before)
    return setpoint
