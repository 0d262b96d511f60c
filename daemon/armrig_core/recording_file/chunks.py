"""The chunks of a recording, unpacked: what a chunk says of its own size is not believed."""

from __future__ import annotations

import zlib
from struct import Struct

import zstandard

from armrig_core.recording_file.budget import UNPACKED, Budget, DamageError
from armrig_core.recording_file.file_records import CHUNK_LIMIT

_HEAD = Struct("<QQQII")  # start, end, uncompressed size, uncompressed CRC, length of a name


class Unpacker:
    """Unpacks chunks, one after the other."""

    def __init__(self, budget: Budget) -> None:
        """Count what is unpacked in `budget`."""
        self._budget = budget
        self._zstd = zstandard.ZstdDecompressor(max_window_size=CHUNK_LIMIT)

    def records(self, body: bytes) -> bytes:
        """Return the records of a chunk, unpacked and checked.

        Raises
        ------
        DamageError
            It is too large, cannot be unpacked, or its checksum is wrong.
        struct.error, UnicodeDecodeError
            It has not the form of a chunk.
        """
        _, _, size, crc, n = _HEAD.unpack_from(body)
        at = _HEAD.size
        compression, at = body[at : at + n].decode(), at + n
        packed = memoryview(body)[at + 8 :]
        if size > CHUNK_LIMIT:
            raise DamageError(f"a chunk of {size} B is larger than the {CHUNK_LIMIT} B allowed")
        self._budget.spend(UNPACKED, size)
        if compression == "zstd":
            data = self._unpacked(packed, size)
        elif compression:
            raise DamageError(f"compression {compression!r} is not known; known are zstd and none")
        else:
            data = bytes(packed)
        if len(data) != size or (crc and zlib.crc32(data) != crc):
            raise DamageError("the checksum or the size of a chunk is wrong")
        return data

    def _unpacked(self, packed: memoryview, size: int) -> bytes:
        try:
            # A frame says how long it is, and no more comes out; where it says nothing, so much is
            # taken. decompress(max_output_size=…) would believe whatever a frame says.
            if zstandard.frame_content_size(packed) == size:
                return self._zstd.decompress(packed)
            with self._zstd.stream_reader(packed) as stream:
                return stream.read(size + 1)
        except zstandard.ZstdError as err:
            raise DamageError(f"a chunk cannot be unpacked ({err})") from err
