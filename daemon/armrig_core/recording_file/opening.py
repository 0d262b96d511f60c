"""Opening of untrusted files, and the lock on a recording that is being written."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from armrig_core.process.bounded import open_untrusted
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.byte_source import ByteSource
from armrig_core.recording_file.file_records import MAGIC

try:
    import fcntl
except ImportError:  # Windows also recovers recordings, and records virtual rigs
    _HAS_LOCKS = False
else:
    _HAS_LOCKS = True

_ROOT_UID = 0


@contextmanager
def byte_source(path: Path, *, is_hashed: bool = False) -> Iterator[ByteSource | None]:
    """Yield a reader of a file's bytes after the MCAP magic; None for a file without the magic.

    `is_hashed` is True if the caller will request the hash of the file.

    Raises the exceptions of `regular_file`.
    """
    with regular_file(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        source = ByteSource(stream, size, is_hashed=is_hashed)
        yield source if source.read(len(MAGIC)) == MAGIC else None


def regular_file(path: Path, *, may_be_link: bool = True) -> IO[bytes]:
    """Open a regular file; refuse another user's link, which could lead to a private file.

    If `may_be_link` is True, a link of this user or of root is followed.

    Raises OSError if the file cannot be opened or read. Raises DamageError if the path is a link
    that is not followed, or is not a regular file. A pipe may block, and a device may never end.
    """
    try:
        stream = open(path, "rb", opener=no_link)  # noqa: SIM115 - the caller closes it
    except OSError:
        if not path.is_symlink():
            raise
        if not may_be_link or not _is_own(path):
            kind = "another user's link" if may_be_link else "a link"
            raise DamageError(f"{kind} is not followed; copy the file to which it leads") from None
        stream = open(path, "rb", opener=open_untrusted)  # noqa: SIM115 - the caller closes it
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise DamageError("not a regular file")
    return stream


def _is_own(link: Path) -> bool:
    user = getattr(os, "geteuid", None)  # Windows has no geteuid, and hardly any links
    return user is None or link.lstat().st_uid in (user(), _ROOT_UID)


def no_link(path: str, flags: int) -> int:
    """Open an untrusted file, but no link; use this function as the `opener` of `open`."""
    return open_untrusted(path, flags | getattr(os, "O_NOFOLLOW", 0))


def lock(file: IO[bytes]) -> None:
    """Lock a file; raise BlockingIOError if another process holds the lock.

    The lock shows that the daemon of a recording is running. On a system without such locks
    (Windows), no file appears locked, and no process is excluded.
    """
    if _HAS_LOCKS:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
