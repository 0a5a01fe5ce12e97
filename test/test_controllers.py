# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Controllers as objects: one interface, the compiled servo's bits, schedules, settings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from arm_reference import arm_of, bits, plant_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from puma_sim_core.arm.rigid_body import inertia
from puma_sim_core.control.computed_torque import ComputedTorque
from puma_sim_core.control.controllers import GROUPS, KINDS, load_settings, make_controller
from puma_sim_core.control.metrics import tracking_error
from puma_sim_core.control.scheduled import GainSchedule, ScheduledPid
from puma_sim_core.control.setpoints import Move, joint_path, joint_setpoints
from puma_sim_core.control.velocity_loop import VelocityLoop, VelocityLoopSettings
from puma_sim_core.errors import NonFiniteStateError, ParameterError
from puma_sim_core.resources import config_path
from puma_sim_core.servo.pid import Pid, PidGains
from puma_sim_core.servo.servo import DEFAULT_GAINS, ServoConfig
from puma_sim_core.simulation.feedback import samples_per_period
from puma_sim_core.simulation.simulator import SERVO_PERIOD, Simulator
from puma_sim_core.tuning.schedule_design import placed_gains, schedule_of, ultimate_gains

PLANT = plant_of()
START = (0.0, -1.2, 1.0)
EFFECTS = (
    "coulomb_friction:joint=2,torque=5",
    "presliding_friction:joint=3,torque=6",
    "voltage_saturation:joint=1,voltage=20",
)
SETPOINTS = np.array(START) + 0.02 * np.random.default_rng(3).normal(size=(12, 3)).cumsum(axis=0)
GAINS = (PidGains(900.0, 0.2, 0.03), PidGains(1600.0, 0.3, 0.02), PidGains(800.0))


def columns(run):
    return (
        bits(run.time),
        bits(run.position),
        bits(run.velocity),
        bits(run.current),
        bits(run.voltage),
        bits(run.setpoint),
    )


def simulator_of(*effects, **options):
    simulator = Simulator(plant_of(*effects), **options)
    simulator.reset(START)
    return simulator


def follow(controller, moves, duration, plant=PLANT, **options):
    """(recording, path) from START."""
    _, setpoint = joint_setpoints(START, moves, duration)
    simulator = Simulator(plant)
    simulator.reset(START)
    run = simulator.run_controller(controller, setpoint[:-1], **options)
    return run, joint_path(START, moves, run.time)


LOOPS = {
    "position_gain": (20.0,) * 3,
    "velocity_gain": (25.0, 40.0, 15.0),
    "velocity_time": (0.05,) * 3,
    "greatest_velocity": (2.2, 1.28, 2.5),
    "greatest_acceleration": (15.0, 10.0, 20.0),
}


def computed(model=PLANT, **changes) -> ComputedTorque:
    return make_controller("computed_torque", model, {**load_settings("computed_torque"), **changes})


# ------------------------------------------------------------------------------------ the loop


@pytest.mark.parametrize("effects", [(), EFFECTS], ids=["none", "effects"])
@pytest.mark.parametrize(
    "chain",
    [
        {},
        {"amplifier_gain": 2.5},
        {"encoder_counts": 1000, "converter_bits": 12},
        {"delay_samples": 3, "amplifier_gain": 4.0, "converter_bits": 8, "encoder_counts": 500},
    ],
)
@pytest.mark.parametrize("on_measurement", [False, True])
def test_the_pid_object_gives_the_bits_of_the_compiled_servo(effects, chain, on_measurement):
    limit = 25.0
    servo = ServoConfig(GAINS, derivative_on_measurement=on_measurement, **chain)
    compiled = simulator_of(*effects).run_servo(SETPOINTS, servo, voltage_limit=limit)
    pid = Pid(GAINS, SERVO_PERIOD, limit=limit / servo.amplifier_gain, on_measurement=on_measurement)
    # the gains of the chain are not used
    chain = replace(servo, gains=(PidGains(1.0),) * 3)
    run = simulator_of(*effects).run_controller(pid, SETPOINTS, voltage_limit=limit, chain=chain)
    assert columns(run) == columns(compiled)


