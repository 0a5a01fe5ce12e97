# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Sections 6.1 and 6.2: constrained joints; Runge-Kutta against Euler, its stability and its run time."""

import itertools
import time
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from puma_sim_core.arm.rigid_body import coriolis, inertia
from puma_sim_core.arm.third_order import jerk, joint_torque_per_ampere
from puma_sim_core.dynamics.laws import AT_REST
from puma_sim_core.dynamics.rigid import derivative
from puma_sim_core.dynamics.rk4 import ARM
from puma_sim_core.dynamics.runs import is_finite, run_voltages
from puma_sim_core.dynamics.types import FREE, NO_SLIP, STILL, Constants, Rows, State
from puma_sim_core.jit import BACKEND, compiled, inlined
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.run_inputs import native
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator
from puma_sim_core.thesis.misprints.chapter_6 import growth, jacobian, locked_inertias, stability_limit
from puma_sim_core.thesis.misprints.reference import nominal
from puma_sim_core.thesis.motions import POSES, UPRIGHT, angles, rk4_step
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Heatmap, Result, Row, significant
from puma_sim_core.thesis.wording import Words

words = Words(__name__)
_MICROVAX_SECONDS = 540.0


@words.experiment("6.1")
def constraints(context: Context) -> Result:
    """Run the 64 combinations of section 6.1 and draw its example, a Coriolis torque."""
    plant, start = Plant.of("bejczy"), np.array([0.1, -0.4, 0.7])
    at = SERVO_PERIOD * np.arange(201)
    volts = np.tile((20.0, -15.0, 10.0), (len(at), 1))
    moved = {"hold": 0.0 * at, "velocity:0.4": 0.4 * at, "acceleration:0.7": 0.35 * at**2}
    worst, combinations = 0.0, list(itertools.product(("free", *moved), repeat=3))
    for done, kinds in enumerate(combinations):
        simulator = Simulator(plant, constraints=[Constraint.parse(kind) for kind in kinds])
        simulator.reset(start)
        run = simulator.run(at, volts)
        off = [run.position[:, j] - (start[j] + moved[kind]) for j, kind in enumerate(kinds) if kind != "free"]
        worst = max(worst, np.max(np.abs(off), initial=0.0))
        context.progress((done + 1) / len(combinations))
    q2 = np.radians(np.linspace(-223, 43, 134))
    curves = [
        Curve(f"q3 = {q3:g} deg", np.degrees(q2), 2 * coriolis(angles(q2, np.radians(q3)), nominal())[:, 0, 0, 1])
        for q3 in (-50.0, 0.0, 90.0)
    ]
    greatest = float(np.max(np.abs([curve.y for curve in curves])))
    rows = (
        words.row("combinations", len(combinations)),
        words.row("constrained", case=worst > 1e-12, worst=worst),
        words.row("coriolis", round(greatest, 4)),
    )
    numbers = {"Coriolis torque, greatest, N.m": significant(greatest, 9)}
    return words.result("6.1", rows, [words.figure("6.1 Coriolis", curves)], numbers)


# ---------------------------------------------------------------------------------- section 6.2.1


def locked_response(overwrite: bool, duration: float = 0.1, volts: float = 20.0):
    """(time (n,) [s], velocity of joint 1 (n,) [rad/s]) of the upright arm under a voltage step, joints 2 and 3 locked.

    The thesis's states and its servo sample as the step. overwrite : integrate the free arm and
    put the locked joints' states back after each step, as section 6.2.1 says; else their rows and
    columns are taken out.
    """
    arm, v = nominal(), np.array([volts, 0.0, 0.0])

    def f(x):
        third = jerk(x[:3], x[3:6], x[6:], v, arm)
        if not overwrite:
            # the same right-hand side with joint 1's own inertia: qddd of the others is zero
            mass = inertia(x[:3], arm) + np.diag(arm.motor_inertia)
            third = np.array([(mass @ third)[0] / mass[0, 0], 0.0, 0.0])
        return np.concatenate([x[3:], third])

    # the arm at rest with no voltage: motor 1 carries no current (G1 = 0)
    x = np.array([*UPRIGHT, *[0.0] * 6])
    found = [x[3]]
    for _ in range(round(duration / SERVO_PERIOD)):
        x = rk4_step(f, x, SERVO_PERIOD)
        x[[1, 2]], x[[4, 5, 7, 8]] = UPRIGHT[1:], 0.0
        found.append(x[3])
    return SERVO_PERIOD * np.arange(len(found)), np.array(found)


