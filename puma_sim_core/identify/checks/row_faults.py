# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Faults of single rows and stretches: time stamps, missing numbers, spikes, dropped rows, channels
that freeze.

What a position may do from row to row is bounded by the drive: no acceleration above what the
voltages of the log, friction and a blow give the joint's inertia.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from puma_sim_core.identify.checks.plausibility import Coarse, Plausibility
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.settings import CHECKS


def number_faults(log) -> list[Fault]:
    """Numbers that are missing, not finite, or, of `enable`, neither 0 nor 1."""
    found = []
    for name, values in _channels(log):
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            value = "no number" if np.isnan(values[bad[0]]) else f"{values[bad[0]]}"
            found.append(
                Fault(name, int(bad[0]) + 1, f"{value} at {log.place(bad[0])}{_more(bad)}; expected finite numbers")
            )
    if log.enable is not None and not found:
        for name, values in _enables(log):
            bad = np.flatnonzero((values != 0.0) & (values != 1.0))
            if bad.size:
                found.append(
                    Fault(
                        name,
                        int(bad[0]) + 1,
                        f"{values[bad[0]]:g} at {log.place(bad[0])}{_more(bad)}; expected 0 (drive off) or 1",
                    )
                )
    return found


def time_faults(log) -> list[Fault]:
    """Time stamps that stand, go back, leave rows out, or come too slowly; finite numbers."""
    steps = np.diff(log.time)
    found = []
    for what, bad in (("goes back", np.flatnonzero(steps < 0.0)), ("is repeated", np.flatnonzero(steps == 0.0))):
        if bad.size:
            r = int(bad[0]) + 1
            found.append(
                Fault(
                    "time",
                    r + 1,
                    f"{log.time[r]:.9g} s after {log.time[r - 1]:.9g} s "
                    f"at {log.place(r)}: time {what}{_more(bad)}; expected times that "
                    "increase",
                )
            )
    middle = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    if middle > CHECKS.row_slowest:
        found.append(
            Fault(
                "time",
                None,
                f"rows come each {middle:.3g} s; expected times in seconds, and rows each "
                f"{CHECKS.row_slowest} s at least",
            )
        )
    if found or not middle:
        return found
    far = np.abs(steps / middle - 1.0) > CHECKS.row_even
    limit = (
        CHECKS.row_gap_even
        if far.mean() < CHECKS.row_even_share
        else max(CHECKS.row_gap_uneven, CHECKS.row_gap_tail * float(np.quantile(steps, 0.99)) / middle)
    ) * middle
    gaps = np.flatnonzero(steps > limit)
    if gaps.size:
        r = int(gaps[0]) + 1
        found.append(
            Fault(
                "time",
                r + 1,
                f"a gap of {steps[r - 1]:.4g} s before {log.place(r)}, "
                f"about {steps[r - 1] / middle - 1.0:.0f} rows{_more(gaps)}; expected "
                f"rows each {middle:.4g} s",
            )
        )
    return found


def jitter_faults(log) -> list[Fault]:
    """Time stamps that jump about while the positions tell of an even clock."""
    steps = np.diff(log.time)
    middle = float(np.median(steps))
    before, after = steps[:-1], steps[1:]
    uneven = np.abs(after - before) > CHECKS.row_even * middle
    by_clock, by_count = [], []
    for j in range(log.joints):
        q = log.position[:, j]
        clock = q[1:-1] - (q[:-2] * after + q[2:] * before) / (before + after)
        count = q[1:-1] - 0.5 * (q[:-2] + q[2:])
        speed = np.abs(q[2:] - q[:-2]) / (before + after)
        size = max(log.quantum[j], 0.7 * float(np.median(np.abs(count))), 1e-12)
        # where the two differ by more than the encoder's step; blows and spikes are told elsewhere
        rows = np.flatnonzero(uneven & (0.5 * speed * np.abs(after - before) > size))
        by_clock.append(np.minimum((clock[rows] / size) ** 2, 100.0))
        by_count.append(np.minimum((count[rows] / size) ** 2, 100.0))
    by_clock, by_count = np.concatenate(by_clock), np.concatenate(by_count)
    if len(by_clock) < 30 or by_clock.mean() < 1.5 * by_count.mean():
        return []
    first = None if uneven.mean() > 0.5 else int(np.flatnonzero(uneven)[0]) + 2
    spread = 100.0 * float(np.std(steps[1:][uneven])) / middle
    return [
        Fault(
            "time",
            first,
            f"the stamps jump by {spread:.0f} % of a row while the positions "
            "move on evenly: they are not the times of the samples; expected stamps of an "
            "even clock",
        )
    ]


