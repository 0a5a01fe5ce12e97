# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A session: commands by the step, a watchdog, counters, and equal reruns."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from arm_reference import arm_of, bits, plant_of

from puma_sim_core.errors import CommandError, NonFiniteStateError
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.session import Session, SessionConfig
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

EFFECTS = (
    "coulomb_friction:joint=1,torque=12",
    "presliding_friction:joint=3,torque=6",
    "stribeck_friction:joint=1,torque=4",
    "viscous_friction:joint=2,coefficient=9.5",
    "current_limit:joint=2,current=7.25",
    "payload:mass=1.1",
)
POSITION = (0.1, -1.1, 0.9)


def config_of(*effects, **changes):
    return SessionConfig(**{"plant": plant_of(*effects), "initial_position": POSITION, **changes})


def position_config(*effects, **changes):
    return config_of(*effects, command_interface="position", **changes)


def all_bits(state):
    return state.step, state.time_ns, bits([state.position, state.velocity, state.current, state.voltage, state.effort])


# ------------------------------------------------------------------------------------- stepping


@pytest.mark.parametrize("effects", [(), EFFECTS], ids=["none", "effects"])
def test_a_voltage_session_is_the_simulator_bit_for_bit(effects):
    session, simulator = Session(config_of(*effects)), Simulator(plant_of(*effects))
    simulator.reset(POSITION)
    random = np.random.default_rng(1)
    for _ in range(30):
        volts = random.uniform(-20, 20, 3)
        session.command(volts)
        state = session.step()
        simulator.step(volts, 0.028)
        assert bits([*state.position, *state.velocity, *state.current]) == bits(simulator.state)
        assert bits(state.voltage) == bits(volts)


def test_states_are_stamped_with_the_step_times_the_period():
    session = Session(config_of())
    assert all_bits(session.state)[:2] == (0, 0)
    for step in range(1, 6):
        state = session.step()
        assert (state.step, state.time_ns) == (step, step * 28_000_000)
        assert state is session.state
    assert config_of(period=1 / 3, substeps=1000).period_ns == 333333333


def test_effort_is_the_torque_of_the_motors_at_the_joints():
    session = Session(config_of())
    session.command((5.0, -4.0, 3.0))
    for _ in range(5):
        state = session.step()
    expected = [i * m.torque_constant * m.gear_ratio for i, m in zip(state.current, arm_of("bejczy").motors)]
    np.testing.assert_allclose(state.effort, expected, rtol=1e-14)


def test_the_initial_state_is_the_configured_one():
    state = Session(config_of(initial_velocity=(0.1, 0.2, 0.3), initial_current=(1, 2, 3))).state
    assert state.position == POSITION and state.velocity == (0.1, 0.2, 0.3)
    assert state.current == (1.0, 2.0, 3.0) and state.voltage == (0.0, 0.0, 0.0)


def test_a_command_acts_from_the_next_step_on_and_holds():
    session, other = Session(config_of()), Session(config_of())
    session.step(), other.step()
    session.command((9.0, 9.0, 9.0))
    assert session.state.voltage == (0.0, 0.0, 0.0)
    assert session.step().voltage == (9.0, 9.0, 9.0)
    assert session.step().voltage == (9.0, 9.0, 9.0)
    assert other.step().voltage == (0.0, 0.0, 0.0)


def test_of_several_commands_between_two_steps_the_last_acts():
    session = Session(config_of())
    session.command((9.0, 9.0, 9.0))
    session.command((1.0, 2.0, 3.0))
    assert session.step().voltage == (1.0, 2.0, 3.0)


def test_saturation_of_the_plant_shows_in_the_voltage():
    session = Session(config_of("voltage_saturation:joint=2,voltage=12"))
    session.command((20.0, -20.0, 20.0))
    assert session.step().voltage == (20.0, -12.0, 20.0)
    assert session.counters.saturated == 0


@pytest.mark.parametrize("config", [config_of, position_config])
def test_reset_equals_a_new_session_bit_for_bit(config):
    servo = ServoConfig(encoder_counts=1000, converter_bits=12)
    used, new = (Session(config(*EFFECTS, servo=servo)) for _ in range(2))
    for step in range(20):
        used.command((0.3, -1.0, 0.5 + step / 50))
        used.step()
    with pytest.raises(CommandError):
        used.command((math.nan,) * 3)
    used.command((0.7, 0.7, 100.0))
    used.reset()
    assert used.counters == new.counters and used.command_age_steps == new.command_age_steps
    assert all_bits(used.state) == all_bits(new.state)
    for step in range(40):
        if step == 3:
            used.command((0.2, -1.0, 0.8))
            new.command((0.2, -1.0, 0.8))
        assert all_bits(used.step()) == all_bits(new.step())


