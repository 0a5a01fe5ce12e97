# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Compile the kernel ahead of its first use, part by part.

`python -m puma_sim_core.identify.compile_ahead` takes a minute or two, with names of parts only these; what it makes is
kept on the disk, for this user and these sources. What is there already is left alone, and of several of these
processes one works while the others wait, and none for one that takes what others leave; with ``--locked`` the one that
started it holds their lock for it.
"""

import sys

import numpy as np

from puma_sim_core import jit
from puma_sim_core.compiling import lock_in_turn
from puma_sim_core.control.sample_laws import compile_laws
from puma_sim_core.dynamics.samples import flat
from puma_sim_core.effects import KINDS, parse_effect
from puma_sim_core.effects.base import VOLTAGE, Stage
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.residuals.shape import play
from puma_sim_core.identify.screening.hypotheses import candidates, hypotheses
from puma_sim_core.identify.screening.known_effects import known_voltage
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.session import Session
from puma_sim_core.simulation.session_config import COMMAND_INTERFACES, SessionConfig
from puma_sim_core.simulation.side_by_side import innovations_side_by_side
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.tracking import innovations
from puma_sim_core.simulation.windows import driven_current

#: an effect with dry friction, one of two masses, and one of the voltages
_DRY = next(kind.example for kind in KINDS.values() if kind.stage == Stage.DRY)
_SOFT = next(kind.example for kind in KINDS.values() if kind.two_masses)
_AMPLIFIED = next(kind.example for kind in KINDS.values() if kind.acts == VOLTAGE)


def _simulated(plant: Plant) -> None:
    """What sessions and simulations run of a plant."""
    for interface in COMMAND_INTERFACES:
        Session(SessionConfig(plant, interface)).step()
    simulator, time = Simulator(plant), np.array([0.0, 0.001, 0.002])
    simulator.run(time, np.zeros((3, 3)), acceleration=True)
    simulator.run_servo(np.zeros((1, 3)))


def _sampled() -> None:
    """What trials of `appraise` run beside that: single samples, of the plant and of controllers."""
    for effects in ((), (parse_effect(_SOFT),)):
        kernel = flat(Plant.of(effects=effects).constants)
        rows = np.zeros((2, kernel.width))
        kernel.hold(kernel.model, kernel.table, rows, (0, 1), (0.0, 0.0, 0.0), 0.0, 1, 0.001)
    compile_laws()


def _identified() -> None:
    """What `explain` runs beside that, on a second of a slow motion."""
    mechanism = load_mechanism()
    time = np.arange(0.0, 3.0, 0.01)
    position = 0.1 * np.sin(np.outer(time, (3.0, 4.0, 5.0)))
    voltage = np.zeros_like(position)
    theta = mechanism.start
    signals = Problem(sample([Log("made", time, voltage, position)]), mechanism).signals(theta)
    for texts in ((), (_DRY,), (_SOFT,)):
        plant = mechanism.plant(theta, [parse_effect(text) for text in texts])
        rows = slice(0, 4)
        followed = time[rows], voltage[rows], position[rows], np.zeros((3, 3))
        innovations(Simulator(plant), *followed)
        if texts:
            known_voltage(mechanism.of_plant(plant), theta, signals)
        else:
            innovations_side_by_side([Simulator(plant)], *followed)
    for kind, joint in hypotheses((kind for kind in KINDS.values() if kind.screening), mechanism):
        candidates(kind, joint, signals)
    play(time, np.zeros(len(time), dtype=int), 1.0)
    amplified = mechanism.plant(theta, [parse_effect(_AMPLIFIED)])
    driven_current(amplified, time, voltage, 0, position[0], position[0])


#: part -> what to run of it
_PARTS = {
    "arm": lambda: _simulated(Plant.of()),
    "trains": lambda: _simulated(Plant.of(effects=[parse_effect(_SOFT)])),
    "identification": _identified,
    "trials": _sampled,
}


def main() -> int:
    """Run each part that is named, or all, and not in the cache."""
    if jit.compiled_mark("lock") is None:
        return 0
    with open(str(jit.compiled_mark("lock")), "a") as lock:
        if "--locked" not in sys.argv:
            lock_in_turn(lock, waits=True)
        for part in [name for name in _PARTS if name in sys.argv] or _PARTS:
            mark = jit.compiled_mark(part)
            if mark is not None and not mark.exists():
                _PARTS[part]()
                mark.touch()
    return 0


if __name__ == "__main__":
    sys.exit(main())
