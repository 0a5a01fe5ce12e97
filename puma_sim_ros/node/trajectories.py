# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Trajectories for a node that takes setpoints: one at a time, a setpoint in each step."""

from collections.abc import Sequence

from trajectory_msgs.msg import JointTrajectory

from puma_sim_core.control.trajectory import Follower, Waypoint, trajectory_setpoints
from puma_sim_core.errors import CommandError
from puma_sim_core.simulation.session_config import SessionConfig
from puma_sim_ros.messages import stamp_ns

TOPIC = "joint_trajectory_controller/joint_trajectory"


class Following:
    """The trajectory that is followed now, if there is one; after its last point that point is held."""

    def __init__(self) -> None:
        self._rows: list[list[float]] = []

    @property
    def active(self) -> bool:
        """Whether there is one."""
        return bool(self._rows)

    def start(self, message: JointTrajectory, config: SessionConfig, setpoint: Sequence[float]) -> None:
        """Follow a trajectory from now on, in place of the former one; one without points holds the present setpoint.

        Raises CommandError where it cannot be followed: the former one goes on then.
        """
        if stamp_ns(message.header.stamp):
            stamp = f"header.stamp {stamp_ns(message.header.stamp) * 1e-9:g} s"
            raise CommandError(stamp, where="trajectory", expected="0: it begins when it comes")
        points = [
            Waypoint(stamp_ns(p.time_from_start) * 1e-9, list(p.positions), list(p.velocities), list(p.accelerations))
            for p in message.points
        ]
        rows = [list(setpoint)]
        if points:
            follower = Follower(config.plant, config.joint_names, config.period, config.voltage_limit)
            rows = trajectory_setpoints(follower, list(message.joint_names), points, setpoint).tolist()
        # taken from the end
        self._rows = rows[::-1]

    def next(self) -> list[float]:
        """The setpoint of the next step [rad]."""
        return self._rows.pop() if len(self._rows) > 1 else self._rows[0]

    def stop(self) -> None:
        """Follow it no longer."""
        self._rows = []
