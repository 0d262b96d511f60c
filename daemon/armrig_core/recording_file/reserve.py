"""Disk space reserved for the end of a recording, so that its index fits even on a full disk."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


class Reserve:
    """Space reserved in a directory; the system frees it if the process dies."""

    def __init__(self, directory: Path) -> None:
        """Reserve no space yet."""
        # The file has no name, so nobody finds it, and the system frees it when the process dies.
        self._file = tempfile.TemporaryFile(dir=directory)  # noqa: SIM115 - open until released
        self._size = 0

    def hold(self, size: int) -> None:
        """Reserve `size` B until `release`; raise OSError if there is no space."""
        has_room = hasattr(os, "posix_fallocate")  # not every system has it
        if size > self._size and has_room and not self._file.closed:
            os.posix_fallocate(self._file.fileno(), 0, size)
            self._size = size

    def release(self) -> bool:
        """Release the space; return whether space was reserved."""
        held, self._size = self._size, 0
        self._file.close()
        return held > 0
