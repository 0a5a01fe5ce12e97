# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The errata of the thesis: every misprint with its proof and its effect on the numbers."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from puma_sim_core.arm import printed_coefficients as section_4_5
from puma_sim_core.arm.third_order import acceleration_from_current, current_rate, joint_torque_per_ampere
from puma_sim_core.thesis.misprints import chapter_4, chapter_5, chapter_6, chapter_7, chapters_2_3, references
from puma_sim_core.thesis.misprints.evidence import Erratum
from puma_sim_core.thesis.misprints.reference import nominal
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Result, Row

#: every misprint, in the order of the thesis; those that touch no number come last
ERRATA: tuple[Erratum, ...] = (
    *chapters_2_3.ROWS,
    *chapter_4.ROWS,
    *chapter_5.ROWS,
    *chapter_6.ROWS,
    *chapter_7.ROWS,
    *references.ROWS,
)

_START = np.array([0.1, -0.4, 0.7, 0.3, -0.2, 0.5, 0.5, -1.0, 0.8])
_VOLTS = np.array([20.0, -15.0, 10.0])


def section_4_5_acceleration(q, qd, current, corrected: bool) -> np.ndarray:
    """Joint accelerations (3,) [rad/s^2] by the numbers of section 4.5, as printed or corrected.

    Their labels are read as they are meant; only the numbers and functions are the print's.
    """

    def number(name):
        return section_4_5.coefficient(name, q, corrected)

    d12, d13, d23 = number("D12"), number("D13"), number("D23")
    mass = np.array([[number("D11"), d12, d13], [d12, number("D22"), d23], [d13, d23, number("D33")]])
    c112, c113, c223 = number("C112"), number("C113"), number("C223")
    w1, w2, w3 = qd
    both = w3 * (2 * w2 + w3)
    bias = np.array(
        [
            2 * w1 * (c112 * w2 + c113 * w3) + number("C122") * w2**2 + number("C123") * both,
            -c112 * w1**2 + c223 * both + number("G2"),
            -c113 * w1**2 - c223 * w2**2 + number("G3"),
        ]
    )
    return np.linalg.solve(mass, joint_torque_per_ampere(nominal()) * current - bias)


def motion_of_section_4_5(corrected: bool | None, duration: float = 1.0):
    """(time (n,) [s], q (n, 3) [rad]) from a moving start with constant voltages.

    corrected : which numbers; None for the model itself.
    """
    arm = nominal()

    def f(_, x):
        q, qd, current = x[:3], x[3:6], x[6:]
        qdd = (
            acceleration_from_current(q, qd, current, arm)
            if corrected is None
            else section_4_5_acceleration(q, qd, current, corrected)
        )
        return np.concatenate([qd, qdd, current_rate(qd, current, _VOLTS, arm)])

    time = np.linspace(0.0, duration, 101)
    run = solve_ivp(f, (0.0, duration), _START, t_eval=time, method="RK45", rtol=1e-6, atol=1e-9)
    return time, run.y[:3].T


@experiment("errata", "Every misprint of the thesis, proved, with its effect")
def run(context: Context) -> Result:
    """Evaluate the proof of each row and gather the effects."""
    rows, numbers, unproved = [], {}, []
    for done, erratum in enumerate(ERRATA):
        evidence = erratum.evidence()
        note = " ".join(filter(None, (evidence.effect(), f"Shown by: {evidence.by}.", erratum.note)))
        if not evidence.proved:
            unproved.append(erratum.key)
            note = f"NOT PROVED. {note}"
        rows.append(Row(erratum.where, "", erratum.printed, erratum.correct, note))
        error = evidence.printed_error
        numbers[erratum.key] = {
            "quantity": evidence.quantity,
            "unit": evidence.unit,
            # rounding of the last digits is no property of the misprint
            "error_of_the_print": float(f"{error:.9g}") if np.isfinite(error) else None,
            "proved": evidence.proved,
        }
        context.progress(0.6 * (done + 1) / len(ERRATA))
    time, true = motion_of_section_4_5(None)
    _, corrected = motion_of_section_4_5(True)
    context.progress(0.8)
    _, printed = motion_of_section_4_5(False)
    apart = np.max(np.abs(printed - true), axis=0)
    residue = np.max(np.abs(corrected - true), axis=0)
    rows.append(
        Row(
            "motion of joints 1, 2, 3 with section 4.5's numbers, first second",
            "rad",
            _triple(apart),
            _triple(residue),
            "Greatest distance from the corrected model, of the printed numbers and of the "
            "numbers with their misprints mended; those have four digits.",
        )
    )
    numbers["motion with the numbers of section 4.5"] = {
        "printed_apart_rad": apart.round(9).tolist(),
        "corrected_apart_rad": residue.round(9).tolist(),
    }
    summary = (
        f"{len(ERRATA)} misprints and slips, {len(ERRATA) - len(unproved)} of them proved by "
        f"computation; {len(references.ROWS)} are captions and references that touch no number. "
        f"With the numbers of section 4.5 as printed, joints 1, 2, 3 part from the corrected "
        f"model by {_triple(apart)} rad within a second. Whether the author or the scan is at "
        f"fault is not always to be told: a row says what our text of the thesis has."
    )
    figure = Figure(
        "4.5",
        "Motion with the numbers of section 4.5",
        "time [s]",
        "angle [rad]",
        tuple(
            curve
            for j in range(3)
            for curve in (
                Curve(f"joint {j + 1}, corrected", time, corrected[:, j]),
                Curve(f"joint {j + 1}, as printed", time, printed[:, j], "dashed"),
            )
        ),
        note="20, -15 and 10 V held, from a moving start.",
    )
    numbers["rows"] = len(ERRATA)
    numbers["unproved"] = unproved
    numbers["rows_on_numbers_and_equations"] = len(ERRATA) - len(references.ROWS)
    context.progress(1.0)
    return Result(summary=summary, rows=tuple(rows), figures=(figure,), numbers=numbers)


def _triple(values) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
