"""What is in an MCAP file, read from front to back for as far as it is whole.

One way of reading for whole, cut and hostile files: record after record, nothing believed that a
file says of its own sizes, and at the first damage it stops and says where. What it has by then is
a prefix without holes.
"""

from __future__ import annotations

import os
import re
import stat
import struct
import zlib
from collections.abc import Collection
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import Any

import numpy as np
import zstandard
from armrig_core import protobuf
from armrig_core.manifest import CALIBRATION, CALIBRATION_RAW, CONFIG, INPUT, OUTCOME, RUN
from armrig_core.topics import STREAMS
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, DataEnd, Metadata
from numpy.typing import NDArray

from armrig.recordings.byte_source import ByteSource
from armrig.recordings.sample_rows import (
    CHANNEL,
    RECORD_HEAD,
    SAMPLE_DTYPE,
    DamageError,
    SampleRows,
)

MAGIC = b"\x89MCAP0\r\n"
CHUNK_LIMIT = 8 << 20
"""Largest chunk that is unpacked, in B."""
MESSAGES_LIMIT, MESSAGES_PER_BYTE = 40 << 20, 16
"""Of messages other than samples a file of n B may cost the first plus the second times n, in B."""
RECORD_LIMIT = CHUNK_LIMIT + (64 << 10)
"""Longest record that is read, in B; a longer attachment is passed over."""
UNPACKED_LIMIT, UNPACKED_PER_BYTE, UNPACKED_MORE = 64 << 20, 64, 1 << 30
"""A file of n B may unpack to the first plus 64 n, but no more than n and the third, in B."""
WORK_LIMIT = 3_000_000
"""Most work with records, in messages passed over, which take about 1 µs each."""

_IDS = Struct("<HH")  # a channel and its schema, or a schema
_CHUNK_HEAD = Struct("<QQQII")  # start, end, uncompressed size, uncompressed CRC, length of a name
_PASSED_OVER = (Opcode.CHUNK_INDEX, Opcode.STATISTICS)
_INDEX_HEAD = Struct("<HI")  # of a message index: channel, length of what follows
# What may stand before the end of the data; a changed opcode must not make a chunk disappear.
_DATA = (
    Opcode.HEADER,
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.MESSAGE,
    Opcode.CHUNK,
    Opcode.MESSAGE_INDEX,
    Opcode.ATTACHMENT,
    Opcode.METADATA,
    Opcode.DATA_END,
)
_NAME_LIMIT, _MESSAGE_HEAD = 100, 2 + 4 + 8 + 8  # B; channel, sequence, log and publish time
_WORK, _KEPT = "units of work with records", "B of messages other than samples"
_UNPACKED = "B in its chunks, unpacked"
_RUN_WORK, _SAMPLE_WORK, _RECORD_WORK = 8, 1, 10  # measured, roughly
# Bytes that a message costs us beyond its payload once it is parsed; measured.
_OVERHEADS = {"event": 900, "gap": 850, "timing": 2_700, "clock": 850, "state": 700, "trace": 200}
READ = STREAMS
"""What most readers want; the core's steps are for who decides a run once more."""


class CutOffError(DamageError):
    """The file ends too early; says how."""

    def __init__(self, how: str) -> None:
        super().__init__(f"the file is cut off: it ends {how}")


@dataclass(slots=True, kw_only=True)
class Content:
    """What was read."""

    sha256: str = ""
    """Of the whole file, the unreadable rest included."""
    size: int = 0
    """Of the file, in B."""
    damage: str = ""
    """Why reading ended early; "" for a whole file."""
    cut_off: bool = False
    """That is because the file ends too early; nothing before its end is wrong."""
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


