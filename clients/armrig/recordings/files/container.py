"""Content of an MCAP file, without its damaged records.

All files are read record by record, because they may be truncated or forged. Reading stops at the
first damage, and the place of the damage is reported. If the file has an index, the records are
then read by the index, so that one damaged record does not cost the other records.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from struct import Struct
from typing import Any

import numpy as np
from armrig_core.recording_file.budget import KEPT, WORK, Budget, DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.chunks import Unpacker
from armrig_core.recording_file.file_records import (
    MESSAGE_HEAD,
    RECORD_HEAD,
    UNREADABLE,
    CutOffError,
    FileRecord,
    Place,
    RecordSelection,
    attachment_sha256,
    check_attachment,
    file_records,
)
from armrig_core.recording_file.manifest import (
    CALIBRATION,
    CALIBRATION_RAW,
    CONFIG,
    CONTROLLER,
    DESCRIPTION,
    OUTCOME,
    RECOVERED,
    RUN,
    SOURCES,
)
from armrig_core.recording_file.opening import byte_source
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.topics import STREAMS, stream_of
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from numpy.typing import NDArray

from armrig.numerics.quantities import plural
from armrig.recordings.files.recording_summary import data_stream, read_by_index
from armrig.recordings.files.sample_rows import ROW_LENGTH, SAMPLE_DTYPE, SampleRows

_DAMAGES = (DamageError, *UNREADABLE)

_IDS = Struct("<HH")  # a channel and its schema, or a schema
_MESSAGE = Struct("<BQH")  # opcode and length of a record, and the channel if it is a message
_IN_CHUNKS = bytes((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))
_MESSAGE_CODE = int(Opcode.MESSAGE)  # Opcode.MESSAGE itself would be looked up each time
_NAME_LIMIT = 100  # B
_RUN_WORK, _SAMPLE_WORK, _RECORD_WORK = 8, 10, 10  # costs in the budget; measured, rounded
# Bytes that a parsed message takes in addition to its payload; measured.
_OVERHEADS = {"event": 900, "gap": 850, "timing": 2_700, "clock": 850, "state": 700, "trace": 200}
_OVERHEADS |= {"control": 900}
_DECISION = ("k", "r", "v", "u_v", "is_low", "is_high", "is_slewed", "predicted", "reference_n")
READ = tuple(stream for stream in STREAMS if stream != "control")
"""Streams read by default. A replay also needs the stream `trace`, the core's steps, and `control`
has a message for each sample."""


@dataclass(slots=True, kw_only=True)
class Content:
    """Content that was read from a file."""

    sha256: str = ""
    """SHA-256 of the whole file, including the bytes after a damage."""
    size: int = 0
    """Size of the file, in B."""
    damage: str = ""
    """Damage of attachments, and the reason why reading ended early; "" for an undamaged file."""
    cut_off: bool = False
    """True if reading ended because the file is truncated, not because of another error."""
    read: int = 0
    """Number of bytes up to the end of the last complete record."""
    samples: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, SAMPLE_DTYPE))
    """All samples, `SAMPLE_DTYPE`; k increases strictly."""
    messages: dict[str, list[Any]] = field(default_factory=dict)
    """Protobuf messages of each stream except the samples, by stream."""
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    """Metadata records by name."""
    attachments: dict[str, bytes] = field(default_factory=dict)
    """Calibration, readings of the calibration, configuration, description and law, by the name of
    the attachment.

    The input, or the reference of a law, is left out, because it may be long.
    """
    input: Place | None = None
    """Place of the attached input, or of the reference, in the file."""
    input_sha256: str = ""
    """SHA-256 of the input or reference; "" without one, or if its attachment is damaged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FileRange:
    """Part of a file to read; chunks outside this part are skipped."""

    from_ns: int
    """Log time of the first message in the part."""
    to_ns: int
    """Log time of the last message in the part."""
    k_end: int
    """Index of the first sample after the part.

    Reading continues up to this index, because a sample of the part may have arrived late.
    """


