"""Reader that reads each byte of a file once, in order, and computes a hash and a checksum."""

from __future__ import annotations

import hashlib
import zlib
from typing import IO

from armrig_core.errors import InputError

_SKIP_BYTES = 1 << 18  # block size for bytes that are read only for the hash or checksum


class ByteSource:
    """Reader of a file's bytes, in order."""

    def __init__(self, stream: IO[bytes], size: int, *, is_hashed: bool = False) -> None:
        """Begin at the stream's position; `is_hashed` permits a call of `sha256`."""
        self.stream, self.left = stream, size
        self.at = 0
        self.whole = 0
        """Position of the end of the last complete record, in B."""
        self.crc = 0
        """CRC-32 of the bytes up to `whole`."""
        self.passed = False
        """True after a call of `pass_over`."""
        self._crc = 0
        self._hash = hashlib.sha256() if is_hashed else None

    def read(self, n: int) -> bytes:
        """Return the next n bytes, or fewer bytes at the end of the file."""
        data = self.stream.read(min(n, self.left))
        # A file that was shortened after it was opened ends here.
        self.left = self.left - len(data) if data or not n else 0
        self.at += len(data)
        self._crc = zlib.crc32(data, self._crc)
        if self._hash is not None:
            self._hash.update(data)
        return data

    def end_record(self) -> None:
        """Mark the current position as the end of a complete record."""
        self.whole, self.crc = self.at, self._crc

    def skip(self, n: int) -> None:
        """Read and discard n bytes."""
        while n > 0 and (data := self.read(min(n, _SKIP_BYTES))):
            n -= len(data)

    def pass_over(self, n: int) -> None:
        """Skip n bytes without reading them, unless they are hashed."""
        self.passed = True
        if self._hash is not None:
            self.skip(n)
        else:
            self.at = self.stream.seek(self.at + n)
            self.left -= n

    def sha256(self) -> str:
        """Read the rest of the file; return the hash of all bytes that it had when opened."""
        if self._hash is None:
            raise InputError("sha256() needs is_hashed=True")
        self.skip(self.left)
        return self._hash.hexdigest()
