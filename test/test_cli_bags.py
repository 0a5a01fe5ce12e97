# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""`puma-sim replay` and `puma-sim recover`: what they print, how they end, what they leave."""

from __future__ import annotations

import math
import re
import shutil
import sys

import pytest
import yaml
from arm_reference import plant_of
from cli_support import call, complaints, contents, puma_sim, record_session

from puma_sim_core.jit import BACKEND
from puma_sim_core.recording.bag import messages, read_bag
from puma_sim_core.simulation.session import SessionConfig

STEPS = 60
EFFECTS = ("coulomb_friction:joint=1,torque=9", "presliding_friction:joint=2,torque=4", "payload:mass=1")
VOLTS = {
    0: [(None, (12.0, -20.0, 7.0))],
    9: [(None, (60.0, 0.0, -5.0)), (None, (8.0, 3.0, -0.0))],
    30: [(None, (-4.0, -15.0, 2.0))],
}
SETPOINTS = {
    0: [(None, (0.2, -0.3, 0.1))],
    7: [(("joint3", "joint1"), (0.4, 0.3))],
    20: [(("joint2",), (-9.0,)), (None, (0.1, -0.1, 0.1))],
}


@pytest.fixture(params=["voltage", "position"])
def recorded(request, tmp_path):
    config = SessionConfig(plant_of(*EFFECTS), request.param, command_timeout=0.3)
    commands = VOLTS if request.param == "voltage" else SETPOINTS
    return record_session(tmp_path / "run", config, commands, STEPS)


def mcap_of(bag):
    return bag / f"{bag.name}_0.mcap"


