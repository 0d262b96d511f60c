"""Room on the disk that is kept for the end of a recording: a full disk must not cost its index."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


class Reserve:
    """Room in a directory, taken from now on; it ends with us, whatever kills us."""

    def __init__(self, directory: Path) -> None:
        """Hold nothing yet."""
        # It has no name, so nobody finds it, and the system frees it when we die.
        self._file = tempfile.TemporaryFile(dir=directory)  # noqa: SIM115 - open until released
        self._size = 0

    def hold(self, size: int) -> None:
        """Hold so many bytes, until all is released; raises OSError where there is no room."""
        has_room = hasattr(os, "posix_fallocate")  # not every system has it
        if size > self._size and has_room and not self._file.closed:
            os.posix_fallocate(self._file.fileno(), 0, size)
            self._size = size

    def release(self) -> bool:
        """Give it back; return whether there was any."""
        held, self._size = self._size, 0
        self._file.close()
        return held > 0
