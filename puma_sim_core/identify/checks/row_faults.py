# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Faults of single rows and runs of rows: time stamps, missing numbers, spikes, dropped rows, frozen channels.

What a position may do from row to row is bounded by the drive: no acceleration above what the voltages of the log,
friction and an impact give the joint's inertia.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from puma_sim_core.identify.arrays import Bools, Floats, Ints, runs
from puma_sim_core.identify.checks.plausibility import Coarse, Plausibility, soft_threshold
from puma_sim_core.identify.data.late_stamps import bends, scales
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import cutoffs
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.settings import CHECKS, DATA, FITTING
from puma_sim_core.recording.column_names import units_of

_MOTION = "a motion that the drive can make"
_VOLTAGE = "the voltage that acted"


def number_faults(log: Log) -> list[Fault]:
    """Numbers that are missing, not finite, or, of `enable`, neither 0 nor 1."""
    return _bad_numbers(log, _channels(log), lambda values: ~np.isfinite(values), "finite numbers") or _bad_numbers(
        log, _enables(log), lambda values: (values != 0.0) & (values != 1.0), "0 (drive off) or 1"
    )


def _bad_numbers(
    log: Log, channels: Iterable[tuple[str, Floats]], wrong: Callable[[Floats], Bools], expected: str
) -> list[Fault]:
    """The runs of wrong numbers of each channel."""
    found = []
    for name, values in channels:
        for r, end in runs(wrong(values)):
            value = "no number" if np.isnan(values[r]) else f"{values[r]:g}"
            found.append(Fault.of(name, log.row(r), f"{value} at {log.place(r)}", expected, end - r))
    return found


def time_faults(log: Log) -> list[Fault]:
    """Time stamps that stand, go back, leave rows out, or come too slowly; finite numbers."""
    steps = np.diff(log.time)
    found = []
    for what, bad, rows in (("goes back", steps < 0.0, 0), ("is repeated", steps == 0.0, 1)):
        for r in (np.flatnonzero(bad) + 1).tolist():
            stamps = f"{log.time[r]:.9g} s after {log.time[r - 1]:.9g} s at {log.place(r)}"
            found.append(Fault.of("time", log.row(r), f"{stamps}: time {what}", "times that increase", rows))
    middle = log.step
    if middle > CHECKS.row_slowest:
        expected = f"times in seconds, and rows every {CHECKS.row_slowest} s at least"
        fits = next((unit for unit, factor in units_of("time").items() if middle * factor <= CHECKS.row_slowest), None)
        expected += f", or, if these are {fits}, a column named time_{fits}" if fits else ""
        found.append(Fault.of("time", None, f"rows come every {middle:.3g} s", expected))
    if found or not middle:
        return found
    for r in (np.flatnonzero(steps > longest_gap(log)) + 1).tolist():
        missing = f"about {steps[r - 1] / middle - 1.0:.0f} rows"
        what = f"a gap of {steps[r - 1]:.4g} s before {log.place(r)}, {missing}"
        found.append(Fault.of("time", log.row(r), what, f"rows every {middle:.4g} s"))
    return found


def longest_gap(log: Log) -> float:
    """Longest time [s] between two rows of a log that its motion can be followed over, 0.0 without a step of time.

    Rows of a motion below a cutoff may be half its period apart (Shannon 1949, Proc. IRE 37:10): below the first cutoff
    where rows come that often, and below the second where one of them is missing. An uneven clock has longer steps by
    itself.
    """
    steps, middle = np.diff(log.time), log.step
    if not middle:
        return 0.0
    limit = max(0.5 / cutoffs(middle)[0], CHECKS.row_gap_even * middle)
    if np.mean(np.abs(steps / middle - 1.0) > CHECKS.row_even) >= CHECKS.row_even_share:
        usual = float(np.quantile(steps, 0.99))
        limit = max(limit, CHECKS.row_gap_uneven * middle, CHECKS.row_gap_tail * usual)
    return limit


def jitter_faults(log: Log) -> list[Fault]:
    """Time stamps that jitter while the positions show an even clock."""
    steps = np.diff(log.time)
    middle = float(np.median(steps))
    uneven = np.abs(np.diff(steps)) > CHECKS.row_even * middle
    by_clock, by_count = (bends(time, log.position) / scales(log) for time in (log.time, np.arange(float(len(log)))))
    # where the two differ by more than the encoder's step; spikes are checked elsewhere
    rows = (uneven[:, None] & (np.abs(by_clock - by_count) > 1.0)).T
    by_clock, by_count = (np.minimum(x.T[rows] ** 2, DATA.bend_most) for x in (by_clock, by_count))
    if len(by_clock) < CHECKS.row_jitter_rows or by_clock.mean() < DATA.bend_ratio * by_count.mean():
        return []
    first = None if uneven.mean() > 0.5 else log.row(int(np.flatnonzero(uneven)[0]) + 1)
    spread = 100.0 * float(np.std(steps[1:][uneven])) / middle
    what = f"the stamps jitter by {spread:.0f} % of a row while the positions move on evenly"
    return [Fault.of("time", first, what, "the times of the samples, or stamps of an even clock")]


