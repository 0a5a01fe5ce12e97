# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Chapter 5 and sections 6.3, 6.4: third-order matrices, their inversion, and the program's P."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from scipy.integrate import solve_ivp

from puma_sim_core.arm.parameters import load_parameters, parameter_sets, smallest_eigenvalue
from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.arm.third_order import ThirdOrderMatrices, acceleration_from_current, current_rate, jerk, matrices
from puma_sim_core.thesis.misprints.chapter_6 import jerk_6_2
from puma_sim_core.thesis.misprints.reference import VISCOUS, nominal
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Heatmap, Result, Row, matrix_text

#: a moving start with held voltages: angles, velocities, currents, volts
START = (np.array([0.1, -0.4, 0.7]), np.array([0.3, -0.2, 0.5]), np.array([0.5, -1.0, 0.8]))
VOLTS = np.array([20.0, -15.0, 10.0])
_UNITS = {
    "Dbar": "V.s^3/rad",
    "FMAT": "V.s^2/rad",
    "BMAT": "V.s^2/rad",
    "GMAT": "V.s^2/rad",
    "HMAT": "V.s^2/rad",
    "JKMAT": "V.s/rad",
    "KMAT": "V.s/rad",
    "LMAT": "V",
    "LKMAT": "V.s/(N.m)",
}


def motion(state: str, torque_form: str = "physical", duration: float = 0.5):
    """Motion from START in the thesis's states ("acceleration") or with currents ("current").

    Returns (time (n,), angles (n, 3), accelerations (n, 3)); DOP853 at 1e-11.
    """
    arm = nominal()
    q, qd, current = START

    def acceleration(x):
        return acceleration_from_current(x[:3], x[3:6], x[6:], arm, VISCOUS, torque_form)

    def f(_, x):
        if state == "acceleration":
            return np.concatenate([x[3:], jerk(x[:3], x[3:6], x[6:], VOLTS, arm, VISCOUS, torque_form)])
        return np.concatenate([x[3:6], acceleration(x), current_rate(x[3:6], x[6:], VOLTS, arm)])

    third = acceleration(np.concatenate(START)) if state == "acceleration" else current
    time = np.linspace(0.0, duration, 101)
    run = solve_ivp(
        f, (0.0, duration), np.concatenate([q, qd, third]), t_eval=time, method="DOP853", rtol=1e-11, atol=1e-12
    )
    states = run.y.T
    accelerations = states[:, 6:] if state == "acceleration" else np.array([acceleration(x) for x in states])
    return time, states[:, :3], accelerations


def jerk_disagreement(rng: np.random.Generator, name: str, form: str, count: int = 12) -> float:
    """Greatest relative distance of the two forms' third derivatives over random states."""
    arm, worst, step = load_parameters(name), 0.0, 1e-40j
    for _ in range(count):
        q, qd = rng.uniform(-np.pi, np.pi, 3), rng.uniform(-2, 2, 3)
        current, v = rng.uniform(-8, 8, 3), rng.uniform(-40, 40, 3)
        qdd = acceleration_from_current(q, qd, current, arm, VISCOUS, form)
        flow = (
            acceleration_from_current(
                q + step * qd, qd + step * qdd, current + step * current_rate(qd, current, v, arm), arm, VISCOUS, form
            ).imag
            / step.imag
        )
        named = jerk(q, qd, qdd, v, arm, VISCOUS, form)
        worst = max(worst, float(np.max(np.abs(named - flow)) / np.max(np.abs(flow))))
    return worst