def assert_refused(capsys, tmp_path, *arguments, says):
    """The command fails with one line, and everything is as it was."""
    before = contents(tmp_path)
    capsys.readouterr()
    assert call(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and re.fullmatch(r"puma-sim: .+; expected .+\n", err), err
    for part in says:
        assert part in err
    assert contents(tmp_path) == before


# --------------------------------------------------------------------------------------- replay


def test_a_bag_replays_identical_from_its_directory_and_its_file(recorded, capsys):
    given = len(read_bag(recorded).commands)
    for path in (recorded, mcap_of(recorded)):
        assert call("replay", path) == 0
        out = capsys.readouterr().out
        assert f"{STEPS} steps and {given} commands" in out and "replay identical" in out
        assert f"({BACKEND} kernel)" in out and "recorded by version" in out


def test_another_process_and_the_other_kernel_replay_identical(recorded):
    for kernel in ("auto", "python"):
        done = puma_sim("replay", recorded, PUMA_SIM_KERNEL=kernel)
        assert (done.returncode, complaints(done)) == (0, [])
        assert "replay identical" in done.stdout


@pytest.mark.parametrize("field, joint, unit", [("position", 2, "rad"), ("current", 1, "A"), ("voltage", 3, "V")])
def test_the_first_step_that_differs_in_one_bit_is_named(tmp_path, capsys, field, joint, unit):
    def falsified(state):
        if state.step < 17:
            return state
        values = list(getattr(state, field))
        values[joint - 1] = math.nextafter(values[joint - 1], math.inf)
        return state._replace(**{field: tuple(values)})

    bag = record_session(tmp_path / "run", SessionConfig(plant_of()), VOLTS, 30, falsified)
    before = contents(tmp_path)
    assert call("replay", bag) == 1
    out, err = capsys.readouterr()
    assert f"replay differs first at step 17 (0.476 s): {field} of joint {joint} was" in out
    assert unit in out and "identical" not in out and err == ""
    assert contents(tmp_path) == before


def test_a_missing_command_shows(tmp_path, capsys):
    """The states are those of a session with one more command than the bag tells of."""
    config = SessionConfig(plant_of())
    true = record_session(tmp_path / "true", config, VOLTS, 40)
    fewer = {step: given for step, given in VOLTS.items() if step != 30}
    states = iter(_states(true))
    false = record_session(tmp_path / "false", config, fewer, 40, lambda state: next(states))
    assert call("replay", true) == 0
    assert call("replay", false) == 1
    assert "differs first at step 31" in capsys.readouterr().out


def _states(bag):
    from puma_sim_core.simulation.session import SessionState

    found = read_bag(bag)
    columns = (found.steps, found.time_ns, found.position, found.velocity, found.current, found.voltage, found.effort)
    return [SessionState(*row) for row in zip(*(column.tolist() for column in columns))]


def test_bags_that_cannot_be_replayed_are_refused(tmp_path, capsys):
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = messages.typestore()
    with Writer(tmp_path / "other", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/chatter", messages.STRING, typestore=store)
        writer.write(connection, 0, messages.encode_data("hello"))
    (tmp_path / "text.mcap").write_text("time,voltage1\n")
    (tmp_path / "empty").mkdir()
    for name, says in (
        ("other", ["other: there is no model", "sim_node/model"]),
        ("nowhere", ["nowhere: does not exist"]),
        ("text.mcap", ["text.mcap", "is not an MCAP file"]),
        ("empty", ["empty: is not a bag", "metadata.yaml"]),
    ):
        assert_refused(capsys, tmp_path, "replay", tmp_path / name, says=says)


def test_a_truncated_bag_is_refused_and_recover_is_named(recorded, tmp_path, capsys):
    data = mcap_of(recorded).read_bytes()
    for length in (len(data) - 1, 2 * len(data) // 3):
        mcap_of(recorded).write_bytes(data[:length])
        assert_refused(
            capsys, tmp_path, "replay", recorded, says=[mcap_of(recorded).name, f"offset {length}", "puma-sim recover"]
        )


@pytest.mark.parametrize(
    "change, says",
    [
        (lambda m: m.update(format="puma-sim session 9"), ["session format 'puma-sim session 9'"]),
        (lambda m: m["model"]["effects"].append({"name": "magic", "joint": 1}), ["unknown effect 'magic'"]),
        (lambda m: m["model"].update(format="puma-sim model 7"), ["format 'puma-sim model 7'"]),
        (lambda m: m.update(gravity_compensation=True), ["gravity_compensation"]),
        (lambda m: m["model"]["parameters"]["links"]["link1"]["mass"].update(unit="lb"), ["unit 'lb'"]),
        (lambda m: m.update(period=0.3), ["10 ms", "8 ms"]),
    ],
)
def test_a_model_that_this_version_cannot_rebuild_is_refused(tmp_path, capsys, monkeypatch, change, says):
    """A later version may record what this one does not know: it says which version that was."""
    mapping = SessionConfig(plant_of(*EFFECTS)).to_mapping()
    change(mapping)
    mapping["version"] = "7.1.0"
    config = SessionConfig(plant_of(*EFFECTS))
    monkeypatch.setattr(SessionConfig, "to_mapping", lambda self: mapping)
    bag = record_session(tmp_path / "run", config, {}, 3)
    monkeypatch.undo()
    assert_refused(capsys, tmp_path, "replay", bag, says=["sim_node/model", "recorded by version 7.1.0", *says])


# ------------------------------------------------------------------------------------- publish


def test_publishing_without_ros_says_what_is_missing(recorded, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    monkeypatch.delitem(sys.modules, "puma_sim_ros.bag_publisher", raising=False)
    assert_refused(
        capsys, tmp_path, "replay", recorded, "--publish", says=["replay --publish: rclpy cannot be imported", "ROS 2"]
    )


def test_the_rate_belongs_to_publishing(recorded, tmp_path, capsys):
    assert_refused(capsys, tmp_path, "replay", recorded, "--rate", "2", says=["--rate 2 without --publish"])
    assert_refused(
        capsys, tmp_path, "replay", recorded, "--publish", "--rate", "x", says=["--rate: 'x'", "a finite number"]
    )


def test_publishing_goes_by_the_rate(recorded, capsys, monkeypatch):
    from puma_sim_core.cli import records

    calls = []

    def publish(bag, rate):
        calls.append((bag, rate))
        return 7

    monkeypatch.setattr(records, "_publisher", lambda: publish)
    assert call("replay", recorded, "--publish") == 0
    assert call("replay", recorded, "--publish", "--rate", "2.5") == 0
    assert calls == [(str(recorded), 1.0), (str(recorded), 2.5)]
    assert capsys.readouterr().out == "7 messages published\n" * 2


# ------------------------------------------------------------------------------------- recover


def test_a_cut_bag_is_recovered_and_replays(recorded, tmp_path):
    data = mcap_of(recorded).read_bytes()
    mcap_of(recorded).write_bytes(data[: 3 * len(data) // 4])
    (recorded / "metadata.yaml").unlink()
    done = puma_sim("recover", recorded)
    assert (done.returncode, complaints(done)) == (0, [])
    whole = tmp_path / "run_recovered"
    steps = int(read_bag(whole).steps[-1])
    assert str(whole) in done.stdout and f"{steps} steps" in done.stdout and 0 < steps < STEPS
    assert call("replay", whole) == 0


def test_recover_goes_where_it_is_told(recorded, tmp_path, capsys):
    assert call("recover", recorded, "--out", tmp_path / "there") == 0
    assert f"{STEPS} steps, 1.680 s" in capsys.readouterr().out
    assert call("replay", tmp_path / "there") == 0


def test_recover_writes_over_nothing_unless_told_so(recorded, tmp_path, capsys):
    shutil.copytree(recorded, tmp_path / "run_recovered")
    assert_refused(capsys, tmp_path, "recover", recorded, says=["run_recovered", "exists already", "--force"])
    assert_refused(capsys, tmp_path, "recover", recorded, "--out", recorded, says=["exists already"])
    assert_refused(capsys, tmp_path, "recover", tmp_path / "nowhere", says=["nowhere: does not exist"])


def test_recover_replaces_a_bag_and_nothing_else_where_it_is_told_to(recorded, tmp_path, capsys):
    assert call("recover", recorded, "--out", tmp_path / "first") == 0
    record_session(tmp_path / "old", SessionConfig(plant_of()), {}, 3)
    assert call("recover", recorded, "--out", tmp_path / "old", "--force") == 0
    assert read_bag(tmp_path / "old").steps[-1] == STEPS
    assert sorted(path.name for path in (tmp_path / "old").iterdir()) == ["metadata.yaml", "old_0.mcap"]
    assert mcap_of(tmp_path / "old").read_bytes() == mcap_of(tmp_path / "first").read_bytes()

    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    for name in ("mine", "file"):
        refused = ("recover", recorded, "--out", tmp_path / name, "--force")
        assert_refused(capsys, tmp_path, *refused, says=[name, "is no bag"])
    refused = ("recover", recorded, "--out", recorded, "--force")
    assert_refused(capsys, tmp_path, *refused, says=["is the bag that is recovered"])
    # what cannot be read replaces nothing
    mcap_of(recorded).write_bytes(b"no bag")
    assert_refused(
        capsys, tmp_path, "recover", recorded, "--out", tmp_path / "old", "--force", says=[mcap_of(recorded).name]
    )


def test_the_model_in_a_bag_is_a_model_file(recorded, tmp_path, capsys):
    """What a bag holds can be simulated: its model is the mapping of a model file."""
    mapping = yaml.safe_load(read_bag(recorded).config_text)["model"]
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(mapping))
    assert call("model", "--model", tmp_path / "model.yaml") == 0
    assert yaml.safe_load(capsys.readouterr().out) == mapping
