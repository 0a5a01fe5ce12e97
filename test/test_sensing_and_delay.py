# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""What the sensors make of the motion, voltages that arrive late, and sessions with both."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from arm_reference import bits, plant_of, smooth_voltages
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from test_effect_library import HOLD, LIBRARY, START, VISCOUS

from puma_sim_core.dynamics.laws import SENSED
from puma_sim_core.dynamics.sensed import settled_positions, true_motion
from puma_sim_core.files import yaml_text
from puma_sim_core.recording.bag.recorder import BagRecorder
from puma_sim_core.servo.pid import Pid
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.conditions import Constraint
from puma_sim_core.simulation.replay import replay
from puma_sim_core.simulation.session import Session, SessionConfig
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator
from puma_sim_core.simulation.windows import run_windows

CURVED = (
    "sensor_nonlinearity:joint=1,amplitude=0.02,period=0.9,phase=0.4",
    "encoder_offset:joint=1,angle=0.05",
    "sensor_lag:joint=1,time_constant=0.03",
)


def simulator_of(*effects, start=START, **options):
    simulator = Simulator(plant_of(*VISCOUS, *effects), **options)
    simulator.reset(*start)
    return simulator


# ------------------------------------------------------------------------------------- sensors


def test_offset_and_curve_are_added_to_the_true_position():
    time, volts = smooth_voltages((9.0, 12.0, 7.0), 0.5)
    true = simulator_of().run(time, volts)
    simulator = simulator_of(
        "encoder_offset:joint=2,angle=0.03", "sensor_nonlinearity:joint=3,amplitude=0.01,period=0.5,phase=1"
    )
    seen = simulator.run(time, volts)
    assert bits(seen.velocity) == bits(true.velocity) and bits(seen.current) == bits(true.current)
    assert bits(simulator.state[:3]) == bits(true.position[-1])
    assert bits(seen.position[:, 0]) == bits(true.position[:, 0])
    assert bits(seen.position[:, 1]) == bits(true.position[:, 1] + 0.03)
    q = true.position[:, 2]
    np.testing.assert_allclose(seen.position[:, 2], q + 0.01 * np.sin(2 * np.pi * q / 0.5 + 1), rtol=0, atol=1e-15)
    assert bits(simulator.measured) == bits(seen.position[-1])


@pytest.mark.parametrize("lag", [1e-5, 0.002, 0.03, 5.0])
def test_a_lag_follows_a_uniform_motion_as_its_equation_says(lag):
    simulator = Simulator(
        plant_of(f"sensor_lag:joint=1,time_constant={lag}"), constraints=(Constraint("acceleration", 3.0), HOLD, HOLD)
    )
    simulator.reset((0.2, 0, 0), (0.5, 0, 0))
    time = np.linspace(0.0, 0.5, 40)
    seen = simulator.run(time, np.zeros((40, 3))).position[:, 0]
    q = 0.2 + 0.5 * time + 1.5 * time**2
    # q - T qd + T^2 qdd, and what is left of the rest at the start
    expected = q - lag * (0.5 + 3.0 * time) + 3.0 * lag**2 + (0.5 * lag - 3.0 * lag**2) * np.exp(-time / lag)
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-12 * max(1.0, lag**2))


