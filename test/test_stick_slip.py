# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Reversals and jerking motion under dry friction, against an event-driven integrator."""

from __future__ import annotations

import numpy as np
import pytest
from arm_reference import mass_matrix, plant_of, smooth_voltages
from scipy.integrate import solve_ivp

from puma_sim_core.arm.rigid_body import gravity_torque
from puma_sim_core.jit import BACKEND
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import Simulator

pytestmark = pytest.mark.long
#: friction of each joint: level for positive and negative motion, Stribeck excess, its velocity
FRICTION = ((12.0, 16.0, 5.0, 0.05), (13.6, 7.65, 6.0, 0.02), (5.0, 4.0, 2.0, 0.1))
EFFECTS = [
    text
    for j, (fp, fn, fs, vs) in enumerate(FRICTION, start=1)
    for text in (
        f"coulomb_friction:joint={j},torque={min(fp, fn) - 1.0}",
        f"asymmetric_coulomb_friction:joint={j},positive={fp - min(fp, fn) + 1.0},negative={fn - min(fp, fn) + 1.0}",
        f"stribeck_friction:joint={j},torque={fs},velocity={vs}",
        f"viscous_friction:joint={j},coefficient=2",
    )
]
POSITION = np.array([0.3, -0.6, 0.9])


class EventDriven:
    """One joint, the others locked: slip by DOP853 with the stop as an event, stick in closed
    form from the current's exponential."""

    def __init__(self, plant, joint, start):
        motor = plant.arm.motors[joint]
        self.plant, self.joint = plant, joint
        self.M = mass_matrix(plant, POSITION)[joint, joint]
        self.R, self.L = motor.resistance, motor.inductance
        self.ke = motor.back_emf * motor.gear_ratio
        self.kT, self.H = plant.torque_per_ampere[joint], plant.viscous_friction[joint]
        self.q, self.w, self.i = start
        self.stops = self.starts = 0

    def level(self, direction, speed, q):
        fp, fn, fs, vs = FRICTION[self.joint]
        return (fp if direction > 0 else fn) + fs * np.exp(-((speed / vs) ** 2))

    def gravity(self, q):
        pose = POSITION.copy()
        pose[self.joint] = q
        return gravity_torque(pose, self.plant.arm)[self.joint]

    def advance(self, volts, duration):
        left = duration
        while left > 1e-13:
            if self.w == 0.0:
                left = self.stick(volts, left)
            if left > 1e-13:
                left = self.slip(volts, left)

    def stick(self, volts, left):
        """Rest until the torque passes a level, or the row ends; returns what is left."""
        final, tau = volts / self.R, self.L / self.R
        loads = [self.gravity(self.q) + s * self.level(s, 0.0, self.q) for s in (1.0, -1.0)]
        for load in loads:
            if (self.kT * self.i - load) * (1.0 if load is loads[0] else -1.0) > -1e-9:
                self.direction = 1.0 if load is loads[0] else -1.0
                return left
        for load, direction in zip(loads, (1.0, -1.0)):
            share = (final - load / self.kT) / (final - self.i) if final != self.i else 2.0
            if 0.0 < share < 1.0 and (final - self.i) * direction > 0.0:
                after = -tau * np.log(share)
                if after < left:
                    self.i, self.direction = load / self.kT, direction
                    self.starts += 1
                    return left - after
        self.i = final + (self.i - final) * np.exp(-left / tau)
        return 0.0

    def slip(self, volts, left):
        s = self.direction

        def f(t, y):
            torque = self.kT * y[2] - self.gravity(y[0]) - self.H * y[1] - s * self.level(s, abs(y[1]), y[0])
            return [y[1], torque / self.M, (volts - self.R * y[2] - self.ke * y[1]) / self.L]

        def stop(t, y):
            return s * y[1]

        stop.terminal, stop.direction = True, -1
        run = solve_ivp(
            f,
            (0.0, left),
            [self.q, self.w, self.i],
            method="DOP853",
            events=stop,
            rtol=1e-11,
            atol=1e-13,
            max_step=0.01,
        )
        self.q, self.w, self.i = run.y[:, -1]
        if run.status == 1:
            self.w = 0.0
            self.stops += 1
        return left - run.t[-1]


