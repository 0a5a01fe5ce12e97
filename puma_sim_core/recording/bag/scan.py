# Copyright the puma-sim contributors. SPDX-License-Identifier: Apache-2.0
"""One pass over the records of an MCAP file, that of a killed recorder included.

The reader of the `mcap` package needs the index at the end of the file, or takes a cut record
for a whole one. This pass checks each length against what is there, and says where it stopped.
Format: the MCAP specification, version 0.
"""

import io
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream

from puma_sim_core.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQII")  # first and last time, size, checksum, length of compression
_FOOTER = struct.Struct("<BQQQI")
_READ = (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS)


class RawMessage(NamedTuple):
    """A message as it stands in the bag: log time [ns], CDR bytes."""

    topic: str
    type: str
    time_ns: int
    data: bytes


class Damage(NamedTuple):
    """Bytes of a file that could not be read."""

    path: Path
    offset: int
    size: int
    what: str


class _Fault(Exception):
    """The file cannot be read on from here; the text says what is wrong."""


class Scan:
    """Reads the messages of an MCAP file in the order in which they were written.

    ``topics`` (name to type) and ``counts`` (name to number of messages) fill up during
    `messages`. ``complete`` says whether the file ends with its index and footer, ``damage`` what was passed over.
    Raises `BagError` if the file cannot be read or, unless ``partial``, is no MCAP file.
    """

    def __init__(self, path: Path, partial: bool = False):
        self.path = path
        self.topics: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        self.fault: BagError | None = None
        self.damage: list[Damage] = []
        self._partial = partial
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, tuple[str, str]] = {}
        self._statistics: Statistics | None = None
        try:
            self.size = path.stat().st_size
            with open(path, "rb") as file:
                magic = file.read(len(MAGIC))
                self.complete = _ends_with_footer(file, self.size)
        except OSError as error:
            raise BagError(f"cannot be read ({error.strerror})", where=path, expected="an MCAP file") from error
        if magic != MAGIC:
            self.fault = BagError(
                "is not an MCAP file", where=path, expected="a bag of sim_node, or the .mcap file in it"
            )
            self.damage.append(Damage(path, 0, self.size, self.fault.what))
            if not partial:
                raise self.fault

    def messages(self, after_ns: int = 0) -> Iterator[RawMessage]:
        """Messages in file order, none before ``after_ns``. Raises `BagError` where the file cannot be read on; if it
        is read in part it goes on at the next whole chunk, and ends where there is none, with that error in ``fault``.
        """
        if self.fault:
            return
        last, self._used = after_ns, len(MAGIC)
        try:
            with open(self.path, "rb") as file:
                for message in self._parts(file):
                    if not last <= message.time_ns < 2**63:
                        what = f"a message at {message.time_ns} ns stands after one at {last} ns"
                        where, expected = f"{self.path}, topic {message.topic}", "messages in the order of their times"
                        raise BagError(what, where=where, expected=expected)
                    last = message.time_ns
                    yield message
            if not self.damage and self._statistics and self._statistics.message_count != self.counts.total():
                expected = f"the {self._statistics.message_count} of its own index"
                raise BagError(f"holds {self.counts.total()} messages", where=self.path, expected=expected)
        except OSError as error:
            raise BagError(f"cannot be read ({error.strerror})", where=self.path) from error
        except BagError as error:
            self.fault = error
            if not self._partial:
                raise

    def _parts(self, file: BinaryIO) -> Iterator[RawMessage]:
        """Messages; of a file that is read in part, also of what stands behind damage."""
        place: int | None = self._used
        while place is not None:
            try:
                yield from self._records(file, place)
                return
            except _Fault as fault:
                begin, place = self._used, self._next_chunk(file, self._used)
                size = (self.size if place is None else place) - begin
                self.damage.append(Damage(self.path, begin, size, str(fault)))
                where, expected = f"{self.path}, offset {begin}", "a whole MCAP record"
                if place is None:
                    raise BagError(str(fault), where=where, expected=expected) from None

    def _next_chunk(self, file: BinaryIO, offset: int) -> int | None:
        """Offset of the first chunk behind an offset whose checksum holds; None without one, or where all is wanted."""
        if not self._partial:
            return None
        offset = file.seek(offset + 1)
        rest, first = file.read(), bytes([Opcode.CHUNK])
        place = rest.find(first)
        while place >= 0 and not _is_whole_chunk(rest, place):
            place = rest.find(first, place + 1)
        return offset + place if place >= 0 else None

    def _records(self, file: BinaryIO, offset: int) -> Iterator[RawMessage]:
        file.seek(offset)
        while True:
            self._used = offset
            head = file.read(_HEAD.size)
            if len(head) < _HEAD.size:
                raise _Fault("the file ends without a footer")
            opcode, length = _HEAD.unpack(head)
            if opcode == 0:
                raise _Fault("there is no record, but zeros")
            if opcode == Opcode.FOOTER:
                return
            room = self.size - offset - _HEAD.size
            cut = length > room
            if cut and self._next_chunk(file, offset) is not None:
                raise _Fault(f"a record of {length} bytes, more than there are")
            file.seek(offset + _HEAD.size)
            if opcode == Opcode.CHUNK:
                yield from self._chunk(file.read(min(length, room)), cut)
            if cut:
                raise _Fault(f"the file ends inside a record of {length} bytes")
            if opcode in _READ:
                yield from self._record(opcode, file.read(length))
            offset = file.seek(offset + _HEAD.size + length)

    def _chunk(self, body: bytes, cut: bool) -> Iterator[RawMessage]:
        start = _CHUNK.size
        if len(body) < start:
            raise _Fault("the file ends inside the head of a chunk")
        if cut:
            name_length = _CHUNK.unpack_from(body)[-1]
            if name_length:
                raise _Fault("the file ends inside a compressed chunk")
            start += 8
            records = body[start:]
        else:
            try:
                records = _chunk_records(body)
            except Exception as error:  # each decompressor raises its own kinds
                raise _Fault(f"the chunk is damaged ({error})") from error
        begin = self._used + _HEAD.size + start
        offset = 0
        while offset + _HEAD.size <= len(records):
            opcode, length = _HEAD.unpack_from(records, offset)
            offset += _HEAD.size
            if offset + length > len(records):
                break
            if opcode in _READ and opcode != Opcode.STATISTICS:
                yield from self._record(opcode, records[offset : offset + length])
            offset += length
            if cut:
                self._used = begin + offset
        if not cut and offset != len(records):
            raise _Fault("the last record of the chunk is longer than the chunk")

    def _record(self, opcode: int, body: bytes) -> Iterator[RawMessage]:
        """Take in a record; gives the message if it is one."""
        if opcode == Opcode.MESSAGE:
            yield self._message(body)
            return
        stream = ReadDataStream(io.BytesIO(body))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                schema = self._schemas.get(channel.schema_id)
                form = "" if channel.message_encoding == "cdr" else f" as {channel.message_encoding}"
                self.topics[channel.topic] = f"{schema.name if schema else ''}{form}"
                self._channels[channel.id] = (channel.topic, self.topics[channel.topic])
            else:
                self._statistics = Statistics.read(stream)
        except Exception as error:  # the library raises several kinds on arbitrary bytes
            name = Opcode(opcode).name.lower()
            raise _Fault(f"the {name} record is damaged ({type(error).__name__})") from error

    def _message(self, body: bytes) -> RawMessage:
        if len(body) < _MESSAGE.size:
            raise _Fault(f"the message record has {len(body)} bytes")
        number, _, time_ns, _ = _MESSAGE.unpack_from(body)
        channel = self._channels.get(number)
        if channel is None:
            raise _Fault(f"the message is of channel {number}, which was not described before")
        self.counts[channel[0]] += 1
        return RawMessage(*channel, time_ns, body[_MESSAGE.size :])


