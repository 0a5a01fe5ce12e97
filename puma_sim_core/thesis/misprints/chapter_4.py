# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Misprints of chapter 4: the coefficients of the arm in symbols and in numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from puma_sim_core.arm import printed_coefficients as section_4_5
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.thesis.misprints import chapter_4_forms as forms
from puma_sim_core.thesis.misprints import reference
from puma_sim_core.thesis.misprints.evidence import Erratum, Evidence
from puma_sim_core.thesis.misprints.reference import POSES, RATES, at_poses, nominal

_MOTION = "Christoffel symbols of D"
_BODIES = "kinetic energy of the bodies"


def _entry(name):
    """The independent value of D22, C113, G2 ... at a pose."""
    indices = tuple(int(digit) - 1 for digit in name[1:])
    source = {"D": reference.inertia, "C": reference.coriolis, "G": reference.gravity}[name[0]]
    return lambda q: source(q)[indices]


def _form(name, slip, label=None):
    """Evidence for one slip in an equation; label : what the print calls the term."""

    def evidence():
        form = getattr(forms, name.lower())
        by = {"D": _BODIES, "C": _MOTION, "G": "derivative of the potential energy"}[name[0]]
        printed = at_poses(_entry(label)) if label else at_poses(lambda q: form(forms.symbols(q, nominal()), {slip}))
        return Evidence(
            name,
            "N.m" if name[0] == "G" else "kg.m^2",
            by,
            at_poses(_entry(name)),
            at_poses(lambda q: form(forms.symbols(q, nominal()))),
            printed,
            1e-10,
        )

    return evidence


def _equation(name, correct, printed):
    """Evidence for an equation that only points at another coefficient."""

    def evidence():
        return Evidence(name, "kg.m^2", _MOTION, at_poses(_entry(name)), at_poses(correct), at_poses(printed), 1e-10)

    return evidence


def _second_row():
    def rows(q, qd, second):
        c = reference.coriolis(q)
        return np.array([qd @ c[i] @ qd for i in (0, second, 2)]) + reference.gravity(q)

    states = list(zip(POSES, RATES))
    still = np.zeros(3)
    return Evidence(
        "P(q, qd)",
        "N.m",
        "torque of the bodies at no acceleration",
        np.array([reference.torque(q, qd, still) for q, qd in states]),
        np.array([rows(q, qd, 1) for q, qd in states]),
        np.array([rows(q, qd, 0) for q, qd in states]),
        1e-10,
    )


def _shape_of_p():
    rows = reference.coriolis(POSES[0]) @ RATES[0] @ RATES[0] + reference.gravity(POSES[0])
    return Evidence(
        "shape of P", "", "torques of the three joints, one below the other", rows[:, None].shape, (3, 1), (1, 3)
    )


def _tautology():
    """How many equations for (D13, D31) the line adds."""

    def rank(row):
        return int(np.linalg.matrix_rank(np.array([row], dtype=float)))

    d = reference.inertia(POSES[0])
    needed = int(abs(d[2, 0] - d[0, 2]) < 1e-12)
    return Evidence(
        "equations that the line gives for D31", "", "symmetry of D, computed", needed, rank([-1, 1]), rank([0, 0])
    )


def _undefined(correct, printed, wanted):
    def evidence():
        return Evidence(
            "terms of the equation",
            "",
            "the legend that stands below the equation",
            frozenset(wanted),
            frozenset(correct),
            frozenset(printed),
        )

    return evidence


_TERMS = ("D_ij", "Ia_i", "C_ijk", "G_i")


