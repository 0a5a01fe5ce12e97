# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 7.4: radii of gyration estimated from motions of one joint at a time of a hidden arm.

The thesis takes masses, centres of mass and motors as known and looks for radii of gyration; so
do the estimators here. Which radii can be told apart is another matter. Joint 3 alone gives k3yy
and joint 2 alone k2zz (the thesis calls the first k3zz: its own misprint). Joint 1 sees five
radii through

    D11 = s + p C2^2 + r C23^2 + known terms,
    s = m1 k1yy + m2 k2xx + m3 k3xx,  p = m2 (k2yy - k2xx),  r = m3 (k3zz - k3xx)

and nothing else in the equations of motion holds them: no test on the arm tells the five apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from math import ceil, pi, radians

import numpy as np
from numpy.typing import ArrayLike

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.parameters import load_parameters, smallest_eigenvalue
from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.thesis.motions import FOLDED, HORIZONTAL, UPRIGHT, angles, with_joint
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Numbers, Result, Row
from puma_sim_core.thesis.wording import Words
from puma_sim_core.tuning.estimation import (
    Estimate,
    Instrument,
    Record,
    ServoTest,
    estimate,
    record_from_servo,
    with_gyration,
)

words = Words(__name__)
#: about how far the hidden arm's radii are from the set that it is made of
SPREAD = 0.08
#: the five that only joint 1 sees
WAIST = ("k1yy", "k2xx", "k2yy", "k3xx", "k3zz")
SCALED = ("k1yy", "k2xx", "k3zz")
LUMPS = ("s", "p", "r")
PERIOD = 0.028
Angles = tuple[float, float, float]


def instrument(arm: ArmParameters) -> Instrument:
    """Encoders of 1000 counts a motor turn, and a 12-bit converter of +-40 V."""
    return Instrument(angle_steps=tuple(2.0 * pi / (1000 * m.gear_ratio) for m in arm.motors), voltage_step=80.0 / 4096)


def gyration(plant: Plant, name: str) -> float:
    """A radius of gyration squared by its name, such as k3yy [m^2]."""
    return plant.arm.links[int(name[1]) - 1].gyration_squared[("xx", "yy", "zz").index(name[2:])]


def lumps(plant: Plant) -> np.ndarray:
    """(s, p, r) [kg.m^2], what joint 1 can see of five radii."""
    m1, m2, m3 = (link.mass for link in plant.arm.links)
    k1yy, k2xx, k2yy, k3xx, k3zz = (gyration(plant, name) for name in WAIST)
    return np.array([m1 * k1yy + m2 * k2xx + m3 * k3xx, m2 * (k2yy - k2xx), m3 * (k3zz - k3xx)])


def with_lumps(plant: Plant, s: float, p: float, r: float) -> Plant:
    """A plant with these lumps: k1yy, k2yy and k3zz give way, k2xx and k3xx stay."""
    m1, m2, m3 = (link.mass for link in plant.arm.links)
    k2xx, k3xx = gyration(plant, "k2xx"), gyration(plant, "k3xx")
    values = {"k1yy": (s - m2 * k2xx - m3 * k3xx) / m1, "k2yy": k2xx + p / m2, "k3zz": k3xx + r / m3}
    return with_gyration(plant, values)


def with_friction(plant: Plant, joint: int, dry: float, viscous: float) -> Plant:
    """The plant with the friction of one joint in place of all effects."""
    coulomb = parse_effect(f"coulomb_friction:joint={joint},torque={float(dry)!r}")
    return replace(
        plant, effects=(coulomb, parse_effect(f"viscous_friction:joint={joint},coefficient={float(viscous)!r}"))
    )


def demand(pose: Angles, joint: int, end: float, speed: float, ramp: float = 0.25, rest: float = 0.3) -> np.ndarray:
    """Setpoints (n, 3) [rad], one each 28 ms: the joint accelerates to a constant speed [rad/s]
    within `ramp` [s], decelerates likewise at `end` [rad] and rests; the pendant's motion."""
    distance = abs(end - pose[joint - 1])
    cruise = max(distance / speed - ramp, 0.0)
    speed = distance / (cruise + ramp)
    t = PERIOD * np.arange(1, ceil((cruise + 2.0 * ramp + rest) / PERIOD) + 1)
    up, level, down = np.clip(t, 0.0, ramp), np.clip(t - ramp, 0.0, cruise), np.clip(t - ramp - cruise, 0.0, ramp)
    travelled = speed * (up**2 / (2.0 * ramp) + level + down - down**2 / (2.0 * ramp))
    setpoint = np.tile(np.asarray(pose, dtype=float), (len(t), 1))
    setpoint[:, joint - 1] += np.sign(end - pose[joint - 1]) * travelled
    return setpoint