def test_a_slow_controller_is_integrated_in_small_steps():
    pid = Pid([PidGains(100.0)] * 3, 0.028, limit=40.0)
    slow = simulator_of().run_controller(pid, SETPOINTS)
    servo = simulator_of().run_servo(SETPOINTS, ServoConfig([PidGains(100.0)] * 3), samples=1)
    assert columns(slow) == columns(servo)
    assert len(slow) == len(SETPOINTS) + 1


def test_a_run_goes_on_where_the_last_one_ended_with_a_controller_that_is_new():
    used = Pid(GAINS, SERVO_PERIOD, limit=40.0)
    simulator = simulator_of()
    simulator.run_controller(used, SETPOINTS)
    state, time = simulator.state, simulator.time
    assert time == pytest.approx(12 * 0.028)
    again = simulator.run_controller(used, SETPOINTS)
    other = Simulator(PLANT)
    other.reset(state[:3], state[3:6], state[6:], time=time)
    fresh = other.run_controller(Pid(GAINS, SERVO_PERIOD, limit=40.0), SETPOINTS)
    assert columns(again) == columns(fresh)


class Spy:
    """A controller that keeps what it is told."""

    def __init__(self, volts=(0.0, 0.0, 0.0), period=0.007):
        self.volts, self.period, self.seen, self.resets = volts, period, [], 0

    def reset(self):
        self.resets += 1

    def update(self, t, setpoint, measurement):
        self.seen.append((t, setpoint, measurement))
        return self.volts


def test_a_controller_is_told_times_setpoints_and_counts():
    spy = Spy((1.0, -2.0, 3.0))
    run = simulator_of().run_controller(spy, SETPOINTS, chain=ServoConfig(encoder_counts=100))
    assert spy.resets >= 1
    assert [t for t, _, _ in spy.seen] == run.time[:-1].tolist()
    assert [s for _, s, _ in spy.seen] == [tuple(s) for s in run.setpoint[:-1].tolist()]
    for (_, _, measured), position in zip(spy.seen, run.position):
        for y, q, motor in zip(measured, position, PLANT.arm.motors):
            counts = y * 100 * motor.gear_ratio / (2.0 * math.pi)
            assert counts == pytest.approx(round(counts), abs=1e-6)
            assert abs(y - q) <= math.pi / (100 * motor.gear_ratio) * (1 + 1e-9)
    assert set(map(tuple, run.voltage.tolist())) == {(1.0, -2.0, 3.0)}


@pytest.mark.parametrize(
    "run, error, message",
    [
        (
            lambda s: s.run_controller(Spy(period=0.005), SETPOINTS),
            ParameterError,
            "controller: its period is 0.005 s; expected a whole part of the 0.028 s",
        ),
        (lambda s: s.run_controller(Spy(period=0.05), SETPOINTS), ParameterError, "its period is"),
        (
            lambda s: s.run_controller(Spy((1.0, 2.0)), SETPOINTS),
            ParameterError,
            "controller: 2 voltages; expected three",
        ),
        (
            lambda s: s.run_controller(Spy((0.0, math.nan, 0.0)), SETPOINTS),
            NonFiniteStateError,
            "step 1: the state is no longer finite",
        ),
        (lambda s: s.run_controller(Spy(), SETPOINTS[:0]), ParameterError, "no setpoint"),
        (lambda s: s.run_controller(Spy(), SETPOINTS[:, :2]), ParameterError, "setpoint of shape"),
        (lambda s: s.run_controller(Spy(), SETPOINTS, voltage_limit=0.0), ParameterError, "voltage_limit 0.0 V"),
        (lambda s: s.run_controller(Spy(), SETPOINTS, period=0.0), ParameterError, "period 0.0 s"),
    ],
)
def test_loops_that_cannot_be_are_named(run, error, message):
    simulator = simulator_of()
    before = simulator.state
    with pytest.raises(error, match=message):
        run(simulator)
    assert simulator.state == before


def test_samples_per_period():
    assert samples_per_period(Spy(period=SERVO_PERIOD), 0.028) == 30
    assert samples_per_period(Spy(period=0.028), 0.028) == 1


