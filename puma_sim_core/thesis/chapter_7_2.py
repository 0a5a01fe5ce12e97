# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Section 7.2: what the motors can drive, and the thesis's one table of measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isfinite

import numpy as np
from scipy.optimize import brentq

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.rigid_body import gravity_torque
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.thesis.motions import FOLDED, STRETCHED, UPRIGHT, crossing_time, drive, one_joint, with_joint
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Result, Row

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
    Minimum("joint2_extended", "joint 2, arm extended", 2, (0.0, 0.0, STRETCHED), 7.5, 8.5),
    Minimum("joint2_folded", "joint 2, forearm folded", 2, (0.0, 0.0, FOLDED), 4.0, 5.0),
    Minimum("joint3", "joint 3, upper arm upright", 3, UPRIGHT, 3.5, 5.5),
)


def greatest_gravity(plant: Plant, test: Minimum) -> float:
    """Greatest gravity torque [N.m] at the test's joint over its range."""
    low, high = plant.arm.joint_ranges[test.joint - 1]
    q = np.tile(test.pose, (20001, 1))
    q[:, test.joint - 1] = np.linspace(low, high, len(q))
    return float(np.abs(gravity_torque(q, plant.arm)[:, test.joint - 1]).max())


def volts_per_torque(plant: Plant, joint: int) -> float:
    """Volts at a motor that stands still for one N.m at its joint, R / (N kt)."""
    return plant.arm.motors[joint - 1].resistance / plant.torque_per_ampere[joint - 1]


def voltage_for_time(plant: Plant, test: Minimum, allowed: float, sign: float = 1.0) -> float:
    """The least constant voltage [V], as a magnitude, that drives the joint from one end of its
    range to the other within `allowed` [s]."""
    simulator = one_joint(plant, test.joint, COARSE)

    def excess(volts):
        taken = crossing_time(simulator, test.joint, test.pose, sign * volts, allowed + 0.02)
        # short of the end, the voltage alone tells the search where to go
        return min(taken, allowed + 0.02 + 1.0 / volts) - allowed

    return brentq(excess, 0.5, 120.0, xtol=1e-3)


def friction_of(arm, joint: int) -> dict[str, float]:
    """Viscous coefficient and Coulomb levels that the arm's source gives for a joint."""
    found = {"positive": 0.0, "negative": 0.0, "coefficient": 0.0}
    for effect in map(parse_effect, arm.suggested_effects):
        if effect.joint == joint:
            found.update(effect.values)
    return found


def _plots(plant: Plant) -> tuple[Figure, Figure]:
    """Plots 7.1 and 7.2: a stop at each end of the range, so that the curves end there."""
    figures = []
    for key, test, volts in (("7.1", TESTS[0], range(5, 45, 5)), ("7.2", TESTS[2], range(0, 45, 5))):
        stopped = replace(plant, effects=(parse_effect(f"soft_stop:joint={test.joint}"),))
        simulator = one_joint(stopped, test.joint)
        low, high = plant.arm.joint_ranges[test.joint - 1]
        curves = []
        for sign, start, style in ((1, low, "line"), (-1, high, "dashed")):
            for v in volts:
                if v == 0 and sign < 0:
                    continue
                r = drive(simulator, test.joint, with_joint(test.pose, test.joint, start), float(sign * v), 12.0)
                curves.append(Curve(f"{sign * v} V", r.time, r.position[:, test.joint - 1], style))
        figures.append(
            Figure(
                key,
                f"Simulated motion of joint {test.joint} with constant input voltages",
                "time [s]",
                f"q{test.joint} [rad]",
                tuple(curves),
                "The other joints are locked. Dashed: negative voltages, from the other end of the "
                "range. The range ends at stops.",
            )
        )
    return tuple(figures)


def _all_voltages(plant: Plant) -> dict[str, list]:
    """Crossing times of every joint for -40 to 40 V in steps of 5 V; None: not within 60 s."""
    numbers = {"voltages_V": [float(v) for v in range(-40, 45, 5)]}
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


def _model_rows(plant: Plant, needed, tick) -> list[Row]:
    rows = []
    for joint in (1, 2, 3):
        rows.append(
            Row(f"speed of joint {joint} at 40 V, gravity apart", "rad/s", None, steady_speed(plant, joint, 40.0))
        )
    for test, volts in zip(TESTS, needed):
        least = greatest_gravity(plant, test)
        static = least * volts_per_torque(plant, test.joint)
        taken = crossing_time(one_joint(plant, test.joint, COARSE), test.joint, test.pose, test.simulated, 60.0)
        rows += [
            Row(
                f"least static voltage, {test.name}",
                "V",
                test.simulated,
                static,
                f"Below it the motor cannot hold {least:.2f} N.m. The printed voltage is higher "
                "because a motor that only just holds the load takes for ever; the thesis does "
                "not say how long its joints were allowed.",
            ),
            Row(
                f"least voltage within {ALLOWED:g} s, {test.name}",
                "V",
                test.simulated,
                volts,
                "Agrees with the print if some 20 s were allowed."
                if abs(volts - test.simulated) < 0.25
                else f"Does not reproduce: with the {ALLOWED:g} s that fit the two other tests "
                f"(the third within 0.2 V) the folded arm needs {volts:.2f} V, not 4 V.",
            ),
            Row(
                f"time that {test.simulated:g} V take, {test.name}",
                "s",
                None,
                taken,
                ""
                if taken < 30.0
                else "Not the 20 to 21 s of the two other tests: no single "
                "time allowed gives all three printed voltages.",
            ),
        ]
        tick()
    return rows


