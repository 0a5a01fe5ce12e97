# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A log of a motion that something else than the drives made is refused, and no other one is."""

from __future__ import annotations

import numpy as np
import pytest

from puma_sim_core.effects import parse_effect
from puma_sim_core.identify import explain
from puma_sim_core.identify.checks.gate import check
from puma_sim_core.identify.data.log import Log
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.simulation.simulator import Simulator

STEP, SECONDS, NOISE = 2e-3, 10.0, 1e-5
MECHANISMS = {name: load_mechanism(name) for name in ("pendulum", "puma560")}


def moved(mechanism, law, hand, effects=(), start=0.4):
    """A log of a machine whose drives have the voltages law(time, positions (J,)), and that a hand moves as much as
    further voltages hand(time, positions) would."""
    plant = mechanism.plant(effects=effects)
    simulator = Simulator(plant, max_step=1e-3)
    simulator.reset(np.full(mechanism.joints, start))
    time, rng = np.arange(0.0, SECONDS, STEP), np.random.default_rng(5)
    position = np.empty((len(time), mechanism.joints))
    voltage = np.empty_like(position)
    for k, t in enumerate(time):
        position[k] = np.take(simulator.state, plant.axes) + NOISE * rng.standard_normal(mechanism.joints)
        voltage[k] = law(t, position[k])
        simulator.step(voltage[k] + hand(t, position[k]), STEP)
    return Log("moved", time, voltage, position)


def weight(mechanism):
    """The voltages that bear the links at rest."""
    k = mechanism.drive(mechanism.start).volts_per_torque
    return lambda t, q: k * mechanism.gravity(mechanism.start, q[None])[0]


def along(mechanism, share=1.0):
    """Voltages that take each joint along a path that repeats nothing, as a servo or a hand does."""
    drive = mechanism.drive(mechanism.start)
    stiffness = share * 60.0 * drive.volts_per_torque * np.asarray(mechanism.torque_scale)
    phase = 2.0 * np.arange(mechanism.joints)

    def volts(t, q):
        path = np.sin(1.3 * t + phase) + np.sin(4.1 * t + 2.0 * phase) + np.sin(0.5 * t * t)
        return stiffness * (0.4 + 0.15 * path - q)

    return volts


def nothing(t, q):
    return 0.0


def faults(mechanism, *args, **kwargs):
    """Faults of the channels of a log of a motion."""
    return [f.channel for f in check(moved(mechanism, *args, **kwargs), mechanism).faults]


@pytest.mark.parametrize("name", MECHANISMS)
def test_an_arm_that_bears_its_weight_while_a_hand_moves_it_is_refused(name):
    m = MECHANISMS[name]
    assert faults(m, weight(m), along(m)) == [f"voltage{j + 1}" for j in range(m.joints)]


@pytest.mark.parametrize("name", MECHANISMS)
def test_a_motion_that_the_drives_make_is_not_refused(name):
    m = MECHANISMS[name]
    bears, drives = weight(m), along(m)
    assert faults(m, lambda t, q: bears(t, q) + drives(t, q), nothing) == []
    # nor one that they make for the greater part
    assert faults(m, lambda t, q: bears(t, q) + drives(t, q), along(m, 0.3)) == []


def test_a_swing_by_its_own_weight_is_not_refused():
    pendulum = MECHANISMS["pendulum"]
    friction, bears = parse_effect("coulomb_friction:joint=1,torque=0.01"), weight(pendulum)
    log = moved(pendulum, lambda t, q: -bears(t, q), nothing, (friction,), start=1.2)
    assert np.ptp(log.position) > 1.0 and np.ptp(log.voltage) > 0.5
    assert check(log, pendulum).faults == ()


def test_a_fall_into_a_stop_is_not_refused():
    pendulum = MECHANISMS["pendulum"]
    stop = parse_effect("soft_stop:joint=1,lower=-9,upper=-0.4,stiffness=3,damping=0.002")
    bears = weight(pendulum)
    log = moved(pendulum, lambda t, q: 0.5 * bears(t, q), nothing, (stop,), start=-1.5)
    assert log.position.max() > -0.4
    assert check(log, pendulum).faults == ()


def test_a_joint_that_is_held_in_place_while_a_hand_moves_it_is_refused():
    """The voltage is the controller's answer to the position, and tells of it alone."""
    pendulum = MECHANISMS["pendulum"]
    assert faults(pendulum, lambda t, q: 2.0 * (0.4 - q), along(pendulum)) == ["voltage1"]


def test_stamps_that_are_no_clock_are_not_put_on_a_grid():
    """A grid by their middle step would have a million rows a second."""
    pendulum = MECHANISMS["pendulum"]
    log = moved(pendulum, weight(pendulum), along(pendulum))
    bursts, ten = np.arange(len(log) // 10), np.arange(10)
    time = np.repeat(0.1 * bursts, 10) + np.tile(1e-6 * ten, len(bursts))
    (fault,) = check(Log("bursts", time, log.voltage, log.position), pendulum).faults
    assert fault.channel == "time" and "very uneven times" in fault.what


def test_the_refusal_says_what_is_expected():
    pendulum = MECHANISMS["pendulum"]
    explanation = explain(moved(pendulum, weight(pendulum), along(pendulum)), plant="pendulum")
    assert explanation.verdict == "DATA_FAULT"
    assert "something that is not in the log moves the machine" in explanation.sentence
    assert "expected a motion that the drives make" in explanation.sentence