@experiment("5.2", "Third-order matrices by their names; both states agree", chapter="5")
def third_order(context: Context) -> Result:
    """The named matrices at a state, and the motion in either state."""
    rng = context.rng("5.2 states")
    q, qd, _ = START
    named = matrices(q, qd, nominal(), VISCOUS)
    rows, numbers = [], {}
    for name in ThirdOrderMatrices._fields:
        value = getattr(named, name)
        numbers[name] = [[float(f"{x:.9g}") for x in row] for row in np.atleast_2d(value)]
        rows.append(
            Row(
                f"{name} at q = (0.1, -0.4, 0.7), qd = (0.3, -0.2, 0.5)",
                _UNITS[name],
                None,
                matrix_text([[f"{x:.4g}" for x in row] for row in np.atleast_2d(value)]),
            )
        )
    worst = max(jerk_disagreement(rng, name, form) for name in parameter_sets() for form in ("physical", "printed"))
    context.progress(0.3)
    rows.append(
        Row(
            "third derivatives of the two states apart, relative, all parameter sets and both torque forms",
            "",
            None,
            "below 1e-10" if worst < 1e-10 else f"{worst:.1g}",
            "Named matrices against the complex step along the motion with currents.",
        )
    )
    numbers["two states agree to 1e-10"] = bool(worst < 1e-10)
    figures = []
    for form, words in (("physical", "F = N kt i"), ("printed", "F = kt i, as printed")):
        runs = {state: motion(state, form) for state in ("acceleration", "current")}
        apart = max(float(np.max(np.abs(runs["acceleration"][k] - runs["current"][k]))) for k in (1, 2))
        end = runs["current"][1][-1]
        numbers[f"q(0.5 s), {words}"] = end.round(8).tolist()
        rows.append(
            Row(
                f"q(0.5 s), {words}",
                "rad",
                None,
                ", ".join(f"{x:.7f}" for x in end),
                f"Angles and accelerations of the two states agree "
                f"{'to 1e-7' if apart < 1e-7 else f'to {apart:.1g} only'}.",
            )
        )
        figures.append(
            Figure(
                f"5.2 {form}",
                f"Accelerations in both states, {words}",
                "time [s]",
                "acceleration [rad/s^2]",
                tuple(
                    curve
                    for j in range(3)
                    for curve in (
                        Curve(
                            f"joint {j + 1}, states (q, qd, qdd)",
                            runs["acceleration"][0],
                            runs["acceleration"][2][:, j],
                        ),
                        Curve(
                            f"joint {j + 1}, states (q, qd, i)", runs["current"][0], runs["current"][2][:, j], "dashed"
                        ),
                    )
                ),
            )
        )
        context.progress(0.65 if form == "physical" else 1.0)
    return Result(
        summary="The thesis's third-order equations, with their misprints corrected, and the "
        "equations with motor currents as states are one system: third derivatives agree "
        "to rounding for every parameter set. The thesis prints no number of these "
        "matrices. Effects with jumps, such as dry friction, exist in the second form "
        "only, so that everything else here runs on currents.",
        rows=tuple(rows),
        figures=tuple(figures),
        numbers=numbers,
    )


# ------------------------------------------------------------------------------------ section 6.3


def gauss_jordan(matrix, dtype=np.float64) -> np.ndarray:
    """Inverse by Gauss-Jordan elimination with partial pivoting, all arithmetic in ``dtype``.

    Raises
    ------
    ZeroDivisionError : a pivot is zero: the matrix is singular.
    """
    work = np.array(matrix, dtype=dtype)
    n = len(work)
    work = np.hstack([work, np.eye(n, dtype=dtype)])
    for column in range(n):
        pivot = column + int(np.argmax(np.abs(work[column:, column])))
        if work[pivot, column] == 0:
            raise ZeroDivisionError("a pivot is zero")
        work[[column, pivot]] = work[[pivot, column]]
        work[column] /= work[column, column]
        for row in range(n):
            if row != column:
                work[row] -= work[row, column] * work[column]
    return work[:, n:]


def inversion_errors(rng: np.random.Generator, count: int = 300):
    """Median relative error of the inverse, (double, single), of matrices whose elements differ by
    factors of up to 10 000."""
    errors = {np.float64: [], np.float32: []}
    for _ in range(count):
        matrix = rng.choice((-1, 1), (3, 3)) * 10.0 ** rng.uniform(-2, 2, (3, 3))
        exact = _adjugate_inverse(matrix)
        for dtype, found in errors.items():
            found.append(np.max(np.abs(gauss_jordan(matrix, dtype) - exact)) / np.max(np.abs(exact)))
    return tuple(float(np.median(found)) for found in errors.values())


def _adjugate_inverse(matrix) -> np.ndarray:
    """Inverse by cofactors in exact rational arithmetic."""
    m = [[Fraction(float(value)) for value in row] for row in matrix]

    def cofactor(i, j):
        a, b = [r for r in range(3) if r != i]
        c, d = [r for r in range(3) if r != j]
        return (-1) ** (i + j) * (m[a][c] * m[b][d] - m[a][d] * m[b][c])

    determinant = sum(m[0][j] * cofactor(0, j) for j in range(3))
    return np.array([[float(cofactor(j, i) / determinant) for j in range(3)] for i in range(3)])