# -------------------------------------------------------------------------------------- commands


def test_voltages_beyond_the_limit_are_clipped_and_counted():
    session = Session(config_of(voltage_limit=12))
    assert session.command((13.0, -500.0, 12.0)).values == (13.0, -500.0, 12.0)
    assert session.counters.saturated == 2
    state = session.step()
    assert state.voltage == (12.0, -12.0, 12.0)
    assert all(type(v) is float for v in state.voltage)


def test_setpoints_beyond_the_range_of_a_joint_are_clipped_and_counted():
    (_low, high), *_ = arm_of("bejczy").joint_ranges
    session = Session(position_config(command_timeout=0))
    session.command((100.0, POSITION[1], POSITION[2]))
    assert session.counters.saturated == 1
    for _ in range(200):
        session.step()
    assert session.state.position[0] == pytest.approx(high, abs=5e-3)


@pytest.mark.parametrize(
    "values",
    [
        (1.0, 2.0),
        (1.0, 2.0, 3.0, 4.0),
        (),
        (1.0, math.nan, 3.0),
        (1.0, 2.0, math.inf),
        (1.0, None, 3.0),
        ("a", "b", "c"),
        ([1.0], [2.0], [3.0]),
    ],
)
def test_a_refused_command_leaves_the_last_good_one_and_its_age(values):
    session = Session(config_of())
    session.command((3.0, 4.0, 5.0))
    session.step(), session.step()
    age = session.command_age_steps
    with pytest.raises(CommandError, match="command: .*; expected 3 finite numbers"):
        session.command(values)
    assert session.counters.rejected == 1 and session.counters.saturated == 0
    assert session.command_age_steps == age == 1
    assert session.step().voltage == (3.0, 4.0, 5.0)
    assert session.command_age_steps == 2


def test_some_joints_may_be_commanded_by_name_and_the_others_keep_theirs():
    session, full = Session(position_config()), Session(position_config())
    taken = session.command_joints(("joint3", "joint1"), (0.95, 0.15))
    assert taken.names == ("joint3", "joint1") and taken.values == (0.95, 0.15)
    full.command((0.15, POSITION[1], 0.95))
    for _ in range(10):
        assert all_bits(session.step()) == all_bits(full.step())
    session.command_joints(["joint2"], [-1.0])
    full.command((0.15, -1.0, 0.95))
    for _ in range(10):
        assert all_bits(session.step()) == all_bits(full.step())


@pytest.mark.parametrize(
    "names, values, message",
    [
        (("joint1", "wrist"), (0.1, 0.2), "unknown joint 'wrist'; expected some of joint1, joint2"),
        (("joint1", "joint1"), (0.1, 0.2), "joint 'joint1' stands twice; expected each joint once"),
        (("joint1", "joint2"), (0.1,), "expected 2 finite numbers"),
        (("joint1",), (math.nan,), "expected 1 finite numbers"),
        ((), (), "no joint names; expected some of joint1"),
    ],
)
def test_commands_by_name_that_cannot_be_used_are_named(names, values, message):
    session = Session(position_config())
    with pytest.raises(CommandError, match=message):
        session.command_joints(names, values)
    assert session.counters.rejected == 1
    reference = Session(position_config())
    assert all_bits(session.step()) == all_bits(reference.step())


def test_a_session_that_takes_volts_refuses_joint_names():
    session = Session(config_of())
    with pytest.raises(CommandError, match="takes volts; expected command_interface position"):
        session.command_joints(("joint1",), (1.0,))
    assert session.counters.rejected == 1


# -------------------------------------------------------------------------------------- watchdog


def test_without_a_command_for_its_timeout_the_voltage_falls_to_zero():
    session = Session(config_of(command_timeout=0.5))
    session.command((5.0, 5.0, 5.0))
    volts = [session.step().voltage for _ in range(30)]
    # 0.5 s are 18 periods of 28 ms
    assert volts == [(5.0,) * 3] * 18 + [(0.0,) * 3] * 12
    session.command((6.0, 6.0, 6.0))
    assert session.command_age_steps == 29
    assert session.step().voltage == (6.0,) * 3 and session.command_age_steps == 0


