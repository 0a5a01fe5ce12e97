# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Independent runs of the model on all cores: the compiled kernel lets go of the interpreter."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor

from puma_sim_core.jit import BACKEND

#: plain Python runs one thread at a time
_CORES = (os.cpu_count() or 1) if BACKEND == "numba" else 1


def parallel_map(function: Callable, items: Iterable) -> list:
    """The function of each item, in the order of the items; the first error is raised."""
    items = list(items)
    if _CORES == 1 or len(items) < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(min(_CORES, len(items))) as executor:
        return list(executor.map(function, items))
