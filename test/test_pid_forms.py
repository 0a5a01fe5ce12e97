# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Forms and options of the PID law, and the same options of the compiled servo."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from arm_reference import bits, plant_of

from puma_sim_core.errors import ParameterError
from puma_sim_core.servo.pid import Pid, PidGains, gains_of_recursive, recursive_coefficients
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.session import Session, SessionConfig
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

H = SERVO_PERIOD
GAINS = PidGains(90.0, 0.225, 0.05625)
START = (0.1, -0.4, 0.7)


def outputs(pid, setpoint, measurement):
    return np.array([pid.update(k * H, (r,), (y,))[0] for k, (r, y) in enumerate(zip(setpoint, measurement))])


def random_signals(rows=200, seed=4):
    random = np.random.default_rng(seed)
    return random.normal(0.0, 0.1, rows), np.cumsum(random.normal(0.0, 0.01, rows))


# ------------------------------------------------------------------------------------ velocity form


def test_velocity_form_is_the_recursion_of_equation_7_3():
    setpoint, measurement = random_signals()
    q0, q1, q2 = recursive_coefficients(GAINS, H)
    u = outputs(Pid((GAINS,), H, form="velocity"), setpoint, measurement)
    e = setpoint - measurement
    expected = u[1:-1] + q0 * e[2:] + q1 * e[1:-1] + q2 * e[:-2]
    np.testing.assert_allclose(u[2:], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("on_measurement", [False, True])
@pytest.mark.parametrize(
    "gains", [GAINS, PidGains(50.0), PidGains(50.0, inf, 0.03), PidGains(50.0, 0.1)], ids=["PID", "P", "PD", "PI"]
)
def test_without_limits_the_forms_differ_by_the_newest_term_of_the_sum(gains, on_measurement):
    setpoint, measurement = random_signals()
    options = {"on_measurement": on_measurement}
    positional = outputs(Pid((gains,), H, **options), setpoint, measurement)
    velocity = outputs(Pid((gains,), H, form="velocity", **options), setpoint, measurement)
    newest = gains.gain * H / gains.integral_time * (setpoint - measurement)
    np.testing.assert_allclose(velocity, positional - newest, rtol=1e-9, atol=1e-8)


def test_coefficients_by_hand():
    # Kg = 2, Ti = .5, Td = .1, h = .05: Td/h = 2, h/Ti = .1
    assert recursive_coefficients(PidGains(2.0, 0.5, 0.1), 0.05) == pytest.approx((6.0, -9.8, 4.0))


def test_corrected_coefficients_add_up_to_the_integral_action():
    # a constant error moves the output by Kg h/Ti a sample; with the printed q1 it would run away
    q = recursive_coefficients(GAINS, H)
    assert sum(q) == pytest.approx(GAINS.gain * H / GAINS.integral_time, rel=1e-9)
    printed = GAINS.gain * (1.0 + 2.0 * GAINS.derivative_time / H - H / GAINS.integral_time)
    assert q.q1 == -printed and q.q0 + printed + q.q2 > 1e4


def test_gains_come_back_from_the_coefficients():
    for gains in (GAINS, PidGains(2.0, 0.5, 0.1), PidGains(3.0, inf, 0.0)):
        back = gains_of_recursive(*recursive_coefficients(gains, H), H)
        assert back.gain == pytest.approx(gains.gain, rel=1e-9)
        assert back.derivative_time == pytest.approx(gains.derivative_time, rel=1e-9)
        assert back.integral_time == pytest.approx(gains.integral_time, rel=1e-6)


@pytest.mark.parametrize("q", [(1.0, 0.0, 2.0), (3.0, -1.0, -1.0), (1.0, -5.0, 0.5)])
def test_coefficients_of_no_pid_are_refused(q):
    with pytest.raises(ParameterError, match="PID coefficients: q = .*; expected q0 > q2 >= 0"):
        gains_of_recursive(*q, H)


def test_unknown_form_is_refused():
    with pytest.raises(ParameterError, match="form 'fast'; expected positional or velocity"):
        Pid((GAINS,), H, form="fast")


# -------------------------------------------------------------------------------------- anti-windup


def windup(**options):
    """Samples after a long time at the limit until the output leaves it, of 2000."""
    pid = Pid((PidGains(10.0, 0.05),), H, limit=5.0, **options)
    setpoint = np.where(np.arange(4000) < 2000, 1.0, -0.1)
    u = outputs(pid, setpoint, np.zeros(4000))
    assert np.abs(u).max() <= 5.0 and u[1999] == 5.0
    return int((np.maximum.accumulate(u[2000:] < 5.0) == 0).sum())


@pytest.mark.parametrize("form", ["positional", "velocity"])
def test_anti_windup_lets_go_of_the_limit_at_once(form):
    assert windup(form=form) <= 1
    assert windup(form=form, anti_windup=False) > 1000


def test_velocity_form_keeps_its_proportional_action_through_the_limit():
    pid = Pid((PidGains(100.0),), H, limit=5.0, form="velocity")
    u = outputs(pid, np.array([0.01, 1.0, 1.0, 0.01]), np.zeros(4))
    np.testing.assert_allclose(u, [1.0, 5.0, 5.0, 1.0], rtol=1e-12)


def test_reset_forgets():
    setpoint, measurement = random_signals(20)
    for form in ("positional", "velocity"):
        pid = Pid((GAINS,), H, form=form, limit=3.0)
        first = outputs(pid, setpoint, measurement)
        pid.reset()
        assert bits(outputs(pid, setpoint, measurement)) == bits(first)


# ------------------------------------------------------------------------------- the compiled servo


def servo_run(servo=ServoConfig(), rows=12, simulator=None, **options):
    simulator = simulator or Simulator(plant_of())
    simulator.reset(START)
    setpoint = np.array(START) + 0.2 * np.sin(np.arange(rows)[:, None] * np.array([0.5, 0.4, 0.7]))
    return simulator.run_servo(setpoint, servo, **options)


@pytest.mark.parametrize("anti_windup", [True, False])
@pytest.mark.parametrize("delay", [0, 1, 4])
def test_servo_is_the_python_law_with_its_answers_late(delay, anti_windup):
    servo = ServoConfig(delay_samples=delay, anti_windup=anti_windup)
    record = servo_run(servo, voltage_limit=8.0)
    pid = Pid(servo.gains, H, limit=8.0, on_measurement=True, anti_windup=anti_windup)
    asked = [pid.update(0.0, r, y) for r, y in zip(record.setpoint[:-1], record.position[:-1])]
    expected = np.vstack([np.zeros((delay, 3)), asked])[: len(asked)]
    np.testing.assert_allclose(record.voltage[:-1], expected, rtol=0, atol=1e-9)
    assert np.abs(record.voltage).max() == 8.0


def test_voltages_asked_for_before_the_start_act_first():
    held = (3.0, -2.0, 1.0)
    record = servo_run(ServoConfig(delay_samples=3), held_voltage=held)
    np.testing.assert_array_equal(record.voltage[:3], [held] * 3)
    assert not (record.voltage[3] == held).any()


def test_samples_longer_than_a_step_are_integrated_in_steps():
    servo = ServoConfig(tuple(PidGains(20.0) for _ in range(3)))
    slow = servo_run(servo, samples=1)
    simulator = Simulator(plant_of())
    simulator.reset(START)
    again = simulator.run(slow.time, slow.voltage)
    # the lengths of the rows are differences of the times, which are rounded
    np.testing.assert_allclose(again.position, slow.position, rtol=0, atol=1e-14)
    assert len(slow.time) == 13 and slow.time[1] == 0.028


def test_a_session_with_a_delay_is_the_same_servo():
    servo = ServoConfig(delay_samples=7, anti_windup=False)
    config = SessionConfig(plant=plant_of(), command_interface="position", servo=servo, initial_position=START)
    assert SessionConfig.from_mapping(config.to_mapping()) == config
    session, simulator = Session(config), Simulator(plant_of())
    simulator.reset(START)
    target = np.array(START) + 0.1
    session.command(target)
    for _ in range(5):
        session.step()
    # its servo starts at rest at the initial position
    record = simulator.run_servo(np.tile(target, (5, 1)), servo)
    np.testing.assert_allclose(session.state.position, record.position[-1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("delay", [-1, 1.0, True, 10**9])
def test_delays_that_cannot_be_are_refused(delay):
    with pytest.raises(ParameterError, match="delay_samples .*; expected a whole number"):
        ServoConfig(delay_samples=delay)
