# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A controller that moves all joints so that a record of it shows what the model lacks.

It works like `external_controller`, by topics in volts: those of `exciting_motion`, and a
proportional part that holds the arm to the setpoints.
"""

from __future__ import annotations

import sys

import numpy as np
from exciting_motion import expected_volts

from puma_sim_ros.external_controller import ControllerError, ExternalController, run_to_its_end

PARAMETERS = {
    "simulator": "sim_node",  # its name
    "parameter_set": "bejczy",  # the arm that the volts are computed for
    "duration": 20.0,  # of the motion [s]
    "seed": 1,  # of the motion and the dither
    "gain": [150.0, 260.0, 135.0],  # V per rad off the setpoint
    "timeout": 30.0,  # longest wait for an answer of the simulator [s]
}


class ExcitingController(ExternalController):
    """The node ``exciting_controller``; `done` when the motion is over."""

    def __init__(self) -> None:
        super().__init__("exciting_controller", PARAMETERS)
        self.start = None
        if not 1.0 <= self.p["duration"] <= 600.0:
            raise ControllerError(f"{self.p['duration']:g} s", where="parameter 'duration'", expected="1 to 600 s")
        if len(self.p["gain"]) != 3:
            raise ControllerError(f"gain {list(self.p['gain'])}", expected="three numbers, one for each joint")

    def controller_settings(self) -> dict:
        """None: there is no controller by a name."""
        return {}

    def make_controller(self, limit: float):
        """The volts (n, 3) that depend on nothing measured, for each period; with setpoints."""
        self.setpoints, volts = expected_volts(self.p["parameter_set"], self.p["duration"], self.period, self.p["seed"])
        return np.clip(volts, -limit, limit)

    def control(self, t: float, position: list[float]) -> tuple[float, ...] | None:
        """Volts for positions [rad] at simulated time t [s]; None when the motion is over."""
        if self.start is None:
            self.start = t
        place = round((t - self.start) / self.period)
        if place >= len(self.setpoints):
            self.done = True
            return None
        off = self.setpoints[place] - position
        return tuple((self.controller[place] + np.multiply(self.p["gain"], off)).tolist())


def finish(node: ExcitingController) -> None:
    """Say how many commands there were."""
    print(f"{len(node.setpoints)} commands, one every {1e3 * node.period:g} ms", flush=True)


if __name__ == "__main__":
    sys.exit(run_to_its_end("exciting_controller", ExcitingController, finish))
