# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 7.2: what the motors can drive, and the thesis's one table of measurements."""

from dataclasses import dataclass, replace
from math import inf, isfinite

import numpy as np
from scipy.optimize import brentq

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.rigid_body import gravity_torque
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.thesis.motions import FOLDED, HORIZONTAL, UPRIGHT, crossing_time, drive, one_joint, with_joint
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Result, Row
from puma_sim_core.thesis.wording import Words

words = Words(__name__)
#: the time allowed that makes the corrected model give the thesis's first number [s]
ALLOWED = 20.0
#: the thesis reads its voltages in steps of half a volt: each may be off by half of that
READING = 0.25
#: constant voltages over many seconds: a step of 4 ms is 1e-6 s from a fine one in crossing times
COARSE = 0.004


@dataclass(frozen=True)
class Minimum:
    """One of tests 1 to 3: the joint, how the others stand, and the two printed voltages [V]."""

    key: str
    name: str
    joint: int
    pose: tuple[float, float, float]
    simulated: float
    measured: float


TESTS = (
    Minimum("joint2_extended", "joint 2, arm extended", 2, HORIZONTAL, 7.5, 8.5),
    Minimum("joint2_folded", "joint 2, forearm folded", 2, (0.0, 0.0, FOLDED), 4.0, 5.0),
    Minimum("joint3", "joint 3, upper arm upright", 3, UPRIGHT, 3.5, 5.5),
)


def greatest_gravity(plant: Plant, test: Minimum) -> float:
    """Greatest gravity torque [N.m] at the test's joint over its range."""
    q = np.tile(test.pose, (20001, 1))
    q[:, test.joint - 1] = np.linspace(*plant.arm.joint_ranges[test.joint - 1], len(q))
    return float(np.abs(gravity_torque(q, plant.arm)[:, test.joint - 1]).max())


def volts_per_torque(plant: Plant, joint: int) -> float:
    """Volts at a motor that stands still for one N.m at its joint, R / (N kt)."""
    return plant.arm.motors[joint - 1].resistance / plant.torque_per_ampere[joint - 1]


def voltage_for_time(plant: Plant, test: Minimum, allowed: float, sign: float = 1.0) -> float:
    """The least constant voltage [V], as a magnitude, that drives the joint over its range within `allowed` [s]."""
    simulator = one_joint(plant, test.joint, COARSE)

    def excess(volts):
        taken = crossing_time(simulator, test.joint, test.pose, sign * volts, allowed + 0.02)
        # short of the end, the voltage alone tells the search where to go
        return min(taken, allowed + 0.02 + 1.0 / volts) - allowed

    return brentq(excess, 0.5, 120.0, xtol=1e-3)


def _plot(plant: Plant, plot: str, test: Minimum, volts) -> Figure:
    """Plot 7.1 or 7.2: a stop at each end of the range, so that the curves end there."""
    stopped = replace(plant, effects=(parse_effect(f"soft_stop:joint={test.joint}"),))
    simulator, j = one_joint(stopped, test.joint), test.joint - 1
    low, high = plant.arm.joint_ranges[j]
    curves = []
    for v in (*volts, *(-v for v in volts if v)):
        start, style = (low, "line") if v >= 0 else (high, "dashed")
        r = drive(simulator, test.joint, with_joint(test.pose, test.joint, start), float(v), 12.0)
        curves.append(Curve(f"{v} V", r.time, r.position[:, j], style))
    return words.figure("motion", curves, plot=plot, joint=test.joint)


def _all_voltages(plant: Plant) -> dict[str, list]:
    """Crossing times of every joint for -40 to 40 V in steps of 5 V; None: not within 60 s."""
    numbers: dict[str, list] = {"voltages_V": [float(v) for v in range(-40, 45, 5)]}
    for joint, pose in ((1, UPRIGHT), (2, TESTS[0].pose), (3, TESTS[2].pose)):
        simulator = one_joint(plant, joint, COARSE)
        times = [crossing_time(simulator, joint, pose, v, 60.0) if v else inf for v in numbers["voltages_V"]]
        numbers[f"crossing_time_joint{joint}_s"] = [t if isfinite(t) else None for t in times]
    return numbers


def steady_speed(plant: Plant, joint: int, volts: float) -> float:
    """Speed [rad/s] of a joint that settled at a voltage without load, by simulation."""
    weightless = Plant(replace(plant.arm, gravity=0.0))
    pose = with_joint(UPRIGHT, joint, 0.0)
    return float(drive(one_joint(weightless, joint), joint, pose, volts, 1.0).velocity[-1, joint - 1])


def _model_rows(plant: Plant, needed) -> list[Row]:
    rows = [words.row("speed", steady_speed(plant, joint, 40.0), joint=joint) for joint in (1, 2, 3)]
    for test, volts in zip(TESTS, needed):
        torque = greatest_gravity(plant, test)
        static = torque * volts_per_torque(plant, test.joint)
        taken = crossing_time(one_joint(plant, test.joint, COARSE), test.joint, test.pose, test.simulated, 60.0)
        near = abs(volts - test.simulated) < 0.25
        rows += [
            words.row("static", static, test=test, torque=torque),
            words.row("within", volts, case=near, test=test, allowed=ALLOWED, volts=volts),
            words.row("taken", taken, case=taken < 30.0, test=test),
        ]
    return rows


