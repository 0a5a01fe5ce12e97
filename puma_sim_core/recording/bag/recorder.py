# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Recording of a session as a rosbag2 directory, NAME/NAME_0.mcap and NAME/metadata.yaml."""

from __future__ import annotations

import re
import shutil
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from mcap.writer import CompressionType, Writer

from puma_sim_core import __version__
from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import messages, metadata
from puma_sim_core.recording.bag.messages import ARRAY_COMMANDS, JOINT_COMMANDS, STATE_FIELDS, FixedMessage, Topic

# Half of the second that a killed recorder may lose at most.
_FLUSH_NS = 500_000_000
# A chunk is closed at each flush; this only bounds one that many commands at one step fill.
_CHUNK_BYTES = 65536
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*")


class BagRecorder:
    """Writes one session, from its step 0, into a new rosbag2 directory.

    All times are simulated time, so equal sessions give equal bytes. Every half second of
    simulated time what was written is handed to the operating system as a closed chunk:
    `recover` then reads it whatever happens to this process.

    Parameters
    ----------
    path : the directory to make; its parent must exist, itself must not.
    namespace : ROS namespace of the topics, such as "/cell1".
    config_text : YAML text of the model and the session, from which a replay rebuilds both.
    urdf : text for the topic ``robot_description``, which is left out without it.
    joint_names, frame_id : of the joint states, in the order of the arrays of a state.
    command_interface : "voltage" or "position".
    period_ns : simulated time of one step [ns].

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
        joint_names: Sequence[str],
        frame_id: str,
        command_interface: str,
        period_ns: int,
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
        self._step, self._time_ns, self._flush_at_ns = -1, 0, 0
        self._file: IO[bytes] | None = None
        self._broken = self._reported = self.complete = False
        self._state_forms = messages.state_forms(joint_names, frame_id)
        self._array = FixedMessage([len(joint_names)])
        self._joint_commands: dict[tuple[str, ...], FixedMessage] = {}
        texts = {messages.MODEL: config_text} if urdf is None else {messages.MODEL: config_text, messages.URDF: urdf}
        by_name = [JOINT_COMMANDS] if command_interface == "position" else []
        self._counts = dict.fromkeys([*texts, *STATE_FIELDS, ARRAY_COMMANDS[command_interface], *by_name], 0)
        try:
            self.path.mkdir()
        except FileExistsError as error:
            raise BagError("exists already", where=self.path, expected="the path of a new bag") from error
        except OSError as error:
            if self.path.parent.is_dir():
                raise self._disk_error(error) from error
            raise BagError("cannot be made", where=self.path, expected=f"{self.path.parent} as a directory") from error
        try:
            self._open()
            for topic, text in texts.items():
                self._add(topic, messages.encode_text(text), 0)
            self.flush()
            # The first state follows at once, so that there is one to recover.
            self._flush_at_ns = 0
        except BaseException as error:
            self._abandon()
            shutil.rmtree(self.path, ignore_errors=True)
            if isinstance(error, OSError):
                raise self._disk_error(error) from error
            raise

    def _open(self) -> None:
        # Larger than a chunk with its index, so that each flush is one write to the file.
        self._file = open(self.path / f"{self.path.name}_0.mcap", "xb", buffering=4 * _CHUNK_BYTES)
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.NONE)
        self._writer.start(profile="ros2", library=f"puma-sim-core {__version__}")
        schemas: dict[str, int] = {}
        self._channels: dict[Topic, int] = {}
        for topic in self._counts:
            kind = topic.type
            if kind not in schemas:
                schemas[kind] = self._writer.register_schema(kind, "ros2msg", messages.definition(kind).encode())
            profile = {"offered_qos_profiles": messages.qos_text(topic), "topic_type_hash": messages.type_hash(kind)}
            name = self._prefix + topic.name
            self._channels[topic] = self._writer.register_channel(name, "cdr", schemas[kind], profile)

    def write_state(self, state: Any) -> None:
        """Write a state (such as `SessionState`): the next step, at the time step x period.

        Raises `BagError` if the step, the time or a length is another, or on a full disk.
        """
        self._check_usable()
        step, time_ns = state.step, state.time_ns
        if step != self._step + 1 or time_ns != step * self._period_ns:
            expected = f"step {self._step + 1} at {(self._step + 1) * self._period_ns} ns"
            raise BagError(f"the state is of step {step} at {time_ns} ns", where=self.path, expected=expected)
        try:
            encoded = [
                (topic, form.encode(time_ns, *(getattr(state, name) for name in STATE_FIELDS[topic])))
                for topic, form in self._state_forms.items()
            ]
        except struct.error as error:
            what = f"the state of step {step} cannot be written ({error})"
            raise BagError(what, where=self.path, expected="one number per joint in each field") from error
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
        self._check_usable()
        if self._step < 0 or time_ns != self._time_ns:
            last = f", {self._time_ns} ns" if self._step >= 0 else "; no state was written yet"
            raise BagError(f"a command at {time_ns} ns", where=self.path, expected=f"the time of the last state{last}")
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
            what, where = f"the command {command.values!r} cannot be written ({error})", self._prefix + topic.name
            raise BagError(what, where=f"{self.path}, topic {where}", expected="one number per joint") from error
        self._add(topic, data, time_ns)

    def flush(self) -> None:
        """Hand everything written so far to the operating system, as a closed chunk."""
        self._check_usable()
        with self._writing():
            self._writer.flush()  # type: ignore[no-untyped-call]
        self._flush_at_ns = self._time_ns + _FLUSH_NS

    def _add(self, topic: Topic, data: bytes, time_ns: int) -> None:
        count = self._counts[topic]
        with self._writing():
            self._writer.add_message(self._channels[topic], time_ns, data, time_ns, count)
            self._counts[topic] = count + 1

    @contextmanager
    def _writing(self) -> Iterator[None]:
        # Whatever interrupts the writer (a full disk, Ctrl-C) may leave half a record in the
        # open chunk; such a bag must not be closed as if it were whole.
        self._broken = True
        try:
            yield
        except OSError as error:
            raise self._disk_error(error) from error
        self._broken = False

    def _check_usable(self) -> None:
        if self._broken or self._file is None:
            state = "an earlier write failed" if self._broken else "it is closed"
            raise BagError(f"nothing more can be written, {state}", where=self.path)

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
        counts = [(topic, self._prefix + topic.name, count) for topic, count in self._counts.items()]
        try:
            with self._writing():
                inner = metadata.dump(metadata.information(counts, self._time_ns)).strip()
                self._writer.add_metadata("rosbag2", {"serialized_metadata": inner})
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.close()
                name = f"{self.path.name}_0.mcap"
                metadata.write(self.path, metadata.information(counts, self._time_ns, name))
        except BagError:
            self._abandon()
            raise
        self._file, self.complete = None, True

    def _abandon(self) -> None:
        # The raw file is closed so that the buffer above it is dropped, not written again.
        if self._file is not None:
            self._file.raw.close()  # type: ignore[attr-defined]
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
