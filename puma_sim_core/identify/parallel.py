# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Independent runs of the model on all cores: the compiled kernel lets go of the interpreter."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from puma_sim_core.executors import threads
from puma_sim_core.jit import BACKEND

Item = TypeVar("Item")
Result = TypeVar("Result")


def parallel_map(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """The function of each item, in the order of the items; the first error is raised."""
    items = list(items)
    # plain Python runs one thread at a time
    count = min(threads(), len(items)) if BACKEND == "numba" else 1
    if count <= 1:
        return [function(item) for item in items]
    with ThreadPoolExecutor(count) as executor:
        return list(executor.map(function, items))