def read(
    path: Path,
    streams: Collection[str] = READ,
    *,
    part: FileRange | None = None,
    digest: bool = True,
) -> Content | None:
    """Return the content of the file at `path`, or None if it is not an MCAP file.

    Messages of the `streams` are kept. By default the whole file is read; of a `part`, the first
    chunk with a sample is always read. `digest` determines whether the hash of the whole file is
    computed.

    Raises OSError if the file cannot be opened or read. Raises DamageError if the file is not a
    regular file: reading a pipe or a device could block or never end.
    """
    with byte_source(path, is_hashed=digest) as source:
        if source is None:
            return None
        reader = _Reader(Content(size=source.at + source.left), streams)
        for _ in _read_records(source, reader, part):
            pass
        content, sha256 = reader.content, source.sha256() if digest else ""
        if reader.end:
            again = _read_by_index(source, reader)
            content = max(content, again, key=lambda c: (c.samples.size, len(c.metadata)))
        if content.input is not None:
            content.input_sha256 = attachment_sha256(source.stream, content.input)
    content.sha256 = sha256
    return content


def stream_messages(path: Path, stream: str) -> Iterator[Any]:
    """Yield the protobuf messages of one stream up to the first damage, without storing them.

    Raises the exceptions of `read`.
    """
    with byte_source(path) as source:
        if source is None:
            return
        reader = _Reader(Content(size=source.at + source.left), (stream,))
        for _ in _read_records(source, reader, None):
            yield from reader.content.messages.pop(stream, ())
            reader.budget.regain(KEPT)


def law_decisions(paths: Sequence[Path]) -> dict[str, NDArray[np.float64]]:
    """Return the decisions of a law in the files of a run: numbers (n,) by name, in their order.

    Raises the exceptions of `read`.
    """
    messages = chain.from_iterable(stream_messages(path, "control") for path in paths)
    table = np.array([[getattr(m, name) for name in _DECISION] for m in messages], np.float64)
    return dict(zip(_DECISION, table.reshape(-1, len(_DECISION)).T, strict=True))


def _read_records(source: ByteSource, reader: _Reader, part: FileRange | None) -> Iterator[None]:
    """Read to the end or to the first damage, which the content names; yield after each record."""
    content = reader.content
    wanted = RecordSelection(left=SOURCES)
    if part is not None:
        wanted = RecordSelection(
            left=SOURCES, chunk=lambda start, end: reader.wants(part, start, end)
        )
    try:
        for record in file_records(source, wanted, reader.spend_work):
            reader.add(record)
            yield
    except _DAMAGES as err:
        reader.end, content.cut_off = _reason(err), isinstance(err, CutOffError)
    content.read = source.whole
    reader.finish()
    content.damage = "; ".join(filter(None, [*reader.left_out, reader.end]))
    yield


def _read_by_index(source: ByteSource, first: _Reader) -> Content:
    """Read the undamaged records that the file's index names, if any, as another reader did."""
    content, left_out = Content(size=first.content.size), 0
    reader = _Reader(content, first.kept)
    try:
        for record in read_by_index(source.stream, content.size, SOURCES):
            reader.spend_work(1)
            if record is None:
                left_out += 1
                continue
            try:
                reader.add(record)
                content.read += RECORD_HEAD.size + record.place.length
            except _DAMAGES:
                left_out += 1
    except _DAMAGES:
        return first.content
    reader.finish()
    remark = (
        f"the other records were found by the file's index, {plural(left_out, 'record')} left out"
    )
    content.damage = "; ".join(filter(None, [*reader.left_out, first.end, remark, reader.end]))
    return content


def _reason(err: Exception) -> str:
    if isinstance(err, DamageError):
        return str(err)
    return f"a record cannot be read ({err or type(err).__name__})"


