# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Plants of one joint against equations of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from mechanism_support import pendulum
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import ParameterError
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.simulator import Simulator


def test_pendulum_moves_as_its_equation():
    plant = pendulum()
    time = np.arange(0.0, 3.0, 0.01)
    voltage = 2.5 * np.sin(5.0 * time)[:, None]
    simulator = Simulator(plant)
    simulator.reset([0.4])
    run = simulator.run(time, voltage)
    inertia = 0.49 * 0.1**2 + 0.0019
    state, states = np.array([0.4, 0.0]), [[0.4, 0.0]]
    for r in range(len(time) - 1):
        volts = voltage[r, 0]

        def slope(_, x):
            current = (volts - 0.334 * x[1]) / 3.29
            return [x[1], (0.334 * current - 0.0066 * x[1] - 0.49 * 9.81 * 0.1 * np.sin(x[0])) / inertia]

        state = solve_ivp(slope, (time[r], time[r + 1]), state, rtol=1e-9, atol=1e-12).y[:, -1]
        states.append(state)
    assert_allclose(np.column_stack([run.position, run.velocity]), states, atol=1e-8)
    # the current of a row is that of the voltage which led to it
    assert_allclose(run.current[1:, 0], (voltage[:-1, 0] - 0.334 * run.velocity[1:, 0]) / 3.29, atol=1e-12)


def test_switched_off_it_swings_with_the_period_of_a_pendulum():
    plant = pendulum(viscous_friction=0.0)
    start, inertia, weight = 1.1, 0.49 * 0.01 + 0.0019, 0.49 * 9.81 * 0.1
    period = 4.0 * np.sqrt(inertia / weight) * ellipk(np.sin(start / 2.0) ** 2)
    simulator = Simulator(plant)
    simulator.reset([start])
    time = np.linspace(0.0, 5.0 * period, 2001)
    volts = np.full((len(time), 1), 3.0)  # which nobody applies
    run = simulator.run(time, volts, enable=np.zeros(len(time)))
    assert_allclose(run.position[-1], start, atol=1e-5)
    assert not run.current.any()
    energy = 0.5 * inertia * run.velocity**2 - weight * np.cos(run.position)
    assert np.ptp(energy) < 1e-7 * weight


def test_switching_off_and_on_is_a_run_of_each_part():
    plant = pendulum(["coulomb_friction:joint=1,torque=0.02"])
    time = np.arange(0.0, 1.0, 0.004)
    voltage = (2.0 * np.cos(7.0 * time))[:, None]
    enable = np.ones(len(time))
    enable[100:150] = 0.0
    simulator = Simulator(plant)
    run = simulator.run(time, voltage, enable=enable)
    whole = Simulator(plant)
    first = whole.run(time[:101], voltage[:101])
    assert np.array_equal(run.position[:101], first.position)
    assert not run.current[101:150].any() and run.current[151:].all()
    always = Simulator(plant).run(time, voltage)
    assert np.array_equal(always.position, Simulator(plant).run(time, voltage, enable=np.ones(len(time))).position)
    with pytest.raises(ParameterError, match=r"\(250,\) or \(250, 1\)"):
        simulator.run(time, voltage, enable=np.ones((len(time), 3)))


def test_an_arm_without_current_falls_as_with_open_motors():
    """A drive that is off neither brakes nor drives; an arm whose joints are all off is a
    frictionless body."""
    plant = Plant.of("bejczy")
    simulator = Simulator(plant)
    simulator.reset([0.1, 0.2, -0.3])
    time = np.arange(0.0, 0.4, 1e-3)
    run = simulator.run(time, np.full((len(time), 3), 20.0), enable=np.zeros(len(time)))
    from puma_sim_core.arm.rigid_body import inertia

    D = inertia(run.position, plant.arm) + np.diag(plant.arm.motor_inertia)
    kinetic = 0.5 * np.einsum("ni,nij,nj->n", run.velocity, D, run.velocity)
    arm = load_mechanism("puma560")
    work = np.zeros(len(time))
    gravity = arm.gravity(arm.start, run.position)
    middle = 0.5 * (gravity[1:] + gravity[:-1])
    work[1:] = np.cumsum((middle * np.diff(run.position, axis=0)).sum(axis=1))
    assert kinetic[-1] > 5.0
    assert_allclose(kinetic + work, 0.0, atol=1e-3)


