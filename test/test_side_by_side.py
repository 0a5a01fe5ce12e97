# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Models that follow a measured motion side by side: as each alone, with the same bits on both kernels."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from puma_sim_core.dynamics.lanes.registers import LANES
from puma_sim_core.effects import Effect, parse_effect
from puma_sim_core.executors import one_thread_of_algebra
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.fitting.point import Point, size_of, with_value
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.settings import FITTING
from puma_sim_core.jit import BACKEND
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.side_by_side import goes_side_by_side, innovations_side_by_side
from puma_sim_core.simulation.simulator import Simulator
from puma_sim_core.simulation.tracking import innovations

ROOT = Path(__file__).resolve().parent.parent
ARM = load_mechanism()
TIME = np.arange(0.0, 0.3, 1.5e-3)
VOLTS = 6.0 * np.sin(TIME[:, None] * [4.0, 5.0, 7.0] + [0.3, 2.0, 0.1])
GAIN = np.array([[0.3, 12.0, 0.4], [0.2, 9.0, 0.1], [0.4, 15.0, 0.2]])


def measured() -> np.ndarray:
    """Positions (n, 3) of an arm that none of the models is."""
    simulator = Simulator(ARM.plant(ARM.start * 1.02))
    simulator.reset((0.1, -0.9, 1.1))
    return simulator.run(TIME, VOLTS).position


def effects(*texts: str) -> tuple[Effect, ...]:
    """Effects of texts."""
    return tuple(parse_effect(text) for text in texts)


#: effects on the voltages: a dead band, and a limit that is met
ON_VOLTAGE = effects("voltage_dead_band:joint=1,voltage=0.5", "voltage_saturation:joint=2,voltage=4")
#: joints that slide, reverse and stick in the motion, and a current that meets its limit
SLIDING = effects("coulomb_friction:joint=2,torque=6", "asymmetric_coulomb_friction:joint=3,positive=3,negative=1")
STICKING = effects("coulomb_friction:joint=1,torque=40", "coulomb_friction:joint=3,torque=4")
LIMITED = effects(
    "current_limit:joint=2,current=1.5", "coulomb_friction:joint=1,torque=5", "voltage_offset:joint=3,voltage=0.3"
)
#: voltages that arrive within a row, late by one and a half
LATE = [(*effects("input_delay:time=0.00225"), *own) for own in (ON_VOLTAGE, STICKING, LIMITED)]
ALL = [(), ON_VOLTAGE, SLIDING, STICKING, LIMITED, *LATE]
#: what depends on more than the direction of motion: compiled lanes have it, arrays do not
LANE_BY_LANE = [
    effects("stribeck_friction:joint=2,torque=3,sliding=4", "joint_spring:joint=3,stiffness=6"),
    effects("load_dependent_friction:joint=2,coefficient=0.1", "quadratic_friction:joint=1,coefficient=5"),
    effects("position_dependent_friction:joint=3,torque=2,amplitude=1", "base_tilt:x=0.05,y=0.02"),
    effects("impulse:joint=2,torque=40,time=0.1,width=0.05", "coulomb_friction:joint=1,torque=40"),
    effects(
        "friction_warm_up:joint=1,share=0.4,time_constant=0.2", "resistance_drift:joint=2,share=0.3,time_constant=1"
    ),
    effects("soft_stop:joint=3,lower=-0.5,upper=0.5", "current_limit:joint=2,current=1.5"),
    effects("input_delay:time=0.00225", "stribeck_friction:joint=2,torque=3,sliding=4"),
]
COMPILED = BACKEND == "numba"


def started(count: int, effects: tuple[Effect, ...] = ()) -> list[Simulator]:
    """Simulators of as many different arms."""
    found = []
    for n in range(count):
        found.append(Simulator(ARM.plant(ARM.start * (1.0 + 0.003 * n), effects)))
        found[-1].reset((0.1, -0.9 - 0.01 * n, 1.1), (0.0, 0.1, 0.0), (0.2, 0.0, -0.1))
    return found


#: a joint without inductance in its motor: effects that lanes have
PENDULUM = load_mechanism("pendulum")
OF_ONE_JOINT = [
    (),
    effects("coulomb_friction:joint=1,torque=0.03"),
    effects("coulomb_friction:joint=1,torque=0.2", "voltage_offset:joint=1,voltage=0.2"),
    effects("current_limit:joint=1,current=0.3", "coulomb_friction:joint=1,torque=0.03"),
]
OF_ONE_JOINT_BY_LANE = [
    effects("stribeck_friction:joint=1,torque=0.03,sliding=0.02", "resistance_drift:joint=1,share=0.3,time_constant=1"),
    effects(
        "position_dependent_friction:joint=1,torque=0.02,amplitude=0.01",
        "impulse:joint=1,torque=0.3,time=0.4,width=0.1",
    ),
]


