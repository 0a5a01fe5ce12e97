# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""A killed recorder loses at most the last second, and never more than can be said."""

from __future__ import annotations

import random
import struct

import bag_sessions as sessions
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import read_bag, recover

pytestmark = pytest.mark.long
SECOND = 1_000_000_000


def mcap_of(bag):
    return bag / f"{bag.name}_0.mcap"


def assert_recovered(bag, out, folder, command_interface):
    """``out`` is what an undisturbed recorder would have closed at its last state.

    So states, commands, model and index are right to the last bit, whatever was lost.
    """
    steps = len(read_bag(out).steps) - 1
    reference = folder / f"reference_{steps}_{command_interface}"
    if not reference.exists():
        sessions.record(reference, steps, command_interface, trailing=False)
    assert mcap_of(out).read_bytes() == mcap_of(reference).read_bytes()
    return steps


@pytest.mark.parametrize("command_interface", ["voltage", "position"])
@pytest.mark.parametrize("seed", range(4))
def test_a_recorder_ended_by_sigkill_loses_less_than_a_second(tmp_path, seed, command_interface):
    """Kill a real process at a random step; it prints each step when it has written it."""
    target = random.Random(f"{seed} {command_interface}").randrange(1, 900)
    bag = tmp_path / "run"
    with sessions.endless(bag, command_interface) as process:
        try:
            while int(process.stdout.readline()) < target:
                pass
        finally:
            process.kill()
        written = [int(line) for line in process.stdout.read().splitlines()]
    last = written[-1] if written else target
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    assert sorted(before) == ["run_0.mcap"]

    result = recover(bag)
    assert result.path == tmp_path / "run_recovered"
    assert not result.was_complete
    steps = assert_recovered(bag, result.path, tmp_path, command_interface)
    assert (result.steps, result.last_time_ns) == (steps, steps * sessions.PERIOD_NS)
    assert (last - steps) * sessions.PERIOD_NS < SECOND
    assert {file.name: file.read_bytes() for file in bag.iterdir()} == before


@pytest.mark.parametrize("period_ns", [1_000_000, sessions.PERIOD_NS, 100_000_000, 2 * SECOND])
def test_at_every_step_all_but_the_last_second_is_on_the_disk(tmp_path, period_ns):
    """The file, read while it is written, is what a killed process would leave."""
    recorder = sessions.new_recorder(tmp_path / "run", period_ns=period_ns)
    for step in range(150):
        recorder.write_state(sessions.state(step, period_ns))
        for command in sessions.commands(step, "voltage"):
            recorder.write_command(step * period_ns, command)
        found = read_bag(tmp_path / "run", partial=True)
        assert not found.complete
        assert (step - found.steps[-1]) * period_ns < SECOND
    recorder.close()
    assert read_bag(tmp_path / "run").steps[-1] == 149


def test_many_commands_at_one_step_are_kept_with_it(tmp_path):
    """A chunk that its size closes, not the time, may hold half a period."""
    recorder = sessions.new_recorder(tmp_path / "run", "position")
    command = sessions.RecordedCommand(None, (1.0, 2.0, 3.0))
    for step in range(3):
        recorder.write_state(sessions.state(step))
        for _ in range(3000):
            recorder.write_command(step * sessions.PERIOD_NS, command)
    recorder.flush()
    result = recover(tmp_path / "run")
    assert result.steps == 2
    assert [step for step, _ in read_bag(result.path).commands] == [0] * 3000 + [1] * 3000
    recorder.close()
    assert len(read_bag(tmp_path / "run").commands) == 9000


def record_boundaries(data):
    """Offsets at which a record starts, of those inside chunks too."""
    offsets, offset = [], 8
    while offset < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, offset)
        offsets.append(offset)
        if opcode == Opcode.CHUNK:
            inner = offset + 9 + 32 + 8
            while inner < offset + 9 + length:
                offsets.append(inner)
                inner += 9 + struct.unpack_from("<Q", data, inner + 1)[0]
        offset += 9 + length
    return [*offsets, len(data) - 8]


