# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What proves a misprint: a reference beside the corrected and the printed form.

Errata have two halves: texts and numbers in a YAML file, proofs in the module of their chapter. An
entry of a file has the fields of :class:`Erratum`. Its ``proof: NAME`` is the function ``prove_NAME``,
which returns the reference, the correct and the printed value; ``given`` holds the arguments
(``{low: 0, high: 1}`` is a range).
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np

from puma_sim_core.errors import ParameterError
from puma_sim_core.files import read_yaml

#: a printed form must miss the reference by so many tolerances; anything less proves nothing
CLEARANCE = 5.0
#: proofs that any file may name: names of a list, in any order, and values that stand in the file
_SHARED: dict[str, Any] = {
    "names": lambda reference, correct, printed: (frozenset(reference), frozenset(correct), frozenset(printed)),
    "as_given": lambda reference, correct, printed: (reference, correct, printed),
}


@dataclass(frozen=True)
class Between:
    """A reference that is a range: what the text or physics demands of a number."""

    low: float
    high: float

    def __str__(self) -> str:
        if math.isinf(self.high):
            return f"above {self.low:.4g}"
        return f"below {self.high:.4g}" if math.isinf(self.low) else f"{self.low:.4g} to {self.high:.4g}"


@dataclass(frozen=True)
class Evidence:
    """Corrected and printed form of a quantity beside a reference.

    by : how the reference was derived. reference : numbers, a :class:`Between`, or words and sets, which
    must agree exactly. correct, printed : by the two forms; an array of another shape disagrees. tolerance :
    what rounding, or the digits that the thesis prints, can explain.
    """

    quantity: str
    unit: str
    by: str
    reference: Any
    correct: Any
    printed: Any
    tolerance: float = 0.0

    @property
    def correct_error(self) -> float:
        """Greatest distance of the corrected form from the reference; for words 0 or 1."""
        return self._distance(self.correct)

    @property
    def printed_error(self) -> float:
        """The same of the printed form."""
        return self._distance(self.printed)

    @property
    def proved(self) -> bool:
        """Whether the corrected form agrees with the reference and the printed form does not."""
        return self.correct_error <= self.tolerance and self.printed_error > CLEARANCE * self.tolerance

    def effect(self) -> str:
        """What the misprint does to the numbers, in a sentence."""
        unit = f" {self.unit}" if self.unit else ""
        reference, correct, printed = (_numbers(value) for value in (self.reference, self.correct, self.printed))
        if isinstance(self.reference, Between):
            values = f"{_list(printed)}{unit} as printed, {_list(correct)}{unit} corrected"
            return f"{self.quantity}: {values}; it must be {self.reference}{unit}."
        if reference is None:
            words = [", ".join(sorted(v)) if isinstance(v, frozenset) else v for v in (self.printed, self.correct)]
            return f"{self.quantity}: {words[0]} instead of {words[1]}."
        if printed.shape != correct.shape or printed.size <= 3:
            return f"{self.quantity}: {_list(printed)}{unit} as printed, {_list(correct)}{unit} corrected."
        size = np.max(np.abs(reference))
        error = f"wrong by up to {self.printed_error:.4g}{unit}"
        return f"{self.quantity}: {error}, where the true values reach {size:.4g}{unit}."

    def _distance(self, value: Any) -> float:
        reference, number = _numbers(self.reference), _numbers(value)
        if isinstance(self.reference, Between):
            return float(max(0.0, np.max(self.reference.low - number), np.max(number - self.reference.high)))
        if reference is None:
            return 0.0 if value == self.reference else 1.0
        if number is None or number.shape != reference.shape:
            return math.inf
        return float(np.max(np.abs(number - reference)))


@dataclass(frozen=True)
class Erratum:
    """One misprint by a unique key, and where it stands.

    quantity, by, unit, tolerance : of the :class:`Evidence`; proof : computes its reference, correct and printed value.
    """

    key: str
    where: str
    printed: str
    correct: str
    quantity: str
    by: str
    proof: Callable[[], Iterable[Any]]
    unit: str = ""
    tolerance: float = 0.0
    note: str = ""

    def evidence(self) -> Evidence:
        """Compute the proof."""
        reference, correct, printed = self.proof()
        return Evidence(self.quantity, self.unit, self.by, reference, correct, printed, self.tolerance)


def read_errata(file: str | Path, module: Mapping[str, Any]) -> tuple[Erratum, ...]:
    """The errata of a YAML file in this folder with the proofs among a module's names.

    ParameterError : a field or an argument is missing or unknown, a text is a number, a key stands twice, an
    erratum has no proof or a proof no erratum.
    """
    own = {name.removeprefix("prove_"): each for name, each in module.items() if name.startswith("prove_")}
    proofs, unused, rows = {**_SHARED, **own}, set(own), dict[str, Erratum]()
    for entry in map(dict, read_yaml(Path(__file__).parent / file)):
        where, name, given = f"{file}, {entry.get('key')!r}", entry.pop("proof", None), entry.pop("given", {})
        unused.discard(name)
        if name not in proofs:
            raise ParameterError(f"no function prove_{name}", where=where, expected="one in the chapter's module")
        for field, value in entry.items():
            if not isinstance(value, float if field == "tolerance" else str):
                raise ParameterError(f"{field} = {value!r}", where=where, expected="a text (tolerance: a float)")
        given = {each: Between(**value) if isinstance(value, dict) else value for each, value in given.items()}
        try:
            signature(proofs[name]).bind(**given)
            erratum = Erratum(**entry, proof=partial(proofs[name], **given))
        except TypeError as reason:
            raise ParameterError(str(reason), where=where, expected="an erratum, and what its proof takes") from None
        if rows.setdefault(erratum.key, erratum) is not erratum:
            raise ParameterError("the key stands twice", where=where, expected="keys that are unique")
    if unused:
        raise ParameterError(f"no erratum for {sorted(unused)}", where=str(file), expected="one for each proof")
    return tuple(rows.values())


def _numbers(value: Any) -> Any:
    """The value as an array of floats, or None for words, sets and truth values."""
    array = np.asarray(value)
    return array.astype(float) if array.dtype.kind in "fiu" else None


def _list(values: np.ndarray) -> str:
    # what is left of a zero by rounding is a zero
    items = [f"{value if abs(value) > 1e-12 else 0.0:.5g}" for value in values.ravel()]
    return items[0] if len(items) == 1 else f"({', '.join(items)})"
