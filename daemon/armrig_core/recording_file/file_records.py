"""Records of an MCAP file, in order, up to the first damage.

The reader trusts none of the sizes that a file states.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from struct import Struct
from typing import IO, NamedTuple

from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import DataEnd

from armrig_core.process.printable import printable
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = Struct("<BQ")
"""Opcode and length, in front of each record's content."""
MESSAGE_HEAD = Struct("<HIQQ")
"""Channel, sequence, log time and publish time, in front of each message."""
CHUNK_LIMIT = 8 << 20
"""Largest chunk that is unpacked, in B."""
RECORD_LIMIT = CHUNK_LIMIT + (64 << 10)
"""Longest record that is read, in B, except attachments."""
UNREADABLE = (McapError, struct.error, DecodeError, ValueError, OverflowError)
"""Exceptions of the libraries at damaged bytes; in most cases a CRC detects the damage first."""

_SKIPPED_OPCODES = (Opcode.CHUNK_INDEX, Opcode.STATISTICS)
_INDEX_HEAD = Struct("<HI")  # message index: channel, length of the rest
_CHUNK_TIMES = Struct("<QQ")
# Opcodes that are allowed in the data section. Without this check, a chunk whose opcode is damaged
# could be skipped like an index.
_DATA_OPCODES = (
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
_ATTACHMENT_HEAD = 8 + 8 + 4  # size of two times and of the name's length, in B
_NAME_LIMIT = 100  # in B
_CRC = Struct("<I")
_HEAD_BYTES = 1 << 10  # times, name and media type of an attachment
_BLOCK_BYTES = 1 << 18


class CutOffError(DamageError):
    """The file ends too early."""

    def __init__(self, how: str) -> None:
        super().__init__(f"the file is cut off: it ends {how}")


class Place(NamedTuple):
    """Position and length of a record's content in its file, in B."""

    at: int
    length: int


class FileRecord(NamedTuple):
    """A record that the caller selected by `RecordSelection`."""

    opcode: int
    body: bytes
    """Content; empty for an attachment with a name in `RecordSelection.left`."""
    place: Place


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordSelection:
    """Selection of the records to read; all others are skipped."""

    chunk: Callable[[int, int], bool] | None = None
    """Filter of chunks by their first and last log time, in ns; None selects all chunks."""
    left: tuple[str, ...] = ()
    """Names of attachments whose content is not read; their `FileRecord` has an empty `body`."""
    attachment: int = RECORD_LIMIT
    """Longest attachment that is read, in B; longer attachments are skipped."""


def file_records(
    source: ByteSource, wanted: RecordSelection, spend: Callable[[int], None]
) -> Iterator[FileRecord]:
    """Yield the records up to the final magic.

    `source` is positioned after the magic. `spend` is called for each record with the record's
    work, in units of the budget.

    Raises DamageError if the file ends early or is damaged.
    """
    ended = False
    while True:
        source.end_record()
        head = source.read(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            raise CutOffError("without its footer")
        opcode, length = RECORD_HEAD.unpack(head)
        if not ended and opcode not in _DATA_OPCODES:
            raise DamageError(f"the data section contains a record of opcode {opcode}")
        if length > source.left:
            raise CutOffError(f"{length - source.left} B before the end of its last record")
        spend(1)
        place = Place(source.at, length)
        if opcode == Opcode.MESSAGE_INDEX:
            _pass_index(source, length)
            continue
        if opcode in _SKIPPED_OPCODES:
            source.skip(length)
            continue
        begin = b""
        if opcode == Opcode.ATTACHMENT:
            begin = source.read(min(length, _ATTACHMENT_HEAD + _NAME_LIMIT))
            if any(_is_named(begin, name) for name in wanted.left):
                yield FileRecord(opcode, b"", place)
                source.skip(length - len(begin))
                continue
            if length > wanted.attachment:
                source.skip(length - len(begin))
                continue
        elif length > RECORD_LIMIT:
            raise DamageError(f"a record of {length} B is longer than the {RECORD_LIMIT} B allowed")
        if opcode == Opcode.CHUNK and wanted.chunk is not None:
            begin = source.read(min(length, _CHUNK_TIMES.size))
            if len(begin) == _CHUNK_TIMES.size and not wanted.chunk(*_CHUNK_TIMES.unpack(begin)):
                source.pass_over(length - len(begin))
                continue
        body = begin + source.read(length - len(begin))
        if opcode == Opcode.FOOTER:
            if source.read(len(MAGIC)) != MAGIC:
                raise CutOffError("without its final magic")
            source.end_record()
            return
        if opcode == Opcode.DATA_END:
            _check_data(source, body)
            ended = True
        else:
            yield FileRecord(opcode, body, place)


def check_attachment(attachment: bytes) -> None:
    """Refuse an attachment with a wrong checksum; the DamageError names the attachment."""
    (crc,) = _CRC.unpack(attachment[-_CRC.size :])
    if not crc or crc == zlib.crc32(attachment[: -_CRC.size]):
        return
    at = _ATTACHMENT_HEAD - 4
    n = int.from_bytes(attachment[at : at + 4], "little")  # this length may be damaged, too
    name = attachment[at + 4 : at + 4 + min(n, _NAME_LIMIT)].decode(errors="replace")
    raise DamageError(
        f"the checksum of the attachment '{printable(name)}' is wrong: it is left out"
    )


def attachment_sha256(stream: IO[bytes], place: Place) -> str:
    """Return the SHA-256 of the data of the attachment at `place`; "" if the attachment is damaged.

    The data are read in blocks, because an input may be long.
    """
    stream.seek(place.at)
    head = stream.read(min(place.length, _HEAD_BYTES))
    at = _ATTACHMENT_HEAD - 4
    for _ in range(2):  # name and media type
        at += 4 + int.from_bytes(head[at : at + 4], "little")
    left = int.from_bytes(head[at : at + 8], "little")
    at += 8
    if at > len(head) or at + left + _CRC.size != place.length:
        return ""
    stream.seek(place.at + at)
    crc, digest = zlib.crc32(head[:at]), hashlib.sha256()
    while left and (data := stream.read(min(left, _BLOCK_BYTES))):
        crc, left = zlib.crc32(data, crc), left - len(data)
        digest.update(data)
    expected = int.from_bytes(stream.read(_CRC.size), "little")
    return "" if left or expected not in (0, crc) else digest.hexdigest()


def _is_named(begin: bytes, name: str) -> bool:
    expected = len(name).to_bytes(4, "little") + name.encode()
    at = _ATTACHMENT_HEAD - 4
    return begin[at : at + len(expected)] == expected


def _check_data(source: ByteSource, body: bytes) -> None:
    """Check the checksum over all data, unless `pass_over` has skipped chunks."""
    expected = DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc
    if expected and not source.passed and expected != source.crc:
        raise DamageError("the checksum over all data is wrong: the file was changed")


def _pass_index(source: ByteSource, length: int) -> None:
    """Skip a message index; refuse a record that does not have the form of an index."""
    head = source.read(min(_INDEX_HEAD.size, length))
    if len(head) < _INDEX_HEAD.size or _INDEX_HEAD.unpack(head)[1] != length - len(head):
        raise DamageError("a message index does not have the form of an index")
    source.skip(length - len(head))