def inertia_from_start(overwrite: bool) -> list[float]:
    """Effective inertia [kg.m^2] of each joint, upright and at rest, from the third derivative that a voltage starts;
    the other joints locked in one of the two ways."""
    arm, pose, still = nominal(), np.array(UPRIGHT), np.zeros(3)
    mass = inertia(pose, arm) + np.diag(arm.motor_inertia)
    volts = 10.0 * np.eye(3)
    started = np.array([jerk(pose, still, still, v, arm) - jerk(pose, still, still, still, arm) for v in volts])
    if not overwrite:
        started = started @ mass.T / np.diag(mass)
    factor = joint_torque_per_ampere(arm) / [m.inductance for m in arm.motors]
    return (factor * 10.0 / np.diag(started)).tolist()


@words.experiment("6.2.1")
def locks_and_run_time(context: Context) -> Result:
    """What overwriting the state of a locked joint does, and ten seconds beside the MicroVax."""
    rows, numbers = [], {}
    for pose, q in POSES.items():
        right, overwritten = locked_inertias(np.array(q))
        numbers[f"{pose}: inertia, kg.m^2"] = significant(right, 9)
        numbers[f"{pose}: inertia by overwriting, kg.m^2"] = significant(overwritten, 9)
        for j, (true, wrong) in enumerate(zip(right, overwritten), start=1):
            how = {"joint": j, "pose": pose, "overwritten": wrong, "percent": round(100 * (wrong / true - 1))}
            rows.append(words.row("locked", round(float(true), 4), **how))
    right, overwritten = (inertia_from_start(mode) for mode in (False, True))
    numbers["upright: inertia seen in the motion, right"] = significant(right, 9)
    numbers["upright: inertia seen in the motion, overwritten"] = significant(overwritten, 9)
    rows.append(words.row("seen", right=right, overwritten=overwritten))
    context.progress(0.3)
    (at, right), (_, wrong) = (locked_response(mode) for mode in (False, True))
    apart = float(np.max(np.abs(right - wrong)))
    numbers["velocity of joint 1 apart by, rad/s"] = significant(apart, 9)
    rows.append(words.row("velocity", round(apart, 4), end=right[-1]))
    context.progress(0.6)
    page_rows = _run_time()
    context.progress(1.0)
    figure = words.figure("6.2.1", [Curve("right", at, right), Curve("overwritten", at, wrong, "dashed")])
    return words.result("6.2.1", rows, [figure], numbers, page_rows=page_rows)


def _run_time() -> list[Row]:
    """Measured run times of ten seconds, for the page alone."""
    rows = []
    for case, step in (("servo", SERVO_PERIOD), ("likely", 0.005)):
        simulator, taken = Simulator(Plant.of("bejczy"), max_step=step), []
        at = np.arange(0.0, 10.0 + step / 2, step)
        volts = np.tile((10.0, -10.0, 10.0), (len(at), 1))
        for _ in range(3):
            simulator.reset()
            begin = time.perf_counter()
            simulator.run(at, volts)
            taken.append(time.perf_counter() - begin)
        how = {"printed": _MICROVAX_SECONDS, "times": _MICROVAX_SECONDS / min(taken)}
        rows.append(words.row("run_time", significant(min(taken), 3), case=case, **how))
    for step in (0.05, 0.005):
        each = _MICROVAX_SECONDS / (4 * 10.0 / step)
        rows.append(words.row("evaluation", significant(each, 3), step=step, operations=each * 1e5))
    return rows


# ------------------------------------------------------- section 6.2: methods on the simulator's own equations