class Cut:
    """A bag of 30 steps that is cut at one length after the other."""

    STEPS = 30

    def __init__(self, folder, command_interface):
        self.folder, self.command_interface = folder, command_interface
        whole = sessions.record(folder / "whole", self.STEPS, command_interface)
        self.data = mcap_of(whole).read_bytes()
        self.bag = folder / "cut"
        self.bag.mkdir()

    def steps_after(self, length):
        """Recover the first ``length`` bytes; the last step, or None if there was nothing."""
        cut = mcap_of(self.bag)
        cut.write_bytes(self.data[:length])
        out = self.folder / f"out_{length}"
        try:
            result = recover(self.bag, out)
        except BagError as error:
            assert str(self.bag) in str(error)
            assert not out.exists()
            return None
        finally:
            assert cut.read_bytes() == self.data[:length]
        if result.was_complete:
            assert mcap_of(out).read_bytes() == self.data
            steps = self.STEPS
        else:
            steps = assert_recovered(self.bag, out, self.folder, self.command_interface)
        for file in out.iterdir():
            file.unlink()
        out.rmdir()
        return steps


@pytest.mark.parametrize("command_interface", ["voltage", pytest.param("position", marks=pytest.mark.thorough)])
def test_a_file_cut_at_any_record_gives_what_stands_before_the_cut(tmp_path, command_interface):
    cut = Cut(tmp_path, command_interface)
    steps = [cut.steps_after(length) for length in [0, 5, 8, *record_boundaries(cut.data)]]
    found = [step for step in steps if step is not None]
    assert steps[: len(steps) - len(found)] == [None] * (len(steps) - len(found))
    assert found == sorted(found)
    assert set(found) == set(range(cut.STEPS + 1))
    assert cut.steps_after(len(cut.data)) == cut.STEPS


@pytest.fixture(scope="module")
def cut_anywhere(tmp_path_factory):
    return Cut(tmp_path_factory.mktemp("anywhere"), "position")


@settings(max_examples=60)
@given(position=st.floats(0, 1))
def test_a_file_cut_at_any_byte_is_recovered_or_refused(cut_anywhere, position):
    length = int(position * len(cut_anywhere.data))
    steps = cut_anywhere.steps_after(length)
    longer = cut_anywhere.steps_after(min(length + 999, len(cut_anywhere.data)))
    assert steps is None or steps <= longer


@settings(max_examples=60)
@given(position=st.floats(0, 1), mask=st.integers(1, 255), length=st.integers(1, 3000))
def test_damaged_bytes_are_recovered_around_or_refused(cut_anywhere, position, mask, length):
    """Whatever the damage: a bag that reads, or an error that names the file."""
    data = bytearray(cut_anywhere.data)
    start = int(position * (len(data) - 1))
    for index in range(start, min(start + length, len(data))):
        data[index] ^= mask
    bag = cut_anywhere.folder / "damaged"
    bag.mkdir(exist_ok=True)
    mcap_of(bag).write_bytes(data)
    out = cut_anywhere.folder / "out_damaged"
    try:
        result = recover(bag, out)
    except BagError as error:
        assert str(bag) in str(error)
        assert not out.exists()
        return
    found = read_bag(out)
    assert found.steps[-1] == result.steps and found.missing == result.missing
    assert len(found.steps) == result.steps + 1 - sum(last + 1 - first for first, last in found.missing)
    for file in out.iterdir():
        file.unlink()
    out.rmdir()


