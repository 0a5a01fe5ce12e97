# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Logs of known plants of any mechanism, and the pieces of the loop that are made of them."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from puma_sim_core.identify.data.log import Log
from puma_sim_core.identify.data.sampling import sample
from puma_sim_core.identify.fitting.predictor import Predictor
from puma_sim_core.identify.screening.problem import Problem
from puma_sim_core.identify.selection.validate import Validation
from puma_sim_core.simulation.simulator import Simulator

STEP, SECONDS = 2e-3, 10.0
START = [0.1, -0.9, 1.1]


def record(
    mechanism, plant, volts=0.0, noise=0.0, enable=None, seconds=SECONDS, unlogged=None, correlation=0.0, time=None
):
    """A log of a plant with noise of the voltage [V], white or with a correlation time [s], and white noise of the
    positions; unlogged: function of (time, state of the simulator) -> (J,) [V] more that the plant gets in an even log;
    time: that of the rows [s]."""
    J, rng = mechanism.joints, np.random.default_rng(3)
    time = np.arange(0.0, seconds, STEP) if time is None else time
    voltage = sum(a * np.sin(w * time[:, None] + w * np.arange(J)) for a, w in ((3.0, 2.1), (2.0, 5.3)))
    simulator = Simulator(plant, max_step=1e-3)
    simulator.reset(START[:J])
    kept = np.exp(-STEP / correlation) if correlation else 0.0
    given = voltage + lfilter(
        [volts * np.sqrt(1.0 - kept**2)], [1.0, -kept], rng.standard_normal(voltage.shape), axis=0
    )
    if unlogged is None:
        position = simulator.run(time, given, enable=enable).position
    else:
        position = np.empty_like(voltage)
        for k, t in enumerate(time):
            position[k] = np.take(simulator.state, plant.axes)
            simulator.step(given[k] + unlogged(t, simulator), STEP)
    on = None if enable is None else np.repeat(enable[:, None], J, axis=1)
    return Log("own", time, voltage, position + noise * rng.standard_normal(voltage.shape), enable=on)


def pieces(mechanism, log, volts=0.02, noise=1e-6, place=0.5):
    """(problem, function of a problem -> its validation set, predictor) of a log with such
    noise, blocks at a place of their period."""
    problem = Problem(sample([log]), mechanism, place=place)

    def rows(of):
        held = np.interp(log.time, of.sampled.time[of.kept], of.validation.astype(float))
        return [lambda t: np.interp(t, log.time, held) > 0.5]

    return (
        problem,
        rows,
        Predictor([log], mechanism, rows(problem), np.full(mechanism.joints, volts), np.full(mechanism.joints, noise)),
    )


def validation(mechanism, log, volts=0.02, noise=1e-6):
    """The windows of a log."""
    problem, _, predictor = pieces(mechanism, log, volts, noise)
    return Validation(problem, predictor)
