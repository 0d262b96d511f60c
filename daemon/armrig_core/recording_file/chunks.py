"""Unpacking of chunks without trust in the size that a chunk states."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from struct import Struct

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from armrig_core.recording_file.budget import UNPACKED, Budget, DamageError
from armrig_core.recording_file.file_records import CHUNK_LIMIT, RECORD_HEAD, FileRecord

_HEAD = Struct("<QQQII")  # start, end, uncompressed size, uncompressed CRC, length of the name


class Unpacker:
    """Unpacker of chunks, one at a time."""

    def __init__(self, budget: Budget) -> None:
        """Count the unpacked bytes in `budget`."""
        self._budget = budget
        self._zstd = zstandard.ZstdDecompressor(max_window_size=CHUNK_LIMIT)

    def parts(self, record: FileRecord) -> Iterator[tuple[int, bytes]]:
        """Yield the opcodes and contents of the records in a chunk, or of another record."""
        if record.opcode != Opcode.CHUNK:
            yield record.opcode, record.body
            return
        data, at = self.records(record.body), 0
        while at < len(data):
            opcode, length = RECORD_HEAD.unpack_from(data, at)
            begin, at = at + RECORD_HEAD.size, at + RECORD_HEAD.size + length
            if at > len(data):
                raise DamageError("a record runs over the end of its chunk")
            yield opcode, data[begin:at]

    def records(self, body: bytes) -> bytes:
        """Check a chunk; return its unpacked records.

        Raises DamageError if the chunk is too large, cannot be unpacked, or has a wrong checksum.
        Raises struct.error or UnicodeDecodeError if `body` does not have the form of a chunk.
        """
        _, _, size, crc, n = _HEAD.unpack_from(body)
        at = _HEAD.size
        compression, at = body[at : at + n].decode(), at + n
        packed = memoryview(body)[at + 8 :]
        if size > CHUNK_LIMIT:
            raise DamageError(f"a chunk of {size} B is larger than the {CHUNK_LIMIT} B allowed")
        self._budget.spend(UNPACKED, size)
        if compression == "zstd":
            data = self._unpack(packed, size)
        elif compression == "lz4":
            data = _unpack_lz4(packed, size)
        elif compression:
            raise DamageError(f"compression {compression!r}: allowed are zstd, lz4 and none")
        else:
            data = bytes(packed)
        if len(data) != size or (crc and zlib.crc32(data) != crc):
            raise DamageError("the checksum or the size of a chunk is wrong")
        return data

    def _unpack(self, packed: memoryview, size: int) -> bytes:
        try:
            # If the frame states `size`, `decompress` returns at most `size` B. Any other frame is
            # read as a stream, because decompress(max_output_size=…) would trust the frame.
            if zstandard.frame_content_size(packed) == size:
                return self._zstd.decompress(packed)
            with self._zstd.stream_reader(packed) as stream:
                return stream.read(size + 1)
        except zstandard.ZstdError as err:
            raise DamageError(f"a chunk cannot be unpacked ({err})") from err


def _unpack_lz4(packed: memoryview, size: int) -> bytes:
    try:
        data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
    except RuntimeError as err:
        raise DamageError(f"a chunk cannot be unpacked ({err})") from err
    return data
