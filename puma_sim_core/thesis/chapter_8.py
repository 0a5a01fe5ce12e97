# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Chapter 8, the thesis's closing wish: smooth setpoints, velocity loops, decoupling.

Five controllers, designed on the model, do steps, a path with abrupt changes of velocity, and the same path smoothly.
The arm then is the model, differs from it by 10 % in every parameter that matters, or has unknown friction.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf

import numpy as np

from puma_sim_core.control.controllers import load_settings, make_controller
from puma_sim_core.control.metrics import effort, step_quality
from puma_sim_core.control.setpoints import Move
from puma_sim_core.control.velocity_loop import VelocityLoop, VelocityLoopSettings
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.recording import Recording
from puma_sim_core.servo.pid import Pid
from puma_sim_core.simulation.feedback import Controller
from puma_sim_core.simulation.simulator import SERVO_PERIOD
from puma_sim_core.thesis.motions import LIMIT, case, run_moves, tracking
from puma_sim_core.thesis.registry import Context
from puma_sim_core.thesis.result import Curve, Figure, Numbers, Result, Row
from puma_sim_core.thesis.wording import Words
from puma_sim_core.tuning.ziegler_nichols import settings

words = Words(__name__)
#: where all runs start: between upright and horizontal, the elbow bent
START = (0.0, -1.2, 1.0)
STEP_AT, STEP = 0.28, 0.1
#: the move of all joints at once [rad] and its duration [s]: its fastest moment takes some
#: three quarters of what the motors can do
BY, MOVE_AT, MOVE = (1.0, -0.8, 1.0), 0.28, 1.5
#: arms that differ from the model by 10 %, each parameter up or down by the toss of a coin
WRONG = 6
#: what the controllers have to follow: moves, and how long the runs last [s]
TRIALS = {
    "step": (Move(STEP_AT, 0.0, (STEP,) * 3, "step"), 2.0),
    "ramp": (Move(MOVE_AT, MOVE, BY, "ramp"), 3.0),
    "smooth": (Move(MOVE_AT, MOVE, BY, "quintic"), 3.0),
}
#: joint 1 moves and the others shall not
ALONE = (Move(MOVE_AT, 1.0, (1.0, 0.0, 0.0), "quintic"), 3.0)
NAMES = ("PID by table 7.2", "PID, detuned", "scheduled PID", "velocity loop", "computed torque")
CASES = ("model right", "parameters 10 % wrong", "unknown friction")
#: what differs of a motor
MOTOR = ("inertia", "resistance", "torque_constant", "back_emf")
#: found by trial on the model, so that an arm that differs from it is still damped
VELOCITY_LOOP = {
    "position_gain": (25.0, 25.0, 25.0),
    "velocity_gain": (25.0, 40.0, 15.0),
    "velocity_time": (0.05, 0.05, 0.05),
}


def controllers(plant: Plant) -> dict[str, Controller]:
    """The five, designed on the model. (The detuned PID has the gains of sim_node.)"""
    bounds = {name: load_settings("computed_torque")[name] for name in ("greatest_velocity", "greatest_acceleration")}
    tuned = [settings(case(plot).ultimate(plant)) for plot in ("7.18", "7.19", "7.21")]
    pid = Pid(tuned, SERVO_PERIOD, limit=LIMIT)
    loop = VelocityLoop(VelocityLoopSettings(**VELOCITY_LOOP, **bounds), SERVO_PERIOD, limit=LIMIT)
    detuned, scheduled, torque = (make_controller(name, plant) for name in ("pid", "scheduled", "computed_torque"))
    return dict(zip(NAMES, (pid, detuned, scheduled, loop, torque)))


def arms(plant: Plant, rng: np.random.Generator) -> dict[str, list[Plant]]:
    """The arms of each case."""
    signs = [np.ones(12), -np.ones(12), *rng.choice((-1.0, 1.0), (WRONG - 2, 12))]
    friction = tuple(map(parse_effect, Plant.of("corke_armstrong_1994").arm.suggested_effects))
    wrong = [differing(plant, 1.0 + 0.1 * s) for s in signs]
    return dict(zip(CASES, ([plant], wrong, [replace(plant, effects=friction)])))


def differing(plant: Plant, factors: np.ndarray) -> Plant:
    """The plant with factors (12,) on the link masses, and on the inertias, resistances, torque
    constants and back-EMFs of the motors; a torque constant and its back-EMF differ alike, since
    physics makes them one."""
    mass, inertia, resistance, constant = np.reshape(factors, (4, 3)).tolist()
    links = [replace(link, mass=link.mass * f) for link, f in zip(plant.arm.links, mass)]
    motors = [
        replace(motor, **{name: f * getattr(motor, name) for name, f in zip(MOTOR, each)})
        for motor, *each in zip(plant.arm.motors, inertia, resistance, constant, constant)
    ]
    return replace(plant, arm=replace(plant.arm, links=tuple(links), motors=tuple(motors)))


