# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What several experiments share: poses, motions of one joint, the thesis's PID gains, and runs under the servo."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import radians
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.control.linear import least_damped, linearised, pid_loop, sampled
from puma_sim_core.control.metrics import effort, tracking_error
from puma_sim_core.control.setpoints import Move, joint_path, joint_setpoints
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import Recording
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.feedback import Controller
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator
from puma_sim_core.tuning.ziegler_nichols import Loop, Ultimate, settings, ultimate_by_eigenvalues

HELD, FREE = Constraint("hold"), Constraint()

#: (q1, q2, q3) [rad]: horizontal and stretched, upright and stretched
HORIZONTAL = (0.0, 0.0, radians(90.0))
UPRIGHT = (0.0, radians(-90.0), radians(90.0))
#: poses of chapter 6
POSES = {"upright": UPRIGHT, "horizontal": HORIZONTAL, "q = 0": (0.0, 0.0, 0.0)}
#: the angle of joint 3 with the forearm folded back (section 7.4.2)
FOLDED = radians(-52.0)


def rk4_step(f: Callable[[np.ndarray], np.ndarray], x: np.ndarray, h: float) -> np.ndarray:
    """One Runge-Kutta step of a derivative in plain NumPy, for equations as the thesis writes them."""
    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    k4 = f(x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def angles(q2, q3) -> np.ndarray:
    """(..., 3) angles [rad] with joint 1 at 0."""
    return np.stack(np.broadcast_arrays(0.0, q2, q3), axis=-1)


def with_joint(pose, joint: int, angle: float) -> tuple[float, float, float]:
    """The pose [rad] with joint 1, 2 or 3 at another angle."""
    return tuple(float(angle) if j == joint - 1 else float(q) for j, q in enumerate(pose))


def open_circuit(plant: Plant) -> Plant:
    """The plant with motors that carry no current at 0 V, however they are turned.

    Without back-EMF nothing drives a current that starts at zero: it stays zero exactly, which is
    what an open circuit does. The voltage across the open terminals is not modelled.
    """
    motors = tuple(replace(motor, back_emf=0.0) for motor in plant.arm.motors)
    return replace(plant, arm=replace(plant.arm, motors=motors))


def one_joint(plant: Plant, joint: int | None, max_step: float = SERVO_PERIOD) -> Simulator:
    """A simulator of the plant with the two other joints locked; None: all are free."""
    return Simulator(plant, constraints=[FREE if joint in (None, j) else HELD for j in (1, 2, 3)], max_step=max_step)


def drive(simulator: Simulator, joint: int, pose, voltage: float, duration: float, sample: float = 0.02) -> Recording:
    """The joint under a constant voltage [V] from rest at a pose [rad], for `duration` [s]."""
    time = sample * np.arange(int(np.ceil(duration / sample)) + 1)
    volts = np.zeros((len(time), 3))
    volts[:, joint - 1] = voltage
    simulator.reset(pose)
    return simulator.run(time, volts)


def first_time(time, values, level: float) -> float:
    """When the values first reach the level [s], between samples by a straight line; infinity if they never do."""
    side = np.sign(np.asarray(values) - level)
    k = int(np.argmax(side != side[0]))
    if k == 0:
        return float("inf")
    share = (level - values[k - 1]) / (values[k] - values[k - 1])
    return float(time[k - 1] + share * (time[k] - time[k - 1]))


def crossing_time(simulator: Simulator, joint: int, pose, voltage: float, longest: float) -> float:
    """Time [s] that a constant voltage takes to drive a joint from rest at one end of its range to the other.

    Infinity if it is longer than `longest` [s]. The sign of the voltage tells the direction; `pose` [rad]
    gives the angles of the other joints.
    """
    low, high = simulator.plant.arm.joint_ranges[joint - 1]
    start, end = (low, high) if voltage > 0.0 else (high, low)
    recording = drive(simulator, joint, with_joint(pose, joint, start), voltage, longest)
    return first_time(recording.time, recording.position[:, joint - 1], end)


# ------------------------------------------------------------------------- sections 7.6 to 8: loops under PID

#: the folded arm with q3 as section 7.7.2 prints it; the centre of mass of links 2 and 3 is above the shoulder
#: (thesis: .17 rad)
FOLDED_ARM = (0.0, -np.pi / 2 + 0.1143, -0.9075)
#: of the motors' voltage [V]
LIMIT = 40.0
#: Kg [V/rad], Ti [s], Td [s] of gains or of their estimates
kg_ti_td = attrgetter("gain", "integral_time", "derivative_time")


@dataclass(frozen=True)
class Case:
    """One of the five poses of section 7.7 with what is printed for it: plot, Kmax, Tp."""

    plot: str
    name: str
    joint: int
    pose: tuple[float, float, float]
    printed: Ultimate

    def ultimate(self, plant: Plant, period: float = SERVO_PERIOD, delay: int = 0) -> Ultimate:
        """Kmax and Tp of the corrected model, the joint alone."""
        return ultimate_by_eigenvalues(Loop(plant, self.joint, self.pose, period, delay))


CASES = (
    Case("7.17", "joint 1, arm upright", 1, UPRIGHT, Ultimate(150.0, 0.45)),
    Case("7.18", "joint 1, arm horizontal", 1, HORIZONTAL, Ultimate(220.0, 0.60)),
    Case("7.19", "joint 2, links aligned, upright", 2, UPRIGHT, Ultimate(475.0, 0.40)),
    Case("7.20", "joint 2, arm folded", 2, FOLDED_ARM, Ultimate(385.0, 0.20)),
    Case("7.21", "joint 3, link 2 upright", 3, UPRIGHT, Ultimate(270.0, 0.18)),
)


def case(plot: str) -> Case:
    """The case of a plot."""
    return next(c for c in CASES if c.plot == plot)


def printed_pid(*plots: str) -> tuple[PidGains, ...]:
    """Table 7.2 on the thesis's own Kmax and Tp of some plots."""
    return tuple(settings(case(plot).printed) for plot in plots)


def gains_text(gains: PidGains) -> str:
    """Gains for a person."""
    return f"Kg {gains.gain:.4g} V/rad, Ti {gains.integral_time:.3g} s, Td {gains.derivative_time:.3g} s"


def servo_loop(
    plant: Plant, pose: ArrayLike, joints: Sequence[int], gains: Sequence[PidGains], delay: int = 0
) -> np.ndarray:
    """The map of the linear loop of some joints under PID at 28/30 ms, the others locked."""
    f, g = sampled(*linearised(plant, pose, joints), SERVO_PERIOD)
    return pid_loop(f, g, gains, SERVO_PERIOD, delay)


def damping(plant: Plant, pose: ArrayLike, joint: int, gains: PidGains) -> tuple[float, float]:
    """Damping ratio and period [s] of a joint's least damped oscillation, the others locked."""
    ratio, period = least_damped(servo_loop(plant, pose, (joint,), (gains,)), SERVO_PERIOD)
    return float(ratio), float(period)


def path(
    start: ArrayLike, moves: Sequence[tuple[float, float, Any]], duration: float, period: float = 0.028
) -> np.ndarray:
    """Setpoints (n, 3) [rad], one each `period` [s], that sum up ramps and steps (moves of no length).

    start : (3,) [rad]; moves : (when [s], how long [s], by what (3,) [rad]).
    """
    # at the middle of a period, so that rounding does not move a step by one
    time = (np.arange(int(np.ceil(duration / period - 1e-9))) + 0.5) * period
    added = [Move(when, length, by, "ramp" if length else "step").at(time) for when, length, by in moves]
    return sum(added, np.tile(np.asarray(start, dtype=float), (len(time), 1)))


def run(
    plant: Plant,
    gains: Sequence[PidGains],
    pose: ArrayLike,
    setpoint: ArrayLike,
    alone: int | None = None,
    servo: Mapping[str, Any] = {},
    **how: Any,
) -> Recording:
    """The arm at rest at `pose`, under the servo; `alone`: the one joint that is not locked.

    servo : options of `ServoConfig`; how : of `run_servo`. The derivative is that of the error, as in the thesis.
    """
    simulator = one_joint(plant, alone)
    simulator.reset(pose)
    config = ServoConfig(tuple(gains), **{"derivative_on_measurement": False, **servo})
    return simulator.run_servo(setpoint, config, **how)


def run_moves(
    plant: Plant, controller: Controller, pose: ArrayLike, moves: Sequence[Move], duration: float, alone: int | None
) -> tuple[Recording, np.ndarray]:
    """(recording, path (n, 3) [rad] at its times) of moves under any controller, as `run`."""
    simulator = one_joint(plant, alone)
    simulator.reset(pose)
    _, setpoint = joint_setpoints(pose, moves, duration)
    recording = simulator.run_controller(controller, setpoint[:-1], voltage_limit=LIMIT)
    return recording, joint_path(pose, moves, recording.time)


def tracking(run: Recording, path: np.ndarray) -> dict[str, np.ndarray]:
    """Errors from a path, and volts, (3,) each."""
    error = tracking_error(run, path)
    return {"rms_mrad": 1e3 * error.rms, "worst_mrad": 1e3 * error.worst, "volts_rms": effort(run, LIMIT).rms}
