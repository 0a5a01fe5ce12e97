# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Numerical coefficients of section 4.5, as printed and with their misprints corrected.

For regression only: they show which parameters the thesis used (Bejczy's, table 4.2, though the
text says the mean of Bejczy and Armstrong) and where its print cannot be right. Nothing is
simulated with them. The diagonal of D holds the motor inertias, as in the thesis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Term(NamedTuple):
    """One product of a coefficient and a function of the angles; 0 where a form lacks it.

    The units are kg.m^2 for D and C, N.m for G; the thesis prints others.
    """

    basis: str
    printed: float
    corrected: float


#: functions of sin and cos of q2, q3 and u = q2 + q3 that multiply the coefficients
BASES = {
    "1": lambda s2, c2, s3, c3, su, cu: 1.0,
    "S2": lambda s2, c2, s3, c3, su, cu: s2,
    "C2": lambda s2, c2, s3, c3, su, cu: c2,
    "S3": lambda s2, c2, s3, c3, su, cu: s3,
    "C3": lambda s2, c2, s3, c3, su, cu: c3,
    "S23": lambda s2, c2, s3, c3, su, cu: su,
    "C23": lambda s2, c2, s3, c3, su, cu: cu,
    "C2^2": lambda s2, c2, s3, c3, su, cu: c2 * c2,
    "S23^2": lambda s2, c2, s3, c3, su, cu: su * su,
    "C23^2": lambda s2, c2, s3, c3, su, cu: cu * cu,
    "C22": lambda s2, c2, s3, c3, su, cu: c2 * c2 - s2 * s2,
    "C2S2": lambda s2, c2, s3, c3, su, cu: c2 * s2,
    "C3S3": lambda s2, c2, s3, c3, su, cu: c3 * s3,
    "C2S23": lambda s2, c2, s3, c3, su, cu: c2 * su,
    "S2S23": lambda s2, c2, s3, c3, su, cu: s2 * su,
    "C2C23": lambda s2, c2, s3, c3, su, cu: c2 * cu,
    "C23S23": lambda s2, c2, s3, c3, su, cu: cu * su,
    "S2S3S23": lambda s2, c2, s3, c3, su, cu: s2 * s3 * su,
}


def _as_printed(**terms):
    return tuple(Term(basis, value, value) for basis, value in terms.items())


_D13 = _as_printed(S23=-0.007, C23=-0.1596)
_COMMON = (Term("1", 0.0203, 0.0203), Term("C3S3", 0.5322, 0.5322), Term("S2S3S23", -1.0643, -1.0643))

COEFFICIENTS = {
    # C2 without its square; -2 m2 a2 y2 C2 S2 left out, as in equation 4.9
    "D11": (
        Term("1", 0.7766 + 1.7209, 0.7766 + 1.7209),
        Term("C2", 2.1007, 0.0),
        Term("C2^2", 0.0, 2.1007),
        Term("C2S2", 0.0, -0.0966),
        Term("S23^2", 0.5323, 0.5323),
        Term("C2C23", -0.0330, -0.0330),
        Term("C23S23", -0.0405, -0.0405),
        Term("C2S23", 0.9161, 0.9161),
    ),
    # 2 m3 a3 x3 was taken with a3 = +0.0191
    "D22": (Term("1", 2.3616 + 3.0574, 2.3616 + 3.0501), *_as_printed(S3=0.9161, C3=-0.0331)),
    "D33": _as_printed(**{"1": 0.5827 + 0.5468}),
    "D12": (Term("S2", 2.4492, 2.4492), *_D13),
    "D13": _D13,
    "D23": _as_printed(**{"1": 0.5468, "S3": 0.4581, "C3": -0.0165}),
    # printed under the label C123; C2C23 with a digit too many, C23 without its square
    "C112": (
        *_COMMON,
        Term("C2S2", -1.5685, -1.5685),
        Term("C2S23", 0.0331, 0.0331),
        Term("C2C23", 0.04581, 0.4581),
        Term("S2S23", -0.4581, -0.4581),
        Term("C22", -0.0483, -0.0483),
        Term("C23", -0.0405, 0.0),
        Term("C23^2", 0.0, -0.0405),
        Term("S3", -0.0166, -0.0166),
    ),
    # equation 4.20 has no term in S3
    "C113": (
        *_COMMON,
        Term("C2S2", 0.5322, 0.5322),
        Term("C2S23", 0.0166, 0.0166),
        Term("C2C23", 0.4581, 0.4581),
        Term("C23^2", -0.0405, -0.0405),
        Term("S3", -0.0166, 0.0),
    ),
    # m3 a2 (y3 + d3) is left out, as in equation 4.22
    "C122": (Term("C2", 1.9686, 2.4492), *_as_printed(S23=0.1596, C23=-0.007)),
    "C123": _as_printed(S23=0.1596, C23=-0.007),
    "C133": _as_printed(S23=0.1596, C23=-0.007),
    "C223": _as_printed(C3=0.4581, S3=0.0165),
    "C233": _as_printed(C3=0.4581, S3=0.0165),
    "G2": _as_printed(C2=-52.1060, S2=1.0972, C23=0.3761, S23=-10.4068),
    "G3": _as_printed(C23=0.3761, S23=-10.4068),
}


def coefficient(name: str, q, corrected: bool = False):
    """One coefficient of section 4.5 at the angles q (..., 3) [rad]; name: a key of COEFFICIENTS.

    Returns (...) [kg.m^2, for G2 and G3 N.m].

    Raises
    ------
    KeyError : a name that the section does not list.
    """
    q2, q3 = np.asarray(q, dtype=float)[..., 1], np.asarray(q, dtype=float)[..., 2]
    sines = np.sin(q2), np.cos(q2), np.sin(q3), np.cos(q3), np.sin(q2 + q3), np.cos(q2 + q3)
    return sum(
        (term.corrected if corrected else term.printed) * BASES[term.basis](*sines) for term in COEFFICIENTS[name]
    )


def misprints() -> list[str]:
    """Names of the coefficients whose print differs from what the parameters give."""
    return [name for name, terms in COEFFICIENTS.items() if any(term.printed != term.corrected for term in terms)]