def _symmetry_row(plant: Plant) -> Row:
    worst = 0.0
    for test in (TESTS[0], TESTS[2]):
        simulator = one_joint(plant, test.joint, COARSE)
        for v in range(5, 45, 5):
            there, back = (crossing_time(simulator, test.joint, test.pose, s * v, 60.0) for s in (1.0, -1.0))
            if isfinite(there) and isfinite(back):
                worst = max(worst, abs(there / back - 1.0))
    return Row(
        "difference between the crossing times for +V and -V",
        "%",
        "symmetrically identical",
        100.0 * worst,
        "Nearly so, not identically: the centres of mass lie a little beside the lines "
        "from joint to joint (y2, x3 + a3).",
    )


def _residual_rows(plant: Plant, needed, numbers: dict) -> list[Row]:
    """The measured table turned into torque, and each possible cause held against it."""
    other = load_parameters("corke_armstrong_1994")
    rows, residual, gravity = [], [], []
    for test, volts in zip(TESTS, needed):
        per_torque = volts_per_torque(plant, test.joint)
        torque = (test.measured - test.simulated) / per_torque
        known = friction_of(other, test.joint)
        low, high = plant.arm.joint_ranges[test.joint - 1]
        speed = (high - low) / ALLOWED
        drag = known["coefficient"] * speed
        residual.append(torque)
        gravity.append(greatest_gravity(plant, test))
        rows += [
            Row(
                f"residual torque, {test.name}",
                "N.m",
                f"{test.measured - test.simulated:g} V",
                torque,
                f"(measured - simulated) N kt / R; both voltages are read to half a volt, so that "
                f"the torque is good to +-{2 * READING / per_torque:.1f} N.m at worst.",
            ),
            Row(
                f"friction that others measured, joint {test.joint}",
                "N.m",
                None,
                f"{known['negative']:g} to {known['positive']:g} dry, and {drag:.2f} viscous",
                f"Corke and Armstrong-Helouvry (1994), another arm; viscous at {speed:.2f} rad/s.",
            ),
        ]
        with_friction = Plant(
            plant.arm, tuple(e for e in map(parse_effect, other.suggested_effects) if e.joint == test.joint)
        )
        moved = [voltage_for_time(with_friction, test, ALLOWED, s) for s in (1.0, -1.0)]
        clean = [volts, voltage_for_time(plant, test, ALLOWED, -1.0)]
        added = [a - b for a, b in zip(moved, clean)]
        rows.append(
            Row(
                f"voltage that this friction adds, {test.name}",
                "V",
                test.measured - test.simulated,
                max(added),
                f"{added[0]:.2f} V towards positive angles, {added[1]:.2f} V back.",
            )
        )
        numbers[f"residual_torque_{test.key}_Nm"] = torque
        numbers[f"voltage_of_known_friction_{test.key}_V"] = added
    rows += _causes(plant, needed, residual, gravity)
    return rows


