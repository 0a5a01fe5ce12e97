# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Tasks as data: what the arm is to do, what is done to it, and the limits that pass or fail is judged by.

All are made for an arm and its voltage limit, so that the limits follow from what that arm can do. The bounds are those
within which a drive at `VOLTAGE_LIMIT` can follow: the speed at which the back-EMF takes 0.9 of it, and the greatest
accelerations of config/controllers.yaml.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from puma_sim_core.appraisal.settings import (
    ACCURACY,
    GREATEST_SENSITIVITY,
    LATE,
    OVERSHOOT,
    PUSHED,
    REST,
    SETPOINT_PERIOD,
    SETTLING,
    VOLTAGE_LIMIT,
    WOUND_UP,
)
from puma_sim_core.appraisal.tasks.paths import Circle, Corner, Pass, angles_along, greatest_speed
from puma_sim_core.appraisal.trials.response import Aims, Path, Step, Stop
from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.inverse_kinematics import wrist_angles
from puma_sim_core.control.controllers import load_settings
from puma_sim_core.control.setpoints import Move, joint_path
from puma_sim_core.plant.plant import Plant

#: where the wrist works [m]: half a metre in front of the base, with room for a step and a path in all directions
WORKPLACE = (0.5, 0.15, 0.3)
#: near which pose its joints are looked for [rad]: elbow up
_NEAR = (0.0, -1.4, 3.2)
#: rated speed of a path, as a share of that at which the back-EMF takes 0.9 of the voltage: a third is left
_RATED = 0.75
#: least duration of a task [s]
_LEAST = 3.0
Triple = tuple[float, float, float]


class Limit(NamedTuple):
    """The most that a measure may be for a trial to pass (the least, of margins), in the measure's unit."""

    measure: str
    value: float
    why: str


class Push(NamedTuple):
    """Voltages [V] added at the plant's input from a time [s] on, as a steady torque would take them."""

    start: float
    voltage: Triple


@dataclass(frozen=True)
class Task:
    """One task.

    name, sentence : for lists and reports; start (3,) [rad]: where the arm stands at time 0; duration [s], a whole
    number of setpoints; reference : times (n,) [s] -> wanted joint angles (n, 3) [rad]; aims : what it is judged by.
    limits : all must hold for a trial to pass; the score is that of the first.
    pushes : disturbances at the plant's input; lost : (from, to) in which commands do not reach the plant [s]: the
    motors then get 0 V, as sim_node's watchdog gives them.
    margins : the sampled loop's margins belong to it.
    """

    name: str
    sentence: str
    start: tuple[float, ...]
    duration: float
    reference: Callable[[np.ndarray], np.ndarray]
    aims: Aims
    limits: tuple[Limit, ...]
    pushes: tuple[Push, ...] = ()
    lost: tuple[tuple[float, float], ...] = ()
    margins: bool = False


class _Bounds(NamedTuple):
    """Of an arm: joint speeds (3,) [rad/s], accelerations (3,) [rad/s^2], and the angle that moves the wrist by
    `ACCURACY` at full reach [rad]."""

    speed: np.ndarray
    acceleration: np.ndarray
    angle: float

    @classmethod
    def of(cls, arm: ArmParameters, limit: float) -> _Bounds:
        speed = np.array([0.9 * limit / (m.back_emf * m.gear_ratio) for m in arm.motors])
        reach = arm.a2 + sqrt(arm.a3**2 + arm.d4**2)
        acceleration = np.array(load_settings("computed_torque")["greatest_acceleration"])
        return cls(speed, acceleration, ACCURACY / reach)

    def least_time(self, by: Sequence[float]) -> float:
        """Least time [s] of a move of all joints by (3,) [rad]: a trapezoid of speed, or a triangle."""
        found = []
        for distance, v, a in zip(np.abs(by), self.speed, self.acceleration):
            found.append(distance / v + v / a if distance > v * v / a else 2.0 * sqrt(distance / a))
        return float(max(found))


