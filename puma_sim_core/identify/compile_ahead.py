# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Compile what `explain` runs, ahead of its first use.

`python -m puma_sim_core.identify.compile_ahead` takes the better part of a minute; what it makes is kept
on the disk, for this user and these sources.
"""

import sys

import numpy as np

from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.effects.base import Stage
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.screening.known_effects import known_voltage
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.tracking import innovations


def _models() -> list[tuple[str, ...]]:
    """Effects of a model for each part of the kernel: none, dry friction, two masses."""
    dry = next(kind.example for kind in KINDS.values() if kind.stage == Stage.DRY)
    soft = next(kind.example for kind in KINDS.values() if kind.two_masses)
    return [(), (dry,), (soft,)]


def main() -> int:
    """Run each compiled part on a second of a slow motion."""
    mechanism = load_mechanism()
    time = np.arange(0.0, 3.0, 0.01)
    position = 0.1 * np.sin(np.outer(time, (3.0, 4.0, 5.0)))
    voltage = np.zeros_like(position)
    theta = mechanism.start
    signals = Problem(sample([Log("made", time, voltage, position)]), mechanism).signals(theta)
    for texts in _models():
        plant = mechanism.plant(theta, [parse_effect(text) for text in texts])
        rows = slice(0, 4)
        innovations(Simulator(plant), time[rows], voltage[rows], position[rows], np.zeros((3, 3)))
        Simulator(plant).run(time[rows], voltage[rows])
        if texts:
            known_voltage(mechanism.of_plant(plant), theta, signals)
    return 0


if __name__ == "__main__":
    sys.exit(main())
