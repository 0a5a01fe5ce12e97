# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Chapter 5 and sections 6.3, 6.4: third-order matrices, their inversion, and the program's P."""

from fractions import Fraction

import numpy as np
from scipy.integrate import solve_ivp

from puma_sim_core.arm.parameters import load_parameters, parameter_sets, smallest_eigenvalue
from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.arm.third_order import acceleration_from_current, current_rate, jerk, matrices
from puma_sim_core.thesis.misprints.chapter_6 import jerk_6_2
from puma_sim_core.thesis.misprints.reference import VISCOUS, nominal
from puma_sim_core.thesis.motions import angles, rk4_step
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Result, matrix_text, significant
from puma_sim_core.thesis.wording import Words

words = Words(__name__)
#: a moving start with held voltages: angles, velocities, currents, volts
START = (np.array([0.1, -0.4, 0.7]), np.array([0.3, -0.2, 0.5]), np.array([0.5, -1.0, 0.8]))
VOLTS = np.array([20.0, -15.0, 10.0])


def motion(state: str, torque_form: str = "physical", duration: float = 0.5):
    """(time (n,), angles, accelerations (n, 3)) from START in the thesis's states ("acceleration") or with currents
    ("current"); DOP853 at 1e-11."""
    arm, start = nominal(), np.concatenate(START)

    def acceleration(x):
        return acceleration_from_current(x[:3], x[3:6], x[6:], arm, VISCOUS, torque_form)

    def f(_, x):
        if state == "acceleration":
            return np.concatenate([x[3:], jerk(x[:3], x[3:6], x[6:], VOLTS, arm, VISCOUS, torque_form)])
        return np.concatenate([x[3:6], acceleration(x), current_rate(x[3:6], x[6:], VOLTS, arm)])

    if state == "acceleration":
        start[6:] = acceleration(start)
    time = np.linspace(0.0, duration, 101)
    states = solve_ivp(f, (0.0, duration), start, t_eval=time, method="DOP853", rtol=1e-11, atol=1e-12).y.T
    accelerations = states[:, 6:] if state == "acceleration" else np.array([acceleration(x) for x in states])
    return time, states[:, :3], accelerations


def jerk_disagreement(rng: np.random.Generator, name: str, form: str, count: int = 12) -> float:
    """Greatest relative distance of the two forms' third derivatives over random states."""
    arm, worst, step = load_parameters(name), 0.0, 1e-40j
    for _ in range(count):
        q, qd = rng.uniform(-np.pi, np.pi, 3), rng.uniform(-2, 2, 3)
        current, v = rng.uniform(-8, 8, 3), rng.uniform(-40, 40, 3)
        qdd = acceleration_from_current(q, qd, current, arm, VISCOUS, form)
        along = (q + step * qd, qd + step * qdd, current + step * current_rate(qd, current, v, arm))
        flow = acceleration_from_current(*along, arm, VISCOUS, form).imag / step.imag
        named = jerk(q, qd, qdd, v, arm, VISCOUS, form)
        worst = max(worst, np.max(np.abs(named - flow)) / np.max(np.abs(flow)))
    return float(worst)


@words.experiment("5.2")
def third_order(context: Context) -> Result:
    """The named matrices at a state, and the motion in either state."""
    rng = context.rng("5.2 states")
    rows, figures, numbers = [], [], {}
    for name, value in matrices(*START[:2], nominal(), VISCOUS)._asdict().items():
        value = np.atleast_2d(value)
        numbers[name] = significant(value, 9)
        text = matrix_text([[f"{x:.4g}" for x in row] for row in value])
        rows.append(words.row("matrix", text, name=name, unit=words.table("UNITS")[name]))
    worst = max(jerk_disagreement(rng, name, form) for name in parameter_sets() for form in ("physical", "printed"))
    context.progress(0.3)
    rows.append(words.row("third", case=worst < 1e-10, worst=worst))
    numbers["two states agree to 1e-10"] = worst < 1e-10
    styles = {"acceleration": "line", "current": "dashed"}
    for share, name in ((0.65, "physical"), (1.0, "printed")):
        form = words.text("form", case=name)
        runs = {state: motion(state, name) for state in styles}
        apart = max(np.max(np.abs(one - two)) for one, two in list(zip(*runs.values()))[1:])
        end = runs["current"][1][-1]
        numbers[f"q(0.5 s), {form}"] = end.round(8)
        rows.append(words.row("end", case=apart < 1e-7, form=form, end=end, apart=apart))
        curves = [
            Curve(words.text("state", case=state, joint=j + 1), runs[state][0], runs[state][2][:, j], style)
            for j in range(3)
            for state, style in styles.items()
        ]
        figures.append(words.figure("states", curves, name=name, form=form))
        context.progress(share)
    return words.result("5.2", rows, figures, numbers)


# ------------------------------------------------------------------------------------ section 6.3


def gauss_jordan(matrix, dtype=np.float64) -> np.ndarray:
    """Inverse by Gauss-Jordan elimination with partial pivoting in ``dtype``; ZeroDivisionError for a singular one."""
    n = len(matrix)
    work = np.hstack([np.array(matrix, dtype=dtype), np.eye(n, dtype=dtype)])
    for column in range(n):
        pivot = column + int(np.argmax(np.abs(work[column:, column])))
        if work[pivot, column] == 0:
            raise ZeroDivisionError("a pivot is zero")
        work[[column, pivot]] = work[[pivot, column]]
        work[column] /= work[column, column]
        others = np.arange(n) != column
        work[others] -= np.outer(work[others, column], work[column])
    return work[:, n:]


