# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Section 7.5: a recorded path down a vertical line, replayed open loop."""

from dataclasses import replace
from math import radians

import numpy as np

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.rigid_body import gravity_torque
from puma_sim_core.control.setpoints import vertical_line
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import Recording
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator
from puma_sim_core.thesis.chapter_7_4 import instrument
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Numbers, Result, Row
from puma_sim_core.thesis.wording import Words
from puma_sim_core.tuning.estimation import Instrument

words = Words(__name__)
#: where the recorded line begins; figure 7.6 is not in the text that we have
START = (0.0, radians(-20.0), radians(50.0))
#: length [m] and time [s] of the line, and what the arm went before it came to rest there [m]
LINE, DURATION, APPROACH = -0.4, 8.0, 0.06
#: servo samples of the rest before the line that is in the record, and of what its means are of
REST, MEAN = round(0.5 / SERVO_PERIOD), int(0.2 / SERVO_PERIOD)
#: how long the first drop is looked at [s]
FIRST = 0.5
BRAKES = "on its brakes"
HISTORIES = ("from above", "from below", BRAKES)
#: torques of dry friction that depends on the direction
WAYS = ("positive", "negative")


def robot(rng: np.random.Generator) -> Plant:
    """The measured arm: the set `tuned` with friction near that measured by others."""
    friction = tuple(map(parse_effect, load_parameters("corke_armstrong_1994").suggested_effects))
    return scaled_effects(Plant(load_parameters("tuned"), friction), rng.uniform(0.85, 1.15, len(friction)))


def scaled_effects(plant: Plant, factors: np.ndarray) -> Plant:
    """The plant with all values of each effect times a factor."""
    scaled = (
        replace(effect, values={name: factor * value for name, value in effect.values.items()})
        for effect, factor in zip(plant.effects, factors.tolist())
    )
    return replace(plant, effects=tuple(scaled))


def record(plant: Plant, history: str, meter: Instrument, rng: np.random.Generator) -> Recording:
    """Drive the line under the servo and record it, after the arm came to rest as `history` says.

    On its brakes the arm cannot move and its motors have 0 V; the servo takes over as the line
    begins.
    """
    _, line = vertical_line(plant.arm, START, LINE, DURATION)
    line = np.vstack([line, np.repeat(line[-1:], 10, axis=0)])
    simulator = Simulator(plant)
    if history == BRAKES:
        simulator.reset(START)
        run = simulator.run_servo(line)
        position = np.vstack([np.repeat(run.position[:1], REST, axis=0), run.position])
        voltage = np.vstack([np.zeros((REST, 3)), run.voltage])
    else:
        rise = APPROACH if history == "from above" else -APPROACH
        _, away = vertical_line(plant.arm, START, rise, 2.0)
        simulator.reset(away[-1])
        there, settled = np.repeat(away[-1:], 30, axis=0), np.repeat(line[:1], 60, axis=0)
        run = simulator.run_servo(np.vstack([there, away[::-1], settled, line]))
        first = 30 * (30 + len(away) + 60) - REST
        position, voltage = run.position[first:], run.voltage[first:]
    angle = np.column_stack([meter.angle(position[:, j], j + 1, rng) for j in range(3)])
    volts = np.column_stack([meter.voltage(voltage[:, j], rng) for j in range(3)])
    return Recording(SERVO_PERIOD * np.arange(len(position)), volts, angle)


def replay(path: Recording, plant: Plant, *, current: bool = False) -> np.ndarray:
    """(n, 3) angles [rad] of a plant under the recorded voltages, from the recorded start at rest;
    with the motor currents of the start, or as the thesis's simulator starts, without any."""
    amperes = path.voltage[:MEAN].mean(axis=0) / [m.resistance for m in plant.arm.motors]
    simulator = Simulator(plant)
    simulator.reset(path.position[:MEAN].mean(axis=0), None, amperes if current else (0.0, 0.0, 0.0))
    return simulator.run(path.time, path.voltage).position


