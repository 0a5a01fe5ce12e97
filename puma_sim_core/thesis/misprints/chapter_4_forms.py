# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Forms of D, C and G: equations 4.9 to 4.47 with their misprints, and the coefficients of section 4.5 for any arm.

The equations stand in `equations.yaml`. In `terms.yaml` each coefficient is a sum of numbers times the functions of
the thesis (C2S2, S2S3S23 ...: :data:`puma_sim_core.arm.printed_coefficients.BASES`), so that its numbers can be held
against those of every parameter set.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache, reduce
from operator import add
from pathlib import Path
from types import CodeType, SimpleNamespace

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.printed_coefficients import BASES, COEFFICIENTS
from puma_sim_core.arm.rigid_body import lumped_constants
from puma_sim_core.errors import ParameterError
from puma_sim_core.files import read_yaml

EQUATIONS = read_yaml(Path(__file__).with_name("equations.yaml"))
#: unit of a coefficient by its first letter
UNITS = {"D": "kg.m^2", "C": "kg.m^2", "G": "N.m"}
#: the print leaves out the last digits of one coefficient; all others have four decimals
_DECIMALS = {-0.007: 3, 0.04581: 5}
_TERMS = read_yaml(Path(__file__).with_name("terms.yaml"))


def symbols(q: Sequence[float], arm: ArmParameters) -> SimpleNamespace:
    """The thesis's symbols at a pose: s2, c2, s3, c3, su, cu (u = q2 + q3), m, x, y, z, k."""
    at = SimpleNamespace(a2=arm.a2, a3=arm.a3, d3=arm.d3, g=arm.gravity, c22=math.cos(2 * q[1]))
    for name, angle in (("2", q[1]), ("3", q[2]), ("u", q[1] + q[2])):
        setattr(at, f"s{name}", math.sin(angle))
        setattr(at, f"c{name}", math.cos(angle))
    for i, link in enumerate(arm.links, start=1):
        setattr(at, f"m{i}", link.mass)
        for axis, place, gyration in zip("xyz", link.centre, link.gyration_squared):
            setattr(at, f"{axis}{i}", place)
            setattr(at, f"k{i}{axis}{axis}", gyration)
    return at


@cache
def _formula(name: str, slips: frozenset[str]) -> CodeType:
    text = EQUATIONS[name]["correct"]
    for slip in sorted(slips):
        correct, printed = EQUATIONS[name]["slips"][slip]
        if text.count(correct) != 1:
            raise ParameterError(f"{text.count(correct)} times {correct!r}", where=f"{name}, {slip}", expected="one")
        text = text.replace(correct, printed)
    return compile(text, f"equation of {name}", "eval")


def evaluate(name: str, s: SimpleNamespace, slips: Iterable[str] = ()) -> float:
    """An equation at these symbols, with the misprints that `slips` names."""
    return eval(_formula(name, frozenset(slips)), {}, vars(s))


def coefficient_terms(arm: ArmParameters) -> dict[str, dict[str, float]]:
    """Numbers by coefficient and function [kg.m^2; G: N.m]; motor inertias are in D11, D22, D33.

    Products of inertia (B4) add terms that the thesis does not have: D12 and C122 then have one more.
    """
    constants = lumped_constants(arm)._asdict()
    return {
        name: {
            basis: reduce(add, (factor * constants[constant] for constant, factor in factors.items()))
            for basis, factors in terms.items()
            if "B4" not in factors or constants["B4"]
        }
        for name, terms in _TERMS.items()
    }


def value(terms: Mapping[str, float], q: ArrayLike) -> np.ndarray:
    """Sum of one coefficient's terms at the angles q (..., 3) [rad]."""
    q2, q3 = np.moveaxis(np.asarray(q, dtype=float), -1, 0)[1:]
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
