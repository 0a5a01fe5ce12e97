# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Bags give back a session to the last bit; equal sessions are equal bytes."""

from __future__ import annotations

import subprocess
import sys

import bag_sessions as sessions
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from puma_sim_core.recording.bag import RecordedCommand, iterate_messages, messages, read_bag

FIELDS = ("position", "velocity", "effort", "current", "voltage")


def mcap_of(bag):
    return bag / f"{bag.name}_0.mcap"


def recorded_commands(steps, command_interface, trailing=True):
    return [
        (step, command) for step in range(steps + trailing) for command in sessions.commands(step, command_interface)
    ]


def assert_same_commands(found, expected):
    assert [(step, command.names) for step, command in found] == [(step, command.names) for step, command in expected]
    for (_, one), (_, other) in zip(found, expected):
        assert sessions.bits(one.values) == sessions.bits(other.values)


def assert_contents(contents, steps, command_interface, trailing=True):
    assert contents.steps.tolist() == list(range(steps + 1))
    assert contents.time_ns.tolist() == [k * sessions.PERIOD_NS for k in range(steps + 1)]
    for field in FIELDS:
        expected = [getattr(sessions.state(k), field) for k in range(steps + 1)]
        assert sessions.bits(getattr(contents, field).ravel()) == sessions.bits(np.ravel(expected))
    assert_same_commands(contents.commands, recorded_commands(steps, command_interface, trailing))


@pytest.mark.parametrize("command_interface", ["voltage", "position"])
@pytest.mark.parametrize("steps", [0, 1, 100])
def test_a_bag_gives_back_every_bit(tmp_path, command_interface, steps):
    bag = sessions.record(tmp_path / "run", steps, command_interface)
    for path in (bag, str(bag), mcap_of(bag)):
        contents = read_bag(path)
        assert_contents(contents, steps, command_interface)
        assert contents.complete
        assert contents.config_text == sessions.CONFIG
        assert contents.urdf == sessions.URDF
        assert contents.command_interface == command_interface
        assert contents.joint_names == sessions.JOINTS
        assert contents.frame_id == "base_link"
        assert contents.period_ns == (sessions.PERIOD_NS if steps else None)
        assert contents.namespace == ""


FLOATS = st.floats(allow_nan=False, width=64)


@given(values=st.lists(st.tuples(FLOATS, FLOATS, FLOATS), min_size=5, max_size=5))
def test_any_numbers_survive(tmp_path_factory, values):
    bag = tmp_path_factory.mktemp("numbers") / "run"
    with sessions.new_recorder(bag) as recorder:
        recorder.write_state(sessions.State(0, 0, *values))
        recorder.write_command(0, RecordedCommand(None, values[0]))
    contents = read_bag(bag)
    for field, expected in zip(sessions.State._fields[2:], values):
        assert sessions.bits(getattr(contents, field)[0]) == sessions.bits(expected)
    assert sessions.bits(contents.commands[0][1].values) == sessions.bits(values[0])


@given(
    names=st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0")), max_size=4),
    frame=st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9),
    time_ns=st.integers(0, 2**31 * 10**9 - 1),
    seed=st.integers(0, 99),
)
def test_the_fast_encoder_is_the_serializer(names, frame, time_ns, seed):
    """Numbers put into a made message give the bytes of a message serialized anew."""
    store = messages.typestore()
    types = store.types
    arrays = np.random.default_rng(seed).normal(size=(3, len(names)))
    stamp = types["builtin_interfaces/msg/Time"](*divmod(time_ns, 10**9))
    header = types["std_msgs/msg/Header"](stamp, frame)
    counts = [len(names)] * 3 if seed % 2 else [len(names), 0, 0]
    parts = [array[:count] for array, count in zip(arrays, counts)]
    message = types[messages.JOINT_STATE](header, names, *parts)
    form = messages.FixedMessage(counts, names, frame)
    data = form.encode(time_ns, *parts)
    assert data == bytes(store.serialize_cdr(message, messages.JOINT_STATE, little_endian=True))
    stamps, decoded = form.decode([data, data])
    assert stamps.tolist() == [time_ns, time_ns]
    for part, both in zip(parts, decoded):
        assert sessions.bits(both[1]) == sessions.bits(part)

    layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
    message = types[messages.ARRAY](layout, arrays[0])
    assert messages.FixedMessage([len(names)]).encode(0, arrays[0]) == bytes(
        store.serialize_cdr(message, messages.ARRAY, little_endian=True)
    )


