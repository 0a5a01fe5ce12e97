# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Sections 6.1 and 6.2.1: constrained joints, how they are locked, and the run time."""

from __future__ import annotations

import itertools
import math
import time

import numpy as np

from puma_sim_core.arm.rigid_body import coriolis, inertia
from puma_sim_core.arm.third_order import jerk, joint_torque_per_ampere
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Constraint, Simulator
from puma_sim_core.thesis.misprints.chapter_6 import locked_inertias
from puma_sim_core.thesis.misprints.reference import nominal
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Result, Row

_POSES = {"upright": (0.0, -math.pi / 2, math.pi / 2), "horizontal": (0.0, 0.0, math.pi / 2), "q = 0": (0.0, 0.0, 0.0)}
_MICROVAX_SECONDS = 540.0
_KINDS = ("free", "hold", "velocity:0.4", "acceleration:0.7")


@experiment("6.1", "Constraints on the joints, all combinations", chapter="6")
def constraints(context: Context) -> Result:
    """Run the 64 combinations of section 6.1 and draw its example, a Coriolis torque."""
    plant = Plant.of("bejczy")
    at = SERVO_PERIOD * np.arange(201)
    volts = np.tile((20.0, -15.0, 10.0), (len(at), 1))
    worst, combinations = 0.0, list(itertools.product(_KINDS, repeat=3))
    start = np.array([0.1, -0.4, 0.7])
    for done, kinds in enumerate(combinations):
        simulator = Simulator(plant, constraints=[Constraint.parse(kind) for kind in kinds])
        simulator.reset(start)
        run = simulator.run(at, volts)
        for j, kind in enumerate(kinds):
            expected = {
                "free": run.position[:, j],
                "hold": np.full(len(at), start[j]),
                "velocity:0.4": start[j] + 0.4 * at,
                "acceleration:0.7": start[j] + 0.35 * at**2,
            }[kind]
            worst = max(worst, float(np.max(np.abs(run.position[:, j] - expected))))
        context.progress((done + 1) / len(combinations))
    angles = np.radians(np.linspace(-223, 43, 134))
    curves = []
    for q3 in (-50.0, 0.0, 90.0):
        poses = np.stack([np.zeros_like(angles), angles, np.full_like(angles, np.radians(q3))], axis=-1)
        c112 = coriolis(poses, nominal())[:, 0, 0, 1]
        curves.append(Curve(f"q3 = {q3:g} deg", np.degrees(angles), 2 * c112))
    greatest = max(float(np.max(np.abs(curve.y))) for curve in curves)
    rows = (
        Row("combinations of constraints", "", 64, len(combinations)),
        Row(
            "greatest distance of a constrained joint from its motion, 0.19 s",
            "rad",
            None,
            f"{worst:.1g}" if worst > 1e-12 else "below 1e-12",
            "Integration of a constant velocity or acceleration is exact but for rounding.",
        ),
        Row(
            "Coriolis torque at joint 1, joints 1 and 2 at 1 rad/s each, greatest",
            "N.m",
            None,
            round(greatest, 4),
            "2 C112 qd1 qd2, the example of section 6.1.",
        ),
    )
    return Result(
        summary="All 64 combinations of free joints and joints at constant position, velocity or "
        "acceleration run, and the constrained joints keep to their motion. Figure 6.1 "
        "(ranges of the joints) is not in our text of the thesis.",
        rows=rows,
        figures=(
            Figure(
                "6.1 Coriolis",
                "Coriolis torque at joint 1 with joints 1 and 2 at 1 rad/s",
                "q2 [deg]",
                "torque [N.m]",
                tuple(curves),
            ),
        ),
        numbers={"Coriolis torque, greatest, N.m": float(f"{greatest:.9g}")},
    )


