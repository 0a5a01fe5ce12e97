# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Recording of a session as a rosbag2 directory, NAME/NAME_0.mcap, NAME/NAME_1.mcap, ... and NAME/metadata.yaml."""

from __future__ import annotations

import re
import shutil
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from math import inf
from pathlib import Path
from typing import Any

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import messages, metadata
from puma_sim_core.recording.bag.file_writer import FileWriter
from puma_sim_core.recording.bag.frames import FrameMessages
from puma_sim_core.recording.bag.messages import FixedMessage
from puma_sim_core.recording.topics import (
    ARRAY_COMMANDS,
    BOOL,
    BRAKES,
    CHANGES,
    EFFECTS,
    FIXED_FRAMES,
    FRAMES,
    JOINT_COMMANDS,
    MODEL,
    PLACEMENTS,
    STATE_FIELDS,
    URDF,
    Topic,
)

# Half of the second that a killed recorder may lose at most.
_FLUSH_NS = 500_000_000
#: Simulated time in one MCAP file [ns]. The index of a file grows with each chunk and is in memory until the file is
#: finished: an hour bounds it however long the session is, and nearly all sessions are shorter and need one file only.
FILE_NS = 3600 * 1_000_000_000
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*")


class BagRecorder:
    """Writes one session, from its step 0, into a new rosbag2 directory.

    All times are simulated time, so equal sessions give equal bytes. Every half second of
    simulated time what was written is handed to the operating system as a closed chunk:
    `recover` then reads it whatever happens to this process. A long session is split, as rosbag2 does it, into several
    MCAP files; each is finished with an index of its own when the next begins.

    Parameters
    ----------
    path : the directory to make; its parent must exist, itself must not.
    namespace : ROS namespace of the topics, such as "/cell1".
    config_text : YAML text of the model and the session, from which a replay rebuilds both. Where topics have other
        names than those of `messages` in the namespace, its key ``topics`` tells them, full, by the names there.
    urdf : text for the topic ``robot_description``, which is left out without it.
    frames : write the frames of the arm of `urdf` too, on ``/tf`` and ``/tf_static``.
    joint_names, frame_id : of the joint states, in the order of the arrays of a state.
    command_interface : "voltage" or "position".
    period_ns : simulated time of one step [ns].
    splits_ns : rising times [ns]; the first state at or after each begins a new MCAP file. By default each whole hour.

    Raises
    ------
    BagError : the path exists or cannot be written, or an argument is not usable; nothing is left
        on the disk then. Later, if the disk refuses the data: what was flushed can be recovered.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        namespace: str = "",
        config_text: str,
        urdf: str | None = None,
        frames: bool = False,
        joint_names: Sequence[str],
        frame_id: str,
        command_interface: str,
        period_ns: int,
        splits_ns: Iterable[int] | None = None,
    ):
        self.path = Path(path)
        namespace = "/" + namespace.strip("/") if namespace.strip("/") else ""
        if not _NAMESPACE.fullmatch(namespace):
            raise BagError(f"{namespace!r} is no ROS namespace", where=path, expected="such as '/cell1'")
        if command_interface not in ARRAY_COMMANDS:
            what, expected = f"the command interface is {command_interface!r}", " or ".join(ARRAY_COMMANDS)
            raise BagError(what, where=path, expected=expected)
        if period_ns <= 0:
            raise BagError(f"the period is {period_ns} ns", where=path, expected="a positive one")
        self._prefix, self._interface, self._period_ns = namespace + "/", command_interface, period_ns
        self._names = messages.names_in(config_text)
        for name in self._names.values():
            if name == "" or not _NAMESPACE.fullmatch(name):
                raise BagError(
                    f"{name!r} is no full name of a topic", where=path, expected="such as '/cell1/joint_states'"
                )
        self._step, self._time_ns, self._flush_at_ns = -1, 0, 0
        self._splits = iter(count(FILE_NS, FILE_NS) if splits_ns is None else splits_ns)
        self._file: FileWriter | None = None
        self._finished: list[metadata.FileInformation] = []
        self._broken = self._reported = self.complete = False
        self._state_forms = messages.state_forms(joint_names, frame_id)
        self._array = FixedMessage([len(joint_names)])
        self._joint_commands: dict[tuple[str, ...], FixedMessage] = {}
        texts = {MODEL: config_text} if urdf is None else {MODEL: config_text, URDF: urdf}
        by_name = [JOINT_COMMANDS] if command_interface == "position" else []
        inputs = [ARRAY_COMMANDS[command_interface], *by_name, *CHANGES]
        if frames and urdf is None:
            raise BagError("frames without a URDF", where=path, expected="the URDF that they are those of")
        self._frames = FrameMessages(urdf, joint_names) if frames and urdf is not None else None
        framed = [FRAMES, FIXED_FRAMES] if frames else []
        self._topics = {topic: self._name(topic) for topic in (*texts, *STATE_FIELDS, *inputs, *framed)}
        self._counts = dict.fromkeys(self._topics, 0)
        try:
            self.path.mkdir()
        except FileExistsError as error:
            raise BagError("exists already", where=self.path, expected="the path of a new bag") from error
        except OSError as error:
            if self.path.parent.is_dir():
                raise self._disk_error(error) from error
            raise BagError("cannot be made", where=self.path, expected=f"{self.path.parent} as a directory") from error
        try:
            self._open(0)
            for topic, text in texts.items():
                self._add(topic, messages.encode_data(text), 0)
            if self._frames is not None:
                self._add(FIXED_FRAMES, self._frames.fixed, 0)
            self.flush()
            # The first state follows at once, so that there is one to recover.
            self._flush_at_ns = 0
        except BaseException as error:
            self._abandon()
            shutil.rmtree(self.path, ignore_errors=True)
            if isinstance(error, OSError):
                raise self._disk_error(error) from error
            raise

    def _open(self, time_ns: int) -> None:
        name = f"{self.path.name}_{len(self._finished)}.mcap"
        self._file = FileWriter(self.path / name, self._topics, time_ns)
        self._split_at_ns = next((at for at in self._splits if at > time_ns), inf)

    def _name(self, topic: Topic) -> str:
        absolute = topic.name.startswith("/")
        return self._names.get(topic.name, topic.name if absolute else self._prefix + topic.name)

    def write_state(self, state: Any) -> None:
        """Write a state (such as `SessionState`): the next step, at the time step x period.

        Raises `BagError` if the step, the time or a length is another, or on a full disk.
        """
        self._usable()
        step, time_ns = state.step, state.time_ns
        if step != self._step + 1 or time_ns != step * self._period_ns:
            expected = f"step {self._step + 1} at {(self._step + 1) * self._period_ns} ns"
            raise BagError(f"the state is of step {step} at {time_ns} ns", where=self.path, expected=expected)
        try:
            encoded = [
                (topic, form.encode(time_ns, *(getattr(state, name) for name in STATE_FIELDS[topic])))
                for topic, form in self._state_forms.items()
            ]
            if self._frames is not None:
                encoded.append((FRAMES, self._frames.encode(time_ns, state.position)))
        except struct.error as error:
            what = f"the state of step {step} cannot be written ({error})"
            raise BagError(what, where=self.path, expected="one number per joint in each field") from error
        if time_ns >= self._split_at_ns:
            self._split(time_ns)
        for topic, data in encoded:
            self._add(topic, data, time_ns)
        self._step, self._time_ns = step, time_ns
        if time_ns >= self._flush_at_ns:
            self.flush()

    def write_command(self, time_ns: int, command: Any) -> None:
        """Write a command that the step at ``time_ns`` [ns] consumes, after that step's state.

        ``command`` has ``values`` (V or rad) and ``names`` of the joints, None for all of them
        in their order. Raises `BagError` if the time is not that of the last state, if joints
        are named in the voltage interface, or if the values are not one number per joint.
        """
        self._check_input(time_ns)
        topic, form, arrays = ARRAY_COMMANDS[self._interface], self._array, [command.values]
        if command.names is not None:
            if self._interface == "voltage":
                raise BagError("a command by joint names", where=self.path, expected="voltages of all joints")
            names = tuple(command.names)
            if names not in self._joint_commands:
                self._joint_commands[names] = FixedMessage([len(names), 0, 0], names)
            topic, form, arrays = JOINT_COMMANDS, self._joint_commands[names], [command.values, (), ()]
        try:
            data = form.encode(time_ns, *arrays)
        except struct.error as error:
            what, where = f"the command {command.values!r} cannot be written ({error})", self._name(topic)
            raise BagError(what, where=f"{self.path}, topic {where}", expected="one number per joint") from error
        self._add(topic, data, time_ns)

    def write_placement(self, time_ns: int, placement: Any) -> None:
        """Write where joints were put before the step at ``time_ns`` [ns]: ``names``, and ``position`` [rad] and
        ``velocity`` [rad/s] of each. Raises `BagError` as `write_command`."""
        self._check_input(time_ns)
        names = tuple(placement.names)
        try:
            form = FixedMessage([len(names), len(names), 0], names)
            data = form.encode(time_ns, placement.position, placement.velocity, ())
        except struct.error as error:
            what = f"the placement {placement!r} cannot be written ({error})"
            raise BagError(what, where=self.path, expected="two numbers a joint") from error
        self._add(PLACEMENTS, data, time_ns)

    def write_brakes(self, time_ns: int, engaged: bool) -> None:
        """Write that the brakes hold, or no longer do, from the state at ``time_ns`` [ns] on."""
        self._check_input(time_ns)
        self._add(BRAKES, messages.encode_data(bool(engaged), BOOL), time_ns)

    def write_effects(self, time_ns: int, text: str) -> None:
        """Write the effects, as YAML of a model file's entry, that act from the state at ``time_ns`` [ns] on."""
        self._check_input(time_ns)
        self._add(EFFECTS, messages.encode_data(text), time_ns)

    @property
    def steps(self) -> int:
        """The step that is written next."""
        return self._step + 1

    def skip_to(self, step: int) -> None:
        """Leave out the steps before this one: they are lost. Raises `BagError` for one that was written."""
        if step <= self._step:
            raise BagError(f"step {step} is not ahead", where=self.path, expected=f"more than {self._step}")
        self._step = step - 1

    def _check_input(self, time_ns: int) -> None:
        self._usable()
        if self._step < 0 or time_ns != self._time_ns:
            last = f", {self._time_ns} ns" if self._step >= 0 else "; no state was written yet"
            raise BagError(f"an input at {time_ns} ns", where=self.path, expected=f"the time of the last state{last}")

    def flush(self) -> None:
        """Hand everything written so far to the operating system, as a closed chunk."""
        with self._writing() as file:
            file.flush()
        self._flush_at_ns = self._time_ns + _FLUSH_NS

    def _split(self, time_ns: int) -> None:
        with self._writing() as file:
            self._finished.append(file.finish())
            self._open(time_ns)
        # as in the first file, the first state is handed on at once
        self._flush_at_ns = time_ns

    def _add(self, topic: Topic, data: bytes, time_ns: int) -> None:
        with self._writing() as file:
            file.add(topic, data, time_ns, self._counts[topic])
            self._counts[topic] += 1

    @contextmanager
    def _writing(self) -> Iterator[FileWriter]:
        file = self._usable()
        # Whatever interrupts the writer (a full disk, Ctrl-C) may leave half a record in the
        # open chunk; such a bag must not be closed as if it were whole.
        self._broken = True
        try:
            yield file
        except OSError as error:
            raise self._disk_error(error) from error
        self._broken = False

    def _usable(self) -> FileWriter:
        if self._broken or self._file is None:
            state = "an earlier write failed" if self._broken else "it is closed"
            raise BagError(f"nothing more can be written, {state}", where=self.path)
        return self._file

    def close(self) -> None:
        """Write the index and ``metadata.yaml``. A second call does nothing.

        Raises `BagError` if that fails, or if an earlier write was interrupted and nobody was
        told: what was flushed can be recovered.
        """
        if self._file is None:
            return
        if self._broken:
            self._abandon()
            if not self._reported:
                raise BagError(f"a write was interrupted; {self._hint()}", where=self.path)
            return
        try:
            with self._writing() as file:
                self._finished.append(file.finish())
                metadata.write(self.path, metadata.information(self._topics, self._finished, listed=True))
        except BagError:
            self._abandon()
            raise
        self._file, self.complete = None, True

    def _abandon(self) -> None:
        if self._file is not None:
            self._file.abandon()
            self._file = None

    def _disk_error(self, error: OSError) -> BagError:
        self._reported = True
        what = f"cannot be written ({error.strerror})"
        return BagError(f"{what}; {self._hint()}" if self._step >= 0 else what, where=self.path)

    def _hint(self) -> str:
        return f"`puma-sim recover {self.path}` reads what was written before"

    def __enter__(self) -> BagRecorder:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
