# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Sections 7.7.1 to 7.7.3: one joint under PID at the thesis's five poses, plots 7.17 to 7.21,
and maps over the workspace of what tuning finds and of what one fixed controller then does."""

from __future__ import annotations

import numpy as np

from puma_sim_core.control.linear import least_damped, linearised, pid_loop, radius, sampled
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Heatmap, Result, Row
from puma_sim_core.thesis.tuning import FOLDED_ELBOW, Case, case, gains_text, path, run
from puma_sim_core.tuning.ziegler_nichols import Ultimate, settings, ultimate_map

#: ramp of a second and a step [rad]; the thesis names ramps and steps, the plots' own path is
#: not in its text
RAMP, STEP, DURATION, STEP_AT = 0.5, 0.1, 6.0, 3.0
#: points of the maps
MAP = (27, 29)


def _responses(plant: Plant, c: Case, rows: list, numbers: dict) -> Figure:
    """The redrawn plot of a case, with the thesis's gains and with ours."""
    by = np.eye(3)[c.joint - 1]
    setpoint = path(c.pose, ((0.2, 1.0, RAMP * by), (STEP_AT, 0.0, -STEP * by)), DURATION)
    own = c.ultimate(plant)
    curves, pose = [], c.pose[c.joint - 1]
    for label, key, ultimate in (("thesis's gains", "thesis", c.printed), ("gains of the corrected model", "own", own)):
        gains = settings(ultimate)
        record = run(plant, [gains] * 3, c.pose, setpoint, alone=c.joint)
        moved = record.position[:, c.joint - 1] - pose
        asked = record.setpoint[:, c.joint - 1] - pose
        if not curves:
            curves.append(Curve("setpoint", record.time, asked, "steps"))
        curves.append(Curve(label, record.time, moved, "line" if key == "thesis" else "dashed"))
        over, settle = _step_quality(record.time, moved, asked)
        damping, period = _damping(plant, c, gains)
        rows += [
            Row(f"plot {c.plot}, {label}", "", None, gains_text(gains)),
            Row(
                f"plot {c.plot}, {label}: damping of the least damped oscillation",
                "",
                None,
                damping,
                f"its period is {period:.3f} s",
            ),
            Row(f"plot {c.plot}, {label}: overshoot of the step", "%", None, 100.0 * over),
            Row(f"plot {c.plot}, {label}: settles to 2 % of the step after", "s", None, settle),
        ]
        numbers |= {
            f"{c.plot}_{key}_damping": damping,
            f"{c.plot}_{key}_overshoot": over,
            f"{c.plot}_{key}_settling": settle,
            f"{c.plot}_{key}_rms": float(np.sqrt(np.mean((moved - asked) ** 2))),
        }
    numbers[f"{c.plot}_ultimate"] = [own.gain, own.period]
    return Figure(
        c.plot,
        f"Closed-loop control of {c.name}",
        "time [s]",
        f"joint {c.joint}, from its start [rad]",
        tuple(curves),
        note=f"Thesis: Kmax = {c.printed.gain:g} V/rad, Tp = {c.printed.period:g} s; "
        f"ours: {own.gain:.0f} V/rad, {own.period:.4f} s. The path is ours.",
    )


def _step_quality(time, moved, asked) -> tuple[float, float]:
    """Overshoot as a share of the step, and the time [s] until 2 % of it are not left again."""
    after = time > STEP_AT
    end = asked[-1]
    error = (moved[after] - end) / -STEP
    outside = np.flatnonzero(np.abs(error) > 0.02)
    last = int(outside[-1]) + 1 if outside.size else 0
    clock = time[after] - time[after][0]
    return float(max(error.max(), 0.0)), float(clock[min(last, len(clock) - 1)])


def _damping(plant: Plant, c: Case, gains) -> tuple[float, float]:
    f, g = sampled(*linearised(plant, c.pose, (c.joint,)), SERVO_PERIOD)
    return tuple(float(v) for v in least_damped(pid_loop(f, g, (gains,), SERVO_PERIOD), SERVO_PERIOD))


def _ultimate_rows(plant: Plant, c: Case) -> list[Row]:
    own = c.ultimate(plant)
    note = "Does not reproduce; see 7.6."
    caption = {
        "7.19": " The caption of the plot has Tp = .2.",
        "7.20": " The caption of the plot has Tp = .18.",
        "7.21": " The caption of the plot repeats joint 1's 150 and .45.",
    }.get(c.plot, "")
    return [
        Row(f"Kmax, {c.name}", "V/rad", c.printed.gain, own.gain, note),
        Row(f"Tp, {c.name}", "s", c.printed.period, own.period, note + caption),
    ]


