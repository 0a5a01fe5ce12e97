# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Channels that are not what they are called: exchanged, of the other sign, in another unit or offset; and logs of
another plant.

Each such mistake has a correction. A log whose voltage the model cannot explain as it stands (see `plausibility`), and
explains with one of these corrections, has that fault; one that none of them explains is of another plant.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.checks.plausibility import Change, Coarse, Plausibility
from puma_sim_core.identify.checks.prior_fit import PriorFit
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.settings import CHECKS

#: what the numbers are in, the unit as names of columns have it ("" where they cannot), by what they must be
#: multiplied (None: over the gear ratio), whether a slide can have it
_POSITION_UNITS = (
    ("degrees, not radians", "deg", np.pi / 180.0, False),
    ("thousandths of the unit", "m{unit}", 1e-3, True),
    ("a unit a thousand times as large", "", 1e3, True),
    ("turns, not radians", "turns", 2.0 * np.pi, False),
    ("angles of the motor: the gear ratio is left out", "", None, False),
)
_VOLTAGE_UNITS = (("millivolts", "mV", 1e-3), ("kilovolts", "", 1e3), ("raw counts", "", 40.0 / 2048.0))
_TIME_UNITS = (("milliseconds", "ms", 1e-3), ("minutes", "", 60.0))


@dataclass(frozen=True)
class Correction:
    """A correction of a log: the faults that it stands for, and how unusual it is (the least wins among the alike)."""

    faults: tuple[Fault, ...]
    change: Change
    unusual: float


def in_the_name(channel: str, unit: str) -> str:
    """Words on how a log can keep its unit; "" without one."""
    return f", or a column whose name ends with the unit, such as {channel}_{unit}" if unit else ""


def channel_faults(model: Plausibility, c: Coarse) -> list[Fault]:
    """Faults of whole channels that can be named."""
    found: list[Fault] = []
    for _ in range(2 * c.joints):
        best = _best(model, c)
        if best is None:
            break
        found += [fault for fault in best.faults if fault.channel not in {f.channel for f in found}]
        c = c.changed(best.change)
    if found and model.shares(model.fits(c), CHECKS.channel_another_floor).max() < CHECKS.channel_another:
        return found
    return []


def moderate_faults(model: Plausibility, c: Coarse, slow: Coarse) -> list[Fault]:
    """A scale or an offset of one position that no parameter makes, nor, by the `slow` motion alone, a lag."""
    best = _nearer(model, c)
    if best is None:
        return []
    change, fault = best
    near, counted = PriorFit(model), [model.moving(slow, j) for j in range(slow.joints)]
    before, after = (near.cost(other, counted) for other in (slow, slow.changed(change)))
    return [fault] if after < CHECKS.channel_holds * before else []


def unexplained(model: Plausibility, c: Coarse) -> list[Fault]:
    """Joints whose voltage nothing explains: they stand still, or the log is of another plant."""
    found = []
    fits = model.lasting_fits(c)
    shares = model.shares(fits, CHECKS.channel_another_floor)
    for j in np.flatnonzero(shares >= CHECKS.channel_another):
        channel, expected = f"position{j + 1}", "a motion, or a voltage that friction can hold"
        what = f"frozen: it stays within {np.ptp(c.position[:, j]):.2g} while its voltage must move it"
        if fits[j].rows:
            channel = f"voltage{j + 1}"
            what = f"{100 * min(shares[j], 1.0):.0f} % of the voltage of joint {j + 1} cannot be explained by any "
            what += "parameters or effects, nor by exchanged channels or other units"
            expected = f"a log of {model.mechanism.name}, with channels in the order and units of the format"
        found.append(Fault.of(channel, None, what, expected))
    return found


def _best(model: Plausibility, c: Coarse) -> Correction | None:
    """The best correction of the log, or None where nothing is wrong or none helps."""
    fits = model.fits(c)
    before = model.shares(fits)
    if model.shares(fits, CHECKS.channel_another_floor).max() < CHECKS.channel_asked:
        return None
    worst = int(before.argmax())
    left = max(CHECKS.channel_left, CHECKS.channel_left_of * before[worst])
    enough, tried = min(CHECKS.channel_shrinks * before[worst], left), []
    for correction in _corrections(model, c):
        other = c.changed(correction.change)
        if model.share(model.fit(other, worst), worst) >= enough:
            continue
        changed = model.fits(other)
        after = model.shares(changed)
        # what hardly moves any more, or hardly has a voltage, is not explained by that
        moved = [
            fit.rows
            for fit, now, then in zip(changed, after, before)
            if fit.rows and now < CHECKS.channel_shrinks * then and fit.left <= CHECKS.channel_left_at_all * fit.scale
        ]
        still = sum(moved) >= CHECKS.channel_still_moves * max(fit.rows for fit in fits)
        # greater volts shrink their floor
        scaled = np.abs(correction.change.volts) != 1.0
        after = np.where(scaled, np.maximum(after, CHECKS.channel_alike_share), after)
        if still:
            tried.append((float(np.log(after / before).sum()), correction))
    best = min((score for score, _ in tried), default=0.0)
    if best > np.log(CHECKS.channel_shrinks):
        return None
    alike = [(score, each) for score, each in tried if score <= best + CHECKS.channel_alike]
    return min(alike, key=lambda pair: (pair[1].unusual, pair[0]))[1]


