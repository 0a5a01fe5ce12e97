# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Chapter 8, the thesis's closing wish: smooth setpoints, velocity loops, decoupling.

Five controllers do the same: steps, a path with abrupt changes of velocity, and the same path
smoothly. Each is designed once, on the model. The arm then is the model, differs from it by 10 %
in every parameter that matters, or has friction that no controller knows of.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from puma_sim_core.control.controllers import load_settings, make_controller
from puma_sim_core.control.metrics import effort, step_quality, tracking_error
from puma_sim_core.control.setpoints import Move, joint_path, joint_setpoints
from puma_sim_core.control.velocity_loop import VelocityLoop
from puma_sim_core.dynamics.pid import Pid
from puma_sim_core.effects import parse_effect
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator
from puma_sim_core.thesis.registry import Context, experiment
from puma_sim_core.thesis.result import Curve, Figure, Result, Row
from puma_sim_core.thesis.tuning import case
from puma_sim_core.tuning.ziegler_nichols import settings

LIMIT = 40.0
#: where all runs start: between upright and horizontal, the elbow bent
START = (0.0, -1.2, 1.0)
STEP_AT, STEP, STEP_TIME = 0.28, 0.1, 2.0
#: the move of all joints at once [rad] and its duration [s]: its fastest moment takes some
#: three quarters of what the motors can do
BY, MOVE_AT, MOVE, MOVE_TIME = (1.0, -0.8, 1.0), 0.28, 1.5, 3.0
#: arms that differ from the model by 10 %, each parameter up or down by the toss of a coin
WRONG = 6
NAMES = ("PID by table 7.2", "PID, detuned", "scheduled PID", "velocity loop", "computed torque")
CASES = ("model right", "parameters 10 % wrong", "unknown friction")
#: found by trial on the model, so that an arm that differs from it is still damped
VELOCITY_LOOP = {
    "position_gain": (25.0, 25.0, 25.0),
    "velocity_gain": (25.0, 40.0, 15.0),
    "velocity_time": (0.05, 0.05, 0.05),
}


def controllers(plant: Plant) -> dict:
    """The five, designed on the model. (The detuned PID has the gains of sim_node.)"""
    bounds = {name: load_settings("computed_torque")[name] for name in ("greatest_velocity", "greatest_acceleration")}
    tuned = [settings(case(plot).ultimate(plant)) for plot in ("7.18", "7.19", "7.21")]
    made = (
        Pid(tuned, SERVO_PERIOD, limit=LIMIT),
        make_controller("pid", plant),
        make_controller("scheduled", plant),
        VelocityLoop(SERVO_PERIOD, **VELOCITY_LOOP, **bounds, limit=LIMIT),
        make_controller("computed_torque", plant),
    )
    return dict(zip(NAMES, made))


def arms(plant: Plant, rng: np.random.Generator) -> dict[str, list[Plant]]:
    """The arms of each case."""
    signs = [np.ones(12), -np.ones(12), *rng.choice((-1.0, 1.0), (WRONG - 2, 12))]
    friction = Plant.of("corke_armstrong_1994").arm.suggested_effects
    return dict(
        zip(
            CASES,
            (
                [plant],
                [differing(plant, 1.0 + 0.1 * s) for s in signs],
                [replace(plant, effects=tuple(map(parse_effect, friction)))],
            ),
        )
    )


def differing(plant: Plant, factors) -> Plant:
    """The plant with factors (12,) on the link masses, and on the inertias, resistances, torque
    constants and back-EMFs of the motors; a torque constant and its back-EMF differ alike, since
    physics makes them one."""
    mass, ia, resistance, kt = np.reshape(factors, (4, 3)).tolist()
    links = tuple(replace(link, mass=link.mass * f) for link, f in zip(plant.arm.links, mass))
    motors = tuple(
        replace(
            m,
            inertia=m.inertia * a,
            resistance=m.resistance * r,
            torque_constant=m.torque_constant * k,
            back_emf=m.back_emf * k,
        )
        for m, a, r, k in zip(plant.arm.motors, ia, resistance, kt)
    )
    return replace(plant, arm=replace(plant.arm, links=links, motors=motors))


