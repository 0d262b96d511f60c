"""The records of an MCAP file, one after the other, for as far as it is whole.

Nothing is believed that a file says of its own sizes, and at the first damage reading stops.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from struct import Struct
from typing import NamedTuple

from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import DataEnd

from armrig_core.printable import printable
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = Struct("<BQ")
"""Opcode and length, before each record's content."""
MESSAGE_HEAD = Struct("<HIQQ")
"""Channel, sequence, log time, publish time, before each message."""
CHUNK_LIMIT = 8 << 20
"""Largest chunk that is unpacked, in B."""
RECORD_LIMIT = CHUNK_LIMIT + (64 << 10)
"""Longest record that is read, in B; attachments apart."""
UNREADABLE = (McapError, struct.error, DecodeError, ValueError, OverflowError)
"""What the libraries raise on damaged bytes. The CRCs make it rare."""

_PASSED_OVER = (Opcode.CHUNK_INDEX, Opcode.STATISTICS)
_INDEX_HEAD = Struct("<HI")  # of a message index: channel, length of what follows
_CHUNK_TIMES = Struct("<QQ")
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
_ATTACHMENT_HEAD = 8 + 8 + 4  # B: two times, the length of a name
_NAME_LIMIT = 100  # B
_CRC = Struct("<I")


class CutOffError(DamageError):
    """The file ends too early; says how."""

    def __init__(self, how: str) -> None:
        super().__init__(f"the file is cut off: it ends {how}")


class Place(NamedTuple):
    """Where the content of a record stands in its file."""

    at: int
    length: int


class Record(NamedTuple):
    """A record of the file that is of interest."""

    opcode: int
    body: bytes
    """Its content; empty for an attachment that stays in the file."""
    place: Place


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What a reader wants of a file; the rest is passed over, unread."""

    chunk: Callable[[int, int], bool] | None = None
    """Whether it wants the chunk with messages of these log times, in ns; None: each."""
    left: str = ""
    """Name of the attachment that stays in the file, to be read from its place."""
    attachment: int = RECORD_LIMIT
    """Longest attachment that it wants, in B; a longer one is passed over."""


def file_records(
    source: ByteSource, wanted: Wanted, spend: Callable[[int], None]
) -> Iterator[Record]:
    """Give the records up to the closing magic.

    Parameters
    ----------
    source : ByteSource
        The file, behind its magic.
    spend : callable
        Called with the work of each record.

    Raises
    ------
    DamageError
        The file ends or breaks before.
    """
    ended = False
    while True:
        source.end_record()
        head = source.read(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            raise CutOffError("without its footer")
        opcode, length = RECORD_HEAD.unpack(head)
        if not ended and opcode not in _DATA:
            raise DamageError(f"the data section contains a record of opcode {opcode}")
        if length > source.left:
            raise CutOffError(f"{length - source.left} B before the end of its last record")
        spend(1)
        place = Place(source.at, length)
        if opcode == Opcode.MESSAGE_INDEX:
            _pass_index(source, length)
            continue
        if opcode in _PASSED_OVER:
            source.skip(length)
            continue
        begin = b""
        if opcode == Opcode.ATTACHMENT:
            begin = source.read(min(length, _ATTACHMENT_HEAD + _NAME_LIMIT))
            if _stays(begin, wanted.left):
                yield Record(opcode, b"", place)
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
                raise CutOffError("without its closing magic")
            source.end_record()
            return
        if opcode == Opcode.DATA_END:
            _check_data(source, body)
            ended = True
        else:
            yield Record(opcode, body, place)


def spoilt(attachment: bytes) -> str:
    """Return that the checksum of an attachment is wrong, with its name; "" where it is right."""
    (crc,) = _CRC.unpack(attachment[-_CRC.size :])
    if not crc or crc == zlib.crc32(attachment[: -_CRC.size]):
        return ""
    at = _ATTACHMENT_HEAD - 4
    n = int.from_bytes(attachment[at : at + 4], "little")  # it, too, may be wrong
    name = attachment[at + 4 : at + 4 + min(n, _NAME_LIMIT)].decode(errors="replace")
    return f"the checksum of the attachment '{printable(name)}' is wrong: it is left out"


def _stays(begin: bytes, name: str) -> bool:
    told = len(name).to_bytes(4, "little") + name.encode()
    at = _ATTACHMENT_HEAD - 4
    return name != "" and begin[at : at + len(told)] == told


def _check_data(source: ByteSource, body: bytes) -> None:
    """Check all data before its end; where chunks were passed over there is nothing to check by."""
    expected = DataEnd.read(ReadDataStream(BytesIO(body))).data_section_crc
    if expected and not source.passed and expected != source.crc:
        raise DamageError("the checksum over all data is wrong: something in the file was changed")


def _pass_index(source: ByteSource, length: int) -> None:
    """Pass over an index of messages, which must have the form of one: a chunk has not."""
    head = source.read(min(_INDEX_HEAD.size, length))
    if len(head) < _INDEX_HEAD.size or _INDEX_HEAD.unpack(head)[1] != length - len(head):
        raise DamageError("an index of messages has not the form of one")
    source.skip(length - len(head))
