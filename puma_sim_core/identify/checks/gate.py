# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The gate: a log with a fault of its data is explained by that fault alone.

In order: numbers that are missing, length, time stamps; rows and runs that no drive can make; channels that are not
what they are called; a log of another plant. Each check presupposes those before it, and is only made where they found
nothing. Rows count from 1, the first row of numbers; a fault of a whole channel has none.
"""

import numpy as np

from puma_sim_core.identify.arrays import Bools
from puma_sim_core.identify.checks.channel_faults import channel_faults, moderate_faults, unexplained
from puma_sim_core.identify.checks.plausibility import Plausibility, coarse
from puma_sim_core.identify.checks.row_faults import (
    frozen_positions,
    frozen_voltages,
    jitter_faults,
    number_faults,
    position_faults,
    time_faults,
    voltage_spikes,
)
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.settings import CHECKS
from puma_sim_core.plant.mechanism import Mechanism


def check(log: Log, mechanism: Mechanism) -> tuple[list[Fault], list[str]]:
    """Faults of a log's data, none where it can be explained, and notes on what was seen."""
    notes = list(log.notes)
    faults = number_faults(log) or _short(log) or time_faults(log)
    if faults:
        return faults, notes
    model = Plausibility(mechanism)
    c = coarse(log)
    if c is None:
        what = f"{len(log)} rows of very uneven times"
        return [Fault.of("time", None, what, "rows that are spread over the log")], notes
    still = _rests(log, mechanism)
    if still.all():
        # a joint in a stop or with a brake rests under any constant voltage
        driven = [f"position{j + 1}" for j in range(log.joints) if np.ptp(log.voltage[:, j]) > 2.0 * model.unit[j]]
        what = "nothing moves: it stays within"
        found = [f"{what} {np.ptp(q):.2g} {mechanism.position_unit}" for q in log.position.T]
        return [f for f in frozen_positions(log, model, c) if f.channel in driven] or [
            Fault.of(f"position{j}", None, text, "a motion") for j, text in enumerate(found, 1)
        ], notes
    faults = (
        jitter_faults(log)
        or channel_faults(model, c)
        or position_faults(log, model)
        or frozen_voltages(log, model, c)
        or moderate_faults(model, c, coarse(log, CHECKS.gate_slow) or c)
        or frozen_positions(log, model, c)
        or unexplained(model, c)
        or voltage_spikes(log, model)
        or _outside(log, mechanism)
    )
    notes += [f"Joint {j + 1} does not move: nothing can be said of it alone." for j in np.flatnonzero(still)]
    return faults, notes


def _short(log: Log) -> list[Fault]:
    if len(log) >= CHECKS.gate_least_rows and not 0.0 <= log.span < CHECKS.gate_least_time:
        return []
    what = f"the log is too short: {len(log)} rows over {log.span:.3g} s"
    return [Fault.of("time", None, what, f"{CHECKS.gate_least_rows} rows and {CHECKS.gate_least_time:g} s at least")]


def _rests(log: Log, mechanism: Mechanism) -> Bools:
    """(J,) whether a joint rests all the time; noise of the sensor is no motion."""
    still = np.zeros(log.joints, dtype=bool)
    for j, q in enumerate(log.position.T):
        blocks = [part.mean() for part in np.array_split(q, CHECKS.gate_rest_blocks)]
        width = float(np.ptp(mechanism.ranges[j]))
        least = max(CHECKS.gate_rest_steps * log.quantum[j], CHECKS.gate_rest_share * width)
        still[j] = np.ptp(blocks) <= least and np.ptp(q) < CHECKS.gate_rest_rows * width
    return still


def _outside(log: Log, mechanism: Mechanism) -> list[Fault]:
    found = []
    for j, (low, high) in enumerate(mechanism.ranges):
        q, room = log.position[:, j], CHECKS.gate_outside * (high - low)
        rows = np.flatnonzero((q < low - room) | (q > high + room))
        if rows.size:
            r = int(rows[0])
            whole = rows.size > CHECKS.gate_whole * len(q)
            what = f"{q[r]:.5g} at {log.place(r)}, far outside the joint's range"
            expected = f"{low:.4g} to {high:.4g} {mechanism.position_unit}"
            found.append(Fault.of(f"position{j + 1}", None if whole else r + 1, what, expected))
    return found
