# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""The excitation that best tells two effects apart, or shows one: a seeded search (step 11).

Random motions, then neighbours of the best ones, are judged by `separation` on what the machine
would do if the effect were there. The winner's voltages are played on machines whose parameters
are wrong by 8 %, and with the effects in them; it is made smaller until all of them stay in their
ranges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from puma_sim_core.effects import KINDS
from puma_sim_core.effects.relations import EXACT_TIES
from puma_sim_core.errors import ParameterError
from puma_sim_core.identify.experiment.excitation import Builder, Limits, Motion, voltages
from puma_sim_core.identify.experiment.separation import NUMBERS, Distance, Judge, Suspect, plant_with, play
from puma_sim_core.identify.settings import EXPERIMENT, SELECTION
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.mechanism import Mechanism
from puma_sim_core.simulation.simulator import SERVO_PERIOD


@dataclass(frozen=True)
class Design:
    """An excitation. time (n,) [s]; voltage (n, J) [V], each held until the next row; setpoint
    (n, J) [rad or m]: the motion that the start model makes under it; start (J,): its pose at rest
    at the beginning.

    nats : expected gain of log evidence of the effect that is there; plain : that of one slow
    sine a joint; suspects : labels of what it is for; one_way : the only one that can be told from
    the other, where the other is a special case of it; motion : the planned one; seed.
    """

    time: np.ndarray
    voltage: np.ndarray
    setpoint: np.ndarray
    start: np.ndarray
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
            what = f"tells {self.suspects[0]} and {self.suspects[1]} of a usual size apart"
        return (
            f"{what} by {self.nats:.3g} nat, which is {self.noises:.2g} times a noise of "
            f"{EXPERIMENT.separation_noise:g} V all the time (one slow sine a joint: {self.plain:.3g} nat)"
        )


def suspects_of(texts: Sequence[str], mechanism: Mechanism, joint: int | None = None) -> tuple[Suspect, ...]:
    """Suspects from ``name`` or ``name@joint``, joint (1-based) for those without one.

    Raises
    ------
    ParameterError : an effect or a joint that is not there, that this mechanism cannot have or
        that no motion can show; other than one or two; the same twice.
    """
    if not 1 <= len(texts) <= 2:
        raise ParameterError(f"{len(texts)} effects", where="--separate", expected="one or two")
    found = tuple(_suspect(text.strip(), mechanism, joint) for text in texts)
    if len(set(found)) < len(found):
        raise ParameterError(f"{found[0].label} twice", where="--separate", expected="two effects, or one")
    return found


