# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs of one machine, each explained alone: on other processes beside other work, or here when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, wait
from typing import Any

from puma_sim_core.executors import WorkerDied
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.prepare import silent

#: takes (what is done, share 0 to 1)
Progress = Callable[[str, float], None]
#: mapping of report.json, None of a log that is too short alone
Report = dict[str, Any] | None
#: seconds between two calls of `progress` while a process works
_LOOK = 0.5


def within(progress: Progress, low: float, high: float) -> Progress:
    """Progress from low to high of that of a whole."""
    return lambda what, share: progress(what, low + (high - low) * share)


class OneByOne:
    """The reports of some logs; with an executor they are begun at once.

    explained : (log, progress) -> its report; for an executor a function that can be pickled.
    """

    def __init__(
        self, logs: Sequence[Log], explained: Callable[[Log, Progress], Report], executor: Executor | None = None
    ):
        self._logs, self._explained = logs, explained
        self._begun = [] if executor is None else [executor.submit(explained, log, silent) for log in logs]

    def cancel(self) -> None:
        """Give up what has not begun."""
        for future in self._begun:
            future.cancel()

    def reports(self, progress: Progress) -> list[Report]:
        """In the order of the logs, whoever makes them. A log whose process was ended is explained here."""
        out, count = list[Report](), len(self._logs)
        for n, log in enumerate(self._logs):
            own = within(progress, n / count, (n + 1) / count)
            try:
                out.append(_awaited(self._begun[n], own) if self._begun else self._explained(log, own))
            except WorkerDied:
                out.append(self._explained(log, own))
        return out


def _awaited(future: Future[Report], progress: Progress) -> Report:
    while not wait([future], timeout=_LOOK).done:
        progress("each log alone", 0.0)
    return future.result()