def _workspace(plant: Plant):
    """(q2, q3, poses (n3, n2, 3)) over the joint ranges [rad]."""
    q2, q3 = (np.linspace(*plant.arm.joint_ranges[j], n) for j, n in zip((1, 2), MAP))
    pose = np.zeros((len(q3), len(q2), 3))
    pose[..., 1], pose[..., 2] = q2, q3[:, None]
    return q2, q3, pose


def _map(key, title, q2, q3, values, label, note="") -> Heatmap:
    return Heatmap(key, title, "q2 [deg]", "q3 [deg]", np.degrees(q2), np.degrees(q3), values, label, note)


def _fixed(plant: Plant, joint: int, poses, gains) -> tuple[np.ndarray, np.ndarray]:
    """Damping and greatest eigenvalue over the workspace of one fixed controller."""
    f, g = sampled(*linearised(plant, poses, (joint,)), SERVO_PERIOD)
    loop = pid_loop(f, g, (gains,), SERVO_PERIOD)
    return least_damped(loop, SERVO_PERIOD)[0], radius(loop)


def _maps(plant: Plant, joint: int, cases, rows: list, numbers: dict) -> list[Heatmap]:
    """Kmax, Tp and the damping that the controllers of some cases give elsewhere."""
    q2, q3, poses = _workspace(plant)
    gain, period, _ = ultimate_map(plant, joint, poses, limit=1e5)
    slow, slow_period, _ = ultimate_map(plant, joint, poses, period=0.028, delay=1, limit=1e5)
    for name, values, unit, text in (
        ("gain", gain, "V/rad", "Kmax at 28/30 ms"),
        ("period", period, "s", "Tp at 28/30 ms"),
        ("gain_28ms", slow, "V/rad", "Kmax at 28 ms with one sample of delay"),
        ("period_28ms", slow_period, "s", "Tp at 28 ms with one sample of delay"),
    ):
        low, high = float(values.min()), float(values.max())
        numbers[f"joint_{joint}_{name}_range"] = [low, high]
        rows.append(Row(f"{text}, over the workspace", unit, None, f"{low:.4g} to {high:.4g}"))
    maps = [
        _map(f"7.7.{joint}-gain", f"Kmax of joint {joint} at 28 ms with one sample of delay", q2, q3, slow, "V/rad"),
        _map(
            f"7.7.{joint}-period",
            f"Tp of joint {joint} at 28/30 ms",
            q2,
            q3,
            period,
            "s",
            "At this rate Kmax is nearly the same everywhere; the period follows the square root of the inertia.",
        ),
    ]
    for c in cases:
        gains = settings(c.ultimate(plant))
        damping, greatest = _fixed(plant, joint, poses, gains)
        unstable = float((greatest >= 1.0).mean())
        key = f"7.7.{joint}-fixed-{c.plot}"
        numbers |= {
            f"{key}_damping_range": [float(damping.min()), float(damping.max())],
            f"{key}_unstable_share": unstable,
        }
        rows.append(
            Row(
                f"controller tuned for {c.name}, damping over the workspace",
                "",
                None,
                f"{damping.min():.3f} to {damping.max():.3f}",
                f"unstable at {100.0 * unstable:.0f} % of the poses" if unstable else "stable at all poses",
            )
        )
        maps.append(
            _map(
                key,
                f"Damping with the controller tuned for {c.name}",
                q2,
                q3,
                damping,
                "damping ratio of the least damped oscillation",
                "Below zero the oscillation grows.",
            )
        )
    return maps


@experiment("7.7.1", "PID control of joint 1", chapter="7.7")
def joint_1(context: Context) -> Result:
    """Plots 7.17 and 7.18, and what either controller does over the workspace."""
    plant, rows, numbers, figures = Plant.of(), [], {}, []
    cases = [case("7.17"), case("7.18")]
    for c in cases:
        rows += _ultimate_rows(plant, c)
        figures.append(_responses(plant, c, rows, numbers))
        context.progress(0.3)
    figures += _maps(plant, 1, cases, rows, numbers)
    share = numbers["7.7.1-fixed-7.17_unstable_share"]
    low, high = numbers["7.7.1-fixed-7.18_damping_range"]
    return Result(
        f"One PID cannot serve joint 1: tuned upright, it is unstable at {100.0 * share:.0f} % of "
        f"the poses of the workspace, the outstretched ones. Tuned for the outstretched arm, it is "
        f"stable everywhere and detuned elsewhere (damping {low:.2f} to {high:.2f}), as the thesis "
        "says of its own. With the thesis's gains, twenty to thirty times lower, both plots "
        "settle.",
        tuple(rows),
        tuple(figures),
        numbers,
    )


