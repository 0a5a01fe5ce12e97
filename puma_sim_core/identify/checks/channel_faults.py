# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Channels that are not what they are called: exchanged, turned round, in another unit or offset;
and logs of another plant.

Each such mistake is a way to put the log right. A log whose voltage the model cannot explain as it
stands (see `plausibility`), and explains with one of these ways, has that fault; one that none of
them explains is of another plant.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from puma_sim_core.identify.checks.plausibility import Coarse, Plausibility
from puma_sim_core.identify.checks.prior_fit import PriorFit
from puma_sim_core.identify.result import Fault
from puma_sim_core.identify.settings import CHECKS

_OFFSETS = tuple(
    sign * size for size in (0.15, 0.2, 0.3, 0.4, 0.55, 0.8, 1.1, np.pi / 2.0, np.pi) for sign in (1.0, -1.0)
)
#: factors of units: what the numbers are in, and by what they must be multiplied
_POSITION_UNITS = (
    ("degrees, not radians", np.pi / 180.0),
    ("thousandths of the unit", 1e-3),
    ("a unit a thousand times as large", 1e3),
    ("turns, not radians", 2.0 * np.pi),
    ("angles of the motor: the gear ratio is left out", None),
)
_VOLTAGE_UNITS = (
    ("millivolts, not volts", 1e-3),
    ("kilovolts, not volts", 1e3),
    ("raw counts, not volts", 40.0 / 2048.0),
)


@dataclass(frozen=True)
class Way:
    """A way to put a log right: the faults that it stands for, what is changed (arguments of
    `Coarse.changed`), and how unusual it is (smaller ones win among the alike)."""

    faults: tuple[Fault, ...]
    change: dict
    unusual: float


def channel_faults(model: Plausibility, c: Coarse) -> list[Fault]:
    """Faults of whole channels that one can name."""
    found: list[Fault] = []
    for _ in range(2 * c.joints):
        way = _best(model, c)
        if way is None:
            break
        found += [fault for fault in way.faults if fault.channel not in {f.channel for f in found}]
        c = c.changed(**way.change)
    if found and model.shares(model.fits(c), CHECKS.channel_another_floor).max() < CHECKS.channel_another:
        return found
    return []


def moderate_faults(model: Plausibility, c: Coarse, slow: Coarse) -> list[Fault]:
    """A scale or an offset of one position that no parameter makes, and that holds for the `slow`
    motion alone too, where lags have no say."""
    found = _nearer(model, c)
    if not found:
        return []
    change, fault = found
    near = PriorFit(model)
    counted = [model.moving(slow, j) for j in range(slow.joints)]
    before, after = (near.costs(other, counted)[0] for other in (slow, slow.changed(**change)))
    return [fault] if after < CHECKS.channel_holds * before else []


def unexplained(model: Plausibility, c: Coarse) -> list[Fault]:
    """Joints whose voltage nothing explains: they stand still, or the log is of another plant."""
    found = []
    fits = model.fits(c)
    shares = model.shares(fits, CHECKS.channel_another_floor)
    for j in np.flatnonzero(shares >= CHECKS.channel_another):
        rest = f"; expected a log of {model.mechanism.name}, with channels in the order and units of the format"
        if not fits[j].rows:
            found.append(
                Fault(
                    f"position{j + 1}",
                    None,
                    "frozen: it stays within "
                    f"{np.ptp(c.position[:, j]):.2g} while its voltage must move it; "
                    "expected a motion, or a voltage that friction can hold",
                )
            )
        else:
            found.append(
                Fault(
                    f"voltage{j + 1}",
                    None,
                    f"{100 * min(shares[j], 1.0):.0f} % of the "
                    f"voltage of joint {j + 1} cannot be explained by any parameters or "
                    f"effects, nor by exchanged channels or other units{rest}",
                )
            )
    return found


def _best(model: Plausibility, c: Coarse) -> Way | None:
    """The way that puts the log right best, or None where nothing is wrong or none does."""
    fits = model.fits(c)
    before = model.shares(fits)
    if model.shares(fits, CHECKS.channel_another_floor).max() < CHECKS.channel_asked:
        return None
    worst = int(before.argmax())
    enough = min(CHECKS.channel_shrinks * before[worst], max(CHECKS.channel_left, 0.1 * before[worst]))
    tried = []
    for way in _ways(model, c):
        other = c.changed(**way.change)
        if model.share(model.fit(other, worst), worst) >= enough:
            continue
        changed = model.fits(other)
        after = model.shares(changed)
        # what hardly moves any more, or hardly has a voltage, is not explained by that
        moved = [
            j
            for j, fit in enumerate(changed)
            if fit.rows
            and after[j] < CHECKS.channel_shrinks * before[j]
            and fit.left <= CHECKS.channel_left_at_all * fit.scale
        ]
        still = sum(changed[j].rows for j in moved) >= CHECKS.channel_still_moves * max(fit.rows for fit in fits)
        if np.any(np.abs(way.change.get("volts", 1.0)) != 1.0):
            after = np.maximum(after, CHECKS.channel_alike_share)  # greater volts shrink their floor
        if still:
            tried.append((float(np.log(after / before).sum()), way))
    best = min((score for score, _ in tried), default=0.0)
    if best > np.log(CHECKS.channel_shrinks):
        return None
    return min(
        ((way.unusual, score, n, way) for n, (score, way) in enumerate(tried) if score <= best + CHECKS.channel_alike),
        key=lambda entry: entry[:3],
    )[3]