#: a row of voltages: one setpoint period of the manipulator [s]
ROW = 0.028
_ROWS_OF_TEN_SECONDS = 357
_START = (0.1, -0.4, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Run(NamedTuple):
    """States (n + 1, 9) at the rows' ends, how often the derivative was evaluated, and the first row whose
    state is not finite, or -1."""

    states: np.ndarray
    evaluations: int
    failed: int = -1


@inlined
def _slope(x, v, constants):
    model, p = constants
    return derivative(x, v, model, p, FREE, NO_SLIP, STILL)


_moved = ARM.moved


@compiled
def _rates(x, v, constants):
    return _slope(x, v, constants)


@compiled
def _euler(x, volts, count, h, constants, out):
    out[0] = np.array(x)
    for r in range(len(volts)):
        v = (volts[r][0], volts[r][1], volts[r][2])
        for _ in range(count):
            x = _moved(x, h, _slope(x, v, constants))
        if not is_finite(x):
            return r + 1
        out[r + 1] = np.array(x)
    return -1


def _constants(plant: Plant, active: int | None = None) -> Constants:
    model, table = plant.constants
    return Constants(model if active is None else model._replace(active=active), native(table))


def euler(plant: Plant, start: Sequence[float], volts: ArrayLike, count: int) -> Run:
    """Euler's method with ``count`` steps a row; plant without effects."""
    rows = _rows(volts)
    out = np.zeros((len(rows) + 1, 9))
    failed = _euler(tuple(map(float, start)), rows, count, ROW / count, _constants(plant, 0), out)
    return Run(out, len(rows) * count, failed)


def rk4(plant: Plant, start: Sequence[float], volts: ArrayLike, count: int, row: float = ROW) -> Run:
    """The simulator's Runge-Kutta method with ``count`` steps a row, whatever their length."""
    volts = _rows(volts)
    n = len(volts)
    out = np.zeros((n + 1, 12))
    rows = Rows(volts, _rows(row * np.arange(n)), _rows(np.full(n, count), int), _rows(np.full(n, row / count)))
    state = State(tuple(map(float, start)), AT_REST, (0.0, 0.0, 0.0))
    failed = run_voltages(state, rows, _constants(plant), FREE, out)
    return Run(out[:, :9], 4 * n * count, failed)


def adaptive(plant: Plant, start: Sequence[float], volts: ArrayLike, tolerance: float = 1e-12) -> Run:
    """Adaptive reference: DOP853 of SciPy, restarted at each row, where the voltages jump."""
    constants = _constants(plant, 0)
    states, evaluations = [np.asarray(start, dtype=float)], 0
    how = {"method": "DOP853", "rtol": tolerance, "atol": tolerance * 1e-1, "first_step": ROW / 8}
    for v in map(tuple, np.asarray(volts, dtype=float).tolist()):
        run = solve_ivp(
            lambda t, x, v: _rates(tuple(x.tolist()), v, constants), (0.0, ROW), states[-1], args=(v,), **how
        )
        states.append(run.y[:, -1])
        evaluations += run.nfev
    return Run(np.array(states), evaluations)


def _rows(values: ArrayLike, dtype: type = float) -> Any:
    """Rows as the kernel takes them."""
    rows = np.ascontiguousarray(values, dtype=dtype)
    return rows if BACKEND == "numba" else rows.tolist()


#: each method with its counts of steps a row
METHODS = {
    "RK4": (rk4, (4, 5, 6, 7, 8, 10, 14, 20, 28, 30, 40, 56)),
    "Euler": (euler, (5, 8, 14, 28, 56, 112, 280, 560, 1120)),
}


def voltage_records(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Ten seconds of rows (n, 3) [V]: samples of sines, and 40 V of either sign at random."""
    at = ROW * np.arange(_ROWS_OF_TEN_SECONDS)
    smooth = (20.0, 15.0, 10.0) * np.sin(np.outer(at, (3.1, 2.3, 4.7)) + (0.3, 1.0, 2.0))
    return {"smooth": smooth, "random": 40.0 * rng.choice((-1.0, 1.0), size=smooth.shape)}


def errors_by_step(plant: Plant, volts: np.ndarray, reference: Run, name: str) -> tuple[np.ndarray, ...]:
    """(steps [s], greatest error of the angles [rad] or infinity, evaluations) of a method."""
    method, counts = METHODS[name]
    runs = [method(plant, _START, volts, count) for count in counts]
    errors = [np.inf if r.failed >= 0 else np.max(np.abs(r.states - reference.states)[:, :3]) for r in runs]
    return ROW / np.array(counts), np.array(errors), np.array([run.evaluations for run in runs])


def observed_order(steps: np.ndarray, errors: np.ndarray) -> float:
    """Slope of the error over the step in logarithms, where rounding does not reach and the runs converge."""
    use = (errors > 1e-10) & (errors < 1e-1) & (steps < 2.1e-3)
    return float(np.polyfit(np.log(steps[use]), np.log(errors[use]), 1)[0])


def evaluations_for(target: float, errors: np.ndarray, evaluations: np.ndarray) -> float:
    """Evaluations that an error [rad] costs, along the observed line in logarithms."""
    use = np.isfinite(errors) & (errors > 0) & (errors < 1e-1)
    slope, offset = np.polyfit(np.log(errors[use][-4:]), np.log(evaluations[use][-4:]), 1)
    return float(np.exp(slope * np.log(target) + offset))


def pose_eigenvalues(pose: Sequence[float]) -> np.ndarray:
    """Eigenvalues [1/s] of the arm at rest in a pose, motors at 0 V."""
    return np.linalg.eigvals(jacobian(np.array([*pose, *[0.0] * 6]), np.zeros(3)))


@cache
def limit_map():
    """(angles (n,) [rad] of joints 2 and 3, greatest stable step of RK4 (n, n) [ms], [q3, q2])."""
    turn = np.radians(np.arange(-180, 181, 20))
    return turn, np.array([[1e3 * stability_limit(pose_eigenvalues((0.0, q2, q3))) for q2 in turn] for q3 in turn])


def failure_row(step: float) -> int:
    """Steps until RK4 with this step leaves the finite numbers from rest at q = 0 with 20 V."""
    return rk4(Plant.of("bejczy"), (0.0,) * 9, np.full((400, 3), 20.0), 1, step).failed


@words.experiment("6.2")
def run(context: Context) -> Result:
    """Error and cost against the step, the limit of stability, and the reading of "50 mS"."""
    plant = Plant.of("bejczy")
    by_step, by_cost, rows, numbers = [], [], [], {}
    for share, (name, volts) in enumerate(voltage_records(context.rng("6.2 voltages")).items()):
        reference = adaptive(plant, _START, volts)
        context.progress(0.2 + 0.4 * share)
        found = {method: errors_by_step(plant, volts, reference, method) for method in METHODS}
        for method, (steps, errors, evaluations) in found.items():
            finite = np.isfinite(errors)
            style, label = "line" if name == "smooth" else "dashed", f"{method}, {name} voltages"
            by_step.append(Curve(label, 1e3 * steps[finite], errors[finite], style))
            by_cost.append(Curve(label, evaluations[finite], errors[finite], style))
            numbers[f"{method}, {name}: step, error"] = [
                [s, significant(e, 6) if np.isfinite(e) else None] for s, e in zip(steps, errors)
            ]
        servo = found["RK4"][1][METHODS["RK4"][1].index(30)]
        rows.append(words.row("servo", significant(servo, 6), name=name))
        orders = [significant(observed_order(steps, errors), 6) for steps, errors, _ in found.values()]
        if name == "smooth":
            rows += [words.row("order_rk4", orders[0]), words.row("order_euler", orders[1])]
            rows += [
                words.row("cost", significant(evaluations_for(1e-6, *values[1:]), 2), case=method, method=method)
                for method, values in found.items()
            ]
        numbers[f"orders, {name}"] = orders
        numbers[f"evaluations of the reference, {name}"] = reference.evaluations
    limits = {pose: 1e3 * stability_limit(pose_eigenvalues(q)) for pose, q in POSES.items()}
    numbers["stability limit of RK4, ms"] = {pose: round(limit, 6) for pose, limit in limits.items()}
    rows += _stability_rows(limits["upright"])
    context.progress(1.0)
    figures = [words.figure("6.2 step", by_step), words.figure("6.2 cost", by_cost), *_stability_figures()]
    return words.result("6.2", rows, figures, numbers)


def _stability_rows(limit_upright: float) -> list[Row]:
    motor = nominal().motors[0]
    electrical = np.array([-motor.resistance / motor.inductance])
    alone = 1e3 * stability_limit(electrical)
    limits = {
        "limit_motor": alone,
        "limit_upright": limit_upright,
        "limit_least": np.min(limit_map()[1]),
        "limit_euler": 1e3 * stability_limit(electrical, order=1),
    }
    return [words.row(name, significant(limit, 6)) for name, limit in limits.items()] + [
        words.row("accurate"),
        words.row("factor", significant(growth(pose_eigenvalues(POSES["upright"]), 0.050), 6)),
        words.row("overflow", failure_row(0.050)),
        words.row("inaccurate", limit=alone),
    ]


def _stability_figures() -> list[Figure | Heatmap]:
    upright, steps = pose_eigenvalues(POSES["upright"]), np.geomspace(1e-3, 5e-2, 160)
    curves = [
        Curve(name, 1e3 * steps, np.array([growth(upright, h, order) for h in steps]))
        for name, order in (("RK4", 4), ("Euler", 1))
    ]
    turn, limits = np.degrees(limit_map()[0]), limit_map()[1]
    return [
        words.figure("6.2 growth", [*curves, Curve("1: limit", 1e3 * steps, np.ones_like(steps), "dashed")]),
        words.heatmap("6.2 limit", turn, turn, limits),
    ]