def bounds(log, model: Plausibility) -> np.ndarray:
    """(J,) accelerations that the drives cannot exceed; finite numbers."""
    m = model.mechanism
    volts = np.quantile(np.abs(log.voltage), 0.999, axis=0)
    inertia = m.inertia(model.theta, log.position[:: max(1, len(log) // 500)]).min(axis=0)
    inertia = np.maximum(inertia, 0.0) + model.drive.motor_inertia
    torque = 2.0 * volts / model.k + CHECKS.row_blow * model.unit / model.k
    return CHECKS.row_margin * torque / inertia


def position_faults(log, model: Plausibility) -> list[Fault]:
    """Spikes, dropped rows, and stretches that end with a jump."""
    limits, found = bounds(log, model), []
    volts = np.quantile(np.abs(log.voltage), 0.999, axis=0)
    lines = [_out_of_line(log, j, limits[j], float(volts[j]), model) for j in range(log.joints)]
    jumps: dict[int, list[int]] = {}
    for j, line in enumerate(lines):
        if line.rows.size > max(20, CHECKS.row_many * len(log)):
            continue
        taken = -1
        for n, r in enumerate(line.rows):
            r = int(r)
            if r <= taken:
                continue
            back = _comes_back(log, j, r, line.rows[n + 1 :], line)
            start = _run_before(log.position[:, j], r)
            if back is not None:
                taken = back
                values = f"{log.position[r, j]:.5g} at {log.place(r)}"
                what = f"a spike: {values}" if back == r + 1 else f"a drop-out of {back - r} rows: {values}"
                found.append(
                    Fault(
                        f"position{j + 1}",
                        r + 1,
                        f"{what}, {line.excess[r]:.3g} beside its neighbours; expected "
                        "a motion that the drive can make",
                    )
                )
            elif r - start >= 4:
                found.append(
                    Fault(
                        f"position{j + 1}",
                        start + 2,
                        f"frozen at {log.position[start, j]:.6g} from "
                        f"{log.place(start + 1)} to {log.place(r - 1)}, then a jump by "
                        f"{line.excess[r]:.3g}; expected a motion that goes on",
                    )
                )
            else:
                jumps.setdefault(r, []).append(j)
    for r, parts in jumps.items():
        found += _jump(log, r, parts, lines)
    return _first_of_each(found)


@dataclass(frozen=True)
class _Line:
    """What one position does from row to row: rows (m,) that no motion reaches from the row
    before, by how much (n,), what is allowed (n,), slope around and its change there (n,)."""

    rows: np.ndarray
    excess: np.ndarray
    allowed: np.ndarray
    slope: np.ndarray
    bend: np.ndarray


def _out_of_line(log, j, limit, volts, model) -> _Line:
    q, steps = log.position[:, j], np.diff(log.time)
    slope = np.diff(q) / steps
    padded = np.concatenate(
        [
            np.full(CHECKS.row_around, slope[: CHECKS.row_around].mean()),
            slope,
            np.full(CHECKS.row_around, slope[-CHECKS.row_around :].mean()),
        ]
    )
    middle = np.median(sliding_window_view(padded, CHECKS.row_around), axis=1)
    before, after = middle[: len(slope)], middle[CHECKS.row_around + 1 : CHECKS.row_around + 1 + len(slope)]
    inside = np.clip(slope, np.minimum(before, after), np.maximum(before, after))
    excess = np.r_[0.0, (slope - inside) * steps]
    bend = np.abs(np.diff(q, 2))
    noise = 1.4826 * float(np.median(bend)) / np.sqrt(6.0)
    reach = limit * steps**2
    if model.drive.emf[j] > 0.0:
        reach = np.minimum(reach, 3.0 * volts / model.speed[j] * steps)
    allowed = np.maximum(reach, max(10.0 * noise, 4.0 * log.quantum[j], 1e-9))
    allowed = np.r_[np.inf, allowed]
    return _Line(
        np.flatnonzero(np.abs(excess) > allowed),
        excess,
        allowed,
        np.r_[0.0, 0.5 * (before + after)],
        np.r_[0.0, np.abs(after - before)],
    )


def _comes_back(log, j, r, later, line) -> int | None:
    """The row at which a position that left its line at row r is back on it, or None."""
    q, t = log.position[:, j], log.time
    for k in later[: CHECKS.row_spike]:
        if k - r > CHECKS.row_spike:
            break
        expected = q[r - 1] + line.slope[r] * (t[k] - t[r - 1])
        if abs(q[k] - expected) < 0.3 * abs(line.excess[r]) and line.excess[k] * line.excess[r] < 0.0:
            return int(k)
    return None


def _run_before(q, r: int) -> int:
    """First row of the run of equal values that ends at row r - 1."""
    start = r - 1
    while start > 0 and q[start - 1] == q[r - 1]:
        start -= 1
    return start


def _jump(log, r: int, parts: list[int], lines: list[_Line]) -> list[Fault]:
    """A jump without return: of all that moves, on its way, it is rows that are missing."""
    j = max(parts, key=lambda k: abs(lines[k].slope[r]))
    lost = lines[j].excess[r] / lines[j].slope[r] if lines[j].slope[r] else -1.0
    onward = lost > 0.0 and all(
        abs(line.excess[r] - lost * line.slope[r])
        < lost * (0.3 * abs(line.slope[r]) + 0.5 * line.bend[r]) + line.allowed[r]
        for line in lines
    )
    found = [
        Fault(
            f"position{j + 1}",
            r + 1,
            f"a jump by {lines[j].excess[r]:.3g} at {log.place(r)}; expected a motion that the drive can make",
        )
        for j in parts
    ]
    if onward:
        found.insert(
            0,
            Fault(
                "time",
                r + 1,
                f"the motion jumps on by {lost:.3g} s at "
                f"{log.place(r)} while the stamps do not: rows are missing; expected "
                "every row, or stamps that tell of the gap",
            ),
        )
    return found


def voltage_spikes(log, model: Plausibility) -> list[Fault]:
    """Single rows of voltage that the joint did not feel."""
    found = []
    steps = np.diff(log.time)
    middle = float(np.median(steps))
    m = max(3, int(0.012 / middle))
    inertia = (
        np.maximum(model.mechanism.inertia(model.theta, log.position[:: max(1, len(log) // 500)]).mean(axis=0), 0.0)
        + model.drive.motor_inertia
    )
    for j in range(log.joints):
        v, q = log.voltage[:, j], log.position[:, j]
        padded = np.r_[np.full(3, v[0]), v, np.full(3, v[-1])]
        away = v - np.median(sliding_window_view(padded, 7), axis=1)
        usual = float(np.quantile(np.abs(away), 0.995))
        rows = np.flatnonzero(np.abs(away) > max(4.0 * usual, 5.0 * model.unit[j]))
        if not 0 < rows.size <= max(3, 0.005 * len(v)):
            continue
        noise = max(log.quantum[j], 1.5 * float(np.median(np.abs(np.diff(q, 2)))), 1e-12)
        for r in rows:
            if r < 3 * m or r + 3 * m >= len(q) or away[r - 1] * away[r] > 0.25 * away[r] ** 2:
                continue
            kick = away[r] * middle / (model.k[j] * inertia[j])
            slow = model.k[j] * inertia[j] / model.speed[j] if model.speed[j] > 0.0 else np.inf
            span = m * middle
            travel = kick * slow * (1.0 - np.exp(-span / slow)) if np.isfinite(slow) else kick * span
            # the bend at the row, beside those of the motion before and after
            before, seen, after = (q[k + m] - 2.0 * q[k] + q[k - m] for k in (r - 2 * m, r, r + 2 * m))
            seen -= 0.5 * (before + after)
            others = float(np.quantile(np.abs(v), 0.999))
            felt = abs(travel) > 4.0 * noise and seen / travel > 0.4
            told = abs(travel) > 4.0 * noise or abs(v[r]) > 3.0 * others
            if told and not felt:
                found.append(
                    Fault(
                        f"voltage{j + 1}",
                        int(r) + 1,
                        f"a spike: {v[r]:.4g} V at {log.place(r)} between "
                        f"{v[r - 1]:.4g} and {v[r + 1]:.4g} V, which the joint did not "
                        "feel; expected the voltage that acted",
                    )
                )
                break
    return found


def frozen_positions(log, model: Plausibility, c: Coarse) -> list[Fault]:
    """Positions that stand still while the voltage must move the joint."""
    found = []
    fits = model.fits(c)
    static = model.k * model.mechanism.torque(model.theta, c.position, c.velocity, c.acceleration)
    at = _times(log, c)
    for j in range(log.joints):
        fit, q = fits[j], log.position[:, j]
        if fit.rows and model.share(fit, j) > CHECKS.row_explained:
            continue  # neither is the motion, then
        held = (
            CHECKS.row_stuck_unknown * model.unit[j]
            if fit.dry is None
            else min(
                CHECKS.row_stuck_unknown * model.unit[j], CHECKS.row_stuck * fit.dry + CHECKS.row_beside * model.unit[j]
            )
        )
        beyond = c.voltage[:, j] - static[:, j]
        beyond = np.sign(beyond) * np.maximum(np.abs(beyond) - held, 0.0) * (c.enable[:, j] > 0.99)
        low, high = float(q.min()), float(q.max())
        for first, last in _runs(q, log.time, 0.15):
            inside = (at >= log.time[first]) & (at <= log.time[last])
            if inside.sum() < 3:
                continue
            push = beyond[inside]
            if low < high:  # a stop, or friction with the weight, at an end of the travel
                steady = np.ptp(c.voltage[inside, j]) < 2.0 * model.unit[j]
                beyond_end = np.inf if steady else CHECKS.row_at_an_end * held
                if q[first] >= high - 0.02 * (high - low):
                    push = np.minimum(push, np.maximum(push - beyond_end, 0.0))
                if q[first] <= low + 0.02 * (high - low):
                    push = np.maximum(push, np.minimum(push + beyond_end, 0.0))
            travel = float(np.abs(push).sum()) * c.step / max(model.speed[j], 1e-12)
            width = float(np.ptp(model.mechanism.ranges[j]))
            if travel > max(CHECKS.row_frozen_travel * width, 20.0 * log.quantum[j]):
                whole = last - first >= 0.98 * len(q)
                found.append(
                    Fault(
                        f"position{j + 1}",
                        None if whole else int(first) + 2,
                        f"frozen at {q[first]:.6g} from {log.place(first + 1)} to {log.place(last)} "
                        f"while its voltage must move it by {travel:.2g}; expected a motion, or a "
                        "voltage that friction can hold",
                    )
                )
                break
    return found


def frozen_voltages(log, model: Plausibility, c: Coarse) -> list[Fault]:
    """Voltages that stand still while the motion needs others."""
    found = []
    at = _times(log, c)
    for j in range(log.joints):
        v = log.voltage[:, j]
        runs = _runs(v, log.time, 0.25)
        greatest = float(np.abs(v).max())
        if np.ptp(v) == 0.0 and model.share(model.fit(c, j), j) > CHECKS.row_explained:
            found.append(
                Fault(
                    f"voltage{j + 1}",
                    None,
                    f"frozen at {v[0]:.5g} V while the joint moves otherwise; expected the voltage that acted",
                )
            )
        if sum(b - a for a, b in runs) > 0.6 * len(v):
            continue  # a voltage of steps
        for first, last in runs:
            if v[first] == 0.0 or abs(v[first]) > 0.97 * greatest:
                continue  # off, or at the limit of the supply
            start, end = log.time[first], log.time[last]
            near = (at > start - 0.2) & (at < end + 0.2)
            inside = (at > start + 0.05) & (at < end - 0.05) & model.moving(c, j)
            fit = model.fit(c, j, without=near)
            if inside.sum() < 3 or not fit.rows:
                continue
            here = float(np.sqrt(np.mean(fit.residual[inside] ** 2)))
            if here > max(model.unit[j], 8.0 * fit.left):
                found.append(
                    Fault(
                        f"voltage{j + 1}",
                        int(first) + 2,
                        f"frozen at {v[first]:.5g} V from {log.place(first + 1)} to "
                        f"{log.place(last)}, {here:.2g} V beside what the motion "
                        "takes; expected the voltage that acted",
                    )
                )
                break
    return found


def _times(log, c: Coarse) -> np.ndarray:
    """(n,) times of the rows of a log's coarse series."""
    n = len(c.voltage)
    return 0.5 * (log.time[0] + log.time[-1]) + c.step * (np.arange(n) - 0.5 * (n - 1))


def _runs(values, time, shortest: float) -> list[tuple[int, int]]:
    """(first, last) rows of runs of equal values that last at least `shortest` [s]."""
    equal = np.diff(np.r_[0, (np.diff(values) == 0.0).astype(int), 0])
    first, last = np.flatnonzero(equal == 1), np.flatnonzero(equal == -1)
    return [(int(a), int(b)) for a, b in zip(first, last) if time[b] - time[a] >= shortest]


def _channels(log):
    yield "time", log.time
    for group in ("voltage", "position", "velocity", "current", "setpoint"):
        values = getattr(log, group)
        if values is not None:
            for j in range(log.joints):
                yield f"{group}{j + 1}", values[:, j]
    if log.enable is not None:
        yield from _enables(log)


def _enables(log):
    if np.array_equal(log.enable, log.enable[:, :1].repeat(log.joints, axis=1), equal_nan=True):
        yield "enable", log.enable[:, 0]
    else:
        for j in range(log.joints):
            yield f"enable{j + 1}", log.enable[:, j]


def _more(rows) -> str:
    return "" if len(rows) == 1 else f" and {len(rows) - 1} more"


def _first_of_each(found: list[Fault]) -> list[Fault]:
    """The first fault of each channel, with the number of the others."""
    result = []
    for channel in dict.fromkeys(fault.channel for fault in found):
        mine = sorted((f for f in found if f.channel == channel), key=lambda f: f.row)
        more = f" ({len(mine) - 1} more)" if len(mine) > 1 else ""
        result.append(Fault(channel, mine[0].row, mine[0].what + more))
    return result
