# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Made-up explanations of each verdict, for the tests of what is written from them.

The record is the arm under slow sines, with Coulomb friction of 10 N.m on joint 2 that the model
lacks and parameters a few per cent off; residuals are computed from that in closed form.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from puma_sim_core.effects import KINDS, Effect
from puma_sim_core.identify.result import (
    DATA_FAULT,
    NAMED,
    NAMED_WITH_REMAINDER,
    NOTHING_MISSING,
    PARTS,
    UNNAMED,
    Detectable,
    Drawn,
    Errors,
    Explanation,
    Fault,
    FeedbackBias,
    Hypothesis,
    Interval,
    NamedEffect,
    NextExperiment,
    Ranked,
    RuledOut,
    Shape,
    StageErrors,
)
from puma_sim_core.plant.plant import Plant

K = np.array([0.0980, 0.0568, 0.1143])  # V per N.m at the joints
FRICTION = 10.0
NOISE = np.array([0.030, 0.025, 0.035])
HARD = "a < b & \"c\" > 'd' <script>alert(1)</script> \u00b0"


def drawn(seed: int = 1, rows: int = 2000, joints: int = 3) -> Drawn:
    """Residuals of 20 s with Coulomb friction on joint 2 (on joint 1 where there is one)."""
    random = np.random.default_rng(seed)
    time = np.linspace(0.0, 20.0, rows)
    phase = np.outer(time, [0.9, 0.7, 1.3][:joints]) + [0.3, 0.0, 1.1][:joints]
    position = 0.9 * np.sin(phase) + 0.3 * np.sin(2.7 * phase + 0.5)
    velocity = np.gradient(position, time, axis=0)
    acceleration = np.gradient(velocity, time, axis=0)
    gravity = np.zeros_like(position)
    if joints == 3:
        gravity[:, 2] = 9.0 * np.cos(position[:, 1] + position[:, 2])
        gravity[:, 1] = 37.0 * np.cos(position[:, 1]) + gravity[:, 2]
    noise = NOISE[:joints] * random.normal(size=(rows, joints))
    retuned = noise.copy()
    j = min(joints, 2) - 1
    friction = K[j] * FRICTION * np.sign(velocity[:, j])
    # retuning takes the part of a step that a slope can take
    retuned[:, j] += friction - velocity[:, j] * (friction @ velocity[:, j]) / (velocity[:, j] @ velocity[:, j])
    nominal = noise + 0.25 * velocity + K[:joints] * 0.05 * gravity
    nominal[:, j] += friction
    lags = np.arange(41) * 0.01
    bound = 1.96 / np.sqrt(rows)
    white = {
        joint: (lags, np.concatenate([[1.0], bound * 0.5 * random.normal(size=40)]), bound)
        for joint in range(1, joints + 1)
    }
    held_out = ((time % 5.0) > 3.8).astype(float)
    torque = 3.0 * acceleration + gravity
    return Drawn(
        time,
        nominal,
        retuned,
        noise,
        {
            "position": position,
            "velocity": velocity,
            "acceleration": acceleration,
            "torque": torque,
            "gravity_torque": gravity,
            "voltage": 20.0 * velocity + K[:joints] * torque,
        },
        held_out,
        white,
    )


def _stages(nominal, retuned, augmented, floor) -> StageErrors:
    return StageErrors(*(np.array(each) for each in (nominal, retuned, augmented, floor)))


def errors(joints: int = 3) -> dict[str, Errors]:
    """Errors that fall as in the prototype."""
    voltage = _stages([0.21, 0.66, 0.19], [0.031, 0.34, 0.036], [0.0301, 0.0262, 0.0355], NOISE)
    position = _stages(
        [4.1e-3, 14.7e-3, 6.2e-3], [1.1e-3, 3.7e-3, 1.3e-3], [0.61e-3, 0.70e-3, 0.85e-3], [0.50e-3, 0.47e-3, 0.71e-3]
    )
    held = Errors(voltage, position)
    if joints == 1:
        held = Errors(
            *(
                _stages(*(getattr(each, name)[1:2] for name in ("nominal", "retuned", "augmented", "floor")))
                for each in (voltage, position)
            )
        )
    return dict.fromkeys(PARTS, held)


