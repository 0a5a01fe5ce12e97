# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The experiments by their numbers, found in the package's own modules; run one by one or in several processes."""

import hashlib
import importlib
import multiprocessing
import pkgutil
import re
import signal
from collections.abc import Callable, MutableSequence, Sequence
from concurrent.futures import FIRST_EXCEPTION, ProcessPoolExecutor, wait
from dataclasses import dataclass

import numpy as np

from puma_sim_core import thesis
from puma_sim_core.errors import ParameterError, one_of
from puma_sim_core.thesis.result import Result

DEFAULT_SEED = 1
#: time between two looks at the processes [s]
_LOOK = 0.1
#: in a process of :func:`_run_in_processes`: the share done of each experiment
_shares: MutableSequence[float]


@dataclass(frozen=True)
class Context:
    """What an experiment is given: a seed >= 0, from which all that is random follows, and what to
    call with the share done, 0 to 1."""

    seed: int = DEFAULT_SEED
    progress: Callable[[float], None] = lambda share: None

    def rng(self, name: str) -> np.random.Generator:
        """Random numbers that depend on the seed and ``name`` alone, not on other experiments."""
        digest = hashlib.sha256(name.encode("utf-8")).digest()
        return np.random.default_rng([self.seed, int.from_bytes(digest[:16], "big")])


Run = Callable[[Context], Result]


@dataclass(frozen=True)
class Experiment:
    """One experiment: ``number`` is the thesis's section, ``chapter`` the section it belongs to."""

    number: str
    title: str
    chapter: str
    run: Run


_FOUND: dict[str, Experiment] = {}


def experiment(number: str, title: str, *, chapter: str | None = None) -> Callable[[Run], Run]:
    """Register ``run(context) -> Result`` under a section number; ValueError where another function has it."""

    def register(run: Run) -> Run:
        before = _FOUND.get(number)
        if before is not None and before.run.__module__ != run.__module__:
            raise ValueError(f"experiment {number} stands in {before.run.__module__} and in {run.__module__}")
        _FOUND[number] = Experiment(number, title, chapter or number, run)
        return run

    return register


def _order(number: str) -> tuple[list[float], str]:
    """7.2 before 7.10; names without a number (the errata) last."""
    return ([float(digits) for digits in re.findall(r"\d+", number.split("-")[0])] or [float("inf")], number)


def experiments() -> dict[str, Experiment]:
    """All experiments by number, in the thesis's order."""
    for module in pkgutil.iter_modules(thesis.__path__):
        if module.name.startswith("chapter_") or module.name == "errata":
            importlib.import_module(f"{thesis.__name__}.{module.name}")
    return {number: _FOUND[number] for number in sorted(_FOUND, key=_order)}


def find(number: str) -> list[Experiment]:
    """The experiment of that number, or all of a section ("7.7" gives 7.7.1, 7.7.2 ...).

    ParameterError : there is none; the message lists those that there are.
    """
    everything = experiments()
    if number in everything:
        return [everything[number]]
    within = [each for each in everything.values() if each.number.startswith(f"{number}.") or each.chapter == number]
    if not within:
        raise ParameterError(
            f"no experiment {number!r}", where="thesis", expected=one_of(number, everything, "`puma-sim thesis`")
        )
    return within


def run(
    chosen: Sequence[Experiment],
    seed: int,
    jobs: int = 1,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, tuple[Experiment, Result]]:
    """Results by number, in the order given; RuntimeError names an experiment that failed, its own error is the cause.

    jobs : processes at a time; progress : called with what is running and the share of all that is done.
    """
    if jobs > 1 and len(chosen) > 1:
        found = _run_in_processes(chosen, seed, jobs, progress)
    else:
        found = []
        for index, each in enumerate(chosen):

            def report(share: float, index: int = index, each: Experiment = each) -> None:
                progress(each.number, (index + min(1.0, max(0.0, share))) / len(chosen))

            found.append(_run(each, seed, report))
    return {each.number: (each, result) for each, result in zip(chosen, found)}


def _run_in_processes(
    chosen: Sequence[Experiment], seed: int, jobs: int, progress: Callable[[str, float], None]
) -> list[Result]:
    # a fresh interpreter: threads of the compiled kernel do not survive a fork
    context = multiprocessing.get_context("spawn")
    shares = context.Array("d", len(chosen), lock=False)
    others = set(multiprocessing.active_children())
    with ProcessPoolExecutor(min(jobs, len(chosen)), context, _begin, (shares,)) as pool:
        try:
            futures = [pool.submit(_work, index, each.number, seed) for index, each in enumerate(chosen)]
            while not all(future.done() for future in futures):
                for ended in wait(futures, _LOOK, FIRST_EXCEPTION).done:
                    ended.result()
                running = [c.number for c, f, share in zip(chosen, futures, shares) if share > 0.0 and not f.done()]
                done = sum(1.0 if f.done() else share for f, share in zip(futures, shares))
                progress(", ".join(running) or "starting", done / len(chosen))
            return [future.result() for future in futures]
        except BaseException:
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise


def _begin(shares: MutableSequence[float]) -> None:
    """Prepare a process; after Ctrl-C the parent ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    global _shares
    _shares = shares


def _work(index: int, number: str, seed: int) -> Result:
    def report(share: float) -> None:
        _shares[index] = max(1e-9, min(1.0, share))

    return _run(experiments()[number], seed, report)


def _run(each: Experiment, seed: int, report: Callable[[float], None]) -> Result:
    report(0.0)
    try:
        return each.run(Context(seed, report))
    except Exception as error:
        raise RuntimeError(f"experiment {each.number} ({each.title}) failed: {error}") from error
