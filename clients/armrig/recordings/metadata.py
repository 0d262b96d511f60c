"""The metadata of a recording without its samples, by the index at the end of the file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from struct import Struct, error
from typing import IO

from armrig_core.manifest import OUTCOME, RUN
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.file_records import MAGIC, RECORD_HEAD, RECORD_LIMIT, CutOffError
from armrig_core.recording_file.opening import regular_file
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Metadata, MetadataIndex

_FOOTER = Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, CRC
_FOOTER_BODY = 8 + 8 + 4


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """Return the metadata records of a run and of its outcome, by name; what is there of them.

    Three short reads, however long the recording is. The samples are not looked at, so nothing is
    said of whether they are whole.

    Raises
    ------
    OSError
        The file cannot be opened or read.
    DamageError
        It is no MCAP file, or has no end that says where the records are.
    """
    with regular_file(path) as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise DamageError("not an MCAP file")
        try:
            return _records(stream, os.fstat(stream.fileno()).st_size)
        except (McapError, error, ValueError, OverflowError) as err:
            raise DamageError(f"its index cannot be read ({err or type(err).__name__})") from err


def _records(stream: IO[bytes], size: int) -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    for index in _indexes(stream, size):
        # The first of each name, as whoever reads the whole file takes it; and an index of a
        # hundred thousand of them must not have us read as many records.
        if index.name in (RUN, OUTCOME) and index.name not in found:
            opcode, body = _record(stream, index.offset)
            if opcode != Opcode.METADATA:
                raise DamageError("its index points to something else than metadata")
            found[index.name] = Metadata.read(_bytes(body)).metadata
    return found


def _indexes(stream: IO[bytes], size: int) -> Iterator[MetadataIndex]:
    """Give what the summary, between the data and the footer, says of where metadata are."""
    end = size - _FOOTER.size - len(MAGIC)
    if end < len(MAGIC):
        raise CutOffError("without its footer")
    stream.seek(end)
    tail = stream.read(_FOOTER.size + len(MAGIC))
    opcode, length, start, _, _ = _FOOTER.unpack(tail[: _FOOTER.size])
    if (opcode, length, tail[_FOOTER.size :]) != (Opcode.FOOTER, _FOOTER_BODY, MAGIC):
        raise CutOffError("without its footer")
    if not len(MAGIC) <= start <= end or end - start > RECORD_LIMIT:
        raise DamageError("its footer says of no summary")
    stream.seek(start)
    summary, at = stream.read(end - start), 0
    while at + RECORD_HEAD.size <= len(summary):
        opcode, length = RECORD_HEAD.unpack_from(summary, at)
        at += RECORD_HEAD.size
        if opcode == Opcode.METADATA_INDEX:
            yield MetadataIndex.read(_bytes(summary[at : at + length]))
        at += length


def _record(stream: IO[bytes], offset: int) -> tuple[int, bytes]:
    stream.seek(offset)
    head = stream.read(RECORD_HEAD.size)
    opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (0, 0)
    if length > RECORD_LIMIT:
        raise DamageError(f"a record of {length} B is longer than the {RECORD_LIMIT} B allowed")
    return opcode, stream.read(length)


def _bytes(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))
