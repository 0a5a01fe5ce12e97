# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Run experiments, one after the other or in several processes, with the same results."""

from __future__ import annotations

import multiprocessing
import queue
import signal
import traceback
from collections.abc import Callable, Sequence

from puma_sim_core.thesis.registry import Context, Experiment, experiments
from puma_sim_core.thesis.result import Result

#: time between two looks at the processes [s]
_LOOK = 0.1


def run(
    chosen: Sequence[Experiment],
    seed: int,
    jobs: int = 1,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> dict[str, tuple[Experiment, Result]]:
    """Results by number, in the order given.

    Parameters
    ----------
    chosen : the experiments.
    seed : of all that is random; an experiment's numbers depend on it and on nothing else.
    jobs : processes at a time.
    progress : called with what is running and the share of all that is done.

    Raises
    ------
    RuntimeError : an experiment failed; names it, its own error is the cause.
    """
    if jobs <= 1 or len(chosen) <= 1:
        found = []
        for index, each in enumerate(chosen):

            def report(share: float, index=index, each=each) -> None:
                progress(each.number, (index + min(1.0, max(0.0, share))) / len(chosen))

            report(0.0)
            found.append(_guarded(each, Context(seed, report)))
        return {each.number: (each, result) for each, result in zip(chosen, found)}
    return _run_in_processes(chosen, seed, jobs, progress)


def _run_in_processes(chosen, seed, jobs, progress):
    # a fresh interpreter: threads of the compiled kernel do not survive a fork; and no daemon,
    # which could have no children of its own
    context = multiprocessing.get_context("spawn")
    shares = context.Array("d", len(chosen), lock=False)
    tasks, answers = context.Queue(), context.Queue()
    for task in [*range(len(chosen)), *[None] * jobs]:
        tasks.put(task)
    numbers = [each.number for each in chosen]
    workers = [
        context.Process(target=_work, args=(tasks, answers, shares, numbers, seed))
        for _ in range(min(jobs, len(chosen)))
    ]
    found: dict[int, Result] = {}
    try:
        for worker in workers:
            worker.start()
        while len(found) < len(chosen):
            # read before the wait: what a process wrote before its end is still to be had
            ended = not any(worker.is_alive() for worker in workers)
            try:
                index, result = answers.get(timeout=_LOOK)
            except queue.Empty:
                if ended:
                    raise RuntimeError("the processes ended without an answer") from None
            else:
                if isinstance(result, BaseException):
                    raise result
                found[index] = result
            running = [numbers[i] for i, share in enumerate(shares) if share > 0.0 and i not in found]
            progress(
                ", ".join(running) or "starting",
                sum(1.0 if i in found else share for i, share in enumerate(shares)) / len(chosen),
            )
    finally:
        for worker in workers:
            if worker.is_alive() and len(found) < len(chosen):
                worker.terminate()
            if worker.pid is not None:
                worker.join()
    return {each.number: (each, found[index]) for index, each in enumerate(chosen)}


def _work(tasks, answers, shares, numbers, seed) -> None:
    # after Ctrl-C the parent ends its processes itself
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    known = experiments()
    for index in iter(tasks.get, None):

        def report(share: float, index=index) -> None:
            shares[index] = max(1e-9, min(1.0, share))

        report(0.0)
        try:
            answers.put((index, _guarded(known[numbers[index]], Context(seed, report))))
        except Exception as error:
            text = "".join(traceback.format_exception(type(error), error, error.__traceback__))
            answers.put((index, RuntimeError(f"{error}\n\n{text}")))


def _guarded(each: Experiment, context: Context) -> Result:
    try:
        return each.run(context)
    except Exception as error:
        raise RuntimeError(f"experiment {each.number} ({each.title}) failed: {error}") from error