def test_curve_offset_and_lag_together_agree_with_an_integration():
    def chain(q):
        return q + 0.05 + 0.02 * np.sin(2 * np.pi * q / 0.9 + 0.4)

    def q(t):
        return 0.2 + 0.5 * t + 1.5 * t**2

    truth = solve_ivp(
        lambda t, m: (chain(q(t)) - m) / 0.03, (0.0, 0.5), [chain(0.2)], rtol=1e-11, atol=1e-12, max_step=0.005
    ).y[0, -1]
    errors = []
    for n in (1, 4):
        simulator = Simulator(
            plant_of(*CURVED), max_step=SERVO_PERIOD / n, constraints=(Constraint("acceleration", 3.0), HOLD, HOLD)
        )
        simulator.reset((0.2, 0, 0), (0.5, 0, 0))
        simulator.step((0, 0, 0), 0.5)
        errors.append(abs(simulator.measured[0] - truth))
    assert errors[0] < 1e-8 and errors[1] < max(errors[0] / 30, 1e-11)


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-5, 5))
def test_the_true_motion_is_found_behind_the_sensors(q, qd, qdd):
    table = plant_of(*CURVED).constants.table
    turn, lag = 2 * np.pi / 0.9, 0.03
    u = settled_positions((q, 0, 0), table)[0]
    slope = 1 + 0.02 * turn * np.cos(turn * q + 0.4)
    # any measured motion whose lag leads to u and its rate
    rate = u * 0.3 + qd
    measured, second = u - lag * rate, (qd * slope - rate) / lag
    position, velocity = true_motion((measured, 0, 0), (rate, 0, 0), (second, 0, 0), table)
    assert position[0] == pytest.approx(q, abs=1e-12)
    assert velocity[0] == pytest.approx(qd, abs=1e-10)


def test_the_servo_drives_the_measured_position_to_its_setpoint():
    target = np.array([0.3, -1.0, 0.7])
    effects = (
        "encoder_offset:joint=1,angle=0.05",
        "encoder_offset:joint=3,angle=-0.02",
        "sensor_lag:joint=2,time_constant=0.002",
    )
    simulator = simulator_of(*effects, start=(target,))
    run = simulator.run_servo(np.tile(target, (250, 1)), ServoConfig())
    np.testing.assert_allclose(run.position[-1], target, rtol=0, atol=2e-5)
    np.testing.assert_allclose(simulator.state[:3], target - (0.05, 0.0, -0.02), rtol=0, atol=2e-5)


# --------------------------------------------------------------------------------------- delay


def late_rows(time, volts, delay, first):
    """Rows of a plant without the delay that gets the voltages when they arrive."""
    edges = np.unique(np.concatenate([time, time + delay]).round(12))
    edges = edges[edges <= time[-1]]
    rows = np.searchsorted(time + delay, edges + 1e-9, side="right") - 1
    return edges, np.where(rows[:, None] < 0, first, volts[np.maximum(rows, 0)])


@pytest.mark.parametrize("delay", [0.0004, 0.032, 0.05, 0.1234])
def test_a_delay_shifts_the_voltages_by_exactly_its_time(delay):
    time, volts = smooth_voltages((9.0, 12.0, 7.0), 0.6)
    seen = simulator_of(f"input_delay:time={delay}").run(time, volts, acceleration=True)
    edges, arriving = late_rows(time, volts, delay, volts[0])
    truth = simulator_of().run(edges, arriving, acceleration=True)
    rows = np.searchsorted(edges, time - 1e-9)
    np.testing.assert_allclose(seen.position, truth.position[rows], rtol=0, atol=1e-12)
    np.testing.assert_allclose(seen.current, truth.current[rows], rtol=0, atol=1e-11)
    np.testing.assert_allclose(seen.acceleration, truth.acceleration[rows], rtol=0, atol=1e-9)


@settings(max_examples=15)
@given(delay=st.floats(0.0, 0.08), cuts=st.lists(st.integers(1, 9), max_size=3, unique=True))
def test_what_is_on_its_way_goes_on_from_run_to_run(delay, cuts):
    time, volts = smooth_voltages((9.0, 12.0, 7.0), 0.32)
    effect = f"input_delay:time={delay!r}"
    whole, parts = simulator_of(effect), simulator_of(effect)
    end = whole.run(time, volts).position[-1]
    edges = [0, *sorted(cuts), len(time) - 1]
    for first, last in itertools.pairwise(edges):
        # each with a clock of its own
        parts.run(time[first : last + 1] - time[first], volts[first : last + 1])
    np.testing.assert_allclose(parts.state[:3], end, rtol=0, atol=1e-12)
    steps = simulator_of(effect)
    for row, length in zip(volts[:-1], np.diff(time)):
        steps.step(row, length)
    np.testing.assert_allclose(steps.state[:3], end, rtol=0, atol=1e-12)


