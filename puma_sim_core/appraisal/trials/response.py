# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What one trial of a controller left behind, and what it is judged by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import NamedTuple

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.kinematics import wrist_motion, wrist_path
from puma_sim_core.checks import check_choice, check_positive, check_shapes
from puma_sim_core.errors import ParameterError

#: how a trial can end. All but "completed" are failures, and every measure of one has its worst value.
ENDS = (
    "completed",
    "diverged",  # the state stopped being finite, or left what the arm can reach
    "limit",  # a joint left its range, or exceeded its greatest velocity
    "not_finite",  # the controller gave a voltage that is not a finite number
    "refused",  # the controller gave something else than three numbers, or raised an error
    "late",  # no answer in the time that the protocol allows
    "died",  # the process of the controller ended
)
_WHERE = "response"


@dataclass(frozen=True)
class Response:
    """One trial, a row each servo sample of the plant's host (28/30 ms), whatever the controller's own period is.

    Arrays are (n, 3), joint by joint. Measures interpolate between rows: positions by the cubic that has the positions
    and velocities of both ends, so that 28 ms between rows are usable too. Trials that are compared need equal rows.

    time : (n,) [s], increasing.
    reference : what the task wants [rad], by a straight line between rows but where a step of the task stands.
    position : of the links as they truly are [rad], not what sensors give; velocity : theirs [rad/s].
    voltage : asked for by the controller [V], held from a row to the next, the last by nobody.
    applied : at the motors, behind limit, delay and amplifier [V], held like voltage.
    current : of the motors [A].
    voltage_limit : [V], inf for none.
    arm : whose wrist moves; None: no measure at the wrist.
    end : one of `ENDS`; why : the reason in words, empty for a trial that was completed.

    A trial that ended early has the rows up to its last finite state, one at least.

    Raises ParameterError: shapes, numbers that are not finite, times that do not increase, an unknown end.
    """

    time: np.ndarray
    reference: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    voltage: np.ndarray
    applied: np.ndarray
    current: np.ndarray
    voltage_limit: float = inf
    arm: ArmParameters | None = None
    end: str = "completed"
    why: str = ""

    def __post_init__(self) -> None:
        check_choice(self.end, "end", ENDS, _WHERE)
        (time,) = check_shapes("(n,)", _WHERE, time=self.time)
        if not len(time) or not (np.diff(time) > 0.0).all():
            raise ParameterError(f"{len(time)} times", where=_WHERE, expected="one at least, increasing")
        names = ("reference", "position", "velocity", "voltage", "applied", "current")
        arrays = check_shapes("(n, 3)", _WHERE, **{name: getattr(self, name) for name in names})
        if len(arrays[0]) != len(time):
            raise ParameterError(f"{len(arrays[0])} rows at {len(time)} times", where=_WHERE, expected="as many")
        for name, values in zip(("time", *names), (time, *arrays)):
            object.__setattr__(self, name, values)
        check_positive(self.voltage_limit, "voltage_limit", "V", _WHERE, infinite=True)

    @property
    def failed(self) -> bool:
        """Whether the trial ended before its time."""
        return self.end != "completed"

    @cached_property
    def wrist(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Path [m] and velocity [m/s] of the wrist in the base frame, (n, 3) each; None without an arm."""
        return None if self.arm is None else wrist_motion(self.position, self.velocity, self.arm)

    @cached_property
    def commanded_wrist(self) -> np.ndarray | None:
        """(n, 3) path that the reference asks of the wrist [m]; None without an arm."""
        return None if self.arm is None else wrist_path(self.reference, self.arm)


class Step(NamedTuple):
    """A step of a joint's reference, judged from `at` to `until` (None: the end of the trial) [s].

    joint : 1 to 3; start, end : [rad], different; band : half-width of the settled band as a share of the step.
    """

    joint: int
    at: float
    start: float
    end: float
    until: float | None = None
    band: float = 0.02


class Stop(NamedTuple):
    """A pose at which the wrist is to stand still (ISO 9283 clause 7).

    pose, approach : numbers of the pose and of the direction that it is approached from; visits with the same numbers
    are the repetitions of one another, over all trials that are measured together.
    at, until : the time when the command arrives, and when it leaves again [s]; the commanded pose is the reference's
    wrist position at `until`. band : radius of the limit band about the attained pose [m].
    """

    pose: int
    approach: int
    at: float
    until: float
    band: float = 1e-3


class Path(NamedTuple):
    """A path of the wrist, with a constant speed where speeds are judged (ISO 9283 clause 8).

    start, until : of what is judged [s]; speed : commanded along the path [m/s].
    path : its number; passes with the same one are the repetitions of one another, over all trials measured together.
    corner : when the command is at a corner of two straight lines [s], None without one.
    """

    path: int
    start: float
    until: float
    speed: float
    corner: float | None = None


@dataclass(frozen=True)
class Aims:
    """What a task's trial is judged by, beside tracking and effort, which are judged always."""

    steps: Sequence[Step] = ()
    stops: Sequence[Stop] = ()
    paths: Sequence[Path] = ()