def inversion_errors(rng: np.random.Generator, count: int = 300) -> list[float]:
    """Median relative error of the inverse, [double, single], of matrices whose elements differ by up to 10 000."""
    errors = []
    for _ in range(count):
        matrix = rng.choice((-1, 1), (3, 3)) * 10.0 ** rng.uniform(-2, 2, (3, 3))
        # by cofactors in exact rational arithmetic
        m = np.array([[Fraction(value) for value in row] for row in matrix.tolist()])
        cofactors = np.array([np.cross(m[i - 2], m[i - 1]) for i in range(3)])
        exact = (cofactors.T / (m[0] @ cofactors[0])).astype(float)
        off = [np.max(np.abs(gauss_jordan(matrix, dtype) - exact)) for dtype in (np.float64, np.float32)]
        errors.append(np.array(off) / np.max(np.abs(exact)))
    return np.median(errors, axis=0).tolist()


def meets_conditions(matrices_) -> np.ndarray:
    """Section 6.3's conditions (second one mended) for matrices (..., 3, 3)."""
    diagonal = np.einsum("...ii->...i", matrices_)
    off = matrices_**2 < diagonal[..., :, None] * diagonal[..., None, :]
    off[..., [0, 1, 2], [0, 1, 2]] = True
    return np.all(diagonal > 0, axis=-1) & np.all(off, axis=(-2, -1))


@words.experiment("6.3")
def inversion(context: Context) -> Result:
    """Eigenvalues of D and D + Ia over the poses, and the inversion in single precision."""
    arm = nominal()
    turn = np.radians(np.arange(-180.0, 181.0, 5.0))
    axis = np.degrees(turn)
    poses = angles(*np.meshgrid(turn, turn))
    d = inertia(poses, arm)
    with_motors = d + np.diag(arm.motor_inertia)
    bare, whole = (np.linalg.eigvalsh(m)[..., 0] for m in (d, with_motors))
    inner = np.s_[:-1, :-1]  # +180 is -180 again
    indefinite = float(np.mean(bare[inner] <= 0))
    fooled = float(np.mean((bare[inner] <= 0) & meets_conditions(d[inner])))
    context.progress(0.4)
    double, single = inversion_errors(context.rng("6.3 matrices"))
    condition = float(np.max(np.linalg.cond(matrices(poses[0, 0], np.zeros(3), arm).LKMAT @ with_motors)))
    found = {
        "lowest_d": round(float(bare.min()), 4),
        "indefinite": round(100 * indefinite, 2),
        "fooled": round(100 * fooled, 2),
        "lowest_sum": round(float(whole.min()), 4),
        "condition": round(condition, 2),
        "double": significant(double, 1),
        "single": significant(single, 1),
    }
    lowest = {name: round(smallest_eigenvalue(load_parameters(name))[0], 4) for name in parameter_sets()}
    rows = [words.row(name, value) for name, value in found.items()]
    rows += [words.row("lowest_of_set", value, name=name) for name, value in lowest.items()]
    context.progress(1.0)
    numbers = {
        "smallest eigenvalue of D": significant(bare.min(), 9),
        "smallest eigenvalue of D + Ia": significant(whole.min(), 9),
        "share of poses with D indefinite": indefinite,
        "share that meets the conditions and is indefinite": fooled,
        "median error double, single": significant([double, single], 3),
    }
    figures = [words.heatmap("6.3 D", axis, axis, bare), words.heatmap("6.3 D + Ia", axis, axis, whole)]
    return words.result("6.3", rows, figures, numbers, indefinite=100 * indefinite)


# ------------------------------------------------------------------------------------ section 6.4


def motion_6_4(slips=(), duration: float = 0.5, count: int = 250) -> np.ndarray:
    """Angles (count + 1, 3) [rad] from START by section 6.4's matrices and RK4."""

    def rates(x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[3:], jerk_6_2(x[:3], x[3:6], x[6:], VOLTS, slips)])

    found = [np.concatenate([*START[:2], acceleration_from_current(*START, nominal(), VISCOUS)])]
    for _ in range(count):
        found.append(rk4_step(rates, found[-1], duration / count))
    return np.array(found)[:, :3]


@words.experiment("6.4")
def program_matrices(context: Context) -> Result:
    """Half a second by section 6.4's matrices, corrected and with each misprint alone."""
    true, slips = motion_6_4(), words.table("SLIPS")
    runs, rows, numbers = {}, [], {}
    for done, (name, slip) in enumerate(slips.items()):
        runs[name] = motion_6_4((name,))
        apart = np.max(np.abs(runs[name] - true), axis=0)
        numbers[name] = significant(apart, 6)
        rows.append(words.row("slip", slip=slip, apart=apart))
        context.progress((done + 1) / len(slips))
    numbers["q(0.5 s), corrected"] = true[-1].round(8)
    near = np.max(np.abs(true[-1] - motion("current")[1][-1])) < 1e-6
    rows.insert(0, words.row("corrected", case=near, end=true[-1]))
    time = np.linspace(0.0, 0.5, len(true))
    worst = sorted(runs, key=lambda name: -np.max(np.abs(runs[name][:, 1] - true[:, 1])))[:3]
    curves = [
        Curve("corrected", time, true[:, 1]),
        *(Curve(slips[name], time, runs[name][:, 1], "dashed") for name in worst),
    ]
    return words.result("6.4", rows, [words.figure("6.4", curves)], numbers, worst=slips[worst[0]])