@dataclass(frozen=True)
class Trial:
    """A path that a controller has to follow."""

    moves: tuple[Move, ...]
    duration: float

    def run(self, plant: Plant, controller):
        """(recording, path (n, 3) [rad] at its times)."""
        _, setpoint = joint_setpoints(START, self.moves, self.duration)
        simulator = Simulator(plant)
        simulator.reset(START)
        run = simulator.run_controller(controller, setpoint[:-1], voltage_limit=LIMIT)
        return run, joint_path(START, self.moves, run.time)


STEPS = Trial((Move(STEP_AT, 0.0, (STEP,) * 3, "step"),), STEP_TIME)
RAMPS = Trial((Move(MOVE_AT, MOVE, BY, "ramp"),), MOVE_TIME)
SMOOTH = Trial((Move(MOVE_AT, MOVE, BY, "quintic"),), MOVE_TIME)
#: joint 1 moves and the others shall not
ALONE = Trial((Move(MOVE_AT, 1.0, (1.0, 0.0, 0.0), "quintic"),), MOVE_TIME)


def step_numbers(plants, controller) -> dict:
    """Overshoot [%], rise and settling time [s] of each joint: the worst over the arms; None for
    a time that does not end."""
    found = []
    for plant in plants:
        run, _ = STEPS.run(plant, controller)
        found.append(
            [step_quality(run.time, run.position[:, j], START[j], START[j] + STEP, at=STEP_AT) for j in range(3)]
        )
    worst = np.array(found).max(axis=0)

    def plain(values):
        return [None if v == inf else float(v) for v in values]

    return {
        "overshoot_percent": plain(100.0 * worst[:, 0]),
        "rise_s": plain(worst[:, 1]),
        "settling_s": plain(worst[:, 2]),
    }


def move_numbers(plants, controller, trial: Trial) -> dict:
    """Errors [mrad], volts and share of saturation [%] of each joint: the worst over the arms."""
    found = []
    for plant in plants:
        run, path = trial.run(plant, controller)
        error, used = tracking_error(run, path), effort(run, LIMIT)
        found.append([1e3 * error.rms, 1e3 * error.worst, used.rms, 100.0 * used.saturated, 1e3 * beyond(run, path)])
    names = ("rms_mrad", "worst_mrad", "volts_rms", "saturated_percent", "overshoot_mrad")
    return dict(zip(names, np.array(found).max(axis=0).tolist()))


def beyond(run, path) -> np.ndarray:
    """(3,) [rad] by how much the joints run past the end of their path."""
    moved = np.sign(path[-1] - path[0])
    return np.maximum(((run.position - path[-1]) * moved).max(axis=0), 0.0)


def three(values, digits: int = 3) -> str:
    """Numbers of the three joints for a person."""
    return " / ".join("never" if v is None else f"{v:.{digits}g}" for v in values)


def case_rows(name: str, of: str, found: dict) -> list[Row]:
    """The rows of a controller on the arms of a case; joints 1 / 2 / 3."""
    step = found["step"]
    rows = [
        Row(
            f"{of}, {name}: step of {STEP:g} rad",
            "%; s; s",
            None,
            f"overshoot {three(step['overshoot_percent'])}; rise {three(step['rise_s'])}; "
            f"settling {three(step['settling_s'])}",
        )
    ]
    for kind, words in (("ramp", "abrupt path"), ("smooth", "smooth path")):
        move = found[kind]
        rows.append(
            Row(
                f"{of}, {name}: {words}",
                "mrad; mrad; V; %",
                None,
                f"rms {three(move['rms_mrad'])}; worst {three(move['worst_mrad'])}; "
                f"{three(move['volts_rms'])} V rms; saturated {three(move['saturated_percent'], 2)}",
            )
        )
    return rows