def whole(duration: float) -> float:
    """The least whole number of setpoint periods that covers a duration [s], and the least duration of a task."""
    return SETPOINT_PERIOD * ceil(max(duration, _LEAST) / SETPOINT_PERIOD - 1e-9)


@lru_cache(maxsize=4)
def tasks(plant: Plant, limit: float = VOLTAGE_LIMIT) -> dict[str, Task]:
    """All tasks by name for an arm with motors of at most `limit` [V]."""
    arm, bounds = plant.arm, _Bounds.of(plant.arm, limit)
    start = tuple(wrist_angles(WORKPLACE, arm, _NEAR).tolist())
    found = [
        *(_step(f"small_step_{j}", "A small step of one joint.", start, _only(j, 0.05), bounds) for j in (1, 2, 3)),
        *(_step(f"large_step_{j}", "A large step of one joint.", start, _only(j, 0.8), bounds) for j in (1, 2, 3)),
        _step("simultaneous_steps", "Steps of all joints at once: coupling.", start, (0.3, 0.3, -0.3), bounds),
        _load_step(plant, start, bounds),
        *_paths(arm, start, bounds),
        _reversals(start, bounds),
        _poses(arm, bounds),
        _margins(start, bounds),
        _slew(start, bounds),
        _loss(start, bounds),
        _effects(start, bounds),
    ]
    return {task.name: task for task in found}


def _only(joint: int, by: float) -> Triple:
    """A move of one joint [rad]; joint 3 moves down, where it has room."""
    first, second, third = (by * (-1.0 if joint == 3 else 1.0) if j == joint else 0.0 for j in (1, 2, 3))
    return first, second, third


def _steps(start: Sequence[float], by: Sequence[float], at: float) -> tuple[Step, ...]:
    return tuple(Step(j, at, q, q + d) for j, (q, d) in enumerate(zip(start, by), 1) if d)


def _moves(start: Sequence[float], moves: Sequence[Move]) -> Callable[[np.ndarray], np.ndarray]:
    return lambda time: joint_path(start, moves, time)


def _step(name: str, sentence: str, start: tuple[float, ...], by: Triple, bounds: _Bounds) -> Task:
    settling = bounds.least_time(by) + SETTLING
    return Task(
        name,
        sentence,
        start,
        whole(REST + 2.5 * settling),
        _moves(start, [Move(REST, 0.0, by, "step")]),
        Aims(steps=_steps(start, by, REST)),
        (
            Limit("settling_time", settling, f"least time of the move and {SETTLING:g} s"),
            Limit("overshoot", OVERSHOOT, "damping ratio of 0.45"),
        ),
    )


def _slew(start: tuple[float, ...], bounds: _Bounds) -> Task:
    by = (1.6, 0.9, -1.6)
    settling = bounds.least_time(by) + SETTLING
    limits = (
        Limit("overshoot", WOUND_UP, "damping ratio of 0.6: more is wound up"),
        Limit("settling_time", settling, f"least time of the move and {SETTLING:g} s"),
    )
    sentence = "A step of all joints so large that the voltages stay at their limit: wind-up."
    moves = _moves(start, [Move(REST, 0.0, by, "step")])
    return Task(
        "saturating_slew", sentence, start, whole(REST + 2.0 * settling), moves, Aims(_steps(start, by, REST)), limits
    )


def _load_step(plant: Plant, start: tuple[float, ...], bounds: _Bounds) -> Task:
    # in volts the steady torque of a load of 2 kg at the wrist, at full reach, on each joint
    torque = 2.0 * 9.81 * ACCURACY / bounds.angle
    drives = zip(plant.arm.motors, plant.torque_per_ampere)
    first, second, third = (torque * motor.resistance / per for motor, per in drives)
    end = whole(REST + 1.68)
    limits = (
        Limit("greatest_error", PUSHED * bounds.angle, f"{PUSHED:g} mm of the wrist at full reach"),
        Limit("pose_accuracy", ACCURACY, "ten times the arm's specified repeatability"),
    )
    return Task(
        "load_step",
        f"A torque of {torque:.1f} N.m, that of 2 kg at full reach, comes on each joint while the arm is to stand.",
        start,
        end,
        _moves(start, ()),
        Aims(stops=(Stop(1, 1, REST, end),)),
        limits,
        pushes=(Push(REST, (-first, -second, -third)),),
    )


