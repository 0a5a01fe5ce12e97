# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The plan: which record has what. A recipe is small, can be pickled, and says all but draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from blind.effects import COMMON, EFFECTS, WHOLE_ARM
from blind.faults import FAULTS
from blind.outside import OUTSIDE

#: a pair that on one joint is a single effect to any log: a spring about another angle
ONE_ANGLE = {"joint_spring", "voltage_offset"}
#: servo period [s] of the arm: 28 ms over 30
SERVO = 0.028 / 30


@dataclass(frozen=True)
class Recipe:
    """What a record holds; the rest is drawn from `seed`.

    effects : (name, joint 0-based or None) each; sizes : asked for, over the noise floor; outside :
    (kind, joint) or None; fault : kind or None; period [s]; motion, or None: drawn; check : the
    seed of another motion and noise with the same plant.
    """

    name: str
    seed: int
    effects: tuple[tuple[str, int | None], ...] = ()
    sizes: tuple[float, ...] = ()
    outside: tuple[str, int] | None = None
    fault: str | None = None
    period: float = SERVO
    seconds: float = 10.0
    motion: str | None = None
    feedback: bool = True
    dither: bool = True
    coloured: bool = False
    setpoint: bool = True


#: kinds of record
KINDS = ("nothing", "common", "effect", "pair", "outside", "fault")


def plan(kind: str, seed: int, count: int, turn: int = 0) -> list[Recipe]:
    """`count` recipes with seeds from `seed` on.

    kind : one of `KINDS`, or the name of an effect. Effects, outsiders and faults take turns, so
    that each has its share of any count; turn : whose turn it is first.
    """
    return [_recipe(kind, seed + k, turn + k) for k in range(count)]


def _recipe(kind: str, seed: int, turn: int) -> Recipe:
    rng = np.random.default_rng([seed, 1])
    common = {
        "name": f"record_{seed:06d}",
        "seed": seed,
        "period": float(rng.choice([SERVO, 1e-3, 5e-3], p=[0.7, 0.15, 0.15])),
        "feedback": bool(rng.random() < 0.75),
        "dither": bool(rng.random() < 0.5),
        "coloured": bool(rng.random() < 0.35),
        "setpoint": bool(rng.random() < 0.75),
    }
    if kind == "nothing":
        return Recipe(**common)
    if kind in ("common", "effect") or kind in EFFECTS:
        names = {"common": COMMON, "effect": tuple(EFFECTS)}.get(kind, (kind,))
        name = names[turn % len(names)]
        return Recipe(**_fit(common, rng, name), effects=(_placed(rng, name),), sizes=(_size(rng),))
    if kind == "pair":
        names = tuple(EFFECTS)
        first = names[turn % len(names)]
        while True:
            second = str(rng.choice(names))
            if EFFECTS[second].family != EFFECTS[first].family:
                break
        placed = [_placed(rng, first), _placed(rng, second)]
        same = {first, second} == ONE_ANGLE and placed[0][1] == placed[1][1]
        if (rng.random() < 0.5 or same) and None not in (placed[0][1], placed[1][1]):
            free = [j for j in EFFECTS[second].joints if j != placed[0][1]]
            placed[1] = (second, int(rng.choice(free)))
        return Recipe(
            **_fit(_fit(common, rng, second), rng, first),
            effects=tuple(placed),
            sizes=(_size(rng, 1.5), _size(rng, 1.5)),
        )
    if kind == "outside":
        names = tuple(OUTSIDE)
        name = names[turn % len(names)]
        made = OUTSIDE[name]
        common["motion"] = str(rng.choice(made.motions))
        return Recipe(**common, outside=(name, int(rng.choice(made.joints))), sizes=(_size(rng, 1.5),))
    if kind == "fault":
        return Recipe(**common, fault=FAULTS[turn % len(FAULTS)])
    raise ValueError(f"kind of record {kind!r}: expected one of {KINDS} or the name of an effect")


def committed() -> list[Recipe]:
    """The records under `records/`: small ones, with effects well above the noise floor."""
    plain: list[dict] = [
        {"motion": "fourier", "feedback": False, "dither": False},
        {"motion": "points"},
        {"motion": "triangles", "dither": False, "setpoint": True},
        {"motion": "wide", "period": SERVO, "seconds": 4.0},
    ]
    single = [
        "coulomb_friction",
        "stribeck_friction",
        "quadratic_friction",
        "torque_ripple",
        "backlash",
        "joint_elasticity",
        "payload",
        "base_tilt",
        "voltage_dead_band",
        "resistance_drift",
        "input_delay",
        "sensor_nonlinearity",
    ]
    pairs = [(("coulomb_friction", 0), ("joint_spring", 2)), (("quadratic_friction", 0), ("voltage_offset", 1))]
    strange = [("shake_in_time", 1), ("cable_from_another_joint", 2)]
    spoilt = ["gap", "swapped_positions", "degrees", "frozen_position"]

    wanted: list[dict] = list(plain)
    for k, name in enumerate(single):
        rng = np.random.default_rng([1000, k])
        more = _fit({"feedback": k % 4 != 3, "dither": k % 2 == 0}, rng, name)
        if name == "joint_elasticity":
            more.update(period=SERVO, seconds=4.0)
        if name == "payload":
            more.update(seed=1075, seconds=8.0)  # one of almost 5 kg
        placed = ("quadratic_friction", 0) if name == "quadratic_friction" else _placed(rng, name)
        wanted.append(dict(more, effects=(placed,), sizes=(6.0,)))
    wanted += [{"motion": "wide", "effects": pair, "sizes": (5.0, 5.0)} for pair in pairs]
    wanted += [{"motion": "wide", "outside": each, "sizes": (6.0,)} for each in strange]
    wanted += [{"motion": "points", "fault": kind, "seconds": 4.0} for kind in spoilt]
    return [
        Recipe(
            **{
                "name": f"record_{1000 + k:06d}",
                "seed": 1000 + k,
                "period": 5e-3,
                "seconds": 6.0,
                "setpoint": False,
                **each,
            }
        )
        for k, each in enumerate(wanted)
    ]


def _placed(rng, name: str) -> tuple[str, int | None]:
    return name, None if name in WHOLE_ARM else int(rng.choice(EFFECTS[name].joints))


def _size(rng, low: float = 0.6) -> float:
    """Evenly over the decades from `low` to ten times the floor."""
    return float(f"{low * (10.0 / low) ** rng.random():.3g}")


def _fit(common: dict, rng, name: str) -> dict:
    """The excitation that the effect needs."""
    effect = EFFECTS[name]
    common = dict(common, motion=str(rng.choice(effect.motions)))
    if effect.band:
        common["dither"] = True
    if not effect.open_loop:
        common["feedback"] = True
    return common
