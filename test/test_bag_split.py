# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A long session is several MCAP files, and reads, replays and recovers as one."""

from __future__ import annotations

import errno
import gc
import random
import shutil
import tracemalloc
from dataclasses import fields
from types import SimpleNamespace

import bag_sessions as sessions
import numpy as np
import pytest
from cli_support import call, record_session
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from puma_sim_core.arm.parameters import load_parameters
from puma_sim_core.arm.urdf import arm_urdf
from puma_sim_core.errors import BagError
from puma_sim_core.identify.data.bag_log import read_bag_log
from puma_sim_core.plant.plant import Plant
from puma_sim_core.recording.bag import RecordedCommand, iterate_messages, read_bag, recorder, recover
from puma_sim_core.simulation.replay import replay
from puma_sim_core.simulation.session_config import SessionConfig
from puma_sim_core.view.sources import session_motion

#: no whole number of periods; longer than what stands between two flushes
EVERY = 700_000_000
SPLITS = range(EVERY, 1000 * EVERY, EVERY)
#: steps of 28 ms whose states begin files
FIRSTS = (0, 25, 50, 75, 100)
STEPS = 110


def file_of(bag, number):
    return bag / f"{bag.name}_{number}.mcap"


def record(path, steps=STEPS, interface="position", **options):
    return sessions.record(path, steps, interface, **{"splits_ns": SPLITS, **options})


def contents_of(bag):
    """Bytes of each file; without the bag's name, which differs."""
    return {file.name.removeprefix(bag.name): file.read_bytes() for file in bag.iterdir() if file.suffix == ".mcap"}


def assert_same_session(one, other):
    for field in fields(one):
        if field.name not in ("path", "splits_ns"):
            ours, theirs = getattr(one, field.name), getattr(other, field.name)
            if isinstance(ours, np.ndarray):
                assert ours.dtype == theirs.dtype and ours.tobytes() == theirs.tobytes()
            else:
                assert ours == theirs


# -- writing ---------------------------------------------------------------------------------------


def test_a_split_that_is_never_reached_changes_no_byte(tmp_path):
    bags = []
    for name, splits in (("default", None), ("never", ()), ("late", [STEPS * sessions.PERIOD_NS + 1])):
        (tmp_path / name).mkdir()
        bags.append(record(tmp_path / name / "run", splits_ns=splits))
    for bag in bags:
        assert sorted(file.name for file in bag.iterdir()) == ["metadata.yaml", "run_0.mcap"]
        for file in bag.iterdir():
            assert file.read_bytes() == (bags[0] / file.name).read_bytes()


