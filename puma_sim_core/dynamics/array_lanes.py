# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`lanes` for plain Python: any number of runs side by side in arrays of NumPy, with the same bits.

The step is that of one arm, with an array over the runs in place of each number, so that the interpreter goes through
it once for all of them. Sums and products of arrays have the bits of those of numbers; sine and cosine are the
polynomials of `lanes`, as those of NumPy have no such promise.
"""

from typing import Any

import numpy as np

from puma_sim_core.dynamics.lanes import build_trigonometry
from puma_sim_core.dynamics.laws import UNBENT
from puma_sim_core.dynamics.rigid import build_arm
from puma_sim_core.dynamics.runs import terminals
from puma_sim_core.dynamics.types import FREE, NO_SLIP, Model, Rows
from puma_sim_core.jit import Table

# of the compiled kernel it is never called, and so never compiled
_, array_step = build_arm(build_trigonometry(np.floor, np.where)[1])


def follow_arrays(numbers: np.ndarray, rows: Rows, measured: Any, corrected: Any, gain: Any, p: Table) -> np.ndarray:
    """`lanes.follow_lanes` of m runs: innovations (m, n, 3).

    numbers (LANE_NUMBERS, m) : those of `follow_lanes`, a column a run.
    """
    x = tuple(numbers[0:9])
    model = Model(tuple(numbers[12:32]), tuple(numbers[32:47]), 0)
    out = np.empty((numbers.shape[1], len(rows.count), 3))
    for r, count in enumerate(rows.count):
        v = terminals(rows.voltage, r, p)
        for _ in range(count):
            x, _ = array_step(x, UNBENT, v, rows.step[r], model, p, FREE, NO_SLIP)
        e = [measured[r][j] - x[j] for j in range(3)]
        out[:, r] = np.transpose(e)
        if corrected[r]:
            x = tuple(x[3 * k + j] + gain[3 * j + k] * e[j] for k in range(3) for j in range(3))
    return out
