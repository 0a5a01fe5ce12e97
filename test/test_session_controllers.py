# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Sessions whose volts come from a controller object: the simulator's bits, records, replays."""

from __future__ import annotations

import os
import subprocess
import sys
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from arm_reference import bits
from test_session import EFFECTS, POSITION, all_bits, config_of, position_config

from puma_sim_core.control.controllers import load_settings, make_controller
from puma_sim_core.errors import ModelError, ParameterError
from puma_sim_core.files import parse_yaml, yaml_text
from puma_sim_core.recording.bag import BagRecorder
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.replay import replay
from puma_sim_core.simulation.session import Session, SessionConfig
from puma_sim_core.simulation.simulator import Simulator

KINDS = ("scheduled", "computed_torque")
SERVO = ServoConfig(amplifier_gain=2.0, converter_bits=12, encoder_counts=1000, delay_samples=1)
TARGETS = np.array(POSITION) + np.linspace(0.0, 0.15, 25)[:, None] * (1.0, -1.0, 0.5)


def driven(session, targets=TARGETS):
    states = [session.state]
    for target in targets:
        session.command(target)
        states.append(session.step())
    return states


@pytest.mark.parametrize("effects", [(), EFFECTS], ids=["none", "effects"])
@pytest.mark.parametrize("servo", [ServoConfig(), SERVO], ids=["ideal", "chain"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_session_is_the_simulator_under_the_same_controller(kind, servo, effects):
    config = position_config(*effects, controller=kind, servo=servo, voltage_limit=30.0)
    states = driven(Session(config))
    simulator = Simulator(config.plant)
    simulator.reset(POSITION)
    run = simulator.run_controller(
        make_controller(kind, config.plant, voltage_limit=30.0, amplifier_gain=servo.amplifier_gain),
        TARGETS,
        voltage_limit=30.0,
        chain=servo,
    )
    for k, state in enumerate(states[1:], start=1):
        assert bits(state.position) == bits(run.position[30 * k])
        assert bits(state.current) == bits(run.current[30 * k])
        assert bits(state.voltage) == bits(run.voltage[30 * k - 1])


def test_the_pid_object_of_a_session_gives_the_compiled_servos_bits():
    config = position_config(*EFFECTS, servo=SERVO)
    session = Session(config)
    # as the session's servo does, the run begins at rest with the arm's place as its setpoint
    states = driven(session, [POSITION, *TARGETS])
    simulator = Simulator(config.plant)
    simulator.reset(POSITION)
    run = simulator.run_controller(config.make_controller(), [POSITION, *TARGETS], chain=SERVO)
    for k, state in enumerate(states):
        assert bits(state.position) == bits(run.position[30 * k])


@pytest.mark.parametrize("kind", KINDS)
def test_reset_equals_a_new_session_bit_for_bit(kind):
    config = position_config(*EFFECTS, controller=kind, servo=SERVO)
    used, new = Session(config), Session(config)
    driven(used)
    used.reset()
    assert list(map(all_bits, driven(used))) == list(map(all_bits, driven(new)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_record_of_a_session_makes_an_equal_one(kind):
    settings = load_settings(kind)
    key = "bandwidth" if kind == "computed_torque" else "integral_time"
    settings[key] = [value * (1.0 + 1.0 / 3.0) for value in settings[key]]
    config = position_config(*EFFECTS, controller=kind, controller_settings=settings)
    text = yaml_text(config.to_mapping())
    again = SessionConfig.from_mapping(parse_yaml(text, "bag"), "bag")
    assert again == config and yaml_text(again.to_mapping()) == text
    assert list(map(all_bits, driven(Session(again)))) == list(map(all_bits, driven(Session(config))))
    other = position_config(*EFFECTS, controller=kind)
    assert other != config
    assert all_bits(driven(Session(other))[-1]) != all_bits(driven(Session(config))[-1])


def test_the_settings_of_a_session_are_its_own():
    settings = load_settings("computed_torque")
    config = position_config(controller="computed_torque", controller_settings=settings)
    before = deepcopy(config.to_mapping())
    settings["bandwidth"][0] = 1.0
    config.to_mapping()["controller_settings"]["bandwidth"][1] = 1.0
    assert config.to_mapping() == before


def test_a_session_without_the_key_is_one_with_pid():
    config = position_config()
    mapping = config.to_mapping()
    assert "controller" not in mapping and "controller_settings" not in mapping
    assert SessionConfig.from_mapping(mapping).controller == "pid"
    assert SessionConfig.from_mapping({**mapping, "controller": "pid"}) == config


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"controller": "pd"}, "controller 'pd'; expected pid or scheduled or computed_torque"),
        (
            {"controller": "scheduled", "command_interface": "voltage"},
            "controller 'scheduled'; expected pid, or command_interface position",
        ),
        ({"controller_settings": {}}, "controller_settings of controller 'pid'; expected none"),
        ({"controller": "scheduled", "controller_settings": {}}, "derivative_on_measurement = None"),
        ({"controller": "scheduled", "controller_settings": 7}, "settings 7; expected a mapping"),
        (
            {"controller": "computed_torque", "controller_settings": {"bandwidth": 1.0}},
            "keys bandwidth; expected bandwidth, velocity_filter",
        ),
    ],
)
def test_sessions_whose_controller_cannot_be_are_named(changes, message):
    with pytest.raises(ParameterError, match=message):
        config_of(**{"command_interface": "position", **changes})
    mapping = {**position_config().to_mapping(), **changes}
    with pytest.raises(ModelError, match=message) as caught:
        SessionConfig.from_mapping(mapping, "the bag")
    assert str(caught.value).startswith("the bag")


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_replays_to_the_last_bit_with_either_kernel(kind, tmp_path):
    config = position_config(*EFFECTS, controller=kind, servo=SERVO)
    session = Session(config)
    with BagRecorder(
        tmp_path / "bag",
        namespace="/",
        config_text=yaml_text(config.to_mapping()),
        urdf="<robot/>",
        joint_names=config.joint_names,
        frame_id=config.frame_id,
        command_interface="position",
        period_ns=config.period_ns,
    ) as recorder:
        recorder.write_state(session.state)
        for target in TARGETS:
            recorder.write_command(session.state.time_ns, session.command(target))
            recorder.write_state(session.step())
    assert replay(tmp_path / "bag").identical
    root = Path(__file__).resolve().parent.parent
    done = subprocess.run(
        [sys.executable, "-m", "puma_sim_core", "replay", str(tmp_path / "bag")],
        cwd=root,
        env={**os.environ, "PUMA_SIM_KERNEL": "python"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
