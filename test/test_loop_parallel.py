# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Runs side by side give the same bits as one after the other."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from puma_sim_core.effects import parse_effect
from puma_sim_core.executors import THREADS
from puma_sim_core.identify import parallel
from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.fitting.point import Point
from puma_sim_core.identify.fitting.prediction import PredictionFit
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator


@pytest.mark.parametrize("cores", [1, 2, 5])
def test_results_keep_the_order_of_the_items(monkeypatch, cores):
    monkeypatch.setenv(THREADS, str(cores))
    barrier = threading.Barrier(cores)

    def square(k):
        if k < cores:
            barrier.wait(timeout=10.0)  # as many at a time as there are cores
        return k * k

    assert parallel.parallel_map(square, iter(range(17))) == [k * k for k in range(17)]
    assert parallel.parallel_map(square, ()) == []


@pytest.mark.parametrize("cores", [1, 3])
def test_the_first_error_is_raised(monkeypatch, cores):
    monkeypatch.setenv(THREADS, str(cores))
    with pytest.raises(KeyError, match="2"):
        parallel.parallel_map({0: 0, 1: 1}.__getitem__, (0, 1, 2, 3))


def test_derivatives_have_the_same_bits_on_any_number_of_cores(monkeypatch):
    arm = load_mechanism()
    effect = parse_effect("presliding_friction:joint=2,torque=8,stiffness=2e4")
    plant = arm.plant(arm.start, (effect,))
    time = np.arange(0.0, 1.0, 2e-3)
    volts = 5.0 * np.sin(time[:, None] * [4.0, 5.0, 7.0])
    simulator = Simulator(plant)
    simulator.reset((0.1, -0.9, 1.1))
    log = Log("own", time, volts, simulator.run(time, volts).position)
    found = []
    for cores in (1, 4):
        monkeypatch.setenv(THREADS, str(cores))
        predictor = Predictor([log], arm, [lambda t: t > 1e9], np.full(3, 0.05), np.full(3, 3e-5))
        fit = PredictionFit(predictor, predictor.unfiltered_weighting(predictor.errors(plant)))
        found.append(fit.derivatives(Point(arm.start * 1.01, plant.effects[-1:]), [(0, "torque"), (0, "stiffness")]))
    assert np.abs(found[0]).max() > 0.0
    np.testing.assert_array_equal(*found)