def _causes(plant: Plant, needed, residual, gravity) -> list[Row]:
    heavy = Plant(
        replace(
            plant.arm,
            links=tuple(
                replace(link, gyration_squared=tuple(2.0 * k for k in link.gyration_squared))
                for link in plant.arm.links
            ),
            motors=tuple(replace(m, inertia=2.0 * m.inertia) for m in plant.arm.motors),
        )
    )
    inertial = max(abs(voltage_for_time(heavy, test, ALLOWED) - volts) for test, volts in zip(TESTS, needed))
    gains = [(t.measured - READING, t.measured + READING, t.simulated - READING, t.simulated + READING) for t in TESTS]
    gain_text = ", ".join(
        f"{t.measured / t.simulated:.2f} ({a / d:.2f} to {b / c:.2f})" for t, (a, b, c, d) in zip(TESTS, gains)
    )
    # a mass at the wrist that would explain joint 3, and what joint 2 would feel of it
    g, reach = plant.arm.gravity, plant.arm.d4
    mass = residual[2] / (g * reach)
    loaded = Plant(plant.arm, (parse_effect(f"payload:mass={mass!r}"),))
    felt = [greatest_gravity(Plant(loaded.loaded_arm), t) - w for t, w in zip(TESTS[:2], gravity)]
    speeds = [(hi - lo) / ALLOWED for lo, hi in (plant.arm.joint_ranges[t.joint - 1] for t in TESTS)]
    viscous = [tau / w for tau, w in zip(residual, speeds)]
    printed = Plant(plant.arm, torque_form="printed")
    return [
        Row(
            "cause: incorrect moments of inertia (all doubled)",
            "V",
            "link inertias",
            inertial,
            "Ruled out: the motion is so slow that doubling every radius of gyration squared and "
            "every motor inertia moves no voltage by more than this.",
        ),
        Row(
            "cause: incorrect weight of the links; extra gravity torque needed",
            "%",
            "link inertias",
            ", ".join(f"{100 * t / w:.0f}" for t, w in zip(residual, gravity)),
            "Not one factor. For joint 2 alone the half-volt readings leave room for one; link 3 "
            "would have to weigh 2.7 times as much.",
        ),
        Row(
            "cause: weight at the wrist that explains joint 3; residual of joint 2 from it",
            "N.m",
            f"{residual[0]:.1f} and {residual[1]:.1f} (measured)",
            f"{felt[0]:.1f} extended, {felt[1]:.1f} folded",
            f"Ruled out: {mass:.1f} kg would show twice over in joint 2 extended, and hardly when "
            "folded; the readings leave +-8.8 N.m.",
        ),
        Row(
            "cause: gain of amplifier or motor; measured over simulated",
            "1",
            None,
            gain_text,
            "One gain for all is ruled out, the intervals of reading do not meet; for joint 2 "
            "alone a gain of 1.12 to 1.21 is not.",
        ),
        Row(
            "cause: viscous friction alone; coefficient needed",
            "N.m.s/rad",
            "friction forces",
            ", ".join(f"{h:.0f}" for h in viscous),
            f"If {ALLOWED:g} s were allowed; 8 to 18 times what others measured "
            "(9.50 at joint 2, 3.98 at joint 3). The time is not printed, so this is unlikely "
            "rather than impossible.",
        ),
        Row(
            "cause: dry friction; level needed",
            "N.m",
            "friction forces",
            ", ".join(f"{t:.1f}" for t in residual),
            "What the table points to: it adds the same voltage whatever the load and whatever "
            "the time allowed, and extended and folded give the same. At joint 2 it agrees with "
            "the friction that others measured; at joint 3 it is 2.5 to 3 times theirs, which the "
            "readings do not cover: that joint of that arm was tighter, or the minimum was judged "
            "otherwise there.",
        ),
        Row(
            "least static voltage of joint 2 with F = kt i as printed",
            "V",
            7.5,
            gravity[0] * volts_per_torque(printed, 2),
            "Equation 5.2 as printed cannot have made this table: no voltage within +-40 V would "
            "lift the arm. The thesis's simulator had the gear ratio here.",
        ),
    ]


def _time_figure(plant: Plant, tick) -> Figure:
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
        tick()
    return Figure(
        "7.2-time",
        "Voltage that drives a joint through its range in a given time",
        "time allowed [s]",
        "constant voltage [V]",
        tuple(curves),
        "The thesis prints one voltage each and no time. Extended joint 2 and joint 3 "
        "meet their printed voltages at 20 to 21 s, folded joint 2 at twice that.",
        log_x=True,
        log_y=True,
    )


@experiment("7.2", "Motor output torque tests", chapter="7.2")
def run(context: Context) -> Result:
    """Tests 1 to 5 and what the measured voltages say."""
    plant = Plant.of()
    done = 0

    def tick():
        nonlocal done
        done += 1
        context.progress(min(1.0, done / 12.0))

    needed = [voltage_for_time(plant, test, ALLOWED) for test in TESTS]
    tick()
    rows = _model_rows(plant, needed, tick)
    numbers = _all_voltages(plant)
    tick()
    rows.append(_symmetry_row(plant))
    tick()
    rows += _residual_rows(plant, needed, numbers)
    tick()
    figures = (*_plots(plant), _time_figure(plant, tick))
    context.progress(1.0)
    return Result(
        "The motors drive every joint through its range. The printed simulated voltages are not "
        "the least static ones: two of the three belong to a crossing of some 20 s, the third "
        "(joint 2 folded) to one of more than 40 s. The measured voltages exceed the simulated "
        "ones by 17.6, 17.6 and 17.5 N.m at the joints. A torque that does not depend on the load "
        "is dry friction; moments of inertia and a common gain are ruled out, and so is the "
        "weight of the forearm. At joint 2 the size agrees with friction measured by others, at "
        "joint 3 it is about three times as great.",
        tuple(rows),
        figures,
        numbers,
    )
