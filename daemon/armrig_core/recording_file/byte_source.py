"""The bytes of a file from front to back, with their hash and checksum."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator
from typing import IO


class ByteSource:
    """The bytes of a file, from the front."""

    def __init__(self, stream: IO[bytes], size: int, *, is_hashed: bool = False) -> None:
        """Begin; `is_hashed` says that `sha256` will be asked for, so that less is read twice."""
        self.stream, self.left = stream, size
        self.at = 0
        self.whole = 0
        """End of the last whole record."""
        self.passed = False
        """Chunks were passed over, unread."""
        self._is_hashed = is_hashed
        self._hash, self._hashed = hashlib.sha256(), 0  # and of how many bytes it is

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
        for block in self._blocks(self._hashed, self.at + self.left):
            self._hash.update(block)
        return self._hash.hexdigest()

    def crc(self, length: int) -> int:
        """Return the CRC-32 of the first `length` bytes."""
        crc, hashes = 0, self._is_hashed and not self._hashed
        for block in self._blocks(0, length):
            crc = zlib.crc32(block, crc)
            if hashes:
                self._hash.update(block)
                self._hashed += len(block)
        return crc

    def _blocks(self, begin: int, end: int) -> Iterator[bytes]:
        # To read the file once more in large pieces is faster than to hash each record.
        self.stream.seek(begin)
        while begin < end and (block := self.stream.read(min(end - begin, 1 << 20))):
            begin += len(block)
            yield block
        self.stream.seek(self.at)
