# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 7.9: joint 1 with the measured and with the estimated PID values, plots 7.25 and 7.26;
and gains that follow the pose."""

from dataclasses import dataclass

import numpy as np

from puma_sim_core.control.controllers import make_controller
from puma_sim_core.control.metrics import step_quality
from puma_sim_core.control.setpoints import Move
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.pid import Pid, PidGains
from puma_sim_core.simulation.simulator import SERVO_PERIOD
from puma_sim_core.thesis.motions import (
    HORIZONTAL,
    LIMIT,
    UPRIGHT,
    Case,
    case,
    damping,
    gains_text,
    kg_ti_td,
    run_moves,
    tracking,
)
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Numbers, Result, Row
from puma_sim_core.thesis.wording import Words
from puma_sim_core.tuning.schedule_design import placed_gains
from puma_sim_core.tuning.ziegler_nichols import settings

words = Words(__name__)
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
PRINTED, OWN = "estimated, as printed", "estimated, corrected model"


@dataclass(frozen=True)
class Pose:
    """A pose of the section, its plot, and the PID values of joint 1 that the thesis measured and
    says that they differ from the estimates by."""

    plot: str
    name: str
    case: Case
    measured: PidGains
    printed_difference: float


POSES = (
    Pose("7.25", "extended, horizontal", case("7.18"), PidGains(137.0, 0.315, 0.032), 35.0),
    Pose("7.26", "vertical", case("7.17"), PidGains(176.0, 0.42, 0.04), 17.0),
)


def gains_of(plant: Plant, pose: Pose) -> dict[str, PidGains]:
    """The constant gains that are compared at a pose."""
    own = pose.case.ultimate(plant)
    return {"measured": pose.measured, PRINTED: settings(pose.case.printed), OWN: settings(own)}


def plot(plant: Plant, pose: Pose, rows: list[Row], numbers: Numbers) -> Figure:
    """The redrawn plot of a pose."""
    gains = gains_of(plant, pose)
    made = {name: Pid([g] * 3, SERVO_PERIOD, limit=LIMIT) for name, g in gains.items()}
    made["scheduled"] = make_controller("scheduled", plant)
    curves: list[Curve] = []
    for name, controller in made.items():
        run, path = run_moves(plant, controller, pose.case.pose, RAMPS, DURATION, 1)
        curves = curves or [Curve("setpoint", run.time, path[:, 0], "steps")]
        curves.append(Curve(name, run.time, run.position[:, 0], "dashed" if name == "scheduled" else "line"))
        found = {key: values[0] for key, values in tracking(run, path).items()}
        rest = (run.time >= FIRST_REST[0]) & (run.time < FIRST_REST[1])
        found["beyond_mrad"] = 1e3 * max((run.position - path)[rest, 0].max(), 0.0)
        numbers |= {f"{pose.plot} {name}: {key}": each for key, each in found.items()}
        if name in gains:
            ratio, _ = damping(plant, pose.case.pose, 1, gains[name])
            numbers[f"{pose.plot} {name}: damping"] = ratio
            rows.append(words.row("gains", gains_text(gains[name]), plot=pose.plot, name=name, damping=ratio))
        rows.append(words.row("error", plot=pose.plot, name=name, found=found))
    measured, estimated = (numbers[f"{pose.plot} {name}: rms_mrad"] for name in ("measured", PRINTED))
    better = words.text("better", case=measured < estimated)
    percent = 100.0 * (max(measured, estimated) / min(measured, estimated) - 1.0)
    rows.append(words.row("better", better, case=pose.plot, plot=pose.plot, percent=percent))
    off = 100.0 * np.abs(np.divide(kg_ti_td(gains[PRINTED]), kg_ti_td(pose.measured)) - 1.0)
    numbers[f"{pose.plot} differences_percent"] = off
    rows.append(words.row("differences", pose=pose, off=off, mean=np.mean(off)))
    return words.figure("tracking", curves, pose=pose)


def descent(plant: Plant, rows: list[Row], numbers: Numbers) -> Figure:
    """Joint 1 steps upright and stretched out: gains fixed for one of the two, and scheduled."""
    made = {}
    for name, pose in {"upright": UPRIGHT, "horizontal": HORIZONTAL}.items():
        gains = [PidGains(*g) for g in placed_gains(plant, np.array(pose), (BANDWIDTH,) * 3).tolist()]
        made[f"fixed, {name}"] = Pid(gains, SERVO_PERIOD, limit=LIMIT, on_measurement=True)
    made["scheduled"] = make_controller("scheduled", plant)
    out, down, back = (move.start for move in DESCENT)
    curves: list[Curve] = []
    for name, controller in made.items():
        run, path = run_moves(plant, controller, UPRIGHT, DESCENT, DESCENT_TIME, None)
        time, q1 = run.time, run.position[:, 0]
        curves = curves or [Curve("setpoint", time, path[:, 0], "steps")]
        curves.append(Curve(name, time, q1))
        between = (time >= down) & (time < back)
        numbers[f"descent {name}: disturbed_mrad"] = 1e3 * np.abs(run.position - path)[between, 0].max()
        found = {
            "upright": step_quality(time[time < down], q1[time < down], 0.0, STEP, at=out),
            "horizontal": step_quality(time, q1, STEP, 0.0, at=back),
        }
        for where, quality in found.items():
            settled = quality.settling_time if np.isfinite(quality.settling_time) else None
            numbers[f"descent {name}: {where} overshoot"] = quality.overshoot
            numbers[f"descent {name}: {where} settling"] = settled
            about = {"name": name, "where": where, "overshoot": 100.0 * quality.overshoot, "settled": settled}
            rows.append(words.row("step", case=settled is not None, **about))
    return words.figure("7.9-schedule", curves, bandwidth=BANDWIDTH)


@words.experiment("7.9")
def run(context: Context) -> Result:
    """Plots 7.25 and 7.26, and the gain-scheduled controller."""
    plant, rows, figures, numbers = Plant.of(), list[Row](), list[Figure](), Numbers()
    for pose in POSES:
        figures.append(plot(plant, pose, rows, numbers))
        context.progress(0.3 * len(figures))
    figures.append(descent(plant, rows, numbers))
    context.progress(1.0)
    rms = {n: np.array([numbers[f"{p.plot} {n}: rms_mrad"] for p in POSES]) for n in ("measured", PRINTED, OWN)}
    ratios = {name: rms["measured"] / rms[name] for name in (PRINTED, OWN)}
    over = {
        name: [100.0 * numbers[f"descent {name}: {where} overshoot"] for where in ("upright", "horizontal")]
        for name in ("fixed, upright", "fixed, horizontal", "scheduled")
    }
    return words.result("7.9", rows, figures, numbers, ratios=ratios, over=over)