def _speed(plant: Plant, joint: int) -> float:
    """Mean speed [rad/s] that crosses the range of a joint in the time allowed."""
    low, high = plant.arm.joint_ranges[joint - 1]
    return (high - low) / ALLOWED


def _residual_rows(plant: Plant, needed) -> tuple[list[Row], dict]:
    """The measured table turned into torque, and each possible cause held against it."""
    other = load_parameters("corke_armstrong_1994")
    rows, residual, numbers = [], [], {}
    for test, volts in zip(TESTS, needed):
        per_torque, difference = volts_per_torque(plant, test.joint), test.measured - test.simulated
        friction = tuple(e for e in map(parse_effect, other.suggested_effects) if e.joint == test.joint)
        known = {name: value for effect in friction for name, value in effect.values.items()}
        speed, rubbed = _speed(plant, test.joint), Plant(plant.arm, friction)
        clean = (volts, voltage_for_time(plant, test, ALLOWED, -1.0))
        added = [voltage_for_time(rubbed, test, ALLOWED, s) - v for s, v in zip((1.0, -1.0), clean)]
        residual.append(difference / per_torque)
        of, reading = {"test": test, "difference": difference}, 2 * READING / per_torque
        rows += [
            words.row("residual_torque", residual[-1], reading=reading, **of),
            words.row("known_friction", joint=test.joint, known=known, drag=known["coefficient"] * speed, speed=speed),
            words.row("added_voltage", max(added), added=added, **of),
        ]
        numbers[f"residual_torque_{test.key}_Nm"] = residual[-1]
        numbers[f"voltage_of_known_friction_{test.key}_V"] = added
    return rows + _causes(plant, needed, np.array(residual)), numbers


def _causes(plant: Plant, needed, residual: np.ndarray) -> list[Row]:
    arm = plant.arm
    gravity = np.array([greatest_gravity(plant, test) for test in TESTS])
    links = [replace(link, gyration_squared=tuple(2.0 * k for k in link.gyration_squared)) for link in arm.links]
    motors = [replace(motor, inertia=2.0 * motor.inertia) for motor in arm.motors]
    doubled = Plant(replace(arm, links=tuple(links), motors=tuple(motors)))
    inertial = max(abs(voltage_for_time(doubled, test, ALLOWED) - volts) for test, volts in zip(TESTS, needed))
    # a mass at the wrist that would explain joint 3, and what joint 2 would feel of it
    mass = float(residual[2] / (arm.gravity * arm.d4))
    loaded = Plant(Plant(arm, (parse_effect(f"payload:mass={mass!r}"),)).loaded_arm)
    felt = [greatest_gravity(loaded, test) - torque for test, torque in zip(TESTS[:2], gravity)]
    gains = ", ".join(
        f"{t.measured / t.simulated:.2f} ({(t.measured - READING) / (t.simulated + READING):.2f} to "
        f"{(t.measured + READING) / (t.simulated - READING):.2f})"
        for t in TESTS
    )
    viscous = residual / [_speed(plant, test.joint) for test in TESTS]
    return [
        words.row("inertial", inertial),
        words.row("weight", extra=100 * residual / gravity),
        words.row("payload", residual=residual, felt=felt, mass=mass),
        words.row("gain", gains),
        words.row("viscous", needed=viscous, allowed=ALLOWED),
        words.row("dry", residual=residual),
        words.row("printed_form", gravity[0] * volts_per_torque(Plant(arm, torque_form="printed"), 2)),
    ]


def _time_figure(plant: Plant) -> Figure:
    curves = []
    for test in TESTS:
        simulator = one_joint(plant, test.joint, COARSE)
        static = greatest_gravity(plant, test) * volts_per_torque(plant, test.joint)
        volts = np.unique(np.concatenate([static * np.geomspace(1.02, 3.0, 22), np.linspace(3.0 * static, 40.0, 12)]))
        times = np.array([crossing_time(simulator, test.joint, test.pose, v, 90.0) for v in volts])
        seen = np.isfinite(times)
        curves += [
            Curve(test.name, times[seen], volts[seen]),
            Curve(f"{test.name}: printed, simulated", times[seen][[0, -1]], np.full(2, test.simulated), "dashed"),
        ]
    return words.figure("7.2-time", curves)


@words.experiment("7.2")
def run(context: Context) -> Result:
    """Tests 1 to 5 and what the measured voltages say."""
    plant = Plant.of()
    needed = [voltage_for_time(plant, test, ALLOWED) for test in TESTS]
    context.progress(0.1)
    numbers = _all_voltages(plant)
    # 5 to 40 V beside -5 to -40 V
    times = [numbers[f"crossing_time_joint{joint}_s"] for joint in (2, 3)]
    ratios = [there / back for each in times for there, back in zip(each[9:], each[7::-1]) if there and back]
    symmetry = 100.0 * max(abs(ratio - 1.0) for ratio in ratios)
    rows = [*_model_rows(plant, needed), words.row("symmetry", symmetry)]
    context.progress(0.4)
    residual, torques = _residual_rows(plant, needed)
    context.progress(0.6)
    figures = [_plot(plant, "7.1", TESTS[0], range(5, 45, 5)), _plot(plant, "7.2", TESTS[2], range(0, 45, 5))]
    context.progress(0.8)
    figures.append(_time_figure(plant))
    context.progress(1.0)
    return words.result("7.2", rows + residual, figures, numbers | torques)
