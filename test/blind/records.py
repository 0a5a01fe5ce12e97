# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The plan: which record has what. A recipe is small, can be pickled, and says all but draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from blind.cases import CASES
from blind.effects import COMMON, EFFECTS, WHOLE_ARM
from blind.faults import FAULTS
from blind.outside import OUTSIDE

#: a pair that on one joint is a single effect to any log: a spring about another angle
ONE_ANGLE = {"joint_spring", "voltage_offset"}
#: servo period [s] of the arm: 28 ms over 30
SERVO = 0.028 / 30
#: of the generator; 1 made the records that are committed, and all others with seeds up to 920339. The same seed has
#: other draws in another version
VERSION = 2


def random(seed: int, stream: int, version: int) -> np.random.Generator:
    """A stream of numbers of a record; 1: its recipe, 2: parameters, 3: motion, 4: noise, 5: effects (15, 25: drawn
    again), 6, 7: faults."""
    return np.random.default_rng([seed, stream] if version == 1 else [seed, stream, version])


@dataclass(frozen=True)
class Recipe:
    """What a record holds; the rest is drawn from `seed`.

    effects : (name, joint 0-based or None) each; sizes : asked for, over the noise floor; outside :
    (kind, joint) or None; fault : kind or None; period [s]; motion, or None: drawn; check : the
    seed of another motion and noise with the same plant; case : one of `cases`, whose effects are not scaled to a size;
    version : of the generator.
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
    case: str | None = None
    version: int = VERSION

    def random(self, stream: int, seed: int | None = None) -> np.random.Generator:
        """As `random`, of this record, or of another seed."""
        return random(self.seed if seed is None else seed, stream, self.version)


#: kinds of record
KINDS = ("nothing", "common", "effect", "case", "pair", "outside", "fault")


def plan(kind: str, seed: int, count: int, turn: int = 0) -> list[Recipe]:
    """`count` recipes with seeds from `seed` on.

    kind : one of `KINDS`, or the name of an effect or a case. Effects, cases, outsiders and faults take turns, so
    that each has its share of any count; turn : whose turn it is first.
    """
    return [_recipe(kind, seed + k, turn + k) for k in range(count)]


def _recipe(kind: str, seed: int, turn: int) -> Recipe:
    rng = random(seed, 1, VERSION)
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
    if kind == "case" or kind in CASES:
        return _case(common, rng, kind if kind in CASES else tuple(CASES)[turn % len(CASES)])
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
    raise ValueError(f"kind of record {kind!r}: expected one of {KINDS}, the name of an effect or of a case")


def _case(common: dict, rng, name: str) -> Recipe:
    case = CASES[name]
    for effect in case.effects:
        common = _fit(common, rng, effect)
    if case.motions:
        common["motion"] = str(rng.choice(case.motions))
    if case.periods:
        common["period"] = float(rng.choice(case.periods))
    # a controller that oscillates, or runs against a limit or a stop, is one with feedback
    common["feedback"] = True
    placed = tuple(_placed(rng, effect) for effect in case.effects)
    sizes = tuple(_size(rng) for _ in case.effects)
    return Recipe(**common, effects=placed, sizes=sizes, case=name)


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
                "version": 1,
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
