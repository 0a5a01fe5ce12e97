# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""The library of effects in motion: each against an oracle that shares no code with the kernel.

Loads, drag and time against an integration by SciPy of the equations with matrices; a leaning base
against the trace form with gravity turned; voltages and delays against rows that were changed
beforehand; the sensors against closed forms.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_reference import arm_of, bits, driving_torque, mass_matrix, open_circuit, plant_of, smooth_voltages
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from test_stick_slip import POSITION, EventDriven
from trace_form import arm_table

from puma_sim_core.arm.kinematics import first_derivatives
from puma_sim_core.arm.rigid_body import arm_pseudo_inertias, gravity_torque
from puma_sim_core.effects.impulse import pulse_torque
from puma_sim_core.jit import interpreted
from puma_sim_core.plant.plant import Plant
from puma_sim_core.simulation.batch import InitialState, run_batch
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

HOLD = Constraint("hold")
MOTORS = arm_of("bejczy").motors
R, L, KE, N = (
    np.array([getattr(m, name) for m in MOTORS]) for name in ("resistance", "inductance", "back_emf", "gear_ratio")
)
VISCOUS = [
    "viscous_friction:joint=1,coefficient=5.8",
    "viscous_friction:joint=2,coefficient=9.5",
    "viscous_friction:joint=3,coefficient=4",
]
START = ((0.1, -1.2, 0.9), (0.8, -0.5, 0.7), (1.0, -2.0, 0.5))


def everywhere(text, *values):
    """The effect on the three joints, with a value of its own in each."""
    return [text.format(j + 1, value) for j, value in enumerate(values)]


# ---------------------------------------------------------------- against SciPy, with matrices


def turned_gravity(x, y):
    """Torques of gravity, turned by the angle (x, y) in its own direction, in the trace form."""
    angle = np.hypot(x, y)
    down = np.array([x / angle * np.sin(angle), y / angle * np.sin(angle), -np.cos(angle)])

    def torque(arm, q):
        first = first_derivatives(q, arm_table(arm))
        moments = arm_pseudo_inertias(arm)[:, :, 3]
        return -arm.gravity * np.einsum("c,picb,pb->i", down, first[:, :, :3, :], moments)

    return torque


def pulse(t, t0, width):
    return np.where(np.abs(t - t0) < width / 2, np.cos(np.pi * (t - t0) / width) ** 2, 0.0)


#: name -> (effects, torque(t, q, qd) taken, factor of R at t, of H at t, of the voltage at i)
CASES = {
    "quadratic_friction": (
        everywhere("quadratic_friction:joint={},coefficient={}", 6, 9, 4),
        lambda t, q, qd: np.array([6, 9, 4]) * qd * np.abs(qd),
    ),
    "torque_ripple": (
        everywhere("torque_ripple:joint={},amplitude={},order=2,phase=0.4", 5, 9, 3),
        lambda t, q, qd: np.array([5, 9, 3]) * np.sin(2 * N * q + 0.4),
    ),
    "joint_spring": (
        everywhere("joint_spring:joint={},stiffness={},angle=0.3", 15, 20, 6),
        lambda t, q, qd: np.array([15, 20, 6]) * (q - 0.3),
    ),
    "base_tilt": (
        ["base_tilt:x=0.11,y=-0.07"],
        lambda t, q, qd: turned_gravity(0.11, -0.07)(arm_of("bejczy"), q) - gravity_torque(q, arm_of("bejczy")),
    ),
    "impulse": (
        ["impulse:joint=1,torque=120,time=0.2,width=0.1", "impulse:joint=3,torque=-60,time=0.3,width=0.06"],
        lambda t, q, qd: np.array([-120 * pulse(t, 0.2, 0.1), 0, 60 * pulse(t, 0.3, 0.06)]),
    ),
    "resistance_drift": (
        everywhere("resistance_drift:joint={},share={},time_constant=0.2", 0.3, 0.5, 0.1),
        None,
        lambda t: 1 + np.array([0.3, 0.5, 0.1]) * (1 - np.exp(-t / 0.2)),
    ),
    "friction_warm_up": (
        everywhere("friction_warm_up:joint={},share={},time_constant=0.15", 0.8, 0.5, 1),
        None,
        None,
        lambda t: 1 - np.array([0.8, 0.5, 1]) * (1 - np.exp(-t / 0.15)),
    ),
    "supply_droop": (["supply_droop:coefficient=0.02"], None, None, None, lambda i: max(1 - 0.02 * np.abs(i).sum(), 0)),
}


