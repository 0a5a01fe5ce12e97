# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Controllers and setpoints: the PID law in all its forms, the servo's chain, straight lines."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from arm_reference import arm_of, bits, plant_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from puma_sim_core.arm.inverse_kinematics import wrist_angles
from puma_sim_core.arm.kinematics import wrist_motion, wrist_path, wrist_position
from puma_sim_core.control.setpoints import smooth_share, straight_line, vertical_line
from puma_sim_core.errors import ParameterError
from puma_sim_core.jit import interpreted
from puma_sim_core.servo.pid import Pid, PidGains
from puma_sim_core.servo.servo import ServoConfig, quantised
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator

GAINS = (PidGains(900.0, 0.2, 0.03), PidGains(1600.0, 0.3, 0.02), PidGains(800.0))
ARM = arm_of("bejczy")
errors = st.lists(st.floats(-1, 1), min_size=3, max_size=30)
gains = st.builds(PidGains, st.floats(0.1, 5e3), st.floats(0.01, 10), st.floats(0, 0.1))


def outputs(pid, setpoints, measurements):
    return [pid.update(k * pid.period, [r], [y])[0] for k, (r, y) in enumerate(zip(setpoints, measurements))]


# --------------------------------------------------------------------------------------- the law


@given(gains, errors)
def test_pid_is_the_positional_form_with_its_sum(g, e):
    h = SERVO_PERIOD
    found = outputs(Pid([g], h), e, [0.0] * len(e))
    for k, u in enumerate(found):
        before = e[k - 1] if k else e[0]
        expected = g.gain * (
            e[k] + h / g.integral_time * math.fsum(e[: k + 1]) + g.derivative_time / h * (e[k] - before)
        )
        assert u == pytest.approx(expected, rel=1e-9, abs=1e-9 * g.gain)


@given(gains, errors)
def test_pid_equals_the_recursive_form_while_it_is_not_limited(g, e):
    # q0, q1, q2 of equations 7.5 to 7.7, 7.6 with its minus; their sum ends one sample earlier
    h = 0.028
    q0 = g.gain * (1.0 + g.derivative_time / h)
    q1 = -g.gain * (1.0 + 2.0 * g.derivative_time / h - h / g.integral_time)
    q2 = g.gain * g.derivative_time / h
    found = [u - g.gain * h / g.integral_time * x for u, x in zip(outputs(Pid([g], h), e, [0.0] * len(e)), e)]
    assert found[0] == pytest.approx(g.gain * e[0], abs=1e-9 * g.gain)
    for k in range(2, len(e)):
        assert found[k] == pytest.approx(
            found[k - 1] + q0 * e[k] + q1 * e[k - 1] + q2 * e[k - 2],
            rel=1e-9,
            abs=1e-8 * g.gain * (1 + g.derivative_time / h),
        )
    # and back from them
    assert q0 - q2 == pytest.approx(g.gain)
    assert g.gain * h / (q0 + q1 + q2) == pytest.approx(g.integral_time, rel=1e-6)


def test_derivative_on_the_measurement_does_not_kick():
    g = PidGains(100.0, math.inf, 0.1)
    kick = outputs(Pid([g], 0.01), [0.0, 1.0], [0.0, 0.0])
    calm = outputs(Pid([g], 0.01, on_measurement=True), [0.0, 1.0], [0.0, 0.0])
    assert kick == [0.0, 1100.0] and calm == [0.0, 100.0]
    moving = outputs(Pid([g], 0.01, on_measurement=True), [0.0, 0.0], [0.0, 0.5])
    assert moving == outputs(Pid([g], 0.01), [0.0, 0.0], [0.0, 0.5])


def test_the_first_sample_has_no_derivative_and_reset_makes_a_first_sample():
    for on_measurement in (False, True):
        pid = Pid([PidGains(10.0, math.inf, 1.0)], 0.01, on_measurement=on_measurement)
        assert pid.update(0.0, [3.0], [1.0]) == (20.0,)
        pid.update(0.01, [5.0], [2.0])
        pid.reset()
        assert pid.update(0.02, [3.0], [1.0]) == (20.0,)


@given(gains, errors, st.floats(0.1, 50))
def test_output_is_limited_and_its_sum_stops_there(g, e, limit):
    pid = Pid([g], 0.01, limit=limit)
    assert all(abs(u) <= limit for u in outputs(pid, e, [0.0] * len(e)))


