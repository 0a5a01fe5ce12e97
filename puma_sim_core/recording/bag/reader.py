# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""Reading of bags that `BagRecorder` wrote."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from puma_sim_core.errors import BagError
from puma_sim_core.recording.bag import messages
from puma_sim_core.recording.bag.files import BagFiles
from puma_sim_core.recording.bag.messages import FixedMessage
from puma_sim_core.recording.bag.scan import Damage, RawMessage
from puma_sim_core.recording.topics import (
    ARRAY_COMMANDS,
    BRAKES,
    EFFECTS,
    FRAMES,
    JOINT_COMMANDS,
    MODEL,
    PLACEMENTS,
    STATE_FIELDS,
    STATES,
    STRING,
    URDF,
    Topic,
)


class RecordedCommand(NamedTuple):
    """A command as the session accepted it: values in V or rad, of these joints (None: all)."""

    names: tuple[str, ...] | None
    values: tuple[float, ...]


class RecordedPlacement(NamedTuple):
    """Joints that were put at positions [rad] and velocities [rad/s]."""

    names: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]


class RecordedBrakes(NamedTuple):
    """Whether the brakes hold from a state on."""

    engaged: bool


class RecordedEffects(NamedTuple):
    """Effects from a state on, as YAML of a model file's entry."""

    text: str


Input = RecordedCommand | RecordedPlacement | RecordedBrakes | RecordedEffects


@dataclass(frozen=True, eq=False)
class BagContents:
    """A recorded session; n states, the first of step 0, one per period. Of a bag that was damaged some are missing.

    ``inputs`` holds (step, command or other change) in their order: an input belongs to the step that consumed it,
    which leads from state ``step`` to state ``step + 1``. ``period_ns`` is None if there is but one state.
    """

    path: Path  # as it was given: the directory, or one file
    complete: bool  # each file ends with its index; False for what a killed recorder left
    namespace: str
    config_text: str
    urdf: str | None
    frames: bool  # whether it holds the frames on /tf
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
    inputs: tuple[tuple[int, Input], ...]
    splits_ns: tuple[int, ...] = ()  # times at which its second MCAP file and the later ones begin [ns]
    damage: tuple[Damage, ...] = ()  # what could not be read, of a bag that was read in part

    @property
    def commands(self) -> tuple[tuple[int, RecordedCommand], ...]:
        """(step, command) of the inputs that are commands."""
        return tuple((step, each) for step, each in self.inputs if isinstance(each, RecordedCommand))

    @property
    def missing(self) -> tuple[tuple[int, int], ...]:
        """(first, last) step of each stretch that is missing between two states."""
        places = np.flatnonzero(np.diff(self.steps) > 1)
        return tuple((int(self.steps[n]) + 1, int(self.steps[n + 1]) - 1) for n in places)


def iterate_messages(path: str | Path) -> Iterator[RawMessage]:
    """Messages of a closed bag of any program, in the order of their log times; raises as `read_bag` does."""
    return BagFiles(Path(path)).messages()


def read_bag(path: str | Path, *, partial: bool = False) -> BagContents:
    """Read a bag: its directory with all its MCAP files, or one file alone, which must be the first.

    Parameters
    ----------
    partial : read what a killed recorder left, up to its last whole period; ``metadata.yaml`` and files
        may be missing then, and commands that no written state shows are left out. Without it
        such a bag is refused.

    Raises
    ------
    BagError : no bag, or one of another program; cut off, without ``metadata.yaml``, without a
        file or a topic, or with numbers of messages that do not agree.
    """
    return _Session(BagFiles(Path(path), partial), partial).contents()


def names_told(recorded: Iterable[RawMessage]) -> dict[str, str]:
    """Full names of a session's topics by their own, where a model among the messages tells others; empty otherwise."""
    for message in recorded:
        if message.type == STRING:
            try:
                names = messages.names_in(messages.decode(message.data, STRING).data)
            except ValueError:
                continue
            if names.get(MODEL.name) == message.topic:
                return names
    return {}