def swing() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), voltages and positions (n, 1) of a pendulum."""
    time = np.arange(0.0, 1.5, 2e-3)
    volts = 5.0 * np.sin(7.0 * time[:, None]) + 3.0 * np.sign(np.sin(3.0 * time[:, None]))
    simulator = Simulator(PENDULUM.plant(PENDULUM.start * 1.02))
    simulator.reset((0.3,))
    return time, volts, simulator.run(time, volts).position


def pendulums(count: int, own: tuple[Effect, ...]) -> list[Simulator]:
    """Simulators of as many different pendulums."""
    found = [Simulator(PENDULUM.plant(PENDULUM.start * (1.0 + 0.003 * n), own)) for n in range(count)]
    for simulator in found:
        simulator.reset((0.3,), (0.1,))
    return found


@pytest.mark.parametrize("own", OF_ONE_JOINT + OF_ONE_JOINT_BY_LANE * COMPILED)
def test_machines_of_one_joint_without_inductance_go_side_by_side_as_well(own):
    time, volts, positions = swing()
    gain = GAIN[:1]
    found = innovations_side_by_side(pendulums(5, own), time, volts, positions, gain)
    for simulator, one in zip(pendulums(5, own), found):
        assert goes_side_by_side(simulator.plant, simulator.plant)
        alone = innovations(simulator, time, volts, positions, gain).innovation
        assert one.shape == alone.shape == (len(time) - 1, 1) and np.abs(alone).max() > 1e-5
        np.testing.assert_allclose(one, alone, rtol=0.0, atol=1e-13)


def digest() -> str:
    """Of the innovations of five models side by side."""
    found = [innovations_side_by_side(started(5, own), TIME, VOLTS, measured(), GAIN, [2] * 5) for own in ALL]
    swinging = [innovations_side_by_side(pendulums(5, own), *swing(), GAIN[:1]) for own in OF_ONE_JOINT]
    return hashlib.sha256(np.array(found).tobytes() + np.array(swinging).tobytes()).hexdigest()


@pytest.mark.parametrize("parts", [1, 4])
@pytest.mark.parametrize("own", ALL + LANE_BY_LANE * COMPILED)
@pytest.mark.parametrize("count", [1, 3, LANES])
def test_each_model_has_the_innovations_that_it_has_alone(count, own, parts):
    positions = measured()
    side_by_side = innovations_side_by_side(started(count, own), TIME, VOLTS, positions, GAIN, [parts] * count)
    assert len(side_by_side) == count
    for simulator, found in zip(started(count, own), side_by_side):
        alone = innovations(simulator, TIME, VOLTS, positions, GAIN, parts=parts).innovation
        assert np.abs(alone).max() > 1e-5
        np.testing.assert_allclose(found, alone, rtol=0.0, atol=1e-14)


def test_what_is_tried_side_by_side_reverses_sticks_and_meets_its_limit():
    positions = measured()

    def followed(own: tuple[Effect, ...]) -> tuple[np.ndarray, np.ndarray]:
        found = innovations(started(1, own)[0], TIME, VOLTS, positions, GAIN)
        return found.velocity, found.innovation

    velocity, _ = followed(SLIDING)
    assert (np.abs(np.diff(np.sign(velocity[:, 1:]), axis=0)) == 2.0).any()
    velocity, _ = followed(STICKING)
    assert 3 < np.count_nonzero(velocity[:, 0] == 0.0) < len(velocity) - 3
    limited, free = followed(LIMITED)[1], followed(LIMITED[1:])[1]
    assert 0 < np.argmax(np.abs(limited - free).max(axis=1) > 1e-9) < len(free) - 10


@pytest.mark.parametrize(("joint", "level"), [(1, 40.0), (3, 4.0)])
def test_models_side_by_side_may_differ_in_all_values_of_their_effects(joint, level):
    positions, simulators = measured(), [list[Simulator](), list[Simulator]()]
    for n in range(5):
        texts = (
            f"voltage_dead_band:joint=1,voltage={0.1 + 0.2 * n}",
            f"coulomb_friction:joint={joint},torque={level * n}",
        )
        for group in simulators:
            group.append(Simulator(ARM.plant(ARM.start, effects(*texts))))
            group[-1].reset((0.1, -0.9, 1.1), (0.0, 0.1, 0.0))
    found = innovations_side_by_side(simulators[0][1:], TIME, VOLTS, positions, GAIN)
    for simulator, own in zip(simulators[1][1:], found):
        alone = innovations(simulator, TIME, VOLTS, positions, GAIN).innovation
        np.testing.assert_allclose(own, alone, rtol=0.0, atol=1e-14)
    assert np.abs(found[0] - found[3]).max() > 1e-6


def test_both_kernels_give_the_same_bits():
    run = "import sys; sys.path.insert(0, 'test'); from test_side_by_side import digest; print(digest())"
    found = {
        subprocess.check_output(
            [sys.executable, "-c", run],
            cwd=ROOT,
            text=True,
            env={**os.environ, "PUMA_SIM_KERNEL": kernel, "PYTHONPATH": str(ROOT)},
        )
        for kernel in ("auto", "python")
    }
    assert len(found) == 1


@pytest.mark.parametrize(
    ("text", "goes"),
    [
        ("payload:mass=1", True),
        ("coulomb_friction:joint=2,torque=3", True),
        ("current_limit:joint=2,current=3", True),
        ("voltage_dead_band:joint=1,voltage=0.5", True),
        ("input_delay:time=0.002", True),
        ("stribeck_friction:joint=2,torque=3,sliding=2", COMPILED),
        ("presliding_friction:joint=1,torque=8", False),
        ("joint_elasticity:joint=2,stiffness=20000", False),
    ],
)
def test_only_models_whose_stages_lanes_have_go_side_by_side(text, goes):
    first, other = (ARM.plant(ARM.start * share, effects(text)) for share in (1.0, 1.01))
    assert goes_side_by_side(first, first) is goes_side_by_side(other, first) is goes


def test_models_side_by_side_have_the_same_stages():
    first, other = (ARM.plant(ARM.start, own) for own in (SLIDING, ON_VOLTAGE))
    assert goes_side_by_side(first, first) and goes_side_by_side(other, other)
    assert not goes_side_by_side(other, first)


def test_models_side_by_side_have_the_same_delay():
    first, same, other = (ARM.plant(ARM.start, effects(f"input_delay:time={t}")) for t in (0.002, 0.002, 0.003))
    assert goes_side_by_side(same, first) and not goes_side_by_side(other, first)


def test_a_model_that_does_not_stay_finite_leaves_the_others_as_they_are():
    positions, wild = measured(), started(3)
    wild[1].reset((0.1, -0.9, 1.1), (1e200, 1e200, 1e200))
    found = innovations_side_by_side(wild, TIME, VOLTS, positions, GAIN)
    alone = innovations_side_by_side(started(3), TIME, VOLTS, positions, GAIN)
    assert not np.isfinite(found[1]).all()
    np.testing.assert_array_equal(found[0], alone[0])
    np.testing.assert_array_equal(found[2], alone[2])


@pytest.mark.parametrize("logs", [1, 2])
@pytest.mark.parametrize(
    ("own", "pairs"), [((), ()), (SLIDING, ((0, "torque"), (1, "positive"))), (ON_VOLTAGE, ((0, "voltage"),))]
)
def test_derivatives_side_by_side_are_differences_of_runs_alone(logs, own, pairs):
    given = [Log(f"log {n}", TIME + n, VOLTS, measured()) for n in range(logs)]
    predictor = Predictor(given, ARM, [lambda t: t > 1e9] * logs, np.full(3, 0.05), np.full(3, 3e-5))
    point = Point(ARM.start * 1.01, own)
    raw = predictor.errors(point.plant(ARM))
    found = PredictionFit(predictor, predictor.unfiltered_weighting(raw)).derivatives(point, pairs)
    assert found.shape == (*raw.shape, len(ARM.start) + len(pairs))

    def is_difference(column: int, to: Point, share: float) -> None:
        alone = (predictor.errors(to.plant(ARM)) - raw) / share
        assert np.abs(alone).max() > 0.0
        np.testing.assert_allclose(found[:, :, column], alone, rtol=0.0, atol=1e-6 * np.abs(alone).max() + 1e-13)

    for number in (0, 7, len(ARM.start) - 1):
        theta = point.theta.copy()
        theta[number] += FITTING.difference * ARM.deviations[number]
        is_difference(number, Point(theta, own), FITTING.difference)
    for column, (number, name) in enumerate(pairs, start=len(ARM.start)):
        share = FITTING.effect_difference
        value = own[number].values[name] + share * size_of(own[number], name)
        moved = with_value(own, number, name, value)
        assert moved is not None
        is_difference(column, Point(point.theta, moved), share)


def test_linear_algebra_keeps_to_one_thread_and_gets_its_own_back():
    def threads() -> list[int]:
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with one_thread_of_algebra():
            assert set(threads()) == {1}
        assert threads() == before