def meets_conditions(matrices_) -> np.ndarray:
    """Section 6.3's conditions (second one mended) for matrices (..., 3, 3)."""
    diagonal = np.einsum("...ii->...i", matrices_)
    pairs = diagonal[..., :, None] * diagonal[..., None, :]
    off = matrices_**2 < pairs
    off[..., [0, 1, 2], [0, 1, 2]] = True
    return np.all(diagonal > 0, axis=-1) & np.all(off, axis=(-2, -1))


@experiment("6.3", "Is D positive definite? Inversion and its rounding", chapter="6")
def inversion(context: Context) -> Result:
    """Eigenvalues of D and D + Ia over the poses, and the inversion in single precision."""
    arm = nominal()
    angles = np.radians(np.arange(-180.0, 181.0, 5.0))
    q2, q3 = np.meshgrid(angles, angles)
    poses = np.stack([np.zeros_like(q2), q2, q3], axis=-1)
    d = inertia(poses, arm)
    with_motors = d + np.diag(arm.motor_inertia)
    bare, whole = (np.linalg.eigvalsh(m)[..., 0] for m in (d, with_motors))
    inner = np.s_[:-1, :-1]  # +180 is -180 again
    indefinite = float(np.mean(bare[inner] <= 0))
    fooled = float(np.mean((bare[inner] <= 0) & meets_conditions(d[inner])))
    context.progress(0.4)
    double, single = inversion_errors(context.rng("6.3 matrices"))
    condition = float(np.max(np.linalg.cond(matrices(poses[0, 0], np.zeros(3), arm).LKMAT @ with_motors)))
    context.progress(0.8)
    rows = [
        Row(
            "smallest eigenvalue of D over all poses",
            "kg.m^2",
            "above 0",
            round(float(bare.min()), 4),
            "At q2 = 90 and -90, q3 = -90 deg. With zero products of "
            "inertia link 2 is not a possible body; kinetic energy of the links alone would be "
            "negative there.",
        ),
        Row("poses at which D is not positive definite", "%", "0", round(100 * indefinite, 2)),
        Row(
            "of all poses, those that meet section 6.3's conditions though D is indefinite",
            "%",
            None,
            round(100 * fooled, 2),
            "The conditions (with d_ij^2 for d_ii^2) are necessary, not sufficient: the determinant counts too.",
        ),
        Row(
            "smallest eigenvalue of D + Ia over all poses",
            "kg.m^2",
            "above 0",
            round(float(whole.min()), 4),
            "Positive, so that the simulation can run; a parameter set for which it is not is refused.",
        ),
        Row("greatest condition number of Dbar", "", None, round(condition, 2), "Inversion loses about one digit."),
        Row(
            "error of Gauss-Jordan with pivoting, elements up to 10 000 apart, double",
            "",
            None,
            float(f"{double:.1g}"),
            "Median over 300 matrices, relative to the inverse by exact fractions.",
        ),
        Row(
            "the same in single precision",
            "",
            "accuracy reduced by about 15 %",
            float(f"{single:.1g}"),
            "Seven digits in place of sixteen; what the 15 % refer to is not said.",
        ),
    ]
    for name in parameter_sets():
        rows.append(
            Row(
                f"smallest eigenvalue of D + Ia over the joint ranges, set {name}",
                "kg.m^2",
                None,
                round(smallest_eigenvalue(load_parameters(name))[0], 4),
            )
        )
    context.progress(1.0)
    degrees = np.degrees(angles)
    return Result(
        summary="Section 6.3 proves D positive definite by two conditions that are necessary but "
        "not sufficient, one of them misprinted. For its parameters D is indefinite at "
        f"{100 * indefinite:.1f} % of the poses; only the motor inertias make the sum that "
        "is inverted positive definite.",
        rows=tuple(rows),
        figures=(
            Heatmap(
                "6.3 D",
                "Smallest eigenvalue of D, links alone",
                "q2 [deg]",
                "q3 [deg]",
                degrees,
                degrees,
                bare,
                "eigenvalue [kg.m^2]",
                note="Below zero the links are not possible bodies.",
            ),
            Heatmap(
                "6.3 D + Ia",
                "Smallest eigenvalue of D + Ia",
                "q2 [deg]",
                "q3 [deg]",
                degrees,
                degrees,
                whole,
                "eigenvalue [kg.m^2]",
            ),
        ),
        numbers={
            "smallest eigenvalue of D": float(f"{bare.min():.9g}"),
            "smallest eigenvalue of D + Ia": float(f"{whole.min():.9g}"),
            "share of poses with D indefinite": indefinite,
            "share that meets the conditions and is indefinite": fooled,
            "median error double, single": [float(f"{double:.3g}"), float(f"{single:.3g}")],
        },
    )


