# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The laws of controllers that are compiled ahead: the same bits as plain Python, never compiled by a first use."""

import pickle

import numpy as np
import pytest

from puma_sim_core import jit
from puma_sim_core.appraisal.controllers import Models, make
from puma_sim_core.control import sample_laws
from puma_sim_core.plant.plant import Plant

CONTROLLERS = ("computed_torque", "scheduled", "velocity_loop")


def driven(name, packed, monkeypatch):
    """Voltages of a controller over setpoints and measurements that wander, jump, and drive it to its limit."""
    monkeypatch.setattr(sample_laws, "compiled_ahead", lambda part: packed)
    controller = make(name, Models(Plant.of())).controller
    draws = np.random.default_rng(7)
    setpoints = np.cumsum(draws.normal(0.0, 0.02, (300, 3)), axis=0) + np.array([0.0, -1.5, 1.5])
    setpoints[150:] += np.array([1.0, -0.7, 0.6])
    measured = setpoints + draws.normal(0.0, 0.05, (300, 3))
    controller.reset()
    period = controller.period
    volts = [controller.update(k * period, r, y) for k, (r, y) in enumerate(zip(setpoints.tolist(), measured.tolist()))]
    return controller, np.array(volts)


@pytest.mark.skipif(jit.BACKEND != "numba", reason="nothing is compiled without numba")
@pytest.mark.parametrize("name", CONTROLLERS)
def test_compiled_and_plain_give_the_same_bits(name, monkeypatch):
    _, plain = driven(name, False, monkeypatch)
    controller, compiled = driven(name, True, monkeypatch)
    assert isinstance(controller._constants, np.ndarray)
    np.testing.assert_array_equal(compiled, plain)
    # some of them at the limit, some not
    at_limit = np.abs(plain) >= controller.limit
    assert 0.0 < at_limit.mean() < 1.0


@pytest.mark.skipif(jit.BACKEND != "numba", reason="nothing is compiled without numba")
@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_controller_that_is_compiled_can_be_copied(name, monkeypatch):
    controller, _ = driven(name, True, monkeypatch)
    copy = pickle.loads(pickle.dumps(controller))
    sample = (0.0, (0.1, -1.4, 1.5), (0.0, -1.5, 1.6))
    assert copy.update(*sample) == controller.update(*sample)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_controller_compiles_nothing(name, monkeypatch):
    def refuse(*_):
        raise AssertionError("compiled by a first use")

    for law in ("computed_torque", "scheduled_pid", "velocity_loops"):
        function = getattr(sample_laws, law)
        if hasattr(function, "compile"):
            monkeypatch.setattr(function, "compile", refuse)
    driven(name, False, monkeypatch)
