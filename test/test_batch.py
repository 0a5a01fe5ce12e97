# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Batches: the same runs as one by one, whatever the grouping and the number of workers."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from puma_sim_core.dynamics.lanes.registers import LANES, polynomial_sin_cos
from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.batch import InitialState, run_batch
from puma_sim_core.simulation.simulator import Simulator

pytestmark = pytest.mark.long
TIME = np.arange(0.0, 0.5, 0.028)


def volts(seed: int, runs: int | None = None) -> np.ndarray:
    shape = (len(TIME), 3) if runs is None else (runs, len(TIME), 3)
    return np.random.default_rng(seed).uniform(-40.0, 40.0, shape)


def starts(seed: int, runs: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (runs, 3))


def alone(plant, voltage, position):
    simulator = Simulator(plant)
    simulator.reset(position)
    return simulator.run(TIME, voltage)


def mixed_plants(runs: int) -> list[Plant]:
    """Plants of several sets; every third with effects, of which some need stages of their own."""
    effects = [
        ("coulomb_friction:joint=2,torque=8",),
        ("voltage_saturation:joint=1,voltage=15",),
        ("presliding_friction:joint=3,torque=4", "payload:mass=2"),
    ]
    plants = [Plant.of("paul" if r % 2 else "bejczy") for r in range(runs)]
    return [
        replace(plant, effects=tuple(map(parse_effect, effects[r // 3 % 3]))) if r % 3 == 0 else plant
        for r, plant in enumerate(plants)
    ]


@pytest.mark.parametrize("runs", [1, 2, LANES, LANES + 1, 3 * LANES - 1])
def test_each_run_is_the_one_that_the_simulator_gives(runs):
    plants, voltage, position = mixed_plants(runs), volts(1, runs), starts(2, runs)
    batch = run_batch(plants, TIME, voltage, start=InitialState(position))
    for r in range(runs):
        single = alone(plants[r], voltage[r], position[r])
        for name in ("position", "velocity", "current"):
            np.testing.assert_allclose(getattr(batch, name)[r], getattr(single, name), rtol=0, atol=1e-11)
    assert batch.finite.all()


def test_without_lanes_the_bits_are_the_simulators():
    plants, voltage, position = mixed_plants(7), volts(3, 7), starts(4, 7)
    batch = run_batch(plants, TIME, voltage, start=InitialState(position), lanes=False)
    for r in range(7):
        single = alone(plants[r], voltage[r], position[r])
        assert np.array_equal(batch.position[r], single.position)
        assert np.array_equal(batch.velocity[r], single.velocity)
        assert np.array_equal(batch.current[r], single.current)


def test_the_bits_depend_neither_on_workers_nor_on_neighbours():
    plants, voltage, position = mixed_plants(19), volts(5, 19), starts(6, 19)
    reference = run_batch(plants, TIME, voltage, start=InitialState(position), workers=1)
    for workers in (2, 3):
        again = run_batch(plants, TIME, voltage, start=InitialState(position), workers=workers)
        assert np.array_equal(again.position, reference.position)
    order = np.random.default_rng(0).permutation(19)
    mixed = run_batch([plants[r] for r in order], TIME, voltage[order], start=InitialState(position[order]))
    assert np.array_equal(mixed.current, reference.current[order])


def test_what_is_given_once_serves_all_runs():
    position = starts(7, 9)
    plant, voltage = Plant.of(), volts(8)
    once = run_batch(plant, TIME, voltage, start=InitialState(position))
    each = run_batch([plant] * 9, TIME, np.stack([voltage] * 9), start=InitialState(position, np.zeros((9, 3))))
    assert np.array_equal(once.position, each.position)


def test_a_run_that_blows_up_spoils_no_other():
    # an absurd back-EMF makes the electrical circuit faster than the step
    plant = Plant.of()
    motors = tuple(replace(m, back_emf=1e9, inductance=1e-9) for m in plant.arm.motors)
    wild = replace(plant, arm=replace(plant.arm, motors=motors))
    plants = [plant, wild] + [plant] * 7
    voltage = volts(9)
    for lanes in (True, False):
        batch = run_batch(plants, TIME, voltage, start=InitialState((0.0, -1.0, 1.0)), lanes=lanes)
        assert batch.finite.tolist() == [True, False] + [True] * 7
        assert np.isnan(batch.position[1, -1]).all()
        assert np.array_equal(batch.position[0, 0], (0.0, -1.0, 1.0))
        assert np.array_equal(batch.position[0], batch.position[5])
        first_bad = np.argmax(np.isnan(batch.position[1]).any(axis=1))
        assert np.isnan(batch.position[1, first_bad:]).all()


def test_progress_reaches_the_end():
    seen = []
    run_batch(
        Plant.of(), TIME, volts(1), InitialState(starts(1, 20)), progress=lambda done, total: seen.append((done, total))
    )
    assert seen[-1] == (20, 20) and seen == sorted(seen)


@pytest.mark.parametrize(
    "change, named",
    [
        ({"voltage": np.zeros((4, len(TIME), 3))}, "the same number of runs"),
        ({"start": InitialState(np.zeros((5, 2)))}, "the same number of runs"),
        ({"voltage": np.full((len(TIME), 3), np.nan)}, "not finite"),
        ({"voltage": np.zeros((2, 3))}, "shape"),
        ({"time": TIME[::-1]}, "increas"),
        ({"max_step": 0.009}, "8 ms"),
    ],
)
def test_bad_input_is_named(change, named):
    arguments = {"time": TIME, "voltage": volts(1), "start": InitialState(starts(1, 3))} | change
    time, voltage = arguments.pop("time"), arguments.pop("voltage")
    with pytest.raises(ParameterError, match=named):
        run_batch([Plant.of()] * 3, time, voltage, **arguments)


@settings(max_examples=300)
@given(st.floats(-1e5, 1e5))
def test_sine_and_cosine_of_the_lanes_are_within_an_ulp(x):
    s, c = polynomial_sin_cos(x)
    assert abs(s - math.sin(x)) <= 2.3e-16 and abs(c - math.cos(x)) <= 2.3e-16


@pytest.mark.skipif(BACKEND != "numba", reason="this process has no compiled kernel to leave out")
def test_batches_run_on_processes_without_numba(tmp_path):
    code = (
        "import numpy as np\n"
        "from puma_sim_core.simulation.batch import InitialState, run_batch\n"
        "from puma_sim_core.plant.plant import Plant\n"
        "t = np.arange(0.0, 0.2, 0.028)\n"
        "v = np.random.default_rng(1).uniform(-40, 40, (len(t), 3))\n"
        "if __name__ == '__main__':\n"
        "    b = run_batch(Plant.of(), t, v, start=InitialState(np.eye(3)), lanes=False, workers=2)\n"
        "    print(b.position.tobytes().hex())\n"
    )
    script = tmp_path / "batch.py"
    script.write_text(code)
    root = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    said = [
        subprocess.run(
            [sys.executable, str(script)],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "PUMA_SIM_KERNEL": kernel, "PYTHONPATH": root},
        ).stdout
        for kernel in ("numba", "python")
    ]
    assert said[0] and said[0] == said[1]
