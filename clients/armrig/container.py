"""What is in an MCAP file, read from front to back for as far as it is whole.

One way of reading for whole, cut and hostile files: record after record, nothing believed that a
file says of its own sizes, and at the first damage it stops and says where. What it has by then is
a prefix without holes.
"""

from __future__ import annotations

import hashlib
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import IO, Any

import numpy as np
import zstandard
from armrig_core import protobuf
from armrig_core.manifest import CALIBRATION, CONFIG
from armrig_core.topics import STREAMS
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Message, Metadata, Schema
from numpy.typing import NDArray

from armrig.sample_rows import CHANNEL, RECORD_HEAD, SAMPLE_DTYPE, DamageError, SampleRows

MAGIC = b"\x89MCAP0\r\n"
CHUNK_LIMIT = 8 << 20
"""Largest chunk that is unpacked, in B."""
MESSAGES_LIMIT = 16 << 20
"""Most that is kept of messages other than samples, in B."""
RECORD_LIMIT = CHUNK_LIMIT + (64 << 10)
"""Longest record that is read, in B; a longer attachment is passed over."""

_CHUNK_HEAD = Struct("<QQQII")  # start, end, uncompressed size, uncompressed CRC, length of a name
_PASSED_OVER = (Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.STATISTICS)
_IGNORED_COST = 16  # so that a million of them are allowed
_MESSAGE_OVERHEAD = 200  # bytes that a short message costs us beyond its payload
_KINDS = {
    "sample": protobuf.SAMPLE,
    "gap": protobuf.GAP,
    "event": protobuf.LOG,
    "timing": protobuf.TIMING,
    "clock": protobuf.CLOCK,
    "state": protobuf.STATE,
}


@dataclass(slots=True, kw_only=True)
class Content:
    """What was read."""

    sha256: str = ""
    """Of the whole file, the unreadable rest included."""
    size: int = 0
    """Of the file, in B."""
    damage: str = ""
    """Why reading ended early; "" for a whole file."""
    read: int = 0
    """Bytes that were read when it ended."""
    samples: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, SAMPLE_DTYPE))
    """All samples, `SAMPLE_DTYPE`, k rising strictly."""
    messages: dict[str, list[Any]] = field(default_factory=dict)
    """Protobuf messages of each other stream."""
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    """Metadata records by name."""
    attachments: dict[str, bytes] = field(default_factory=dict)
    """Attachments that a reader needs, by name."""


def read(path: Path) -> Content | None:
    """Return what is in the file at `path`, or None where it is no MCAP.

    Raises
    ------
    OSError
        The file cannot be opened or read.
    """
    with path.open("rb") as stream:
        content = Content(size=path.stat().st_size)
        source = _Source(stream, content.size)
        if source.take(len(MAGIC)) != MAGIC:
            return None
        reader = _Reader(content)
        try:
            _read_records(source, reader)
        except DamageError as damage:
            content.damage = str(damage)
        # What the libraries raise on damaged bytes; the CRCs make it rare.
        except (McapError, struct.error, DecodeError, ValueError) as err:
            content.damage = f"a record cannot be read ({err or type(err).__name__})"
        content.read = source.whole
        left = reader.rows.finish()
        content.damage = content.damage or left
        content.samples = reader.rows.samples()
        content.sha256 = source.sha256()
    return content


class _Source:
    """The bytes of a file, from the front."""

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self.stream, self.left = stream, size
        self.at = 0
        self.whole = 0
        """End of the last whole record."""

    def take(self, n: int) -> bytes:
        """Return the next n bytes, fewer at the end of the file."""
        data = self.stream.read(min(n, self.left))
        self.left = self.left - len(data) if data else 0
        self.at += len(data)
        return data

    def skip(self, n: int) -> None:
        """Pass over n bytes."""
        self.at = self.stream.seek(self.at + n)
        self.left -= n

    def sha256(self) -> str:
        """Return the hash of the whole file, as large as it was when it was opened."""
        digest = hashlib.sha256()
        for block in self._blocks(self.at + self.left):
            digest.update(block)
        return digest.hexdigest()

    def crc(self, length: int) -> int:
        """Return the CRC-32 of the first `length` bytes."""
        crc = 0
        for block in self._blocks(length):
            crc = zlib.crc32(block, crc)
        return crc

    def _blocks(self, length: int) -> Iterator[bytes]:
        # Once more over the file, in large pieces: to hash each record as it passes is slower.
        self.stream.seek(0)
        while length > 0 and (block := self.stream.read(min(length, 1 << 20))):
            length -= len(block)
            yield block
        self.stream.seek(self.at)