def test_a_good_command_restarts_the_watchdog_and_a_refused_one_does_not():
    session = Session(config_of(command_timeout=0.28))
    session.command((5.0, 5.0, 5.0))
    for step in range(1, 15):
        state = session.step()
        if step == 5:
            session.command((5.0, 5.0, 5.0))
        elif step > 5:
            with pytest.raises(CommandError):
                session.command(())
    assert state.voltage == (5.0,) * 3
    session.step()
    assert session.step().voltage == (0.0,) * 3


def test_without_a_command_the_servo_holds_where_the_arm_is():
    session = Session(position_config(command_timeout=0.14))
    session.command((1.5, POSITION[1], POSITION[2]))
    for _ in range(5):
        there = session.step().position
    assert 0.15 < there[0] < 1.4
    for _ in range(150):
        state = session.step()
    np.testing.assert_allclose(state.position, there, atol=2e-3)
    assert np.abs(state.velocity).max() < 1e-3


def test_a_timeout_of_zero_is_never():
    session = Session(config_of(command_timeout=0.0))
    session.command((5.0, 5.0, 5.0))
    assert {session.step().voltage for _ in range(100)} == {(5.0,) * 3}


# ------------------------------------------------------------------------------ position servo


def test_the_position_interface_reaches_its_setpoints():
    session = Session(position_config("coulomb_friction:joint=2,torque=5", command_timeout=0))
    for target in ((0.3, -0.9, 0.8), (-0.2, -1.3, 1.1)):
        session.command(target)
        for _ in range(150):
            state = session.step()
        np.testing.assert_allclose(state.position, target, atol=1e-4)


def test_a_position_session_is_the_servo_of_the_simulator_bit_for_bit():
    servo = ServoConfig((PidGains(500.0, 0.3, 0.02),) * 3, 2.0, 12, 1000, False)
    setpoints = np.array(POSITION) + np.linspace(0, 0.1, 20)[:, None]
    session = Session(position_config(*EFFECTS, servo=servo))
    simulator = Simulator(plant_of(*EFFECTS))
    simulator.reset(POSITION)
    # the session starts at rest with the arm's place as its setpoint, as this run does
    run = simulator.run_servo(np.vstack([[POSITION], setpoints]), servo)
    session.command(POSITION)
    session.step()
    for k, setpoint in enumerate(setpoints, start=2):
        session.command(setpoint)
        state = session.step()
        assert bits(state.position) == bits(run.position[30 * k])
        assert bits(state.voltage) == bits(run.voltage[30 * k - 1])


def test_converter_and_amplifier_show_in_the_volts():
    servo = ServoConfig(amplifier_gain=4.0, converter_bits=12)
    session = Session(position_config(servo=servo))
    step, seen = 2.0 * 40.0 / 4096, set()
    for k in range(30):
        session.command((0.1 + 0.01 * k, POSITION[1], POSITION[2]))
        volts = session.step().voltage
        np.testing.assert_allclose(np.array(volts) / step, np.round(np.array(volts) / step), atol=1e-9)
        seen.update(volts)
    assert len(seen) > 10


def test_a_state_that_stops_being_finite_stays_the_last_finite_one_until_reset():
    plant = plant_of()
    motors = tuple(replace(m, inductance=1e-9) for m in plant.arm.motors)
    session = Session(config_of(plant=replace(plant, arm=replace(plant.arm, motors=motors))))
    session.command((0.0, 0.0, 0.0))
    start = session.state
    with pytest.raises(NonFiniteStateError, match="step 1: the state is no longer") as caught:
        session.command((1.0, 1.0, 1.0))
        session.step()
    assert caught.value.step == 1
    assert session.state is start
    session.reset()
    assert all_bits(session.state) == all_bits(start)


def test_a_period_of_one_servo_sample_is_a_session_too():
    session = Session(position_config(period=SERVO_PERIOD, substeps=1))
    session.command((0.11, -1.1, 0.9))
    for _ in range(300):
        state = session.step()
    assert state.time_ns == 300 * round(SERVO_PERIOD * 1e9)
    assert state.position[0] == pytest.approx(0.11, abs=2e-3)