def test_a_sum_that_waited_at_the_limit_lets_go_at_once():
    # a minute of an error that the limit keeps from being corrected, then a small one the other way
    g = PidGains(100.0, 0.5, 0.0)
    pid, free = Pid([g], 0.01, limit=10.0), Pid([g], 0.01, limit=10.0)
    held = outputs(pid, [1.0] * 6000, [0.0] * 6000)
    assert set(held) == {10.0}
    assert pid.update(60.0, [-0.01], [0.0]) == free.update(0.0, [-0.01], [0.0])


def test_joints_do_not_know_of_each_other():
    pid = Pid(GAINS, 0.01)
    alone = [Pid([g], 0.01) for g in GAINS]
    for k in range(10):
        r, y = [math.sin(k + j) for j in range(3)], [math.cos(k * j) for j in range(3)]
        together = pid.update(0.01 * k, r, y)
        assert together == tuple(p.update(0.01 * k, [a], [b])[0] for p, a, b in zip(alone, r, y))


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: PidGains(-1.0), "gain = -1.0; expected a number of at least 0"),
        (lambda: PidGains(math.nan), "gain = nan"),
        (lambda: PidGains(math.inf), "gain = inf"),
        (lambda: PidGains("5"), "gain = '5'"),
        (lambda: PidGains(True), "gain = True"),
        (lambda: PidGains(1.0, 0.0), "integral_time = 0.0; expected a number of at least 1e-09"),
        (lambda: PidGains(1.0, 1.0, -0.1), "derivative_time = -0.1"),
        (lambda: Pid(GAINS, 0.0), "period 0.0 s; expected a positive number"),
        (lambda: Pid(GAINS, 0.01, limit=0.0), "limit 0.0 V; expected a positive number"),
        (lambda: Pid(GAINS, 0.01, limit=math.nan), "limit nan"),
        (lambda: Pid(GAINS, 0.01).update(0.0, [0.0], [0.0] * 3), "expected 3 of each"),
        (lambda: ServoConfig(gains=GAINS[:2]), "servo: gains .* expected PidGains of three joints"),
        (lambda: ServoConfig(amplifier_gain=0.0), "amplifier_gain 0.0; expected a positive number"),
        (lambda: ServoConfig(converter_bits=1), "converter_bits 1; expected a whole number from 2 to"),
        (lambda: ServoConfig(converter_bits=12.0), "converter_bits 12.0"),
        (lambda: ServoConfig(encoder_counts=0), "encoder_counts 0; expected a whole number from 1"),
        (lambda: ServoConfig(encoder_counts=True), "encoder_counts True"),
        (lambda: ServoConfig.from_mapping({"speed": 1}), "servo: .*speed.*; expected the keys"),
        (lambda: ServoConfig.from_mapping({"gains": [{"gain": 1.0}]}), "PidGains of three joints"),
    ],
)
def test_controllers_that_cannot_be_are_refused(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


# --------------------------------------------------------------------------------- servo's chain


STEPS = 0.02 * np.random.default_rng(3).normal(size=(12, 3))
SETPOINTS = np.array([0.0, -1.0, 0.5]) + STEPS.cumsum(axis=0)


def servo_run(servo, limit=40.0):
    simulator = Simulator(plant_of("coulomb_friction:joint=2,torque=5"))
    simulator.reset((0.01, -1.0, 0.5))
    return simulator.run_servo(SETPOINTS, servo, voltage_limit=limit)


@pytest.mark.parametrize("on_measurement", [False, True])
@pytest.mark.parametrize("gain, counts, limit", [(1.0, None, 40.0), (4.0, None, 15.0), (2.5, 1000, 20.0)])
def test_servo_in_the_kernel_is_the_pid_class_bit_for_bit(on_measurement, gain, counts, limit):
    servo = ServoConfig(GAINS, amplifier_gain=gain, encoder_counts=counts, derivative_on_measurement=on_measurement)
    run = servo_run(servo, limit)
    pid = Pid(GAINS, SERVO_PERIOD, limit=limit / gain, on_measurement=on_measurement)
    turns = [2.0 * math.pi / (counts * m.gear_ratio) if counts else 0.0 for m in ARM.motors]
    limited = 0
    for row in range(len(run) - 1):
        measured = [
            math.floor(q / step + 0.5) * step if step else q for q, step in zip(run.position[row].tolist(), turns)
        ]
        volts = pid.update(run.time[row], run.setpoint[row], measured)
        assert bits([u * gain for u in volts]) == bits(run.voltage[row])
        limited += sum(abs(u) == limit / gain for u in volts)
    assert limited > 5


def test_a_delay_holds_each_voltage_back_by_its_samples():
    run = servo_run(ServoConfig(GAINS, delay_samples=3))
    pid = Pid(GAINS, SERVO_PERIOD, limit=40.0, on_measurement=True)
    asked = [pid.update(t, r, y) for t, r, y in zip(run.time, run.setpoint, run.position)]
    assert not run.voltage[:3].any()
    assert bits(run.voltage[3:-1]) == bits(asked[:-4])


def test_converter_gives_multiples_of_its_step_in_its_range():
    servo = ServoConfig(GAINS, amplifier_gain=4.0, converter_bits=12)
    volts = servo_run(servo).voltage
    step = 2.0 * 40.0 / 4096
    codes = volts / step
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-9)
    assert codes.min() == -2048 and codes.max() == 2047
    assert (np.abs(volts - servo_run(ServoConfig(GAINS, amplifier_gain=4.0)).voltage)[0] <= step * 1.0001).all()