def detectability(joints: int = 3) -> tuple[Detectable, ...]:
    """A size for each kind of the library on each joint; slow things are not excited."""
    found = []
    for kind in KINDS.values():
        first = kind.parameters[0]
        for joint in range(1, joints + 1) if kind.per_joint else (None,):
            excited = kind.name not in ("soft_stop", "presliding_friction") and not (
                kind.name == "stribeck_friction" and joint == 1
            )
            size = np.inf if kind.name == "soft_stop" else 0.4 + 0.2 * (joint or 0)
            found.append(Detectable(kind.name, joint, first.name, size, first.unit, excited))
    return tuple(found)


def _ranking() -> tuple[Ranked, ...]:
    friction = Hypothesis("coulomb_friction", 2)
    rows = [
        Ranked("coulomb_friction", 2, 1834.2, "named"),
        Ranked("asymmetric_coulomb_friction", 2, 1831.0, "it contains Coulomb friction, which is enough", friction),
        Ranked("voltage_dead_band", 2, 1204.9, "lower than Coulomb friction by 629 nat", friction),
        Ranked("load_dependent_friction", 2, 977.4, "lower than Coulomb friction by 857 nat", friction),
        Ranked("stribeck_friction", 2, 641.3, "it contains Coulomb friction, which is enough", friction),
    ]
    rows += [
        Ranked(kind.name, joint, 12.0 - 3.1 * joint - index, "gains nothing once the others are in the model")
        for index, kind in enumerate(KINDS.values())
        for joint in (1, 3)
        if kind.per_joint
    ]
    return tuple(sorted(rows, key=lambda each: -each.evidence))


def named() -> Explanation:
    """NAMED: Coulomb friction on joint 2."""
    effect = NamedEffect(
        "coulomb_friction",
        2,
        {"torque": Interval(9.973, 9.81, 10.14, "N.m")},
        1834.2,
        ruled_out=tuple(RuledOut(each.name, each.joint, each.verdict) for each in _ranking()[1:5]),
    )
    parameters = {
        f"{name}{j}": (value, value * (1.0 + 0.011 * j), unit, 0.06 * value)
        for j in (1, 2, 3)
        for name, value, unit in (
            ("motor.resistance", 1.6, "ohm"),
            ("motor.back_emf", 0.19, "V.s/rad"),
            ("inertia.xx", 0.35, "kg.m2"),
            ("viscous_friction", 5.8, "N.m.s/rad"),
            ("motor.inertia", 2.0e-4, "kg.m2"),
        )
    }
    return Explanation(
        NAMED,
        "The model lacks Coulomb friction on joint 2 of 9.97 N.m (9.81 to 10.14); with it "
        "the open-loop error on held-out data falls from 14.7 to 0.70 mrad.",
        (effect,),
        errors(),
        detectability=detectability(),
        next_experiment=NextExperiment(
            "Crawl through reversals at 0.01 to 0.2 rad/s to see whether the step has a bump at low speed.",
            (Hypothesis("stribeck_friction", 1),),
            "puma-sim excite --plant puma560 --separate stribeck_friction@1 --out volts.csv",
        ),
        feedback_bias=FeedbackBias(
            np.array([1.2, 0.4, 2.3]),
            np.array([0.27, 0.53, 0.13]),
            False,
            "the voltage delayed by 0.1 to 0.4 s",
            "No sign of feedback in the recording.",
        ),
        ranking=_ranking(),
        notes=("Joint 3 rested for 2.1 s; these rows were left out.",),
        drawn=drawn(),
        model=Plant.of("bejczy", (Effect(KINDS["coulomb_friction"], 2, {"torque": 9.973}),)),
        logs=("runs/monday.csv",),
        parameters=parameters,
        seconds=7.3,
        version="0.1.0",
        seed=4,
    )


def tied() -> Explanation:
    """NAMED with a tie, two effects, one of the whole arm, and names that need escaping."""
    first, e = named().effects[0], named()
    others = tuple(each for each in first.ruled_out if each.name != "voltage_dead_band")
    first = replace(first, tied_with=(Hypothesis("voltage_dead_band", 2),), ruled_out=others)
    second = NamedEffect(
        "payload", None, {"mass": Interval(1.234, 1.1, 1.37, "kg"), "z": Interval(2.1e-3, -1e-3, np.inf, "m")}, 31.4
    )
    rows = [
        replace(each, evidence=1831.9, verdict="tied") if each.name == "voltage_dead_band" and each.joint == 2 else each
        for each in e.ranking
    ]
    separate = (Hypothesis("coulomb_friction", 2), first.tied_with[0])
    feedback = replace(
        e.feedback_bias,
        biased=True,
        p_value=np.array([1e-9, 0.2, np.nan]),
        sentence="Noise went through the controller " + HARD,
    )
    return replace(
        e,
        effects=(first, second),
        ranking=tuple(sorted([*rows, Ranked("payload", None, 31.4, "named")], key=lambda each: -each.evidence)),
        next_experiment=NextExperiment(
            "Load the joint with gravity.",
            separate,
            "puma-sim excite --separate coulomb_friction@2,voltage_dead_band@2 --out volts.csv",
        ),
        feedback_bias=feedback,
        sentence=HARD,
        logs=(f"dir/{HARD}.csv", "bad\udcff.csv"),
        held_out_logs=("kept.csv",),
        notes=(HARD,),
    )


