# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A session's configuration: text that makes an equal session, and errors that name the value."""

from __future__ import annotations

import math

import pytest
from arm_reference import bits, plant_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_session import EFFECTS, all_bits, config_of, position_config

from puma_sim_core.errors import ModelError, ParameterError
from puma_sim_core.files import parse_yaml, yaml_text
from puma_sim_core.servo.pid import PidGains
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.session import Session, SessionConfig

finite = st.floats(-1e6, 1e6)
triple = st.tuples(finite, finite, finite)


@settings(max_examples=60)
@given(
    initial=triple,
    velocity=triple,
    current=triple,
    period=st.floats(1e-4, 0.2),
    limit=st.floats(1e-3, 1e3),
    timeout=st.floats(0, 100),
    gain=st.floats(0, 1e5),
    bits_=st.none() | st.integers(2, 32),
    interface=st.sampled_from(("voltage", "position")),
)
def test_configuration_survives_its_text_exactly(
    initial, velocity, current, period, limit, timeout, gain, bits_, interface
):
    config = SessionConfig(
        plant_of(*EFFECTS),
        interface,
        period,
        30,
        limit,
        timeout,
        initial,
        velocity,
        current,
        ServoConfig((PidGains(gain), PidGains(gain, 0.1), PidGains(gain, 0.1, 0.2)), 1.5, bits_),
        ("a", "joint2", "ä"),
        "world",
    )
    text = yaml_text(config.to_mapping())
    again = SessionConfig.from_mapping(parse_yaml(text, "bag"), "bag")
    assert again == config
    assert yaml_text(again.to_mapping()) == text
    for name in ("initial_position", "initial_velocity", "initial_current"):
        assert bits(getattr(again, name)) == bits(getattr(config, name))


def test_sessions_of_equal_configurations_are_equal_bit_for_bit():
    config = position_config(*EFFECTS)
    again = SessionConfig.from_mapping(parse_yaml(yaml_text(config.to_mapping()), "bag"))
    one, other = Session(config), Session(again)
    for k in range(40):
        for session in (one, other):
            session.command((0.1, -1.1 + 0.01 * k, 0.9))
        assert all_bits(one.step()) == all_bits(other.step())


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"command_interface": "torque"}, "command_interface 'torque'; expected voltage or position"),
        ({"period": 0.0}, "period 0.0 s; expected more than 0"),
        ({"period": math.nan}, "period nan s"),
        ({"substeps": 0}, "substeps 0; expected a whole number of at least 1"),
        ({"substeps": 30.0}, "substeps 30.0"),
        ({"substeps": 3}, "period / substeps: 9.33333 ms; expected more than 0 and at most 8 ms"),
        ({"voltage_limit": 0.0}, "voltage_limit 0.0 V; expected a positive number"),
        ({"voltage_limit": math.inf}, "voltage_limit inf V"),
        ({"command_timeout": -1.0}, "command_timeout -1.0 s; expected 0 or more"),
        ({"initial_position": (0.0, 0.0)}, "initial_position = .*; expected three finite numbers"),
        ({"initial_velocity": (0.0, 0.0, math.nan)}, "initial_velocity"),
        ({"initial_current": None}, "initial_current"),
        ({"joint_names": ("a", "b")}, "joint_names .*; expected three different names"),
        ({"joint_names": ("a", "b", "a")}, "joint_names"),
        ({"joint_names": ("a", "b", 3)}, "joint_names"),
    ],
)
def test_configurations_that_cannot_be_used_are_named(changes, message):
    with pytest.raises(ParameterError, match=message):
        config_of(**changes)
    mapping = config_of().to_mapping()
    mapping.update({k: list(v) if isinstance(v, tuple) else v for k, v in changes.items()})
    with pytest.raises(ModelError, match=message.split(";")[0].replace("(", r"\(")) as caught:
        SessionConfig.from_mapping(mapping, "the bag")
    assert str(caught.value).startswith("the bag")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"format": "puma-sim session 2"}, "session format 'puma-sim session 2'; expected 'puma-"),
        ({"colour": "red"}, "colour"),
        ({"model": None}, "no model"),
        ({"servo": {"speed": 3}}, "servo: .*speed"),
        ({"servo": 7}, "servo"),
        ({"period": "fast"}, "expected"),
    ],
)
def test_mappings_that_cannot_be_rebuilt_are_named(change, message):
    with pytest.raises(ModelError, match=message):
        SessionConfig.from_mapping({**config_of().to_mapping(), **change})
    for nothing in (None, [], "text", {}):
        with pytest.raises(ModelError, match="session format"):
            SessionConfig.from_mapping(nothing)
