"""Rewriting of a recording: small chunks become chunks of a size that suits readers.

During a run, each flush ends a chunk, ten times a second. The chunks are therefore small, and
little is lost if the process dies. The finished recording has chunks of 1 MiB.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.writer import CompressionType, Writer

from armrig_core.recording_file.budget import Budget, DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.chunks import Unpacker
from armrig_core.recording_file.file_records import (
    MESSAGE_HEAD,
    UNREADABLE,
    FileRecord,
    RecordSelection,
    check_attachment,
    file_records,
)
from armrig_core.recording_file.opening import byte_source, lock

CHUNK_BYTES = 1 << 20
CHUNK_NS = 10_000_000_000
"""Longest time in a chunk, in ns: a damaged chunk costs no more."""


class Rewriter:
    """Writer of records to a new file."""

    def __init__(self, target: IO[bytes], size: int) -> None:
        """Write the records of a file of `size` B to `target`."""
        self.metadata: dict[str, dict[str, str]] = {}
        """Metadata records written so far, by name."""
        self.topics: dict[int, str] = {}
        """Topic of each channel, by the channel's number in the source."""
        self.left_out: list[str] = []
        """Messages about damaged attachments, which are not written."""
        self._writer = Writer(
            target, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        self._chunks = Unpacker(Budget(size))
        self._schemas = {0: 0}
        self._channels: dict[int, int] = {}
        self._chunk_end_ns = 0

    def add(self, record: FileRecord) -> Iterator[tuple[int, bytes]]:
        """Write a record of a file; yield channel and payload of each message in it."""
        for opcode, body in self._chunks.parts(record):
            yield from self._add(opcode, body)

    def add_metadata(self, name: str, metadata: dict[str, str]) -> None:
        """Write a metadata record."""
        self.metadata[name] = metadata
        self._writer.add_metadata(name, metadata)

    def finish(self) -> None:
        """Complete the file."""
        self._writer.finish()

    def _add(self, opcode: int, body: bytes) -> Iterator[tuple[int, bytes]]:
        writer = self._writer
        match opcode:
            case Opcode.MESSAGE:
                channel, sequence, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(body)
                data = body[MESSAGE_HEAD.size :]
                if channel not in self._channels:
                    return  # an unknown channel: no reader can decode the message
                if log_ns >= self._chunk_end_ns:
                    writer.flush()
                    self._chunk_end_ns = log_ns + CHUNK_NS
                writer.add_message(self._channels[channel], log_ns, data, publish_ns, sequence)
                yield channel, data
            case Opcode.HEADER:
                header = Header.read(_stream(body))
                writer.start(header.profile, header.library)
            case Opcode.SCHEMA:
                schema = Schema.read(_stream(body))
                if schema.id not in self._schemas:
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                    self._schemas[schema.id] = number
            case Opcode.CHANNEL:
                self._add_channel(Channel.read(_stream(body)))
            case Opcode.METADATA:
                metadata = Metadata.read(_stream(body))
                self.add_metadata(metadata.name, metadata.metadata)
            case Opcode.ATTACHMENT:
                self._add_attachment(body)
            case _:
                pass  # indexes; the writer makes the indexes of the new file

    def _add_channel(self, channel: Channel) -> None:
        if channel.id in self._channels:
            return
        if channel.schema_id not in self._schemas:
            return  # no reader can decode its messages
        self.topics[channel.id] = channel.topic
        self._channels[channel.id] = self._writer.register_channel(
            channel.topic,
            channel.message_encoding,
            self._schemas[channel.schema_id],
            channel.metadata,
        )

    def _add_attachment(self, body: bytes) -> None:
        try:
            check_attachment(body)
        except DamageError as damage:
            self.left_out.append(str(damage))
            return
        a = Attachment.read(_stream(body))
        self._writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)


def compact(source: Path, target: Path) -> None:
    """Copy all records of the complete recording `source` to `target`, and sync `target`.

    Raises OSError if the disk is full, or `target` exists already. Raises DamageError if `source`
    is damaged.
    """
    with byte_source(source) as read, target.open("xb") as written:
        if read is None:
            raise DamageError("not an MCAP file")
        lock(written)
        rewriter = Rewriter(written, read.at + read.left)
        try:
            for record in all_records(read):
                for _ in rewriter.add(record):
                    pass
        except UNREADABLE as err:
            raise DamageError(f"a record cannot be read ({err or type(err).__name__})") from err
        if rewriter.left_out:
            raise DamageError(rewriter.left_out[0])
        rewriter.finish()
        written.flush()
        os.fsync(written.fileno())


def all_records(source: ByteSource) -> Iterator[FileRecord]:
    """Yield the records of a file, including attachments of any length."""
    return file_records(source, RecordSelection(attachment=source.at + source.left), lambda _: None)


def sync_directory(directory: Path) -> None:
    """Sync the names in `directory` to the disk, if the system can do it."""
    if sys.platform == "win32":  # Windows opens no directory
        return
    fd = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))