def test_a_delay_of_whole_samples_is_that_of_the_servo():
    setpoint = np.array([0.1, -1.1, 0.9]) + 0.1 * np.sin(np.outer(np.arange(12), (0.5, 0.3, 0.7)))
    for samples in (1, 3):
        ours = simulator_of(f"input_delay:time={samples * SERVO_PERIOD!r}").run_servo(setpoint)
        servo = simulator_of().run_servo(setpoint, ServoConfig(delay_samples=samples))
        assert bits(ours.position) == bits(servo.position)
        # what is asked for is what arrives that much later
        assert bits(ours.voltage[: -1 - samples]) == bits(servo.voltage[samples:-1])


@pytest.mark.parametrize("delay", [0.0004, 0.0021])
def test_servo_and_controllers_see_the_same_delay_and_sensors(delay):
    setpoint = np.array([0.1, -1.1, 0.9]) + 0.1 * np.sin(np.outer(np.arange(12), (0.5, 0.3, 0.7)))
    effects = (f"input_delay:time={delay}", *LIBRARY[4:])
    servo = ServoConfig(encoder_counts=1000, delay_samples=1)
    ours = simulator_of(*effects).run_servo(setpoint, servo)
    limit = 40.0
    pid = Pid(
        servo.gains,
        SERVO_PERIOD,
        limit=limit,
        anti_windup=servo.anti_windup,
        on_measurement=servo.derivative_on_measurement,
    )
    theirs = simulator_of(*effects).run_controller(pid, setpoint, chain=servo)
    assert bits(ours.position) == bits(theirs.position)
    assert bits(ours.voltage) == bits(theirs.voltage)


