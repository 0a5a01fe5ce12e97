# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The excitation that best tells effects apart, or shows one: a seeded search.

Random motions, then neighbours of the best ones, are judged by `separation` on what the machine would do if the effect
were there. The voltages of the best ones are simulated on machines whose parameters are wrong by 8 %, and with the
effects in them; a motion is made smaller until all of them stay in their ranges.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.effects.relations import EXACT_TIES
from puma_sim_core.errors import ParameterError, one_of
from puma_sim_core.identify.arrays import Floats
from puma_sim_core.identify.experiment.excitation import Builder, Limits, Motion, voltages
from puma_sim_core.identify.experiment.separation import (
    NUMBERS,
    Direction,
    Distance,
    Judge,
    Suspect,
    plant_with,
    simulate,
)
from puma_sim_core.identify.settings import EXPERIMENT, SELECTION
from puma_sim_core.jit import BACKEND, is_compiled
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD


@dataclass(frozen=True)
class Design:
    """An excitation. time (n,) [s]; voltage (n, J) [V], each held until the next row; setpoint (n, J) [rad or m]: the
    motion that the start model makes under it; start (J,): its pose at rest at the beginning.

    nats : expected gain of log evidence of the effect that is there; plain : that of one slow sine a joint; suspects :
    labels of what it is for; one_way : the only one that can be told from the other, where the other is a special case
    of it; motion : the planned one; seed.
    """

    time: Floats
    voltage: Floats
    setpoint: Floats
    start: Floats
    nats: float
    plain: float
    suspects: tuple[str, ...]
    one_way: str | None
    motion: Motion
    seed: int

    @property
    def noises(self) -> float:
        """Voltage over the whole record that no parameter nor other effect makes, over noise."""
        return float(np.sqrt(2.0 * self.nats / (NUMBERS * self.motion.seconds)))

    @property
    def sentence(self) -> str:
        """What is to be expected of it."""
        if len(self.suspects) == 1:
            what = f"shows {self.suspects[0]} of a usual size"
        elif self.one_way is not None:
            other = next(s for s in self.suspects if s != self.one_way)
            what = f"tells {self.one_way} of a usual size from {other}, which it has as a special case"
        else:
            what = f"tells {', '.join(self.suspects[:-1])} and {self.suspects[-1]} of a usual size apart"
        return (
            f"{what} by {self.nats:.3g} nat, which is {self.noises:.2g} times a noise of "
            f"{EXPERIMENT.separation_noise:g} V all the time (one slow sine a joint: {self.plain:.3g} nat)"
        )


def suspects_of(texts: Sequence[str], mechanism: Mechanism, joint: int | None = None) -> tuple[Suspect, ...]:
    """Suspects from ``name`` or ``name@joint``, joint (1-based) for those without one.

    Raises
    ------
    ParameterError : an effect or a joint that is not there, that this mechanism cannot have or
        that no motion can show; too many; the same twice; a joint without a drive on volts.
    """
    if set(mechanism.inputs) != {"voltage"}:
        what = f"'{mechanism.name}' has a joint that cannot be given volts"
        raise ParameterError(what, where="--plant", expected="a mechanism whose joints are all driven, without servos")
    if not 1 <= len(texts) <= EXPERIMENT.design_suspects:
        expected = f"one, or up to {EXPERIMENT.design_suspects} to tell apart"
        raise ParameterError(f"{len(texts)} effects", where="--separate", expected=expected)
    found = tuple(_suspect(text.strip(), mechanism, joint) for text in texts)
    if len(set(found)) < len(found):
        twice = next(each for n, each in enumerate(found) if each in found[:n])
        raise ParameterError(f"{twice.label} twice", where="--separate", expected="each effect once")
    return found


def _suspect(text: str, mechanism: Mechanism, joint: int | None) -> Suspect:
    name, at, place = text.partition("@")

    def refused(what: str, expected: str) -> ParameterError:
        return ParameterError(what, where=f"--separate {text}", expected=expected)

    kind = KINDS.get(name)
    if kind is None:
        raise refused(f"unknown effect '{name}'", one_of(name, KINDS, "`puma-sim list`"))
    if kind.screening is None:
        raise refused("is a parameter of every mechanism", "an effect; " + _reason(name))
    if not mechanism.possible(name):
        raise refused(f"has no meaning on {mechanism.name}", "an effect that this mechanism can have")
    if not kind.repeatable:
        raise refused("cannot be brought about", "an effect that a motion shows; to rule out an impact, repeat one")
    if not kind.per_joint:
        if at:
            raise refused(f"joint {place}", "no joint: it acts on the whole arm")
        return Suspect(kind, None)
    J = mechanism.joints
    number = int(place) if place.isdigit() else None if at else joint or (1 if J == 1 else None)
    if number is None or not 1 <= number <= J:
        what = f"joint '{place}'" if at else "no joint" if number is None else f"joint {number}"
        raise refused(what, f"{name}@1" + (f" to {name}@{J}, or --joint" if J > 1 else ""))
    return Suspect(kind, number)