@experiment("7.7.2", "PID control of joint 2", chapter="7.7")
def joint_2(context: Context) -> Result:
    """Plots 7.19 and 7.20, Kmax along the range of the joint."""
    plant, rows, numbers, figures = Plant.of(), [], {}, []
    cases = [case("7.19"), case("7.20")]
    q2 = np.linspace(*plant.arm.joint_ranges[1], 41)
    curves = []
    for c, elbow in zip(cases, (np.pi / 2, FOLDED_ELBOW)):
        rows += _ultimate_rows(plant, c)
        poses = np.stack([0.0 * q2, q2, np.full_like(q2, elbow)], axis=-1)
        gain, period, least = ultimate_map(plant, 2, poses, limit=1e5)
        hardest = float(np.degrees(q2[np.argmin(gain)]))
        numbers |= {
            f"{c.plot}_gain_range": [gain.min(), gain.max()],
            f"{c.plot}_period_range": [period.min(), period.max()],
            f"{c.plot}_least_gain": float(least.max()),
            f"{c.plot}_hardest": hardest,
        }
        rows += [
            Row(
                f"{c.name}: q2 of the least Kmax",
                "deg",
                "close to the vertical",
                hardest,
                f"But Kmax changes by {1e6 * (gain.max() / gain.min() - 1.0):.2g} millionths "
                "only over the whole range: gravity is a weak spring.",
            ),
            Row(
                f"{c.name}: least gain that holds the arm up",
                "V/rad",
                None,
                float(least.max()),
                "where it stands on end: R |dG2/dq2| / kT",
            ),
        ]
        curves.append(Curve(c.name, np.degrees(q2), gain / gain.max()))
        figures.append(_responses(plant, c, rows, numbers))
        context.progress(0.3)
    figures.append(
        Figure(
            "7.7.2-range", "Kmax along the range of joint 2", "q2 [deg]", "Kmax / its greatest value [-]", tuple(curves)
        )
    )
    figures += _maps(plant, 2, cases, rows, numbers)
    return Result(
        "Joint 2 is easier to serve with one PID than joint 1: its inertia depends on the elbow "
        "alone. The printed fall of Kmax when the arm folds (475 to 385) is not found; folded, the "
        "ultimate gain is the same at 28/30 ms and higher with delay, and the period shorter. The "
        "least Kmax is near the vertical, as the thesis says, by a few millionths.",
        tuple(rows),
        tuple(figures),
        numbers,
    )


@experiment("7.7.3", "PID control of joint 3", chapter="7.7")
def joint_3(context: Context) -> Result:
    """Plot 7.21."""
    plant, rows, numbers = Plant.of(), [], {}
    c = case("7.21")
    rows += _ultimate_rows(plant, c)
    figures = [_responses(plant, c, rows, numbers)]
    q3 = np.linspace(*plant.arm.joint_ranges[2], 41)
    poses = np.stack([0.0 * q3, np.full_like(q3, c.pose[1]), q3], axis=-1)
    gain, period, _ = ultimate_map(plant, 3, poses, limit=1e5)
    numbers |= {"gain_range": [gain.min(), gain.max()], "period_range": [period.min(), period.max()]}
    rows.append(
        Row(
            "Kmax over the range of joint 3, link 2 upright",
            "V/rad",
            None,
            f"{gain.min():.2f} to {gain.max():.2f}",
            "The inertia of joint 3 is constant; only gravity differs.",
        )
    )
    context.progress(0.5)
    figures += _maps(plant, 3, [c], rows, numbers)
    wrong = settings(Ultimate(150.0, 0.45))
    damping, _ = _damping(plant, c, wrong)
    rows.append(
        Row(
            "damping with the gains of the caption (150, .45)",
            "",
            None,
            damping,
            "The caption repeats joint 1's numbers; 270 and .18 of the text are used.",
        )
    )
    numbers["caption_damping"] = damping
    return Result(
        "One PID serves joint 3 over its whole range, since its inertia does not depend on the "
        "pose. The thesis's 270 V/rad and .18 s do not reproduce (4039 V/rad and .036 s).",
        tuple(rows),
        tuple(figures),
        numbers,
    )