def records(
    name: str, joint: int, pose: Angles, speed: float, *ends: tuple[float, float]
) -> cached_property[list[Record]]:
    """Records of motions of a joint from one angle to another [deg] at a speed [rad/s], taken when asked for."""

    def taken(c: Campaign) -> list[Record]:
        rng, plant = c.context.rng(f"7.4 {name}"), c.hidden(joint)
        setpoints = (demand(with_joint(pose, joint, radians(a)), joint, radians(b), speed) for a, b in ends)
        test = ServoTest(joint, c.servo)
        return [record_from_servo(plant, setpoint, test, c.instrument, rng)[0] for setpoint in setpoints]

    return cached_property(taken)


class Campaign:
    """A hidden arm, the records taken of it, and the estimates made from the records alone.

    The hidden arm has the radii of the set `tuned`, each off by some per cent of its own, and
    friction of its own at each joint; the estimators start from the set `bejczy`.
    """

    def __init__(self, context: Context) -> None:
        self.context = context
        rng = context.rng("7.4 hidden arm")
        arm = tuned = load_parameters("tuned")
        while arm is tuned or smallest_eigenvalue(arm)[0] <= 0.0:
            squared = np.array([link.gyration_squared for link in tuned.links])
            squared *= 1.0 + SPREAD * rng.uniform(-1.0, 1.0, (3, 3))
            links = [replace(link, gyration_squared=tuple(k)) for link, k in zip(tuned.links, squared.tolist())]
            arm = replace(tuned, links=tuple(links))
        factors = rng.uniform(0.6, 1.4, (2, 3))
        #: dry and viscous friction of each joint
        self.friction = (factors * [(8.0, 8.0, 5.0), (5.8, 9.5, 4.0)]).T.tolist()
        self._rigid, self.nominal = Plant(arm), Plant.of()
        self.servo, self.instrument = ServoConfig(), instrument(arm)

    def hidden(self, joint: int) -> Plant:
        """The hidden arm with its friction at the joint that moves."""
        return with_friction(self._rigid, joint, *self.friction[joint - 1])

    # 7.4.1: link 3 from hanging to horizontal, then at other points of its range
    elbow_records = records("joint 3", 3, (0.0, 0.0, 0.0), 2.0, (180, 90), (90, -30), (-40, 60), (120, 220))
    # 7.4.2: joint 2 at four parts of its range with joint 3 at -52 degrees
    shoulder_records = records("joint 2", 2, (0.0, 0.0, FOLDED), 1.1, (-90, -30), (-30, 35), (-100, -170), (-210, -140))
    # 7.4.3: joint 1 with the arm extended upright
    upright_records = records("joint 1 upright", 1, UPRIGHT, 1.6, (0, 90), (90, -20), (-100, -30))
    # 7.4.4: joint 1 with the arm extended horizontally, where k2xx has no effect
    stretched_records = records("joint 1 stretched", 1, HORIZONTAL, 1.6, (0, -90), (-90, 20), (100, 30))
    # one pose more, upper arm horizontal and forearm upright, to tell p from r
    forearm_records = records("joint 1 forearm upright", 1, (0.0, 0.0, 0.0), 1.6, (0, 90), (90, -20), (-100, -30))

    def _estimate(
        self,
        joint: int,
        records: list[Record],
        names: Sequence[str],
        friction: Sequence[float],
        known: tuple[Sequence[float], ArrayLike] | None = None,
        lower: float | Sequence[float] = 0.0,
    ) -> Estimate:
        """Parameters by their names, then dry and viscous friction of the joint, of which there is a guess.

        known : values and precision of the parameters that follow the first.
        """
        nominal = {"factor": 1.0, **dict(zip(LUMPS, lumps(self.nominal)))}
        guess = [nominal[n] if n in nominal else gyration(self.nominal, n) for n in names] + list(friction)
        prior = None
        if known is not None:
            prior = values, precision = np.zeros(len(guess)), np.zeros((len(guess), len(guess)))
            some = slice(1, 1 + len(known[0]))
            guess[some] = values[some] = known[0]
            precision[some, some] = known[1]

        def model(x: np.ndarray) -> Plant:
            return with_friction(self._changed(dict(zip(names, x))), joint, *x[-2:])

        labels = (*names, "dry friction", "viscous friction")
        return estimate(model, records, labels, guess, self.instrument, lower=lower, prior=prior)

    def _changed(self, values: dict[str, float]) -> Plant:
        if "s" in values:
            return with_lumps(self.nominal, **values)
        plant = self.scaled(values.pop("factor")) if "factor" in values else self.nominal
        return with_gyration(plant, values)

    def scaled(self, factor: float) -> Plant:
        """The nominal arm with k1yy, k2xx and k3zz scaled together, as 7.4.3 does."""
        return with_gyration(self.nominal, {name: factor * gyration(self.nominal, name) for name in SCALED})

    @cached_property
    def elbow(self) -> Estimate:
        """k3yy with the friction of joint 3."""
        return self._estimate(3, self.elbow_records, ("k3yy",), (5.0, 4.0))

    @cached_property
    def shoulder(self) -> Estimate:
        """k2zz with the friction of joint 2; k3yy as 7.4.1 gave it, with its uncertainty."""
        k3yy, spread = float(self.elbow.values[0]), float(self.elbow.deviations[0])
        return self._estimate(2, self.shoulder_records, ("k2zz", "k3yy"), (10.0, 8.0), ([k3yy], spread**-2))

    @cached_property
    def upright(self) -> Estimate:
        """The common factor of k1yy, k2xx and k3zz, with the friction of joint 1."""
        return self._estimate(1, self.upright_records, ("factor",), (8.0, 6.0))

    @cached_property
    def stretched(self) -> Estimate:
        """k2yy as 7.4.4 has it, after the scaling of 7.4.3 and its uncertainty."""
        before = self.upright
        known = before.values, np.linalg.inv(before.covariance)
        return self._estimate(1, self.stretched_records, ("k2yy", "factor"), before.values[1:], known)

    @cached_property
    def waist(self) -> Estimate:
        """The three lumps that joint 1 can see, from three poses, with its friction."""
        records = [*self.upright_records, *self.stretched_records, *self.forearm_records]
        return self._estimate(1, records, LUMPS, (8.0, 6.0), lower=(0.0, -np.inf, -np.inf, 0.0, 0.0))


