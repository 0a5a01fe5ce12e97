# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Reading of bags that `BagRecorder` wrote."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import messages, metadata
from puma_sim_core.recording.bag.messages import ARRAY_COMMANDS, JOINT_COMMANDS, MODEL, STATES, FixedMessage, Topic
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
    """Messages of a closed bag of any program, in the order of their log times; raises as `read_bag` does."""
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
        topic, or with numbers of messages that do not agree.
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
    file, counts = metadata.read(path)
    if not file.is_file():
        raise BagError("does not exist", where=file, expected="the file of the bag")
    return file, counts


def _hint(path: Path) -> str:
    return f"`puma-sim recover {path}` reads what is there"


def _open(path: Path, partial: bool) -> Scan:
    file, counts = mcap_file(path, partial)
    scan = Scan(file, counts)
    if not (scan.complete or partial):
        what = f"the file ends at offset {scan.size} without an index; {_hint(path)}"
        raise BagError(what, where=file, expected="a closed bag")
    return scan


class _Session:
    """The messages of one bag, turned into `BagContents`."""

    def __init__(self, scan: Scan, partial: bool):
        self.scan, self.partial = scan, partial
        #: topic -> its messages, each with its rank in the whole bag
        self.found: dict[str, list[tuple[int, RawMessage]]] = defaultdict(list)
        for rank, message in enumerate(scan.messages(partial)):
            self.found[message.topic].append((rank, message))
        self.complete = scan.complete and scan.fault is None
        models = [name for name in scan.topics if name.endswith("/" + MODEL.name)]
        if not models and (fault := scan.fault):
            raise BagError(f"{fault.what}, and there is no model before", where=fault.where, expected=fault.expected)
        if len(models) != 1:
            what, expected = f"{len(models)} topics are named {MODEL.name}", "one, which each bag of this simulator has"
            raise BagError(what, where=scan.path, expected=expected)
        self.namespace = models[0].removesuffix("/" + MODEL.name)

    def contents(self) -> BagContents:
        config_text = self._text(MODEL)
        urdf = self._text(messages.URDF) if self._is_there(messages.URDF) else None
        interface = self._command_interface()
        names, frame_id = self._joints()
        times: dict[Topic, np.ndarray] = {}
        fields: dict[str, np.ndarray] = {}
        for topic, form in messages.state_forms(names, frame_id).items():
            times[topic], arrays = self._fixed(topic, form)
            fields.update(zip(messages.STATE_FIELDS[topic], arrays))
        time_ns = times.pop(STATES)
        count = min(map(len, (time_ns, *times.values())))
        for topic, other in times.items():
            if not self.partial and len(other) != len(time_ns):
                raise self._error(topic, f"{len(other)} messages", f"{len(time_ns)}, as of states")
            if not np.array_equal(other[:count], time_ns[:count]):
                raise self._error(topic, "times differ from those of the states", "the same")
        if count == 0:
            raise self._error(STATES, "no whole period was written", "one or more")
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
            **{name: values[:count] for name, values in fields.items()},
            commands=self._commands(ARRAY_COMMANDS[interface], len(names), period_ns or 1, int(time_ns[-1])),
        )

    def _name(self, topic: Topic) -> str:
        return f"{self.namespace}/{topic.name}"

    def _is_there(self, topic: Topic) -> bool:
        return self._name(topic) in self.scan.topics

    def _error(self, topic: Topic, what: str, expected: str) -> BagError:
        return BagError(what, where=f"{self.scan.path}, topic {self._name(topic)}", expected=expected)

    def _messages(self, topic: Topic) -> list[bytes]:
        name = self._name(topic)
        if not self._is_there(topic):
            raise self._error(topic, "is missing", "in each bag of this simulator")
        if self.scan.topics[name] != topic.type:
            raise self._error(topic, f"its type is {self.scan.topics[name]!r}", repr(topic.type))
        return [message.data for _, message in self.found[name]]

    def _text(self, topic: Topic) -> str:
        found = self._messages(topic)
        if len(found) != 1:
            raise self._error(topic, f"{len(found)} messages", "one")
        return self._decode(topic, found[0]).data

    def _decode(self, topic: Topic, data: bytes) -> Any:
        try:
            return messages.decode(data, topic.type)
        except ValueError as error:
            raise self._error(topic, f"a message does not decode ({error})", topic.type) from error

    def _command_interface(self) -> str:
        present = [interface for interface, topic in ARRAY_COMMANDS.items() if self._is_there(topic)]
        if len(present) != 1:
            expected = " or ".join(map(self._name, ARRAY_COMMANDS.values()))
            raise BagError(f"{len(present)} command topics", where=self.scan.path, expected=expected)
        return present[0]

    def _joints(self) -> tuple[tuple[str, ...], str]:
        """Joint names and frame of the first state."""
        found = self._messages(STATES)
        if not found:
            raise self._error(STATES, "no whole period was written", "one or more")
        first = self._decode(STATES, found[0])
        return tuple(first.name), first.header.frame_id

    def _steps(self, time_ns: np.ndarray) -> tuple[np.ndarray, int | None]:
        """Steps of the states, and the period; their times are whole periods from 0 on."""
        period_ns = int(time_ns[1]) if len(time_ns) > 1 else None
        if time_ns[0] != 0 or period_ns == 0:
            raise self._error(STATES, f"states are at {time_ns[:2].tolist()} ns", "0 and one period")
        steps = np.arange(len(time_ns))
        wrong = np.flatnonzero(time_ns != steps * (period_ns or 0))
        if wrong.size:
            n = wrong[0]
            raise self._error(STATES, f"state {n} is at {time_ns[n]} ns", f"{n} periods of {period_ns} ns")
        return steps, period_ns

    def _fixed(self, topic: Topic, form: FixedMessage) -> tuple[np.ndarray, list[np.ndarray]]:
        """Times (n,) [ns] and arrays (n, count) of the messages of one form."""
        found = self._messages(topic)
        time_ns = np.array([message.time_ns for _, message in self.found[self._name(topic)]], dtype=np.int64)
        try:
            stamps, arrays = form.decode(found)
        except messages.MismatchError as error:
            index, problem, expected = error.args
            raise self._error(topic, f"message {index} has {problem}", expected) from error
        if stamps is not None and not np.array_equal(stamps, time_ns):
            n = int(np.flatnonzero(stamps != time_ns)[0])
            raise self._error(topic, f"message {n} is stamped {stamps[n]} ns", f"its log time, {time_ns[n]} ns")
        return time_ns, arrays

    def _commands(
        self, array_topic: Topic, joints: int, period_ns: int, end_ns: int
    ) -> tuple[tuple[int, RecordedCommand], ...]:
        """Commands of all topics, in the order in which they were written."""
        _, (values,) = self._fixed(array_topic, FixedMessage([joints]))
        given = {array_topic: [RecordedCommand(None, tuple(row)) for row in values.tolist()]}
        if self._is_there(JOINT_COMMANDS):
            decoded = [self._decode(JOINT_COMMANDS, data) for data in self._messages(JOINT_COMMANDS)]
            given[JOINT_COMMANDS] = [RecordedCommand(tuple(m.name), tuple(m.position.tolist())) for m in decoded]
        ranked: list[tuple[int, int, RecordedCommand]] = []
        for topic, commands in given.items():
            for (rank, message), command in zip(self.found[self._name(topic)], commands):
                time_ns = message.time_ns
                if not self.complete and time_ns >= end_ns:
                    break
                step, rest = divmod(time_ns, period_ns)
                if rest or not 0 <= time_ns <= end_ns:
                    raise self._error(topic, f"a command at {time_ns} ns", "the time of a state")
                ranked.append((rank, step, command))
        return tuple((step, command) for _, step, command in sorted(ranked))