def test_recovery_goes_on_behind_damaged_chunks(tmp_path):
    """Two of the six chunks are damaged, one in a number, one in its length: only their steps are missing."""
    bag = sessions.record(tmp_path / "run", 100)
    data = bytearray(mcap_of(bag).read_bytes())
    chunks = [offset for offset in record_boundaries(data) if data[offset] == Opcode.CHUNK and offset + 99 < len(data)]
    sizes = [9 + struct.unpack_from("<Q", data, offset + 1)[0] for offset in chunks]
    chunks, sizes = zip(*(pair for pair in zip(chunks, sizes) if pair[1] > 2000))
    data[chunks[2] + sizes[2] // 2] ^= 1
    data[chunks[4] + 3] ^= 0x40
    mcap_of(bag).write_bytes(data)
    result = recover(bag)
    assert not result.was_complete and result.steps == 100
    # with the index of its messages that stands behind each of them
    assert [(each.offset, each.size) for each in result.damage] == [
        (chunks[n], chunks[n + 1] - chunks[n]) for n in (2, 4)
    ]
    whole, found = (read_bag(path) for path in (sessions.record(tmp_path / "whole", 100), result.path))
    assert found.missing == result.missing and len(result.missing) == 2
    lost = {step for first, last in result.missing for step in range(first, last + 1)}
    assert 20 < len(lost) < 50 and found.steps.tolist() == [n for n in range(101) if n not in lost]
    for name in ("position", "velocity", "effort", "current", "voltage"):
        assert sessions.bits(getattr(found, name).ravel()) == sessions.bits(getattr(whole, name)[found.steps].ravel())
    # what the last state before a hole was given stands in its chunk or in the one that is lost
    edges = {first - 1 for first, _ in result.missing}
    kept = [each for each in whole.commands if each[0] not in lost and each[0] < 100]
    assert found.commands == tuple(each for each in kept if each[0] not in edges or each in found.commands)


def test_recovery_says_where_it_stopped_and_what_it_left(tmp_path):
    bag = sessions.record(tmp_path / "run", 100)
    data = mcap_of(bag).read_bytes()
    mcap_of(bag).write_bytes(data[: len(data) // 2])
    (damage,) = recover(bag).damage
    assert damage.offset + damage.size == len(data) // 2
    assert damage.size < 1000 and "ends inside a record" in damage.what


def test_zeros_behind_the_last_record_are_no_obstacle(tmp_path):
    """A machine that loses its power may leave the length of a file without its bytes."""
    recorder = sessions.new_recorder(tmp_path / "run")
    for step in range(40):
        recorder.write_state(sessions.state(step))
    recorder.flush()
    data = mcap_of(tmp_path / "run").read_bytes()
    recorder.close()
    (tmp_path / "zeros").mkdir()
    for zeros in (1, 8, 9, 4096):
        mcap_of(tmp_path / "zeros").write_bytes(data + bytes(zeros))
        assert recover(tmp_path / "zeros", tmp_path / f"out{zeros}").steps == 39


@pytest.mark.parametrize("lost", ["metadata.yaml", None])
def test_a_whole_file_is_recovered_whole(tmp_path, lost):
    """With the commands of the last step too: nothing says that they came after the end."""
    bag = sessions.record(tmp_path / "run", 30, "position", namespace="cell1")
    original = {file.name: file.read_bytes() for file in bag.iterdir()}
    if lost:
        (bag / lost).unlink()
    result = recover(bag, tmp_path / "back" if lost else None)
    assert result.was_complete
    assert mcap_of(result.path).read_bytes() == original["run_0.mcap"]
    assert (result.path / "metadata.yaml").exists()


def test_where_the_recovered_bag_goes(tmp_path, monkeypatch):
    bag = sessions.record(tmp_path / "run", 3)
    assert recover(bag).path == tmp_path / "run_recovered"
    with pytest.raises(BagError, match="run_recovered: exists already"):
        recover(mcap_of(bag))
    loose = tmp_path / "loose.mcap"
    loose.write_bytes(mcap_of(bag).read_bytes())
    assert recover(loose).path == tmp_path / "loose_recovered"
    with pytest.raises(BagError, match="cannot be made"):
        recover(bag, tmp_path / "missing" / "out")
    monkeypatch.chdir(bag)
    with pytest.raises(BagError, match="run_recovered: exists already"):
        recover(".")


def test_nothing_to_recover_is_said_so(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mcap").write_text("no bag")
    with pytest.raises(BagError, match="absent: does not exist"):
        recover(tmp_path / "absent")
    with pytest.raises(BagError, match="empty: is not a bag"):
        recover(tmp_path / "empty")
    with pytest.raises(BagError, match="text.mcap: is not an MCAP file"):
        recover(tmp_path / "text.mcap")
    sessions.new_recorder(tmp_path / "new").close()
    with pytest.raises(BagError, match="joint_states: no whole period was written"):
        recover(tmp_path / "new")
    assert not (tmp_path / "new_recovered").exists()
