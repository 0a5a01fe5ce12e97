# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Bags are written whole or not at all; each error names what, where, and what was expected."""

from __future__ import annotations

import errno

import bag_sessions as sessions
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import RecordedCommand, iterate_messages, messages, read_bag


def mcap_of(bag):
    return bag / f"{bag.name}_0.mcap"


# Errors of writing ---------------------------------------------------------------------------


def test_a_path_that_exists_is_refused_and_not_touched(tmp_path):
    bag = sessions.record(tmp_path / "run", 2)
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    file = tmp_path / "file"
    file.write_text("mine")
    for path in (bag, file, tmp_path):
        with pytest.raises(BagError, match="exists already") as error:
            sessions.new_recorder(path)
        assert str(path) in str(error.value)
    assert {file.name: file.read_bytes() for file in bag.iterdir()} == before
    assert file.read_text() == "mine"


def test_a_missing_parent_is_named(tmp_path):
    with pytest.raises(BagError, match="cannot be made.*expected .*missing") as error:
        sessions.new_recorder(tmp_path / "missing" / "run")
    assert str(tmp_path / "missing" / "run") in str(error.value)
    (tmp_path / "file").touch()
    with pytest.raises(BagError, match="cannot be made"):
        sessions.new_recorder(tmp_path / "file" / "run")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_a_directory_that_refuses_is_named(tmp_path):
    with pytest.raises(BagError, match=r"/proc/run: cannot be written \("):
        sessions.new_recorder("/proc/run")
    with pytest.raises(BagError, match="cannot be written"):
        sessions.new_recorder(tmp_path / ("long" * 100))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "change, text",
    [
        ({"command_interface": "torque"}, "torque.*voltage or position"),
        ({"period_ns": 0}, "period"),
        ({"namespace": "9 lives"}, "namespace"),
    ],
)
def test_unusable_arguments_leave_nothing(tmp_path, change, text):
    with pytest.raises(BagError, match=text):
        sessions.new_recorder(tmp_path / "run", **change)
    assert not list(tmp_path.iterdir())


