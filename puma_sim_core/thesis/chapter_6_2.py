# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Section 6.2: Runge-Kutta against Euler and an adaptive reference, step and stability."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from puma_sim_core.plant.plant import Plant
from puma_sim_core.thesis import integration
from puma_sim_core.thesis.misprints.chapter_6 import growth, jacobian, stability_limit
from puma_sim_core.thesis.misprints.reference import nominal
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Heatmap, Result, Row

_RK4_COUNTS = (4, 5, 6, 7, 8, 10, 14, 20, 28, 30, 40, 56)
_EULER_COUNTS = (5, 8, 14, 28, 56, 112, 280, 560, 1120)
_ROWS_OF_TEN_SECONDS = 357
_START = (0.1, -0.4, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_POSES = {"upright": (0.0, -math.pi / 2, math.pi / 2), "horizontal": (0.0, 0.0, math.pi / 2), "q = 0": (0.0, 0.0, 0.0)}


def voltage_records(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Ten seconds of rows (n, 3) [V]: samples of sines, and 40 V of either sign at random."""
    at = integration.ROW * np.arange(_ROWS_OF_TEN_SECONDS)
    smooth = (20.0, 15.0, 10.0) * np.sin(np.outer(at, (3.1, 2.3, 4.7)) + (0.3, 1.0, 2.0))
    return {"smooth": smooth, "random": 40.0 * rng.choice((-1.0, 1.0), size=smooth.shape)}


def errors_by_step(plant: Plant, volts, reference, method, counts):
    """(steps [s], greatest error of the angles [rad], evaluations) for counts of steps a row."""
    runs = [method(plant, _START, volts, count) for count in counts]
    return (
        integration.ROW / np.array(counts),
        np.array([integration.position_error(run, reference) for run in runs]),
        np.array([run.evaluations for run in runs]),
    )


def observed_order(steps, errors, floor: float = 1e-10) -> float:
    """Slope of the error over the step in logarithms, where rounding does not reach.

    Errors below ``floor`` [rad] and those of runs that do not converge yet are left out.
    """
    use = (errors > floor) & (errors < 1e-1) & (steps < 2.1e-3)
    return float(np.polyfit(np.log(steps[use]), np.log(errors[use]), 1)[0])


def evaluations_for(target: float, errors, evaluations) -> float:
    """Evaluations that an error [rad] costs, along the observed line in logarithms."""
    use = np.isfinite(errors) & (errors > 0) & (errors < 1e-1)
    slope, offset = np.polyfit(np.log(errors[use][-4:]), np.log(evaluations[use][-4:]), 1)
    return float(np.exp(slope * np.log(target) + offset))


def pose_eigenvalues(pose) -> np.ndarray:
    """Eigenvalues [1/s] of the arm at rest in a pose, motors at 0 V."""
    return np.linalg.eigvals(jacobian(np.array([*pose, *[0.0] * 6]), np.zeros(3)))


@cache
def limit_map():
    """(angles (n,) [rad] of joints 2 and 3, greatest stable step of RK4 (n, n) [ms], [q3, q2])."""
    angles = np.radians(np.arange(-180, 181, 20))
    return angles, np.array(
        [[1e3 * stability_limit(pose_eigenvalues((0.0, q2, q3))) for q2 in angles] for q3 in angles]
    )


def failure_row(step: float) -> int:
    """Steps until RK4 with this step leaves the finite numbers from rest at q = 0 with 20 V."""
    plant = Plant.of("bejczy")
    run = integration.rk4(plant, (0.0,) * 9, np.full((400, 3), 20.0), 1, step)
    return run.failed


@experiment("6.2", "Integration: Runge-Kutta, Euler and an adaptive reference", chapter="6")
def run(context: Context) -> Result:
    """Error and cost against the step, the limit of stability, and the reading of "50 mS"."""
    plant = Plant.of("bejczy")
    records = voltage_records(context.rng("6.2 voltages"))
    curves_step, curves_cost, rows, numbers = [], [], [], {}
    for share, (name, volts) in enumerate(records.items()):
        reference = integration.adaptive(plant, _START, volts)
        context.progress(0.2 + 0.4 * share)
        found = {
            "RK4": errors_by_step(plant, volts, reference, integration.rk4, _RK4_COUNTS),
            "Euler": errors_by_step(plant, volts, reference, integration.euler, _EULER_COUNTS),
        }
        for method, (steps, errors, evaluations) in found.items():
            finite = np.isfinite(errors)
            style = "line" if name == "smooth" else "dashed"
            curves_step.append(Curve(f"{method}, {name} voltages", 1e3 * steps[finite], errors[finite], style))
            curves_cost.append(Curve(f"{method}, {name} voltages", evaluations[finite], errors[finite], style))
            numbers[f"{method}, {name}: step, error"] = [
                [float(s), float(f"{e:.6g}") if np.isfinite(e) else None] for s, e in zip(steps, errors)
            ]
        servo = dict(zip(_RK4_COUNTS, found["RK4"][1]))[30]
        rows.append(
            Row(f"error of RK4 at the servo sample of 28/30 ms, {name} voltages, 10 s", "rad", None, _rounded(servo))
        )
        orders = {method: observed_order(*found[method][:2]) for method in found}
        if name == "smooth":
            rows += [
                Row(
                    "order of RK4 (slope of the error over the step)",
                    "",
                    4,
                    _rounded(orders["RK4"]),
                    "Truncation per step of order h^5, as section 6.2 says; over a fixed time one order less.",
                ),
                Row(
                    "order of Euler's method",
                    "",
                    1,
                    _rounded(orders["Euler"]),
                    "The thesis found the solutions highly dependent on the step: with first "
                    "order they are, at every step that was affordable.",
                ),
                *_cost_rows(found),
            ]
        numbers[f"orders, {name}"] = [_rounded(value) for value in orders.values()]
        numbers[f"evaluations of the reference, {name}"] = reference.evaluations
    rows += _stability_rows(numbers)
    context.progress(1.0)
    figures = (
        Figure(
            "6.2 step",
            "Error after at most ten seconds against the step",
            "step [ms]",
            "greatest error of an angle [rad]",
            tuple(curves_step),
            log_x=True,
            log_y=True,
            note="Reference: DOP853 at a relative tolerance of 1e-12, restarted where the "
            "voltages jump. Runs that leave the finite numbers have no point.",
        ),
        Figure(
            "6.2 cost",
            "Error against cost",
            "evaluations of the derivative",
            "greatest error of an angle [rad]",
            tuple(curves_cost),
            log_x=True,
            log_y=True,
        ),
        *_stability_figures(),
    )
    summary = (
        "RK4 converges with its fourth order and Euler's method with its first. One step for each "
        "servo sample of 28/30 ms is accurate beyond need. RK4 is stable up to about 8.4 ms, the "
        "electrical time constant L/R being 3 ms: the step of 50 mS of sections 6.2.1 and 6.5 "
        "multiplies a decaying mode by about 2000 at each step and cannot have been used; 5 ms is "
        "the likely meaning. The 0.035 mS of the same paragraph fits neither reading."
    )
    return Result(summary=summary, rows=tuple(rows), figures=figures, numbers=numbers)


def _cost_rows(found):
    costs = {method: evaluations_for(1e-6, found[method][1], found[method][2]) for method in found}
    return [
        Row(
            f"evaluations of the derivative for an error of 1e-6 rad, {method}",
            "",
            None,
            float(f"{cost:.2g}"),
            "Along the observed line." if method == "Euler" else "",
        )
        for method, cost in costs.items()
    ]


def _stability_rows(numbers):
    motor = nominal().motors[0]
    electrical = np.array([-motor.resistance / motor.inductance])
    limits = {pose: stability_limit(pose_eigenvalues(angles)) for pose, angles in _POSES.items()}
    lowest, greatest = 1e3 * stability_limit(electrical), 1e3 * limits["upright"]
    upright = pose_eigenvalues(_POSES["upright"])
    numbers["stability limit of RK4, ms"] = {pose: round(1e3 * limit, 6) for pose, limit in limits.items()}
    euler = 1e3 * stability_limit(electrical, order=1)
    return [
        Row(
            "stability limit of RK4, motor alone (2.785 L/R)",
            "ms",
            None,
            _rounded(lowest),
            "Also the limit of a motor whose joint is locked.",
        ),
        Row(
            "stability limit of RK4, arm upright at rest",
            "ms",
            None,
            _rounded(greatest),
            "Back-emf makes damped oscillations of the motors' modes, at half their decay; "
            "the limit moves up a little.",
        ),
        Row(
            "least stability limit of RK4 over the poses, at rest", "ms", None, _rounded(float(np.min(limit_map()[1])))
        ),
        Row("stability limit of Euler's method, motor alone (2 L/R)", "ms", None, _rounded(euler)),
        Row(
            "step that produced accurate results, sections 6.2.1 and 6.5",
            "ms",
            "50",
            "5 (likely meaning)",
            "At 50 ms a decaying mode grows by the factor below.",
        ),
        Row(
            "factor on the fastest mode in one step of 50 ms",
            "",
            None,
            _rounded(growth(upright, 0.050)),
            "Above 1 the solution grows without bound.",
        ),
        Row("steps of 50 ms until the numbers overflow, 20 V from q = 0", "", None, failure_row(0.050)),
        Row(
            "step above which the output became inaccurate",
            "ms",
            "0.035",
            f"{lowest:.3g} (stability)",
            "The printed 0.035 mS is below the 50 to 40 mS of the "
            "sentence before it, and 0.035 s above L/R: neither reading agrees with both.",
        ),
    ]


def _stability_figures():
    upright = pose_eigenvalues(_POSES["upright"])
    steps = np.geomspace(1e-3, 5e-2, 160)
    growth_curves = tuple(
        Curve(name, 1e3 * steps, np.array([growth(upright, h, order) for h in steps]))
        for name, order in (("RK4", 4), ("Euler", 1))
    )
    angles, limits = limit_map()
    return (
        Figure(
            "6.2 growth",
            "Factor on a decaying mode in one step, arm upright",
            "step [ms]",
            "factor",
            (*growth_curves, Curve("1: limit", 1e3 * steps, np.ones_like(steps), "dashed")),
            log_x=True,
            log_y=True,
        ),
        Heatmap(
            "6.2 limit",
            "Greatest stable step of RK4 over the poses, at rest",
            "q2 [deg]",
            "q3 [deg]",
            np.degrees(angles),
            np.degrees(angles),
            limits,
            "step [ms]",
            note="2.785 L/R is 8.36 ms.",
        ),
    )


def _rounded(value: float, digits: int = 6) -> float:
    """To so many digits: what a reader wants, and the same on every machine."""
    return float(f"{value:.{digits}g}")
