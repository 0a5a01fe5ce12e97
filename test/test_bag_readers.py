# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Readers of other projects accept every bag and find the same numbers in it."""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import bag_sessions as sessions
import pytest
import yaml
from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

DecoderFactory = pytest.importorskip("mcap_ros2.decoder").DecoderFactory

from puma_sim_core.recording import bag as bags
from puma_sim_core.recording.bag import messages

STEPS = 40
INFINITE = {"sec": 9223372036, "nsec": 854775807}


@pytest.fixture(scope="module", params=["voltage", "position", "recovered"])
def bag(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    interface = "voltage" if request.param == "voltage" else "position"
    path = sessions.record(folder / "run", STEPS, interface, namespace="cell1")
    if request.param != "recovered":
        return path
    (path / "metadata.yaml").unlink()
    os.truncate(mcap_of(path), mcap_of(path).stat().st_size * 3 // 4)
    return bags.recover(path).path


def mcap_of(bag):
    return bag / f"{bag.name}_0.mcap"


def expected_messages(bag):
    """(topic, type, time, numbers or text) from the session, not from the file."""
    contents = bags.read_bag(bag)
    complete = bag.name == "run"
    array, joints = messages.ARRAY, messages.JOINT_STATE
    expected = [
        ("/cell1/sim_node/model", messages.STRING, 0, sessions.CONFIG),
        ("/cell1/robot_description", messages.STRING, 0, sessions.URDF),
    ]
    for step in contents.steps.tolist():
        state = sessions.state(step)
        time_ns = state.time_ns
        motion = [sessions.bits(v) for v in (state.position, state.velocity, state.effort)]
        expected += [
            ("/cell1/joint_states", joints, time_ns, (list(sessions.JOINTS), *motion)),
            ("/cell1/motor_currents", array, time_ns, sessions.bits(state.current)),
            ("/cell1/motor_voltages", array, time_ns, sessions.bits(state.voltage)),
        ]
        if step == contents.steps[-1] and not complete:
            continue
        for command in sessions.commands(step, contents.command_interface):
            values = sessions.bits(command.values)
            if command.names:
                value = (list(command.names), values, [], [])
                expected.append(("/cell1/joint_commands", joints, time_ns, value))
            else:
                topic = f"/cell1/{contents.command_interface}_controller/commands"
                expected.append((topic, array, time_ns, values))
    return expected


def value_of(message, time_ns):
    """The value of a decoded message in the form of `expected_messages`."""
    if not hasattr(message, "header"):
        data = message.data
        return data if isinstance(data, str) else sessions.bits(data)
    stamp = message.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == time_ns
    motion = [sessions.bits(v) for v in (message.position, message.velocity, message.effort)]
    return (list(message.name), *motion)


def test_rosbags_reads_the_directory(bag):
    with AnyReader([bag]) as reader:
        found = [
            (
                connection.topic,
                connection.msgtype,
                time_ns,
                value_of(reader.deserialize(data, connection.msgtype), time_ns),
            )
            for connection, time_ns, data in reader.messages()
        ]
        assert reader.message_count == len(found)
        assert (reader.start_time, reader.duration) == (0, found[-1][2] + 1)
    assert found == expected_messages(bag)


def test_rosbags_reads_the_file(bag):
    with Reader(mcap_of(bag)) as reader:
        found = [(c.topic, c.msgtype, time_ns) for c, time_ns, _ in reader.messages()]
    assert found == [item[:3] for item in expected_messages(bag)]


@pytest.mark.parametrize("indexed", [True, False])
def test_mcap_and_mcap_ros2_read_the_file(bag, indexed):
    """Through the index and straight through, all checksums compared."""
    with open(mcap_of(bag), "rb") as file:
        make = make_reader if indexed else NonSeekingReader
        reader = make(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found = [
            (
                item.channel.topic,
                item.schema.name,
                item.message.log_time,
                value_of(item.decoded_message, item.message.log_time),
            )
            for item in reader.iter_decoded_messages()
        ]
    assert found == expected_messages(bag)


def test_the_reader_for_web_pages_reads_the_file(bag):
    folder = os.environ.get("PUMA_SIM_NODE_MODULES")
    node = shutil.which("node")
    if not (node and folder and (Path(folder) / "@mcap" / "core").is_dir()):
        pytest.skip("PUMA_SIM_NODE_MODULES names no folder with @mcap/core, or node is missing")
    script = Path(__file__).parent / "bag_readers_js" / "read_bag.cjs"
    done = subprocess.run([node, script, folder, mcap_of(bag)], capture_output=True, text=True, check=True)
    found = []
    for line in done.stdout.splitlines():
        item = json.loads(line)
        numbers = {
            key: [struct.unpack("<Q", bytes.fromhex(text)[::-1])[0] for text in item[key]]
            for key in ("data", "position", "velocity", "effort")
        }
        if item["name"] is not None:
            assert item["stamp"] == item["time"]
            motion = [numbers[key] for key in ("position", "velocity", "effort")]
            value = (item["name"], *motion)
        else:
            value = numbers["data"] if item["text"] is None else item["text"]
        found.append((item["topic"], item["type"], int(item["time"]), value))
    assert found == expected_messages(bag)


# The form ------------------------------------------------------------------------------------

TOPIC_KEYS = {
    "name": str,
    "type": str,
    "serialization_format": str,
    "offered_qos_profiles": list,
    "type_description_hash": str,
}
INFORMATION_KEYS = {
    "version": int,
    "storage_identifier": str,
    "duration": dict,
    "starting_time": dict,
    "message_count": int,
    "topics_with_message_count": list,
    "compression_format": str,
    "compression_mode": str,
    "relative_file_paths": list,
    "files": list,
    "custom_data": type(None),
    "ros_distro": str,
}
FILE_KEYS = {"path": str, "starting_time": dict, "duration": dict, "message_count": int}
QOS_KEYS = {
    "history": str,
    "depth": int,
    "reliability": str,
    "durability": str,
    "deadline": dict,
    "lifespan": dict,
    "liveliness": str,
    "liveliness_lease_duration": dict,
    "avoid_ros_namespace_conventions": bool,
}


def assert_keys(mapping, keys):
    assert {key: type(value) for key, value in mapping.items()} == keys


def assert_information(information, files):
    """Every key that rosbag2 decodes at version 9, of the kind to which it decodes it."""
    assert_keys(information, INFORMATION_KEYS)
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["ros_distro"] == "jazzy"
    assert information["compression_format"] == information["compression_mode"] == ""
    assert information["starting_time"] == {"nanoseconds_since_epoch": 0}
    assert list(information["duration"]) == ["nanoseconds"]
    assert len(information["files"]) == len(information["relative_file_paths"]) == files
    for topic in information["topics_with_message_count"]:
        assert_keys(topic, {"topic_metadata": dict, "message_count": int})
        assert_keys(topic["topic_metadata"], TOPIC_KEYS)
        assert topic["topic_metadata"]["serialization_format"] == "cdr"
        (profile,) = topic["topic_metadata"]["offered_qos_profiles"]
        assert_keys(profile, QOS_KEYS)
        latched = topic["topic_metadata"]["name"].endswith(("model", "robot_description", "brakes", "effects"))
        assert profile == {
            "history": "keep_last",
            "depth": 1 if latched else 10,
            "reliability": "reliable",
            "durability": "transient_local" if latched else "volatile",
            "deadline": INFINITE,
            "lifespan": INFINITE,
            "liveliness": "automatic",
            "liveliness_lease_duration": INFINITE,
            "avoid_ros_namespace_conventions": False,
        }


def stored_information(bag):
    text = (bag / "metadata.yaml").read_text(encoding="utf-8")
    assert "&id" not in text and "*id" not in text
    content = yaml.safe_load(text)
    assert list(content) == ["rosbag2_bagfile_information"]
    return content["rosbag2_bagfile_information"]


def test_metadata_has_every_key_of_version_9(bag):
    information = stored_information(bag)
    assert_information(information, files=1)
    expected = expected_messages(bag)
    counts = {
        topic["topic_metadata"]["name"]: topic["message_count"] for topic in information["topics_with_message_count"]
    }
    assert sum(counts.values()) == information["message_count"] == len(expected)
    for topic, count in counts.items():
        assert count == sum(item[0] == topic for item in expected)
    assert information["duration"]["nanoseconds"] == expected[-1][2]
    assert information["relative_file_paths"] == [mcap_of(bag).name]
    (file,) = information["files"]
    assert_keys(file, FILE_KEYS)
    assert file == {
        "path": mcap_of(bag).name,
        "starting_time": information["starting_time"],
        "duration": information["duration"],
        "message_count": information["message_count"],
    }


def test_the_mcap_file_has_the_form_of_rosbag2(bag):
    with open(mcap_of(bag), "rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        (record,) = reader.iter_metadata()
    assert record.name == "rosbag2"
    inner = yaml.safe_load(record.metadata["serialized_metadata"])
    assert_information(inner, files=0)
    outer = stored_information(bag)
    assert inner == {**outer, "files": [], "relative_file_paths": []}

    stored = {topic["topic_metadata"]["name"]: topic["topic_metadata"] for topic in outer["topics_with_message_count"]}
    assert {channel.topic for channel in summary.channels.values()} == set(stored)
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        topic = stored[channel.topic]
        assert channel.message_encoding == "cdr"
        assert schema.encoding == "ros2msg"
        assert schema.name == topic["type"]
        assert set(channel.metadata) == {"offered_qos_profiles", "topic_type_hash"}
        assert channel.metadata["topic_type_hash"] == topic["type_description_hash"]
        # A reader of the directory takes only channels whose quality of service is the same.
        profiles = channel.metadata["offered_qos_profiles"]
        assert yaml.safe_load(profiles) == topic["offered_qos_profiles"]
        assert profiles == yaml.safe_dump(topic["offered_qos_profiles"], sort_keys=False).strip()

    assert summary.statistics.message_count == outer["message_count"]
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 1
    assert all(chunk.message_index_length > 0 for chunk in summary.chunk_indexes)
    assert all(len(chunk.message_index_offsets) >= 3 for chunk in summary.chunk_indexes[2:])


# Split bags ----------------------------------------------------------------------------------

EVERY = 300_000_000


@pytest.fixture(scope="module")
def split_bag(tmp_path_factory):
    """Of four files: states 0 to 10, 11 to 21, 22 to 32, 33 to 40."""
    path = tmp_path_factory.mktemp("split") / "run"
    return sessions.record(path, STEPS, "position", namespace="cell1", splits_ns=range(EVERY, 10**12, EVERY))


def test_rosbags_reads_a_split_directory_whole(split_bag):
    test_rosbags_reads_the_directory(split_bag)


@pytest.mark.parametrize("indexed", [True, False])
def test_the_files_of_a_split_bag_are_the_session_one_after_the_other(split_bag, indexed):
    found = []
    for number in range(4):
        with open(split_bag / f"run_{number}.mcap", "rb") as file:
            make = make_reader if indexed else NonSeekingReader
            reader = make(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
            for item in reader.iter_decoded_messages():
                value = value_of(item.decoded_message, item.message.log_time)
                found.append((item.channel.topic, item.schema.name, item.message.log_time, value))
    assert found == expected_messages(split_bag)


def test_the_metadata_of_a_split_bag_lists_its_files(split_bag):
    outer = stored_information(split_bag)
    assert_information(outer, files=4)
    expected = expected_messages(split_bag)
    assert outer["message_count"] == len(expected)
    assert outer["duration"]["nanoseconds"] == expected[-1][2]
    names = [f"run_{number}.mcap" for number in range(4)]
    assert outer["relative_file_paths"] == [file["path"] for file in outer["files"]] == names
    for file, begin, end in zip(outer["files"], (0, 11, 22, 33), (11, 22, 33, 41)):
        assert_keys(file, FILE_KEYS)
        times = [item[2] for item in expected if begin <= item[2] // sessions.PERIOD_NS < end]
        assert file["starting_time"] == {"nanoseconds_since_epoch": begin * sessions.PERIOD_NS}
        assert file["duration"] == {"nanoseconds": (end - 1 - begin) * sessions.PERIOD_NS}
        assert file["message_count"] == len(times)


def test_each_file_of_a_split_bag_describes_itself(split_bag):
    outer = stored_information(split_bag)
    for listed in outer["files"]:
        with open(split_bag / listed["path"], "rb") as file:
            reader = make_reader(file)
            statistics = reader.get_summary().statistics
            topics = [channel.topic for _, channel, _ in reader.iter_messages()]
            (record,) = reader.iter_metadata()
        inner = yaml.safe_load(record.metadata["serialized_metadata"])
        assert_keys(inner, INFORMATION_KEYS)
        span = {key: listed[key] for key in ("starting_time", "duration", "message_count")}
        same = {**outer, **span, "files": [], "relative_file_paths": []}
        of_topic = [
            {**each, "message_count": topics.count(each["topic_metadata"]["name"])}
            for each in outer["topics_with_message_count"]
        ]
        assert inner == {**same, "topics_with_message_count": of_topic}
        assert statistics.message_count == listed["message_count"]
        assert statistics.message_start_time == listed["starting_time"]["nanoseconds_since_epoch"]
        assert statistics.message_end_time - statistics.message_start_time == listed["duration"]["nanoseconds"]


@pytest.mark.parametrize(
    "name", ["std_msgs/msg/String", "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState"]
)
def test_type_hashes_and_definitions_are_those_of_ros(name):
    """Against the files that an installed ROS brings, where there is one."""
    package, _, kind = name.split("/")
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    prefixes.append(os.environ.get("VIRTUAL_ENV", ""))
    prefixes.append(str(Path(sys.prefix)))
    for prefix in prefixes:
        folder = Path(prefix or "/nonexistent") / "share" / package / "msg"
        if (folder / f"{kind}.json").exists():
            break
    else:
        pytest.skip("no ROS messages are installed here")
    hashes = {
        entry["type_name"]: entry["hash_string"]
        for entry in json.loads((folder / f"{kind}.json").read_text())["type_hashes"]
    }
    assert messages.type_hash(name) == hashes[name]

    fields = [
        line.split("#")[0].split()
        for line in (folder / f"{kind}.msg").read_text().splitlines()
        if line.split("#")[0].strip()
    ]
    ours = [
        [part.split("/")[-1] for part in line.split()]
        for line in messages.definition(name).split("=" * 80)[0].splitlines()
        if line
    ]
    assert ours == [[part.split("/")[-1] for part in line] for line in fields]
