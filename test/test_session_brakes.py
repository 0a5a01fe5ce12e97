# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Brakes, stops, placements and other effects in the middle of a session."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from puma_sim_core import jit
from puma_sim_core.effects import parse_effect
from puma_sim_core.errors import CommandError, ParameterError
from puma_sim_core.plant.plant import Plant
from puma_sim_core.plant.stops import with_stops
from puma_sim_core.simulation.session import Session
from puma_sim_core.simulation.session_config import SessionConfig

START = (0.3, -0.9, 0.6)
INTERFACES = ("voltage", "position")


def session(interface="voltage", effects=(), **changes) -> Session:
    plant = Plant.of("bejczy", [parse_effect(text) for text in effects])
    options = {"command_interface": interface, "initial_position": START, "brakes": True, "command_timeout": 0.112}
    return Session(SessionConfig(plant, **{**options, **changes}))


def rest(interface):
    """A command that asks for nothing: 0 V, or the pose at the start."""
    return (0.0, 0.0, 0.0) if interface == "voltage" else START


@pytest.mark.parametrize("interface", INTERFACES)
def test_the_arm_stands_still_until_the_first_good_command(interface):
    arm = session(interface)
    for _ in range(50):
        with pytest.raises(CommandError):
            arm.command((math.nan, 0.0, 0.0))
        state = arm.step()
        assert arm.braked and state.position == START
        assert state.velocity == state.voltage == (0.0, 0.0, 0.0)
    arm.command(rest(interface))
    assert not arm.braking
    state = arm.step()
    assert not arm.braked and state.position != START


@pytest.mark.parametrize("interface", INTERFACES)
def test_once_released_the_arm_moves_as_one_without_brakes(interface):
    braked, free = session(interface, command_timeout=0.0), session(interface, brakes=False, command_timeout=0.0)
    for _ in range(7):
        braked.step()
    for step in range(40):
        target = tuple(v + 0.01 * step for v in rest(interface))
        braked.command(target)
        free.command(target)
        one, other = braked.step(), free.step()
        # the motors' currents have died away from nothing: both begin with none
        assert one[2:] == other[2:]


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("effects", [(), ("input_delay:time=0.035",), ("joint_elasticity:joint=2,stiffness=2e4",)])
def test_after_a_time_out_the_brakes_hold_and_a_command_lets_go_again(interface, effects):
    arm = session(interface, effects)
    away = tuple(v + d for v, d in zip(rest(interface), (20.0, 20.0, 20.0) if interface == "voltage" else (0.5,) * 3))
    arm.command(away)
    for _ in range(4):
        arm.step()
        assert not arm.braked
    moving = arm.state
    assert abs(moving.velocity[0]) > 0.1
    for _ in range(20):
        state = arm.step()
        assert arm.braked and state.position == moving.position
        assert state.velocity == state.voltage == (0.0, 0.0, 0.0)
    assert arm.counters.braked == 1
    # the controller begins at rest: what it summed up before the brakes is gone
    arm.command(rest(interface) if interface == "voltage" else moving.position)
    state = arm.step()
    assert not arm.braked
    assert max(abs(v) for v in state.voltage) < 16.0


def test_brakes_by_hand_and_an_arm_without_them():
    arm = session()
    arm.brake(False)
    first = arm.step()
    assert not arm.braked and first.position != START and first.voltage == (0.0, 0.0, 0.0)
    arm.command((5.0, 5.0, 5.0))
    arm.brake(True)
    state = arm.step()
    assert arm.braked and state.position == first.position
    with pytest.raises(CommandError, match="no brakes"):
        session(brakes=False).brake(True)


def test_the_last_word_between_two_steps_counts():
    arm = session()
    arm.brake(True)
    arm.command((5.0, 5.0, 5.0))
    arm.step()
    assert not arm.braked and arm.state.voltage == (5.0, 5.0, 5.0)


def test_the_mapping_of_a_session_keeps_its_brakes():
    config = session().config
    assert SessionConfig.from_mapping(config.to_mapping()) == config
    assert "brakes" not in replace(config, brakes=False).to_mapping()
    with pytest.raises(ParameterError, match="brakes"):
        replace(config, brakes=1)


# ---- stops


@pytest.mark.parametrize("substeps", [30, 4])
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, -1, -1), (1, -1, 1), (-1, 1, -1)])
def test_no_joint_gets_further_than_a_degree_beyond_its_range(substeps, signs):
    plant = with_stops(Plant.of("bejczy"))
    arm = Session(SessionConfig(plant, initial_position=(0.0, -1.5, 1.0), substeps=substeps, command_timeout=0.0))
    arm.command([40.0 * sign for sign in signs])
    for _ in range(500):
        state = arm.step()
        for q, (low, high) in zip(state.position, plant.arm.joint_ranges):
            assert low - math.radians(1.0) < q < high + math.radians(1.0)
    # pressed against its stops it has come to rest, and says so
    assert max(map(abs, state.velocity)) < 1e-6
    assert arm.at_limit == (True, True, True) and arm.counters.limited > 300


def test_a_stop_of_ones_own_stays():
    own = parse_effect("soft_stop:joint=2,lower=-1.0,upper=0.5")
    plant = with_stops(Plant.of("bejczy", [own]))
    stops = [effect for effect in plant.effects if effect.kind.name == "soft_stop"]
    assert sorted(effect.joint for effect in stops) == [1, 2, 3] and plant.effects[0] == own.on(plant.arm)
    assert with_stops(plant) == plant