# ------------------------------------------------------------------------------------- experiments


@lru_cache(maxsize=2)
def _campaign(seed: int) -> Campaign:
    return Campaign(Context(seed))


def _start_row(key: str, c: Campaign) -> Row:
    return words.row("start", gyration(c.nominal, key), case=key, name=key)


def _rows(key: str, found, truth: float, numbers: Numbers, start: float = 0.0, suffix: str = "") -> list[Row]:
    """Rows and numbers of one parameter: estimate, interval and truth."""
    (value, low, high), name = found, words.text("name", case=key, key=key)
    of = {"low": low, "high": high, "truth": truth}
    inside = low <= truth <= high
    numbers |= {f"{key}{suffix}_{n}": each for n, each in {"estimate": value, **of, "covered": inside}.items()}
    row = words.row("estimate", value, case=key, name=name, start=start, other_arm=words.text("other_arm"))
    return [row, words.row("interval", case=inside, name=name, unit=row.unit, **of)]


def _fit_row(fit: Estimate) -> Row:
    return words.row("misfit", fit.misfit, probability=fit.probability)


#: plots of the voltage and of the position
_PLOTS = {"7.4.1": ("7.6", "7.7"), "7.4.2": ("7.9", "7.8"), "7.4.3": ("7.11", "7.10"), "7.4.4": ("7.13", "7.12")}


def _compared(number: str, record: Record, joint: int, plants, friction) -> tuple[float, list[Figure]]:
    """Positions with the nominal and the tuned value, their greatest distance [rad], the voltage."""
    t = record.time[:: record.every]
    measured = record.angle[:, joint - 1]
    before, after = (record.simulated(with_friction(plant, joint, *friction))[:, joint - 1] for plant in plants)
    gap = float(np.abs(before - after).max())
    radii, (voltage, position) = words.text("radii", case=number), _PLOTS[number]
    recorded = [Curve("recorded", record.time, record.voltage[:, joint - 1])]
    motions = [Curve("measured", t, measured, "points"), Curve("before", t, before), Curve("after", t, after, "dashed")]
    differences = [Curve("before", t, before - measured), Curve("after", t, after - measured, "points")]
    return gap, [
        words.figure("voltage", recorded, plot=voltage, joint=joint),
        words.figure("position", motions, plot=position, joint=joint, radii=radii, gap=gap),
        words.figure("difference", differences, plot=position, joint=joint, radii=radii),
    ]


def _gap_row(number: str, gap: float, plant: Plant, joint: int, pose: Sequence[float]) -> Row:
    """The distance beside the mechanical time constant of the joint, R M / (kT ke N)."""
    motor = plant.arm.motors[joint - 1]
    M = inertia(np.array(pose), plant.arm)[joint - 1, joint - 1] + motor.inertia
    lag = motor.resistance * M / (plant.torque_per_ampere[joint - 1] * motor.back_emf * motor.gear_ratio)
    text = words.text("lag", case=number, ms=1e3 * lag)
    return words.row("gap", gap, case=number, radii=words.text("radii", case=number), lag=text)


def _result(number: str, rows: list[Row], figures: list[Figure], gap: float, numbers: Numbers, **values) -> Result:
    numbers["greatest_gap_rad"] = gap
    return words.result(number, rows, figures, numbers, hidden=words.text("hidden"), **values)