class _Session:
    """The messages of one bag, turned into `BagContents`."""

    def __init__(self, files: BagFiles, partial: bool):
        self.files, self.path, self.partial = files, files.path, partial
        #: topic -> its messages, each with its rank in the whole bag
        self.found: dict[str, list[tuple[int, RawMessage]]] = defaultdict(list)
        for rank, message in enumerate(files.messages()):
            self.found[message.topic].append((rank, message))
        self.topics, self.complete = files.topics, files.complete
        self.names, self.namespace = dict[str, str](), ""
        name, self.config_text = self._model()
        self.names = messages.names_in(self.config_text)
        self.namespace = name.removesuffix(f"/{MODEL.name}") if not self.names else ""

    def _model(self) -> tuple[str, str]:
        """Name and text of the topic with the model: by its name, or by what stands in it."""
        models = [name for name in self.topics if name.endswith("/" + MODEL.name)]
        if not models:
            told = names_told(found[0][1] for found in self.found.values())
            models = [told[MODEL.name]] if told else []
        if not any(name in self.found for name in models):
            raise self._without_model()
        if len(models) != 1:
            what, expected = f"{len(models)} topics are named {MODEL.name}", "one, which each bag of this simulator has"
            raise BagError(what, where=self.path, expected=expected)
        self.names[MODEL.name] = models[0]
        return models[0], self._text(MODEL)

    def _without_model(self) -> BagError:
        if fault := self.files.fault:
            return BagError(f"{fault.what}, and there is no model before", where=fault.where, expected=fault.expected)
        if self.files.damage:
            first = self.files.damage[0]
            where, expected = f"{first.path}, offset {first.offset}", "the model, which stands first"
            return BagError(f"{first.what}, and there is no model before", where=where, expected=expected)
        what, expected = f"there is no model on a topic {MODEL.name}", "one, which each bag of this simulator has"
        if not self.path.is_dir():
            expected += " in its first file: of a bag of several files name the directory"
        return BagError(what, where=self.path, expected=expected)

    def contents(self) -> BagContents:
        urdf = self._text(URDF) if self._is_there(URDF) else None
        interface = self._command_interface()
        names, frame_id = self._joints()
        times: dict[Topic, np.ndarray] = {}
        fields: dict[str, np.ndarray] = {}
        for topic, form in messages.state_forms(names, frame_id).items():
            times[topic], arrays = self._fixed(topic, form)
            fields.update(zip(STATE_FIELDS[topic], arrays))
        common = times.pop(STATES)
        for topic, other in times.items():
            if self.partial:
                # a period that lacks a message is not whole
                common = np.intersect1d(common, other)
            elif not np.array_equal(other, common):
                raise self._error(topic, "times differ from those of the states", "the same")
        if common.size == 0:
            raise self._error(STATES, "no whole period was written", "one or more")
        steps, period_ns = self._steps(common)
        times[STATES] = self._times(STATES)
        for topic, names_of_fields in STATE_FIELDS.items():
            rows = np.searchsorted(times[topic], common)
            fields.update({name: fields[name][rows] for name in names_of_fields})
        return BagContents(
            path=self.path,
            complete=self.complete,
            namespace=self.namespace,
            config_text=self.config_text,
            urdf=urdf,
            frames=FRAMES.name in self.topics,
            command_interface=interface,
            joint_names=names,
            frame_id=frame_id,
            period_ns=period_ns,
            steps=steps,
            time_ns=common,
            **fields,
            inputs=self._inputs(ARRAY_COMMANDS[interface], len(names), period_ns or 1, common),
            splits_ns=tuple(self.files.begins_ns[1:]),
            damage=tuple(self.files.damage),
        )

    def _name(self, topic: Topic) -> str:
        return self.names.get(topic.name, f"{self.namespace}/{topic.name}")

    def _times(self, topic: Topic) -> np.ndarray:
        return np.array([message.time_ns for _, message in self.found[self._name(topic)]], dtype=np.int64)

    def _is_there(self, topic: Topic) -> bool:
        return self._name(topic) in self.topics

    def _error(self, topic: Topic, what: str, expected: str) -> BagError:
        return BagError(what, where=f"{self.path}, topic {self._name(topic)}", expected=expected)

    def _messages(self, topic: Topic) -> list[bytes]:
        name = self._name(topic)
        if not self._is_there(topic):
            raise self._error(topic, "is missing", "in each bag of this simulator")
        if self.topics[name] != topic.type:
            raise self._error(topic, f"its type is {self.topics[name]!r}", repr(topic.type))
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
            raise BagError(f"{len(present)} command topics", where=self.path, expected=expected)
        return present[0]

    def _joints(self) -> tuple[tuple[str, ...], str]:
        """Joint names and frame of the first state."""
        found = self._messages(STATES)
        if not found:
            raise self._error(STATES, "no whole period was written", "one or more")
        first = self._decode(STATES, found[0])
        return tuple(first.name), first.header.frame_id

    def _steps(self, time_ns: np.ndarray) -> tuple[np.ndarray, int | None]:
        """Steps of the states, and the period; their times are whole periods, the first 0."""
        period_ns = int(np.diff(time_ns).min()) if len(time_ns) > 1 else None
        if time_ns[0] != 0 or (period_ns is not None and period_ns <= 0):
            raise self._error(STATES, f"states are at {time_ns[:2].tolist()} ns", "0 and one period")
        steps, rest = np.divmod(time_ns, period_ns or 1)
        wrong = np.flatnonzero(rest)
        if wrong.size:
            n = wrong[0]
            raise self._error(STATES, f"state {n} is at {time_ns[n]} ns", f"whole periods of {period_ns} ns")
        return steps, period_ns

    def _fixed(self, topic: Topic, form: FixedMessage) -> tuple[np.ndarray, list[np.ndarray]]:
        """Times (n,) [ns] and arrays (n, count) of the messages of one form."""
        found = self._messages(topic)
        time_ns = self._times(topic)
        try:
            stamps, arrays = form.decode(found)
        except messages.MismatchError as error:
            index, problem, expected = error.args
            raise self._error(topic, f"message {index} has {problem}", expected) from error
        if stamps is not None and not np.array_equal(stamps, time_ns):
            n = int(np.flatnonzero(stamps != time_ns)[0])
            raise self._error(topic, f"message {n} is stamped {stamps[n]} ns", f"its log time, {time_ns[n]} ns")
        return time_ns, arrays

    def _inputs(
        self, array_topic: Topic, joints: int, period_ns: int, states_ns: np.ndarray
    ) -> tuple[tuple[int, Input], ...]:
        """Inputs of all topics, in the order in which they were written."""
        _, (values,) = self._fixed(array_topic, FixedMessage([joints]))
        given: dict[Topic, list[Any]] = {array_topic: [RecordedCommand(None, tuple(row)) for row in values.tolist()]}
        for topic, make in _MAKE.items():
            if self._is_there(topic):
                given[topic] = [make(self._decode(topic, data)) for data in self._messages(topic)]
        known, ranked, end_ns = set(states_ns.tolist()), list[tuple[int, int, Input]](), int(states_ns[-1])
        for topic, inputs in given.items():
            for (rank, message), each in zip(self.found[self._name(topic)], inputs):
                time_ns = message.time_ns
                if not self.complete and (time_ns >= end_ns or time_ns not in known):
                    continue
                if time_ns not in known:
                    raise self._error(topic, f"a message at {time_ns} ns", "the time of a state")
                ranked.append((rank, time_ns // period_ns, each))
        return tuple((step, each) for _, step, each in sorted(ranked, key=lambda each: each[0]))


#: topics of inputs beside the command interface's own -> what their messages make
_MAKE: dict[Topic, Callable[[Any], Input]] = {
    JOINT_COMMANDS: lambda m: RecordedCommand(tuple(m.name), tuple(m.position.tolist())),
    PLACEMENTS: lambda m: RecordedPlacement(tuple(m.name), *(tuple(a.tolist()) for a in (m.position, m.velocity))),
    BRAKES: lambda m: RecordedBrakes(bool(m.data)),
    EFFECTS: lambda m: RecordedEffects(m.data),
}