def test_a_servo_takes_over_what_a_run_left_on_its_way():
    time, volts = smooth_voltages((9.0, 12.0, 7.0), 0.032 * 3)
    delay, setpoint = 2.5 * SERVO_PERIOD, np.tile(START[0], (2, 1))
    simulator = simulator_of(f"input_delay:time={delay!r}")
    simulator.run(time, volts)
    run = simulator.run_servo(setpoint)
    plain = simulator_of()
    plain.run(*late_rows(time, volts, delay, volts[0]))
    asked = np.vstack([np.tile(volts[-2], (3, 1)), run.voltage])
    steps = SERVO_PERIOD * np.array([0.5, 0.5] * 60)
    for n, length in enumerate(steps):
        plain.step(asked[(n + 1) // 2], length)
    # half steps against whole ones
    np.testing.assert_allclose(run.position[-1], plain.state[:3], rtol=0, atol=1e-9)


# ------------------------------------------------------------------------------------- windows


@pytest.mark.parametrize(
    "effects",
    [
        ("input_delay:time=0.0045",),
        (*CURVED, "encoder_offset:joint=2,angle=0.05", "base_tilt:x=0.05"),
        ("resistance_drift:joint=2,share=1,time_constant=0.3",),
    ],
)
def test_windows_of_a_log_start_from_the_state_behind_its_measurements(effects):
    time, volts = smooth_voltages((9.0, 12.0, 7.0), 1.6, row=0.004)
    simulator = simulator_of(*effects, start=((0.1, -1.2, 0.9),))
    log = simulator.run(time, volts)
    log = type(log)(time=log.time, voltage=log.voltage, position=log.position)
    own = run_windows(Simulator(simulator.plant), log, 0.4)[1].rms
    without = run_windows(Simulator(plant_of(*VISCOUS)), log, 0.4)[1].rms
    # what starting from slopes costs, whatever the plant
    plain = simulator_of(start=((0.1, -1.2, 0.9),)).run(time, volts)
    plain = type(log)(time=log.time, voltage=log.voltage, position=plain.position)
    floor = run_windows(Simulator(plant_of(*VISCOUS)), plain, 0.4)[1].rms
    assert (own < 2.0 * floor).all() and without.sum() > 1.8 * own.sum()


# ------------------------------------------------------------------------------ sessions, bags


def config_of(interface, controller="pid"):
    return SessionConfig(
        plant_of(*LIBRARY, "torque_ripple:joint=2,amplitude=3,order=1", "voltage_dead_band:joint=1,voltage=0.3"),
        interface,
        initial_position=(0.1, -1.1, 0.9),
        voltage_limit=30.0,
        command_timeout=0.2,
        controller=controller,
        servo=ServoConfig(encoder_counts=1000),
    )


def commanded(session, step, random):
    if step < 15 or step > 24:  # a pause lets the watchdog act
        low, high = (-20, 20) if session.config.command_interface == "voltage" else (-0.05, 0.05)
        centre = np.zeros(3) if low < -1 else np.array([0.1, -1.1, 0.9])
        return [tuple((centre + random.uniform(low, high, 3)).tolist())]
    return []


@pytest.mark.parametrize(
    "interface, controller", [("voltage", "pid"), ("position", "pid"), ("position", "computed_torque")]
)
def test_a_bag_replays_to_the_last_bit(interface, controller, tmp_path):
    config = config_of(interface, controller)
    session, random = Session(config), np.random.default_rng(8)
    assert session.config.plant.constants.active & SENSED
    states = []
    with BagRecorder(
        tmp_path / "bag",
        config_text=yaml_text(config.to_mapping()),
        joint_names=config.joint_names,
        frame_id=config.frame_id,
        command_interface=interface,
        period_ns=config.period_ns,
    ) as recorder:
        for step in range(41):
            recorder.write_state(session.state)
            states.append(session.state)
            if step < 40:
                for values in commanded(session, step, random):
                    recorder.write_command(session.state.time_ns, session.command(values))
                session.step()
    found = replay(tmp_path / "bag")
    assert found.identical, found.first_difference
    session.reset()
    random = np.random.default_rng(8)
    for step in range(40):
        assert bits(session.state[2]) == bits(states[step][2])
        for values in commanded(session, step, random):
            session.command(values)
        session.step()
    assert bits(np.concatenate(session.state[2:])) == bits(np.concatenate(states[-1][2:]))


@pytest.mark.parametrize("delay", [0.0004, 0.028, 0.0301])
def test_a_session_in_volts_is_the_run_of_its_commands(delay):
    effects = (*LIBRARY[4:], f"input_delay:time={delay}")
    plant = plant_of(*VISCOUS, *effects)
    session = Session(SessionConfig(plant, "voltage", initial_position=START[0]))
    volts = np.vstack([np.zeros(3), np.random.default_rng(2).uniform(-15, 15, (20, 3))])
    positions = [session.state.position]
    for row in volts:
        session.command(tuple(row))
        positions.append(session.step().position)
    simulator = Simulator(plant)
    simulator.reset(START[0])
    time = 0.028 * np.arange(len(volts) + 1)
    run = simulator.run(time, np.vstack([volts, volts[-1:]]))
    np.testing.assert_allclose(positions, run.position, rtol=0, atol=1e-10)


def test_a_session_under_the_servo_is_the_run_of_its_setpoints():
    plant = plant_of(*LIBRARY)
    setpoints = np.array([0.1, -1.1, 0.9]) + 0.1 * np.sin(np.outer(np.arange(12), (0.5, 0.3, 0.7)))
    session = Session(SessionConfig(plant, "position", initial_position=(0.1, -1.1, 0.9)))
    simulator = Simulator(plant)
    simulator.reset((0.1, -1.1, 0.9))
    setpoints[0] = simulator.measured
    run = simulator.run_servo(setpoints)
    for n, target in enumerate(setpoints):
        session.command(target)
        state = session.step()
        np.testing.assert_allclose(state.position, run.position[30 * (n + 1)], rtol=0, atol=1e-12)


def test_the_watchdog_of_a_session_holds_the_arm_where_it_measures_it():
    session = Session(
        SessionConfig(
            plant_of("encoder_offset:joint=1,angle=0.3"),
            "position",
            initial_position=(0.1, -1.1, 0.9),
            command_timeout=0.1,
        )
    )
    assert session.state.position[0] == pytest.approx(0.4, abs=1e-15)
    for _ in range(60):
        session.step()
    np.testing.assert_allclose(session.state.position, (0.4, -1.1, 0.9), rtol=0, atol=0.02)
