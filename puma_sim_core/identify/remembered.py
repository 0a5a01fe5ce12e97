# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The last few results of what takes long."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock

import numpy as np


class Remembered:
    """Arrays by key, the last `most` that were asked for; any thread may ask."""

    def __init__(self, most: int):
        self._most = most
        self._kept: OrderedDict[Hashable, np.ndarray] = OrderedDict()
        self._lock = Lock()

    def __call__(self, key: Hashable, make: Callable[[], np.ndarray]) -> np.ndarray:
        """The array of a key, made if it is not kept; it cannot be written to."""
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
