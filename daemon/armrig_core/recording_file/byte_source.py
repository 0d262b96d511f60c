"""The bytes of a file from front to back, each read once, with their hash and checksum."""

from __future__ import annotations

import hashlib
import zlib
from typing import IO

from armrig_core.errors import InputError

_BLOCK = 1 << 18  # B that are read at once where nobody wants them


class ByteSource:
    """The bytes of a file, from the front."""

    def __init__(self, stream: IO[bytes], size: int, *, is_hashed: bool = False) -> None:
        """Begin; `is_hashed` says that `sha256` will be asked for."""
        self.stream, self.left = stream, size
        self.at = 0
        self.whole = 0
        """End of the last whole record."""
        self.crc = 0
        """CRC-32 of what was read up to there."""
        self.passed = False
        """Chunks were passed over."""
        self._crc = 0
        self._hash = hashlib.sha256() if is_hashed else None

    def read(self, n: int) -> bytes:
        """Return the next n bytes, fewer at the end of the file."""
        data = self.stream.read(min(n, self.left))
        # One that has become shorter since it was opened ends here.
        self.left = self.left - len(data) if data or not n else 0
        self.at += len(data)
        self._crc = zlib.crc32(data, self._crc)
        if self._hash is not None:
            self._hash.update(data)
        return data

    def end_record(self) -> None:
        """Note that a record ends here, whole."""
        self.whole, self.crc = self.at, self._crc

    def skip(self, n: int) -> None:
        """Read n bytes that nobody wants."""
        while n > 0 and (data := self.read(min(n, _BLOCK))):
            n -= len(data)

    def pass_over(self, n: int) -> None:
        """Leave n bytes out, unread unless they are hashed."""
        self.passed = True
        if self._hash is not None:
            self.skip(n)
        else:
            self.at = self.stream.seek(self.at + n)
            self.left -= n

    def sha256(self) -> str:
        """Read the rest; return the hash of the file, as large as it was when it was opened."""
        if self._hash is None:
            raise InputError("is_hashed=True was not asked for")
        self.skip(self.left)
        return self._hash.hexdigest()
