"""How a file that may be anything is opened."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.file_records import MAGIC

_ROOT = 0


@contextmanager
def byte_source(path: Path, *, is_hashed: bool = False) -> Iterator[ByteSource | None]:
    """Give the file behind its magic; None where it has none.

    Parameters
    ----------
    is_hashed : bool
        Whether its hash will be asked for.

    Raises
    ------
    OSError, DamageError
        As `regular_file`.
    """
    with regular_file(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        source = ByteSource(stream, size, is_hashed=is_hashed)
        yield source if source.read(len(MAGIC)) == MAGIC else None


def regular_file(path: Path, *, may_be_link: bool = True) -> IO[bytes]:
    """Open a regular file, and no link of another user: it could lead to what only we may read.

    Parameters
    ----------
    may_be_link : bool
        Whether a link of this user's own, or of root's, is followed.

    Raises
    ------
    OSError
        The file cannot be opened or read.
    DamageError
        It is a link that is not followed, or no regular file: a pipe or a device would keep us
        waiting, or never end.
    """
    try:
        stream = open(path, "rb", opener=no_link)  # noqa: SIM115 - the caller's
    except OSError:
        if not path.is_symlink():
            raise
        if not may_be_link or not _is_own(path):
            made = "a link" if not may_be_link else "a link that another user made"
            raise DamageError(
                f"{made}: it is not followed; copy the file that it leads to"
            ) from None
        stream = open(path, "rb", opener=opened)  # noqa: SIM115 - the caller's
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise DamageError("not a regular file")
    return stream


def _is_own(link: Path) -> bool:
    user = getattr(os, "geteuid", None)  # Windows has none, and hardly any links
    return user is None or link.lstat().st_uid in (user(), _ROOT)


def no_link(path: str, flags: int) -> int:
    """Open a file that may be anything but a link, as the opener of `open`."""
    return opened(path, flags | getattr(os, "O_NOFOLLOW", 0))


def opened(path: str, flags: int) -> int:
    """Open a file that may be anything, as the opener of `open`."""
    # Do not wait until somebody writes to a pipe. Windows has neither of the two flags, but another
    # one without which it would change bytes.
    more = ("O_NONBLOCK", "O_NOCTTY", "O_BINARY")
    return os.open(path, flags | sum(getattr(os, name, 0) for name in more))
