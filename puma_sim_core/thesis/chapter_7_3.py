# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 7.3: the arm falls under gravity, and friction is estimated from its motion."""

from dataclasses import replace
from math import degrees, pi, radians

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.rigid_body import coriolis, inertia
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import Recording
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.thesis.motions import FREE, HELD, first_time, open_circuit
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Result, Row
from puma_sim_core.thesis.wording import Words
from puma_sim_core.tuning.estimation import Estimate, Instrument, Record, estimate

words = Words(__name__)
#: the end of joint 2's range, where it meets its stop [rad]
STOP = radians(43.0)
#: joint 3 hangs straight down there [rad]
HANGING = pi - STOP
STOPS = ("soft_stop:joint=2", "soft_stop:joint=3")
#: friction column of table 7.1, printed in "Nm/m/s"
TABLE = (0.0107, 0.0341, 0.0150)
#: the motors with which the arm falls
FALLING = ("open-circuit", "as-printed")
NAMES = ("dry friction 1", "dry friction 2", "dry friction 3")


def fall(
    plant: Plant,
    effects=STOPS,
    start=(0.0, 0.0, 0.0),
    duration: float = 4.0,
    sample: float = 0.005,
    constraints=(FREE,) * 3,
    acceleration: bool = False,
) -> Recording:
    """Zero volts from rest, with these effects (as texts) in the place of the plant's."""
    falling = Plant(plant.arm, tuple(map(parse_effect, effects)), plant.torque_form)
    time = sample * np.arange(int(round(duration / sample)) + 1)
    simulator = Simulator(falling, constraints=constraints)
    simulator.reset(start)
    return simulator.run(time, np.zeros((len(time), 3)), acceleration=acceleration)


def friction(kind: str, parameter: str, values) -> tuple[str, ...]:
    """An effect of one parameter at each of the three joints."""
    return tuple(f"{kind}:joint={j},{parameter}={float(v)!r}" for j, v in enumerate(values, start=1))


def coulomb(levels) -> tuple[str, ...]:
    """Dry friction of the three joints [N.m] as effects."""
    return friction("coulomb_friction", "torque", levels)


def reaction(plant: Plant) -> np.ndarray:
    """Torque [N.m] that the fall, until joint 2 meets its stop, exerts on joint 1 held still."""
    r = fall(plant, (), duration=0.38, constraints=(HELD, FREE, FREE), acceleration=True)
    return np.array(
        [
            (inertia(q, plant.arm) @ a + np.einsum("ijk,j,k", coriolis(q, plant.arm), w, w))[0]
            for q, w, a in zip(r.position, r.velocity, r.acceleration)
        ]
    )


def overshoot(r: Recording) -> float:
    """How far joint 3 swings past hanging [deg]; negative: it stays short of it."""
    return degrees(float(r.position[:, 2].max()) - HANGING)


def _motor_rows(plants: dict[str, Plant], falls: dict[str, Recording]) -> list[Row]:
    rows = []
    for name, plant in plants.items():
        long = fall(plant, (), duration=10.0 if name == "shorted" else 1.0)
        when = first_time(long.time, long.position[:, 1], STOP)
        q1 = degrees(float(np.interp(when, long.time, long.position[:, 0])))
        rows += [words.row("fall_time", when, case=name, motors=name), words.row("joint_1", q1, motors=name)]
    return rows + [words.row("overshoot", overshoot(falls[name]), case=name, motors=name) for name in FALLING]


def _table_rows(plants: dict[str, Plant]) -> list[Row]:
    """Readings of the friction column of table 7.1, by what they do to joint 3."""
    table, ratios = np.array(TABLE), np.array([m.gear_ratio for m in plants["shorted"].arm.motors])
    viscous = ("viscous_friction", "coefficient")
    readings = {
        "viscous at the joint": friction(*viscous, table),
        "dry at the joint": coulomb(table),
        "dry at the motor": coulomb(table * ratios),
        "viscous at the motor": friction(*viscous, table * ratios * ratios),
    }
    rows = []
    for name, effects in readings.items():
        found = [overshoot(fall(plants[motors], STOPS + effects)) for motors in FALLING]
        rows.append(words.row("reading", case=name, reading=name, found=found))
    return [*rows, words.row("ratio", TABLE[1] / TABLE[2])]