def test_encoder_counts_are_those_of_the_motor_shaft():
    table = ServoConfig(encoder_counts=1000).table(SERVO_PERIOD, 40.0, [m.gear_ratio for m in ARM.motors])
    width = len(table) // 3
    assert table[4::width] == pytest.approx([2 * math.pi / (1000 * n) for n in (62.55, 107.81, 53.63)])
    # a coarse encoder that sees no motion lets the arm stand: with an ideal one it is corrected
    coarse = ServoConfig(encoder_counts=1, derivative_on_measurement=True)
    simulator = Simulator(plant_of())
    simulator.reset((0.01, -math.pi / 2, math.pi / 2))
    assert not simulator.run_servo([[0.0, 0.0, 0.0]], coarse).voltage[0, 0]


@given(st.floats(-1e3, 1e3), st.floats(1e-6, 1.0))
def test_quantised_is_the_nearest_multiple(value, step):
    found = interpreted(quantised)(value, step)
    assert abs(found - value) <= step * (0.5 + 1e-9 + 1e-15 * abs(value) / step)
    assert abs(found / step - round(found / step)) < 1e-6
    assert interpreted(quantised)(value, 0.0) == value


def test_servo_config_survives_its_mapping():
    servo = ServoConfig(GAINS, 2.5, 12, 1000, False)
    assert ServoConfig.from_mapping(servo.to_mapping()) == servo
    assert ServoConfig.from_mapping({}) == ServoConfig()


# -------------------------------------------------------------------------- inverse and setpoints


def well_placed(q):
    """Away from the axis of joint 1 and from a stretched or folded arm."""
    x, y, z = wrist_position(q, ARM)
    flat = math.hypot(x, y)
    reach = math.hypot(math.sqrt(max(flat**2 - ARM.d3**2, 0.0)), z)
    rho = math.hypot(ARM.a3, ARM.d4)
    return flat > ARM.d3 + 0.02 and abs(ARM.a2 - rho) + 0.02 < reach < ARM.a2 + rho - 0.01


@settings(max_examples=300)
@given(*[st.floats(low, high) for low, high in ARM.joint_ranges])
def test_wrist_angles_invert_the_wrist_position(q1, q2, q3):
    q = np.array([q1, q2, q3])
    assume(well_placed(q))
    point = wrist_position(q, ARM)
    np.testing.assert_allclose(wrist_path(np.array([q, -q]), ARM)[0], point, rtol=0, atol=1e-15)
    moved = wrist_position(q + 1e-30j * np.array([0.3, -0.7, 1.1]), ARM).imag / 1e-30
    np.testing.assert_allclose(wrist_motion(q, (0.3, -0.7, 1.1), ARM)[1], moved, rtol=0, atol=1e-14)
    np.testing.assert_allclose(wrist_angles(point, ARM, q), q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        wrist_position(wrist_angles(point, ARM, (0.0, 0.0, 0.0)), ARM), point, rtol=0, atol=1e-12
    )


