# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Records of a PID controller that is written out by its definition, on a motor with a lag."""

from __future__ import annotations

from math import floor, inf

import numpy as np

from puma_sim_core.tuning.controller_log import ControllerLog

H = 0.028 / 30.0
COUNT = 1.0e-4
VOLT_STEP = 80.0 / 4096.0


def record(
    gains,
    seed: int,
    *,
    samples: int = 4096,
    count: float = COUNT,
    volt_step: float = VOLT_STEP,
    on_measurement: bool = False,
    limit: float = inf,
    amplitude: float = 0.006,
    noise: float = 0.0,
    changed=None,
) -> ControllerLog:
    """A joint that goes to and fro; seeds differ in its speed and in where the counts lie.

    gains : Kg, Ti, Td; changed : gains of the second half. The sum includes the present error and
    stands still while the output is at its limit.
    """
    rng = np.random.default_rng(seed)
    rate, start = rng.uniform(1.2, 2.2), rng.uniform(-1.0, 1.0) * count
    time = 0.028 * np.arange(samples // 30 + 1)
    wanted = np.repeat(amplitude * (1.0 - np.cos(2.0 * np.pi * rate * time)), 30)[:samples]
    disturbance = noise * rng.standard_normal(samples)
    kg, ti, td = gains
    q, speed, total, before = start, 0.0, 0.0, None
    position, voltage = np.empty(samples), np.empty(samples)
    for k in range(samples):
        if changed is not None and k == samples // 2:
            kg, ti, td = changed
        y = floor(q / count + 0.5) * count if count else q
        e = wanted[k] - y
        source = -y if on_measurement else e
        slope = 0.0 if before is None else source - before
        before = source
        grown = total + kg * H / ti * e
        u = kg * e + grown + kg * td / H * slope
        if abs(u) < limit:
            total = grown
        u = max(-limit, min(limit, u))
        u = floor(u / volt_step + 0.5) * volt_step if volt_step else u
        position[k], voltage[k] = y, u + disturbance[k]
        # 16 V for each rad/s, with a lag of 50 ms
        speed += H / 0.05 * (u / 16.0 - speed)
        q += H * speed
    return ControllerLog(H, wanted, position, voltage, f"record {seed}")


def write(log: ControllerLog, path, joint: int | None = None):
    """The log as a file; with a joint, three joints of which the others are at rest."""
    columns = {"time": log.period * np.arange(len(log))}
    for group in ("setpoint", "position", "voltage"):
        values = getattr(log, group)
        if joint is None:
            columns[group] = values
        else:
            columns |= {f"{group}{j}": values if j == joint else np.zeros(len(log)) for j in (1, 2, 3)}
    rows = np.column_stack(list(columns.values())).tolist()
    # the last row's voltage is held by nobody
    rows.append([rows[-1][0] + log.period, *rows[-1][1:]])
    path.write_text("".join(f"{line}\n" for line in [",".join(columns), *(",".join(map(repr, row)) for row in rows)]))
    return path