def test_slide_follows_its_command_exponentially():
    slide = load_mechanism("slide")
    time = np.linspace(0.0, 2.0, 401)
    run = Simulator(slide.plant()).run(time, np.full((len(time), 1), 0.5))
    force, mass, viscous = 0.5 * 35.15065188248547, 95.109, 203.5
    assert_allclose(run.velocity[:, 0], force / viscous * -np.expm1(-time * viscous / mass), atol=1e-12)
    # in rest, dry friction holds what is below its level
    held = slide.plant(None, [parse_effect("coulomb_friction:joint=1,torque=20")])
    simulator = Simulator(held)
    assert not simulator.run(time, np.full((len(time), 1), 0.5)).velocity.any()
    ramp = np.linspace(0.0, 1.0, len(time))[:, None]
    moving = Simulator(held).run(time, ramp).velocity[:, 0]
    # the command is held: it exceeds the friction in the row after 20 N / gain
    first = int(np.flatnonzero(moving)[0])
    assert ramp[first - 1, 0] * 35.15065188248547 > 20.0 >= ramp[first - 2, 0] * 35.15065188248547


def test_no_inductance_is_the_limit_of_a_small_one():
    time = np.arange(0.0, 1.0, 0.005)
    voltage = (2.0 * np.sin(9.0 * time))[:, None]
    at_once = Simulator(pendulum()).run(time, voltage).position
    distances = [
        abs(Simulator(pendulum(inductance=L)).run(time, voltage).position - at_once).max()
        for L in (0.016, 0.008, 0.004)
    ]
    ratios = np.array(distances[:-1]) / np.array(distances[1:])
    assert_allclose(ratios, 2.0, atol=0.15)


@pytest.mark.parametrize(
    "effects",
    [
        [],
        ["coulomb_friction:joint=1,torque=0.05"],
        ["coulomb_friction:joint=1,torque=0.05", "joint_spring:joint=1,stiffness=0.3"],
        ["load_dependent_friction:joint=1,coefficient=0.2,transmitted=0.1"],
        ["presliding_friction:joint=1,stiffness=20", "coulomb_friction:joint=1,torque=0.05"],
        ["resistance_drift:joint=1,share=0.8,time_constant=1", "friction_warm_up:joint=1,share=0.4,time_constant=1"],
        ["impulse:joint=1,torque=0.1,time=0.3,width=0.1", "coulomb_friction:joint=1,torque=0.05"],
        ["joint_elasticity:joint=1,stiffness=40", "coulomb_friction:joint=1,torque=0.05"],
        ["input_delay:time=0.0013", "sensor_lag:joint=1,time_constant=0.01"],
    ],
)
def test_a_current_limit_beyond_reach_changes_nothing(effects):
    """Without inductance the step takes the back-EMF for friction where no limit bends the current, and settles the
    current at each stage where one may: the same motion in two ways."""
    time = np.arange(0.0, 0.6, 0.002)
    voltage = (2.0 * np.sin(11.0 * time))[:, None]
    run = Simulator(pendulum(effects)).run(time, voltage)
    limited = Simulator(pendulum([*effects, "current_limit:joint=1,current=50"])).run(time, voltage)
    assert np.ptp(run.position) > 0.02
    for name in ("position", "velocity", "current"):
        assert_allclose(getattr(run, name), getattr(limited, name), atol=1e-11, err_msg=name)