def _from_brakes(path: Recording, plant: Plant) -> np.ndarray:
    """As `replay`, with the brakes of the arm in the model: it starts as the line begins."""
    start = path.position[:REST].mean(axis=0)
    simulator = Simulator(plant)
    simulator.reset(start)
    return np.vstack([np.tile(start, (REST, 1)), simulator.run(path.time[REST:], path.voltage[REST:]).position])


def _causes(plant: Plant, measured: Plant, paths: dict[str, Recording], numbers: Numbers) -> list[Row]:
    """What each candidate makes of the drop at rest, by itself."""
    gravity = gravity_torque(np.array(START), plant.arm)
    # volts that a joint at rest takes for a newton metre
    volts_per_torque = np.array([m.resistance / k for m, k in zip(plant.arm.motors, plant.torque_per_ampere)])
    hold = volts_per_torque * gravity
    creep = [1 / (m.back_emf * m.gear_ratio) for m in plant.arm.motors]
    # the right volts, without noise, and no current at first
    steady = Recording(paths["from above"].time[:1000], np.tile(hold, (1000, 1)), np.tile(START, (1000, 1)))
    started = replay(steady, plant)[-1] - np.array(START)
    numbers["drop_without_current_rad"] = started
    rows = [words.row("hold", hold=hold, gravity=gravity, creep=creep), words.row("current", started[1])]
    dry = [[e.values.get(way, 0.0) for e in measured.effects if e.joint == j for way in WAYS] for j in (1, 2, 3)]
    band = volts_per_torque * [max(torques) for torques in dry]
    for history, path in paths.items():
        simulated = replay(path, plant, current=True)
        drop = numbers[f"drop_{history.replace(' ', '_')}_rad"] = simulated[round(FIRST / SERVO_PERIOD)] - simulated[0]
        # no minus before 0.00
        volts = np.round(path.voltage[:MEAN].mean(axis=0), 2) + 0.0
        # positive angles are downward
        goes = ["drops" if d > 0.0 else "rises" for d in drop]
        about = {"volts": volts, "drop": drop, "goes": goes, "band": band, "within": FIRST}
        rows.append(words.row("rest", case=history == BRAKES, history=history, **about))
    return rows


@words.experiment("7.5")
def run(context: Context) -> Result:
    """The line down, three ways to be at rest before it, and the replay of each."""
    rng = context.rng("7.5")
    arm = robot(rng)
    model, meter, numbers = Plant(arm.arm), instrument(arm.arm), Numbers()
    paths = {}
    for n, history in enumerate(HISTORIES):
        paths[history] = record(arm, history, meter, rng)
        context.progress((n + 1) / 5.0)
    rows = _causes(model, arm, paths, numbers)
    path = paths[BRAKES]
    angles = {"plain": replay(path, model), "friction": _from_brakes(path, arm)}
    context.progress(0.9)
    moved = path.position[-1] - path.position[0]
    ratio = {name: (q[-1] - q[0]) / moved for name, q in angles.items()}
    for j in (2, 3):
        rows.append(words.row("ratio", ratio["plain"][j - 1], case=j, joint=j))
        numbers[f"way_ratio_joint{j}"] = ratio["plain"][j - 1]
        numbers[f"way_ratio_joint{j}_with_friction"] = ratio["friction"][j - 1]
    stiff = scaled_effects(arm, np.full(len(arm.effects), 1.5))
    slow = (_from_brakes(path, stiff)[-1] - path.position[0]) / moved
    rows.append(words.row("slow", slow[2]))
    for name, q in angles.items():
        rows.append(words.row("distance", case=name, distance=np.abs(q - path.position).max(axis=0)))
    figures, lines = [], list(zip({"measured": path.position, **angles}.items(), ("line", "dashed", "points")))
    for j in (1, 2, 3):
        curves = [Curve(name, path.time[::10], q[::10, j - 1], style) for (name, q), style in lines]
        figures.append(words.figure("motion", curves, case=j, joint=j))
    context.progress(1.0)
    return words.result("7.5", rows, figures, numbers, n=numbers)