def _ways(model: Plausibility, c: Coarse):
    J, unit = c.joints, model.mechanism.position_unit

    def only(joint, value):
        return np.where(np.arange(J) == joint, value, 1.0)

    def whole(name, joints, what):
        return tuple(Fault(f"{name}{j + 1}", None, what) for j in joints)

    for j in range(J):
        tie = "" if J > 1 else " (or that of voltage1: with one joint they look alike)"
        yield Way(
            whole(
                "position",
                [j],
                "its sign is turned: the voltage drives the joint the "
                f"other way; expected positive volts for positive motion{tie}",
            ),
            {"scale": only(j, -1.0)},
            0,
        )
        if J > 1:
            yield Way(
                whole(
                    "voltage",
                    [j],
                    "its sign is turned: it drives the joint the other "
                    "way; expected positive volts for positive motion",
                ),
                {"volts": only(j, -1.0)},
                1,
            )
    for name, key in (("position", "positions"), ("voltage", "voltages")):
        for order in permutations(range(J)):
            moved = [j for j in range(J) if order[j] != j]
            if not moved:
                continue
            faults = tuple(
                Fault(
                    f"{name}{j + 1}",
                    None,
                    f"it moves as {name}{order.index(j) + 1} should: the channels are "
                    f"exchanged; expected {name} of joint {j + 1}",
                )
                for j in moved
            )
            yield Way(faults, {key: order}, len(moved) - 1 + (name == "voltage"))
    for sort, (what, factor) in enumerate(_POSITION_UNITS):
        for group in _groups(J):
            scale = np.array([(factor or 1.0 / model.mechanism.gear[j]) if j in group else 1.0 for j in range(J)])
            if np.all(scale == 1.0) or (unit == "m" and sort in (0, 3, 4)):
                continue
            yield Way(
                whole("position", group, f"its numbers are {what}; expected {unit}"),
                {"scale": scale},
                2.0 + sort + 0.1 * len(group),
            )
    for sort, (what, factor) in enumerate(_VOLTAGE_UNITS):
        for group in _groups(J):
            volts = np.array([factor if j in group else 1.0 for j in range(J)])
            size = [float(np.abs(c.voltage[:, j]).max()) / model.unit[j] for j in group]
            if (factor < 1.0 and min(size) < CHECKS.channel_great) or (
                factor > 1.0 and max(size) > CHECKS.channel_small
            ):
                continue
            yield Way(
                whole("voltage", group, f"its numbers are {what}; expected V"),
                {"volts": volts},
                3.0 + sort + 0.1 * len(group),
            )
    for what, factor in (("milliseconds", 1e-3), ("minutes", 60.0)):
        yield Way((Fault("time", None, f"its numbers are {what}; expected seconds"),), {"clock": factor}, 5)


def _groups(J: int):
    """Joints one by one, by twos, all."""
    for size in range(1, J + 1):
        yield from combinations(range(J), size)


def _nearer(model: Plausibility, c: Coarse) -> tuple[dict, Fault] | None:
    """The change of one position that brings the log nearest to the priors, if by enough."""
    near, c = PriorFit(model), c.thinned(CHECKS.channel_rows)
    counted = [model.moving(c, j) for j in range(c.joints)]
    before, _ = near.costs(c, counted)
    if before < CHECKS.channel_far:
        return None
    left = model.shares(model.fits(c), CHECKS.channel_another_floor)
    least, best = min(before - CHECKS.channel_gain, CHECKS.channel_nearer * before, CHECKS.channel_near), None
    for j in range(c.joints):
        volts = model.speed[j] * c.velocity[counted[j], j]
        if len(volts) < CHECKS.channel_moving_rows * len(c.velocity) or (
            np.sqrt(np.mean(volts**2)) < CHECKS.channel_moving * model.unit[j]
        ):
            continue  # what hardly moves tells of friction alone
        for change, dearer, what in _changes(model, j, left[j]):
            cost = dearer * near.costs(c.changed(**change), counted)[0]
            if cost < least:
                least, best = cost, (change, Fault(f"position{j + 1}", None, what))
    return best


def _changes(model: Plausibility, j: int, left: float):
    """(change, factor of its cost, what it says) of scales and offsets of a position."""
    unit, one = model.mechanism.position_unit, np.arange(model.mechanism.joints) == j
    for size in (*CHECKS.channel_scales, *(CHECKS.channel_far_scales if left > CHECKS.channel_far_asked else ())):
        yield (
            {"scale": np.where(one, 1.0 / size, 1.0)},
            1.0,
            (
                f"its scale is wrong by a factor of about {size:.2g}; expected {unit} at the joint (is "
                "the gear ratio right?)"
            ),
        )
    for size in _OFFSETS if unit == "rad" else ():
        yield (
            {"offset": np.where(one, -size, 0.0)},
            CHECKS.channel_surer,
            (
                f"it is offset by about {size:.2g} rad, as its weight shows; expected an encoder "
                "offset of a few hundredths at most"
            ),
        )
