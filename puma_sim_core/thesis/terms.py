# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The coefficients of section 4.5 for any arm: each D, C and G as numbers times sines and cosines.

The functions are those of the thesis (C2S2, S2S3S23 and so on, the keys of
:data:`puma_sim_core.arm.printed_coefficients.BASES`), so that its numbers can be held against those of
every parameter set.
"""

from __future__ import annotations

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.printed_coefficients import BASES, COEFFICIENTS
from puma_sim_core.arm.rigid_body import lumped_constants

#: unit of a coefficient by its first letter
UNITS = {"D": "kg.m^2", "C": "kg.m^2", "G": "N.m"}
#: the print leaves out the last digits of one coefficient; all others have four decimals
_DECIMALS = {-0.007: 3, 0.04581: 5}


def coefficient_terms(arm: ArmParameters) -> dict[str, dict[str, float]]:
    """Numbers by coefficient and function [kg.m^2; G: N.m]; motor inertias are in D11, D22, D33.

    Products of inertia add terms that the thesis does not have: D12 and C122 then have one more.
    """
    k = lumped_constants(arm)
    # C113 and C112 are halves of the derivatives of D11, written in the thesis's functions:
    # S23 C23 = C2 S2 + C3 S3 - 2 S2 S3 S23 and S2 C23 = C2 S23 - S3
    common = {"1": -k.A4 / 2, "C3S3": -k.A3, "S2S3S23": 2 * k.A3, "C23^2": k.A4, "C2C23": k.A6 / 2}
    outer = {"S23": -k.B2, "C23": k.B1}
    side = {"S23": k.B1, "C23": k.B2}
    slope = {"C3": k.E2, "S3": -k.E1}
    forearm = {"C23": k.g1, "S23": k.g2}
    return {
        "D11": {
            "1": k.A0 + k.A3,
            "C2^2": k.A1,
            "C2S2": k.A2,
            "S23^2": -k.A3,
            "C2C23": k.A5,
            "C23S23": k.A4,
            "C2S23": k.A6,
        },
        "D22": {"1": k.E3, "S3": 2 * k.E2, "C3": 2 * k.E1},
        "D33": {"1": k.E4},
        "D12": {"S2": k.B3, **({"C2": k.B4} if k.B4 else {}), **side},
        "D13": side,
        "D23": {"1": k.E0, "S3": k.E2, "C3": k.E1},
        "C112": {**common, "C2S2": -k.A3 - k.A1, "C2S23": -k.A5, "S2S23": -k.A6 / 2, "C22": k.A2 / 2, "S3": k.A5 / 2},
        "C113": {**common, "C2S2": -k.A3, "C2S23": -k.A5 / 2},
        "C122": {"C2": k.B3, **({"S2": -k.B4} if k.B4 else {}), **outer},
        "C123": outer,
        "C133": outer,
        "C223": slope,
        "C233": slope,
        "G2": {"C2": k.g3, "S2": k.g4, **forearm},
        "G3": forearm,
    }


def value(terms: dict[str, float], q) -> np.ndarray:
    """Sum of one coefficient's terms at the angles q (..., 3) [rad]."""
    q = np.asarray(q, dtype=float)
    q2, q3 = q[..., 1], q[..., 2]
    sines = np.sin(q2), np.cos(q2), np.sin(q3), np.cos(q3), np.sin(q2 + q3), np.cos(q2 + q3)
    return sum(number * BASES[basis](*sines) for basis, number in terms.items()) + 0.0 * q2


def printed_terms() -> list[tuple[str, str, float, float]]:
    """(coefficient, function, printed number, half a unit of its last digit) of section 4.5.

    A function that the print lacks stands with 0 and the accuracy of four decimals.
    """
    return [
        (name, term.basis, term.printed, 0.5 * 10.0 ** -_DECIMALS.get(term.printed, 4))
        for name, terms in COEFFICIENTS.items()
        for term in terms
    ]


def is_misprint(name: str, basis: str) -> bool:
    """Whether the print of this term cannot come from any parameters, whatever they are."""
    return any(term.basis == basis and term.printed != term.corrected for term in COEFFICIENTS[name])
