# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""What the sections 7.6 and 7.7 share: the five poses, the thesis's numbers, paths and runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from puma_sim_core.dynamics.pid import PidGains
from puma_sim_core.dynamics.servo import ServoConfig
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import Recording
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Constraint, Simulator
from puma_sim_core.thesis.motions import HORIZONTAL, UPRIGHT
from puma_sim_core.tuning.ziegler_nichols import Loop, Ultimate, settings, ultimate_by_eigenvalues

#: q3 of the folded arm [rad], as section 7.7.2 prints it
FOLDED_ELBOW = -0.9075
#: with it the centre of mass of links 2 and 3 is above the shoulder (thesis: .17 rad)
FOLDED = (0.0, -np.pi / 2 + 0.1143, FOLDED_ELBOW)

PERIOD = 0.028
SAMPLES = 30


@dataclass(frozen=True)
class Case:
    """One of the five poses of section 7.7 with what is printed for it: plot, Kmax, Tp."""

    plot: str
    name: str
    joint: int
    pose: tuple[float, float, float]
    printed: Ultimate

    def loop(self, plant: Plant, period: float = SERVO_PERIOD, delay: int = 0) -> Loop:
        """The joint alone, the others locked."""
        return Loop(plant, self.joint, self.pose, period, delay)

    def ultimate(self, plant: Plant, period: float = SERVO_PERIOD, delay: int = 0) -> Ultimate:
        """Kmax and Tp of the corrected model."""
        return ultimate_by_eigenvalues(self.loop(plant, period, delay))


CASES = (
    Case("7.17", "joint 1, arm upright", 1, UPRIGHT, Ultimate(150.0, 0.45)),
    Case("7.18", "joint 1, arm horizontal", 1, HORIZONTAL, Ultimate(220.0, 0.60)),
    Case("7.19", "joint 2, links aligned, upright", 2, UPRIGHT, Ultimate(475.0, 0.40)),
    Case("7.20", "joint 2, arm folded", 2, FOLDED, Ultimate(385.0, 0.20)),
    Case("7.21", "joint 3, link 2 upright", 3, UPRIGHT, Ultimate(270.0, 0.18)),
)


def case(plot: str) -> Case:
    """The case of a plot."""
    return next(c for c in CASES if c.plot == plot)


def gains_text(gains: PidGains) -> str:
    """Gains for a person."""
    return f"Kg {gains.gain:.4g} V/rad, Ti {gains.integral_time:.3g} s, Td {gains.derivative_time:.3g} s"


def path(start, moves, duration: float, period: float = PERIOD) -> np.ndarray:
    """Setpoints (n, 3) [rad], one each `period` [s], that sum up ramps and steps.

    start : (3,) [rad]; moves : (when [s], how long [s], by what (3,) [rad]); a move of no length
    is a step.
    """
    # at the middle of a period, so that rounding does not move a step by one
    time = (np.arange(int(np.ceil(duration / period - 1e-9))) + 0.5) * period
    setpoint = np.tile(np.asarray(start, dtype=float), (len(time), 1))
    for when, length, by in moves:
        share = (time > when) * 1.0 if length == 0.0 else np.clip((time - when) / length, 0.0, 1.0)
        setpoint += share[:, None] * np.asarray(by, dtype=float)
    return setpoint


def run(
    plant: Plant,
    gains,
    pose,
    setpoint,
    *,
    alone: int | None = None,
    period: float = PERIOD,
    samples: int = SAMPLES,
    voltage_limit: float = 40.0,
    **servo,
) -> Recording:
    """The arm at rest at `pose`, under the servo; `alone`: the one joint that is not locked.

    servo : options of `ServoConfig`. The derivative is that of the error, as in the thesis.
    """
    held = [Constraint("hold" if alone not in (None, j) else "free") for j in (1, 2, 3)]
    simulator = Simulator(plant, constraints=held)
    simulator.reset(pose)
    config = ServoConfig(tuple(gains), **{"derivative_on_measurement": False, **servo})
    return simulator.run_servo(setpoint, config, period=period, samples=samples, voltage_limit=voltage_limit)


def printed_pid(*plots: str) -> tuple[PidGains, ...]:
    """Table 7.2 on the thesis's own Kmax and Tp of some plots."""
    return tuple(settings(case(plot).printed) for plot in plots)
