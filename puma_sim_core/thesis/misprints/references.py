# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Misprints in captions, numbers of equations and references to other places.

No number of the model depends on them. What a place holds is data (`CONTENTS`), in words of our
own; a reference is proved wrong by the subject that it is given for and the one that stands there.
"""

from __future__ import annotations

from puma_sim_core.thesis.misprints.evidence import Erratum, Evidence

#: what stands where in the thesis
CONTENTS = {
    "section 2.5": "position of point masses",
    "section 2.5.3": "derivatives of the frames",
    "section 2.6": "summary of chapter 2",
    "section 3.3": "meaning of the coefficients",
    "section 6.2": "choice of the integration method",
    "section 6.3": "matrix inversion",
    "section 7.4": "estimation of the radii of gyration",
    "section 7.7": "PID control of single joints",
    "chapter 2": "coordinate frames",
    "chapter 3": "Lagrangian formulation",
    "chapter 8": "conclusions",
    "equation 3.3": "velocity squared of a point",
    "equation 3.17": "potential energy",
    "equation 3.20": "equations of motion",
    "equation 3.23": "inertias D_ij",
    "equation 3.25": "coefficients C_ijk",
    "equation 3.28": "gravity torques",
    "equation 3.29": "C_iji = 0, in chapter 4",
    "equation 4.5": "vector P",
    "equation 4.9": "inertia D11",
    "equation 4.17": "inertia D33",
    "equation 4.18": "C111 = 0",
    "equation 5.9": "third-order equations, element by element",
    "equations 7.2 to 7.4": "PID in discrete forms",
    "equations 7.5 to 7.7": "discrete coefficients from PID values",
    "equation 6.1": "system in state-space form",
    "equation 6.2 of section 6.4": "P in the program's matrices",
    "equation 6.3": "Euler's formula",
    "equation 7.3": "recursive PID",
    "figure 3.2(a)": "arm upright",
    "figure 7.4": "link 3 folded back to joint 2",
    "sections 7.2 to 7.5": "open loop tests",
    "sections 7.3 to 7.9": "open and closed loop tests",
    "table 4.2": "link parameters by Bejczy",
    "plot 7.8": "angles of joint 2, measured and simulated",
    "plot 7.9": "voltage of the test of joint 2",
}

#: equation numbers that the thesis uses for more than one equation, and for what
NUMBERED = {"6.2": ("Taylor series", "P of section 6.4"), "3.25": ("coefficients C_ijk", "D_ij = D_ji")}

#: (Kmax, Tp) in the text of section 7.7 and in the captions of the plots
TEXT = {"7.17": (150, 0.45), "7.18": (220, 0.60), "7.19": (475, 0.40), "7.20": (385, 0.20), "7.21": (270, 0.18)}
CAPTIONS = {"7.17": (150, 0.45), "7.18": (220, 0.60), "7.19": (475, 0.20), "7.20": (385, 0.18), "7.21": (150, 0.45)}
#: joint whose motor voltage a plot shows: by the sections that describe the tests, by its caption
VOLTAGE_PLOTS = {"7.6": 3, "7.9": 2, "7.11": 1, "7.13": 1}
VOLTAGE_CAPTIONS = {"7.6": 3, "7.9": 3, "7.11": 1, "7.13": 1}


def _reference(where, subject, printed, correct, note=""):
    def evidence():
        return Evidence(
            "what the reader finds there",
            "",
            "the subject of the sentence",
            subject,
            CONTENTS[correct],
            CONTENTS.get(printed, "no such place"),
        )

    return Erratum(f"ref {where}", where, printed, correct, evidence, note)


def _twice(number, correct, where):
    def evidence():
        return Evidence(
            f"equations with the number {number}", "", "a number names one equation", 1, 1, len(NUMBERED[number])
        )

    both = " and for ".join(NUMBERED[number])
    return Erratum(f"number {number}", where, f"({number}) for {both}", correct, evidence)


def _caption(plot, note):
    def evidence():
        return Evidence(f"(Kmax, Tp) of plot {plot}", "", "section 7.7, text", TEXT[plot], TEXT[plot], CAPTIONS[plot])

    kmax, period = CAPTIONS[plot]
    return Erratum(
        f"caption {plot}",
        f"caption of plot {plot}",
        f"Kmax = {kmax}, Tp = {period}",
        f"{TEXT[plot][0]}, {TEXT[plot][1]} in the text",
        evidence,
        note,
    )


def _voltage_caption():
    return Evidence(
        "joint whose voltage plot 7.9 shows",
        "",
        "section 7.4.2, text",
        VOLTAGE_PLOTS["7.9"],
        2,
        VOLTAGE_CAPTIONS["7.9"],
    )


_NEITHER = (
    "Text and caption contradict each other; the corrected model reproduces neither, and "
    "which was meant cannot be told."
)

ROWS = (
    _reference("section 3.2.1, masses in a link", "position of point masses", "section 2.6", "section 2.5"),
    _reference("section 3.2.1, link velocities", "derivatives of the frames", "section 2.7", "section 2.5.3"),
    _reference("section 3.3, general equations", "equations of motion", "equation 3.17", "equation 3.20"),
    _reference("section 1.2, conclusions", "conclusions", "chapter 9", "chapter 8"),
    _reference("section 4.3, inertias", "inertias D_ij", "equation 3.29", "equation 3.23"),
    _reference("section 4.3, meaning of the terms", "meaning of the coefficients", "section 3.5.3", "section 3.3"),
    _reference("sections 4.3.2 and 4.3.3, Coriolis terms", "coefficients C_ijk", "equation 4.5", "equation 3.25"),
    _reference("section 4.3.4, gravity terms", "gravity torques", "equation 3.3", "equation 3.28"),
    _reference("section 4.4, frames", "coordinate frames", "chapter 3", "chapter 2"),
    _reference("section 4.4, parameters that were used", "link parameters by Bejczy", "table 4.4", "table 4.2"),
    _reference("chapter 6, choice of Runge-Kutta", "choice of the integration method", "section 6.3", "section 6.2"),
    _reference("section 6.2.1, order of the system", "system in state-space form", "equation 6.3", "equation 6.1"),
    _reference(
        "section 6.4, values of the matrices",
        "P in the program's matrices",
        "equation 6.1",
        "equation 6.2 of section 6.4",
    ),
    _reference("chapter 7, preliminary tests", "open loop tests", "sections 7.3 to 7.9", "sections 7.2 to 7.5"),
    _reference("section 7.4.3, pose", "arm upright", "figure 7.4", "figure 3.2(a)"),
    _reference("section 7.4.1, self inertia", "inertia D33", "equation 4.18", "equation 4.17"),
    _reference("section 7.4.2, responses", "angles of joint 2, measured and simulated", "plot 7.9", "plot 7.8"),
    _reference("section 7.4.4, self inertia of joint 1", "inertia D11", "equation 7.3", "equation 4.9"),
    _reference(
        "section 7.8, PID values",
        "discrete coefficients from PID values",
        "equations 7.2 to 7.4",
        "equations 7.5 to 7.7",
    ),
    _reference("section 7.9, constant PID", "PID control of single joints", "section 7.4", "section 7.7"),
    _twice("6.2", "the second would be (6.11)", "sections 6.2 and 6.4"),
    _twice("3.25", "the second belongs to chapter 4", "sections 3.3.3 and 4.3"),
    Erratum("caption 7.9", "caption of plot 7.9", "voltage of joint 3", "voltage of joint 2", _voltage_caption),
    _caption("7.19", _NEITHER),
    _caption("7.20", _NEITHER),
    _caption("7.21", "The caption repeats joint 1's values, those of plot 7.17."),
)