# ------------------------------------------------------------------------------------ schedules


Q2, Q3 = (-1.0, 0.5, 2.0), (-0.5, 0.0, 0.25, 1.0)
TABLE = np.random.default_rng(5).uniform(10.0, 100.0, (3, 4))


def schedule(**changes):
    return GainSchedule.from_mapping(
        {
            "q2": list(Q2),
            "q3": list(Q3),
            "gain": [TABLE.tolist(), 5.0, TABLE[:1].tolist()],
            "integral_time": [0.1, math.inf, TABLE[:, :1].tolist()],
            "derivative_time": [0.0, 0.01, TABLE.tolist()],
            **changes,
        }
    )


@given(st.floats(-3.0, 4.0), st.floats(-3.0, 4.0))
def test_gains_are_interpolated_linearly_and_held_beyond_the_edges(q2, q3):
    at = schedule().at(q2, q3)
    inside = np.clip(q2, Q2[0], Q2[-1]), np.clip(q3, Q3[0], Q3[-1])

    def expected(table):
        full = np.broadcast_to(table, (3, 4))
        return RegularGridInterpolator((Q2, Q3), full)(np.array(inside))[0]

    assert at[0] == pytest.approx((expected(TABLE), 0.1, 0.0))
    assert at[1] == (5.0, math.inf, 0.01)
    assert at[2] == pytest.approx((expected(TABLE[:1]), expected(TABLE[:, :1]), expected(TABLE)))


def test_a_schedule_gives_the_numbers_of_its_table_and_survives_its_mapping():
    made = schedule()
    for i, q2 in enumerate(Q2):
        for k, q3 in enumerate(Q3):
            assert made.at(q2, q3)[0][0] == pytest.approx(TABLE[i, k], rel=1e-14)
    text = yaml.safe_dump(made.to_mapping())
    assert GainSchedule.from_mapping(yaml.safe_load(text)) == made


def test_with_equal_gains_everywhere_it_is_the_pid_bit_for_bit():
    for on_measurement in (False, True):
        table = GainSchedule(
            Q2,
            Q3,
            *(
                tuple([[g] * 4] * 3 for g in column)
                for column in zip(*((g.gain, min(g.integral_time, 1e9), g.derivative_time) for g in GAINS))
            ),
        )
        scheduled = ScheduledPid(table, SERVO_PERIOD, limit=20.0, on_measurement=on_measurement)
        pid = Pid(
            [PidGains(g.gain, min(g.integral_time, 1e9), g.derivative_time) for g in GAINS],
            SERVO_PERIOD,
            limit=20.0,
            on_measurement=on_measurement,
        )
        runs = [simulator_of().run_controller(c, SETPOINTS) for c in (scheduled, pid)]
        assert columns(runs[0]) == columns(runs[1])


