# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Paths of the wrist at a constant speed, as ISO 9283 asks for: straight lines with a corner, and circles."""

from dataclasses import dataclass
from math import pi

import numpy as np

from puma_sim_core.arm.arm import ArmParameters
from puma_sim_core.arm.inverse_kinematics import wrist_angles


@dataclass(frozen=True)
class Corner:
    """Two straight lines through three points (3,) [m]."""

    begin: tuple[float, ...]
    corner: tuple[float, ...]
    end: tuple[float, ...]

    @property
    def lengths(self) -> tuple[float, float]:
        """Of the two lines [m]."""
        a, b, c = map(np.array, (self.begin, self.corner, self.end))
        return float(np.linalg.norm(b - a)), float(np.linalg.norm(c - b))

    @property
    def length(self) -> float:
        """Of both together [m]."""
        return sum(self.lengths)

    def at(self, s: np.ndarray) -> np.ndarray:
        """(n, 3) points [m] at distances (n,) [m] from the beginning along the path."""
        a, b, c = map(np.array, (self.begin, self.corner, self.end))
        first, second = self.lengths
        before = a + np.clip(s / first, 0.0, 1.0)[:, None] * (b - a)
        return before + np.clip((s - first) / second, 0.0, 1.0)[:, None] * (c - b)


@dataclass(frozen=True)
class Circle:
    """A full circle in the vertical plane through the y axis that starts at a point (3,) [m]; its centre is `radius`
    [m] above."""

    begin: tuple[float, ...]
    radius: float

    @property
    def length(self) -> float:
        """Of its circumference [m]."""
        return 2.0 * pi * self.radius

    def at(self, s: np.ndarray) -> np.ndarray:
        """(n, 3) points [m] at distances (n,) [m] from the beginning along the path."""
        angle = s / self.radius
        turned = np.stack([np.zeros_like(angle), np.sin(angle), 1.0 - np.cos(angle)], axis=-1)
        return np.array(self.begin) + self.radius * turned


def angles_along(points: np.ndarray, arm: ArmParameters, near: np.ndarray) -> np.ndarray:
    """(n, 3) joint angles [rad] of a path of the wrist (n, 3) [m], beginning near a pose (3,)."""
    found = np.empty_like(points)
    for row, point in enumerate(points):
        near = found[row] = wrist_angles(point, arm, near)
    return found


def greatest_speed(path: Corner | Circle, arm: ArmParameters, near: np.ndarray, joint_speed: np.ndarray) -> float:
    """The speed [m/s] along a path at which the first joint reaches its greatest speed, (3,) [rad/s]."""
    s = np.linspace(0.0, path.length, 401)
    slope = np.abs(np.diff(angles_along(path.at(s), arm, near), axis=0)) / np.diff(s)[:, None]
    return float((joint_speed / slope.max(axis=0)).min())


@dataclass(frozen=True)
class Pass:
    """One pass of a path: at rest until `start` [s], a smooth run-up for `run_up` [s], the constant `speed` [m/s], and
    as long to stop."""

    path: Corner | Circle
    speed: float
    start: float
    run_up: float

    @property
    def constant(self) -> tuple[float, float]:
        """(from, to) where the speed is constant [s]."""
        begin = self.start + self.run_up
        return begin, begin + self.path.length / self.speed - self.run_up

    @property
    def end(self) -> float:
        """When it stands still again [s]."""
        return self.constant[1] + self.run_up

    def time_at(self, s: float) -> float:
        """When the command is `s` [m] along the path, within the constant speed [s]."""
        return self.start + s / self.speed + 0.5 * self.run_up

    def distance(self, time: np.ndarray) -> np.ndarray:
        """(n,) distance along the path [m] at times (n,) [s]."""
        begin, after = self.constant
        v, w = self.speed, self.run_up

        def ramp(tau: np.ndarray) -> np.ndarray:
            # the integral of setpoints.smooth_share over the first tau of its time
            tau = np.clip(tau, 0.0, 1.0)
            return tau**4 * (2.5 + tau * (tau - 3.0))

        up = v * w * ramp((time - self.start) / w)
        level = v * np.clip(time - begin, 0.0, after - begin)
        tau = np.clip((time - after) / w, 0.0, 1.0)
        return up + level + v * w * (tau - ramp(tau))
