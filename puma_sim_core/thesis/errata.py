# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The errata of the thesis: every misprint with its proof and its effect on the numbers."""

import numpy as np
from scipy.integrate import solve_ivp

from puma_sim_core.arm import printed_coefficients as section_4_5
from puma_sim_core.arm.third_order import acceleration_from_current, current_rate, joint_torque_per_ampere
from puma_sim_core.thesis.misprints import chapter_4, chapter_5, chapter_6, chapter_7, chapters_2_3, references
from puma_sim_core.thesis.misprints.evidence import Erratum
from puma_sim_core.thesis.misprints.reference import nominal
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Result, significant
from puma_sim_core.thesis.wording import Words

words = Words(__name__)

_CHAPTERS = (chapters_2_3, chapter_4, chapter_5, chapter_6, chapter_7, references)
#: every misprint, in the order of the thesis; those that touch no number come last
ERRATA: tuple[Erratum, ...] = tuple(erratum for chapter in _CHAPTERS for erratum in chapter.ROWS)

_START = np.array([0.1, -0.4, 0.7, 0.3, -0.2, 0.5, 0.5, -1.0, 0.8])
_VOLTS = np.array([20.0, -15.0, 10.0])


def motion_of_section_4_5(corrected: bool | None, duration: float = 1.0):
    """(time (n,) [s], q (n, 3) [rad]) from a moving start with constant voltages.

    corrected : with the numbers of section 4.5, as printed or corrected (their labels are read as they are
    meant); None for the model itself.
    """

    def acceleration(q, qd, current):
        if corrected is None:
            return acceleration_from_current(q, qd, current, nominal())
        n = {name: section_4_5.coefficient(name, q, corrected) for name in section_4_5.COEFFICIENTS}
        mass = [[n["D11"], n["D12"], n["D13"]], [n["D12"], n["D22"], n["D23"]], [n["D13"], n["D23"], n["D33"]]]
        w1, w2, w3 = qd
        both = w3 * (2 * w2 + w3)
        bias = [
            2 * w1 * (n["C112"] * w2 + n["C113"] * w3) + n["C122"] * w2**2 + n["C123"] * both,
            -n["C112"] * w1**2 + n["C223"] * both + n["G2"],
            -n["C113"] * w1**2 - n["C223"] * w2**2 + n["G3"],
        ]
        return np.linalg.solve(mass, joint_torque_per_ampere(nominal()) * current - bias)

    def rates(_, x):
        q, qd, current = np.split(x, 3)
        return np.concatenate([qd, acceleration(q, qd, current), current_rate(qd, current, _VOLTS, nominal())])

    time = np.linspace(0.0, duration, 101)
    run = solve_ivp(rates, (0.0, duration), _START, t_eval=time, method="RK45", rtol=1e-6, atol=1e-9)
    return time, run.y[:3].T


@words.experiment("errata")
def run(context: Context) -> Result:
    """Evaluate the proof of each row and gather the effects."""
    rows, numbers, unproved = [], {}, []
    for done, erratum in enumerate(ERRATA, start=1):
        evidence = erratum.evidence()
        if not evidence.proved:
            unproved.append(erratum.key)
        note = ["NOT PROVED."] * (not evidence.proved) + [evidence.effect(), f"Shown by: {evidence.by}.", erratum.note]
        rows.append(words.row("erratum", erratum=erratum, note=" ".join(filter(None, note))))
        error = evidence.printed_error
        numbers[erratum.key] = {
            "quantity": evidence.quantity,
            "unit": evidence.unit,
            # rounding of the last digits is no property of the misprint
            "error_of_the_print": significant(error, 9) if np.isfinite(error) else None,
            "proved": evidence.proved,
        }
        context.progress(0.6 * done / len(ERRATA))
    (time, true), (_, corrected), (_, printed) = map(motion_of_section_4_5, (None, True, False))
    apart, residue = (np.max(np.abs(q - true), axis=0) for q in (printed, corrected))
    rows.append(words.row("motion", apart=apart, residue=residue))
    numbers["motion with the numbers of section 4.5"] = {
        "printed_apart_rad": apart.round(9),
        "corrected_apart_rad": residue.round(9),
    }
    numbers["rows"], numbers["unproved"] = len(ERRATA), unproved
    numbers["rows_on_numbers_and_equations"] = len(ERRATA) - len(references.ROWS)
    curves = [
        Curve(f"joint {j + 1}, {name}", time, q[:, j], style)
        for j in range(3)
        for name, q, style in (("corrected", corrected, "line"), ("as printed", printed, "dashed"))
    ]
    context.progress(1.0)
    count = {"count": len(ERRATA), "proved": len(ERRATA) - len(unproved), "references": len(references.ROWS)}
    return words.result("errata", rows, [words.figure("4.5", curves)], numbers, apart=apart, **count)