def read(path: Path, streams: Collection[str] = READ, most: int = 0) -> Content | None:
    """Return what is in the file at `path`, or None where it is no MCAP.

    Parameters
    ----------
    streams : collection of str
        Of which streams the messages are kept.
    most : int
        What messages other than samples may cost, in B, 0 for `MESSAGES_LIMIT`; more is damage.

    Raises
    ------
    OSError
        The file cannot be opened or read.
    DamageError
        It is no regular file: a pipe or a device would keep us waiting, or never end.
    """
    with open(path, "rb", opener=opened) as stream:
        found = os.fstat(stream.fileno())
        if not stat.S_ISREG(found.st_mode):
            msg = "not a regular file"
            raise DamageError(msg)
        content = Content(size=found.st_size)
        source = ByteSource(stream, content.size)
        if source.read(len(MAGIC)) != MAGIC:
            return None
        most = most or MESSAGES_LIMIT + MESSAGES_PER_BYTE * content.size
        reader = _Reader(content, streams, most)
        try:
            _read_records(source, reader)
        except DamageError as damage:
            content.damage, content.cut_off = str(damage), isinstance(damage, CutOffError)
        # The libraries raise these on damaged bytes. The CRCs make it rare.
        except (McapError, struct.error, DecodeError, ValueError, OverflowError) as err:
            content.damage = f"a record cannot be read ({err or type(err).__name__})"
        content.read = source.whole
        left = reader.rows.finish()
        content.damage = content.damage or left
        content.samples = reader.rows.samples()
        content.sha256 = source.sha256()
    return content


def opened(path: str, flags: int) -> int:
    """Open a file that may be anything, as the opener of `open`."""
    # Do not wait until somebody writes to a pipe. Windows has neither of the two flags.
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0))


