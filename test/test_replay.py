# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A bag's commands through the core again: every bit, or the first step that differs."""

from __future__ import annotations

import math
import os
import re
import struct
import subprocess
import sys

import numpy as np
import pytest
from arm_reference import plant_of

from puma_sim_core.errors import BagError, CommandError
from puma_sim_core.files import parse_yaml, yaml_text
from puma_sim_core.jit import BACKEND
from puma_sim_core.recording.bag import BagRecorder, RecordedCommand, read_bag
from puma_sim_core.servo.servo import ServoConfig
from puma_sim_core.simulation.replay import replay
from puma_sim_core.simulation.session import Session, SessionConfig

EFFECTS = (
    "coulomb_friction:joint=1,torque=12",
    "stribeck_friction:joint=1,torque=4",
    "asymmetric_coulomb_friction:joint=2,positive=13.6,negative=7.65",
    "presliding_friction:joint=3,torque=6",
    "current_limit:joint=2,current=7",
    "voltage_saturation:joint=3,voltage=20",
    "soft_stop:joint=1,lower=-0.3,upper=0.3",
    "viscous_friction:joint=2,coefficient=9.5",
    "payload:mass=1.1",
)
STEPS = 60


def config_of(interface):
    return SessionConfig(
        plant_of(*EFFECTS),
        interface,
        initial_position=(0.1, -1.1, 0.9),
        voltage_limit=30.0,
        command_timeout=0.2,
        servo=ServoConfig(converter_bits=12, encoder_counts=1000),
    )


def commands_of(step, interface, random):
    """None, one or several commands before a step; some clipped, some by joint name, a pause."""
    if 30 <= step < 45 or step % 4 == 1:
        return []
    if interface == "voltage":
        return [RecordedCommand(None, tuple(random.uniform(-35, 35, 3).tolist())) for _ in range(1 + step % 2)]
    if step % 3:
        return [RecordedCommand(("joint3", "joint1"), tuple(random.uniform(0, 0.5, 2).tolist()))]
    return [RecordedCommand(None, (0.1, -1.0, 0.8 + step / 200)), RecordedCommand(("joint2",), (-1.1,))]


def record(path, interface="voltage", config_text=None, change_state=None, change_command=None):
    """A session with its bag; the changes are made to what is written, not to what was done."""
    config = config_of(interface)
    session, random = Session(config), np.random.default_rng(5)
    with BagRecorder(
        path,
        config_text=config_text or yaml_text(config.to_mapping()),
        joint_names=config.joint_names,
        frame_id=config.frame_id,
        command_interface=interface,
        period_ns=config.period_ns,
    ) as recorder:
        for step in range(STEPS + 1):
            state = session.state
            recorder.write_state(change_state(state) if change_state else state)
            if step < STEPS:
                for command in commands_of(step, interface, random):
                    (session.command(command.values) if command.names is None else session.command_joints(*command))
                    recorder.write_command(state.time_ns, change_command(step, command) if change_command else command)
                session.step()
    return path


def next_float(value):
    """The double with the next bit pattern."""
    (pattern,) = struct.unpack("<q", struct.pack("<d", value))
    return struct.unpack("<d", struct.pack("<q", pattern ^ 1))[0]


@pytest.mark.parametrize("interface", ["voltage", "position"])
def test_a_bag_replays_to_the_last_bit(tmp_path, interface):
    found = replay(record(tmp_path / "run", interface))
    assert found.identical and found.first_difference is None
    assert found.greatest_difference == 0.0
    assert found.steps == STEPS
    assert found.commands == len(read_bag(tmp_path / "run").commands) > 30
    assert found.recorded_kernel == BACKEND
    assert replay(tmp_path / "run" / "run_0.mcap") == found


def test_equal_sessions_make_equal_bags(tmp_path):
    (tmp_path / "a").mkdir(), (tmp_path / "b").mkdir()
    one, other = (record(tmp_path / d / "run", "position") for d in "ab")
    for name in ("run_0.mcap", "metadata.yaml"):
        assert (one / name).read_bytes() == (other / name).read_bytes()


@pytest.mark.parametrize("field", ["position", "velocity", "current", "voltage", "effort"])
def test_one_bit_of_a_state_is_found_at_its_step(tmp_path, field):
    def change(state):
        if state.step != 17:
            return state
        values = list(getattr(state, field))
        values[1] = next_float(values[1])
        return state._replace(**{field: tuple(values)})

    found = replay(record(tmp_path / "run", change_state=change))
    assert not found.identical
    assert found.first_difference.startswith(f"step 17 (0.476 s): {field} of joint 2 was ")
    was, now = re.search(r"was (\S+) and is (\S+) ", found.first_difference).groups()
    assert next_float(float(was)) == float(now)
    assert found.greatest_difference < 1e-14


def test_a_zero_with_another_sign_is_a_difference(tmp_path):
    found = replay(
        record(
            tmp_path / "run",
            change_state=lambda state: state._replace(velocity=(-0.0, 0.0, 0.0)) if state.step == 0 else state,
        )
    )
    assert found.first_difference.startswith("step 0 (0.000 s): velocity of joint 1 was -0.0 and is 0.0 rad/s")


def test_one_bit_of_a_command_is_found_at_the_state_that_it_leads_to(tmp_path):
    def change(step, command):
        # the clipping of those beyond the limit would hide it
        return (
            command
            if step != 22
            else command._replace(values=tuple(v if abs(v) > 20.0 else next_float(v) for v in command.values))
        )

    found = replay(record(tmp_path / "run", change_command=change))
    assert found.first_difference.startswith("step 23 (0.644 s): ")


