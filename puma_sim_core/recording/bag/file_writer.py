# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One MCAP file of a bag while it is written."""

from collections.abc import Mapping
from pathlib import Path

from mcap.writer import CompressionType, Writer

from puma_sim_core import __version__
from puma_sim_core.recording.bag import messages, metadata
from puma_sim_core.recording.bag.metadata import FileInformation
from puma_sim_core.recording.topics import Topic

# A chunk is closed at each flush; this only bounds one that many commands at one step fill.
_CHUNK_BYTES = 65536


class FileWriter:
    """A new MCAP file with the topics of a bag; its methods pass on the ``OSError`` of a disk that refuses.

    Until `finish` the index of its chunks is in memory.

    path : the file, which must not exist.
    names : full name of each topic.
    time_ns : simulated time at which the file begins [ns].
    """

    def __init__(self, path: Path, names: Mapping[Topic, str], time_ns: int):
        self._path, self._names = path, names
        self._first_ns = self._last_ns = time_ns
        self._counts = dict.fromkeys(names, 0)
        # Larger than a chunk with its index, so that each flush is one write to the file.
        self._file = open(path, "xb", buffering=4 * _CHUNK_BYTES)
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.NONE)
        self._writer.start(profile="ros2", library=f"puma-sim-core {__version__}")
        schemas: dict[str, int] = {}
        self._channels: dict[Topic, int] = {}
        for topic, name in names.items():
            kind = topic.type
            if kind not in schemas:
                schemas[kind] = self._writer.register_schema(kind, "ros2msg", messages.definition(kind).encode())
            profile = {"offered_qos_profiles": messages.qos_text(topic), "topic_type_hash": messages.type_hash(kind)}
            self._channels[topic] = self._writer.register_channel(name, "cdr", schemas[kind], profile)

    def add(self, topic: Topic, data: bytes, time_ns: int, sequence: int) -> None:
        """Put a message into the open chunk; ``sequence`` counts those of its topic in the whole bag."""
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns, sequence)
        self._counts[topic] += 1
        self._last_ns = time_ns

    def flush(self) -> None:
        """Hand everything written so far to the operating system, as a closed chunk."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self) -> FileInformation:
        """Write the rosbag2 metadata record and the index, close the file, and say what it holds."""
        written = FileInformation(self._path.name, self._first_ns, self._last_ns, self._counts)
        inner = metadata.dump(metadata.information(self._names, [written], listed=False)).strip()
        self._writer.add_metadata("rosbag2", {"serialized_metadata": inner})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()
        return written

    def abandon(self) -> None:
        """Close the file as it stands: the raw file, so that the buffer above it is dropped, not written again."""
        self._file.raw.close()  # type: ignore[attr-defined]
