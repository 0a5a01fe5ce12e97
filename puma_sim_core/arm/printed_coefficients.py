# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Numerical coefficients of section 4.5, as printed and with their misprints corrected.

For regression only: they show which parameters the thesis used (Bejczy's, table 4.2, though the
text says the mean of Bejczy and Armstrong) and where its print cannot be right. Nothing is
simulated with them. The diagonal of D holds the motor inertias, as in the thesis.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.files import read_yaml


class Term(NamedTuple):
    """One product of a coefficient and a function of the angles; 0 where a form lacks it.

    The units are kg.m^2 for D and C, N.m for G; the thesis prints others.
    """

    basis: str
    printed: float
    corrected: float


#: functions of sin and cos of q2, q3 and u = q2 + q3 that multiply the coefficients
BASES: dict[str, Callable[..., Any]] = {
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

#: name of a coefficient -> its terms
COEFFICIENTS: dict[str, tuple[Term, ...]] = {
    name: tuple(Term(basis, *(pair if isinstance(pair, list) else (pair, pair))) for basis, pair in terms.items())
    for name, terms in read_yaml(Path(__file__).with_suffix(".yaml")).items()
}


def coefficient(name: str, q: ArrayLike, corrected: bool = False) -> Any:
    """One coefficient of section 4.5 at the angles q (..., 3) [rad]; name: a key of COEFFICIENTS.

    Returns (...) [kg.m^2, for G2 and G3 N.m].

    Raises KeyError: a name that the section does not list.
    """
    _, q2, q3 = np.moveaxis(np.asarray(q, dtype=float), -1, 0)
    sines = np.sin(q2), np.cos(q2), np.sin(q3), np.cos(q3), np.sin(q2 + q3), np.cos(q2 + q3)
    return sum(
        (term.corrected if corrected else term.printed) * BASES[term.basis](*sines) for term in COEFFICIENTS[name]
    )