def locked_response(overwrite: bool, duration: float = 0.1, volts: float = 20.0):
    """Joint 1 of the upright arm under a voltage step, joints 2 and 3 locked.

    The thesis's states and its servo sample as the step. overwrite : integrate the free arm and
    put the locked joints' states back after each step, as section 6.2.1 says; else their rows and
    columns are taken out. Returns (time (n,) [s], velocity of joint 1 (n,) [rad/s]).
    """
    arm = nominal()
    pose = np.array(_POSES["upright"])
    v = np.array([volts, 0.0, 0.0])
    h = SERVO_PERIOD

    def third(x):
        free = jerk(x[:3], x[3:6], x[6:], v, arm)
        if overwrite:
            return free
        # the same right-hand side with joint 1's own inertia: qddd of the others is zero
        mass = inertia(x[:3], arm) + np.diag(arm.motor_inertia)
        return np.array([(mass @ free)[0] / mass[0, 0], 0.0, 0.0])

    def f(x):
        return np.concatenate([x[3:], third(x)])

    x = np.concatenate([pose, np.zeros(6)])
    # the arm at rest with no voltage: motor 1 carries no current (G1 = 0)
    found = [x[3]]
    count = int(round(duration / h))
    for _ in range(count):
        k1 = f(x)
        k2 = f(x + h / 2 * k1)
        k3 = f(x + h / 2 * k2)
        k4 = f(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        x[[1, 2]], x[[4, 5, 7, 8]] = pose[1:], 0.0
        found.append(x[3])
    return h * np.arange(count + 1), np.array(found)


def inertia_from_start(overwrite: bool) -> list[float]:
    """Effective inertia [kg.m^2] of each joint from the third derivative a voltage starts.

    Upright, at rest, the other joints locked in one of the two ways.
    """
    arm, pose, still = nominal(), np.array(_POSES["upright"]), np.zeros(3)
    mass = inertia(pose, arm) + np.diag(arm.motor_inertia)
    factor = joint_torque_per_ampere(arm) / np.array([m.inductance for m in arm.motors])
    found = []
    for j in range(3):
        v = np.zeros(3)
        v[j] = 10.0
        started = jerk(pose, still, still, v, arm) - jerk(pose, still, still, still, arm)
        if not overwrite:
            started = (mass @ started) / np.diag(mass)
        found.append(float(factor[j] * v[j] / started[j]))
    return found


@experiment("6.2.1", "Locked joints, rightly and as in 6.2.1; run time", chapter="6")
def locks_and_run_time(context: Context) -> Result:
    """What overwriting the state of a locked joint does, and ten seconds beside the MicroVax."""
    rows, numbers = [], {}
    for pose, angles in _POSES.items():
        right, overwritten = locked_inertias(np.array(angles))
        numbers[f"{pose}: inertia, kg.m^2"] = [float(f"{v:.9g}") for v in right]
        numbers[f"{pose}: inertia by overwriting, kg.m^2"] = [float(f"{v:.9g}") for v in overwritten]
        for j in range(3):
            rows.append(
                Row(
                    f"inertia of joint {j + 1}, the others locked, {pose}",
                    "kg.m^2",
                    None,
                    round(float(right[j]), 4),
                    f"Overwriting the locked joints' states gives {overwritten[j]:.3f}: "
                    f"{round(100 * (overwritten[j] / right[j] - 1)) + 0:d} %.",
                )
            )
    seen = {mode: inertia_from_start(mode) for mode in (False, True)}
    numbers["upright: inertia seen in the motion, right"] = [float(f"{v:.9g}") for v in seen[False]]
    numbers["upright: inertia seen in the motion, overwritten"] = [float(f"{v:.9g}") for v in seen[True]]
    rows.append(
        Row(
            "the same, seen in the third derivative that a voltage starts, upright",
            "kg.m^2",
            None,
            ", ".join(f"{v:.4g}" for v in seen[False]),
            f"Overwriting: {', '.join(f'{v:.4g}' for v in seen[True])}.",
        )
    )
    context.progress(0.3)
    at, right = locked_response(False)
    _, wrong = locked_response(True)
    apart = float(np.max(np.abs(right - wrong)))
    numbers["velocity of joint 1 apart by, rad/s"] = float(f"{apart:.9g}")
    rows.append(
        Row(
            "velocity of joint 1, 20 V, the two ways apart by at most",
            "rad/s",
            None,
            round(apart, 4),
            f"Of {float(right[-1]):.3f} rad/s after 0.1 s.",
        )
    )
    context.progress(0.6)
    page_rows = _run_time()
    context.progress(1.0)
    figure = Figure(
        "6.2.1",
        "Joint 1 under 20 V, joints 2 and 3 locked, arm upright",
        "time [s]",
        "velocity [rad/s]",
        (
            Curve("row and column taken out", at, right),
            Curve("states overwritten after each step", at, wrong, "dashed"),
        ),
    )
    return Result(
        summary="Locking a joint means taking its row and column out of the equations. "
        "Integrating the free arm and overwriting the locked joints afterwards, as section "
        "6.2.1 does, lets the free joint answer with the inertia of a chain whose other "
        "joints give way: upright 1.355, 2.975 and 0.924 in place of 2.498, 6.328 and "
        "1.129 kg.m^2. By the text the tests of chapter 7 with locked joints were run so. "
        "Ten seconds took the MicroVax nine minutes; the page shows what they take here.",
        rows=tuple(rows),
        figures=(figure,),
        numbers=numbers,
        page_rows=page_rows,
    )


def _run_time() -> tuple[Row, ...]:
    """Measured run times of ten seconds, for the page alone."""
    plant = Plant.of("bejczy")
    simulator = Simulator(plant)
    rows = []
    for step, note in ((SERVO_PERIOD, "28/30 ms, the servo sample"), (0.005, "5 ms, the likely step of the thesis")):
        simulator = Simulator(plant, max_step=step)
        at = np.arange(0.0, 10.0 + step / 2, step)
        volts = np.tile((10.0, -10.0, 10.0), (len(at), 1))
        best = math.inf
        for _ in range(3):
            simulator.reset()
            begin = time.perf_counter()
            simulator.run(at, volts)
            best = min(best, time.perf_counter() - begin)
        rows.append(
            Row(
                f"run time of ten simulated seconds, step {note}",
                "s",
                _MICROVAX_SECONDS,
                float(f"{best:.3g}"),
                f"{_MICROVAX_SECONDS / best:.2g} times faster than the MicroVax, best of three runs on this machine.",
            )
        )
    for step in (0.05, 0.005):
        evaluations = 4 * 10.0 / step
        rows.append(
            Row(
                f"time of the MicroVax for one evaluation, if the step was {step:g} s",
                "s",
                None,
                float(f"{_MICROVAX_SECONDS / evaluations:.3g}"),
                "From nine minutes; a machine of about a tenth of a million operations a "
                "second would do "
                f"{_MICROVAX_SECONDS / evaluations * 1e5:.0f} in that time.",
            )
        )
    return tuple(rows)