def _paths(arm: ArmParameters, start: tuple[float, ...], bounds: _Bounds) -> list[Task]:
    x, y, z = WORKPLACE
    shapes: dict[str, Corner | Circle] = {
        "line": Corner((x, y - 0.15, z - 0.1), (x, y + 0.15, z - 0.1), (x, y + 0.15, z + 0.2)),
        "circle": Circle((x, y, z - 0.1), 0.1),
    }
    found = []
    for number, (name, shape) in enumerate(shapes.items(), 1):
        begin = tuple(wrist_angles(shape.at(np.zeros(1))[0], arm, start).tolist())
        fastest = _RATED * greatest_speed(shape, arm, np.array(begin), bounds.speed)
        for percent in (10, 50, 100):
            found.append(_path(f"{name}_{percent}", number, shape, 0.01 * percent * fastest, arm, begin))
    return found


def _path(
    name: str, number: int, shape: Corner | Circle, speed: float, arm: ArmParameters, begin: tuple[float, ...]
) -> Task:
    way = Pass(shape, speed, REST, 0.42)
    low, high = way.constant
    corner = way.time_at(shape.lengths[0]) if isinstance(shape, Corner) else None
    allowed = max(ACCURACY, speed * SETPOINT_PERIOD)
    why = "what the wrist covers between two setpoints, 1 mm at least"
    limits, passes = [Limit("path_accuracy", allowed, why)], [Path(number, low, high, speed)]
    if corner is not None:
        # both lines, the second from its middle on: what the corner does to it is judged by itself
        lines = Path(number, low, corner, speed), Path(number + 10, 0.5 * (corner + high), high, speed)
        passes = [*lines, Path(number, low, high, speed, corner)]
        # without slowing down a corner is cut within the time that a loop of the step tasks takes to answer
        limits.append(
            Limit("corner_overshoot", max(ACCURACY, 0.25 * speed * SETTLING), "a quarter of the way in 0.45 s")
        )
    words = "straight lines with a corner of 90 degrees between them" if corner is not None else "a circle"

    def reference(time: np.ndarray) -> np.ndarray:
        return angles_along(shape.at(way.distance(time)), arm, np.array(begin))

    return Task(
        name,
        f"The wrist along {words}, at {speed:.3f} m/s.",
        begin,
        whole(way.end + 0.28),
        reference,
        Aims(paths=tuple(passes)),
        tuple(limits),
    )


def _reversals(start: tuple[float, ...], bounds: _Bounds) -> Task:
    way, time = 0.02, 0.84
    there = [Move(REST + 2 * k * time, time, (way,) * 3, "ramp") for k in range(2)]
    back = [Move(REST + (2 * k + 1) * time, time, (-way,) * 3, "ramp") for k in range(2)]
    return Task(
        "slow_reversals",
        f"All joints to and fro at {way / time:.3f} rad/s: stick-slip.",
        start,
        whole(REST + 4.0 * time + 0.28),
        _moves(start, there + back),
        Aims(),
        (Limit("greatest_error", 2.0 * bounds.angle, "2 mm of the wrist at full reach"),),
    )


