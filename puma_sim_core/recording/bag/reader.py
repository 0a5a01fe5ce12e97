# SPDX-License-Identifier: Apache-2.0
# Copyright the puma-sim contributors
"""Reading of bags that `BagRecorder` wrote."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import messages, metadata
from puma_sim_core.recording.bag.messages import FixedMessage, MismatchError, Topic
from puma_sim_core.recording.bag.scan import RawMessage, Scan


class RecordedCommand(NamedTuple):
    """A command as the session accepted it: values in V or rad, of these joints (None: all)."""

    names: tuple[str, ...] | None
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class BagContents:
    """A recorded session; n states from step 0 on, one per period.

    ``commands`` holds (step, command) in their order: a command belongs to the step that
    consumed it, which leads from state ``step`` to state ``step + 1``.
    ``period_ns`` is None if there is but one state.
    """

    path: Path
    complete: bool  # the file ends with its index; False for what a killed recorder left
    namespace: str
    config_text: str
    urdf: str | None
    command_interface: str
    joint_names: tuple[str, ...]
    frame_id: str
    period_ns: int | None
    steps: np.ndarray  # (n,)
    time_ns: np.ndarray  # (n,) [ns]
    position: np.ndarray  # (n, joints) [rad]
    velocity: np.ndarray  # (n, joints) [rad/s]
    effort: np.ndarray  # (n, joints) [N.m]
    current: np.ndarray  # (n, joints) [A]
    voltage: np.ndarray  # (n, joints) [V], applied during the last step
    commands: tuple[tuple[int, RecordedCommand], ...]


def iterate_messages(path: str | Path) -> Iterator[RawMessage]:
    """Messages of a closed bag in the order of their log times, whatever program wrote it.

    Raises `BagError` as `read_bag` does.
    """
    return _open(Path(path), partial=False).messages()


def read_bag(path: str | Path, *, partial: bool = False) -> BagContents:
    """Read a bag: its directory, or its MCAP file alone.

    Parameters
    ----------
    partial : read what a killed recorder left, up to its last whole period; ``metadata.yaml``
        may be missing then, and commands that no written state shows are left out. Without it
        such a bag is refused.

    Raises
    ------
    BagError : no bag, or one of another program; cut off, without ``metadata.yaml``, without a
        topic, or with numbers of messages that do not agree. The text names the path, the offset
        or the topic, and what was expected.
    """
    return _Session(_open(Path(path), partial), partial).contents()


def mcap_file(path: Path, partial: bool = False) -> tuple[Path, dict[str, int] | None]:
    """The MCAP file of a bag, and the number of messages by topic if ``metadata.yaml`` is there."""
    if not path.is_dir():
        if not path.exists():
            raise BagError("does not exist", where=path, expected="a bag")
        return path, None
    if partial or not (path / metadata.NAME).exists():
        files = sorted(path.glob("*.mcap"))
        if not files:
            raise BagError("is not a bag", where=path, expected=f"{metadata.NAME} and an MCAP file in it")
        if not partial:
            raise BagError(f"{metadata.NAME} is missing; {_hint(path)}", where=path, expected="a closed bag")
        if len(files) > 1:
            raise BagError(f"holds {len(files)} MCAP files", where=path, expected="one")
        return files[0], None
    stored = metadata.read(path)
    if not stored.file.is_file():
        raise BagError("does not exist", where=stored.file, expected="the file of the bag")
    return stored.file, stored.counts


def _hint(path: Path) -> str:
    return f"`puma-sim recover {path}` reads what is there"


def _open(path: Path, partial: bool) -> Scan:
    file, counts = mcap_file(path, partial)
    scan = Scan(file, counts)
    if not (scan.complete or partial):
        raise BagError(
            f"the file ends at offset {scan.size} without an index; {_hint(path)}", where=file, expected="a closed bag"
        )
    return scan


class _Series:
    """Messages of one topic, with their times [ns] and their ranks in the whole bag."""

    def __init__(self) -> None:
        self.data: list[bytes] = []
        self.times: list[int] = []
        self.ranks: list[int] = []


class _Session:
    """The messages of one bag, turned into `BagContents`."""

    def __init__(self, scan: Scan, partial: bool):
        self.scan, self.partial = scan, partial
        self.series: dict[str, _Series] = defaultdict(_Series)
        for rank, message in enumerate(scan.messages(partial)):
            series = self.series[message.topic]
            series.data.append(message.data)
            series.times.append(message.time_ns)
            series.ranks.append(rank)
        self.complete = scan.complete and scan.fault is None
        models = [name for name in scan.topics if name.endswith("/" + messages.MODEL.name)]
        if not models and scan.fault:
            raise BagError(
                f"{scan.fault.what}, and there is no model before", where=scan.fault.where, expected=scan.fault.expected
            )
        if len(models) != 1:
            raise BagError(
                f"{len(models)} topics are named {messages.MODEL.name}",
                where=scan.path,
                expected="one, which each bag of this simulator has",
            )
        self.namespace = models[0][: -len("/" + messages.MODEL.name)]

    def contents(self) -> BagContents:
        config_text = self._text(messages.MODEL)
        urdf = self._text(messages.URDF) if self._name(messages.URDF) in self.scan.topics else None
        interface = self._command_interface()
        names, frame_id = self._joints()
        form = FixedMessage([len(names)] * 3, names, frame_id)
        time_ns, (position, velocity, effort) = self._fixed(messages.STATES, form)
        array = FixedMessage([len(names)])
        currents_ns, (current,) = self._fixed(messages.CURRENTS, array)
        voltages_ns, (voltage,) = self._fixed(messages.VOLTAGES, array)
        count = min(len(time_ns), len(currents_ns), len(voltages_ns))
        for topic, other in ((messages.CURRENTS, currents_ns), (messages.VOLTAGES, voltages_ns)):
            if not self.partial and len(other) != len(time_ns):
                raise self._error(topic, f"{len(other)} messages", f"{len(time_ns)}, as of states")
            if not np.array_equal(other[:count], time_ns[:count]):
                raise self._error(topic, "times differ from those of the states", "the same")
        if count == 0:
            raise self._error(messages.STATES, "no whole period was written", "one or more")
        time_ns = time_ns[:count]
        steps, period_ns = self._steps(time_ns)
        return BagContents(
            path=self.scan.path,
            complete=self.complete,
            namespace=self.namespace,
            config_text=config_text,
            urdf=urdf,
            command_interface=interface,
            joint_names=names,
            frame_id=frame_id,
            period_ns=period_ns,
            steps=steps,
            time_ns=time_ns,
            position=position[:count],
            velocity=velocity[:count],
            effort=effort[:count],
            current=current[:count],
            voltage=voltage[:count],
            commands=self._commands(interface, names, period_ns, int(time_ns[-1])),
        )

    def _name(self, topic: Topic) -> str:
        return f"{self.namespace}/{topic.name}"

    def _error(self, topic: Topic, what: str, expected: str) -> BagError:
        return BagError(what, where=f"{self.scan.path}, topic {self._name(topic)}", expected=expected)

    def _messages(self, topic: Topic) -> list[bytes]:
        name = self._name(topic)
        found = self.scan.topics.get(name)
        if found is None:
            raise self._error(topic, "is missing", "in each bag of this simulator")
        if found != topic.type:
            raise self._error(topic, f"its type is {found!r}", repr(topic.type))
        return self.series[name].data

    def _text(self, topic: Topic) -> str:
        found = self._messages(topic)
        if len(found) != 1:
            raise self._error(topic, f"{len(found)} messages", "one")
        return self._decode(topic, found[0]).data

    def _decode(self, topic: Topic, data: bytes):
        try:
            return messages.decode(data, topic.type)
        except ValueError as error:
            raise self._error(topic, f"a message does not decode ({error})", topic.type) from error

    def _command_interface(self) -> str:
        present = [
            interface
            for interface in messages.COMMAND_INTERFACES
            if self._name(messages.array_command_topic(interface)) in self.scan.topics
        ]
        if len(present) != 1:
            raise BagError(
                f"{len(present)} command topics",
                where=self.scan.path,
                expected=" or ".join(
                    self._name(messages.array_command_topic(interface)) for interface in messages.COMMAND_INTERFACES
                ),
            )
        return present[0]

    def _joints(self) -> tuple[tuple[str, ...], str]:
        found = self._messages(messages.STATES)
        if not found:
            raise self._error(messages.STATES, "no whole period was written", "one or more")
        first = self._decode(messages.STATES, found[0])
        return tuple(first.name), first.header.frame_id

    def _steps(self, time_ns: np.ndarray) -> tuple[np.ndarray, int | None]:
        period_ns = int(time_ns[1]) if len(time_ns) > 1 else None
        if time_ns[0] != 0 or period_ns == 0:
            raise self._error(messages.STATES, f"states are at {time_ns[:2].tolist()} ns", "0 and one period")
        steps = np.arange(len(time_ns))
        wrong = np.flatnonzero(time_ns != steps * (period_ns or 0))
        if wrong.size:
            raise self._error(
                messages.STATES,
                f"state {wrong[0]} is at {time_ns[wrong[0]]} ns",
                f"{wrong[0]} periods of {period_ns} ns",
            )
        return steps, period_ns

    def _fixed(self, topic: Topic, form: FixedMessage) -> tuple[np.ndarray, list[np.ndarray]]:
        found = self._messages(topic)
        time_ns = np.array(self.series[self._name(topic)].times, dtype=np.int64)
        try:
            stamps, arrays = form.decode(found)
        except MismatchError as error:
            raise self._error(topic, f"message {error.index} has {error.found}", error.expected) from error
        if stamps is not None and not np.array_equal(stamps, time_ns):
            index = int(np.flatnonzero(stamps != time_ns)[0])
            raise self._error(
                topic, f"message {index} is stamped {stamps[index]} ns", f"its log time, {time_ns[index]} ns"
            )
        return time_ns, arrays

    def _commands(
        self, interface: str, names: tuple[str, ...], period_ns: int | None, end_ns: int
    ) -> tuple[tuple[int, RecordedCommand], ...]:
        """Commands of all topics, in the order in which they were written."""
        ranked: list[tuple[int, int, RecordedCommand]] = []

        def add(topic: Topic, values: Sequence, joints: Sequence) -> None:
            series = self.series[self._name(topic)]
            for rank, time_ns, row, names in zip(series.ranks, series.times, values, joints):
                if not self.complete and time_ns >= end_ns:
                    return
                step, rest = divmod(time_ns, period_ns or 1)
                if rest or not 0 <= time_ns <= end_ns:
                    raise self._error(topic, f"a command at {time_ns} ns", "the time of a state")
                ranked.append((rank, step, RecordedCommand(names, tuple(row))))

        topic = messages.array_command_topic(interface)
        _, (values,) = self._fixed(topic, FixedMessage([len(names)]))
        add(topic, values.tolist(), [None] * len(values))
        if self._name(messages.JOINT_COMMANDS) in self.scan.topics:
            found = self._messages(messages.JOINT_COMMANDS)
            decoded = [self._decode(messages.JOINT_COMMANDS, data) for data in found]
            add(
                messages.JOINT_COMMANDS,
                [message.position.tolist() for message in decoded],
                [tuple(message.name) for message in decoded],
            )
        return tuple((step, command) for _, step, command in sorted(ranked))