def _chunk_records(body: bytes) -> bytes:
    """The records in the body of a chunk; raises several kinds where its checksum or its lengths do not hold."""
    *_, size, checksum, name_length = _CHUNK.unpack_from(body)
    start = _CHUNK.size + name_length + 8
    compression = body[_CHUNK.size : start - 8].decode()
    # the library checks the sum and knows the compressions
    chunk = Chunk(compression, body[start:], 0, 0, checksum, size)
    return bytes(get_chunk_data_stream(chunk, validate_crc=True)[0].read(size))


def _is_whole_chunk(data: bytes, place: int) -> bool:
    """Whether a chunk with a checksum that holds begins at a place."""
    if place + _HEAD.size + _CHUNK.size > len(data):
        return False
    _, length = _HEAD.unpack_from(data, place)
    body = data[place + _HEAD.size : place + _HEAD.size + min(length, len(data))]
    if len(body) < max(length, _CHUNK.size + 8):
        return False
    *_, size, checksum, name_length = _CHUNK.unpack_from(body)
    if not checksum or name_length > len("lz4") + 1 or not (name_length or size == length - _CHUNK.size - 8):
        return False
    try:
        _chunk_records(body)
    except Exception:  # each decompressor raises its own kinds
        return False
    return True


def _ends_with_footer(file: BinaryIO, size: int) -> bool:
    tail = _FOOTER.size + len(MAGIC)
    if size < len(MAGIC) + tail:
        return False
    file.seek(-tail, io.SEEK_END)
    data = file.read()
    opcode, length, summary_start, _, _ = _FOOTER.unpack_from(data)
    whole = opcode == Opcode.FOOTER and length == _FOOTER.size - _HEAD.size
    return data.endswith(MAGIC) and whole and summary_start > 0
