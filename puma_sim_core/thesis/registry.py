# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The experiments by their numbers, found by looking at the package's own modules."""

from __future__ import annotations

import hashlib
import importlib
import pkgutil
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from puma_sim_core.errors import ParameterError
from puma_sim_core.thesis.result import Result

DEFAULT_SEED = 1


@dataclass(frozen=True)
class Context:
    """What an experiment is given.

    Parameters
    ----------
    seed : integer >= 0; all that is random follows from it.
    progress : called with the share done, 0 to 1.
    """

    seed: int = DEFAULT_SEED
    progress: Callable[[float], None] = lambda share: None

    def rng(self, name: str) -> np.random.Generator:
        """Random numbers that depend on the seed and on ``name`` alone.

        So an experiment's numbers do not change with the others that run before it.
        """
        digest = hashlib.sha256(name.encode("utf-8")).digest()
        return np.random.default_rng([self.seed, int.from_bytes(digest[:16], "big")])


@dataclass(frozen=True)
class Experiment:
    """One experiment: ``number`` is the thesis's section, ``chapter`` the section it belongs to."""

    number: str
    title: str
    chapter: str
    run: Callable[[Context], Result]


_FOUND: dict[str, Experiment] = {}


def experiment(number: str, title: str, *, chapter: str | None = None):
    """Register ``run(context) -> Result`` under a section number of the thesis.

    Raises
    ------
    ValueError : another function has the number already.
    """

    def register(run: Callable[[Context], Result]) -> Callable[[Context], Result]:
        before = _FOUND.get(number)
        if before is not None and before.run.__module__ != run.__module__:
            raise ValueError(f"experiment {number} stands in {before.run.__module__} and in {run.__module__}")
        _FOUND[number] = Experiment(number, title, chapter or number, run)
        return run

    return register


def _order(number: str) -> tuple[list[float], str]:
    """7.2 before 7.10; names without a number (the errata) last."""
    parts: list[float] = [float(digits) for digits in re.findall(r"\d+", number.split("-")[0])]
    return (parts or [float("inf")], number)


def experiments() -> dict[str, Experiment]:
    """All experiments by number, in the thesis's order."""
    package = importlib.import_module(__package__)
    for module in pkgutil.iter_modules(package.__path__):
        if module.name.startswith("chapter_") or module.name == "errata":
            importlib.import_module(f"{__package__}.{module.name}")
    return {number: _FOUND[number] for number in sorted(_FOUND, key=_order)}


def find(number: str) -> list[Experiment]:
    """The experiment of that number, or all of a section ("7.7" gives 7.7.1, 7.7.2 ...).

    Raises
    ------
    ParameterError : there is none; the message lists those that there are.
    """
    everything = experiments()
    if number in everything:
        return [everything[number]]
    within = [each for each in everything.values() if each.number.startswith(f"{number}.") or each.chapter == number]
    if not within:
        raise ParameterError(f"no experiment {number!r}", where="thesis", expected=f"one of {', '.join(everything)}")
    return within