def test_a_file_holds_an_hour_of_simulated_time(tmp_path):
    period_ns = 600 * 10**9
    bag = sessions.record(tmp_path / "run", 13, period_ns=period_ns)
    steps = [
        [m.log_time // period_ns for _, c, m in messages_of(file_of(bag, n)) if c.topic == "/joint_states"]
        for n in range(3)
    ]
    assert steps == [[0, 1, 2, 3, 4, 5], [6, 7, 8, 9, 10, 11], [12, 13]]
    assert recorder.FILE_NS == 3600 * 10**9


def messages_of(file):
    with open(file, "rb") as stream:
        return list(make_reader(stream, validate_crcs=True).iter_messages())


def test_each_file_begins_with_a_state_and_has_the_inputs_of_its_states(tmp_path):
    bag = record(tmp_path / "run")
    for number, first in enumerate(FIRSTS):
        found = messages_of(file_of(bag, number))
        states = [message.log_time for _, channel, message in found if channel.topic == "/joint_states"]
        steps = range(first, (*FIRSTS, STEPS + 1)[number + 1])
        assert states == [step * sessions.PERIOD_NS for step in steps]
        assert {message.log_time for *_, message in found} == set(states)
        if number:
            assert found[0][1].topic == "/joint_states"
        commands = [message for _, channel, message in found if channel.topic.endswith("commands")]
        assert len(commands) == sum(len(sessions.commands(step, "position")) for step in steps)


def test_sequence_numbers_go_on_in_the_next_file(tmp_path):
    bag = record(tmp_path / "run")
    numbers = {}
    for number in range(len(FIRSTS)):
        with open(file_of(bag, number), "rb") as file:
            for found in StreamReader(file).records:
                if isinstance(found, Message):
                    numbers.setdefault(found.channel_id, []).append(found.sequence)
    assert len(numbers) >= 6
    assert all(found == list(range(len(found))) for found in numbers.values())


def test_equal_sessions_are_equal_bytes_in_all_files(tmp_path):
    one, renamed = (record(tmp_path / name) for name in ("run", "renamed"))
    assert contents_of(one) == contents_of(renamed)
    assert len(contents_of(one)) == len(FIRSTS)


def test_steps_that_are_left_out_begin_one_file_however_many(tmp_path):
    with sessions.new_recorder(tmp_path / "run", splits_ns=SPLITS) as bag:
        bag.write_state(sessions.state(0))
        bag.skip_to(60)
        bag.write_state(sessions.state(60))
        bag.write_state(sessions.state(61))
    assert len(contents_of(tmp_path / "run")) == 2
    assert read_bag(tmp_path / "run").steps.tolist() == [0, 60, 61]


def test_memory_does_not_grow_with_the_steps(tmp_path):
    """Each state is a chunk here: unsplit, each adds some 700 bytes to the index."""
    period_ns, per_file, values = 500_000_000, 50, (0.5, -0.5, 0.25)
    numbers = dict.fromkeys(("position", "velocity", "current", "voltage", "effort"), values)
    splits = range(per_file * period_ns, 10**15, per_file * period_ns)
    sizes, step = [], 0
    with sessions.new_recorder(tmp_path / "run", period_ns=period_ns, splits_ns=splits) as bag:
        tracemalloc.start()
        try:
            for end in (5 * per_file, 10 * per_file, 40 * per_file):
                while step < end:
                    bag.write_state(SimpleNamespace(step=step, time_ns=step * period_ns, **numbers))
                    bag.write_command(step * period_ns, RecordedCommand(None, values))
                    step += 1
                gc.collect()
                sizes.append(tracemalloc.get_traced_memory()[0])
        finally:
            tracemalloc.stop()
    assert len(contents_of(tmp_path / "run")) == 40
    # a finished file leaves its name and its numbers of messages; 1500 steps would add 1 MB to one index
    assert sizes[2] - sizes[1] < 50_000, sizes


# -- a disk that refuses ---------------------------------------------------------------------------


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def assert_recoverable(bag, tmp_path, trailing):
    """What was written before the state that begins the second file."""
    assert not (bag / "metadata.yaml").exists()
    result = recover(bag)
    reference = record(tmp_path / "reference", FIRSTS[1] - 1, trailing=trailing)
    assert contents_of(result.path) == contents_of(reference)
    return result


def write_until(bag, end, start=0):
    for step in range(start, end):
        bag.write_state(sessions.state(step))
        for command in sessions.commands(step, "position"):
            bag.write_command(step * sessions.PERIOD_NS, command)


def test_a_disk_that_is_full_when_a_file_is_finished(tmp_path, monkeypatch):
    bag = sessions.new_recorder(tmp_path / "run", "position", splits_ns=SPLITS)
    write_until(bag, FIRSTS[1])
    bag.flush()
    monkeypatch.setattr(Writer, "finish", full)
    with pytest.raises(BagError, match="run: cannot be written .No space left.*puma-sim recover"):
        bag.write_state(sessions.state(FIRSTS[1]))
    monkeypatch.undo()
    with pytest.raises(BagError, match="earlier write failed"):
        bag.write_state(sessions.state(FIRSTS[1]))
    bag.close()
    assert not bag.complete
    assert sorted(contents_of(tmp_path / "run")) == ["_0.mcap"]
    assert not assert_recoverable(tmp_path / "run", tmp_path, trailing=False).was_complete


def test_a_file_that_cannot_be_begun_leaves_the_others(tmp_path):
    bag = sessions.new_recorder(tmp_path / "run", "position", splits_ns=SPLITS)
    write_until(bag, FIRSTS[1])
    (tmp_path / "run" / "run_1.mcap").touch()
    with pytest.raises(BagError, match="run: cannot be written .File exists.*puma-sim recover"):
        bag.write_state(sessions.state(FIRSTS[1]))
    bag.close()
    assert not bag.complete
    (tmp_path / "run" / "run_1.mcap").unlink()
    # the first file was finished, with the inputs of its last state
    assert assert_recoverable(tmp_path / "run", tmp_path, trailing=True).was_complete


def test_a_split_that_is_interrupted_is_not_closed_as_if_whole(tmp_path, monkeypatch):
    bag = sessions.new_recorder(tmp_path / "run", "position", splits_ns=SPLITS)
    write_until(bag, FIRSTS[1])

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(recorder, "FileWriter", interrupt)
    with pytest.raises(KeyboardInterrupt):
        bag.write_state(sessions.state(FIRSTS[1]))
    monkeypatch.undo()
    with pytest.raises(BagError, match="interrupted.*puma-sim recover"):
        bag.close()
    assert_recoverable(tmp_path / "run", tmp_path, trailing=True)


# -- reading ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("interface", ["voltage", "position"])
def test_a_split_bag_reads_as_one(tmp_path, interface):
    whole, split = (record(tmp_path / name, interface=interface, splits_ns=s) for name, s in (("w", ()), ("s", SPLITS)))
    assert_same_session(read_bag(split), read_bag(whole))
    assert list(iterate_messages(split)) == list(iterate_messages(whole))
    assert read_bag(split).splits_ns == tuple(step * sessions.PERIOD_NS for step in FIRSTS[1:])
    assert read_bag(whole).splits_ns == ()


def test_files_come_in_the_order_of_their_numbers(tmp_path):
    """The tenth stands behind the ninth, with `metadata.yaml` and without."""
    bag = record(tmp_path / "run", 400)
    assert len(contents_of(bag)) > 12
    whole = read_bag(record(tmp_path / "whole", 400, splits_ns=()))
    assert_same_session(read_bag(bag), whole)
    (bag / "metadata.yaml").unlink()
    assert_same_session(read_bag(bag, partial=True), whole)


def test_a_file_that_is_missing_is_named(tmp_path):
    for number in range(len(FIRSTS)):
        bag = record(tmp_path / f"run{number}")
        file_of(bag, number).unlink()
        for read in (read_bag, iterate_messages):
            with pytest.raises(BagError, match=f"run{number}_{number}.mcap: does not exist"):
                read(bag)


def test_a_file_that_is_cut_off_is_named(tmp_path):
    bag = record(tmp_path / "run")
    file_of(bag, 2).write_bytes(file_of(bag, 2).read_bytes()[:-5])
    for read in (read_bag, iterate_messages):
        with pytest.raises(BagError, match=r"run_2.mcap: the file ends at offset \d+ without.*puma-sim recover .*run`"):
            read(bag)


def test_files_in_another_order_or_of_another_session_are_refused(tmp_path):
    bag, short = record(tmp_path / "run"), record(tmp_path / "short", 30)
    first, second = (file_of(bag, number).read_bytes() for number in (1, 2))
    file_of(bag, 1).write_bytes(second), file_of(bag, 2).write_bytes(first)
    with pytest.raises(BagError, match=r"run_2.mcap, topic /joint_states: a message at \d+ ns stands after"):
        read_bag(bag)
    file_of(bag, 1).write_bytes(file_of(short, 1).read_bytes()), file_of(bag, 2).write_bytes(second)
    with pytest.raises(BagError, match=r"run, topic .*: the bag holds \d+ messages; expected \d+, as metadata.yaml"):
        read_bag(bag)


def test_the_first_file_reads_alone_and_a_later_one_says_what_to_name(tmp_path):
    bag = record(tmp_path / "run")
    assert read_bag(file_of(bag, 0)).steps.tolist() == list(range(FIRSTS[1]))
    for read in (read_bag, lambda path: read_bag(path, partial=True), recover):
        with pytest.raises(BagError, match=r"run_2.mcap: there is no model .*its first file: .* name the directory"):
            read(file_of(bag, 2))


def test_replay_view_and_logs_take_a_split_bag(tmp_path):
    urdf = arm_urdf(load_parameters("bejczy"))
    config = SessionConfig(Plant.of("bejczy"), "voltage")
    commands = {step: [(None, (0.1 * step, -5.0, 1.0))] for step in range(0, 90, 3)}
    options = {"urdf": urdf, "splits_ns": SPLITS}
    split = record_session(tmp_path / "split", config, commands, 90, **options)
    whole = record_session(tmp_path / "whole", config, commands, 90, **{**options, "splits_ns": ()})
    assert len(contents_of(split)) == 4
    found = replay(split)
    assert found.identical and (found.steps, found.commands) == (90, 30)
    ours, theirs = read_bag_log(split, 3), read_bag_log(whole, 3)
    for name in ("time", "voltage", "position", "velocity", "current"):
        assert np.array_equal(getattr(ours, name), getattr(theirs, name))
    ours, theirs = session_motion(split), session_motion(whole)
    for name in ("time", "position", "voltage", "current"):
        assert np.array_equal(getattr(ours, name), getattr(theirs, name))


# -- recovery --------------------------------------------------------------------------------------


def killed(bag, files, length=None):
    """The first ``files`` files of a bag; the last of them with its first ``length`` bytes only."""
    left = bag.with_name("killed")
    shutil.rmtree(left, ignore_errors=True)
    left.mkdir()
    for number in range(files):
        shutil.copy(file_of(bag, number), file_of(left, number))
    if length is not None:
        file_of(left, files - 1).write_bytes(file_of(left, files - 1).read_bytes()[:length])
    return left


def recovered(left, folder, trailing=False):
    """Recover: byte for byte what an undisturbed recorder would have closed at the last state."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    result = recover(left, out)
    reference = folder / f"reference_{result.steps}_{trailing}"
    if not reference.exists():
        record(reference, result.steps, trailing=trailing)
    assert contents_of(out) == contents_of(reference)
    text = (reference / "metadata.yaml").read_text().replace(reference.name, "out")
    assert (out / "metadata.yaml").read_text() == text
    assert result.was_complete == trailing
    return result


@pytest.mark.long
def test_a_recorder_killed_in_its_last_file_loses_what_was_not_written(tmp_path):
    bag = record(tmp_path / "run")
    size = file_of(bag, 3).stat().st_size
    steps = []
    # up to the index, of whose end nothing is needed
    for length in range(0, size - 200, 487):
        left = killed(bag, 4, length)
        result = recovered(left, tmp_path)
        steps.append(result.steps)
        (damage,) = result.damage
        assert damage.path == file_of(left, 3)
        assert damage.offset + damage.size == length
    assert steps == sorted(steps)
    # without a whole period of the last file the bag ends with the file before
    assert recovered(killed(bag, 4, size - 1), tmp_path).damage == ()
    assert (steps[0], steps[-1]) == (FIRSTS[3] - 1, FIRSTS[4] - 1)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_recorder_ended_by_sigkill_in_any_file_loses_less_than_a_second(tmp_path, seed):
    target = random.Random(seed).randrange(60, 600)
    with sessions.endless(tmp_path / "run", "position", EVERY) as process:
        try:
            while int(process.stdout.readline()) < target:
                pass
        finally:
            process.kill()
        last = [target, *map(int, process.stdout.read().split())][-1]
    assert len(contents_of(tmp_path / "run")) > target * sessions.PERIOD_NS // EVERY
    result = recover(tmp_path / "run")
    assert (last - result.steps) * sessions.PERIOD_NS < 10**9
    reference = record(tmp_path / "reference", result.steps, trailing=result.was_complete)
    assert contents_of(result.path) == contents_of(reference)


def test_a_recorder_killed_between_two_files_loses_nothing_before(tmp_path):
    bag = record(tmp_path / "run")
    # the second file is finished, the third not begun; begun but empty; with its head only
    assert recovered(killed(bag, 2), tmp_path, trailing=True).damage == ()
    for length in (0, 3, 8, 60):
        left = killed(bag, 3, length)
        result = recovered(left, tmp_path)
        assert result.steps == FIRSTS[2] - 1
        (damage,) = result.damage
        assert damage.path == file_of(left, 2) and damage.offset + damage.size == length
    # the second is not finished: its index is cut
    size = file_of(bag, 1).stat().st_size
    assert recovered(killed(bag, 2, size - 100), tmp_path).steps == FIRSTS[2] - 1


def test_a_bag_that_lacks_only_its_metadata_is_recovered_whole(tmp_path):
    left = killed(record(tmp_path / "run", 400), len(contents_of(tmp_path / "run")))
    assert recovered(left, tmp_path, trailing=True).steps == 400


def test_at_every_step_all_but_half_a_second_is_on_the_disk(tmp_path):
    """The files, read while they are written, are what a killed process would leave."""
    with sessions.new_recorder(tmp_path / "run", "position", splits_ns=SPLITS) as bag:
        for step in range(STEPS):
            write_until(bag, step + 1, step)
            found = read_bag(tmp_path / "run", partial=True)
            assert (step - found.steps[-1]) * sessions.PERIOD_NS <= 500_000_000
            if step in FIRSTS:
                assert found.steps[-1] == step


def test_recovery_goes_on_behind_a_missing_file_and_names_it(tmp_path, capsys):
    for number, listed in ((2, True), (2, False), (len(FIRSTS) - 1, True)):
        bag = record(tmp_path / f"run{number}{listed}")
        file_of(bag, number).unlink()
        if not listed:
            (bag / "metadata.yaml").unlink()
        result = recover(bag)
        assert not result.was_complete
        assert [each.path for each in result.damage] == [file_of(bag, number)]
    assert result.steps == FIRSTS[-1] - 1 and result.missing == ()
    assert recover(tmp_path / "run2True", tmp_path / "again").missing == ((FIRSTS[2], FIRSTS[3] - 1),)
    capsys.readouterr()
    assert call("recover", tmp_path / "run2False", "--out", tmp_path / "third") == 0
    out = capsys.readouterr().out
    assert "run2False_2.mcap, offset 0: does not exist; 0 bytes not used" in out
    assert f"steps {FIRSTS[2]} to {FIRSTS[3] - 1} are missing" in out


def test_without_the_first_file_there_is_nothing_to_recover(tmp_path):
    bag = record(tmp_path / "run")
    file_of(bag, 0).unlink()
    with pytest.raises(BagError, match="run_0.mcap.*does not exist, and there is no model"):
        recover(bag)
    assert not (tmp_path / "run_recovered").exists()


def test_files_of_several_bags_in_one_directory_are_not_guessed_at(tmp_path):
    bag = record(tmp_path / "run")
    (bag / "metadata.yaml").unlink()
    shutil.copy(file_of(bag, 0), bag / "other_0.mcap")
    with pytest.raises(BagError, match="run: holds 6 MCAP files"):
        recover(bag)