# ------------------------------------------------------------------------------------ section 6.4

_SLIPS = {
    "LMAT sign": "+ LMAT for - LMAT",
    "LMAT rate": "LMAT with G for dG/dt",
    "BMAT": "BMAT without dD/dt",
    "JKMAT rate": "JKMAT with C for dC/dt",
    "JKMAT row 2": "JKMAT row 2 with x5 for x6",
    "HMAT": "HMAT with H for L H / kT",
    "KMAT": "KMAT with H for R H / kT",
    "KMAT row 2": "KMAT row 2 with H3 for H2",
}


def motion_6_4(slips=(), duration: float = 0.5, count: int = 250) -> np.ndarray:
    """Angles (count + 1, 3) [rad] from START by section 6.4's matrices and RK4."""
    q, qd, current = START
    x = np.concatenate([q, qd, acceleration_from_current(q, qd, current, nominal(), VISCOUS)])
    h = duration / count

    def f(x):
        return np.concatenate([x[3:], jerk_6_2(x[:3], x[3:6], x[6:], VOLTS, slips)])

    found = [x[:3]]
    for _ in range(count):
        k1 = f(x)
        k2 = f(x + h / 2 * k1)
        k3 = f(x + h / 2 * k2)
        k4 = f(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        found.append(x[:3])
    return np.array(found)


@experiment("6.4", "The program's P vector: what each misprint of it does", chapter="6")
def program_matrices(context: Context) -> Result:
    """Half a second by section 6.4's matrices, corrected and with each misprint alone."""
    true = motion_6_4()
    runs, rows, numbers = {}, [], {}
    for done, (slip, words) in enumerate(_SLIPS.items()):
        runs[slip] = motion_6_4((slip,))
        apart = np.max(np.abs(runs[slip] - true), axis=0)
        numbers[slip] = [float(f"{value:.6g}") for value in apart]
        rows.append(
            Row(
                f"joints 1, 2, 3 within 0.5 s with {words}",
                "rad",
                None,
                ", ".join(f"{value:.2g}" for value in apart),
                "Greatest distance from the corrected motion.",
            )
        )
        context.progress((done + 1) / len(_SLIPS))
    numbers["q(0.5 s), corrected"] = true[-1].round(8).tolist()
    end = motion("current")[1][-1]
    near = np.max(np.abs(true[-1] - end)) < 1e-6
    rows.insert(
        0,
        Row(
            "q(0.5 s) by the corrected matrices",
            "rad",
            None,
            ", ".join(f"{value:.6f}" for value in true[-1]),
            f"The motion with currents as states ends {'within 1e-6 rad' if near else 'more than 1e-6 rad'} of it.",
        ),
    )
    time = np.linspace(0.0, 0.5, len(true))
    worst = sorted(runs, key=lambda slip: -np.max(np.abs(runs[slip][:, 1] - true[:, 1])))[:3]
    figure = Figure(
        "6.4",
        "Joint 2 by section 6.4's matrices",
        "time [s]",
        "q2 [rad]",
        (
            Curve("corrected", time, true[:, 1]),
            *(Curve(_SLIPS[slip], time, runs[slip][:, 1], "dashed") for slip in worst),
        ),
        note="The three misprints that move joint 2 most; viscous friction 0.3, 0.5, "
        "0.2 N.m.s/rad; 20, -15, 10 V held.",
    )
    return Result(
        summary="By the corrected matrices of section 6.4 the arm moves as it does with currents "
        "as states. Alone, the misprint that does most harm is "
        f"'{_SLIPS[worst[0]]}'; those in the rates of C and G would hardly have been "
        "noticed.",
        rows=tuple(rows),
        figures=(figure,),
        numbers=numbers,
    )