def follow(plant: Plant, controller: Controller, move: Move, duration: float) -> tuple[Recording, np.ndarray]:
    """(recording, path (n, 3) [rad] at its times) of a move."""
    return run_moves(plant, controller, START, (move,), duration, None)


def step_numbers(run: Recording, path: np.ndarray) -> dict[str, np.ndarray]:
    """Overshoot [%], rise and settling time [s] of each joint."""
    found = [step_quality(run.time, q, start, start + STEP, at=STEP_AT) for q, start in zip(run.position.T, START)]
    overshoot, rise, settling = np.transpose([(q.overshoot, q.rise_time, q.settling_time) for q in found])
    return {"overshoot_percent": 100.0 * overshoot, "rise_s": rise, "settling_s": settling}


def move_numbers(run: Recording, path: np.ndarray) -> dict[str, np.ndarray]:
    """Errors [mrad], volts and share of saturation [%] of each joint, and by how much it runs past
    the end of its path [mrad]."""
    beyond = ((run.position - path[-1]) * np.sign(path[-1] - path[0])).max(axis=0)
    more = {"saturated_percent": 100.0 * effort(run, LIMIT).saturated, "overshoot_mrad": 1e3 * np.maximum(beyond, 0.0)}
    return {**tracking(run, path), **more}


def worst_numbers(plants: Sequence[Plant], controller: Controller, kind: str) -> dict[str, list[float | None]]:
    """The worst of each number over the arms; None for a time that does not end."""
    measure = step_numbers if kind == "step" else move_numbers
    found = [measure(*follow(plant, controller, *TRIALS[kind])) for plant in plants]
    worst = {name: np.max([each[name] for each in found], axis=0).tolist() for name in found[0]}
    return {name: [None if v == inf else v for v in values] for name, values in worst.items()}


def three(values: Sequence[float | None], digits: int = 3) -> str:
    """Numbers of the three joints for a person."""
    return " / ".join("never" if v is None else f"{v:.{digits}g}" for v in values)


def figures(plant: Plant, made: dict[str, Controller], all_arms: dict[str, list[Plant]]) -> Iterator[Figure]:
    """Step of joint 2, and joint 2's errors on the smooth path in the three cases."""
    curves: list[Curve] = []
    for name, controller in made.items():
        run, path = follow(plant, controller, *TRIALS["step"])
        curves = curves or [Curve("setpoint", run.time, path[:, 1] - START[1], "steps")]
        curves.append(Curve(name, run.time, run.position[:, 1] - START[1]))
    yield words.figure("8-step", curves, step=STEP)
    for n, (of, plants) in enumerate(all_arms.items(), 1):
        runs = {name: follow(plants[0], controller, *TRIALS["smooth"]) for name, controller in made.items()}
        curves = [Curve(name, run.time, 1e3 * (run.position - path)[:, 1]) for name, (run, path) in runs.items()]
        yield words.figure("error", curves, case=len(plants) > 1, n=n, of=of)


@words.experiment("8")
def run(context: Context) -> Result:
    """The controllers beside each other."""
    plant, rows, numbers = Plant.of(), list[Row](), Numbers()
    made, all_arms = controllers(plant), arms(plant, context.rng("8 arms"))
    for index, (of, plants) in enumerate(all_arms.items()):
        for name, controller in made.items():
            shown = {}
            for kind in TRIALS:
                worst = worst_numbers(plants, controller, kind)
                numbers |= {f"{of}, {name}: {kind} {key}": each for key, each in worst.items()}
                shown[kind] = {key: three(each, 2 if key == "saturated_percent" else 3) for key, each in worst.items()}
            rows.append(words.row("step", of=of, name=name, found=shown["step"], step=STEP))
            rows += [words.row("path", case=kind, of=of, name=name, found=shown[kind]) for kind in ("ramp", "smooth")]
        context.progress((index + 1) / 4)
    rows += conclusions(plant, made, numbers)
    drawn = list(figures(plant, made, all_arms))
    context.progress(1.0)
    worst = {name: [max(numbers[f"{of}, {name}: smooth worst_mrad"]) for of in CASES] for name in NAMES}
    torque, pid = worst["computed torque"], worst["PID, detuned"]
    ratio = [other / own for other, own in zip(pid, torque)]
    return words.result("8", rows, drawn, numbers, torque=torque, pid=pid, ratio=ratio, wrong=WRONG)


def conclusions(plant: Plant, made: dict[str, Controller], numbers: Numbers) -> list[Row]:
    """What the thesis concludes, and what comes of it here."""
    rows = []
    for name in NAMES:
        abrupt, smooth = (three(numbers[f"{CASES[0]}, {name}: {kind} overshoot_mrad"]) for kind in ("ramp", "smooth"))
        rows.append(words.row("conclusion 2", name=name, abrupt=abrupt, smooth=smooth))
    for name, controller in made.items():
        run, path = follow(plant, controller, *ALONE)
        moved = numbers[f"coupling, {name}"] = (1e3 * np.abs(run.position - path).max(axis=0)).tolist()
        rows.append(words.row("conclusion 5", three(moved[1:]), name=name))
    return rows