@pytest.mark.parametrize("joint", range(3))
def test_agrees_with_an_event_driven_integrator(joint):
    plant = plant_of(*EFFECTS)
    kT, R = plant.torque_per_ampere[joint], plant.arm.motors[joint].resistance
    lift = gravity_torque(POSITION, plant.arm)[joint] / kT * R
    time = np.arange(0.0, 2.001, 0.05)
    volts = np.zeros((len(time), 3))
    volts[:, joint] = lift + 35.0 / kT * R * np.sin(13.0 * time) * np.sin(1.5 * time)
    reference = EventDriven(plant, joint, (POSITION[joint], 0.0, lift / R))
    expected = [POSITION[joint]]
    for v in volts[:-1, joint]:
        reference.advance(v, 0.05)
        expected.append(reference.q)
    constraints = [Constraint() if j == joint else Constraint("hold") for j in range(3)]
    simulator = Simulator(plant, constraints=constraints, max_step=0.00025)
    current = np.zeros(3)
    current[joint] = lift / R
    simulator.reset(POSITION, current=current)
    run = simulator.run(time, volts)
    assert reference.stops >= 5 and reference.starts >= 5
    np.testing.assert_allclose(run.position[:, joint], expected, rtol=0, atol=1e-8)
    assert run.velocity[-1, joint] == pytest.approx(reference.w, abs=1e-7)


def friction_order(effects, steps):
    """Orders that the summed errors of several runs show between halved steps."""
    plant = plant_of(*effects)
    errors = np.zeros(len(steps))
    for n in range(8 if BACKEND == "numba" else 1):
        time, volts = smooth_voltages((6.0 + n / 4, 9.0, 5.0 + n / 8), 2.0)

        def position(step):
            simulator = Simulator(plant, max_step=step)
            simulator.reset((0.1, -1.2, 1.0 + n / 10))
            run = simulator.run(time, volts)
            reversals = (np.diff(np.sign(run.velocity), axis=0) != 0).sum()
            assert reversals > 8
            return run.position

        exact = position(steps[-1] / 8)
        errors += [np.abs(position(step) - exact).max() for step in steps]
    return np.log2(errors[:-1] / errors[1:])


@pytest.mark.parametrize(
    "effects",
    [
        [f"coulomb_friction:joint={j},torque={c}" for j, c in ((1, 15), (2, 20), (3, 8))],
        [
            f"asymmetric_coulomb_friction:joint={j},positive={p},negative={n}"
            for j, p, n in ((1, 24.7, 10), (2, 13.6, 7.65), (3, 7.1, 5.6))
        ],
        [f"coulomb_friction:joint={j},torque={c}" for j, c in ((1, 15), (2, 20), (3, 8))]
        + [f"stribeck_friction:joint={j},torque=6,velocity=0.1" for j in (1, 2, 3)],
    ],
    ids=["coulomb", "asymmetric", "stribeck"],
)
def test_fourth_order_survives_stops_and_reversals(effects):
    orders = friction_order(effects, (0.0005, 0.00025, 0.000125))
    assert all(3.5 < order < 4.5 for order in orders), orders


def test_crawling_is_stick_slip_with_stribeck_friction_and_smooth_without():
    # a slow ramp under a servo with integral action: the classical hunting of a sticking joint
    ramp = np.zeros((200, 3))
    ramp[:, 0] = 0.002 * 0.028 * np.arange(200)
    starts = {}
    for name, effects in (
        ("jerks", ["coulomb_friction:joint=1,torque=10", "stribeck_friction:joint=1,torque=15,velocity=0.01"]),
        ("smooth", ["viscous_friction:joint=1,coefficient=5"]),
    ):
        simulator = Simulator(plant_of(*effects), constraints=[Constraint(), Constraint("hold"), Constraint("hold")])
        run = simulator.run_servo(ramp, ServoConfig())
        moving = run.velocity[600:, 0] != 0.0
        starts[name] = int((np.diff(moving.astype(int)) == 1).sum())
    assert starts["jerks"] >= 5 and starts["smooth"] == 0