def reference(plant, volts, torque=None, growth=None, thinning=None, supply=None):
    H = np.array(plant.viscous_friction)

    def f(t, y):
        q, qd, i = y[:3], y[3:6], y[6:]
        b = driving_torque(plant, q, qd, i) + H * qd
        b = b - H * qd * (thinning(t) if thinning else 1.0)
        if torque:
            b = b - torque(t, q, qd)
        v = volts * (supply(i) if supply else 1.0)
        r = R * (growth(t) if growth else 1.0)
        return np.concatenate([qd, np.linalg.solve(mass_matrix(plant, q), b), (v - r * i - KE * N * qd) / L])

    return f


@pytest.mark.parametrize("name", CASES)
def test_agrees_with_an_independent_integration(name):
    effects, *law = CASES[name]
    plant, volts = plant_of(*VISCOUS, *effects), np.array([14.0, -18.0, 9.0])
    y = solve_ivp(
        reference(plant, volts, *law), (0.0, 0.4), np.concatenate(START), rtol=1e-9, atol=1e-11, max_step=0.01
    ).y[:, -1]
    ends = {}
    for n in (2, 8):
        simulator = Simulator(plant, max_step=SERVO_PERIOD / n)
        simulator.reset(*START)
        simulator.step(volts, 0.4)
        ends[n] = np.abs(simulator.state - y).max()
    without = Simulator(plant_of(*VISCOUS), max_step=SERVO_PERIOD)
    without.reset(*START)
    without.step(volts, 0.4)
    assert ends[8] < 3e-6 and np.abs(without.state - y).max() > 3e-3
    # constants of a step are of second order, the others of fourth, where nothing else is left
    assert ends[8] < 1e-8 or ends[8] < ends[2] / 12