def friction_records(plant: Plant, instrument: Instrument, rng: np.random.Generator) -> list[Record]:
    """The typical fall of all joints to shortly before the stop, and joint 3 let go alone."""
    records = []
    alone = ((HELD, HELD, FREE), (3,), 1.5)
    for q3, constraints, joints, duration in ((0.0, (FREE,) * 3, (1, 2, 3), 0.38), (90.0, *alone), (225.0, *alone)):
        start = (0.0, 0.0, radians(q3))
        time = 0.001 * np.arange(int(duration / 0.001) + 1)
        simulator = Simulator(plant, constraints=constraints)
        simulator.reset(start)
        position = simulator.run(time, np.zeros((len(time), 3))).position[::5]
        angle = np.column_stack([instrument.angle(position[:, j], j + 1, rng) for j in range(3)])
        records.append(Record(time, np.zeros((len(time), 3)), 5, angle, joints, constraints, start))
    return records


def rubbing(arm: ArmParameters, levels) -> Plant:
    """An arm with dry friction [N.m] and motors that carry no current."""
    return open_circuit(Plant(arm, tuple(map(parse_effect, coulomb(levels)))))


def estimate_friction(arm: ArmParameters, records: list[Record], instrument: Instrument) -> Estimate:
    """Dry friction of three joints from falls, the rigid body taken as known."""
    return estimate(lambda levels: rubbing(arm, levels), records, NAMES, (5.0, 10.0, 5.0), instrument)


def estimation(context: Context, nominal: Plant) -> tuple[list[Row], dict[str, float]]:
    """Rows and numbers of the dry friction estimated from falls of a hidden arm."""
    rng = context.rng("7.3 friction")
    truth = np.array([5.0, 9.0, 4.5]) * rng.uniform(0.7, 1.3, 3)
    instrument = Instrument(angle_steps=tuple(2.0 * pi / (1000 * m.gear_ratio) for m in nominal.arm.motors))
    records = friction_records(rubbing(nominal.arm, truth), instrument, rng)
    fit = estimate_friction(nominal.arm, records, instrument)
    rows, numbers = [], {}
    for joint, (true, (low, high), value) in enumerate(zip(truth, fit.intervals, fit.values), start=1):
        found = {"low": low, "high": high, "truth": true}
        rows.append(words.row("estimate", value, joint=joint, **found))
        numbers |= {f"friction{joint}_{name}": each for name, each in {"estimate": value, **found}.items()}
    others = replace(load_parameters("average"), motors=nominal.arm.motors)
    other = estimate_friction(others, records, instrument)
    rows += [
        words.row("misfit", fit.misfit),
        words.row("twice", 2.0 * fit.values[2], truth=truth[1]),
        words.row("other_links", values=other.values, misfit=other.misfit),
    ]
    return rows, numbers | {"misfit_with_other_links": other.misfit}


@words.experiment("7.3")
def run(context: Context) -> Result:
    """Falls with three kinds of motor, with and without friction, and the estimate."""
    nominal = Plant.of()
    plants = {
        "shorted": nominal,
        "open-circuit": open_circuit(nominal),
        "as-printed": Plant(nominal.arm, torque_form="printed"),
    }
    falls = {name: fall(plant) for name, plant in plants.items()}
    torque = reaction(plants["open-circuit"])
    rows = [*_motor_rows(plants, falls), words.row("reaction", np.abs(torque).max()), *_table_rows(plants)]
    context.progress(0.4)
    levels = np.arange(0.0, 10.25, 0.5)
    swings = {
        name: np.array([overshoot(fall(plants[name], STOPS + coulomb((0.0, 0.0, level)))) for level in levels])
        for name in FALLING
    }
    chosen = float(levels[np.argmax(swings["as-printed"] < 0.5 * swings["as-printed"][0])])
    rows.append(words.row("chosen", chosen))
    context.progress(0.6)
    estimated, found = estimation(context, nominal)
    smooth, rubbed = falls["as-printed"], fall(plants["as-printed"], STOPS + coulomb((chosen, 0.0, chosen)))
    figures = []
    for name, suffix in (("as-printed", ""), ("open-circuit", "-open"), ("shorted", "-shorted")):
        curves = [Curve(f"q{j}", falls[name].time, falls[name].position[:, j - 1]) for j in (1, 2, 3)]
        figures.append(words.figure("fall", curves, motors=name, suffix=suffix))
    curves = [
        Curve(f"q{j}{text}", r.time, r.position[:, j - 1], style)
        for j in (1, 3)
        for r, text, style in ((smooth, "", "dashed"), (rubbed, " with friction", "line"))
    ]
    figures += [
        words.figure("7.5", curves, level=chosen),
        words.figure("7.5-friction", [Curve(f"{name} motors", levels, values) for name, values in swings.items()]),
    ]
    context.progress(1.0)
    numbers = {"chosen_friction_joint3_Nm": chosen, "reaction_joint1_Nm": [torque.min(), torque.max()]}
    return words.result("7.3", rows + estimated, figures, numbers | found)
