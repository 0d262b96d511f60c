"""The bytes of a file from front to back, with their hash and checksum."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator
from typing import IO


class ByteSource:
    """The bytes of a file, from the front."""

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self.stream, self.left = stream, size
        self.at = 0
        self.whole = 0
        """End of the last whole record."""
        self.passed = False
        """Chunks were passed over, unread."""

    def read(self, n: int) -> bytes:
        """Return the next n bytes, fewer at the end of the file."""
        data = self.stream.read(min(n, self.left))
        # One that has become shorter since it was opened ends here.
        self.left = self.left - len(data) if data or not n else 0
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
        # To read the file once more in large pieces is faster than to hash each record.
        self.stream.seek(0)
        while length > 0 and (block := self.stream.read(min(length, 1 << 20))):
            length -= len(block)
            yield block
        self.stream.seek(self.at)
