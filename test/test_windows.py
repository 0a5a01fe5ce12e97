# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Open-loop windows of logs of any mechanism."""

from __future__ import annotations

import numpy as np
import pytest

from mechanism_support import NAMES, pendulum
from puma_sim_core.errors import ParameterError
from puma_sim_core.loop.windows import FAR_OFF, Windows, run_windows
from puma_sim_core.mechanisms import load_mechanism
from puma_sim_core.plant import Plant
from puma_sim_core.simulator import Simulator


def windows_of(plant, start, time, voltage, enable=None, **options):
    simulator = Simulator(plant, max_step=1e-3)
    simulator.reset(start)
    run = simulator.run(time, voltage, enable=enable)
    return run, Windows.of(time, voltage, run.position, enable, **options)


@pytest.mark.parametrize("name", NAMES)
def test_windows_of_the_true_plant_stay_on_the_log(name):
    mechanism = load_mechanism(name)
    J = mechanism.joints
    time = np.arange(0.0, 2.0, 1e-3)
    voltage = 3.0 * np.sin(5.0 * time[:, None] + np.arange(J))
    start = [0.1, -0.4, 0.8][:J]
    run, windows = windows_of(mechanism.plant(), start, time, voltage,
                              starts=np.arange(100, 1500, 400), length=0.4)
    result = run_windows(mechanism.plant(), windows)
    assert [len(p) for p in result.predicted] == [401] * 4
    # what local slopes and quasi-static currents leave of an error
    assert (result.rms < 3e-4).all()
    wrong = run_windows(mechanism.plant(mechanism.start * 1.1), windows)
    assert (wrong.rms > 10.0 * result.rms).all()
    exact = Windows.of(time, voltage, run.position, starts=[100], length=0.4,
                       motion=(run.position[[100]], run.velocity[[100]],
                               np.zeros((1, J))))
    assert (run_windows(mechanism.plant(), exact).rms < 3e-4).all()


def test_windows_know_when_the_drive_is_off():
    plant = pendulum()
    time = np.arange(0.0, 2.0, 0.005)
    voltage = np.full((len(time), 1), 2.0)
    enable = (time < 0.8).astype(float)
    run, windows = windows_of(plant, [0.0], time, voltage, enable, starts=[0, 100, 200, 300],
                              length=0.4)
    assert (run_windows(plant, windows).rms < 2e-3).all()
    blind = Windows.of(time, voltage, run.position, starts=[0, 100, 200, 300], length=0.4)
    assert (run_windows(plant, blind).rms > 0.05).all()


def test_windows_that_cannot_be():
    time, zeros = np.arange(5.0), np.zeros((5, 1))
    for words, options in (("one of them", {"starts": [0]}),
                           ("one row at least", {"starts": [4], "length": 1.0}),
                           ("one row at least", {"starts": [0], "ends": [5]})):
        with pytest.raises(ParameterError, match=words):
            Windows.of(time, zeros, zeros, **options)
    with pytest.raises(ParameterError, match="times that do not increase"):
        Windows.of(time[::-1], zeros, zeros, starts=[0], length=1.0)
    good = Windows.of(time * 1e-2, zeros, zeros, starts=[0], length=0.02)
    with pytest.raises(ParameterError, match="as many joints"):
        run_windows(Plant.of("bejczy"), good)
    wild = Windows.of(time * 1e-2, zeros + 1e300, zeros, starts=[0], length=0.02)
    assert run_windows(pendulum(), wild).rms[0] == pytest.approx(FAR_OFF)
