# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What a measure is."""

from math import inf
from typing import NamedTuple


class Measure(NamedTuple):
    """Name, unit ("1": a share), definition and source of a measure.

    group : "step", "tracking", "pose", "path", "effort" or "margin".
    smaller_is_better : true of all but margins. All are magnitudes of at least 0.
    """

    name: str
    unit: str
    definition: str
    source: str
    group: str
    smaller_is_better: bool = True

    @property
    def worst(self) -> float:
        """The value of a trial that failed."""
        return inf if self.smaller_is_better else 0.0