def _read_records(source: ByteSource, reader: _Reader) -> None:
    """Read until the closing magic; raises DamageError where the file ends or breaks before."""
    ended = False
    while True:
        source.whole = source.at
        head = source.read(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            raise CutOffError("without its footer")
        opcode, length = RECORD_HEAD.unpack(head)
        if not ended and opcode not in _DATA:
            msg = f"a record of opcode {opcode} stands among the data"
            raise DamageError(msg)
        if length > source.left:
            raise CutOffError(f"{length - source.left} B before the end of its last record")
        reader.spend(_WORK, 1)
        if opcode == Opcode.MESSAGE_INDEX:
            _pass_index(source, length)
            continue
        if opcode in _PASSED_OVER or (opcode == Opcode.ATTACHMENT and length > RECORD_LIMIT):
            source.skip(length)
            continue
        if length > RECORD_LIMIT:
            msg = f"a record of {length} B is longer than the {RECORD_LIMIT} B allowed"
            raise DamageError(msg)
        body = source.read(length)
        if opcode == Opcode.FOOTER:
            if source.read(len(MAGIC)) != MAGIC:
                raise CutOffError("without its closing magic")
            source.whole = source.at
            return
        if opcode == Opcode.DATA_END:
            expected = DataEnd.read(_stream(body)).data_section_crc
            # Check it once: each check reads the whole file again.
            if expected and (ended or expected != source.crc(source.whole)):
                msg = "the checksum over all data is wrong: something in the file was changed"
                raise DamageError(msg)
            ended = True
        else:
            reader.add_record(opcode, body)


def _pass_index(source: ByteSource, length: int) -> None:
    """Pass over an index of messages, which must have the form of one: a chunk has not."""
    head = source.read(min(_INDEX_HEAD.size, length))
    if len(head) < _INDEX_HEAD.size or _INDEX_HEAD.unpack(head)[1] != length - len(head):
        msg = "an index of messages has not the form of one"
        raise DamageError(msg)
    source.skip(length - len(head))


class _Reader:
    """Collects what the records hold."""

    def __init__(self, content: Content, streams: Collection[str], most: int) -> None:
        self.content = content
        self.kept = streams
        self.schemas: dict[int, str] = {}
        self.streams: dict[int, str] = {}
        more = min(UNPACKED_PER_BYTE * content.size, content.size + UNPACKED_MORE)
        self.limits = {_WORK: WORK_LIMIT, _KEPT: most, _UNPACKED: UNPACKED_LIMIT + more}
        self.spent = dict.fromkeys(self.limits, 0)
        self.rows = SampleRows()
        self.zstd = zstandard.ZstdDecompressor(max_window_size=CHUNK_LIMIT)

    def add_record(self, opcode: int, body: bytes) -> None:
        """Add one record of the file, or of a chunk."""
        self.spend(_WORK, 1 if opcode == Opcode.MESSAGE else _RECORD_WORK)
        match opcode:
            case Opcode.CHUNK:
                self._chunk(body)
            case Opcode.MESSAGE:
                self._message(body)
            case Opcode.SCHEMA:
                name = _text(body, 2)
                if name in protobuf.OF_STREAM.values():
                    self.schemas[_IDS.unpack_from(body)[0]] = name
            case Opcode.CHANNEL:
                (channel, schema), stream = _IDS.unpack_from(body), stream_of(_text(body, 4))
                if stream in self.kept and self.schemas.get(schema) == protobuf.OF_STREAM[stream]:
                    self.streams[channel] = stream
            case Opcode.METADATA:
                name = _text(body, 0)
                if name in (RUN, OUTCOME) and name not in self.content.metadata:
                    self.content.metadata[name] = Metadata.read(_stream(body)).metadata
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
        if attachment.name in (CALIBRATION, CALIBRATION_RAW, CONFIG, INPUT):
            self.content.attachments.setdefault(attachment.name, attachment.data)

    def _chunk(self, body: bytes) -> None:
        _, _, size, crc, n = _CHUNK_HEAD.unpack_from(body)
        at = _CHUNK_HEAD.size
        compression, at = body[at : at + n].decode(), at + n
        packed = body[at + 8 :]
        if size > CHUNK_LIMIT:
            msg = f"a chunk of {size} B is larger than the {CHUNK_LIMIT} B allowed"
            raise DamageError(msg)
        self.spend(_UNPACKED, size)
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
        # decompress(max_output_size=…) would believe the size that the frame declares.
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
            run = self.rows.add_run(data, at) if self._begins_samples(opcode, data, at) else 0
            if run:
                self.spend(_WORK, _RUN_WORK)
            else:
                if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    msg = f"a chunk holds a record (opcode {opcode}) that must not lie in one"
                    raise DamageError(msg)
                run = RECORD_HEAD.size + length
                self.add_record(opcode, data[at + RECORD_HEAD.size : at + run])
            at += run

    def _begins_samples(self, opcode: int, data: bytes, at: int) -> bool:
        channel = int.from_bytes(data[at + CHANNEL.start : at + CHANNEL.stop], "little")
        return opcode == Opcode.MESSAGE and self.streams.get(channel) == "sample"

    def _message(self, body: bytes) -> None:
        stream = self.streams.get(int.from_bytes(body[:2], "little"))
        if stream is None:
            return
        data = body[_MESSAGE_HEAD:]
        parsed = protobuf.message_class(protobuf.OF_STREAM[stream]).FromString(data)
        if stream == "sample":
            self.spend(_WORK, _SAMPLE_WORK)
            self.rows.add(parsed)
            return
        self.spend(_WORK, _RECORD_WORK)
        self.spend(_KEPT, len(data) + _OVERHEADS[stream])
        self.content.messages.setdefault(stream, []).append(parsed)

    def spend(self, what: str, cost: int) -> None:
        """Count what a record costs: a small file must not cost hours, or all memory."""
        self.spent[what] += cost
        if self.spent[what] > self.limits[what]:
            msg = f"more than {self.limits[what]} {what}"
            raise DamageError(msg)


def stream_of(topic: str) -> str:
    """Return the stream of a topic such as /rig/1/sample, "" where it is none of ours."""
    found = re.fullmatch(r"/rig/[a-z0-9-]{1,40}/([a-z]{1,20})", topic)
    return found[1] if found and found[1] in protobuf.OF_STREAM else ""


def _text(body: bytes, at: int) -> str:
    """Return the text at `at`, "" for one that is too long to be a name of ours."""
    (n,) = struct.unpack_from("<I", body, at)
    struct.unpack_from(f"{n}x", body, at + 4)  # raises where the text runs over the end
    return body[at + 4 : at + 4 + n].decode() if n <= _NAME_LIMIT else ""


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))
