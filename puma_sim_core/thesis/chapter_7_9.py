# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Section 7.9: joint 1 with the measured and with the estimated PID values, plots 7.25 and 7.26;
and gains that follow the pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from puma_sim_core.control.controllers import make_controller
from puma_sim_core.control.linear import least_damped, linearised, pid_loop, sampled
from puma_sim_core.control.metrics import effort, step_quality, tracking_error
from puma_sim_core.control.setpoints import Move, joint_path, joint_setpoints
from puma_sim_core.dynamics.pid import Pid, PidGains
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Constraint, Simulator
from puma_sim_core.thesis.motions import HORIZONTAL, UPRIGHT
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Result, Row
from puma_sim_core.thesis.tuning import case, gains_text
from puma_sim_core.tuning.schedule_design import placed_gains
from puma_sim_core.tuning.ziegler_nichols import settings

LIMIT = 40.0
#: the plots' own path is not in the text: a ramp out, a rest, a ramp back, for joint 1
RAMPS = (Move(0.28, 1.0, (0.5, 0.0, 0.0), "ramp"), Move(2.52, 1.0, (-0.5, 0.0, 0.0), "ramp"))
DURATION = 5.04
#: by what joint 1 runs on where a ramp ends is looked for from here on [s]
FIRST_REST = (1.28, 2.52)
#: bandwidth of the scheduled gains, as in config/controllers.yaml [rad/s]
BANDWIDTH = 40.0
#: joint 1 steps while the arm is upright and when it has come down
STEP = 0.1
DESCENT = (
    Move(0.28, 0.0, (STEP, 0.0, 0.0), "step"),
    Move(1.12, 1.68, (0.0, 0.5 * np.pi, 0.0), "quintic"),
    Move(3.36, 0.0, (-STEP, 0.0, 0.0), "step"),
)
DESCENT_TIME = 4.48


@dataclass(frozen=True)
class Pose:
    """A pose of the section, its plot, and the PID values of joint 1 that the thesis measured and
    says that they differ from the estimates by."""

    plot: str
    name: str
    angles: tuple[float, float, float]
    tuned_at: str
    measured: PidGains
    printed_difference: float


POSES = (
    Pose("7.25", "extended, horizontal", HORIZONTAL, "7.18", PidGains(137.0, 0.315, 0.032), 35.0),
    Pose("7.26", "vertical", UPRIGHT, "7.17", PidGains(176.0, 0.42, 0.04), 17.0),
)


def gains_of(plant: Plant, pose: Pose) -> dict[str, PidGains]:
    """The constant gains that are compared at a pose."""
    tuned = case(pose.tuned_at)
    return {
        "measured": pose.measured,
        "estimated, as printed": settings(tuned.printed),
        "estimated, corrected model": settings(tuned.ultimate(plant)),
    }


def run_path(plant: Plant, controller, pose, moves, duration, alone: bool = True):
    """(recording, path) of the arm at rest at a pose; alone : joints 2 and 3 are locked."""
    held = Constraint("hold") if alone else Constraint()
    simulator = Simulator(plant, constraints=(Constraint(), held, held))
    simulator.reset(pose)
    _, setpoint = joint_setpoints(pose, moves, duration)
    run = simulator.run_controller(controller, setpoint[:-1], voltage_limit=LIMIT)
    return run, joint_path(pose, moves, run.time)


def damping(plant: Plant, pose, gains: PidGains) -> float:
    """Damping ratio of joint 1's least damped oscillation, the others locked."""
    loop = pid_loop(*sampled(*linearised(plant, pose, (1,)), SERVO_PERIOD), (gains,), SERVO_PERIOD)
    return float(least_damped(loop, SERVO_PERIOD)[0])


