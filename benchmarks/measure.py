# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Measuring rows in turn, round after round.

A machine that is shared is slow for a while, then fast again. So each round calls every row, the
short ones several times spread over the round, and rows are compared within their round only.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Sequence
from statistics import median

import numpy as np

from benchmarks.task import Row


def quiet(text: str) -> None:
    """Shows no progress."""


def order_of_calls(rows: Sequence[Row], round_number: int) -> list[int]:
    """Indices of rows in the order in which a round calls them.

    Calls of one row are spread evenly; of those that fall together, another one is first in each
    round.
    """
    n = len(rows)
    calls = [((k + 0.5) / row.calls, (i + round_number) % n, i) for i, row in enumerate(rows) for k in range(row.calls)]
    return [i for _, _, i in sorted(calls)]


def first_calls(rows: Sequence[Row], progress: Callable[[str], None] = quiet) -> list[np.ndarray]:
    """Final positions (3,) [rad] of each row's first call, which warms caches and compilers up."""
    positions = []
    for row in rows:
        progress(f"first call: {row.label}")
        positions.append(np.asarray(row.measure()[1]))
    return positions


def measured(rows: Sequence[Row], rounds: int, progress: Callable[[str], None] = quiet) -> np.ndarray:
    """Times [s] (rounds, rows), each the median of the row's calls in that round."""
    times = np.empty((rounds, len(rows)))
    collecting = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        for r in range(rounds):
            elapsed = [[] for _ in rows]
            for i in order_of_calls(rows, r):
                progress(f"round {r + 1} of {rounds}: {rows[i].label}")
                elapsed[i].append(rows[i].measure()[0])
            times[r] = [median(values) for values in elapsed]
    finally:
        if collecting:
            gc.enable()
        progress("")
    return times


def terminal_progress() -> Callable[[str], None]:
    """Shows one changing line on a terminal, and nothing where standard error is not one."""
    if not sys.stderr.isatty():
        return quiet

    def show(text: str) -> None:
        sys.stderr.write(f"\r\x1b[K{text[:100]}")
        sys.stderr.flush()

    return show