_LITTLE = "gains less than chance does on this record"


def nothing() -> Explanation:
    """NOTHING_MISSING."""
    e = named()
    calm = replace(e.drawn, retuned=e.drawn.augmented)
    ranking = tuple(
        replace(each, evidence=min(each.evidence, 1.3), verdict=_LITTLE, against=None) for each in e.ranking
    )
    found = {}
    for part, each in e.errors.items():
        found[part] = Errors(
            *(replace(stages, retuned=stages.augmented) for stages in (each.voltage_rms, each.position_rms))
        )
    return replace(
        e,
        verdict=NOTHING_MISSING,
        effects=(),
        ranking=ranking,
        drawn=calm,
        errors=found,
        sentence="Nothing is missing that this record could have shown: "
        "the retuned model explains it down to the noise.",
        model=Plant.of("bejczy"),
    )


def remainder() -> Explanation:
    """NAMED_WITH_REMAINDER: a line in the spectrum of joint 3."""
    centre = np.linspace(0.0, 1.0 / 7.3, 33)
    curve = 0.11 * np.sin(2.0 * np.pi * 7.3 * centre)
    return replace(
        named(),
        verdict=NAMED_WITH_REMAINDER,
        shape=Shape(
            "time", "s", 3, centre, curve, curve - 0.01, curve + 0.01, 7.3, (("time", 88.0), ("motor_angle", 12.0))
        ),
        sentence="Coulomb friction on joint 2 explains most; on joint 3 an oscillation of 7.3 Hz has no name.",
    )


def unnamed() -> Explanation:
    """UNNAMED: something on joint 2 over the position."""
    centre = np.linspace(-1.1, 1.1, 60)
    curve = 0.4 * np.tanh(3.0 * centre) * centre
    return replace(
        named(),
        verdict=UNNAMED,
        effects=(),
        ranking=nothing().ranking,
        shape=Shape(
            "position",
            "rad",
            2,
            centre,
            curve,
            curve - 0.05,
            curve + 0.05,
            None,
            (("position", 412.0), ("velocity", 380.5), ("time", 11.0)),
        ),
        sentence="Something is missing on joint 2 that follows its position; no effect of the library explains it.",
    )


def faulty() -> Explanation:
    """DATA_FAULT: nothing but faults."""
    return Explanation(
        DATA_FAULT,
        "position2 is frozen from row 412 on; nothing was sought in the record.",
        faults=(
            Fault("position2", 412, "stands still for 3.2 s while voltage2 changes by 8 V; expected a moving joint"),
            Fault("voltage1", None, f"{HARD} has the opposite sign of the motion"),
        ),
        logs=(f"{HARD}.csv",),
        seconds=0.4,
        version="0.1.0",
    )


def one_joint() -> Explanation:
    """NAMED on a mechanism of one axis that slides, with two logs one after another."""
    e = named()
    series = drawn(joints=1)
    time = np.concatenate([series.time[:1000], series.time[:1000]])
    effect = replace(e.effects[0], joint=1, parameters={"torque": Interval(20.1, 19.6, 20.6, "N")}, ruled_out=())
    return replace(
        e,
        effects=(effect,),
        errors=errors(1),
        detectability=detectability(1),
        drawn=replace(series, time=time),
        mechanism="slide",
        position_unit="m",
        ranking=(Ranked("coulomb_friction", 1, 1834.2, "named"),),
        feedback_bias=None,
        next_experiment=None,
        parameters={},
        notes=(),
        logs=("a.csv", "b.csv"),
        held_out_logs=("c.csv",),
        sentence="The model lacks Coulomb friction of 20.1 N.",
    )


#: one of each kind
EXPLANATIONS = {
    "named": named,
    "tied": tied,
    "nothing": nothing,
    "remainder": remainder,
    "unnamed": unnamed,
    "faulty": faulty,
    "one_joint": one_joint,
}