def test_within_the_ranges_stops_change_no_bit():
    one, other = (
        Session(SessionConfig(plant, initial_position=START))
        for plant in (Plant.of("bejczy"), with_stops(Plant.of("bejczy")))
    )
    for step in range(60):
        for arm in (one, other):
            arm.command((8.0 * math.sin(0.1 * step), -6.0, 3.0))
        assert one.step() == other.step()


# ---- placements and effects


@pytest.mark.parametrize("interface", INTERFACES)
def test_a_placed_arm_goes_on_like_one_that_starts_there(interface):
    arm = session(interface, brakes=False)
    for _ in range(5):
        arm.command(rest(interface))
        arm.step()
    names, there, speed = arm.config.joint_names, (0.1, -1.0, 0.9), (0.2, -0.1, 0.3)
    arm.place(names, there, speed)
    assert arm.state.step == 5 and arm.state.position == there and arm.state.velocity == speed
    other = session(interface, brakes=False, initial_position=there, initial_velocity=speed)
    for _ in range(20):
        for each in (arm, other):
            each.command(rest(interface))
        assert arm.step()[2:] == other.step()[2:]


def test_a_placement_of_some_joints_leaves_the_others():
    arm = session(brakes=False)
    arm.command((5.0, 5.0, 5.0))
    before = arm.step()
    arm.place(["joint2"], [-1.5], [])
    assert arm.state.position == (before.position[0], -1.5, before.position[2])
    assert arm.state.velocity == (before.velocity[0], 0.0, before.velocity[2])
    assert arm.state.current == (before.current[0], 0.0, before.current[2])


def test_brakes_stop_what_was_placed_in_motion_unless_a_command_lets_go():
    arm = session()
    for command in (None, (0.0, 0.0, 0.0)):
        arm.place(["joint1"], [0.5], [1.0])
        if command:
            arm.command(command)
        state = arm.step()
        assert (state.position[0] == 0.5) == (command is None)


@pytest.mark.parametrize(
    "names, position, velocity, words",
    [
        (["joint4"], [0.0], [], "unknown joint 'joint4'"),
        ([], [], [], "no joint names"),
        (["joint1", "joint1"], [0.0, 0.0], [], "stands twice"),
        (["joint1"], [math.nan], [], "1 finite numbers"),
        (["joint1"], [0.0], [0.0, 0.0], "1 finite numbers"),
        (["joint2"], [1.0], [], "-3.8921 to 0.7505"),
    ],
)
def test_a_placement_that_cannot_be_changes_nothing(names, position, velocity, words):
    arm = session()
    before = arm.state
    with pytest.raises(CommandError, match=words):
        arm.place(names, position, velocity)
    assert arm.state == before and arm.counters.rejected == 1


LOADED = ("payload:mass=3,x=0.1", "coulomb_friction:joint=2,torque=5")


def test_effects_in_the_middle_act_from_there_on():
    arm, loaded = session(brakes=False), session(effects=LOADED, brakes=False)
    for _ in range(5):
        arm.command((3.0, -20.0, 5.0))
        arm.step()
    arm.use_effects(parse_effect(text) for text in LOADED)
    state = arm.state
    loaded.place(arm.config.joint_names, state.position, state.velocity)
    ours, theirs = [], []
    for _ in range(10):
        for each, states in ((arm, ours), (loaded, theirs)):
            each.command((3.0, -20.0, 5.0))
            states.append(each.step().position)
    # they differ by the currents with which they began alone
    assert max(abs(a - b) for one, other in zip(ours, theirs) for a, b in zip(one, other)) < 0.02
    arm.reset()
    assert arm.plant == arm.config.plant


def test_the_same_effects_again_change_no_bit():
    """Bristles, soft joints, a lag of the sensors and a delay go on as they are."""
    effects = (
        "presliding_friction:joint=1,torque=4,stiffness=4000",
        "joint_elasticity:joint=2,stiffness=2e4",
        "sensor_lag:joint=3,time_constant=0.01",
        "input_delay:time=0.035",
    )
    one, other = session(effects=effects, brakes=False), session(effects=effects, brakes=False)
    for step in range(30):
        for arm in (one, other):
            arm.command((4.0 * math.sin(0.3 * step), -10.0, 4.0))
        if step % 7 == 3:
            other.use_effects(parse_effect(text) for text in effects)
        assert one.step() == other.step()


def test_effects_that_cannot_be_change_nothing():
    arm = session()
    before = arm.plant
    with pytest.raises(ParameterError, match="stands twice"):
        arm.use_effects([parse_effect(LOADED[1])] * 2)
    assert arm.plant is before


# ---- from plain Python to the compiled kernel


@pytest.mark.skipif(jit.BACKEND != "numba", reason="there is one kernel alone")
@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize("effects", [(), (*LOADED, "input_delay:time=0.035", "sensor_lag:joint=3,time_constant=0.01")])
def test_a_session_goes_over_to_the_compiled_kernel_without_a_change_of_a_bit(interface, effects):
    commands = [tuple(v + 0.02 * step for v in rest(interface)) for step in range(30)]
    awaited, states = [True], []
    jit.await_compiled("arm", lambda: awaited[0])
    arm = session(interface, effects)
    for step, command in enumerate(commands):
        assert jit.kernel_in_use() == ("numba" if step > 11 else "python")
        awaited[0] = step < 11
        arm.command(command)
        states.append(arm.step())
    again = session(interface, effects)
    for command, state in zip(commands, states):
        again.command(command)
        assert again.step() == state
