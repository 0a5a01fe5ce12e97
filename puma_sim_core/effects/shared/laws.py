# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Laws that several effects share."""

from puma_sim_core.jit import Table, inlined


@inlined
def first(p: Table, k: int) -> float:
    """The first parameter: a constant offset, delay, bound, stiffness or time constant."""
    return p[k]