def _fitted(name):
    """Coefficients of section 4.5's functions in the independent D, C or G."""
    bases = [term.basis for term in section_4_5.COEFFICIENTS[name]]
    q2, q3 = POSES[:, 1], POSES[:, 2]
    sines = [f(angle) for angle in (q2, q3, q2 + q3) for f in (np.sin, np.cos)]
    columns = np.column_stack([np.broadcast_to(section_4_5.BASES[basis](*sines), q2.shape) for basis in bases])
    value = at_poses(_entry(name))
    if name in ("D11", "D22", "D33"):
        value = value + nominal().motor_inertia[int(name[1]) - 1]
    return dict(zip(bases, np.linalg.lstsq(columns, value, rcond=None)[0]))


def _number(name, *bases):
    """Evidence for printed coefficients; the tolerance is that of four printed digits."""

    def evidence():
        fitted = _fitted(name)
        terms = {term.basis: term for term in section_4_5.COEFFICIENTS[name]}
        return Evidence(
            f"coefficient of {', '.join(bases)} in {name}",
            "kg.m^2",
            "fit to the bodies' own D and C",
            [fitted[basis] for basis in bases],
            [terms[basis].corrected for basis in bases],
            [terms[basis].printed for basis in bases],
            2e-4,
        )

    return evidence


def d22_constant(a3_of_x3: float) -> float:
    """Constant of D22 [kg.m^2] with this a3 [m] in the term 2 m3 a3 x3 alone."""
    link = nominal().links[2]
    return _fitted("D22")["1"] + 2 * link.mass * link.centre[0] * (a3_of_x3 - nominal().a3)


def _sign_of_a3():
    return Evidence(
        "constant of D22",
        "kg.m^2",
        "fit to the bodies' own D",
        d22_constant(nominal().a3),
        2.3616 + 3.0501,
        2.3616 + 3.0574,
        2e-4,
    )


def _label_4_5():
    return Evidence(
        "C123",
        "kg.m^2",
        _MOTION,
        at_poses(_entry("C123")),
        at_poses(lambda q: section_4_5.coefficient("C123", q, True)),
        at_poses(lambda q: section_4_5.coefficient("C112", q, True)),
        2e-4,
    )


def _exponents(value):
    """Exponents of mass, length and time, from the value in units that are 2 times smaller."""
    arm = nominal()

    def scaled(mass=1.0, length=1.0, time=1.0):
        links = tuple(
            replace(
                link,
                mass=link.mass * mass,
                centre=tuple(length * x for x in link.centre),
                gyration_squared=tuple(length**2 * k for k in link.gyration_squared),
            )
            for link in arm.links
        )
        return replace(
            arm,
            links=links,
            a2=arm.a2 * length,
            a3=arm.a3 * length,
            d3=arm.d3 * length,
            gravity=arm.gravity * length / time**2,
        )

    base = value(arm)
    return [np.log2(value(scaled(**{unit: 2.0})) / base) for unit in ("mass", "length", "time")]


def _unit_of_inertia():
    return Evidence(
        "exponents of kg, m and s in D and C",
        "",
        "D in units that are halved",
        _exponents(lambda arm: reference.inertia(POSES[0], arm)[1, 1]),
        [1.0, 2.0, 0.0],
        [1.0, 1.0, 0.0],
        1e-9,
    )


def _unit_of_gravity():
    return Evidence(
        "exponents of kg, m and s in G",
        "",
        "G in units that are halved",
        _exponents(lambda arm: reference.gravity(POSES[0], arm)[1]),
        [1.0, 2.0, -2.0],
        [1.0, 1.0, 1.0],
        1e-9,
    )


def _parameters_used():
    """Constants of section 4.5 that are printed without a slip, for two sets."""

    def constants(arm):
        link2, link3 = arm.links[1:]
        reach = link3.mass * (arm.a3 + link3.centre[0])
        return [
            link3.mass * (link3.gyration_squared[1] + arm.a3**2 + 2 * arm.a3 * link3.centre[0]),
            link3.mass * arm.a2 * link3.centre[2],
            link2.mass * arm.a2 * link2.centre[2] + link3.mass * arm.a2 * (link3.centre[1] + arm.d3),
            arm.gravity * link3.mass * link3.centre[2],
            -arm.gravity * reach,
        ]

    return Evidence(
        "constants of D33, D23 (S3), D12 (S2), G3 (S23, C23)",
        "kg.m^2 and N.m",
        "the numbers printed in section 4.5",
        [0.5468, 0.4581, 2.4492, 10.4068, 0.3761],
        constants(nominal()),
        constants(load_parameters("average")),
        2e-4,
    )