def _reason(*labels: str) -> str:
    """What the library says on an exact tie of these."""
    names = [label.partition("@")[0] for label in labels]
    found = [
        f"{one} and {other} are an exact tie: {why}"
        for one, other, why in EXACT_TIES
        if any(one.startswith(n) or other.startswith(n) for n in names)
    ]
    return "; ".join(found) or "voltage and position are the same for both"


def design(
    mechanism: Mechanism,
    suspects: tuple[Suspect, ...],
    *,
    seconds: float = 10.0,
    rate: float = 1.0 / SERVO_PERIOD,
    seed: int = 0,
    limits: Limits | None = None,
    motions: int | None = None,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Design:
    """Look for the excitation that tells suspects apart, each from each, or shows one.

    Parameters
    ----------
    seconds : length of the record; rate : rows a second; limits : of the mechanism by default;
    motions : how many are tried, by default some 150, fewer
    without the compiled kernel. The same arguments give the same bits.

    Raises
    ------
    ParameterError : what is wanted is an exact tie, or no motion shows it; a record that is too
        short or too long, or at too low a rate.
    """
    _check(seconds, rate)
    is_compiled("identification")  # a program may wait here until it is
    limits = limits or Limits.of(mechanism)
    builder = Builder(mechanism, limits, seconds)
    judge = Judge(builder, suspects)
    rng = np.random.default_rng(seed)
    wanted = frozenset(s.joint - 1 for s in suspects if s.joint is not None) or frozenset(range(mechanism.joints))
    first = [builder.plain(), *(builder.random(rng, wanted) for _ in range(EXPERIMENT.design_looks))]
    one_way = _ties(judge, first)
    count = motions or _count(judge, first[0])
    machines = _machines(judge, rng)

    def scored(motion: Motion, time: Floats, tries: int, number: int) -> list[tuple[float, int, Motion]]:
        """(score, number, motion made safe), none where it cannot be."""
        safe = _made_safe(judge, motion, time, machines, tries)
        return [] if safe is None else [(_score(judge.on_simulation(safe)), -number, safe)]

    coarse = EXPERIMENT.design_coarse_step * np.arange(int(seconds / EXPERIMENT.design_coarse_step) + 1, dtype=float)
    best: list[tuple[float, int, Motion]] = []
    for n in range(count):
        progress("motions", n / count)
        if n < len(first):
            motion = first[n]
        elif n < EXPERIMENT.design_random * count or not best:
            motion = builder.random(rng, wanted)
        else:
            motion = builder.changed(best[int(rng.integers(len(best)))][2], rng)
        best += scored(motion, coarse, 4, n)
        best = sorted(best, key=lambda each: each[:2], reverse=True)[: EXPERIMENT.design_kept]

    time = np.arange(int(round(seconds * rate)) + 1, dtype=float) / rate
    found = []
    for n, (_, _, motion) in enumerate(best):
        progress("limits", n / len(best))
        found += scored(motion, time, 8, n)
    if not found:
        raise ParameterError(
            f"no motion stays in the ranges of the joints when parameters are wrong by {EXPERIMENT.design_wrong:.0%}",
            where=mechanism.name,
            expected="a shorter record, or wider ranges",
        )
    nats, _, motion = max(found, key=lambda each: each[:2])
    plain = scored(first[0], time, 12, 0)
    labels = tuple(s.label for s in suspects)
    if nats < EXPERIMENT.design_nothing:
        raise ParameterError(
            f"no motion within the limits gives more than {max(nats, 0.0):.2g} nat",
            where="--separate " + ",".join(labels),
            expected=f"{SELECTION.least_gain:g} nat for a name: more time, voltage or range",
        )
    return Design(
        time,
        np.round(voltages(mechanism, motion, time, judge.noise), 6),
        motion.at(time)[0],
        motion.centre,
        nats,
        max(plain[0][0], 0.0) if plain else 0.0,
        labels,
        one_way,
        motion,
        seed,
    )


def _count(judge: Judge, motion: Motion) -> int:
    """Default number of motions of a search."""
    many = sum(judge.columns(motion)) > EXPERIMENT.design_many_columns
    count = EXPERIMENT.design_fewer_motions if many else EXPERIMENT.design_motions
    return count if BACKEND == "numba" else int(EXPERIMENT.design_uncompiled * count)


def _check(seconds: float, rate: float) -> None:
    if not EXPERIMENT.design_shortest <= seconds <= EXPERIMENT.design_longest:
        expected = f"{EXPERIMENT.design_shortest:g} to {EXPERIMENT.design_longest:g} s"
        raise ParameterError(f"{seconds:g} s", where="--seconds", expected=expected)
    if not rate >= EXPERIMENT.design_least_rate or seconds * rate > EXPERIMENT.design_most_rows:
        expected = (
            f"{EXPERIMENT.design_least_rate:g} at least, and {EXPERIMENT.design_most_rows} rows in all at the most"
        )
        raise ParameterError(f"{rate:g} rows a second", where="--rate", expected=expected)


def _score(distances: list[Distance] | None) -> float:
    """The least of the directions; below 0 where the machine leaves its ranges."""
    return -1.0 if distances is None else min(d.nats for d in distances)


def _ties(judge: Judge, motions: list[Motion]) -> str | None:
    """Drop directions in which nothing can be left: a special case of the other effect. Gives the label of the effect
    that can be told from the other, where only one can; raises ParameterError for ties."""
    labels = [s.label for s in judge.suspects]

    def refused(what: str, expected: str) -> ParameterError:
        return ParameterError(what, where="--separate " + ",".join(labels), expected=expected)

    alone: list[Direction] = [(n, None) for n in range(len(labels))]
    looks = [judge.on_plan(motion, alone + judge.directions) for motion in motions]
    for n, label in enumerate(labels):
        raw, nats = (max(values) for values in zip(*((look[n].raw, look[n].nats) for look in looks)))
        if not raw > 0.0:
            raise refused(f"no motion shows {label} here", "an effect that this mechanism can show")
        if raw > SELECTION.least_gain and nats < EXPERIMENT.design_nothing:
            raise refused(
                f"{label} is an exact tie with parameters of {judge.mechanism.name}",
                f"an effect that they cannot make up for ({_reason(label)})",
            )
    possible = [
        direction
        for n, direction in enumerate(judge.directions, start=len(labels))
        if len(labels) == 1 or any(look[n].share > EXPERIMENT.design_no_share for look in looks)
    ]
    for n, m in combinations(range(len(labels)), 2):
        if not {(n, m), (m, n)} & set(possible):
            what = f"{labels[n]} and {labels[m]} are an exact tie"
            raise refused(what, f"effects that differ in voltage and position ({_reason(labels[n], labels[m])})")
    one_way = labels[possible[0][0]] if len(labels) == 2 and len(possible) == 1 else None
    judge.directions = possible
    return one_way


def _machines(judge: Judge, rng: np.random.Generator) -> list[Plant]:
    """Plants that the voltages must suit: wrong parameters, and the effects with usual sizes."""
    m = judge.mechanism
    wrong = np.array(
        [EXPERIMENT.design_viscous_wrong if "viscous" in p.name else EXPERIMENT.design_wrong for p in m.free]
    )
    thetas = [m.start * (1.0 + wrong * rng.choice([-1.0, 1.0], len(wrong))) for _ in range(EXPERIMENT.design_machines)]
    plants = [m.plant(theta) for theta in (m.start, *thetas)]
    return plants + [plant_with(m, theta, effects) for theta, effects in zip(thetas, judge.usual)]


def _made_safe(judge: Judge, motion: Motion, time: Floats, machines: Sequence[Plant], tries: int) -> Motion | None:
    """The motion made smaller until all machines stay in their ranges and the voltages in theirs;
    None where that does not come about."""
    limits = judge.limits

    def stays(plant: Plant) -> bool:
        position = simulate(plant, motion, time, volts, EXPERIMENT.design_coarse_step)
        return position is not None and limits.hold(position)

    for _ in range(tries):
        volts = voltages(judge.mechanism, motion, time, judge.noise)
        if (np.abs(volts) <= limits.voltage).all() and all(map(stays, machines)):
            return motion
        motion = motion.shrunk(np.full(len(motion.centre), EXPERIMENT.design_smaller), limits.home)
    return None