def _bounds(log: Log, model: Plausibility) -> Floats:
    """(J,) accelerations that the drives cannot exceed; finite numbers."""
    torque = 2.0 * _greatest(log.voltage) / model.k + CHECKS.row_impact * model.unit / model.k
    return CHECKS.row_margin * torque / _inertia(log, model, np.min)


def _inertia(log: Log, model: Plausibility, over: Callable[..., Floats]) -> Floats:
    """(J,) inertia, of the links that over some rows."""
    inertia = model.mechanism.inertia(model.theta, log.position[:: max(1, len(log) // 500)])
    return np.maximum(over(inertia, axis=0), 0.0) + model.drive.motor_inertia


def _greatest(values: Floats) -> Floats:
    """Magnitude that only one row in a thousand exceeds."""
    return np.quantile(np.abs(values), 0.999, axis=0)


def position_faults(log: Log, model: Plausibility) -> list[Fault]:
    """Spikes, dropped rows, and runs of equal values that end with a jump."""
    found: list[Fault] = []
    lines = [_line(log, model, j, *limits) for j, limits in enumerate(zip(_bounds(log, model), _greatest(log.voltage)))]
    jumps: dict[int, list[int]] = {}
    for j, line in enumerate(lines):
        q, channel = log.position[:, j], f"position{j + 1}"
        if line.rows.size > max(CHECKS.row_many_rows, CHECKS.row_many * len(log)):
            continue
        taken = -1
        for n, r in enumerate(line.rows.tolist()):
            if r <= taken:
                continue
            back = _comes_back(log, j, r, line.rows[n + 1 :], line)
            start = int(np.flatnonzero(np.diff(q[:r], prepend=np.nan))[-1])  # of the run of equal values before
            if back is not None:
                taken = back
                name = "a spike" if back == r + 1 else f"a drop-out of {back - r} rows"
                what = f"{name}: {q[r]:.5g} at {log.place(r)}, {line.excess[r]:.3g} beside its neighbours"
                found.append(Fault.of(channel, log.row(r), what, _MOTION, back - r))
            elif r - start >= CHECKS.row_frozen_rows:
                rows = f"from {log.place(start + 1)} to {log.place(r - 1)}"
                what = f"frozen at {q[start]:.6g} {rows}, then a jump by {line.excess[r]:.3g}"
                found.append(Fault.of(channel, log.row(start + 1), what, "a motion that goes on", r - start - 1))
            else:
                jumps.setdefault(r, []).append(j)
    for r, joints in jumps.items():
        found += _jump(log, r, joints, lines)
    return found


@dataclass(frozen=True)
class _Line:
    """One position: rows (m,) that no motion reaches from the row before, by how much (n,), what is allowed (n,), slope
    around and its change there (n,)."""

    rows: Ints
    excess: Floats
    allowed: Floats
    slope: Floats
    bend: Floats


def _line(log: Log, model: Plausibility, j: int, limit: float, volts: float) -> _Line:
    q, steps, around = log.position[:, j], np.diff(log.time), CHECKS.row_around
    slope = np.diff(q) / steps
    padded = np.r_[np.full(around, slope[:around].mean()), slope, np.full(around, slope[-around:].mean())]
    middle = np.median(sliding_window_view(padded, around), axis=1)
    before, after = middle[: len(slope)], middle[around + 1 : around + 1 + len(slope)]
    inside = np.clip(slope, np.minimum(before, after), np.maximum(before, after))
    excess = np.r_[0.0, (slope - inside) * steps]
    noise = FITTING.deviation_of_median * float(np.median(np.abs(np.diff(q, 2)))) / np.sqrt(6.0)
    # the slopes around are those of rows `around` / 2 + 1 away at the middle: the drive may accelerate all the way
    reach = 0.5 * (around + 1) * limit * steps**2
    if model.drive.emf[j] > 0.0:
        reach = np.minimum(reach, CHECKS.row_fastest * volts / model.speed[j] * steps)
    least = max(CHECKS.row_noise * noise, CHECKS.row_quanta * log.quantum[j], 1e-9)
    allowed = np.r_[np.inf, reach + least]
    rows = np.flatnonzero(np.abs(excess) > allowed)
    return _Line(rows, excess, allowed, np.r_[0.0, 0.5 * (before + after)], np.r_[0.0, np.abs(after - before)])


def _comes_back(log: Log, j: int, r: int, later: Ints, line: _Line) -> int | None:
    """The row at which a position that left its line at row r is back on it, or None."""
    q, t = log.position[:, j], log.time
    for k in later[: CHECKS.row_spike].tolist():
        if k - r > CHECKS.row_spike:
            break
        away = q[k] - (q[r - 1] + line.slope[r] * (t[k] - t[r - 1]))
        if abs(away) < CHECKS.row_back * abs(line.excess[r]) and line.excess[k] * line.excess[r] < 0.0:
            return k
    return None


def _jump(log: Log, r: int, joints: Sequence[int], lines: Sequence[_Line]) -> list[Fault]:
    """A jump without return: where all joints that move jump along their way, rows are missing."""
    j = max(joints, key=lambda k: abs(lines[k].slope[r]))
    lost = lines[j].excess[r] / lines[j].slope[r] if lines[j].slope[r] else -1.0
    onward = lost > 0.0 and all(
        abs(line.excess[r] - lost * line.slope[r])
        < lost * (CHECKS.row_onward * abs(line.slope[r]) + 0.5 * line.bend[r]) + line.allowed[r]
        for line in lines
    )
    found = [
        Fault.of(f"position{j + 1}", log.row(r), f"a jump by {lines[j].excess[r]:.3g} at {log.place(r)}", _MOTION)
        for j in joints
    ]
    if onward:
        what = f"the motion jumps on by {lost:.3g} s at {log.place(r)} while the stamps do not: rows are missing"
        found.insert(0, Fault.of("time", log.row(r), what, "every row, or stamps that show the gap"))
    return found


def voltage_spikes(log: Log, model: Plausibility) -> list[Fault]:
    """Single rows of voltage that the joint did not respond to."""
    found = []
    middle = float(np.median(np.diff(log.time)))
    m = max(3, int(CHECKS.row_felt_time / middle))
    inertias = _inertia(log, model, np.mean)
    for j, (v, q) in enumerate(zip(log.voltage.T, log.position.T)):
        away = v - np.median(sliding_window_view(np.pad(v, 3, "edge"), 7), axis=1)
        usual = float(np.quantile(np.abs(away), 0.995))
        rows = np.flatnonzero(np.abs(away) > max(CHECKS.row_volts * usual, CHECKS.row_volts_unit * model.unit[j]))
        if not 0 < rows.size <= max(3, CHECKS.row_many_spikes * len(v)):
            continue
        noise = max(log.quantum[j], 1.5 * float(np.median(np.abs(np.diff(q, 2)))), 1e-12)
        for r in rows.tolist():
            if r < 3 * m or r + 3 * m >= len(q) or away[r - 1] * away[r] > 0.25 * away[r] ** 2:
                continue
            kick = away[r] * middle / (model.k[j] * inertias[j])
            slow = model.k[j] * inertias[j] / model.speed[j] if model.speed[j] > 0.0 else np.inf
            span = m * middle
            travel = kick * slow * (1.0 - np.exp(-span / slow)) if np.isfinite(slow) else kick * span
            # the bend at the row, beside those of the motion before and after
            before, seen, after = (q[k + m] - 2.0 * q[k] + q[k - m] for k in (r - 2 * m, r, r + 2 * m))
            seen -= 0.5 * (before + after)
            visible = abs(travel) > CHECKS.row_visible * noise
            felt = visible and seen / travel > CHECKS.row_felt
            if (visible or abs(v[r]) > CHECKS.row_volts_beyond * float(_greatest(v))) and not felt:
                what = f"a spike: {v[r]:.4g} V at {log.place(r)} between {v[r - 1]:.4g} and {v[r + 1]:.4g} V"
                what = f"{what}, which the joint did not respond to"
                found.append(Fault.of(f"voltage{j + 1}", log.row(r), what, _VOLTAGE, 1))
    return found


def frozen_positions(log: Log, model: Plausibility, c: Coarse) -> list[Fault]:
    """Positions that stand still while the voltage must move the joint."""
    found = []
    static = model.k * model.mechanism.torque(model.theta, c.position, c.velocity, c.acceleration)
    at = _times(log, c)
    for j, (fit, q) in enumerate(zip(model.fits(c), log.position.T)):
        if fit.rows and model.share(fit, j) > CHECKS.row_explained:
            continue  # neither is the motion, then
        unit = model.unit[j]
        held = CHECKS.row_stuck_unknown * unit
        if fit.dry is not None:
            held = min(held, CHECKS.row_stuck * fit.dry + CHECKS.row_beside * unit)
        beyond = soft_threshold(c.voltage[:, j] - static[:, j], held) * c.enabled[:, j]
        low, high = float(q.min()), float(q.max())
        for first, last in _runs(q, log.time, CHECKS.row_frozen_time):
            inside = (at >= log.time[first]) & (at <= log.time[last])
            if inside.sum() < 3:
                continue
            push = beyond[inside]
            if low < high:  # a stop, or friction with the weight, at an end of the travel
                steady = np.ptp(c.voltage[inside, j]) < 2.0 * unit
                beyond_end = np.inf if steady else CHECKS.row_at_an_end * held
                end = CHECKS.row_end * (high - low)
                if q[first] >= high - end:
                    push = np.minimum(push, np.maximum(push - beyond_end, 0.0))
                if q[first] <= low + end:
                    push = np.maximum(push, np.minimum(push + beyond_end, 0.0))
            travel = float(np.abs(push).sum()) * c.step / max(model.speed[j], 1e-12)
            width = float(np.ptp(model.mechanism.ranges[j]))
            if travel > max(CHECKS.row_frozen_travel * width, CHECKS.row_frozen_quanta * log.quantum[j]):
                row = None if last - first >= CHECKS.row_frozen_whole * len(q) else log.row(first + 1)
                rows = f"from {log.place(first + 1)} to {log.place(last)}"
                way = f"{travel:.2g} {model.mechanism.position_unit}"
                what = f"frozen at {q[first]:.6g} {rows} while its voltage must move it by {way}"
                expected = "a motion, or a voltage that friction can hold"
                found.append(Fault.of(f"position{j + 1}", row, what, expected, last - first))
    return found


def frozen_voltages(log: Log, model: Plausibility, c: Coarse) -> list[Fault]:
    """Voltages that stand still while the motion needs others."""
    found = []
    at = _times(log, c)
    for j, v in enumerate(log.voltage.T):
        if not model.mechanism.driven[j]:
            continue
        channel = f"voltage{j + 1}"
        equal = _runs(v, log.time, CHECKS.row_frozen_volts)
        if np.ptp(v) == 0.0 and model.share(model.fit(c, j), j) > CHECKS.row_explained:
            found.append(Fault.of(channel, None, f"frozen at {v[0]:.5g} V while the joint moves otherwise", _VOLTAGE))
        if sum(b - a for a, b in equal) > CHECKS.row_steps * len(v):
            continue  # a voltage of steps
        for first, last in equal:
            if v[first] == 0.0 or abs(v[first]) > CHECKS.row_limit * float(np.abs(v).max()):
                continue  # off, or at the limit of the supply
            start, end = log.time[first], log.time[last]
            near = (at > start - 0.2) & (at < end + 0.2)
            inside = (at > start + 0.05) & (at < end - 0.05) & model.moving(c, j)
            fit = model.fit(c, j, without=near)
            if inside.sum() < 3 or not fit.rows:
                continue
            here = float(np.sqrt(np.mean(fit.residual[inside] ** 2)))
            if here > max(model.unit[j], CHECKS.row_beside_motion * fit.left):
                rows = f"from {log.place(first + 1)} to {log.place(last)}"
                what = f"frozen at {v[first]:.5g} V {rows}, {here:.2g} V beside what the motion takes"
                found.append(Fault.of(channel, log.row(first + 1), what, _VOLTAGE, last - first))
    return found


def _times(log: Log, c: Coarse) -> Floats:
    """(n,) times of the rows of a log's coarse series."""
    n = len(c.voltage)
    return 0.5 * (log.time[0] + log.time[-1]) + c.step * (np.arange(n) - 0.5 * (n - 1))


def _runs(values: Floats, time: Floats, shortest: float) -> list[tuple[int, int]]:
    """(first, last) rows of runs of equal values that last at least `shortest` [s]."""
    return [(a, b) for a, b in runs(np.diff(values) == 0.0) if time[b] - time[a] >= shortest]


def _channels(log: Log) -> Iterator[tuple[str, Floats]]:
    yield "time", log.time
    for group in ("voltage", "position", "velocity", "current", "setpoint"):
        yield from _of_joints(group, getattr(log, group))
    # of a joint without such a sensor there is no number at all
    for name, values in _of_joints("link_position", log.link_position):
        if not np.isnan(values).all():
            yield name, values
    yield from _enables(log)


def _enables(log: Log) -> Iterator[tuple[str, Floats]]:
    if log.enable is not None:
        alike = np.array_equal(log.enable, log.enable[:, :1].repeat(log.joints, axis=1), equal_nan=True)
        yield from [("enable", log.enable[:, 0])] if alike else _of_joints("enable", log.enable)


def _of_joints(group: str, values: Floats | None) -> Iterator[tuple[str, Floats]]:
    return ((f"{group}{j + 1}", column) for j, column in enumerate([] if values is None else values.T))


def first_of_each(found: Sequence[Fault]) -> list[Fault]:
    """The first fault of each channel, with the number of the others."""
    result = []
    for channel in dict.fromkeys(fault.channel for fault in found):
        first, *others = sorted((f for f in found if f.channel == channel), key=lambda f: f.row or 0)
        result.append(replace(first, what=first.what + f" ({len(others)} more)" * bool(others)))
    return result