@pytest.mark.parametrize(
    "effect",
    [
        "coulomb_friction:joint=1,torque=0.05",
        "stribeck_friction:joint=1,torque=0.05",
        "current_limit:joint=1,current=0.3",
        "voltage_saturation:joint=1,voltage=0.8",
        "soft_stop:joint=1,lower=-0.2,upper=0.2,stiffness=5,damping=0.1",
        "presliding_friction:joint=1,stiffness=20,torque=0.05",
        "payload:mass=0.1",
    ],
)
def test_effects_act_on_one_joint_as_on_the_third_of_an_arm(effect):
    """A pendulum is an arm whose other joints are held and whose inertia is the same."""
    time = np.arange(0.0, 0.6, 0.002)
    voltage = (2.0 * np.sin(11.0 * time))[:, None]
    plant = pendulum([effect])
    run = Simulator(plant).run(time, voltage)
    from puma_sim_core.simulation.conditions import Constraint

    third = parse_effect(effect.replace("joint=1", "joint=3"))
    # its base upside down, the link hangs at 0
    arm = Plant(
        replace(plant.arm, gravity=-plant.arm.gravity),
        (parse_effect("viscous_friction:joint=3,coefficient=0.0066"), third),
    )
    simulator = Simulator(arm, constraints=(Constraint("hold"), Constraint("hold"), Constraint()))
    full = simulator.run(time, np.pad(voltage, ((0, 0), (2, 0))))
    assert np.array_equal(run.position[:, 0], full.position[:, 2])
    assert not np.array_equal(run.position, Simulator(pendulum()).run(time, voltage).position)


def test_what_a_single_joint_refuses():
    for effect, message in (
        ("coulomb_friction:joint=2,torque=1", "joint=1: 'pendulum' has 1 joint"),
        ("base_tilt:x=0.1", "an arm"),
        ("payload:mass=1,x=0.1", "z along"),
    ):
        with pytest.raises(ParameterError, match=message):
            pendulum([effect])
    slide = load_mechanism("slide")
    for effect, message in (
        ("joint_elasticity:joint=1,stiffness=1000", "a rotor that can move"),
        ("resistance_drift:joint=1,share=0.2,time_constant=9", "on voltage"),
    ):
        assert not slide.possible(effect.split(":")[0])
        with pytest.raises(ParameterError, match=message):
            slide.plant(None, [parse_effect(effect)])
    assert slide.possible("coulomb_friction")
    with pytest.raises(ParameterError, match="one finite number"):
        Simulator(pendulum()).reset([0.0, 1.0])
    with pytest.raises(ParameterError, match=r"\(n,\) and \(n, 1\)"):
        Simulator(pendulum()).run([0.0, 1.0], np.zeros((2, 3)))
    with pytest.raises(ParameterError, match="arm of three"):
        Simulator(pendulum()).run_servo(np.zeros((2, 3)))
    from puma_sim_core.simulation.session import SessionConfig

    with pytest.raises(ParameterError, match="puma-sim simulate"):
        SessionConfig(pendulum())


BITS = """
import numpy as np
from puma_sim_core.plant.mechanism_file import load_mechanism
from puma_sim_core.effects import parse_effect
from puma_sim_core.simulation.simulator import Simulator
for name in ("pendulum", "slide"):
    plant = load_mechanism(name).plant(None, [
        parse_effect("coulomb_friction:joint=1,torque=0.03"),
        parse_effect("current_limit:joint=1,current=0.4")])
    time = np.arange(0.0, 0.3, 0.005)
    simulator = Simulator(plant)
    run = simulator.run(time, 2.0 * np.sin(20.0 * time[:, None]), acceleration=True,
                        enable=(time < 0.2).astype(float))
    print([float(v).hex() for v in np.hstack([run.position, run.velocity, run.current,
                                              run.acceleration]).ravel()])
"""


@pytest.mark.long
def test_interpreted_and_compiled_plants_of_one_joint_have_the_same_bits():
    results = [
        subprocess.run(
            [sys.executable, "-c", BITS],
            capture_output=True,
            text=True,
            env={**os.environ, "PUMA_SIM_KERNEL": kernel},
            check=True,
        ).stdout
        for kernel in ("python", "auto")
    ]
    assert results[0] == results[1] and len(results[0]) > 1000