@settings(max_examples=50)
@given(*[st.floats(low, high) for low, high in ARM.joint_ranges])
def test_all_four_solutions_are_reached_by_where_the_arm_is(q1, q2, q3):
    q = np.array([q1, q2, q3])
    assume(well_placed(q))
    point = wrist_position(q, ARM)
    found = {}
    for near in product(np.linspace(-math.pi, math.pi, 6), repeat=3):
        solution = wrist_angles(point, ARM, near)
        np.testing.assert_allclose(wrist_position(solution, ARM), point, atol=1e-12)
        found.setdefault(tuple(np.round(np.exp(1j * solution), 6)), solution)
        # whole turns apart from the nearest, never more than half a turn away
        assert np.abs(solution - near).max() <= math.pi + 1e-12
    assert len(found) == 4
    for solution in found.values():
        np.testing.assert_allclose(wrist_angles(point, ARM, solution), solution, atol=1e-12)


@pytest.mark.parametrize(
    "point, message",
    [
        (
            (0.0, 0.0, 0.5),
            r"wrist at \(0.0000, 0.0000, 0.5000\) m: too near to the axis of joint 1; "
            "expected a distance of at least 0.1505 m",
        ),
        ((1.0, 0.0, 0.0), "out of reach; expected a distance from the shoulder between 0.0017 and 0.8653 m"),
        ((0.0, 0.1505, 0.0), "out of reach"),
    ],
)
def test_points_out_of_reach_are_named(point, message):
    with pytest.raises(ParameterError, match=message):
        wrist_angles(point, ARM, (0.0, 0.0, 0.0))


def test_a_stretched_arm_is_in_reach():
    q = np.array([0.3, -0.4, math.atan2(ARM.d4, ARM.a3)])
    point = wrist_position(q, ARM)
    np.testing.assert_allclose(wrist_position(wrist_angles(point, ARM, q), ARM), point, atol=1e-9)


START = (0.2, -0.6, 0.6)


@pytest.mark.parametrize(
    "displacement, duration", [((0.0, 0.0, -0.3), 2.0), ((-0.05, 0.0, 0.05), 0.5), ((0.1, -0.2, -0.1), 1.7)]
)
def test_a_line_is_straight_and_starts_and_ends_at_rest(displacement, duration):
    time, setpoint = straight_line(ARM, START, displacement, duration)
    points = np.array([wrist_position(q, ARM) for q in setpoint])
    share = smooth_share(time / duration)
    np.testing.assert_allclose(points, points[0] + np.outer(share, displacement), rtol=0, atol=1e-12)
    assert (setpoint[0] == START).all()
    np.testing.assert_allclose(points[-1] - points[0], displacement, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.diff(time), 0.028, atol=1e-12)
    assert duration <= time[-1] + 1e-9 < duration + 0.028 + 1e-9
    speed = np.linalg.norm(np.diff(setpoint, axis=0), axis=1)
    assert speed[0] < 0.05 * speed.max() and speed[-1] < 0.05 * speed.max()
    assert np.abs(np.diff(setpoint, n=2, axis=0)).max() < 0.02


def test_the_vertical_line_of_section_7_5_keeps_its_horizontal_place():
    _, setpoint = vertical_line(ARM, START, -0.4, 3.0)
    points = np.array([wrist_position(q, ARM) for q in setpoint])
    assert np.ptp(points[:, :2], axis=0).max() < 1e-12
    assert (np.diff(points[:, 2]) < 1e-12).all()


def test_smooth_share_is_at_rest_at_both_ends():
    tau = np.linspace(0.0, 1.0, 1001)
    share = smooth_share(tau)
    assert share[0] == 0.0 and share[-1] == 1.0 and (np.diff(share) >= 0.0).all()
    np.testing.assert_allclose(share + share[::-1], 1.0, atol=1e-14)
    for order in (1, 2):
        assert abs(np.diff(share, n=order)[[0, -1]]).max() < 1e-4**order * 100
    assert smooth_share(-1.0) == 0.0 and smooth_share(2.0) == 1.0


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((START, 1.0, 3.0), "out of reach"),
        (
            ((0.0, -2.5, -0.8), 0.4, 3.0),
            r"wrist at height .* m: joint 3 at .* rad; expected .* rad along the whole line",
        ),
        (((0.0, 1.0, 0.0), -0.1, 3.0), "joint 2 at 1.0000 rad"),
        ((START, -0.1, 0.0), "duration 0.0 s; expected a positive number"),
        ((START, -0.1, math.nan), "duration nan s"),
        ((START, -0.1, 1.0, -1.0), "period -1.0 s"),
    ],
)
def test_lines_that_cannot_be_followed_are_named(arguments, message):
    with pytest.raises(ParameterError, match=message):
        vertical_line(ARM, *arguments)