def _poses(arm: ArmParameters, bounds: _Bounds) -> Task:
    out, away, dwell, between = 0.06, 0.28, 0.42, 0.84
    x, y, z = WORKPLACE
    # the five poses of ISO 9283, 6.6: the centre and four corners of a plane across a cube of 250 mm
    d = 0.8 * 0.125
    poses = [(0, 0, 0), (d, d, d), (-d, d, -d), (-d, -d, -d), (d, -d, d)]
    places = [(x + a, y + b, z + c) for a, b, c in poses]
    knots, stops, time, near = [], [], REST, np.array(_NEAR)
    near = first = wrist_angles(places[0], arm, near)
    for number, place in enumerate(places, 1):
        pose = wrist_angles(place, arm, near)
        for axis in range(3):
            beside = np.array(place)
            beside[axis] += out
            approach = wrist_angles(beside, arm, pose)
            duration = between if axis == 0 else away
            knots += [(time, duration, approach - near), (time + duration, away, pose - approach)]
            time += duration + away
            stops.append(Stop(number, axis + 1, time, time + dwell))
            time, near = time + dwell, pose
    moves = [Move(at, duration, tuple(by.tolist()), "quintic") for at, duration, by in knots]
    start = tuple(first.tolist())
    return Task(
        "poses",
        "Five poses, each approached along three directions (ISO 9283).",
        start,
        whole(time + 0.056),
        _moves(start, moves),
        Aims(stops=tuple(stops)),
        (
            Limit("pose_accuracy", ACCURACY, "ten times the arm's specified repeatability"),
            Limit("stabilisation_time", dwell, "all of the time at a pose"),
        ),
    )


def _margins(start: tuple[float, ...], bounds: _Bounds) -> Task:
    end = whole(2.8)
    limits = (
        Limit("sensitivity_peak", GREATEST_SENSITIVITY, "gain margin 2 and phase margin 29 degrees at least"),
        Limit("greatest_error", PUSHED * bounds.angle, f"{PUSHED:g} mm of the wrist at full reach"),
    )
    return Task(
        "margins",
        "The sampled loop of each joint about the workplace: sensitivity and margins at the plant's input.",
        start,
        end,
        _moves(start, ()),
        Aims(),
        limits,
        margins=True,
    )


def _loss(start: tuple[float, ...], bounds: _Bounds) -> Task:
    lost, end = (REST + 0.28, REST + 0.28 + 0.28), whole(REST + 2.24)
    by = (0.3, 0.3, -0.3)
    move = bounds.least_time(by) + SETTLING
    reference = _moves(start, [Move(REST, move, by, "quintic")])
    limits = (
        Limit("stabilisation_time", SETTLING, f"{SETTLING:g} s, as behind any move"),
        Limit("pose_accuracy", ACCURACY, "ten times the arm's specified repeatability"),
    )
    return Task(
        "command_loss",
        f"Commands are lost for {lost[1] - lost[0]:.2f} s of a smooth move of all joints, and come again.",
        start,
        end,
        reference,
        Aims(stops=(Stop(1, 1, REST + move, end),)),
        limits,
        lost=(lost,),
    )


def _effects(start: tuple[float, ...], bounds: _Bounds) -> Task:
    by = (0.5, 0.4, -0.5)
    move = bounds.least_time(by) + SETTLING
    way, slow = 0.02, 0.56
    at = REST + move + 0.84
    moves = [Move(REST, move, by, "quintic"), Move(at, slow, (way,) * 3, "ramp")]
    moves += [Move(at + slow, slow, (-way,) * 3, "ramp")]
    end = whole(at + 2.0 * slow + 0.56)
    # the peak speed of a quintic is 15/8 of its mean
    late = 15.0 / 8.0 * max(map(abs, by)) / move * LATE * SETPOINT_PERIOD
    limits = (
        Limit("greatest_error", late, f"what the fastest joint covers in {LATE:g} setpoint periods"),
        Limit("pose_accuracy", ACCURACY, "ten times the arm's specified repeatability"),
    )
    return Task(
        "effects",
        "A smooth move of all joints, a rest, and a slow reversal: what single effects are tried on.",
        start,
        end,
        _moves(start, moves),
        Aims(stops=(Stop(1, 1, REST + move, at), Stop(2, 1, at + 2.0 * slow, end))),
        limits,
    )