def _read_records(source: _Source, reader: _Reader) -> None:
    """Read until the closing magic; raises DamageError where the file ends or breaks before."""
    while True:
        source.whole = source.at
        head = source.take(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            msg = "the file ends without its footer"
            raise DamageError(msg)
        opcode, length = RECORD_HEAD.unpack(head)
        if length > source.left:
            msg = f"the file ends {length - source.left} B before the end of its last record"
            raise DamageError(msg)
        if opcode in _PASSED_OVER or (opcode == Opcode.ATTACHMENT and length > RECORD_LIMIT):
            source.skip(length)
            continue
        if length > RECORD_LIMIT:
            msg = f"a record of {length} B is longer than the {RECORD_LIMIT} B allowed"
            raise DamageError(msg)
        body = source.take(length)
        if opcode == Opcode.FOOTER:
            if source.take(len(MAGIC)) != MAGIC:
                msg = "the file ends without its closing magic"
                raise DamageError(msg)
            source.whole = source.at
            return
        if opcode == Opcode.DATA_END:
            expected = DataEnd.read(_stream(body)).data_section_crc
            if expected and expected != source.crc(source.whole):
                msg = "the checksum over all data is wrong: something in the file was changed"
                raise DamageError(msg)
        else:
            reader.take(opcode, body)


class _Reader:
    """Collects what the records hold."""

    def __init__(self, content: Content) -> None:
        self.content = content
        self.schemas: dict[int, str] = {}
        self.streams: dict[int, str] = {}
        self.kept = 0
        self.rows = SampleRows()
        self.zstd = zstandard.ZstdDecompressor(max_window_size=CHUNK_LIMIT)

    def take(self, opcode: int, body: bytes) -> None:
        """Take one record of the file, or of a chunk."""
        match opcode:
            case Opcode.CHUNK:
                self._chunk(body)
            case Opcode.MESSAGE:
                self._message(body)
            case Opcode.SCHEMA:
                schema = Schema.read(_stream(body))
                self.schemas[schema.id] = schema.name
            case Opcode.CHANNEL:
                channel = Channel.read(_stream(body))
                stream = stream_of(channel.topic)
                if stream and self.schemas.get(channel.schema_id) == _KINDS[stream]:
                    self.streams[channel.id] = stream
            case Opcode.METADATA:
                metadata = Metadata.read(_stream(body))
                self.content.metadata.setdefault(metadata.name, metadata.metadata)
            case Opcode.ATTACHMENT:
                self._attachment(body)
            case _:
                pass  # header, indexes, and what later versions may add

    def _attachment(self, body: bytes) -> None:
        (crc,) = Struct("<I").unpack(body[-4:])
        if crc and crc != zlib.crc32(body[:-4]):
            msg = "the checksum of an attachment is wrong"
            raise DamageError(msg)
        attachment = Attachment.read(_stream(body))
        if attachment.name in (CALIBRATION, CONFIG):
            self.content.attachments.setdefault(attachment.name, attachment.data)

    def _chunk(self, body: bytes) -> None:
        _, _, size, crc, n = _CHUNK_HEAD.unpack_from(body)
        at = _CHUNK_HEAD.size
        compression, at = body[at : at + n].decode(), at + n
        packed = body[at + 8 :]
        if size > CHUNK_LIMIT:
            msg = f"a chunk of {size} B is larger than the {CHUNK_LIMIT} B allowed"
            raise DamageError(msg)
        data = packed
        if compression == "zstd":
            data = self._unpack(packed)
        elif compression:
            msg = f"compression {compression!r} is not known; known are zstd and none"
            raise DamageError(msg)
        if len(data) != size or (crc and zlib.crc32(data) != crc):
            msg = "the checksum or the size of a chunk is wrong"
            raise DamageError(msg)
        self._walk(data)

    def _unpack(self, packed: bytes) -> bytes:
        # Not decompress(max_output_size=…): that limit gives way to what the frame declares.
        try:
            with self.zstd.stream_reader(packed) as stream:
                return stream.read(CHUNK_LIMIT + 1)
        except zstandard.ZstdError as err:
            msg = f"a chunk cannot be unpacked ({err})"
            raise DamageError(msg) from err

    def _walk(self, data: bytes) -> None:
        """Take the records of a chunk: runs of samples of constant layout at once."""
        at, end = 0, len(data)
        while at < end:
            if end - at < RECORD_HEAD.size:
                msg = "a chunk ends within a record"
                raise DamageError(msg)
            opcode, length = RECORD_HEAD.unpack_from(data, at)
            if at + RECORD_HEAD.size + length > end:
                msg = "a record runs over the end of its chunk"
                raise DamageError(msg)
            run = self.rows.take_run(data, at) if self._begins_samples(opcode, data, at) else 0
            if not run:
                if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    msg = f"a chunk holds a record (opcode {opcode}) that must not lie in one"
                    raise DamageError(msg)
                self.take(opcode, data[at + RECORD_HEAD.size : at + RECORD_HEAD.size + length])
                run = RECORD_HEAD.size + length
            at += run

    def _begins_samples(self, opcode: int, data: bytes, at: int) -> bool:
        channel = int.from_bytes(data[at + CHANNEL.start : at + CHANNEL.stop], "little")
        return opcode == Opcode.MESSAGE and self.streams.get(channel) == "sample"

    def _message(self, body: bytes) -> None:
        stream = self.streams.get(int.from_bytes(body[:2], "little"))
        if stream is None:
            # Nothing is kept of it; it counts, so that a small file cannot cost hours.
            self._count(_IGNORED_COST)
            return
        message = Message.read(_stream(body), len(body))
        parsed = protobuf.message_class(_KINDS[stream]).FromString(message.data)
        if stream == "sample":
            self.rows.take(parsed)
            return
        self._count(len(message.data) + _MESSAGE_OVERHEAD)
        self.content.messages.setdefault(stream, []).append(parsed)

    def _count(self, cost: int) -> None:
        self.kept += cost
        if self.kept > MESSAGES_LIMIT:
            msg = f"more than {MESSAGES_LIMIT} B of messages other than samples"
            raise DamageError(msg)


def stream_of(topic: str) -> str:
    """Return the stream of a topic such as /rig/1/sample, "" where it is none of ours."""
    found = re.fullmatch(r"/rig/[a-z0-9-]{1,40}/([a-z]+)", topic)
    return found[1] if found and found[1] in STREAMS else ""


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))