@pytest.mark.parametrize(
    "name, extra", [("bejczy", "payload:mass=2,x=0.1,y=-0.2,z=0.3"), ("armstrong", "payload:mass=0")]
)
def test_a_leaning_base_feels_gravity_in_its_turned_direction(name, extra):
    plant = plant_of("base_tilt:x=-0.4,y=0.9", extra, name=name)
    level = Plant(replace(plant.arm, gravity=0.0), plant.effects[1:])
    rng = np.random.default_rng(3)
    for q in rng.uniform(-3, 3, (20, 3)):
        found = []
        for tried in (plant, level):
            simulator = Simulator(tried)
            simulator.reset(q)
            found.append(simulator.run([0.0, 1e-3], np.zeros((2, 3)), acceleration=True).acceleration[0])
        torque = turned_gravity(-0.4, 0.9)(plant.loaded_arm, q)
        np.testing.assert_allclose(mass_matrix(plant, q) @ (found[1] - found[0]), torque, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("step", [SERVO_PERIOD, 0.008])
def test_a_blow_keeps_its_momentum_however_long_the_steps(step):
    arm = replace(arm_of("bejczy"), gravity=0.0)
    plant = open_circuit(Plant(arm, plant_of("impulse:joint=1,torque=90,time=0.0417,width=0.011").effects))
    simulator = Simulator(plant, constraints=(Constraint(), HOLD, HOLD), max_step=step)
    simulator.reset((0.0, -1.0, 0.5))
    simulator.step((0, 0, 0), 0.08)
    momentum = mass_matrix(plant, (0.0, -1.0, 0.5))[0, 0] * simulator.state[3]
    assert momentum == pytest.approx(90 * 0.011 / 2, rel=1e-12)


@given(t=st.floats(-1, 1), step=st.floats(1e-6, 0.5), width=st.floats(1e-3, 2.0))
def test_the_mean_of_a_pulse_is_its_integral(t, step, width):
    mean = interpreted(pulse_torque)((3.0, 0.1, width), 0, t, step)
    n = 4000
    middle = t + (np.arange(n) + 0.5) / n * step
    assert mean == pytest.approx(3.0 * pulse(middle, 0.1, width).mean(), abs=2e-3)


# ------------------------------------------------------------------------------- dry friction


@pytest.mark.parametrize(
    "joint, effect",
    [
        (0, "position_dependent_friction:joint=1,torque=12,amplitude=9,angle=0.1"),
        (1, "position_dependent_friction:joint=2,torque=8,amplitude=14,angle=-1.2"),
        (1, "load_dependent_friction:joint=2,coefficient=0.3"),
        (2, "load_dependent_friction:joint=3,coefficient=0.8"),
        (0, "stribeck_friction:joint=1,torque=6,velocity=0.1,sliding=11"),
    ],
)
def test_dry_friction_of_a_pose_sticks_and_slips_as_an_event_driven_integrator(joint, effect):
    plant = plant_of(*VISCOUS, effect)
    kind, values = effect.partition(":")[0], plant.effects[-1].values

    class Reference(EventDriven):
        def level(self, direction, speed, q):
            if kind == "load_dependent_friction":
                return values["coefficient"] * abs(self.gravity(q))
            if kind == "stribeck_friction":
                return values["sliding"] + values["torque"] * np.exp(-((speed / values["velocity"]) ** 2))
            return max(values["torque"] + values["amplitude"] * np.cos(q - values["angle"]), 0.0)

    kT, resistance = plant.torque_per_ampere[joint], R[joint]
    lift = gravity_torque(POSITION, plant.arm)[joint] / kT * resistance
    time = np.arange(0.0, 1.501, 0.05)
    volts = np.zeros((len(time), 3))
    volts[:, joint] = lift + 35.0 / kT * resistance * np.sin(13.0 * time) * np.sin(1.5 * time)
    truth = Reference(plant, joint, (POSITION[joint], 0.0, lift / resistance))
    expected = [POSITION[joint]]
    for v in volts[:-1, joint]:
        truth.advance(v, 0.05)
        expected.append(truth.q)
    current = np.zeros(3)
    current[joint] = lift / resistance
    simulator = Simulator(plant, constraints=[Constraint() if j == joint else HOLD for j in range(3)])
    simulator.reset(POSITION, current=current)
    run = simulator.run(time, volts)
    assert truth.stops > 2 and truth.starts > 1
    np.testing.assert_allclose(run.position[:, joint], expected, rtol=0, atol=2e-6)


def test_stribeck_friction_has_a_coulomb_level_of_its_own():
    time, volts = smooth_voltages((6.0, 9.0, 5.0), 1.0)
    both = ["coulomb_friction:joint=2,torque=7", "stribeck_friction:joint=2,torque=3"]
    assert same(both, ["stribeck_friction:joint=2,torque=3,sliding=7"], time, volts)


def test_a_bristle_yields_at_the_level_of_its_pose():
    # pushed slowly, joint 3 slides where its load, not a constant, is the level
    for q, expected in ((0.2, 5.0 + 3.0 * np.cos(0.2)), (1.2, 5.0 + 3.0 * np.cos(1.2))):
        plant = plant_of(
            "presliding_friction:joint=1,stiffness=2e4", "position_dependent_friction:joint=1,torque=5,amplitude=3"
        )
        simulator = Simulator(plant, constraints=(Constraint("velocity", 1e-3), HOLD, HOLD))
        simulator.reset((q, -1.0, 0.5), (1e-3, 0, 0))
        simulator.step((0, 0, 0), 3.0)
        assert simulator.bristles[0] * 2e4 == pytest.approx(expected, abs=0.02)


# ------------------------------------------------------------------------------------ voltages


def run(effects, time, volts, reset=START, **options):
    simulator = Simulator(plant_of(*VISCOUS, *effects), **options)
    simulator.reset(*reset)
    return simulator.run(time, volts)


def same(ours, theirs, time, volts, other_volts=None):
    a, b = run(ours, time, volts), run(theirs, time, volts if other_volts is None else other_volts)
    return bits(np.hstack([a.position, a.velocity, a.current])) == bits(np.hstack([b.position, b.velocity, b.current]))


def test_dead_band_and_offset_are_those_of_the_terminals():
    time, volts = smooth_voltages((6.0, 9.0, 5.0), 0.6)
    dead = np.array([0.8, 0.3, 0.5])
    left = volts - np.clip(volts, -dead, dead)
    assert (left == 0.0).any() and (left != 0.0).any()
    band = everywhere("voltage_dead_band:joint={},voltage={}", *dead)
    assert same(band, [], time, volts, left)
    lost = everywhere("voltage_offset:joint={},voltage={}", 0.4, -0.7, 0.2)
    assert same(band + lost, [], time, volts, left - (0.4, -0.7, 0.2))
    supply = everywhere("voltage_saturation:joint={},voltage={}", 4, 4, 4)
    assert same(band + lost + supply, [], time, volts, np.clip(left - (0.4, -0.7, 0.2), -4.0, 4.0))


def test_what_the_amplifier_does_does_not_show_in_the_recorded_voltage():
    time, volts = smooth_voltages((6.0, 9.0, 5.0), 0.2)
    effects = [
        "voltage_dead_band:joint=1,voltage=1",
        "voltage_offset:joint=2,voltage=1",
        "supply_droop:coefficient=0.05",
        "input_delay:time=0.003",
    ]
    assert bits(run(effects, time, volts).voltage) == bits(volts)


# ------------------------------------------------------------------------------ runs and batches

#: all that a run remembers or takes from its time
LIBRARY = (
    *VISCOUS,
    "input_delay:time=0.0035",
    "impulse:joint=1,torque=80,time=0.3,width=0.05",
    "resistance_drift:joint=2,share=0.3,time_constant=0.5",
    "base_tilt:x=0.03,y=0.02",
    "friction_warm_up:joint=3,share=0.5,time_constant=0.4",
    "supply_droop:coefficient=0.01",
    "sensor_lag:joint=1,time_constant=0.01",
    "encoder_offset:joint=2,angle=0.02",
    "sensor_nonlinearity:joint=3,amplitude=0.004,period=0.7",
    "joint_spring:joint=1,stiffness=10",
    "load_dependent_friction:joint=2,coefficient=0.1",
)


def test_a_run_in_pieces_and_one_after_a_reset_are_the_run():
    time, volts = smooth_voltages((9.0, 12.0, 7.0), 0.7)
    simulator = Simulator(plant_of(*LIBRARY))
    found = []
    for parts in ([len(time)], [8, 15, len(time)], [len(time)]):
        simulator.reset(*START)
        rows, first = [], 0
        for last in parts:
            rows.append(simulator.run(time[first:last], volts[first:last]).position)
            first = last - 1
        found.append(bits(np.vstack([rows[0], *(r[1:] for r in rows[1:])])))
    assert found[0] == found[1] == found[2]


def test_a_batch_gives_the_same_bits():
    time, volts = smooth_voltages((9.0, 12.0, 7.0), 0.5)
    plants = [plant_of(*LIBRARY), plant_of("base_tilt:x=0.05")]
    result = run_batch(plants, time, volts, start=InitialState(START[0]))
    for n, plant in enumerate(plants):
        simulator = Simulator(plant)
        simulator.reset(START[0])
        assert bits(result.position[n]) == bits(simulator.run(time, volts).position)


@settings(max_examples=10)
@given(st.floats(0.0, 50.0))
def test_the_cold_motor_is_the_one_at_time_zero(start):
    # a record may begin at any time: drift and warm-up are those of its own clock
    effects = ["resistance_drift:joint=1,share=1,time_constant=10"]
    simulator = Simulator(plant_of(*effects), constraints=(HOLD,) * 3)
    time = start + np.linspace(0.0, 0.2, 5)
    current = simulator.run(time, np.full((5, 3), 8.0)).current[-1, 0]
    assert current == pytest.approx(8.0 / (1.6 * (2.0 - np.exp(-time[-1] / 10))), rel=1e-3)