def test_a_change_of_the_gains_moves_nothing_by_itself():
    table = GainSchedule((-2.0, 2.0), (-2.0, 2.0), ([[1.0], [9.0]],) * 3, (0.5,) * 3, (0.0,) * 3)
    pid = ScheduledPid(table, 0.01)
    for _ in range(100):
        held = pid.update(0.0, (0.1, -2.0, 0.0), (0.0, -2.0, 0.0))
    integral = held[0] - 1.0 * 0.1
    # the pose jumps, and the setpoints with it: no error is left, and the sum is the same in volts
    after = pid.update(0.0, (0.0, 2.0, 0.0), (0.0, 2.0, 0.0))
    assert integral > 0.1 and after[0] == pytest.approx(integral, rel=1e-12)
    pid.reset()
    assert pid.update(0.0, (0.0,) * 3, (0.0,) * 3) == (0.0,) * 3


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: schedule(q2=[1.0, 1.0, 2.0]), "q2 = .*; expected increasing angles"),
        (lambda: schedule(q3=[1.0]), "q3 = .*; expected increasing angles"),
        (lambda: schedule(q3=["a", "b"]), "q3 = .*; expected increasing angles"),
        (lambda: schedule(gain=[1.0, 2.0]), "gain = .*; expected three entries, one for each joint"),
        (lambda: schedule(gain=[[[1.0] * 3] * 3, 1.0, 1.0]), "gain of joint 1 .* 3 rows of 4 numbers"),
        (lambda: schedule(gain=[1.0, "x", 1.0]), "gain of joint 2 = 'x'"),
        (lambda: schedule(gain=[1.0, 0.0, 1.0]), "gain of joint 2 0.0; expected a positive number"),
        (lambda: schedule(integral_time=[1.0, 0.0, 1.0]), "integral_time = 0.0"),
        (lambda: schedule(derivative_time=[-1.0, 0.0, 1.0]), "derivative_time = -1.0"),
        (lambda: schedule(colour=1), "keys .*colour; expected q2, q3, gain"),
        (lambda: GainSchedule.from_mapping([]), "gain schedule: keys"),
        (lambda: ScheduledPid(schedule(), 0.0), "period 0.0 s; expected a positive number"),
        (lambda: ScheduledPid(schedule(), 0.01, limit=-1.0), "limit -1.0 V; expected a positive number"),
        (lambda: ScheduledPid(schedule(), 0.01).update(0.0, (0.0,), (0.0,)), "expected 3 of each"),
    ],
)
def test_schedules_that_cannot_be_are_named(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


@settings(max_examples=30)
@given(st.floats(-3.8, 0.7), st.floats(-0.9, 4.0), st.floats(30.0, 80.0))
def test_placed_gains_put_the_poles_where_they_should_be(q2, q3, b):
    pose = np.array([0.3, q2, q3])
    mass = np.diag(inertia(pose, PLANT.arm)) + PLANT.arm.motor_inertia
    for j, (kg, ti, td) in enumerate(placed_gains(PLANT, pose, (b,) * 3)):
        motor = PLANT.arm.motors[j]
        per = motor.resistance * mass[j] / PLANT.torque_per_ampere[j]
        own = motor.back_emf * motor.gear_ratio
        if td > 0.0:
            poles = np.roots([per, own + kg * td, kg, kg / ti])
            np.testing.assert_allclose(poles, -b, rtol=1e-3)
        else:
            assert own >= 3.0 * b * per


# ------------------------------------------------------------------------------ config and factory


def grid(found):
    return found["q2"], found["q3"]


@pytest.mark.parametrize(
    "group, gains_at",
    [
        ("servo", lambda poses: placed_gains(PLANT, poses, (40.0,) * 3)),
        ("external", lambda poses: ultimate_gains(PLANT, poses, 0.028, 1)),
    ],
)
def test_the_tables_of_the_configuration_are_those_of_their_design(group, gains_at):
    found = load_settings("scheduled", group)
    found.pop("derivative_on_measurement")
    table = GainSchedule.from_mapping(found)
    design = schedule_of(*grid(found), gains_at)
    for q2 in found["q2"]:
        for q3 in found["q3"]:
            np.testing.assert_allclose(table.at(q2, q3), design.at(q2, q3), rtol=0.012)


def test_the_grids_cover_the_ranges_of_the_joints():
    for group in GROUPS:
        found = load_settings("scheduled", group)
        for angles, (low, high) in zip(grid(found), arm_of("bejczy").joint_ranges[1:]):
            assert angles[0] <= low and angles[-1] >= high


def test_the_pid_of_the_configuration_is_that_of_the_servo_and_of_the_nodes():
    servo, external = (load_settings("pid", group) for group in GROUPS)
    assert [PidGains(*row) for row in zip(servo["gain"], servo["integral_time"], servo["derivative_time"])] == list(
        DEFAULT_GAINS
    )
    assert servo["derivative_on_measurement"] == ServoConfig().derivative_on_measurement
    for file, node, place, expected in (
        ("sim_node.yaml", "/**/sim_node", "servo", servo),
        ("external_controller.yaml", "/**/external_controller", None, external),
    ):
        found = yaml.safe_load(config_path(file).read_text())[node]["ros__parameters"]
        found = found[place] if place else found
        for name in ("gain", "integral_time", "derivative_time"):
            assert found[name] == expected[name]


@pytest.mark.parametrize("group, period", [("servo", SERVO_PERIOD), ("external", 0.028)])
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_controller_follows_a_path_from_its_configuration(kind, group, period):
    controller = make_controller(kind, PLANT.arm, load_settings(kind, group), period)
    assert controller.period == period
    moves = [Move(0.28, 1.5, (0.6, -0.4, 0.5))]
    # the external ones must bear a sample that comes late
    run, path = follow(controller, moves, 5.6, chain=ServoConfig(delay_samples=int(group == "external")))
    assert np.abs(run.voltage).max() <= 40.0
    assert tracking_error(run, path).worst.max() < 0.05
    np.testing.assert_allclose(run.position[-1], path[-1], atol=2e-3)
    again, _ = follow(controller, moves, 5.6, chain=ServoConfig(delay_samples=int(group == "external")))
    assert columns(again) == columns(run)


@pytest.mark.parametrize("kind", KINDS)
def test_the_amplifier_changes_nothing_but_the_scale_of_a_model_based_controller(kind):
    moves = [Move(0.28, 0.6, (0.3, -0.2, 0.2))]
    found = []
    for gain in (1.0, 4.0):
        settings_of = load_settings(kind)
        if kind != "computed_torque":
            settings_of["gain"] = [(np.array(g) / gain).tolist() for g in settings_of["gain"]]
        controller = make_controller(kind, PLANT, settings_of, amplifier_gain=gain)
        found.append(follow(controller, moves, 1.4, chain=ServoConfig(amplifier_gain=gain))[0])
    np.testing.assert_allclose(found[0].position, found[1].position, atol=1e-9)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: make_controller("pd", PLANT), "controller 'pd'; expected pid or scheduled or"),
        (lambda: load_settings("pid", "slow"), "group 'slow'; expected servo or external"),
        (lambda: load_settings("pid", path="/nowhere.yaml"), "/nowhere.yaml: cannot be read"),
        (
            lambda: load_settings("scheduled", path=config_path("sim_node.yaml")),
            "sim_node.yaml: no settings servo: scheduled",
        ),
        (lambda: make_controller("pid", PLANT, 7), "controller 'pid': settings 7; expected a mapping"),
        (lambda: make_controller("pid", PLANT, {}), "derivative_on_measurement = None"),
        (
            lambda: make_controller("pid", PLANT, {"derivative_on_measurement": True, "gain": [1.0]}),
            "controller 'pid': keys gain",
        ),
        (
            lambda: make_controller("pid", PLANT, {**load_settings("pid"), "gain": [1.0]}),
            "expected three numbers of each",
        ),
        (lambda: make_controller("pid", PLANT, voltage_limit=0.0), "voltage_limit 0.0 V"),
        (
            lambda: make_controller("computed_torque", PLANT, {"bandwidth": [1.0] * 3}),
            "computed torque: keys bandwidth; expected bandwidth, velocity_filter",
        ),
        (lambda: computed(bandwidth=[1.0, 2.0]), "bandwidth = .* three positive numbers"),
        (lambda: computed(bandwidth=["a"] * 3), "computed torque"),
        (lambda: computed(velocity_filter=0.0), "velocity_filter 0.0 rad/s; expected a positive number"),
        (lambda: computed(back_emf="guessed"), "back_emf 'guessed'; expected measured or reference"),
        (lambda: computed(lead=2.0), "lead 2.0"),
        (lambda: computed(greatest_velocity=[0.0] * 3), "greatest velocity"),
        (lambda: computed(greatest_velocity=[1.0] * 4), "greatest velocity"),
        (lambda: computed(greatest_velocity=["a"] * 3), "greatest velocity"),
        (lambda: make_controller("computed_torque", PLANT, period=0.005), "period = 0.005 s"),
        (lambda: make_controller("computed_torque", PLANT).update(0.0, (0.0,), (0.0,)), "3 of each"),
        (
            lambda: VelocityLoop(VelocityLoopSettings(**LOOPS | {"velocity_gain": (0.0, 1.0, 1.0)}), 0.028),
            "velocity_gain",
        ),
    ],
)
def test_settings_that_cannot_be_are_named(make, message):
    with pytest.raises(ParameterError, match=message):
        make()