def test_an_error_at_the_first_write_leaves_nothing(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("mcap.writer.Writer.flush", full)
    with pytest.raises(BagError, match="No space left"):
        sessions.new_recorder(tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_a_disk_that_fills_up_is_reported_once_and_leaves_a_bag_to_recover(tmp_path, monkeypatch):
    recorder = sessions.new_recorder(tmp_path / "run")
    for step in range(30):
        recorder.write_state(sessions.state(step))

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("mcap.writer.Writer.flush", full)
    with pytest.raises(BagError, match="No space left.*puma-sim recover"):
        for step in range(30, 60):
            recorder.write_state(sessions.state(step))
    with pytest.raises(BagError, match="earlier write failed"):
        recorder.write_state(sessions.state(60))
    recorder.close()
    assert not recorder.complete
    assert not (tmp_path / "run" / "metadata.yaml").exists()
    assert read_bag(tmp_path / "run", partial=True).steps[-1] >= 18


def test_an_interrupted_write_is_not_closed_as_if_whole(tmp_path, monkeypatch):
    recorder = sessions.new_recorder(tmp_path / "run")
    recorder.write_state(sessions.state(0))

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("mcap.writer.Writer.add_message", interrupt)
    with pytest.raises(KeyboardInterrupt):
        recorder.write_state(sessions.state(1))
    with pytest.raises(BagError, match="interrupted.*puma-sim recover"):
        recorder.close()
    assert read_bag(tmp_path / "run", partial=True).steps.tolist() == [0]


def test_states_come_step_by_step(tmp_path):
    with sessions.new_recorder(tmp_path / "run") as recorder:
        with pytest.raises(BagError, match="step 1 at 28000000 ns; expected step 0 at 0 ns"):
            recorder.write_state(sessions.state(1))
        with pytest.raises(BagError, match="no state was written yet"):
            recorder.write_command(0, RecordedCommand(None, (0.0, 0.0, 0.0)))
        recorder.write_state(sessions.state(0))
        with pytest.raises(BagError, match="step 2.*expected step 1"):
            recorder.write_state(sessions.state(2))
        with pytest.raises(BagError, match="step 1 at 5 ns"):
            recorder.write_state(sessions.state(1)._replace(time_ns=5))
        with pytest.raises(BagError, match="expected the time of the last state, 0 ns"):
            recorder.write_command(1, RecordedCommand(None, (0.0, 0.0, 0.0)))
        for values in ((1.0, 2.0), (1.0, 2.0, "x")):
            with pytest.raises(BagError, match="one number per joint"):
                recorder.write_command(0, RecordedCommand(None, values))
            with pytest.raises(BagError, match="one number per joint in each field"):
                recorder.write_state(sessions.state(1)._replace(current=values))
        with pytest.raises(BagError, match="by joint names; expected voltages"):
            recorder.write_command(0, RecordedCommand(("joint1",), (0.0,)))
        recorder.write_state(sessions.state(1))
    contents = read_bag(tmp_path / "run")
    assert contents.steps.tolist() == [0, 1]
    assert contents.commands == ()
    with pytest.raises(BagError, match="closed"):
        recorder.write_state(sessions.state(2))
    recorder.close()


# Errors of reading ---------------------------------------------------------------------------


def foreign_bag(path, topics):
    """A bag that the `rosbags` package writes: one text on each of ``topics``."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = messages.typestore()
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, messages.STRING, typestore=store)
            writer.write(connection, 0, messages.encode_data("hello"))
    return path


def test_a_bag_of_another_program_is_named_so(tmp_path):
    bag = foreign_bag(tmp_path / "other", ["/chatter"])
    with pytest.raises(BagError, match="other: there is no model on a topic sim_node/model"):
        read_bag(bag)
    assert [message.topic for message in iterate_messages(bag)] == ["/chatter"]


def test_two_simulators_in_one_bag_are_not_guessed_at(tmp_path):
    bag = foreign_bag(tmp_path / "two", ["/a/sim_node/model", "/b/sim_node/model"])
    with pytest.raises(BagError, match="2 topics are named sim_node/model"):
        read_bag(bag)


def test_a_missing_topic_is_named(tmp_path):
    bag = foreign_bag(tmp_path / "bare", ["/cell/sim_node/model"])
    with pytest.raises(BagError, match="/cell/voltage_controller/commands or /cell/position"):
        read_bag(bag)
    bag = foreign_bag(tmp_path / "more", ["/cell/sim_node/model", "/cell/voltage_controller/commands"])
    with pytest.raises(BagError, match="topic /cell/joint_states: is missing"):
        read_bag(bag)
    bag = foreign_bag(tmp_path / "text", ["/sim_node/model", "/voltage_controller/commands", "/joint_states"])
    with pytest.raises(BagError, match="/joint_states.*std_msgs/msg/String.*JointState"):
        read_bag(bag)


def test_what_is_no_bag_is_named_so(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text").write_text("time,voltage1\n")
    (tmp_path / "nothing").touch()
    for name, text in [
        ("absent", "does not exist"),
        ("empty", "is not a bag.*metadata.yaml"),
        ("text", "is not an MCAP file"),
        ("nothing", "is not an MCAP file"),
    ]:
        for read in (read_bag, lambda path: list(iterate_messages(path))):
            with pytest.raises(BagError, match=text) as error:
                read(tmp_path / name)
            assert str(tmp_path / name) in str(error.value)


def test_a_missing_metadata_file_points_to_recover(tmp_path):
    bag = sessions.record(tmp_path / "run", 3)
    (bag / "metadata.yaml").unlink()
    with pytest.raises(BagError, match="metadata.yaml is missing; `puma-sim recover .*run`"):
        read_bag(bag)


def test_a_truncated_file_points_to_recover(tmp_path):
    bag = sessions.record(tmp_path / "run", 100)
    data = mcap_of(bag).read_bytes()
    for length in (len(data) - 1, len(data) // 2, 20):
        mcap_of(bag).write_bytes(data[:length])
        for path in (bag, mcap_of(bag)):
            with pytest.raises(BagError, match=f"offset {length} .*puma-sim recover"):
                read_bag(path)


def test_a_damaged_chunk_is_named_by_its_offset(tmp_path):
    bag = sessions.record(tmp_path / "run", 100)
    data = bytearray(mcap_of(bag).read_bytes())
    data[len(data) // 2] ^= 1
    mcap_of(bag).write_bytes(data)
    with pytest.raises(BagError, match=r"run_0.mcap, offset \d+: the chunk is damaged \(crc"):
        read_bag(bag)


def change_metadata(bag, change):
    path = bag / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    change(content["rosbag2_bagfile_information"])
    path.write_text(yaml.safe_dump(content))


@pytest.mark.parametrize(
    "change, text",
    [
        (lambda info: info.pop("storage_identifier"), "storage_identifier is missing.*a text"),
        (lambda info: info.update(storage_identifier="sqlite3"), "'sqlite3'; expected 'mcap'"),
        (lambda info: info.update(version=10), "version is 10; expected at most 9"),
        (lambda info: info.update(version="9"), "version is '9'; expected a whole number"),
        (lambda info: info.update(relative_file_paths=[]), "expected names of files in this directory"),
        (lambda info: info.update(relative_file_paths=["run_0.mcap", 1]), "expected names of files in this directory"),
        (lambda info: info.update(relative_file_paths=["../x"]), "expected names of files in this directory"),
        (lambda info: info.update(relative_file_paths=["gone.mcap"]), "gone.mcap: does not exist"),
        (lambda info: info.update(compression_mode="FILE"), "compression_mode"),
        (
            lambda info: info["topics_with_message_count"][2].update(message_count=3),
            "topic /joint_states: the bag holds 4 messages; expected 3",
        ),
        (lambda info: info["topics_with_message_count"].pop(), "topic /sim_node/effects: .* expected None"),
    ],
)
def test_metadata_that_disagrees_is_named(tmp_path, change, text):
    bag = sessions.record(tmp_path / "run", 3)
    change_metadata(bag, change)
    with pytest.raises(BagError, match=text):
        read_bag(bag)


@pytest.mark.parametrize("content", ["{", "[]", "", "\xff", "a: " * 3000])
def test_metadata_that_is_not_yaml_is_named(tmp_path, content):
    bag = sessions.record(tmp_path / "run", 1)
    (bag / "metadata.yaml").write_bytes(content.encode("latin-1"))
    with pytest.raises(BagError, match="metadata.yaml"):
        read_bag(bag)


@given(position=st.floats(0, 1), value=st.integers(0, 255))
def test_a_changed_byte_is_read_or_named(tmp_path_factory, position, value):
    """Never another kind of error, wherever the byte stands."""
    bag = tmp_path_factory.getbasetemp() / "changed"
    if not bag.exists():
        sessions.record(bag, 10, "position")
    data = bytearray(mcap_of(bag).read_bytes())
    index = int(position * (len(data) - 1))
    kept, data[index] = data[index], value
    mcap_of(bag).write_bytes(data)
    try:
        for path in (bag, mcap_of(bag)):
            try:
                contents = read_bag(path)
            except BagError as error:
                assert str(bag) in str(error)
            else:
                assert len(contents.steps) == 11
    finally:
        data[index] = kept
        mcap_of(bag).write_bytes(data)