def path_numbers(run, path) -> dict[str, float]:
    """Errors of joint 1 on the ramps, and by how much it runs on at the end of the first."""
    error, used = tracking_error(run, path), effort(run, LIMIT)
    rest = (run.time >= FIRST_REST[0]) & (run.time < FIRST_REST[1])
    beyond = (run.position - path)[rest, 0].max()
    return {
        "rms_mrad": 1e3 * error.rms[0],
        "worst_mrad": 1e3 * error.worst[0],
        "beyond_mrad": 1e3 * max(beyond, 0.0),
        "volts_rms": used.rms[0],
    }


def path_rows(label: str, found: dict) -> Row:
    """Errors of a controller at a pose."""
    return Row(
        label,
        "mrad; mrad; mrad",
        None,
        f"rms {found['rms_mrad']:.3g}; worst {found['worst_mrad']:.3g}; runs on by {found['beyond_mrad']:.3g}",
    )


def tracking(plant: Plant, pose: Pose, rows: list, numbers: dict) -> Figure:
    """The redrawn plot of a pose."""
    gains = gains_of(plant, pose)
    made = {name: Pid([g] * 3, SERVO_PERIOD, limit=LIMIT) for name, g in gains.items()}
    made["scheduled"] = make_controller("scheduled", plant)
    curves = []
    for name, controller in made.items():
        run, path = run_path(plant, controller, pose.angles, RAMPS, DURATION)
        found = path_numbers(run, path)
        if not curves:
            curves.append(Curve("setpoint", run.time, path[:, 0], "steps"))
        curves.append(Curve(name, run.time, run.position[:, 0], "dashed" if name == "scheduled" else "line"))
        numbers |= {f"{pose.plot} {name}: {key}": value for key, value in found.items()}
        if name in gains:
            ratio = damping(plant, pose.angles, gains[name])
            numbers[f"{pose.plot} {name}: damping"] = ratio
            rows.append(
                Row(
                    f"plot {pose.plot}, {name}",
                    "",
                    None,
                    gains_text(gains[name]),
                    f"Damping of the least damped oscillation: {ratio:.3g}.",
                )
            )
        rows.append(path_rows(f"plot {pose.plot}, {name}: error", found))
    rows.append(_comparison(pose, numbers))
    rows += _differences(pose, gains, numbers)
    return Figure(
        pose.plot,
        f"Joint 1 on a path, arm {pose.name}",
        "time [s]",
        "joint 1 [rad]",
        tuple(curves),
        note="The path is ours: ramps of 0.5 rad in a second; the plot's own is not in the text.",
    )


def _comparison(pose: Pose, numbers: dict) -> Row:
    measured, estimated = (numbers[f"{pose.plot} {name}: rms_mrad"] for name in ("measured", "estimated, as printed"))
    printed = "the measured is more accurate" if pose.plot == "7.25" else "difficult to determine which is better"
    ours = "the measured" if measured < estimated else "the estimated"
    worse = max(measured, estimated) / min(measured, estimated)
    return Row(
        f"plot {pose.plot}: measured against estimated, as printed",
        "",
        printed,
        f"{ours} is more accurate",
        f"The rms error of the other is {100.0 * (worse - 1.0):.0f} % greater.",
    )


def _differences(pose: Pose, gains, numbers: dict) -> list[Row]:
    estimated = gains["estimated, as printed"]
    percent = [
        100.0 * abs(getattr(estimated, name) / getattr(pose.measured, name) - 1.0)
        for name in ("gain", "integral_time", "derivative_time")
    ]
    numbers[f"{pose.plot} differences_percent"] = percent
    return [
        Row(
            f"estimated from measured values, {pose.name}",
            "%",
            pose.printed_difference,
            f"Kg {percent[0]:.0f}, Ti {percent[1]:.0f}, Td {percent[2]:.0f}",
            "Chapter 7 does not say of which parameter; the printed values give these: "
            f"no one of them, nor their mean ({np.mean(percent):.0f} %), is the printed number.",
        )
    ]


