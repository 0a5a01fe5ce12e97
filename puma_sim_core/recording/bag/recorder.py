# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Recording of a session as a rosbag2 directory, NAME/NAME_0.mcap and NAME/metadata.yaml."""

from __future__ import annotations

import re
import shutil
import struct
from collections.abc import Sequence
from pathlib import Path

from mcap.writer import CompressionType, Writer

from puma_sim_core import __version__
from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import messages, metadata
from puma_sim_core.recording.bag.messages import FixedMessage, Topic

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
    joint_names : names of the joints, in the order of the arrays of a state.
    frame_id : frame of the joint states.
    command_interface : "voltage" or "position".
    period_ns : simulated time of one step [ns].

    Raises
    ------
    BagError : the path exists or cannot be written, or an argument is not usable. Nothing is
        left on the disk then. Later, if the disk refuses the data: the bag stays as far as it
        was flushed and can be recovered.
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
        if command_interface not in messages.COMMAND_INTERFACES:
            raise BagError(
                f"the command interface is {command_interface!r}",
                where=path,
                expected=" or ".join(messages.COMMAND_INTERFACES),
            )
        if period_ns <= 0:
            raise BagError(f"the period is {period_ns} ns", where=path, expected="a positive one")
        self._prefix = namespace + "/"
        self._interface = command_interface
        self._period_ns = period_ns
        self._step = -1
        self._time_ns = 0
        self._flush_at_ns = 0
        self._file = None
        self._broken = False
        self._reported = False
        self.complete = False
        count = len(joint_names)
        self._state = FixedMessage([count] * 3, joint_names, frame_id)
        self._array = FixedMessage([count])
        self._joint_commands: dict[tuple[str, ...], FixedMessage] = {}
        topics = [messages.MODEL, messages.STATES, messages.CURRENTS, messages.VOLTAGES]
        topics.append(messages.array_command_topic(command_interface))
        if command_interface == "position":
            topics.append(messages.JOINT_COMMANDS)
        if urdf is not None:
            topics.insert(1, messages.URDF)
        self._counts = dict.fromkeys(topics, 0)
        self._make_directory()
        try:
            self._open(topics)
            self._add(messages.MODEL, messages.encode_text(config_text), 0)
            if urdf is not None:
                self._add(messages.URDF, messages.encode_text(urdf), 0)
            self.flush()
            # The first state follows at once, so that there is one to recover.
            self._flush_at_ns = 0
        except BaseException as error:
            self._abandon()
            shutil.rmtree(self.path, ignore_errors=True)
            if isinstance(error, OSError):
                raise self._disk_error(error) from error
            raise

    def _make_directory(self) -> None:
        try:
            self.path.mkdir()
        except FileExistsError as error:
            raise BagError("exists already", where=self.path, expected="the path of a new bag") from error
        except OSError as error:
            if self.path.parent.is_dir():
                raise self._disk_error(error) from error
            raise BagError("cannot be made", where=self.path, expected=f"{self.path.parent} as a directory") from error

    def _open(self, topics: list[Topic]) -> None:
        # Larger than a chunk with its index, so that each flush is one write to the file.
        self._file = open(self.path / f"{self.path.name}_0.mcap", "xb", buffering=4 * _CHUNK_BYTES)
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.NONE)
        self._writer.start(profile="ros2", library=f"puma-sim-core {__version__}")
        schemas: dict[str, int] = {}
        self._channels: dict[Topic, int] = {}
        for topic in topics:
            if topic.type not in schemas:
                schemas[topic.type] = self._writer.register_schema(
                    topic.type, "ros2msg", messages.definition(topic.type).encode()
                )
            self._channels[topic] = self._writer.register_channel(
                self._prefix + topic.name,
                "cdr",
                schemas[topic.type],
                {"offered_qos_profiles": messages.qos_text(topic), "topic_type_hash": messages.type_hash(topic.type)},
            )

    def write_state(self, state) -> None:
        """Write a state: the next step after the last one, at the time step x period.

        ``state`` has ``step``, ``time_ns`` [ns], and one number per joint in ``position`` [rad],
        ``velocity`` [rad/s], ``effort`` [N.m], ``current`` [A], ``voltage`` [V].
        Raises `BagError` if the step, the time or a length is another, or on a full disk.
        """
        self._check_usable()
        step, time_ns = state.step, state.time_ns
        if step != self._step + 1 or time_ns != step * self._period_ns:
            raise BagError(
                f"the state is of step {step} at {time_ns} ns",
                where=self.path,
                expected=f"step {self._step + 1} at {(self._step + 1) * self._period_ns} ns",
            )
        try:
            joints = self._state.encode(time_ns, state.position, state.velocity, state.effort)
            currents = self._array.encode(time_ns, state.current)
            voltages = self._array.encode(time_ns, state.voltage)
        except struct.error as error:
            raise BagError(
                f"the state of step {step} cannot be written ({error})",
                where=self.path,
                expected="one number per joint in each field",
            ) from error
        self._add(messages.STATES, joints, time_ns)
        self._add(messages.CURRENTS, currents, time_ns)
        self._add(messages.VOLTAGES, voltages, time_ns)
        self._step, self._time_ns = step, time_ns
        if time_ns >= self._flush_at_ns:
            self.flush()

    def write_command(self, time_ns: int, command) -> None:
        """Write a command that the step at ``time_ns`` [ns] consumes, after that step's state.

        ``command`` has ``values`` (V or rad) and ``names`` of the joints, None for all of them
        in their order. Raises `BagError` if the time is not that of the last state, if joints
        are named in the voltage interface, or if the values are not one number per joint.
        """
        self._check_usable()
        if self._step < 0 or time_ns != self._time_ns:
            raise BagError(
                f"a command at {time_ns} ns",
                where=self.path,
                expected="the time of the last state"
                + (f", {self._time_ns} ns" if self._step >= 0 else "; no state was written yet"),
            )
        if command.names is None:
            topic, form = messages.array_command_topic(self._interface), self._array
            arrays = (command.values,)
        elif self._interface == "position":
            topic, form = messages.JOINT_COMMANDS, self._named_form(tuple(command.names))
            arrays = (command.values, (), ())
        else:
            raise BagError("a command by joint names", where=self.path, expected="voltages of all joints")
        try:
            data = form.encode(time_ns, *arrays)
        except struct.error as error:
            raise BagError(
                f"the command {command.values!r} cannot be written ({error})",
                where=f"{self.path}, topic {self._prefix}{topic.name}",
                expected="one number per joint",
            ) from error
        self._add(topic, data, time_ns)

    def _named_form(self, names: tuple[str, ...]) -> FixedMessage:
        form = self._joint_commands.get(names)
        if form is None:
            form = self._joint_commands[names] = FixedMessage([len(names), 0, 0], names)
        return form

    def flush(self) -> None:
        """Hand everything written so far to the operating system, as a closed chunk."""
        self._check_usable()
        self._broken = True
        try:
            self._writer.flush()
        except OSError as error:
            raise self._disk_error(error) from error
        self._broken = False
        self._flush_at_ns = self._time_ns + _FLUSH_NS

    def _add(self, topic: Topic, data: bytes, time_ns: int) -> None:
        # Whatever interrupts the writer (a full disk, Ctrl-C) may leave half a record in the
        # open chunk; such a bag must not be closed as if it were whole.
        self._broken = True
        count = self._counts[topic]
        try:
            self._writer.add_message(self._channels[topic], time_ns, data, time_ns, count)
        except OSError as error:
            raise self._disk_error(error) from error
        self._counts[topic] = count + 1
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
        counts = [metadata.TopicCount(topic, self._prefix + topic.name, count) for topic, count in self._counts.items()]
        self._broken = True
        try:
            inner = metadata.dump(metadata.information(counts, self._time_ns)).strip()
            self._writer.add_metadata("rosbag2", {"serialized_metadata": inner})
            self._writer.finish()
            self._file.close()
            name = f"{self.path.name}_0.mcap"
            metadata.write(self.path, metadata.information(counts, self._time_ns, name))
        except OSError as error:
            self._abandon()
            raise self._disk_error(error) from error
        self._file, self._broken, self.complete = None, False, True

    def _abandon(self) -> None:
        # The raw file is closed so that the buffer above it is dropped, not written again.
        if self._file is not None:
            self._file.raw.close()
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
