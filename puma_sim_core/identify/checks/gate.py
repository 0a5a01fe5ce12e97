# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The gate of the loop (step 0): a log with a fault of its data is explained by that fault alone.

In order: numbers that are missing, length, time stamps; rows and stretches that no drive can make;
channels that are not what they are called; a log of another plant. Each step presupposes those
before it, and is only taken where they found nothing. Rows count from 1, the first row of numbers;
a fault of a whole channel has none.
"""

from __future__ import annotations

import numpy as np

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


def check(log: Log, mechanism) -> tuple[list[Fault], list[str]]:
    """Faults of a log's data, none where it can be explained, and notes on what was seen.

    mechanism : `Mechanism` that the log is said to be of, with as many joints.
    """
    notes = list(log.notes)
    short = _short(log)
    faults = number_faults(log) or short or time_faults(log)
    if faults:
        return faults, notes
    model = Plausibility(mechanism)
    c = coarse(log)
    if c is None:
        return [
            Fault("time", None, f"{len(log)} rows of very uneven times; expected rows that are spread over the log")
        ], notes
    still = _rests(log, mechanism)
    if still.all():
        # a constant voltage may do what it likes: a joint in a stop or with a brake rests
        driven = [f"position{j + 1}" for j in range(log.joints) if np.ptp(log.voltage[:, j]) > 2.0 * model.unit[j]]
        frozen = [f for f in frozen_positions(log, model, c) if f.channel in driven]
        return frozen or [
            Fault(
                f"position{j + 1}",
                None,
                "nothing moves: it stays within "
                f"{np.ptp(log.position[:, j]):.2g} {mechanism.position_unit}; "
                "expected a motion, which alone tells anything",
            )
            for j in range(log.joints)
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
    length = float(log.time[-1] - log.time[0])
    if len(log) < CHECKS.gate_least_rows or 0.0 <= length < CHECKS.gate_least_time:
        return [
            Fault(
                "time",
                None,
                f"the log is too short: {len(log)} rows over {length:.3g} s; "
                f"expected {CHECKS.gate_least_rows} rows and {CHECKS.gate_least_time:g} s at least",
            )
        ]
    return []


def _rests(log: Log, mechanism) -> np.ndarray:
    """(J,) whether a joint rests all the time; noise of the sensor is no motion."""
    still = np.zeros(log.joints, dtype=bool)
    for j in range(log.joints):
        q = log.position[:, j]
        blocks = [part.mean() for part in np.array_split(q, 50)]
        width = float(np.ptp(mechanism.ranges[j]))
        still[j] = (
            np.ptp(blocks) <= max(CHECKS.gate_rest_steps * log.quantum[j], CHECKS.gate_rest_share * width)
            and np.ptp(q) < 1e-3 * width
        )
    return still


def _outside(log: Log, mechanism) -> list[Fault]:
    found = []
    for j, (low, high) in enumerate(mechanism.ranges):
        q, room = log.position[:, j], CHECKS.gate_outside * (high - low)
        rows = np.flatnonzero((q < low - room) | (q > high + room))
        if rows.size:
            r = int(rows[0])
            whole = rows.size > 0.9 * len(q)
            found.append(
                Fault(
                    f"position{j + 1}",
                    None if whole else r + 1,
                    f"{q[r]:.5g} at {log.place(r)}, far outside the joint's range; "
                    f"expected {low:.4g} to {high:.4g} {mechanism.position_unit}",
                )
            )
    return found