def descent(plant: Plant, rows: list, numbers: dict) -> Figure:
    """Joint 1 steps upright and stretched out: gains fixed for one of the two, and scheduled."""

    def fixed(pose):
        placed = placed_gains(plant, np.array(pose), (BANDWIDTH,) * 3).tolist()
        return Pid([PidGains(*g) for g in placed], SERVO_PERIOD, limit=LIMIT, on_measurement=True)

    made = {
        "fixed, upright": fixed(UPRIGHT),
        "fixed, horizontal": fixed(HORIZONTAL),
        "scheduled": make_controller("scheduled", plant),
    }
    curves = []
    for name, controller in made.items():
        run, path = run_path(plant, controller, UPRIGHT, DESCENT, DESCENT_TIME, alone=False)
        if not curves:
            curves.append(Curve("setpoint", run.time, path[:, 0], "steps"))
        curves.append(Curve(name, run.time, run.position[:, 0]))
        first = run.time < DESCENT[1].start
        q1 = run.position[:, 0]
        found = (
            step_quality(run.time[first], q1[first], 0.0, STEP, at=DESCENT[0].start),
            step_quality(run.time, q1, STEP, 0.0, at=DESCENT[2].start),
        )
        between = (run.time >= DESCENT[1].start) & (run.time < DESCENT[2].start)
        disturbed = 1e3 * np.abs(run.position - path)[between, 0].max()
        numbers |= {f"descent {name}: disturbed_mrad": disturbed}
        for where, quality in zip(("upright", "horizontal"), found):
            settled = quality.settling_time
            numbers |= {
                f"descent {name}: {where} overshoot": quality.overshoot,
                f"descent {name}: {where} settling": settled if np.isfinite(settled) else None,
            }
            words = f"{settled:.3g} s" if np.isfinite(settled) else "not within the record"
            rows.append(
                Row(
                    f"gains {name}: step of joint 1, {where}",
                    "%; s",
                    None,
                    f"overshoot {100.0 * quality.overshoot:.3g}; settled {words}",
                )
            )
    return Figure(
        "7.9-schedule",
        "Joint 1 steps upright, the arm comes down, it steps back",
        "time [s]",
        "joint 1 [rad]",
        tuple(curves),
        note=f"All gains by the same rule: three poles at -{BANDWIDTH:g} rad/s at the "
        "pose that they are made for. All joints are free.",
    )


@experiment("7.9", "Control with measured PID values, and gain scheduling", chapter="7.9")
def run(context: Context) -> Result:
    """Plots 7.25 and 7.26, and the gain-scheduled controller."""
    plant, rows, numbers, drawn = Plant.of(), [], {}, []
    for pose in POSES:
        drawn.append(tracking(plant, pose, rows, numbers))
        context.progress(0.3 * len(drawn))
    drawn.append(descent(plant, rows, numbers))
    context.progress(1.0)

    def ratio(plot, name):
        return numbers[f"{plot} measured: rms_mrad"] / numbers[f"{plot} {name}: rms_mrad"]

    over = {
        name: [100.0 * numbers[f"descent {name}: {where} overshoot"] for where in ("upright", "horizontal")]
        for name in ("fixed, upright", "fixed, horizontal", "scheduled")
    }
    return Result(
        f"With the measured values the rms error is {ratio('7.25', 'estimated, as printed'):.2f} "
        "times that with the printed estimates when the arm is extended, and "
        f"{ratio('7.26', 'estimated, as printed'):.2f} times when it is vertical. Gains from the "
        "ultimate gains of the corrected model are some twenty times greater and make both errors "
        f"much smaller ({ratio('7.25', 'estimated, corrected model'):.0f} and "
        f"{ratio('7.26', 'estimated, corrected model'):.0f} times). With gains fixed for the "
        f"upright arm a step of joint 1 overshoots by {over['fixed, upright'][0]:.1f} % there and "
        f"by {over['fixed, upright'][1]:.1f} % stretched out; fixed for the stretched arm, by "
        f"{over['fixed, horizontal'][0]:.1f} and {over['fixed, horizontal'][1]:.1f} %; scheduled, "
        f"by {over['scheduled'][0]:.1f} and {over['scheduled'][1]:.1f} %.",
        tuple(rows),
        tuple(drawn),
        numbers,
    )