@pytest.mark.parametrize("command_interface", ["voltage", "position"])
def test_equal_sessions_are_equal_bytes(tmp_path, command_interface):
    (tmp_path / "other").mkdir()
    one = sessions.record(tmp_path / "run", 70, command_interface)
    same = sessions.record(tmp_path / "other" / "run", 70, command_interface)
    renamed = sessions.record(tmp_path / "renamed", 70, command_interface)
    assert mcap_of(one).read_bytes() == mcap_of(same).read_bytes()
    assert (one / "metadata.yaml").read_bytes() == (same / "metadata.yaml").read_bytes()
    assert mcap_of(one).read_bytes() == mcap_of(renamed).read_bytes()


def test_messages_come_in_the_order_of_the_session(tmp_path):
    """The model first, then each state before the commands that its step consumes."""
    bag = sessions.record(tmp_path / "run", 40, "position")
    found = [(message.topic, message.time_ns) for message in iterate_messages(bag)]
    expected = [("/sim_node/model", 0), ("/robot_description", 0)]
    for step in range(41):
        time_ns = step * sessions.PERIOD_NS
        topics = ["/joint_states", "/motor_currents", "/motor_voltages"]
        for command in sessions.commands(step, "position"):
            topics.append("/joint_commands" if command.names else "/position_controller/commands")
        expected += [(topic, time_ns) for topic in topics]
    assert found == expected


@pytest.mark.parametrize("namespace", ["cell1", "/cell1", "/plant/cell1/"])
def test_topics_stand_in_the_namespace(tmp_path, namespace):
    bag = sessions.record(tmp_path / "run", 3, "position", namespace=namespace)
    prefix = "/" + namespace.strip("/")
    assert {message.topic for message in iterate_messages(bag)} == {
        f"{prefix}/{name}"
        for name in (
            "sim_node/model",
            "robot_description",
            "joint_states",
            "motor_currents",
            "motor_voltages",
            "position_controller/commands",
            "joint_commands",
        )
    }
    contents = read_bag(bag)
    assert contents.namespace == prefix
    assert_contents(contents, 3, "position")


def test_without_a_urdf_there_is_no_such_topic(tmp_path):
    bag = sessions.record(tmp_path / "run", 1, urdf=None)
    assert read_bag(bag).urdf is None
    assert "/robot_description" not in {message.topic for message in iterate_messages(bag)}


def test_the_last_state_before_an_exception_is_in_the_bag(tmp_path):
    with pytest.raises(RuntimeError, match="stop"), sessions.new_recorder(tmp_path / "run") as recorder:
        recorder.write_state(sessions.state(0))
        recorder.write_state(sessions.state(1))
        raise RuntimeError("stop")
    assert read_bag(tmp_path / "run").steps.tolist() == [0, 1]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_a_file_that_another_tool_wrote_anew_reads_the_same(tmp_path, compression, chunked):
    """Compressed, in other chunks or in none: the messages count, not their packing."""
    bag = sessions.record(tmp_path / "run", 50, "position")
    packed = tmp_path / "packed.mcap"
    with open(mcap_of(bag), "rb") as source, open(packed, "wb") as file:
        writer = Writer(file, chunk_size=3000, compression=compression, use_chunking=chunked)
        writer.start(profile="ros2")
        channels = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", number, channel.metadata)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    assert_contents(read_bag(packed), 50, "position")


def test_the_core_loads_no_bag_library():
    code = "import sys, puma_sim_core; print(sorted({'mcap', 'rosbags'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
