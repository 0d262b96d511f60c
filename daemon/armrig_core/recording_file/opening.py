"""How a file that may be anything is opened."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.file_records import MAGIC


@contextmanager
def byte_source(path: Path, *, is_hashed: bool = False) -> Iterator[ByteSource | None]:
    """Give the file behind its magic; None where it has none.

    Parameters
    ----------
    is_hashed : bool
        Whether its hash will be asked for.

    Raises
    ------
    OSError
        The file cannot be opened or read.
    DamageError
        It is no regular file: a pipe or a device would keep us waiting, or never end.
    """
    with open(path, "rb", opener=opened) as stream:
        found = os.fstat(stream.fileno())
        if not stat.S_ISREG(found.st_mode):
            msg = "not a regular file"
            raise DamageError(msg)
        source = ByteSource(stream, found.st_size, is_hashed=is_hashed)
        yield source if source.read(len(MAGIC)) == MAGIC else None


def opened(path: str, flags: int) -> int:
    """Open a file that may be anything, as the opener of `open`."""
    # Do not wait until somebody writes to a pipe. Windows has neither of the two flags, but another
    # one without which it would change bytes.
    more = ("O_NONBLOCK", "O_NOCTTY", "O_BINARY")
    return os.open(path, flags | sum(getattr(os, name, 0) for name in more))