@words.experiment("7.4.1")
def elbow(context: Context) -> Result:
    """k3yy from joint 3, the others locked."""
    c, numbers = _campaign(context.seed), Numbers()
    fit, truth = c.elbow, gyration(c.hidden(3), "k3yy")
    found, friction = fit.of("k3yy"), fit.values[1:3]
    plants = c.nominal, with_gyration(c.nominal, {"k3yy": found[0]})
    gap, figures = _compared("7.4.1", c.elbow_records[0], 3, plants, friction)
    rows = [
        _start_row("k3yy", c),
        *_rows("k3yy", found, truth, numbers),
        words.row("dry", friction[0], truth=c.friction[2][0]),
        words.row("viscous", friction[1], truth=c.friction[2][1]),
        _fit_row(fit),
        _gap_row("7.4.1", gap, c.nominal, 3, UPRIGHT),
    ]
    context.progress(1.0)
    return _result("7.4.1", rows, figures, gap, numbers, found=found, truth=truth)


@words.experiment("7.4.2")
def shoulder(context: Context) -> Result:
    """k2zz from joint 2 with the forearm folded."""
    c, numbers = _campaign(context.seed), Numbers()
    fit, truth, record = c.shoulder, gyration(c.hidden(2), "k2zz"), c.shoulder_records[0]
    found, folded = fit.of("k2zz"), with_gyration(c.nominal, {"k3yy": fit.values[1]})
    plants = folded, with_gyration(folded, {"k2zz": found[0]})
    gap, figures = _compared("7.4.2", record, 2, plants, fit.values[2:4])
    gap_row = _gap_row("7.4.2", gap, c.nominal, 2, record.start)
    rows = [_start_row("k2zz", c), *_rows("k2zz", found, truth, numbers), _fit_row(fit), gap_row]
    context.progress(1.0)
    return _result("7.4.2", rows, figures, gap, numbers, found=found, truth=truth)


@words.experiment("7.4.3")
def upright(context: Context) -> Result:
    """k1yy, k2xx and k3zz scaled by one factor."""
    c, numbers = _campaign(context.seed), Numbers()
    fit, hidden = c.upright, c.hidden(1)
    masses = {name: hidden.arm.links[int(name[1]) - 1].mass for name in SCALED}
    weight, truth = (sum(m * gyration(plant, name) for name, m in masses.items()) for plant in (c.nominal, hidden))
    factor, total = fit.of("factor"), fit.combined({"factor": weight})
    rows = [words.row("factor", factor[0]), *_rows("sum", total, truth, numbers), words.row("three")]
    for name in SCALED:
        found = tuple(gyration(c.nominal, name) * v for v in factor)
        rows += _rows(name, found, gyration(hidden, name), numbers, suffix="_in_proportion")
    plants = c.nominal, c.scaled(fit.values[0])
    gap, figures = _compared("7.4.3", c.upright_records[0], 1, plants, fit.values[1:3])
    rows += [_fit_row(fit), _gap_row("7.4.3", gap, c.nominal, 1, UPRIGHT)]
    missed = sum(not numbers[f"{name}_in_proportion_covered"] for name in SCALED)
    context.progress(1.0)
    return _result("7.4.3", rows, figures, gap, numbers, total=total, truth=truth, missed=missed)


@words.experiment("7.4.4")
def remaining(context: Context) -> Result:
    """k2yy as in the text, then what three poses together do give."""
    c, numbers = _campaign(context.seed), Numbers()
    fit, waist, hidden = c.stretched, c.waist, c.hidden(1)
    found, truth = fit.of("k2yy"), gyration(hidden, "k2yy")
    rows = [_start_row("k2yy", c), *_rows("k2yy", found, truth, numbers)]
    for name, value, start in zip(LUMPS, lumps(hidden).tolist(), lumps(c.nominal)):
        rows += _rows(name, waist.of(name), value, numbers, start)
    before = c.scaled(fit.values[1])
    plants = before, with_gyration(before, {"k2yy": found[0]})
    gap, figures = _compared("7.4.4", c.stretched_records[0], 1, plants, fit.values[2:4])
    tuned = with_lumps(c.nominal, *waist.values[:3])
    poses = angles(*np.meshgrid(np.linspace(-3.8, 0.7, 19), np.linspace(-0.9, 4.0, 21)))
    worst = np.abs((inertia(poses, tuned.arm) - inertia(poses, hidden.arm))[..., 0, 0]).max()
    rows += [words.row("five"), _fit_row(waist), words.row("worst", worst)]
    rows.append(_gap_row("7.4.4", gap, c.nominal, 1, HORIZONTAL))
    holds = words.text("holds", case=numbers["k2yy_covered"])
    context.progress(1.0)
    return _result("7.4.4", rows, figures, gap, numbers, found=found, truth=truth, holds=holds)