def figures(plant: Plant, made: dict, all_arms: dict):
    """Step of joint 2, and joint 2's errors on the smooth path in the three cases."""
    curves = []
    for name, controller in made.items():
        run, path = STEPS.run(plant, controller)
        if not curves:
            curves.append(Curve("setpoint", run.time, path[:, 1] - START[1], "steps"))
        curves.append(Curve(name, run.time, run.position[:, 1] - START[1]))
    yield Figure(
        "8-step",
        f"All joints step by {STEP:g} rad at once: joint 2, model right",
        "time [s]",
        "joint 2, from its start [rad]",
        tuple(curves),
    )
    for of, plants in all_arms.items():
        curves = []
        for name, controller in made.items():
            run, path = SMOOTH.run(plants[0], controller)
            curves.append(Curve(name, run.time, 1e3 * (run.position - path)[:, 1]))
        yield Figure(
            f"8-error-{CASES.index(of) + 1}",
            f"Smooth path of all joints: {of}",
            "time [s]",
            "error of joint 2 [mrad]",
            tuple(curves),
            "All parameters 10 % greater." if len(plants) > 1 else "",
        )


@experiment("8", "Smooth setpoints, velocity loops, decoupling", chapter="8")
def run(context: Context) -> Result:
    """The controllers beside each other."""
    plant = Plant.of()
    made, all_arms = controllers(plant), arms(plant, context.rng("8 arms"))
    rows, numbers = [], {}
    for index, (of, plants) in enumerate(all_arms.items()):
        for name, controller in made.items():
            found = {
                "step": step_numbers(plants, controller),
                "ramp": move_numbers(plants, controller, RAMPS),
                "smooth": move_numbers(plants, controller, SMOOTH),
            }
            numbers |= {
                f"{of}, {name}: {kind} {key}": value for kind, values in found.items() for key, value in values.items()
            }
            rows += case_rows(name, of, found)
        context.progress((index + 1) / 4)
    rows += conclusions(plant, made, numbers)
    drawn = tuple(figures(plant, made, all_arms))
    context.progress(1.0)
    right, wrong, rough = (max(numbers[f"{of}, computed torque: smooth worst_mrad"]) for of in CASES)
    pid = [max(numbers[f"{of}, PID, detuned: smooth worst_mrad"]) for of in CASES]
    return Result(
        f"On a smooth path computed torque is {pid[0] / right:.0f} times as exact as independent "
        f"PID (sim_node's gains) with the model right (worst error {right:.2g} against "
        f"{pid[0]:.2g} mrad), "
        f"{pid[1] / wrong:.0f} times with parameters 10 % wrong ({wrong:.2g} against {pid[1]:.2g}) "
        f"and {pid[2] / rough:.0f} times with friction that it does not know ({rough:.2g} against "
        f"{pid[2]:.2g}). Joints: 1 / 2 / 3, all moving at once; worst case of the {WRONG} arms "
        "with wrong parameters. Errors are those from the continuous path, sampled at the servo's "
        "rate; controllers get it as setpoints each 28 ms. Part of what computed torque and the "
        "velocity loop gain comes from that: they make velocities of the setpoints, where PID sees "
        "steps. A step they take as a command to go there as fast as their bounds allow, and rise "
        "more slowly than PID, which saturates and overshoots.",
        tuple(rows),
        drawn,
        numbers,
    )


def conclusions(plant: Plant, made: dict, numbers: dict) -> list[Row]:
    """What the thesis concludes, and what comes of it here."""
    rows = []
    of = CASES[0]
    for name in NAMES:
        abrupt, smooth = (numbers[f"{of}, {name}: {kind} overshoot_mrad"] for kind in ("ramp", "smooth"))
        rows.append(
            Row(
                f"(2) overshoot at the end of the path, {name}: abrupt, smooth",
                "mrad",
                "avoided by smooth velocity changes",
                f"{three(abrupt)}, then {three(smooth)}",
            )
        )
    for name, controller in made.items():
        run, path = ALONE.run(plant, controller)
        moved = 1e3 * np.abs(run.position - path).max(axis=0)
        numbers[f"coupling, {name}"] = moved.tolist()
        rows.append(
            Row(
                f"(5) joints 2 / 3 disturbed by a move of joint 1, {name}",
                "mrad",
                "decoupling may be required",
                three(moved[1:]),
                "A quintic of 1 rad in 1 s.",
            )
        )
    return rows
