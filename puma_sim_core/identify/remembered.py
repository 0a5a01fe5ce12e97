# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A cache of arrays: the least recently used goes first."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock

from puma_sim_core.identify.arrays import Floats


class Remembered:
    """Cached arrays by key, the last `most` that were asked for; safe for threads."""

    def __init__(self, most: int):
        self._most = most
        self._kept: OrderedDict[Hashable, Floats] = OrderedDict()
        self._lock = Lock()

    def __call__(self, key: Hashable, make: Callable[[], Floats]) -> Floats:
        """The array of a key, made if it is not cached; read-only."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        # made outside of the lock: two that ask at once for the same make it twice, alike
        array = make()
        array.setflags(write=False)
        with self._lock:
            self._kept[key] = array
            while len(self._kept) > self._most:
                self._kept.popitem(last=False)
        return array