def _corrections(model: Plausibility, c: Coarse) -> Iterator[Correction]:
    J, unit = c.joints, model.mechanism.position_unit

    def factors(joints: Iterable[int], value: float) -> Floats:
        out = np.ones(J)
        out[list(joints)] = value
        return out

    def whole(name: str, joints: Iterable[int], what: str, expected: str) -> tuple[Fault, ...]:
        return tuple(Fault.of(f"{name}{j + 1}", None, what, expected) for j in joints)

    expected = "positive volts for positive motion"
    tie = "" if J > 1 else " (or voltage1 has: with one joint they look alike)"
    for j in range(J):
        what = "it has the wrong sign: the voltage drives the joint the other way"
        yield Correction(whole("position", [j], what, expected + tie), Change(scale=factors([j], -1.0)), 0)
        if J > 1:
            what = "it has the wrong sign: it drives the joint the other way"
            yield Correction(whole("voltage", [j], what, expected), Change(volts=factors([j], -1.0)), 1)
    for name in ("position", "voltage"):
        for order in permutations(range(J)):
            moved = [j for j in range(J) if order[j] != j]
            faults: tuple[Fault, ...] = ()
            for j in moved:
                what = f"it moves as {name}{order.index(j) + 1} should: the channels are exchanged"
                faults += whole(name, [j], what, f"{name} of joint {j + 1}")
            if moved:
                change = Change(positions=order) if name == "position" else Change(voltages=order)
                yield Correction(faults, change, len(moved) - 1 + (name == "voltage"))
    groups = [group for size in range(1, J + 1) for group in combinations(range(J), size)]
    for sort, (what, suffix, factor, slides) in enumerate(_POSITION_UNITS):
        for group in groups if slides or unit != "m" else ():
            scale = np.array([(factor or 1.0 / model.mechanism.gear[j]) if j in group else 1.0 for j in range(J)])
            if not np.all(scale == 1.0):
                expected = unit + in_the_name("position1", suffix.format(unit=unit))
                faults = whole("position", group, f"its numbers are {what}", expected)
                yield Correction(faults, Change(scale=scale), 2.0 + sort + 0.1 * len(group))
    for sort, (what, suffix, factor) in enumerate(_VOLTAGE_UNITS):
        for group in groups:
            size = [float(np.abs(c.voltage[:, j]).max()) / model.unit[j] for j in group]
            if min(size) >= CHECKS.channel_great if factor < 1.0 else max(size) <= CHECKS.channel_small:
                expected = "V" + in_the_name("voltage1", suffix)
                faults = whole("voltage", group, f"its numbers are {what}, not volts", expected)
                yield Correction(faults, Change(volts=factors(group, factor)), 3.0 + sort + 0.1 * len(group))
    for what, suffix, factor in _TIME_UNITS:
        expected = "seconds" + in_the_name("time", suffix)
        yield Correction((Fault.of("time", None, f"its numbers are {what}", expected),), Change(clock=factor), 5)


def _nearer(model: Plausibility, c: Coarse) -> tuple[Change, Fault] | None:
    """The change of one position that brings the log nearest to the priors, if by enough."""
    near, c = PriorFit(model), c.thinned(CHECKS.channel_rows)
    counted = [model.moving(c, j) for j in range(c.joints)]
    before = near.cost(c, counted)
    if before < CHECKS.channel_far:
        return None
    left = model.shares(model.fits(c), CHECKS.channel_another_floor)
    least, best = min(before - CHECKS.channel_gain, CHECKS.channel_nearer * before, CHECKS.channel_near), None
    for j in range(c.joints):
        volts = model.speed[j] * c.velocity[counted[j], j]
        if len(volts) < CHECKS.channel_moving_rows * len(c.velocity) or (
            np.sqrt(np.mean(volts**2)) < CHECKS.channel_moving * model.unit[j]
        ):
            continue  # what hardly moves shows friction alone
        for change, dearer, what, expected in _changes(model, j, left[j]):
            cost = dearer * near.cost(c.changed(change), counted)
            if cost < least:
                least, best = cost, (change, Fault.of(f"position{j + 1}", None, what, expected))
    return best


def _changes(model: Plausibility, j: int, left: float) -> Iterator[tuple[Change, float, str, str]]:
    """(change, factor of its cost, fault, what was expected) of scales and offsets of a position."""
    unit, one = model.mechanism.position_unit, np.arange(model.mechanism.joints) == j
    for size in (*CHECKS.channel_scales, *(CHECKS.channel_far_scales if left > CHECKS.channel_far_asked else ())):
        what, expected = f"its scale is wrong by a factor of about {size:.2g}", f"{unit} at the joint"
        yield Change(scale=np.where(one, 1.0 / size, 1.0)), 1.0, what, f"{expected} (is the gear ratio right?)"
    for offset in CHECKS.channel_offsets if unit == "rad" else ():
        for size in (offset, -offset):
            what = f"it is offset by about {size:.2g} rad, as its weight shows"
            expected = "an encoder offset of a few hundredths at most"
            yield Change(offset=np.where(one, -size, 0.0)), CHECKS.channel_surer, what, expected