def _suspect(text: str, mechanism: Mechanism, joint: int | None) -> Suspect:
    name, at, place = text.partition("@")
    where = f"--separate {text}"
    kind = KINDS.get(name)
    if kind is None:
        raise ParameterError(f"unknown effect '{name}'", where=where, expected=f"one of {', '.join(KINDS)}")
    if kind.screening is None:
        raise ParameterError("is a parameter of every mechanism", where=where, expected="an effect; " + _reason(name))
    if not mechanism.possible(name):
        raise ParameterError(
            f"has no meaning on {mechanism.name}", where=where, expected="an effect that this mechanism can have"
        )
    if not kind.repeatable:
        raise ParameterError(
            "cannot be brought about",
            where=where,
            expected=("an effect that a motion shows; repeat a motion to see that a blow does not come back"),
        )
    if not kind.per_joint:
        if at:
            raise ParameterError(f"joint {place}", where=where, expected="no joint: it acts on the whole arm")
        return Suspect(kind, None)
    J = mechanism.joints
    number = int(place) if place.isdigit() else None if at else joint or (1 if J == 1 else None)
    if number is None or not 1 <= number <= J:
        what = f"joint '{place}'" if at else "no joint" if number is None else f"joint {number}"
        more = f" to {name}@{J}, or --joint" if J > 1 else ""
        raise ParameterError(what, where=where, expected=f"{name}@1{more}")
    return Suspect(kind, number - 1)


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
    """Look for the excitation that tells two suspects apart, or shows one.

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
    limits = limits or Limits.of(mechanism)
    builder = Builder(mechanism, limits, seconds)
    judge = Judge(builder, suspects)
    rng = np.random.default_rng(seed)
    wanted = frozenset(s.joint for s in suspects if s.joint is not None) or frozenset(range(mechanism.joints))
    first = [builder.plain(), *(builder.random(rng, wanted) for _ in range(EXPERIMENT.design_looks))]
    one_way = _ties(judge, first)
    count = motions or _count(judge, first[0])

    machines = _machines(judge, rng)
    coarse = EXPERIMENT.design_coarse_step * np.arange(int(seconds / EXPERIMENT.design_coarse_step) + 1)
    best: list[tuple[float, int, Motion]] = []
    for n in range(count):
        progress("motions", n / count)
        if n < len(first):
            motion = first[n]
        elif n < EXPERIMENT.design_random * count or not best:
            motion = builder.random(rng, wanted)
        else:
            motion = builder.changed(best[int(rng.integers(len(best)))][2], rng)
        motion = _made_safe(judge, motion, coarse, machines, 4)
        if motion is not None:
            best.append((_score(judge.on_play(motion)), -n, motion))
            best = sorted(best, key=lambda each: each[:2], reverse=True)[: EXPERIMENT.design_kept]

    time = np.arange(int(round(seconds * rate)) + 1) / rate
    found = []
    for n, (_, _, motion) in enumerate(best):
        progress("limits", n / len(best))
        safe = _made_safe(judge, motion, time, machines, 8)
        if safe is not None:
            found.append((_score(judge.on_play(safe)), -n, safe))
    if not found:
        raise ParameterError(
            f"no motion stays in the ranges of the joints when parameters are wrong by {EXPERIMENT.design_wrong:.0%}",
            where=mechanism.name,
            expected="a shorter record, or wider ranges",
        )
    nats, _, motion = max(found, key=lambda each: each[:2])
    plain = _made_safe(judge, first[0], time, machines, 12)
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
        0.0 if plain is None else max(_score(judge.on_play(plain)), 0.0),
        labels,
        one_way,
        motion,
        seed,
    )


def _count(judge: Judge, motion: Motion) -> int:
    """Motions of a search that is not told how many."""
    count = (
        EXPERIMENT.design_fewer_motions
        if judge.columns(motion) > EXPERIMENT.design_many_columns
        else EXPERIMENT.design_motions
    )
    return count if BACKEND == "numba" else int(EXPERIMENT.design_uncompiled * count)


def _check(seconds: float, rate: float) -> None:
    if not EXPERIMENT.design_shortest <= seconds <= EXPERIMENT.design_longest:
        raise ParameterError(
            f"{seconds:g} s",
            where="--seconds",
            expected=f"{EXPERIMENT.design_shortest:g} to {EXPERIMENT.design_longest:g} s",
        )
    if not rate >= EXPERIMENT.design_least_rate or seconds * rate > EXPERIMENT.design_most_rows:
        raise ParameterError(
            f"{rate:g} rows a second",
            where="--rate",
            expected=(
                f"{EXPERIMENT.design_least_rate:g} at least, and {EXPERIMENT.design_most_rows} rows in all at the most"
            ),
        )


def _score(distances: list[Distance] | None) -> float:
    """The least of the directions; below 0 where the machine leaves its ranges."""
    return -1.0 if distances is None else min(d.nats for d in distances)


def _ties(judge: Judge, motions: list[Motion]) -> str | None:
    """Drop directions in which nothing can be left: a special case of the other effect. Gives the
    label of the effect that can be told, where it is one of two; raises ParameterError for ties."""
    labels = [s.label for s in judge.suspects]
    where = "--separate " + ",".join(labels)
    alone = [(n, None) for n in range(len(labels))]
    looks = [judge.on_plan(motion, alone + judge.directions) for motion in motions]
    for n, label in enumerate(labels):
        if not any(look[n].raw > 0.0 for look in looks):
            raise ParameterError(
                f"no motion shows {label} here", where=where, expected="an effect that this mechanism can show"
            )
        if (
            max(look[n].raw for look in looks) > SELECTION.least_gain
            and max(look[n].nats for look in looks) < EXPERIMENT.design_nothing
        ):
            raise ParameterError(
                f"{label} is an exact tie with parameters of {judge.mechanism.name}",
                where=where,
                expected=f"an effect that they cannot make up for ({_reason(label)})",
            )
    possible = [
        direction
        for n, direction in enumerate(judge.directions, start=len(labels))
        if len(labels) == 1 or any(look[n].share > EXPERIMENT.design_no_share for look in looks)
    ]
    if not possible:
        raise ParameterError(
            f"{labels[0]} and {labels[1]} are an exact tie",
            where=where,
            expected=f"effects that differ in voltage and position ({_reason(*labels)})",
        )
    one_way = labels[possible[0][0]] if len(possible) < len(judge.directions) else None
    judge.directions = possible
    return one_way


def _machines(judge: Judge, rng) -> list:
    """Plants that the voltages must suit: wrong parameters, and the effects with usual sizes."""
    mechanism = judge.mechanism
    wrong = np.array(
        [EXPERIMENT.design_viscous_wrong if "viscous" in p.name else EXPERIMENT.design_wrong for p in mechanism.free]
    )
    thetas = [mechanism.start] + [
        mechanism.start * (1.0 + wrong * rng.choice([-1.0, 1.0], len(wrong))) for _ in range(EXPERIMENT.design_machines)
    ]
    plants = [mechanism.plant(theta) for theta in thetas]
    return plants + [plant_with(mechanism, theta, effects) for theta, effects in zip(thetas[1:], judge.usual)]


def _made_safe(judge: Judge, motion: Motion, time, machines, tries: int) -> Motion | None:
    """The motion made smaller until all machines stay in their ranges and the voltages in theirs;
    None where that does not come about."""
    for _ in range(tries):
        volts = voltages(judge.mechanism, motion, time, judge.noise)
        fits = (np.abs(volts) <= judge.limits.voltage).all()
        if fits and all(_stays(plant, motion, time, volts, judge.limits) for plant in machines):
            return motion
        motion = motion.shrunk(np.full(len(motion.centre), 0.85), judge.limits.home)
    return None


def _stays(plant, motion, time, volts, limits) -> bool:
    position = play(plant, motion, time, volts, EXPERIMENT.design_coarse_step)
    return position is not None and limits.hold(position)