def _agreement_of_sets():
    one, two = load_parameters("bejczy"), load_parameters("armstrong")
    worst = max(
        abs(b - a) / abs(a)
        for first, second in zip(one.links, two.links)
        for a, b in zip(first.centre + first.gyration_squared, second.centre + second.gyration_squared)
        if a
    )
    return Evidence(
        "greatest difference of tables 4.2 and 4.3 in rows 1, 2 and 3*",
        "%",
        "the two tables",
        100 * worst,
        87.0,
        12.0,
        0.1,
    )


ROWS = (
    Erratum(
        "4.1 terms",
        "equations 4.1 and 5.4 to 5.7",
        "D_i and D_ijk",
        "G_i and C_ijk",
        _undefined(_TERMS, ("D_ij", "Ia_i", "D_ijk", "D_i"), _TERMS),
        "4.1 prints D_i, 5.4 to 5.7 print both; the legends define G_i and C_ijk.",
    ),
    Erratum("4.5 row 2", "equation 4.5, second row", "qd' C^1 qd + G2", "qd' C^2 qd + G2", _second_row),
    Erratum("4.5 shape", "equation 4.5, P", "in R^(1 x 3)", "in R^(3 x 1)", _shape_of_p),
    Erratum(
        "4.9 k1zz",
        "equation 4.9 (and 7.4.3)",
        "m1 k1zz",
        "m1 k1yy",
        _form("D11", "k1zz"),
        "Joint 1 turns link 1 about y1 (alpha1 = -90 deg).",
    ),
    Erratum("4.9 d3", "equation 4.9 (and 7.4.3)", "m3 d3", "m3 d3^2", _form("D11", "d3")),
    Erratum(
        "4.9 y2",
        "equation 4.9 (and 7.4.3)",
        "no term in y2",
        "- 2 m2 a2 y2 S2 C2",
        _form("D11", "no y2"),
        "Its derivative does stand in equation 4.19.",
    ),
    Erratum("4.13 a2", "equation 4.13 (and 7.4.2), m2 bracket", "a2", "a2^2", _form("D22", "a2")),
    Erratum("4.13 a3", "equation 4.13 (and 7.4.2), m3 bracket", "a3", "a3^2", _form("D22", "a3")),
    Erratum("4.13 k3zz", "equation 4.13 (and 7.4.2)", "k3zz", "k3yy", _form("D22", "k3zz")),
    Erratum("4.14 k3zz", "equation 4.14", "k3zz", "k3yy", _form("D23", "k3zz")),
    Erratum("4.17 k3zz", "equation 4.17 (and 7.4.1)", "k3zz", "k3yy", _form("D33", "k3zz")),
    Erratum("4.15 D31", "equation 4.15", "D31 = D31", "D31 = D13", _tautology),
    Erratum("4.19 a2", "equation 4.19, m2 bracket", "a2", "a2^2", _form("C112", "a2")),
    Erratum("4.19 S2C3", "equation 4.19, k3xx bracket", "S2 C3", "C3 S3", _form("C112", "S2C3")),
    Erratum(
        "4.19 k3zz",
        "equation 4.19, second half of the k3xx bracket",
        "k3xx",
        "k3zz",
        _form("C112", "no k3zz"),
        "A factor is missing, so that two brackets ran together.",
    ),
    Erratum("4.19 S23", "equation 4.19", "+ a2 a3 S23", "+ a2 a3 S3", _form("C112", "a2a3S23")),
    Erratum("4.19 2a3", "equation 4.19", "2 a3 S2 S3 S23", "2 a3^2 S2 S3 S23", _form("C112", "2a3")),
    Erratum("4.19 C2S3", "equation 4.19, last bracket", "C2 S2 + C2 S3", "C2 S2 + C3 S3", _form("C112", "C2S3")),
    Erratum("4.20 k3yy", "equation 4.20", "k3yy", "k3zz", _form("C113", "k3yy")),
    Erratum("4.20 2a3", "equation 4.20", "2 a3 S2 S3 S23", "2 a3^2 S2 S3 S23", _form("C113", "2a3")),
    Erratum("4.22 label", "equation 4.22, left side", "C112", "C122", _form("C122", "", label="C112")),
    Erratum("4.22 term", "equation 4.22", "no term in y3 + d3", "+ m3 a2 (y3 + d3) C2", _form("C122", "no y3 + d3")),
    Erratum(
        "4.30 C211",
        "equation 4.30",
        "C211 = C212",
        "C221 = C212 = 0",
        _equation("C211", lambda q: -_entry("C112")(q), _entry("C212")),
        "C211 is -C112 (equation 4.27), which is not zero.",
    ),
    Erratum("4.32 S2", "equation 4.32", "S2", "S3", _form("C223", "S2")),
    Erratum(
        "4.36 C133",
        "equation 4.36",
        "C311 = -C133",
        "C311 = -C113",
        _equation("C311", lambda q: -_entry("C113")(q), lambda q: -_entry("C133")(q)),
    ),
    Erratum("4.46 y3", "equation 4.46", "y3 S2", "y2 S2", _form("G2", "y3")),
    Erratum(
        "4.4 average",
        "section 4.4, parameters of the numbers",
        "the average of Armstrong and Bejczy (table 4.4, which is not there)",
        "Bejczy alone: table 4.2, rows 1, 2 and 3*",
        _parameters_used,
    ),
    Erratum(
        "4.4 12%",
        "section 4.4, Bejczy and Armstrong differ by at most",
        "12 %",
        "87 % (y of row 3*), 12.8 % in the k^2",
        _agreement_of_sets,
        "Rows 1, 2 and 3* of tables 4.2 and 4.3.",
    ),
    Erratum("4.5 D11 C2", "section 4.5.1, D11", "2.1007 C2", "2.1007 C2^2", _number("D11", "C2", "C2^2")),
    Erratum("4.5 D11 C2S2", "section 4.5.1, D11", "no term in C2 S2", "- 0.0966 C2 S2", _number("D11", "C2S2")),
    Erratum(
        "4.5 D22", "section 4.5.1, D22", "3.0574", "3.0501", _sign_of_a3, "2 m3 a3 x3 was taken with a3 = +0.0191 m."
    ),
    Erratum("4.5 label", "section 4.5.2, first left side", "C123", "C112", _label_4_5),
    Erratum("4.5 C112 C2C23", "section 4.5.2, C112", "0.04581 C2 C23", "0.4581 C2 C23", _number("C112", "C2C23")),
    Erratum("4.5 C112 C23", "section 4.5.2, C112", "-0.0405 C23", "-0.0405 C23^2", _number("C112", "C23", "C23^2")),
    Erratum(
        "4.5 C113 S3",
        "section 4.5.2, C113",
        "- 0.0166 S3",
        "no such term",
        _number("C113", "S3"),
        "Equation 4.20 has none; it belongs to C112.",
    ),
    Erratum(
        "4.5 C122",
        "section 4.5.2, C122",
        "1.9686 C2",
        "2.4492 C2",
        _number("C122", "C2"),
        "The term that equation 4.22 leaves out.",
    ),
    Erratum("4.5 unit D", "section 4.5.4, unit of D and C", "kg.m", "kg.m^2", _unit_of_inertia),
    Erratum("4.5 unit G", "section 4.5.4, unit of G", "kg.m.s", "N.m", _unit_of_gravity),
)