class _Reader:
    """Collector of the records' contents."""

    def __init__(self, content: Content, streams: Collection[str]) -> None:
        self.content = content
        self.kept = streams
        self.schemas: dict[int, str] = {}
        self.streams: dict[int, str] = {}
        self.budget = Budget(content.size)
        self.rows = SampleRows(lambda: self.budget.spend(WORK, _SAMPLE_WORK))
        self.chunks = Unpacker(self.budget)
        self._chunks_at = 0  # place of the first chunk in the file
        self.left_out: list[str] = []  # attachments
        self.end = ""  # reason why reading ended early

    def finish(self) -> None:
        """Store the samples in the content."""
        try:
            self.rows.pack()
        except _DAMAGES as err:
            self.end = self.end or _reason(err)
        self.content.samples = self.rows.finish()

    def spend_work(self, cost: int) -> None:
        """Charge the work of reading records to the budget."""
        self.budget.spend(WORK, cost)

    def wants(self, part: FileRange, start: int, end: int) -> bool:
        """Return True if a chunk with these log times may contain samples of the part."""
        if self.rows.is_empty:
            return True  # the first sample is always read: it relates times to k
        if end < part.from_ns:
            return False
        if start <= part.to_ns:
            return True
        self.rows.pack()  # a sample of the part may be in a later chunk
        return self.rows.last_k < part.k_end - 1

    def add(self, record: FileRecord) -> None:
        """Add one record of the file."""
        if record.opcode == Opcode.ATTACHMENT and not record.body:
            self.content.input = self.content.input or record.place
            return
        self.add_record(record.opcode, record.body)
        at, length = record.place
        if record.opcode == Opcode.CHUNK:
            self._chunks_at = self._chunks_at or at
            total = self.content.size - self._chunks_at
            self.rows.settle((at + length - self._chunks_at) / max(total, length))
        else:
            self.rows.settle()

    def add_record(self, opcode: int, body: bytes) -> None:
        """Add one record that was found in the file or in a chunk."""
        self.budget.spend(WORK, 1 if opcode == Opcode.MESSAGE else _RECORD_WORK)
        match opcode:
            case Opcode.CHUNK:
                self._walk(self.chunks.records(body))
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
                if name in (RUN, OUTCOME, RECOVERED) and name not in self.content.metadata:
                    self.content.metadata[name] = Metadata.read(data_stream(body)).metadata
            case Opcode.ATTACHMENT:
                self._attachment(body)
            case _:
                pass  # header, indexes, and records of later versions

    def _attachment(self, body: bytes) -> None:
        try:
            check_attachment(body)
        except DamageError as damage:
            self.left_out.append(str(damage))
            return
        attachment = Attachment.read(data_stream(body))
        if attachment.name in (CALIBRATION, CALIBRATION_RAW, CONFIG, CONTROLLER, DESCRIPTION):
            self.content.attachments.setdefault(attachment.name, attachment.data)

    def _walk(self, chunk: bytes) -> None:
        """Read the records of a chunk; consecutive samples of constant layout are read together."""
        view, streams, add_run = memoryview(chunk), self.streams, self.rows.add_run
        unpack_head, head_size = _MESSAGE.unpack_from, RECORD_HEAD.size
        at, end, work = 0, len(chunk), 0
        while at < end:
            if end - at < _MESSAGE.size:
                _check_opcode(chunk[at])
                raise DamageError("a chunk ends within a record")
            opcode, length, channel = unpack_head(chunk, at)
            after = at + head_size + length
            if opcode != _MESSAGE_CODE:
                _check_opcode(opcode)
            if after > end:
                raise DamageError("a record runs over the end of its chunk")
            if opcode == _MESSAGE_CODE:
                stream = streams.get(channel)
                if stream is None:
                    work += 1
                    at = after
                    continue
                if length == ROW_LENGTH and stream == "sample":
                    work += _RUN_WORK
                    at += add_run(view, at)
                    continue
            self.add_record(opcode, chunk[at + head_size : after])
            at = after
        self.budget.spend(WORK, work)

    def _message(self, body: bytes) -> None:
        stream = self.streams.get(int.from_bytes(body[:2], "little"))
        if stream is None:
            return
        data = body[MESSAGE_HEAD.size :]
        if stream == "sample":
            self.rows.add(data)
            return
        parsed = protobuf.decode_message(protobuf.OF_STREAM[stream], data)
        self.budget.spend(WORK, _RECORD_WORK)
        self.budget.spend(KEPT, len(data) + _OVERHEADS[stream])
        self.content.messages.setdefault(stream, []).append(parsed)


def _check_opcode(opcode: int) -> None:
    if opcode not in _IN_CHUNKS:
        raise DamageError(
            f"a chunk contains a record (opcode {opcode}) that must not be in a chunk"
        )


def _text(body: bytes, at: int) -> str:
    """Return the text at byte `at` of a record; "" if the text is longer than any known name."""
    (n,) = struct.unpack_from("<I", body, at)
    struct.unpack_from(f"{n}x", body, at + 4)  # raises if the text exceeds the body
    return body[at + 4 : at + 4 + n].decode() if n <= _NAME_LIMIT else ""