def test_another_setpoint_is_found_at_the_state_that_it_leads_to(tmp_path):
    # by more than the converter's step
    found = replay(
        record(
            tmp_path / "run",
            "position",
            change_command=lambda step, command: (
                command if step != 22 else command._replace(values=tuple(v + 0.001 for v in command.values))
            ),
        )
    )
    assert found.first_difference.startswith("step 23 (0.644 s): ")


def test_a_command_that_was_left_out_is_found(tmp_path):
    honest = read_bag(record(tmp_path / "run"))
    config = config_of("voltage")
    with BagRecorder(
        tmp_path / "less",
        config_text=honest.config_text,
        frame_id="base_link",
        joint_names=config.joint_names,
        command_interface="voltage",
        period_ns=config.period_ns,
    ) as recorder:
        session = Session(config)
        for step in range(STEPS + 1):
            recorder.write_state(session.state)
            for k, command in honest.commands:
                if k == step:
                    session.command(command.values)
                    if step != 12:
                        recorder.write_command(session.state.time_ns, command)
            session.step()
    found = replay(tmp_path / "less")
    assert found.first_difference.startswith("step 13 (0.364 s): ")


# ---------------------------------------------------------------------------------------- refusals


def model_text(change):
    mapping = config_of("voltage").to_mapping()
    change(mapping)
    return yaml_text(mapping)


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda m: m.update(format="puma-sim session 9"), "session format 'puma-sim session 9'; expected"),
        (lambda m: m["model"].update(format="puma-sim model 9"), "format 'puma-sim model 9'; expected"),
        (
            lambda m: m["model"]["effects"].append({"name": "magic", "joint": 1}),
            "unknown effect 'magic'; expected one of",
        ),
        (
            lambda m: m["model"]["effects"][0].update(torque={"value": -1.0, "unit": "N.m"}),
            "effect coulomb_friction .*: the model cannot be rebuilt: torque=-1; expected 0 to 500 N.m",
        ),
        (
            lambda m: m["model"]["parameters"]["gravity"].update(unit="ft/s^2"),
            "gravity.unit .*: the model cannot be rebuilt: unit 'ft/s.2'; expected m/s",
        ),
        (lambda m: m.update(friction=1), "friction"),
        (lambda m: m.update(period=1.0), "period / substeps .*: 33.3333 ms; expected more than 0 and at most 8 ms"),
        (lambda m: m.pop("model"), "no model"),
    ],
)
def test_a_bag_whose_model_cannot_be_rebuilt_names_what_and_its_version(tmp_path, change, message):
    path = record(tmp_path / "run", config_text=model_text(change))
    with pytest.raises(BagError, match=message) as caught:
        replay(path)
    assert "run: topic sim_node/model" in str(caught.value)
    assert "(recorded by version 0.1.0)" in str(caught.value)


@pytest.mark.parametrize("text", ["", "- 1\n", "just text\n", "a: [\n", "a: 1\na: 2\n"])
def test_a_bag_whose_model_is_no_mapping_is_refused(tmp_path, text):
    with pytest.raises(BagError, match="run: topic sim_node/model"):
        replay(record(tmp_path / "run", config_text=text or "\n"))


def test_a_command_that_its_session_refuses_is_named_with_its_step(tmp_path):
    path = record(
        tmp_path / "run",
        change_command=lambda step, command: command._replace(values=(math.nan, 0.0, 0.0)) if step == 6 else command,
    )
    with pytest.raises(BagError, match="run: step 6: its session refuses an input: .*nan"):
        replay(path)
    with pytest.raises(CommandError):
        Session(config_of("voltage")).command((math.nan, 0.0, 0.0))


def test_what_is_no_bag_is_refused(tmp_path):
    with pytest.raises(BagError, match="does not exist"):
        replay(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BagError, match="is not a bag"):
        replay(tmp_path / "empty")


def test_a_session_that_stops_being_finite_is_told(tmp_path):
    def inductance(mapping):
        for motor in mapping["model"]["parameters"]["motors"].values():
            motor["inductance"]["value"] = 1e-9

    found = replay(record(tmp_path / "run", config_text=model_text(inductance)))
    assert not found.identical
    assert "step 1: the state is no longer finite" in found.first_difference


# ----------------------------------------------------------------------------------- other kernel


@pytest.mark.parametrize("interface", ["voltage", "position"])
def test_a_bag_of_one_kernel_replays_in_the_other(tmp_path, interface):
    pytest.importorskip("numba")
    other = "python" if BACKEND == "numba" else "numba"
    path = record(tmp_path / "run", interface)
    program = (
        "import sys; from puma_sim_core.jit import BACKEND; "
        "from puma_sim_core.simulation.replay import replay; found = replay(sys.argv[1]); "
        "print(BACKEND, found.recorded_kernel, found.identical, found.first_difference)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)],
        capture_output=True,
        text=True,
        env={**os.environ, "PUMA_SIM_KERNEL": other},
        check=True,
    )
    assert done.stdout.split() == [other, BACKEND, "True", "None"]


def test_the_recorded_text_holds_the_whole_session(tmp_path):
    bag = read_bag(record(tmp_path / "run", "position"))
    mapping = parse_yaml(bag.config_text, "bag")
    assert SessionConfig.from_mapping(mapping) == config_of("position")
